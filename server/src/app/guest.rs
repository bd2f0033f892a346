//! One client of the paper's protocol, and the scene that it leads.
//!
//! Reads what it says, does it at its frames, and says what came of that. Its scene is named `app/` and the number of its
//! simulation; it begins with the first frame and ends with the client.

use core::net::{IpAddr, SocketAddr};
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_app::{ErrorReport, Framed, HEADER_BYTES, Id, Message, Session};
use rhumb_protocol::Peer;
use rhumb_protocol::scene::{IdRange, PublishSchedule, SceneConfig, SceneName, Stepping};
use rhumb_reckoning::{Damping, Integrator};

use super::frame_clock::FrameClock;
use super::lead::Lead;
use super::options::{AppOptions, TimeAdvanced};
use super::refusal::{Refusal, RefusedMessage};
use super::send_queue::SendQueue;
use super::state_reporter::{FrameOutput, ReportOptions, StateReporter, Transport};
use super::world_mirror::{ActorPush, MATERIAL, Reply, WorldMirror};
use crate::outbox::Outbox;
use crate::scene_runner::{SceneRunner, Stopwatch};

/// A client.
#[derive(Debug)]
pub(super) struct Guest {
    pub(super) session: Session,
    pub(super) address: IpAddr,
    pub(super) guest_state: GuestState,
    /// Where its states go; on TCP while it is not known.
    pub(super) states_to: Option<SocketAddr>,
    /// Its scene, once there was a frame.
    pub(super) scene: Option<GuestScene>,
    mirror: WorldMirror,
    reporter: StateReporter,
    pub(super) send_queue: SendQueue,
    /// How many refusals were output since the last frame.
    refusals: u32,
}

/// Where a client stands with its host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GuestState {
    /// It has not logged on.
    Silent,
    /// It has, under this number, which no other has.
    Leads(u32),
    /// It was sent away, or went: it is not heard any more, and has no scene.
    Parted,
}

/// What a client has of its scene.
#[derive(Debug)]
pub(super) struct GuestScene {
    pub(super) name: SceneName,
    /// Whose it is.
    pub(super) simulation: u32,
    /// The indices that its bodies may have.
    pub(super) range: IdRange,
    pub(super) frame_clock: FrameClock,
}

/// What a client's word asks of the host.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum GuestRequest {
    Nothing,
    /// It is taken in under this number.
    Logon(u32),
    /// So many seconds shall pass.
    Frame(f32),
    Logoff,
}

/// Refusals that are output and logged between two frames; more are of no use to anybody.
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
            guest_state: GuestState::Silent,
            states_to: None,
            scene: None,
            mirror: WorldMirror::default(),
            reporter: StateReporter::default(),
            send_queue: SendQueue::default(),
            refusals: 0,
        }
    }

    /// Takes a message in.
    pub(super) fn handle_message(&mut self, framed: &Framed) -> GuestRequest {
        match framed.message {
            Message::Logon(logon) => return GuestRequest::Logon(logon.simulation),
            Message::Logoff(_) => return GuestRequest::Logoff,
            Message::AdvanceTime((_, seconds)) => return GuestRequest::Frame(seconds),
            _ => {}
        }
        match self.mirror.handle_message(framed) {
            Ok(Reply::Nothing) => {}
            Ok(Reply::Mass(mass)) => {
                if let Message::GetMass(id) = framed.message {
                    self.say_mass(id.object, mass);
                }
            }
            Err(refusal) => self.refuse(RefusedMessage::at_once(framed.index, refusal)),
        }
        GuestRequest::Nothing
    }

    /// The number under which it has logged on, while it leads something.
    pub(super) const fn simulation(&self) -> Option<u32> {
        match self.guest_state {
            GuestState::Leads(simulation) => Some(simulation),
            GuestState::Silent | GuestState::Parted => None,
        }
    }

    fn say_mass(&mut self, object: u32, mass: f32) {
        // Who has not logged on has asked nothing.
        let Some(simulation) = self.simulation() else {
            return;
        };
        let actor = Id { simulation, object };
        self.send_queue.lasting(&Message::UpdateMass((actor, mass)));
    }

    /// A message was not done: its sender is output, which the published plug-in passes over, and so is the log.
    pub(super) fn refuse(&mut self, refused: RefusedMessage) {
        self.refusals += 1;
        if self.refusals > REFUSALS_MAX {
            return;
        }
        let simulation = self.simulation();
        let RefusedMessage {
            index,
            actor,
            refusal,
        } = refused;
        tracing::warn!(simulation, index, actor, %refusal, "a message of an app client was not done");
        let text = refusal.to_string();
        self.send_queue
            .lasting(&Message::Error(ErrorReport { index, text }));
    }

    /// The config of the scene that begins with a frame so long.
    pub(super) fn config(&self, seconds: f32) -> Result<(SceneConfig, FrameClock), Refusal> {
        let frame_clock = FrameClock::of_frame(seconds).ok_or(Refusal::Time)?;
        let config = SceneConfig {
            integrator: Integrator {
                rate: frame_clock.rate(),
                substeps: SUBSTEPS,
            },
            gravity: self.mirror.gravity.unwrap_or(Vec3::ZERO),
            stepping: Stepping::Lockstep,
            material: MATERIAL,
            damping: DAMPING,
            sleep: None,
            publish_schedule: PublishSchedule::EACH_TICK,
        };
        Ok((config, frame_clock))
    }

    /// A frame: what was said is done, time passes, and what came of it is said.
    pub(super) fn frame(
        &mut self,
        seconds: f32,
        at: FrameAt<'_>,
        options: &AppOptions,
    ) -> Result<(), Refusal> {
        let scene = self.scene.as_mut().ok_or(Refusal::Time)?;
        let owed = scene.frame_clock.ticks(seconds).ok_or(Refusal::Time)?;
        let simulation = scene.simulation;
        let FrameAt {
            leader,
            runner,
            clock,
            out,
            ticks_left,
        } = at;
        // Who asks for more time at once than may pass has its time pass more slowly.
        let ticks = owed.min(*ticks_left);
        *ticks_left -= ticks;
        self.refusals = 0;
        let mut lead = Lead {
            runner,
            leader,
            range: scene.range,
        };
        if let Some(gravity) = self.mirror.gravity
            && lead.scene().gravity() != gravity
        {
            lead.set_gravity(gravity)?;
        }
        let realised = self.mirror.realise(&mut lead);
        for _ in 0..ticks {
            self.mirror.push_all(&mut lead);
            lead.runner.step_for_leader(clock, out);
            self.reporter.note_contacts(&self.mirror, lead.scene());
        }
        if ticks > 0 {
            self.mirror.pushes.clear();
        }
        for (actor, mass) in realised.masses {
            self.say_mass(actor, mass);
        }
        for refused in realised.refused {
            self.refuse(refused);
        }
        let begun = clock();
        self.report(simulation, lead.runner, options);
        lead.runner.note_reporting(clock().since(begun));
        Ok(())
    }

    /// Says states, contacts, and that the frame is over.
    fn report(&mut self, simulation: u32, runner: &SceneRunner, options: &AppOptions) {
        let report = ReportOptions {
            states: options.states,
            transport: match self.states_to {
                Some(_) => Transport::Datagrams,
                None => Transport::Stream,
            },
            capacity: self.send_queue.capacity() / STATE_BYTES,
        };
        let mut output = FrameOutput::default();
        self.reporter.report(
            simulation,
            &report,
            &self.mirror,
            runner.scene(),
            &mut output,
        );
        let over = Message::TimeAdvanced(simulation);
        for message in &output.passing {
            self.send_queue
                .passing(message, self.states_to, options.datagrams);
        }
        for message in &output.lasting {
            self.send_queue.lasting(message);
        }
        match (options.time_advanced, report.transport) {
            (TimeAdvanced::Never, _) => {}
            (TimeAdvanced::Udp, Transport::Datagrams) => {
                self.send_queue
                    .passing(&over, self.states_to, options.datagrams);
            }
            // Where states fill what there is, nothing but this says that time goes on.
            (TimeAdvanced::Tcp, _) | (TimeAdvanced::Udp, Transport::Stream) => {
                self.send_queue.lasting(&over)
            }
        }
        self.send_queue.flush(self.states_to);
    }

    /// What waits to be written to it on TCP.
    pub(super) fn poll_bytes(&mut self) -> Option<Bytes> {
        self.send_queue.poll_bytes()
    }
}

/// Where and when a frame passes.
pub(super) struct FrameAt<'a> {
    pub(super) leader: Peer,
    pub(super) runner: &'a mut SceneRunner,
    pub(super) clock: Stopwatch<'a>,
    pub(super) out: &'a mut Outbox,
    /// Ticks that may pass before others have their turn.
    pub(super) ticks_left: &'a mut u32,
}

impl WorldMirror {
    /// Pushes what is pushed during this frame, once more for the next tick.
    fn push_all(&self, lead: &mut Lead<'_>) {
        for (name, push) in &self.pushes {
            let actor = self.actors.get(name);
            let Some(id) = actor.and_then(|actor| actor.body).map(|body| body.id) else {
                continue;
            };
            let command = match *push {
                ActorPush::Force(force) => rhumb_protocol::scene::Command::Force { id, force },
                ActorPush::Torque(torque) => rhumb_protocol::scene::Command::Torque { id, torque },
            };
            // What does not move is not pushed, whatever its client says.
            if let Err(error) = lead.command(&command) {
                tracing::debug!(actor = name, %error, "an actor was not pushed");
            }
        }
    }
}
