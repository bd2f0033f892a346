//! Outgoing data of all connections: control messages and datagrams.
//!
//! Knows sessions, not scenes. Datagrams are shared: one packet for many members is one allocation.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use bytes::Bytes;
use rhumb_protocol::message::{Grease, ServerMessage};
use rhumb_protocol::session::ServerSession;
use rhumb_protocol::{Peer, Transmit};

/// The sessions of all connections and their outgoing data.
#[derive(Debug, Default)]
pub(crate) struct Outbox {
    sessions: BTreeMap<Peer, ServerSession>,
    /// Connections whose sessions may have data to send.
    sendable: BTreeSet<Peer>,
    ready: VecDeque<Transmit>,
}

impl Outbox {
    pub(crate) fn open(&mut self, peer: Peer, grease: Grease) {
        self.sessions.insert(peer, ServerSession::new(grease));
    }

    pub(crate) fn forget(&mut self, peer: Peer) {
        self.sessions.remove(&peer);
        self.sendable.remove(&peer);
    }

    /// A connection's session; it may have data to send afterwards.
    pub(crate) fn session(&mut self, peer: Peer) -> Option<&mut ServerSession> {
        self.sendable.insert(peer);
        self.sessions.get_mut(&peer)
    }

    pub(crate) fn send(&mut self, to: Peer, message: &ServerMessage) {
        if let Some(session) = self.session(to) {
            session.send(message);
        }
    }

    /// Sends messages that were encoded once for many members.
    pub(crate) fn send_encoded(&mut self, to: Peer, messages: &Bytes) {
        if let Some(session) = self.session(to) {
            session.send_encoded(messages);
        }
    }

    pub(crate) fn datagram(&mut self, to: Peer, bytes: Bytes) {
        self.ready.push_back(Transmit::State { to, bytes });
    }

    pub(crate) fn poll(&mut self) -> Option<Transmit> {
        // Messages go first: datagrams may belong to a stream that they announce.
        while let Some(peer) = self.sendable.first().copied() {
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
            self.sendable.remove(&peer);
        }
        self.ready.pop_front()
    }
}
