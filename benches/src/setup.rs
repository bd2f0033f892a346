//! The work that `rhumb-bench cost` and the Criterion benches measure.
//!
//! Both take their setups from here, so that they cannot disagree about what is measured. A setup is made once, and its
//! work is then done repeatedly. Equal arguments make equal setups, to the bit.

pub mod decoding;
pub mod lanes;
pub mod prediction;
pub mod publishing;
pub mod session;
