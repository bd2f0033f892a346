//! Everything that waits to be sent: what sessions said, and the datagrams.
//!
//! Knows the sessions, not the scenes. Datagrams are shared: one packet for many members is one allocation.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use bytes::Bytes;
use rhumb_protocol::message::{Grease, ServerMessage};
use rhumb_protocol::session::ServerSession;
use rhumb_protocol::{Peer, Transmit};

/// The sessions of a host's connections and what they have to send.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    sessions: BTreeMap<Peer, ServerSession>,
    /// Connections whose sessions may have something to send.
    talking: BTreeSet<Peer>,
    ready: VecDeque<Transmit>,
}

impl Outbox {
    pub(crate) fn open(&mut self, peer: Peer, grease: Grease) {
        self.sessions.insert(peer, ServerSession::new(grease));
    }

    pub(crate) fn forget(&mut self, peer: Peer) {
        self.sessions.remove(&peer);
        self.talking.remove(&peer);
    }

    /// A connection's session, which may have something to send afterwards.
    pub(crate) fn session(&mut self, peer: Peer) -> Option<&mut ServerSession> {
        self.talking.insert(peer);
        self.sessions.get_mut(&peer)
    }

    pub(crate) fn send(&mut self, to: Peer, message: &ServerMessage) {
        if let Some(session) = self.session(to) {
            session.send(message);
        }
    }

    /// Says messages that were encoded once for many.
    pub(crate) fn send_encoded(&mut self, to: Peer, messages: &Bytes) {
        if let Some(session) = self.session(to) {
            session.send_encoded(messages);
        }
    }

    pub(crate) fn datagram(&mut self, to: Peer, bytes: Bytes) {
        self.ready.push_back(Transmit::State { to, bytes });
    }

    pub(crate) fn poll(&mut self) -> Option<Transmit> {
        // What was said goes first: datagrams may be of a stream that it tells of.
        while let Some(peer) = self.talking.first().copied() {
            if let Some(session) = self.sessions.get_mut(&peer) {
                if let Some(bytes) = session.poll_control() {
                    return Some(Transmit::Control { to: peer, bytes });
                }
                if let Some(code) = session.poll_close() {
                    self.forget(peer);
                    return Some(Transmit::Close {
                        to: peer,
                        code: code.0,
                    });
                }
            }
            self.talking.remove(&peer);
        }
        self.ready.pop_front()
    }
}
