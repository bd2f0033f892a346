//! One client of the paper's protocol, and the scene that it leads.
//!
//! Reads what it says, does it at its frames, and says what came of that. Its scene is named `app/` and the number of its
//! simulation; it begins with the first frame and ends with the client.

use core::net::{IpAddr, SocketAddr};
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_app::{Fault, Framed, HEADER_BYTES, Id, Message, Session};
use rhumb_protocol::Peer;
use rhumb_protocol::scene::{Cadence, IdRange, Pace as ScenePace, SceneName, SceneTerms};
use rhumb_reckoning::{Damping, Integrator};

use super::lead::Lead;
use super::ledger::{Answer, Ledger, MATERIAL, Push};
use super::mail::Mail;
use super::options::{AppOptions, TimeAdvanced};
use super::pace::Pace;
use super::refusal::{Refusal, Refused};
use super::telling::{Manner, Telling, Told, Way};
use crate::outbox::Outbox;
use crate::room::{Room, Stopwatch};

/// A client.
#[derive(Debug)]
pub(super) struct Guest {
    pub(super) session: Session,
    pub(super) address: IpAddr,
    pub(super) standing: Standing,
    /// Where its states go; on TCP while it is not known.
    pub(super) states_to: Option<SocketAddr>,
    /// Its scene, once there was a frame.
    pub(super) scene: Option<Scene>,
    ledger: Ledger,
    telling: Telling,
    pub(super) mail: Mail,
    /// How many refusals were told since the last frame.
    refusals: u32,
}

/// Where a client stands with its host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Standing {
    /// It has not logged on.
    Silent,
    /// It has, under this number, which no other has.
    Leads(u32),
    /// It was sent away, or went: it is not heard any more, and has no scene.
    Parted,
}

/// What a client has of its scene.
#[derive(Debug)]
pub(super) struct Scene {
    pub(super) name: SceneName,
    /// Whose it is.
    pub(super) simulation: u32,
    /// The indices that its bodies may have.
    pub(super) range: IdRange,
    pub(super) pace: Pace,
}

/// What a client's word asks of the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Asked {
    Nothing,
    /// It is taken in under this number.
    Logon(u32),
    /// So many seconds shall pass.
    Frame(f32),
    Logoff,
}

/// Refusals that are told and logged between two frames; more are of no use to anybody.
const REFUSALS_MAX: u32 = 16;
/// Bytes of a state.
const STATE_BYTES: usize = HEADER_BYTES + 64;
/// As bodies of the paper's engine have it by default.
const DAMPING: Damping = Damping {
    linear: 0.0,
    angular: 0.05,
};
const SUBSTEPS: NonZeroU32 = NonZeroU32::new(4).expect("four is not zero");

impl Guest {
    pub(super) fn new(address: IpAddr) -> Self {
        Self {
            session: Session::default(),
            address,
            standing: Standing::Silent,
            states_to: None,
            scene: None,
            ledger: Ledger::default(),
            telling: Telling::default(),
            mail: Mail::default(),
            refusals: 0,
        }
    }

    /// Takes a message in.
    pub(super) fn hear(&mut self, framed: &Framed) -> Asked {
        match framed.message {
            Message::Logon(logon) => return Asked::Logon(logon.simulation),
            Message::Logoff(_) => return Asked::Logoff,
            Message::AdvanceTime((_, seconds)) => return Asked::Frame(seconds),
            _ => {}
        }
        match self.ledger.hear(framed) {
            Ok(Answer::Nothing) => {}
            Ok(Answer::Mass(mass)) => {
                if let Message::GetMass(id) = framed.message {
                    self.say_mass(id.object, mass);
                }
            }
            Err(refusal) => self.refuse(Refused::at_once(framed.index, refusal)),
        }
        Asked::Nothing
    }

    /// The number under which it has logged on, while it leads something.
    pub(super) const fn simulation(&self) -> Option<u32> {
        match self.standing {
            Standing::Leads(simulation) => Some(simulation),
            Standing::Silent | Standing::Parted => None,
        }
    }

    fn say_mass(&mut self, object: u32, mass: f32) {
        // Who has not logged on has asked nothing.
        let Some(simulation) = self.simulation() else {
            return;
        };
        let actor = Id { simulation, object };
        self.mail.lasting(&Message::UpdateMass((actor, mass)));
    }

    /// A message was not done: its sender is told, which the published plug-in passes over, and so is the log.
    pub(super) fn refuse(&mut self, refused: Refused) {
        self.refusals += 1;
        if self.refusals > REFUSALS_MAX {
            return;
        }
        let simulation = self.simulation();
        let Refused {
            index,
            actor,
            refusal,
        } = refused;
        tracing::warn!(simulation, index, actor, %refusal, "a message of an app client was not done");
        let text = refusal.to_string();
        self.mail.lasting(&Message::Error(Fault { index, text }));
    }

    /// The terms of the scene that begins with a frame so long.
    pub(super) fn terms(&self, seconds: f32) -> Result<(SceneTerms, Pace), Refusal> {
        let pace = Pace::of_frame(seconds).ok_or(Refusal::Time)?;
        let terms = SceneTerms {
            integrator: Integrator {
                rate: pace.rate(),
                substeps: SUBSTEPS,
            },
            gravity: self.ledger.gravity.unwrap_or(Vec3::ZERO),
            pace: ScenePace::Lockstep,
            material: MATERIAL,
            damping: DAMPING,
            sleep: None,
            cadence: Cadence::EACH_TICK,
        };
        Ok((terms, pace))
    }

    /// A frame: what was said is done, time passes, and what came of it is said.
    pub(super) fn frame(
        &mut self,
        seconds: f32,
        at: FrameAt<'_>,
        options: &AppOptions,
    ) -> Result<(), Refusal> {
        let scene = self.scene.as_mut().ok_or(Refusal::Time)?;
        let owed = scene.pace.ticks(seconds).ok_or(Refusal::Time)?;
        let simulation = scene.simulation;
        let FrameAt {
            leader,
            room,
            clock,
            out,
            ticks_left,
        } = at;
        // Who asks for more time at once than may pass has its time pass more slowly.
        let ticks = owed.min(*ticks_left);
        *ticks_left -= ticks;
        self.refusals = 0;
        let mut lead = Lead {
            room,
            leader,
            range: scene.range,
        };
        if let Some(gravity) = self.ledger.gravity
            && lead.scene().gravity() != gravity
        {
            lead.set_gravity(gravity)?;
        }
        let realised = self.ledger.realise(&mut lead);
        for _ in 0..ticks {
            self.ledger.push_all(&mut lead);
            lead.room.step_for_leader(clock, out);
            self.telling.note_contacts(&self.ledger, lead.scene());
        }
        if ticks > 0 {
            self.ledger.pushes.clear();
        }
        for (actor, mass) in realised.masses {
            self.say_mass(actor, mass);
        }
        for refused in realised.refused {
            self.refuse(refused);
        }
        let begun = clock();
        self.tell(simulation, lead.room, options);
        lead.room.note_telling(clock().since(begun));
        Ok(())
    }

    /// Says states, contacts, and that the frame is over.
    fn tell(&mut self, simulation: u32, room: &Room, options: &AppOptions) {
        let manner = Manner {
            states: options.states,
            way: match self.states_to {
                Some(_) => Way::Datagrams,
                None => Way::Stream,
            },
            room: self.mail.room() / STATE_BYTES,
        };
        let mut told = Told::default();
        self.telling
            .tell(simulation, &manner, &self.ledger, room.scene(), &mut told);
        let over = Message::TimeAdvanced(simulation);
        for message in &told.passing {
            self.mail
                .passing(message, self.states_to, options.datagrams);
        }
        for message in &told.lasting {
            self.mail.lasting(message);
        }
        match (options.time_advanced, manner.way) {
            (TimeAdvanced::Never, _) => {}
            (TimeAdvanced::Udp, Way::Datagrams) => {
                self.mail.passing(&over, self.states_to, options.datagrams);
            }
            // Where states fill what there is, nothing but this says that time goes on.
            (TimeAdvanced::Tcp, _) | (TimeAdvanced::Udp, Way::Stream) => self.mail.lasting(&over),
        }
        self.mail.flush(self.states_to);
    }

    /// What waits to be written to it on TCP.
    pub(super) fn poll_bytes(&mut self) -> Option<Bytes> {
        self.mail.poll_bytes()
    }
}

/// Where and when a frame passes.
pub(super) struct FrameAt<'a> {
    pub(super) leader: Peer,
    pub(super) room: &'a mut Room,
    pub(super) clock: Stopwatch<'a>,
    pub(super) out: &'a mut Outbox,
    /// Ticks that may pass before others have their turn.
    pub(super) ticks_left: &'a mut u32,
}

impl Ledger {
    /// Pushes what is pushed during this frame, once more for the next tick.
    fn push_all(&self, lead: &mut Lead<'_>) {
        for (name, push) in &self.pushes {
            let actor = self.actors.get(name);
            let Some(id) = actor.and_then(|actor| actor.body).map(|body| body.id) else {
                continue;
            };
            let command = match *push {
                Push::Force(force) => rhumb_protocol::scene::Command::Force { id, force },
                Push::Torque(torque) => rhumb_protocol::scene::Command::Torque { id, torque },
            };
            // What does not move is not pushed, whatever its client says.
            if let Err(error) = lead.command(&command) {
                tracing::debug!(actor = name, %error, "an actor was not pushed");
            }
        }
    }
}
