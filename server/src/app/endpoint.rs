//! The server loop as the endpoint of APP.

use core::fmt;
use core::net::SocketAddr;

use rhumb_app::{Message, SessionError};
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Peer};
use rhumb_transport::{AppEndpoint, AppTransmit};

use super::guest::{FrameAt, Guest, GuestRequest, GuestScene, GuestState};
use super::refusal::{Refusal, RefusedMessage};
use crate::server_loop::ServerLoop;

/// Reason for which the server closes a connection.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CloseCause {
    Broken(SessionError),
    /// Another connection leads this simulation.
    Taken,
    /// The engine of its scene failed.
    Faulted,
    NoScene(Refusal),
}

impl fmt::Display for CloseCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Broken(cause) => cause.fmt(f),
            Self::Taken => f.write_str("another connection leads this simulation"),
            Self::Faulted => f.write_str("the engine of its scene failed"),
            Self::NoScene(refusal) => refusal.fmt(f),
        }
    }
}

/// Ticks that one read of a client may advance: two seconds of its time. Its plug-in sends eleven frames of six ticks
/// each second.
const TICKS_AT_ONCE: u32 = 135;

/// Datagram logons that are stored.
const DATAGRAM_LOGONS_MAX: usize = 256;

impl ServerLoop {
    /// Handles every whole message of a client.
    fn handle_guest_messages(&mut self, peer: Peer) -> Result<(), CloseCause> {
        let mut ticks_left = TICKS_AT_ONCE;
        loop {
            let Some(guest) = self.guests.guests.get_mut(&peer) else {
                return Ok(());
            };
            let Some(framed) = guest.session.poll_message().map_err(CloseCause::Broken)? else {
                return Ok(());
            };
            match guest.handle_message(&framed) {
                GuestRequest::Nothing => {}
                GuestRequest::Logon(simulation) => self.log_on(peer, simulation)?,
                GuestRequest::Frame(seconds) => {
                    self.pass_frame(peer, framed.index, seconds, &mut ticks_left)?;
                }
                GuestRequest::Logoff => {
                    tracing::info!(peer = peer.0, "an app client logged off");
                    self.dismiss(peer);
                    self.guests.closing.push_back(peer);
                    return Ok(());
                }
            }
        }
    }

    fn log_on(&mut self, peer: Peer, simulation: u32) -> Result<(), CloseCause> {
        if self.guests.is_taken(simulation, peer) {
            return Err(CloseCause::Taken);
        }
        let ip = self.guests.guests.get(&peer).map(|guest| guest.address);
        let states_to = ip.and_then(|ip| self.guests.claim_datagram_logon(simulation, ip));
        if let Some(guest) = self.guests.guests.get_mut(&peer) {
            guest.guest_state = GuestState::Leads(simulation);
            guest.states_to = states_to;
            guest.send_queue.lasting(&Message::LogonReady(simulation));
            tracing::info!(peer = peer.0, simulation, "an app client logged on");
        }
        Ok(())
    }

    fn pass_frame(
        &mut self,
        peer: Peer,
        index: u32,
        seconds: f32,
        ticks_left: &mut u32,
    ) -> Result<(), CloseCause> {
        let Some(guest) = self.guests.guests.get(&peer) else {
            return Ok(());
        };
        if guest.scene.is_none()
            && let Err(refusal) = self.begin_scene(peer, seconds)
        {
            return match refusal {
                // The next frame may have another length.
                Refusal::Time => {
                    if let Some(guest) = self.guests.guests.get_mut(&peer) {
                        guest.refuse(RefusedMessage::at_once(index, refusal));
                    }
                    Ok(())
                }
                _ => Err(CloseCause::NoScene(refusal)),
            };
        }
        let Some(guest) = self.guests.guests.get_mut(&peer) else {
            return Ok(());
        };
        let name = guest.scene.as_ref().map(|scene| &scene.name);
        let Some(runner) = name.and_then(|name| self.runners.get_mut(name)) else {
            return Ok(());
        };
        let at = FrameAt {
            leader: peer,
            runner,
            clock: &self.stopwatch,
            out: &mut self.out,
            ticks_left,
        };
        if let Err(refusal) = guest.frame(seconds, at, &self.guests.options) {
            guest.refuse(RefusedMessage::at_once(index, refusal));
        }
        let name = guest.scene.as_ref().map(|scene| &scene.name);
        let runner = name.and_then(|name| self.runners.get(name));
        if runner.is_some_and(crate::scene_runner::SceneRunner::is_faulted) {
            return Err(CloseCause::Faulted);
        }
        Ok(())
    }

    fn begin_scene(&mut self, peer: Peer, seconds: f32) -> Result<(), Refusal> {
        let Some(guest) = self.guests.guests.get(&peer) else {
            return Ok(());
        };
        // Only a logged-on client has frames.
        let Some(simulation) = guest.simulation() else {
            return Ok(());
        };
        let (config, frame_clock) = guest.config(seconds)?;
        let name: SceneName = format!("app/{simulation}")
            .parse()
            .expect("a number names a scene");
        self.create(&name, config).map_err(Refusal::NoScene)?;
        let runner = self.runners.get_mut(&name);
        let range = runner.and_then(|runner| runner.lead(peer));
        let range = range.ok_or(Refusal::TooMany)?;
        if let Some(guest) = self.guests.guests.get_mut(&peer) {
            guest.scene = Some(GuestScene {
                name,
                simulation,
                range,
                frame_clock,
            });
        }
        Ok(())
    }

    /// Removes a client's scene after its end.
    fn dismiss(&mut self, peer: Peer) {
        let Some(guest) = self.guests.guests.get_mut(&peer) else {
            return;
        };
        guest.guest_state = GuestState::Parted;
        if let Some(scene) = guest.scene.take() {
            self.end_scene(&scene.name);
        }
    }
}

impl AppEndpoint for ServerLoop {
    fn handle_app_opened(&mut self, _now: Instant, peer: Peer, from: SocketAddr) {
        self.guests.guests.insert(peer, Guest::new(from.ip()));
    }

    fn handle_app_waiting(&mut self, _now: Instant, peer: Peer, bytes: usize) {
        if let Some(guest) = self.guests.guests.get_mut(&peer) {
            guest.send_queue.note_connection_bytes(bytes);
        }
    }

    fn handle_app_bytes(&mut self, _now: Instant, from: Peer, bytes: &[u8]) {
        let Some(guest) = self.guests.guests.get_mut(&from) else {
            return;
        };
        // Bytes may still arrive before the connection is closed.
        if guest.guest_state == GuestState::Parted {
            return;
        }
        guest.session.handle_bytes(bytes);
        if let Err(cause) = self.handle_guest_messages(from) {
            tracing::warn!(peer = from.0, %cause, "closing the connection of an app client");
            self.dismiss(from);
            self.guests.closing.push_back(from);
        }
    }

    fn handle_app_datagram(&mut self, _now: Instant, from: SocketAddr, bytes: &[u8]) {
        // Logons are the only datagrams of clients; others are ignored.
        let Ok(Message::Logon(logon)) = Message::from_datagram(bytes) else {
            return;
        };
        // A client with a destination keeps it, whichever address names its simulation later.
        let waits = |guest: &&mut Guest| {
            guest.simulation() == Some(logon.simulation)
                && guest.address == from.ip()
                && guest.states_to.is_none()
        };
        if let Some(guest) = self.guests.guests.values_mut().find(waits) {
            guest.states_to = Some(from);
            return;
        }
        if self.guests.unassigned.len() >= DATAGRAM_LOGONS_MAX {
            self.guests.unassigned.pop_front();
        }
        self.guests.unassigned.push_back((logon.simulation, from));
    }

    fn handle_app_ended(&mut self, _now: Instant, peer: Peer) {
        self.dismiss(peer);
        self.guests.guests.remove(&peer);
    }

    fn poll_app(&mut self) -> Option<AppTransmit> {
        for (to, guest) in &mut self.guests.guests {
            if let Some((to, bytes)) = guest.send_queue.poll_datagram() {
                return Some(AppTransmit::Datagram { to, bytes });
            }
            if let Some(bytes) = guest.poll_bytes() {
                return Some(AppTransmit::Bytes { to: *to, bytes });
            }
        }
        let to = self.guests.closing.pop_front()?;
        Some(AppTransmit::Close { to })
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};
    use rhumb_app::Logon;
    use rhumb_protocol::message::RemovalCause;
    use rhumb_protocol::scene::{Joint, JointId, Shape, ShapeId};
    use rhumb_protocol::stream::Observation;
    use rhumb_reckoning::{BodyId, Inertia, Twist};

    use super::*;
    use crate::engine::{Contact, Engine, EngineFault, NewBody, Push, UnusableShape};
    use crate::scene::Scene;
    use crate::scene_runner::SceneRunner;
    use crate::stream_names::StreamNames;

    /// An engine that fails in its first step.
    struct Failing;

    impl Engine for Failing {
        fn add_shape(&mut self, _: ShapeId, _: &Shape) -> Result<(), UnusableShape> {
            Ok(())
        }

        fn remove_shape(&mut self, _: ShapeId) {}
        fn add_joint(&mut self, _: JointId, _: &Joint) {}
        fn remove_joint(&mut self, _: JointId) {}
        fn add(&mut self, _: &NewBody) {}
        fn remove(&mut self, _: BodyId) {}
        fn set_pose(&mut self, _: BodyId, _: Vec3, _: Quat) {}
        fn set_velocity(&mut self, _: BodyId, _: Twist) {}
        fn push(&mut self, _: BodyId, _: Push) {}
        fn set_gravity(&mut self, _: Vec3) {}

        fn step(&mut self, _: &mut Vec<(BodyId, RemovalCause)>) -> Result<(), EngineFault> {
            Err(EngineFault::Panicked)
        }

        fn observe(&self, _: &mut Vec<Observation>) {}

        fn observe_one(&self, _: BodyId) -> Option<Observation> {
            None
        }

        fn inertia(&self, _: BodyId) -> Option<Inertia> {
            None
        }

        fn contacts(&self, _: BodyId, _: &mut Vec<Contact>) {}

        fn awake_count(&self) -> usize {
            0
        }

        fn fault(&self) -> Option<EngineFault> {
            None
        }
    }

    const NOW: Instant = Instant::ZERO;
    const FRAME: Message = Message::AdvanceTime((7, 0.089));

    fn send(server_loop: &mut ServerLoop, peer: Peer, message: &Message) {
        let mut bytes = Vec::new();
        message.encode(0, &mut bytes);
        server_loop.handle_app_bytes(NOW, peer, &bytes);
    }

    /// Connects a client that logs on and sends a frame.
    fn begin(server_loop: &mut ServerLoop, peer: Peer) {
        let from = SocketAddr::from(([127, 0, 0, 1], 40_000));
        server_loop.handle_app_opened(NOW, peer, from);
        send(server_loop, peer, &Message::Logon(Logon::new(7, "x")));
        send(server_loop, peer, &FRAME);
    }

    /// Connections that the server closes, of all its transmissions.
    fn closed(server_loop: &mut ServerLoop) -> Vec<Peer> {
        let transmits = core::iter::from_fn(|| server_loop.poll_app());
        let away = transmits.filter_map(|transmit| match transmit {
            AppTransmit::Close { to } => Some(to),
            _ => None,
        });
        away.collect()
    }

    #[test]
    fn an_engine_fault_closes_the_leading_client_which_may_return() {
        let mut server_loop = ServerLoop::new(|| NOW);
        let [first, second] = [1, 2].map(Peer);
        begin(&mut server_loop, first);
        assert_eq!(closed(&mut server_loop), []);
        let (_, runner) = server_loop.runners.iter_mut().next().expect("its scene");
        let broken = Scene::with_engine(*runner.config(), Box::new(Failing)).expect("same config");
        *runner = SceneRunner::new(broken, StreamNames::of_scene(0));
        assert!(runner.lead(first).is_some());
        send(&mut server_loop, first, &FRAME);
        assert_eq!(closed(&mut server_loop), [first]);
        assert_eq!(server_loop.scenes().count(), 0);
        // The old connection is still closing when the client comes again.
        begin(&mut server_loop, second);
        send(&mut server_loop, second, &FRAME);
        assert_eq!(closed(&mut server_loop), []);
        assert_eq!(server_loop.scenes().count(), 1);
    }
}
