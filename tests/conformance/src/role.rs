//! The sides that a case can try.

/// The implementation under test.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// A server.
    Server,
    /// A client.
    Client,
    /// A program that decodes bytes, without a connection.
    Decoder,
    /// A client with a server.
    Pair,
}

impl Role {
    /// All roles.
    pub const ALL: [Self; 4] = [Self::Server, Self::Client, Self::Decoder, Self::Pair];

    /// The role as one lower-case word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Server => "server",
            Self::Client => "client",
            Self::Decoder => "decoder",
            Self::Pair => "pair",
        }
    }
}
