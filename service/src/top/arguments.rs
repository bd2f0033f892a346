//! Arguments of `rhumb-server top`.

use clap::Args;

use super::request::MetricsUrl;

/// The server to read, and how often.
#[derive(Debug, Args)]
pub(crate) struct TopArguments {
    /// URL of the server's figures: the address that its --metrics names.
    #[arg(default_value = "http://127.0.0.1:9464", value_name = "URL")]
    pub(super) url: MetricsUrl,
    /// Prints one table as plain text and ends, for scripts; no terminal is needed.
    #[arg(long)]
    pub(super) once: bool,
}
