//! The conversation at both ends: who may say what when, and what it means.
mod client;
mod close;
mod event;
mod patience;
mod replica;
mod server;

pub use client::{ClientSession, Misuse};
pub use close::CloseCode;
pub use event::Event;
pub use replica::Replica;
pub use server::{Request, ServerSession};
