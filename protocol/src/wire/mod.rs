//! Encoding of values as bytes and bits.
pub(crate) mod alphabet;
pub mod bits;
pub mod bytes;
mod malformed;
pub(crate) mod range;
mod value;

pub use malformed::Malformed;
pub use value::{OPTIONAL, Wire};
