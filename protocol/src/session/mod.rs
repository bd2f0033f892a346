//! The conversation at both ends: who may say what when, and what it means.
mod client;
mod close;
mod patience;
mod replica;
mod server;

pub use client::{ClientSession, Event, Misuse};
pub use close::CloseCode;
pub use replica::Replica;
pub use server::{Request, ServerSession};
