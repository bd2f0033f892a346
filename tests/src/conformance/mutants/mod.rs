//! Peers that break one promise on purpose: each must fail its case.
//!
//! None is a change of the product: each is a good peer whose ears and mouth are not its own.

mod client;
mod packets;
mod server;

pub use client::ClientMutant;
pub use server::{MutantServer, ServerMutant};
