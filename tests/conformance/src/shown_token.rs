//! The token that clients show to a server that asks for one.

use std::path::PathBuf;

use clap::Args;
use rhumb_protocol::message::Token;

/// The token of the suite's clients, and of the clients of a matrix.
#[derive(Debug, Args)]
pub(super) struct ShownToken {
    /// File with a token that every client shows: of an owner of all scenes, with at least 1,000 members.
    #[arg(long, value_name = "FILE")]
    token: Option<PathBuf>,
}

impl ShownToken {
    /// Reads the token; `None` if no file is named.
    ///
    /// # Errors
    ///
    /// The file that cannot be read, or holds no token.
    pub(super) fn read(&self) -> Result<Option<Token>, String> {
        let Some(path) = &self.token else {
            return Ok(None);
        };
        let named = |cause: &dyn std::fmt::Display| format!("{}: {cause}", path.display());
        let text = std::fs::read_to_string(path).map_err(|error| named(&error))?;
        let token = text.parse::<Token>().map_err(|error| named(&error))?;
        Ok(Some(token))
    }
}
