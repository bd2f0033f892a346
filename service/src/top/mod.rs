//! `rhumb-server top`: a running server's figures in the terminal.
//!
//! It reads `/metrics` and `/health` of a server as any other program could, once a second. Rates are differences of two
//! readings. It changes nothing at the server.

mod change;
mod columns;
mod reading;
mod request;
mod run;
mod samples;
mod screen;
mod state;

pub(crate) use self::run::{TopArguments, run};
