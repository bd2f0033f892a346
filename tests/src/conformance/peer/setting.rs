//! What a live scene is, and what the client is to do in it.

use core::num::NonZeroU32;

use rhumb_protocol::scene::Stepping;

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
    pub stepping: Stepping,
    /// Which ticks are spoken of: the multiples of this number.
    pub publish_interval: NonZeroU32,
    /// What the client does.
    pub task: String,
}

impl Setting {
    /// A client that follows this script, from its twentieth tick on, in lockstep.
    #[must_use]
    pub fn of(script: &'static str, bodies: u32) -> Self {
        Self {
            script,
            bodies,
            before: 20,
            stepping: Stepping::Lockstep,
            publish_interval: NonZeroU32::MIN,
            task: "subscribe 10000".to_owned(),
        }
    }

    /// The same with another task.
    #[must_use]
    pub fn wishing(self, task: &str) -> Self {
        let task = task.to_owned();
        Self { task, ..self }
    }

    /// The same in a scene that speaks of the multiples of this number only.
    #[must_use]
    pub const fn each(mut self, publish_interval: NonZeroU32) -> Self {
        self.publish_interval = publish_interval;
        self
    }

    /// The same from another tick on.
    #[must_use]
    pub const fn after(mut self, before: u64) -> Self {
        self.before = before;
        self
    }
}
