//! A script whose commands a test alters.
//!
//! Name and config are those of the script.

use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::Tick;
use rhumb_sims::Script;

/// A script, and what is done to its commands of each tick before they are sent.
pub struct AlteredScript<F> {
    script: Box<dyn Script>,
    alter: F,
}

impl<F: FnMut(Tick, &mut Vec<Command>) + Send> AlteredScript<F> {
    /// The script with its commands altered: `alter` gets those of a tick.
    pub fn new(script: Box<dyn Script>, alter: F) -> Self {
        Self { script, alter }
    }
}

impl<F: FnMut(Tick, &mut Vec<Command>) + Send> Script for AlteredScript<F> {
    fn name(&self) -> &'static str {
        self.script.name()
    }

    fn config(&self) -> SceneConfig {
        self.script.config()
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        let first = out.len();
        self.script.commands(tick, out);
        let mut commands = out.split_off(first);
        (self.alter)(tick, &mut commands);
        out.append(&mut commands);
    }
}
