//! The paper's protocol, spoken to its existing clients (see `spec/APP.md`).
//!
//! A client leads a scene of its own, which members of this server may watch like any other: same engine, same checks,
//! same containment. Sockets are the transport's.

mod actor;
mod form;
mod guest;
mod guests;
mod joint;
mod lead;
mod ledger;
mod lifting;
mod mail;
mod names;
mod options;
mod outline;
mod pace;
mod realise;
mod refusal;
mod shelf;
mod telling;

pub(crate) use guests::Guests;
pub use options::{AppOptions, Datagrams, States, TimeAdvanced};
