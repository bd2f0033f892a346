//! The setting of a live scene: its script, and the task of the client.

use core::num::NonZeroU32;

use rhumb_protocol::scene::Stepping;

/// The script of a live scene, and the task of the client in it.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Name of the script.
    pub script: &'static str,
    /// Number of bodies.
    pub bodies: u32,
    /// Number of ticks before the client may join.
    pub before: u64,
    /// Lockstep or free-running.
    pub stepping: Stepping,
    /// The server publishes the multiples of this number of ticks.
    pub publish_interval: NonZeroU32,
    /// The client's task.
    pub task: String,
}

impl Setting {
    /// A client that subscribes to this script from tick 20 on, in lockstep.
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
    pub fn with_task(self, task: &str) -> Self {
        let task = task.to_owned();
        Self { task, ..self }
    }

    /// The same with another publish interval.
    #[must_use]
    pub const fn each(mut self, publish_interval: NonZeroU32) -> Self {
        self.publish_interval = publish_interval;
        self
    }

    /// The same with another number of ticks before the client joins.
    #[must_use]
    pub const fn after(mut self, before: u64) -> Self {
        self.before = before;
        self
    }
}
