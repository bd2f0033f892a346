//! Mutants: peers that break one promise, so that its case must fail.
//!
//! No mutant changes the product: each wraps a correct peer and alters the data that it receives or sends.

mod client;
mod packets;
mod server;

pub use client::ClientMutant;
pub use server::{MutantServer, ServerMutant};
