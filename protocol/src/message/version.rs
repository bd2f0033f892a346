//! The versions of the protocol, and the first bytes of a client.

/// Supported versions of the protocol, newest first.
pub const VERSIONS: [u16; 1] = [1];
/// First bytes of a client's control stream.
pub const MAGIC: [u8; 4] = *b"RHMB";
