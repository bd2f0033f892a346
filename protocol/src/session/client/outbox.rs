//! The data that a client sends: control messages in order, and datagrams.
//!
//! Decides nothing. Invariant: a control message leaves before everything that was sent after it.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use bytes::Bytes;

use crate::endpoint::{Peer, Transmit};
use crate::message::ClientMessage;
use crate::scene::Stepping;
use crate::session::close::CloseCode;

/// The output of one connection.
#[derive(Debug)]
pub(super) struct ClientOutbox {
    peer: Peer,
    /// Control bytes that are not in `out` yet.
    unsent: Vec<u8>,
    out: VecDeque<Transmit>,
}

impl ClientOutbox {
    pub(super) const fn new() -> Self {
        Self {
            peer: Peer(0),
            unsent: Vec::new(),
            out: VecDeque::new(),
        }
    }

    /// Names the server.
    pub(super) const fn open(&mut self, peer: Peer) {
        self.peer = peer;
    }

    /// Sends a message.
    pub(super) fn send(&mut self, message: &ClientMessage) {
        message.encode(&mut self.unsent);
    }

    /// Sends framed bytes that are no message of this version.
    pub(super) fn send_framed(&mut self, encode: impl FnOnce(&mut Vec<u8>)) {
        encode(&mut self.unsent);
    }

    /// Sends datagrams.
    pub(super) fn send_states(&mut self, datagrams: Vec<Bytes>) {
        let to = self.peer;
        let states = datagrams.into_iter();
        self.out
            .extend(states.map(|bytes| Transmit::State { to, bytes }));
    }

    /// Sends packets of an upstream: as datagrams, or in lockstep before the advance that needs them.
    pub(super) fn send_upstream(&mut self, stepping: Stepping, packets: Vec<Bytes>) {
        match stepping {
            Stepping::FreeRunning => self.send_states(packets),
            Stepping::Lockstep => {
                for packet in packets {
                    self.send(&ClientMessage::Upstream(packet.to_vec()));
                }
            }
        }
    }

    /// Closes the connection after everything sent so far.
    pub(super) fn close(&mut self, code: CloseCode) {
        self.flush();
        self.out.push_back(Transmit::Close {
            to: self.peer,
            code: code.0,
        });
    }

    /// The next output, oldest first.
    pub(super) fn poll(&mut self) -> Option<Transmit> {
        if self.out.is_empty() {
            self.flush();
        }
        self.out.pop_front()
    }

    fn flush(&mut self) {
        if !self.unsent.is_empty() {
            let bytes = Bytes::from(core::mem::take(&mut self.unsent));
            self.out.push_back(Transmit::Control {
                to: self.peer,
                bytes,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_messages_leave_together_and_before_a_close() {
        let mut outbox = ClientOutbox::new();
        let to = Peer(7);
        outbox.open(to);
        outbox.send(&ClientMessage::Leave);
        outbox.send(&ClientMessage::Delete);
        outbox.close(CloseCode::DONE);
        let mut expected = Vec::new();
        ClientMessage::Leave.encode(&mut expected);
        ClientMessage::Delete.encode(&mut expected);
        let bytes = Bytes::from(expected);
        assert_eq!(outbox.poll(), Some(Transmit::Control { to, bytes }));
        let code = CloseCode::DONE.0;
        assert_eq!(outbox.poll(), Some(Transmit::Close { to, code }));
        assert_eq!(outbox.poll(), None);
    }

    #[test]
    fn an_upstream_goes_on_the_control_stream_in_lockstep_only() {
        for (stepping, is_control) in [(Stepping::Lockstep, true), (Stepping::FreeRunning, false)] {
            let mut outbox = ClientOutbox::new();
            outbox.send_upstream(stepping, alloc::vec![Bytes::from_static(&[1, 2])]);
            let sent = outbox.poll();
            assert_eq!(matches!(sent, Some(Transmit::Control { .. })), is_control);
            assert_eq!(matches!(sent, Some(Transmit::State { .. })), !is_control);
        }
    }
}
