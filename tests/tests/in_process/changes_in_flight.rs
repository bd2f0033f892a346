//! Bodies whose properties change all the time stay within their tolerances.
//!
//! As in `simulated_network`, the claims of members about each body are checked against the truth. A random body gets
//! another description every few ticks: damping, gravity scale, locked axes, mass, kind, whether it is enabled.

use glam::Vec3;
use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, LockedAxes, Mass, Stepping};
use rhumb_reckoning::{Damping, Tick, Tolerance, ToleranceScale};
use rhumb_sims::by_name;
use rhumb_tests::{AlteredScript, COMMANDER, Dice, Stage, seed};

/// The bodies of a script, and how they change.
struct Changing {
    bodies: Vec<BodyDesc>,
    dice: Dice,
}

impl Changing {
    /// Adds a change to the commands of every third tick.
    fn alter(&mut self, tick: Tick, commands: &mut Vec<Command>) {
        for command in commands.iter() {
            if let Command::AddBody { desc, .. } = command
                && desc.kind == BodyKind::Dynamic
            {
                self.bodies.push(*desc);
            }
        }
        if tick.value().is_multiple_of(3) && !self.bodies.is_empty() {
            let place = self.dice.below(self.bodies.len());
            let desc = self.changed(self.bodies[place]);
            self.bodies[place] = desc;
            commands.push(Command::ChangeBody { desc });
        }
    }

    fn changed(&mut self, desc: BodyDesc) -> BodyDesc {
        let factor = self.dice.below(4) as f32;
        match self.dice.below(7) {
            0 => BodyDesc {
                damping: Some(Damping {
                    linear: factor,
                    angular: 3.0 - factor,
                }),
                ..desc
            },
            1 => BodyDesc {
                gravity_scale: factor * 0.5 - 0.5,
                ..desc
            },
            2 => BodyDesc {
                locked: LockedAxes::new(self.dice.below(64) as u8).unwrap_or_default(),
                ..desc
            },
            3 => BodyDesc {
                mass: Some(Mass {
                    mass: 10.0,
                    moments: Some(Vec3::new(1.0, 1.0 + factor * 0.5, 2.0)),
                }),
                ..desc
            },
            4 => BodyDesc {
                kind: if desc.kind == BodyKind::Dynamic {
                    BodyKind::Kinematic
                } else {
                    BodyKind::Dynamic
                },
                ..desc
            },
            5 => BodyDesc {
                tolerance_scale: ToleranceScale::new(self.dice.below(3) as i8 - 1)
                    .unwrap_or_default(),
                ..desc
            },
            _ => BodyDesc {
                enabled: !desc.enabled,
                ..desc
            },
        }
    }
}

fn stage(stepping: Stepping, links: &str, seed: u64) -> Stage {
    let mut changing = Changing {
        bodies: Vec::new(),
        dice: Dice::new(seed),
    };
    let script = by_name("ball-pit", 60, seed).expect("an existing script");
    let script = AlteredScript::new(script, move |tick, commands| changing.alter(tick, commands));
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    let links = links.parse().expect("a valid link configuration");
    Stage::new(Box::new(script), stepping, choice, links, seed)
}

#[test]
fn changed_bodies_stay_within_their_tolerances_in_every_tier() {
    let mut stage = stage(Stepping::Lockstep, "", 1);
    let fine = stage.enter(StreamChoice::Within(Tolerance::FINE));
    for _ in 0..400 {
        stage.tick();
    }
    let truth = stage.truth();
    for member in [COMMANDER, fine] {
        stage.histories[member].judge(&truth, "a member");
        assert!(!stage.histories[member].claims.is_empty());
    }
}

#[test]
fn changed_bodies_stay_within_their_tolerances_over_a_bad_link_and_for_late_joiners() {
    let seed = seed(29);
    let mut stage = stage(Stepping::FreeRunning, "rtt=80ms,loss=5%", seed);
    stage.run_script(Span::from_millis(3_000));
    let late = stage.enter(StreamChoice::Within(Tolerance::FINE));
    stage.run_script(Span::from_millis(3_000));
    let truth = stage.truth();
    for member in [COMMANDER, late] {
        let who = format!("member {member}, seed {seed}");
        stage.histories[member].judge(&truth, &who);
        assert!(!stage.histories[member].claims.is_empty(), "{who}");
    }
}
