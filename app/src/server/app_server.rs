//! All APP clients of one host.
//!
//! A client names its simulation on TCP and, once, by a datagram, which may come first: simulation and address match
//! the two. No state is sent to an address without a logged-on connection.

use core::fmt;
use core::net::{IpAddr, SocketAddr};
use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::Peer;

use super::client::{AppClient, ClientRequest, LogonState};
use super::host::{AppHost, AppOptions, Refusal, RefusedMessage};
use super::send_queue::AppTransmit;
use crate::wire::{Message, SessionError};

/// The APP clients of one host, without sockets. Connections are numbered by the caller.
#[derive(Debug, Default)]
pub struct AppServer {
    options: AppOptions,
    clients: BTreeMap<Peer, AppClient>,
    /// Datagram logons without a logged-on connection yet, oldest first.
    datagram_logons: VecDeque<(u32, SocketAddr)>,
    closing: VecDeque<Peer>,
}

/// Reason for which the server closes a connection.
#[derive(Clone, Copy, Debug, PartialEq)]
enum CloseCause {
    Broken(SessionError),
    /// Another connection owns this simulation.
    Taken,
    /// The engine of its scene failed.
    Faulted,
    NoScene(Refusal),
}

impl fmt::Display for CloseCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Broken(cause) => cause.fmt(f),
            Self::Taken => f.write_str("another connection owns this simulation"),
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

impl AppServer {
    /// A server without clients.
    #[must_use]
    pub fn new(options: AppOptions) -> Self {
        Self {
            options,
            ..Self::default()
        }
    }

    /// A connection was opened.
    pub fn handle_opened(&mut self, peer: Peer, from: SocketAddr) {
        self.clients.insert(peer, AppClient::new(from.ip()));
    }

    /// The next bytes of a connection, cut at any place. `waiting`: cost of the bytes that are queued to it, so that a
    /// slow client is not sent updates that newer ones supersede.
    pub fn handle_bytes(
        &mut self,
        host: &mut dyn AppHost,
        from: Peer,
        bytes: &[u8],
        waiting: usize,
    ) {
        let Some(client) = self.clients.get_mut(&from) else {
            return;
        };
        client.send_queue.note_connection_bytes(waiting);
        // Bytes may still arrive before the connection is closed.
        if client.state == LogonState::Closed {
            return;
        }
        client.session.handle_bytes(bytes);
        if let Err(cause) = self.handle_messages(host, from) {
            tracing::warn!(peer = from.0, %cause, "closing the connection of an app client");
            self.dismiss(host, from);
            self.closing.push_back(from);
        }
    }

    /// A datagram from any address.
    pub fn handle_datagram(&mut self, from: SocketAddr, bytes: &[u8]) {
        // Logons are the only datagrams of clients; others are ignored.
        let Ok(Message::Logon(logon)) = Message::from_datagram(bytes) else {
            return;
        };
        // A client with a destination keeps it, whichever address names its simulation later.
        let waits = |client: &&mut AppClient| {
            client.simulation() == Some(logon.simulation)
                && client.address == from.ip()
                && client.states_to.is_none()
        };
        if let Some(client) = self.clients.values_mut().find(waits) {
            client.states_to = Some(from);
            return;
        }
        if self.datagram_logons.len() >= DATAGRAM_LOGONS_MAX {
            self.datagram_logons.pop_front();
        }
        self.datagram_logons.push_back((logon.simulation, from));
    }

    /// A connection has ended: it carries no further bytes.
    pub fn handle_ended(&mut self, host: &mut dyn AppHost, peer: Peer) {
        self.dismiss(host, peer);
        self.clients.remove(&peer);
    }

    /// The next transmission.
    pub fn poll_transmit(&mut self) -> Option<AppTransmit> {
        for (to, client) in &mut self.clients {
            if let Some(datagram) = client.send_queue.poll_datagram() {
                return Some(AppTransmit::Datagram(datagram));
            }
            if let Some(bytes) = client.send_queue.poll_bytes() {
                return Some(AppTransmit::Bytes { to: *to, bytes });
            }
        }
        let to = self.closing.pop_front()?;
        Some(AppTransmit::Close { to })
    }

    /// Handles every whole message of a client.
    fn handle_messages(&mut self, host: &mut dyn AppHost, peer: Peer) -> Result<(), CloseCause> {
        let mut ticks_left = TICKS_AT_ONCE;
        loop {
            let Some(client) = self.clients.get_mut(&peer) else {
                return Ok(());
            };
            let Some(framed) = client.session.poll_message().map_err(CloseCause::Broken)? else {
                return Ok(());
            };
            match client.handle_message(&framed, host) {
                ClientRequest::Nothing => {}
                ClientRequest::Logon(simulation) => self.log_on(peer, simulation)?,
                ClientRequest::Frame(seconds) => {
                    let options = &self.options;
                    run_frame(
                        client,
                        host,
                        options,
                        peer,
                        framed.index,
                        seconds,
                        &mut ticks_left,
                    )?;
                }
                ClientRequest::Logoff => {
                    tracing::info!(peer = peer.0, "an app client logged off");
                    self.dismiss(host, peer);
                    self.closing.push_back(peer);
                    return Ok(());
                }
            }
        }
    }

    fn log_on(&mut self, peer: Peer, simulation: u32) -> Result<(), CloseCause> {
        let is_other = |(other, client): (&Peer, &AppClient)| {
            *other != peer && client.simulation() == Some(simulation)
        };
        if self.clients.iter().any(is_other) {
            return Err(CloseCause::Taken);
        }
        let ip = self.clients.get(&peer).map(|client| client.address);
        let states_to = ip.and_then(|ip| self.claim_datagram_logon(simulation, ip));
        if let Some(client) = self.clients.get_mut(&peer) {
            client.state = LogonState::LoggedOn(simulation);
            client.states_to = states_to;
            client.send_queue.lasting(&Message::LogonReady(simulation));
            tracing::info!(peer = peer.0, simulation, "an app client logged on");
        }
        Ok(())
    }

    /// Destination of a simulation's states, if its datagram came first; the last one counts.
    fn claim_datagram_logon(&mut self, simulation: u32, ip: IpAddr) -> Option<SocketAddr> {
        let is_its = |(named, from): &(u32, SocketAddr)| *named == simulation && from.ip() == ip;
        let last = self.datagram_logons.iter().copied().rfind(is_its);
        self.datagram_logons.retain(|logon| !is_its(logon));
        last.map(|(_, from)| from)
    }

    /// Ends a client's scene after the client's end.
    fn dismiss(&mut self, host: &mut dyn AppHost, peer: Peer) {
        let Some(client) = self.clients.get_mut(&peer) else {
            return;
        };
        client.state = LogonState::Closed;
        if let Some(scene) = client.scene.take() {
            host.end_scene(&scene.name);
        }
    }
}

/// Runs a frame of a client; its first frame begins its scene.
fn run_frame(
    client: &mut AppClient,
    host: &mut dyn AppHost,
    options: &AppOptions,
    peer: Peer,
    index: u32,
    seconds: f32,
    ticks_left: &mut u32,
) -> Result<(), CloseCause> {
    if client.scene.is_none() {
        match client.begin_scene(host, peer, seconds) {
            Ok(()) => {}
            // The next frame may have another length.
            Err(Refusal::Time) => {
                client.refuse(RefusedMessage::at_once(index, Refusal::Time));
                return Ok(());
            }
            Err(refusal) => return Err(CloseCause::NoScene(refusal)),
        }
    }
    let own = client.scene.as_ref();
    let Some(mut scene) = own.and_then(|own| host.scene(peer, &own.name)) else {
        return Ok(());
    };
    if let Err(refusal) = client.run_frame(seconds, &mut *scene, ticks_left, options) {
        client.refuse(RefusedMessage::at_once(index, refusal));
    }
    if scene.is_faulted() {
        return Err(CloseCause::Faulted);
    }
    Ok(())
}
