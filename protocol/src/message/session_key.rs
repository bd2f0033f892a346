//! Sessions: a client's place in its order of commands, across connections.
//!
//! The client draws the key; a scene keeps what it needs to take up the session again.

use core::fmt;

use rhumb_reckoning::Tick;

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Names a session of one scene. It is secret: a client that knows it may take the session over.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionKey(pub [u8; 16]);

impl fmt::Debug for SessionKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SessionKey")
    }
}

/// A client's request to begin a session with its next join, or to take up the one of that key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionRequest {
    /// Its key.
    pub key: SessionKey,
    /// Commands of the session that the client knows to be done: no earlier refusal is repeated.
    pub answered: u64,
}

/// Where a session goes on; sent before the answer to the join.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SessionState {
    /// True if the scene knows the session; otherwise it has just begun.
    pub resumed: bool,
    /// True if the scene has a command log, so that `Durable` is sent.
    pub durable: bool,
    /// Commands of the session that were applied or refused; the next one has this number.
    pub commands: u64,
    /// The tick at which the scene goes on. After a restart of the server it may be earlier than the last one sent.
    pub tick: Tick,
}

impl Wire for SessionKey {
    fn encode(&self, to: &mut Writer) {
        to.raw(&self.0);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let bytes = from.raw(16)?;
        bytes.try_into().map(Self).map_err(|_| Malformed::Truncated)
    }
}

impl Wire for SessionRequest {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.answered);
        self.key.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let answered = from.count()?;
        let key = SessionKey::decode(from)?;
        Ok(Self { key, answered })
    }
}

/// Bits of a session's first byte.
mod flag {
    pub(super) const RESUMED: u8 = 1;
    pub(super) const DURABLE: u8 = 2;
}

impl Wire for SessionState {
    fn encode(&self, to: &mut Writer) {
        let resumed = if self.resumed { flag::RESUMED } else { 0 };
        let durable = if self.durable { flag::DURABLE } else { 0 };
        to.u8(resumed | durable);
        to.varint(self.commands);
        to.varint(self.tick.value());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags > flag::RESUMED | flag::DURABLE {
            return Err(Malformed::UnknownCode);
        }
        Ok(Self {
            resumed: flags & flag::RESUMED != 0,
            durable: flags & flag::DURABLE != 0,
            commands: from.count()?,
            tick: Tick::new(from.count()?),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_state_round_trips_and_its_flags_are_known() {
        let state = SessionState {
            resumed: true,
            durable: false,
            commands: 300,
            tick: Tick::new(7),
        };
        let mut writer = Writer::new();
        state.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(bytes, [1, 0xac, 2, 7]);
        assert_eq!(SessionState::decode(&mut Reader::new(&bytes)), Ok(state));
        let unknown = SessionState::decode(&mut Reader::new(&[4, 0, 0]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
        for cut in 0..bytes.len() {
            let cut = SessionState::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn a_key_is_not_printed() {
        assert_eq!(alloc::format!("{:?}", SessionKey([7; 16])), "SessionKey");
    }
}
