//! What a live scene is, and what the client is to do in it.

use core::num::NonZeroU32;

use rhumb_protocol::scene::Pace;

/// What the scene is, and what the client is to do in it.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Which script runs.
    pub script: &'static str,
    /// Bodies of it.
    pub bodies: u32,
    /// Ticks before the client may join.
    pub before: u64,
    /// Lockstep, or free.
    pub pace: Pace,
    /// Which ticks are spoken of: the multiples of this number.
    pub every: NonZeroU32,
    /// What the client does.
    pub wish: String,
}

impl Setting {
    /// A client that follows this script, from its twentieth tick on, in lockstep.
    #[must_use]
    pub fn of(script: &'static str, bodies: u32) -> Self {
        Self {
            script,
            bodies,
            before: 20,
            pace: Pace::Lockstep,
            every: NonZeroU32::MIN,
            wish: "follow 10000".to_owned(),
        }
    }

    /// The same with another wish.
    #[must_use]
    pub fn wishing(self, wish: &str) -> Self {
        let wish = wish.to_owned();
        Self { wish, ..self }
    }

    /// The same in a scene that speaks of the multiples of this number only.
    #[must_use]
    pub const fn each(mut self, every: NonZeroU32) -> Self {
        self.every = every;
        self
    }

    /// The same from another tick on.
    #[must_use]
    pub const fn after(mut self, before: u64) -> Self {
        self.before = before;
        self
    }
}
