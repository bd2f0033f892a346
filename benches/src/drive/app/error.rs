//! The errors of a mode of the paper's protocol.

use std::fmt;
use std::io;

use super::messages::Unsupported;

/// The error of a mode of the paper's protocol.
#[derive(Debug)]
pub enum AppError {
    /// The script uses a feature that the protocol cannot express.
    Unsupported(Unsupported),
    /// The sockets failed, or the server ended the connection.
    PaperConnection(io::Error),
}

impl fmt::Display for AppError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unsupported(what) => write!(f, "the paper's protocol cannot express {what}"),
            Self::PaperConnection(cause) => write!(f, "the paper's protocol: {cause}"),
        }
    }
}

impl From<io::Error> for AppError {
    fn from(cause: io::Error) -> Self {
        Self::PaperConnection(cause)
    }
}

impl From<Unsupported> for AppError {
    fn from(what: Unsupported) -> Self {
        Self::Unsupported(what)
    }
}
