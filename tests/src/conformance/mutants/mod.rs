//! Peers that break one promise on purpose: each must fail its case.
//!
//! None is a change of the product: a client is a good one whose ears and mouth are not its own.

mod client;

pub use client::ClientMutant;
