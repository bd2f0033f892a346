//! One APP client, and the scene that it has.
//!
//! Handles its messages, applies them at its frames, and reports the results. Its scene is named `app/` with the
//! number of its simulation; it begins with the first frame and ends with the client.
//!
//! A frame is a binary32 of seconds; a scene's tick is a ratio. The first frame decides: its simplest ratio, cut into
//! as few ticks as keep each at a sixtieth of a second or less. Later frames of another length yield whole ticks; the
//! remainder is carried over.

use core::fmt;
use core::net::{IpAddr, SocketAddr};
use core::num::NonZeroU32;
use std::sync::Arc;

use glam::Vec3;
use rhumb_client::{ClientError, OpenError};
use rhumb_protocol::scene::{
    BodyKind, Command, PublishSchedule, SceneConfig, SceneName, Sleep, Stepping,
};
use rhumb_reckoning::{Damping, Integrator, Rate};

use crate::codec::{HEADER_BYTES, Id};
use crate::gateway::Gateway;
use crate::gateway::{Refusal, RefusedMessage, TimeAdvanced};
use crate::message::{ErrorReport, FramedMessage, Message, Session, SessionError};
use crate::scene::OwnScene;
use crate::send_queue::{AppTransmit, SendQueue};
use crate::state_reporter::{FrameOutput, ReportOptions, StateReporter, Transport};
use crate::world_mirror::{ActorPush, MATERIAL, Reply, WorldMirror};

/// An APP client. Dropping it ends its scene.
pub struct AppClient {
    gateway: Arc<Gateway>,
    /// Its name in the log.
    number: u64,
    session: Session,
    address: IpAddr,
    state: LogonState,
    /// Its scene, from its first frame on.
    scene: Option<ClientScene>,
    mirror: WorldMirror,
    reporter: StateReporter,
    send_queue: SendQueue,
    /// Refusals reported since the last frame.
    refusals: u32,
}

/// Progress of a client's session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LogonState {
    /// Not logged on.
    Connected,
    /// Logged on with this simulation, which no other client has.
    LoggedOn(u32),
    /// Closed or logged off: its bytes are ignored, and it has no scene. The connection is to be closed.
    Closing,
    /// The connection was closed.
    Closed,
}

/// A client's scene.
struct ClientScene {
    scene: OwnScene,
    frame_clock: FrameClock,
}

/// Reason for which the gateway closes a connection.
#[derive(Debug)]
enum CloseCause {
    Broken(SessionError),
    /// Another connection has this simulation.
    Taken,
    /// The scene has ended: its server or its engine failed, or it was quarantined.
    Ended(ClientError),
    NoScene(OpenError),
}

impl fmt::Display for CloseCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Broken(cause) => cause.fmt(f),
            Self::Taken => f.write_str("another connection owns this simulation"),
            Self::Ended(cause) => write!(f, "its scene has ended: {cause}"),
            Self::NoScene(cause) => write!(f, "no scene is available: {cause}"),
        }
    }
}

/// Reason of a frame that was not run.
enum FrameError {
    Refused(Refusal),
    Ended(ClientError),
}

impl From<ClientError> for FrameError {
    fn from(cause: ClientError) -> Self {
        Self::Ended(cause)
    }
}

/// Ticks that one read of a client may advance: two seconds of its time. Its plug-in sends eleven frames of six ticks
/// each second.
const TICKS_AT_ONCE: u32 = 135;
/// Refusals that are reported and logged between two frames, each by itself; of more the log has the number.
const REFUSALS_MAX: u32 = 16;
/// Bytes of a state.
const STATE_BYTES: usize = HEADER_BYTES + 64;
/// The defaults of the paper's engine.
const DAMPING: Damping = Damping {
    linear: 0.0,
    angular: 0.05,
};
const SUBSTEPS: NonZeroU32 = NonZeroU32::new(4).expect("four is not zero");

impl AppClient {
    /// A client that has connected from an address. `number` names it in the log.
    #[must_use]
    pub fn new(gateway: &Arc<Gateway>, number: u64, from: SocketAddr) -> Self {
        Self {
            gateway: Arc::clone(gateway),
            number,
            session: Session::default(),
            address: from.ip(),
            state: LogonState::Connected,
            scene: None,
            mirror: WorldMirror::default(),
            reporter: StateReporter::default(),
            send_queue: SendQueue::default(),
            refusals: 0,
        }
    }

    /// The next bytes of its connection, cut at any place. `waiting`: cost of the bytes that are queued to it, so that a
    /// slow client is not sent updates that newer ones supersede.
    pub fn handle_bytes(&mut self, bytes: &[u8], waiting: usize) {
        self.send_queue.note_connection_bytes(waiting);
        // Bytes may still arrive before the connection is closed.
        if self.is_over() {
            return;
        }
        self.session.handle_bytes(bytes);
        if let Err(cause) = self.handle_messages() {
            self.close(&cause);
        }
    }

    /// Some time has passed without bytes: a scene that has ended is noticed.
    pub fn handle_silence(&mut self) {
        if let Some(ClientScene { scene, .. }) = &mut self.scene
            && let Err(cause) = scene.poll()
        {
            self.close(&CloseCause::Ended(cause));
        }
    }

    /// The next transmission.
    pub fn poll_transmit(&mut self) -> Option<AppTransmit> {
        if let Some(datagram) = self.send_queue.poll_datagram() {
            return Some(AppTransmit::Datagram(datagram));
        }
        if let Some(bytes) = self.send_queue.poll_bytes() {
            return Some(AppTransmit::Bytes(bytes));
        }
        (self.state == LogonState::Closing).then(|| {
            self.state = LogonState::Closed;
            AppTransmit::Close
        })
    }

    const fn is_over(&self) -> bool {
        matches!(self.state, LogonState::Closing | LogonState::Closed)
    }

    fn close(&mut self, cause: &CloseCause) {
        let peer = self.number;
        tracing::warn!(peer, %cause, "closing the connection of an app client");
        self.dismiss();
    }

    /// Ends the client's scene, and has its connection closed.
    fn dismiss(&mut self) {
        if let Some(ClientScene { scene, .. }) = self.scene.take() {
            scene.end();
        }
        if let Some(simulation) = self.simulation() {
            self.gateway.free(simulation);
        }
        self.state = LogonState::Closing;
    }

    /// Handles every whole message.
    fn handle_messages(&mut self) -> Result<(), CloseCause> {
        let mut ticks_left = TICKS_AT_ONCE;
        while let Some(framed) = self.session.poll_message().map_err(CloseCause::Broken)? {
            match framed.message {
                Message::Logon(logon) => self.log_on(logon.simulation)?,
                Message::Logoff(_) => {
                    tracing::info!(peer = self.number, "an app client logged off");
                    self.dismiss();
                    return Ok(());
                }
                Message::AdvanceTime((_, seconds)) => {
                    self.begin_frame(framed.index, seconds, &mut ticks_left)?;
                }
                _ => self.handle_message(&framed),
            }
        }
        Ok(())
    }

    fn log_on(&mut self, simulation: u32) -> Result<(), CloseCause> {
        let taken = self.gateway.take(simulation, self.address);
        taken.map_err(|_| CloseCause::Taken)?;
        self.state = LogonState::LoggedOn(simulation);
        self.send_queue.lasting(&Message::LogonReady(simulation));
        tracing::info!(peer = self.number, simulation, "an app client logged on");
        Ok(())
    }

    /// Handles a message about its world.
    fn handle_message(&mut self, framed: &FramedMessage) {
        match self.mirror.handle_message(framed) {
            Ok(Reply::Nothing) => {}
            Ok(Reply::Mass(mass)) => {
                if let Message::GetMass(id) = framed.message {
                    self.send_mass(id.object, mass);
                }
            }
            Err(refusal) => self.refuse(RefusedMessage::at_once(framed.index, refusal)),
        }
    }

    /// The simulation of a logged-on client.
    const fn simulation(&self) -> Option<u32> {
        match self.state {
            LogonState::LoggedOn(simulation) => Some(simulation),
            LogonState::Connected | LogonState::Closing | LogonState::Closed => None,
        }
    }

    fn send_mass(&mut self, object: u32, mass: f32) {
        // A client that is not logged on has requested nothing.
        let Some(simulation) = self.simulation() else {
            return;
        };
        let actor = Id { simulation, object };
        self.send_queue.lasting(&Message::UpdateMass((actor, mass)));
    }

    /// Reports a refused message to the log and to its sender; the published plug-in ignores the report.
    fn refuse(&mut self, refused: RefusedMessage) {
        self.refusals = self.refusals.saturating_add(1);
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

    /// Runs a frame; the first one begins the scene.
    fn begin_frame(
        &mut self,
        index: u32,
        seconds: f32,
        ticks_left: &mut u32,
    ) -> Result<(), CloseCause> {
        // Only a logged-on client has frames.
        let Some(simulation) = self.simulation() else {
            return Ok(());
        };
        if self.scene.is_none() {
            let Some(frame_clock) = FrameClock::of_frame(seconds) else {
                // The next frame may have another length.
                self.refuse(RefusedMessage::at_once(index, Refusal::Time));
                return Ok(());
            };
            self.begin_scene(simulation, frame_clock)
                .map_err(CloseCause::NoScene)?;
        }
        match self.run_frame(simulation, seconds, ticks_left) {
            Ok(()) => {}
            Err(FrameError::Refused(refusal)) => {
                self.refuse(RefusedMessage::at_once(index, refusal));
            }
            Err(FrameError::Ended(cause)) => return Err(CloseCause::Ended(cause)),
        }
        Ok(())
    }

    fn begin_scene(&mut self, simulation: u32, frame_clock: FrameClock) -> Result<(), OpenError> {
        let name: SceneName = format!("app/{simulation}")
            .parse()
            .expect("a number names a scene");
        let config = self.config(&frame_clock);
        let scene = OwnScene::begin(self.gateway.connect()?, &name, config)?;
        self.scene = Some(ClientScene { scene, frame_clock });
        Ok(())
    }

    fn config(&self, frame_clock: &FrameClock) -> SceneConfig {
        SceneConfig {
            integrator: Integrator {
                rate: frame_clock.rate(),
                substeps: SUBSTEPS,
            },
            gravity: self.mirror.gravity.unwrap_or(Vec3::ZERO),
            stepping: Stepping::Lockstep,
            material: MATERIAL,
            damping: DAMPING,
            sleep: Sleep::Settled,
            publish_schedule: PublishSchedule::EACH_TICK,
        }
    }

    /// Runs a frame: applies the messages since the last one, advances time, and reports the results. `ticks_left`: how
    /// many ticks may pass before the next bytes are read.
    fn run_frame(
        &mut self,
        simulation: u32,
        seconds: f32,
        ticks_left: &mut u32,
    ) -> Result<(), FrameError> {
        let refused = FrameError::Refused;
        let Some(ClientScene { scene, frame_clock }) = &mut self.scene else {
            return Ok(());
        };
        let ticks_due = frame_clock.ticks(seconds).ok_or(refused(Refusal::Time))?;
        // A client that requests more time than allowed gets a slower clock.
        let ticks = ticks_due.min(*ticks_left);
        *ticks_left -= ticks;
        let more = std::mem::take(&mut self.refusals).saturating_sub(REFUSALS_MAX);
        if more > 0 {
            tracing::warn!(
                simulation,
                more,
                "further messages of an app client were not done"
            );
        }
        if let Some(gravity) = self.mirror.gravity
            && scene.gravity() != gravity
        {
            let changed = scene.command(&Command::SetGravity { gravity });
            changed.map_err(|error| refused(error.into()))?;
        }
        let mut result = self.mirror.apply(scene);
        let steps = scene.advance(ticks, &self.mirror.pushes(), self.mirror.reports)?;
        self.reporter.note_contacts(&self.mirror, &steps);
        if ticks > 0 {
            self.mirror.pushes.clear();
        } else {
            scene.poll()?;
        }
        self.mirror.take_back(scene, &mut result);
        for (actor, mass) in result.masses {
            self.send_mass(actor, mass);
        }
        for refused in result.refused {
            self.refuse(refused);
        }
        self.report(simulation);
        Ok(())
    }

    /// Sends states, contacts, and the end of the frame.
    fn report(&mut self, simulation: u32) {
        let Some(ClientScene { scene, .. }) = &self.scene else {
            return;
        };
        let options = &self.gateway.options;
        let states_to: Option<SocketAddr> = self.gateway.states_to(simulation);
        let report = ReportOptions {
            states: options.states,
            transport: match states_to {
                Some(_) => Transport::Datagrams,
                None => Transport::Stream,
            },
            capacity: self.send_queue.capacity() / STATE_BYTES,
        };
        let mut output = FrameOutput::default();
        self.reporter.forget(&self.mirror.take_gone());
        self.reporter
            .report(simulation, &report, &self.mirror, scene, &mut output);
        let over = Message::TimeAdvanced(simulation);
        for message in &output.passing {
            self.send_queue
                .passing(message, states_to, options.datagrams);
        }
        for message in &output.lasting {
            self.send_queue.lasting(message);
        }
        match (options.time_advanced, report.transport) {
            (TimeAdvanced::Never, _) => {}
            (TimeAdvanced::Udp, Transport::Datagrams) => {
                self.send_queue.passing(&over, states_to, options.datagrams);
            }
            // If states use all capacity, only this message shows that time advances.
            (TimeAdvanced::Tcp, _) | (TimeAdvanced::Udp, Transport::Stream) => {
                self.send_queue.lasting(&over);
            }
        }
        self.send_queue.flush(states_to);
    }
}

impl Drop for AppClient {
    fn drop(&mut self) {
        self.dismiss();
    }
}

impl WorldMirror {
    /// The forces of this frame, which act in each of its ticks. A static actor is not pushed, whatever its client
    /// requests.
    fn pushes(&self) -> Vec<Command> {
        let pushes = self.pushes.iter().filter_map(|(name, push)| {
            let actor = self.actors.get(name)?;
            let id = actor.body.filter(|_| actor.kind == BodyKind::Dynamic)?.id;
            Some(match *push {
                ActorPush::Force(force) => Command::Force { id, force },
                ActorPush::Torque(torque) => Command::Torque { id, torque },
            })
        });
        pushes.collect()
    }
}

/// Ticks for frames.
#[derive(Clone, Copy, Debug)]
struct FrameClock {
    rate: Rate,
    /// Seconds of frames that are not yet converted to ticks.
    carried: f64,
}

/// The longest frame, seconds.
const FRAME_MAX: f32 = 1.0;
/// The shortest frame, seconds: a tick of a thousand a second.
const FRAME_MIN: f32 = 1e-3;
/// Least tick rate that a frame is cut into.
const TICKS_PER_SECOND: f64 = 60.0;
/// Share of a tick that rounding may leave.
const SLACK: f64 = 1e-3;

impl FrameClock {
    /// A clock for a client with this first frame; `None` if its time is zero, too long, or not a ratio of small
    /// numbers.
    fn of_frame(seconds: f32) -> Option<Self> {
        if !(FRAME_MIN..=FRAME_MAX).contains(&seconds) {
            return None;
        }
        let (over, under) = simplest(seconds)?;
        let length = f64::from(over) / f64::from(under);
        let ticks = (length * TICKS_PER_SECOND - SLACK).ceil().max(1.0) as u32;
        let common = gcd(ticks.checked_mul(under)?, over);
        let rate = Rate::new(ticks * under / common, over / common)?;
        Some(Self { rate, carried: 0.0 })
    }

    /// Tick rate of the scene.
    const fn rate(&self) -> Rate {
        self.rate
    }

    /// The ticks of a frame; `None` for a frame of zero time or too long.
    fn ticks(&mut self, seconds: f32) -> Option<u32> {
        if !(0.0..=FRAME_MAX).contains(&seconds) {
            return None;
        }
        let tick = self.rate.step().seconds();
        let carried = self.carried + f64::from(seconds);
        let ticks = (carried / tick + SLACK).floor();
        self.carried = carried - ticks * tick;
        Some(ticks as u32)
    }
}

/// The simplest ratio that rounds to a binary32, if its numbers are small.
fn simplest(value: f32) -> Option<(u32, u32)> {
    // The convergents of its continued fraction, one after the other.
    let mut rest = f64::from(value);
    let (mut before, mut now) = ((0_u64, 1_u64), (1_u64, 0_u64));
    for _ in 0..32 {
        let integer = rest.floor();
        let next = |before: u64, now: u64| (integer as u64).checked_mul(now)?.checked_add(before);
        let convergent = (next(before.0, now.0)?, next(before.1, now.1)?);
        if convergent.1 > 1_000_000 {
            return None;
        }
        if convergent.0 > 0 && (convergent.0 as f64 / convergent.1 as f64) as f32 == value {
            return Some((convergent.0 as u32, convergent.1 as u32));
        }
        (before, now) = (now, convergent);
        let fraction = rest - integer;
        if fraction <= 0.0 {
            return None;
        }
        rest = 1.0 / fraction;
    }
    None
}

const fn gcd(mut a: u32, mut b: u32) -> u32 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame_clock(seconds: f32) -> FrameClock {
        FrameClock::of_frame(seconds).expect("a frame")
    }

    #[test]
    fn common_frames_get_their_intended_ratios() {
        for (seconds, ticks, over) in [
            (1.0 / 60.0, 60, 1),
            (0.089, 6_000, 89),
            (0.0909, 20_000, 303),
            (1.0 / 11.33, 3_399, 50),
            (0.5, 60, 1),
            (1.0 / 120.0, 120, 1),
        ] {
            assert_eq!(
                frame_clock(seconds).rate(),
                Rate::new(ticks, over).unwrap(),
                "{seconds}"
            );
        }
    }

    #[test]
    fn every_frame_of_the_same_length_has_as_many_ticks() {
        for (seconds, ticks) in [(1.0 / 60.0, 1), (0.089, 6), (1.0 / 11.33, 6), (0.5, 30)] {
            let mut frame_clock = frame_clock(seconds);
            for _ in 0..10_000 {
                assert_eq!(frame_clock.ticks(seconds), Some(ticks));
            }
        }
    }

    #[test]
    fn the_remainder_of_other_frames_is_carried_over() {
        let mut frame_clock = frame_clock(0.089);
        let sum: u32 = (0..1_000).map(|_| frame_clock.ticks(0.1).unwrap()).sum();
        assert_eq!(sum, 6_741);
    }

    #[test]
    fn zero_and_excessive_times_are_refused() {
        for seconds in [0.0, -1.0, 1.5, f32::NAN, f32::INFINITY, 1e-9] {
            assert!(FrameClock::of_frame(seconds).is_none(), "{seconds}");
        }
        assert_eq!(frame_clock(0.1).ticks(f32::NAN), None);
        assert_eq!(frame_clock(0.1).ticks(2.0), None);
        assert_eq!(frame_clock(0.1).ticks(0.0), Some(0));
    }
}
