//! One APP client, and the scene that it leads.
//!
//! Handles its messages, applies them at its frames, and reports the results. Its scene is named `app/` with the
//! number of its simulation; it begins with the first frame and ends with the client.

use core::net::{IpAddr, SocketAddr};
use core::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_app::{ErrorReport, FramedMessage, HEADER_BYTES, Id, Message, Session};
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

/// An APP client.
#[derive(Debug)]
pub(super) struct Guest {
    pub(super) session: Session,
    pub(super) address: IpAddr,
    pub(super) guest_state: GuestState,
    /// Destination of its states; TCP while it is unknown.
    pub(super) states_to: Option<SocketAddr>,
    /// Its scene, from its first frame on.
    pub(super) scene: Option<GuestScene>,
    mirror: WorldMirror,
    reporter: StateReporter,
    pub(super) send_queue: SendQueue,
    /// Refusals reported since the last frame.
    refusals: u32,
}

/// Progress of a client's session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GuestState {
    /// Not logged on.
    Silent,
    /// Logged on with this simulation, which no other client has.
    Leads(u32),
    /// Closed or logged off: its bytes are ignored, and it has no scene.
    Parted,
}

/// A client's scene.
#[derive(Debug)]
pub(super) struct GuestScene {
    pub(super) name: SceneName,
    /// The client's simulation.
    pub(super) simulation: u32,
    /// Index range of its bodies.
    pub(super) range: IdRange,
    pub(super) frame_clock: FrameClock,
}

/// Request of a client's message to the server loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum GuestRequest {
    Nothing,
    /// Log the client on with this simulation.
    Logon(u32),
    /// Advance time by so many seconds.
    Frame(f32),
    Logoff,
}

/// Refusals that are reported and logged between two frames; more would not help.
const REFUSALS_MAX: u32 = 16;
/// Bytes of a state.
const STATE_BYTES: usize = HEADER_BYTES + 64;
/// The defaults of the paper's engine.
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

    /// Handles a message.
    pub(super) fn handle_message(&mut self, framed: &FramedMessage) -> GuestRequest {
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
                    self.send_mass(id.object, mass);
                }
            }
            Err(refusal) => self.refuse(RefusedMessage::at_once(framed.index, refusal)),
        }
        GuestRequest::Nothing
    }

    /// The simulation of a logged-on client.
    pub(super) const fn simulation(&self) -> Option<u32> {
        match self.guest_state {
            GuestState::Leads(simulation) => Some(simulation),
            GuestState::Silent | GuestState::Parted => None,
        }
    }

    fn send_mass(&mut self, object: u32, mass: f32) {
        // A client that is not logged on has not asked.
        let Some(simulation) = self.simulation() else {
            return;
        };
        let actor = Id { simulation, object };
        self.send_queue.lasting(&Message::UpdateMass((actor, mass)));
    }

    /// Reports a refused message to the log and to its sender; the published plug-in ignores the report.
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

    /// Configuration of a scene whose first frame has this length.
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

    /// Runs a frame: applies the messages since the last one, advances time, and reports the results.
    pub(super) fn frame(
        &mut self,
        seconds: f32,
        at: FrameAt<'_>,
        options: &AppOptions,
    ) -> Result<(), Refusal> {
        let scene = self.scene.as_mut().ok_or(Refusal::Time)?;
        let ticks_due = scene.frame_clock.ticks(seconds).ok_or(Refusal::Time)?;
        let simulation = scene.simulation;
        let FrameAt {
            leader,
            runner,
            clock,
            out,
            ticks_left,
        } = at;
        // A client that requests more time than allowed gets a slower clock.
        let ticks = ticks_due.min(*ticks_left);
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
            self.send_mass(actor, mass);
        }
        for refused in realised.refused {
            self.refuse(refused);
        }
        let begun = clock();
        self.report(simulation, lead.runner, options);
        lead.runner.note_reporting(clock().since(begun));
        Ok(())
    }

    /// Sends states, contacts, and the end of the frame.
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
            // Where states use all capacity, only this message shows that time advances.
            (TimeAdvanced::Tcp, _) | (TimeAdvanced::Udp, Transport::Stream) => {
                self.send_queue.lasting(&over);
            }
        }
        self.send_queue.flush(self.states_to);
    }

    /// The next bytes for TCP.
    pub(super) fn poll_bytes(&mut self) -> Option<Bytes> {
        self.send_queue.poll_bytes()
    }
}

/// Tick and limits of a frame.
pub(super) struct FrameAt<'a> {
    pub(super) leader: Peer,
    pub(super) runner: &'a mut SceneRunner,
    pub(super) clock: Stopwatch<'a>,
    pub(super) out: &'a mut Outbox,
    /// Ticks that may pass before other clients get their turn.
    pub(super) ticks_left: &'a mut u32,
}

impl WorldMirror {
    /// Applies all forces of this frame once more for the next tick.
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
            // A static actor is not pushed, whatever its client requests.
            if let Err(error) = lead.command(&command) {
                tracing::debug!(actor = name, %error, "an actor was not pushed");
            }
        }
    }
}
