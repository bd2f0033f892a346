//! The cases that are wanted, and when each runs.

/// The cases that are selected beyond those that every implementation must pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum)]
pub enum Profile {
    /// The cases that every conformant implementation must pass.
    #[default]
    Core,
    /// Additionally the bit-exact results of this project's physics engine.
    BitExact,
}

/// The order of a case relative to the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Schedule {
    /// Waits long for a timer of the peer: starts first.
    Slow,
    /// No constraint.
    Any,
    /// Would disturb other cases: runs after all of them.
    Alone,
}
