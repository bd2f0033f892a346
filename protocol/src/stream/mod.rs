//! The state stream: said once, followed by many.
mod observation;

pub use observation::{Activity, Observation};
