//! `rhumb-server top`: a running server's figures in the terminal.
//!
//! It reads `/metrics` and `/health` of a server as any other program could, once a second. Rates are differences of two
//! readings. It changes nothing at the server.

mod arguments;
mod change;
mod columns;
mod format;
mod keys;
mod reading;
mod request;
mod run;
mod samples;
mod screen;
mod state;
mod table;

pub(crate) use self::arguments::TopArguments;
pub(crate) use self::run::run;
