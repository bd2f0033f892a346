//! The conversation at both ends: who may say what when, and what it means.
mod asking;
mod cadence;
mod client;
mod close;
mod copies;
mod driven;
mod driver;
mod event;
mod misuse;
mod patience;
mod pings;
mod replica;
mod server;

pub use asking::Asking;
pub use client::ClientSession;
pub use close::CloseCode;
pub use driven::Driven;
pub use event::Event;
pub use misuse::Misuse;
pub use replica::Replica;
pub use server::{Request, ServerSession};
