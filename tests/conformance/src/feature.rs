//! The features that an implementation may leave out.

/// A feature that a server may leave out, if it declares so.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, clap::ValueEnum)]
pub enum Feature {
    /// Scenes that step when members ask for it.
    Lockstep,
    /// Scenes that step by the server's clock.
    FreeRunning,
    /// Members that simulate bodies themselves (client authority).
    Authority,
    /// Streams limited by a byte budget.
    Budgets,
    /// Shapes without a volume.
    Sheets,
    /// Shapes made of several parts.
    Compounds,
    /// Streams with a publish interval above one tick, or with a later start.
    PublishSchedule,
}
