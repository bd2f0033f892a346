//! A loaded file as a script: its commands before each tick.
//!
//! Has no controller. A joint comes with the later of its bodies.

use rhumb_protocol::scene::{Command, SceneConfig};
use rhumb_reckoning::Tick;
use rhumb_sims::Script;

use crate::assemble::{FreeIds, LoadedScene};
use crate::error::LoadError;

/// A loaded file as a script.
#[derive(Clone, Debug, PartialEq)]
pub struct FileScript {
    config: SceneConfig,
    /// Commands, each with the tick before which it comes; in this order.
    commands: Vec<(u64, Command)>,
    next: usize,
}

impl FileScript {
    /// The script of a scene.
    ///
    /// # Errors
    ///
    /// [`LoadError`] for a body that no scene accepts, and for more shapes than a scene has.
    pub fn new(scene: &LoadedScene) -> Result<Self, LoadError> {
        let tick = |index: usize| scene.bodies.get(index).map_or(0, |body| body.tick);
        let tick_of = |command: &Command| match command {
            Command::AddBody { desc, .. } => tick(desc.id.index() as usize),
            Command::AddJoint { joint, .. } => {
                let ticks = joint.bodies.map(|body| tick(body.index() as usize));
                ticks[0].max(ticks[1])
            }
            _ => 0,
        };
        let commands = scene.commands(FreeIds::default())?.into_iter();
        let mut commands: Vec<_> = commands
            .map(|command| (tick_of(&command), command))
            .collect();
        commands.sort_by_key(|(tick, _)| *tick);
        Ok(Self {
            config: scene.config,
            commands,
            next: 0,
        })
    }
}

impl Script for FileScript {
    fn name(&self) -> &'static str {
        "file"
    }

    fn config(&self) -> SceneConfig {
        self.config
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        let due = self.commands[self.next..].iter();
        let due = due.take_while(|(at, _)| Tick::new(*at) <= tick);
        let before = out.len();
        out.extend(due.map(|(_, command)| command.clone()));
        self.next += out.len() - before;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files::MemoryFiles;
    use crate::load::load_text;
    use crate::model::LoadOptions;

    #[test]
    fn bodies_and_their_joints_come_before_their_ticks() {
        let body = |tick: u32| {
            format!(
                "{{\"tick\": {tick}, \"dynamic\": true, \"shape\": {{\"ball\": {{\"radius\": 1}}}}, \"position\": [{tick}, 0, 0]}}"
            )
        };
        let frame = "{\"position\": [0, 0, 0]}";
        let text = format!(
            "{{\"bodies\": [{}, {}, {}], \"joints\": [{{\"bodies\": [0, 1], \"kind\": \"fixed\", \"frames\": [{frame}, {frame}]}}]}}",
            body(0),
            body(2),
            body(1)
        );
        let options = LoadOptions::default();
        let scene = load_text(&MemoryFiles::default(), "a.json", &text, &options).expect("balls");
        let mut script = FileScript::new(&scene).expect("within the limits");
        let mut counts = Vec::new();
        for tick in 0..4 {
            let mut out = Vec::new();
            script.commands(Tick::new(tick), &mut out);
            counts.push(out.len());
        }
        assert_eq!(counts, [2, 1, 2, 0]);
    }
}
