//! The record of a scene's run: its entries and their bytes.
//!
//! One form of entries serves rollback, command log, flight recorder and replay. A scene keeps those that a rollback
//! or its command log needs; a flight recorder keeps the bytes of the newest. One entry follows another without gaps in
//! a frame of the log. Reading never panics. Sessions are named by their number in the log, which is given once.

use std::collections::BTreeMap;

use rhumb_protocol::limits::LONG_MESSAGE_BYTES_MAX;
use rhumb_protocol::message::SessionKey;
use rhumb_protocol::scene::{Command, CommandError, IdRange, ShapeId};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::Tick;

use crate::permit::{ClientName, Ownership, decode_client, decode_client_of, encode_client_of};

/// Number of a session in the log of its scene; not used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SessionNumber(pub u32);

/// One entry. Those from `Joined` on explain a run; a replay passes over them.
#[derive(Clone, Debug, PartialEq)]
pub enum LogEntry {
    /// A command changed the scene, whatever its source: a member, an upstream, a script or a hook.
    Applied(Box<AppliedCommand>),
    /// A step; the digest of all observations after it.
    Stepped(u64),
    /// A session of a client begins.
    Opened(Box<OpenedSession>),
    /// A session has more body indices.
    Granted(SessionNumber, IdRange),
    /// A numbered command of a session is done. One that was applied follows its `Applied`.
    Counted(SessionNumber, Option<CommandError>),
    /// A session is over; its indices are free.
    Closed(SessionNumber),
    /// A client became a member; its name, if it showed a token.
    Joined(Peer, Option<ClientName>),
    /// A member left, or its connection ended.
    Left(Peer),
    /// A command of a member is about to be checked and applied.
    Received(Box<ReceivedCommand>),
    /// The last command was refused.
    Refused(CommandError),
    /// A step begins at a moment, from a tick: the last entry of a scene whose step never ends.
    StepBegan(Instant, Tick),
    /// A step and its publication have ended.
    Measured(Box<TickMetrics>),
    /// A packet of the tick, for all members of its stream.
    Packet(PacketHead),
}

/// A command that changed the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct AppliedCommand {
    /// The command.
    pub command: Command,
    /// The client that owns what it adds. Bytes have it only where the owners of a scene change.
    pub client: Option<ClientName>,
    /// The member that gave it. Bytes lack it: a connection ends with its process.
    pub author: Option<Author>,
}

/// The member whose command it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Author {
    /// The member.
    pub member: Peer,
    /// The member's number of the command.
    pub number: u64,
}

/// A session that begins.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenedSession {
    /// Its number.
    pub number: SessionNumber,
    /// Names it to its client.
    pub key: SessionKey,
    /// Its client; `None` without a token.
    pub client: Option<ClientName>,
}

/// A command as it arrived.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceivedCommand {
    /// Its member.
    pub member: Peer,
    /// The member's number of it.
    pub number: u64,
    /// Bytes of the whole command.
    pub length: u32,
    /// Its first bytes, as they are on the wire: at most [`COMMAND_BYTES_KEPT`].
    pub bytes: Vec<u8>,
}

/// The first bytes of a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PacketHead {
    /// Bytes of the whole packet.
    pub length: u32,
    bytes: [u8; HEAD_BYTES_KEPT],
}

/// The metrics of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickMetrics {
    /// The tick.
    pub tick: Tick,
    /// Members of the scene.
    pub members: usize,
    /// Bodies in the scene.
    pub bodies: usize,
    /// Bodies awake after the step.
    pub awake: usize,
    /// Bodies whose updates wait for the budget of a stream.
    pub waiting: usize,
    /// Body steps in a second that the scene has reserved.
    pub load: u64,
    /// Duration of the step.
    pub step: Span,
    /// Duration of everything after the step.
    pub publish: Span,
}

/// Bytes that are kept of a command that arrived; of longer ones, such as meshes, only the beginning.
pub const COMMAND_BYTES_KEPT: usize = 256;
/// Bytes that are kept of a packet.
const HEAD_BYTES_KEPT: usize = 8;

impl PacketHead {
    /// The head of a packet.
    #[must_use]
    pub fn of(packet: &[u8]) -> Self {
        let mut bytes = [0; HEAD_BYTES_KEPT];
        let kept = packet.len().min(HEAD_BYTES_KEPT);
        bytes[..kept].copy_from_slice(&packet[..kept]);
        Self {
            length: u32::try_from(packet.len()).unwrap_or(u32::MAX),
            bytes,
        }
    }

    /// The bytes that are kept.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &self.bytes[..(self.length as usize).min(HEAD_BYTES_KEPT)]
    }
}

mod kind {
    pub(super) const APPLIED: u8 = 1;
    pub(super) const STEPPED: u8 = 2;
    pub(super) const OPENED: u8 = 3;
    pub(super) const GRANTED: u8 = 4;
    pub(super) const COUNTED: u8 = 5;
    pub(super) const REFUSED: u8 = 6;
    pub(super) const CLOSED: u8 = 7;
    /// Applied, with the client that owns what it adds.
    pub(super) const OWNED: u8 = 8;
    pub(super) const JOINED: u8 = 9;
    pub(super) const LEFT: u8 = 10;
    pub(super) const RECEIVED: u8 = 11;
    pub(super) const NOT_APPLIED: u8 = 12;
    pub(super) const STEP_BEGAN: u8 = 13;
    pub(super) const MEASURED: u8 = 14;
    pub(super) const PACKET: u8 = 15;
}

impl LogEntry {
    /// A session of a client begins; `None` without a token.
    #[must_use]
    pub fn opened(number: SessionNumber, key: SessionKey, client: Option<ClientName>) -> Self {
        let opened = OpenedSession {
            number,
            key,
            client,
        };
        Self::Opened(opened.into())
    }

    /// Reads every entry of a frame.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for bytes that are no entries of this version.
    pub fn decode_all(bytes: &[u8]) -> Result<Vec<Self>, Malformed> {
        let mut from = Reader::new(bytes);
        let mut entries = Vec::new();
        while !from.rest().is_empty() {
            entries.push(Self::decode(&mut from)?);
        }
        Ok(entries)
    }

    /// True for an entry that changes the truth of a scene.
    pub(crate) const fn is_change(&self) -> bool {
        matches!(self, Self::Applied(_) | Self::Stepped(_))
    }
}

impl Wire for SessionNumber {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.0));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        from.varint32().map(Self)
    }
}

impl Wire for LogEntry {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Applied(applied) => applied.encode(to),
            Self::Stepped(digest) => {
                to.u8(kind::STEPPED);
                to.raw(&digest.to_le_bytes());
            }
            Self::Opened(opened) => {
                to.u8(kind::OPENED);
                opened.number.encode(to);
                opened.key.encode(to);
                encode_client_of(opened.client.as_ref(), to);
            }
            Self::Granted(number, range) => {
                to.u8(kind::GRANTED);
                number.encode(to);
                range.encode(to);
            }
            Self::Counted(number, None) => {
                to.u8(kind::COUNTED);
                number.encode(to);
            }
            Self::Counted(number, Some(error)) => {
                to.u8(kind::REFUSED);
                number.encode(to);
                error.encode(to);
            }
            Self::Closed(number) => {
                to.u8(kind::CLOSED);
                number.encode(to);
            }
            explains => explains.encode_explanation(to),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            kind::APPLIED => Self::Applied(AppliedCommand::decode(None, from)?.into()),
            kind::OWNED => {
                let client = decode_client(from)?;
                Self::Applied(AppliedCommand::decode(Some(client), from)?.into())
            }
            kind::STEPPED => Self::Stepped(decode_u64(from)?),
            kind::OPENED => {
                let number = SessionNumber::decode(from)?;
                let key = SessionKey::decode(from)?;
                Self::opened(number, key, decode_client_of(from)?)
            }
            kind::GRANTED => Self::Granted(SessionNumber::decode(from)?, IdRange::decode(from)?),
            kind::COUNTED => Self::Counted(SessionNumber::decode(from)?, None),
            kind::REFUSED => {
                let number = SessionNumber::decode(from)?;
                Self::Counted(number, Some(CommandError::decode(from)?))
            }
            kind::CLOSED => Self::Closed(SessionNumber::decode(from)?),
            kind::JOINED => Self::Joined(Peer(from.varint()?), decode_client_of(from)?),
            kind::LEFT => Self::Left(Peer(from.varint()?)),
            kind::RECEIVED => Self::Received(ReceivedCommand::decode(from)?.into()),
            kind::NOT_APPLIED => Self::Refused(CommandError::decode(from)?),
            kind::STEP_BEGAN => {
                let at = Instant::from_nanos(from.varint()?);
                Self::StepBegan(at, Tick::new(from.varint()?))
            }
            kind::MEASURED => Self::Measured(TickMetrics::decode(from)?.into()),
            kind::PACKET => Self::Packet(PacketHead::decode(from)?),
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

impl LogEntry {
    /// Appends an entry that a replay passes over.
    fn encode_explanation(&self, to: &mut Writer) {
        match self {
            Self::Joined(peer, client) => {
                to.u8(kind::JOINED);
                to.varint(peer.0);
                encode_client_of(client.as_ref(), to);
            }
            Self::Left(peer) => {
                to.u8(kind::LEFT);
                to.varint(peer.0);
            }
            Self::Received(received) => {
                to.u8(kind::RECEIVED);
                received.encode(to);
            }
            Self::Refused(error) => {
                to.u8(kind::NOT_APPLIED);
                error.encode(to);
            }
            Self::StepBegan(at, tick) => {
                to.u8(kind::STEP_BEGAN);
                to.varint(at.as_nanos());
                to.varint(tick.value());
            }
            Self::Measured(metrics) => {
                to.u8(kind::MEASURED);
                metrics.encode(to);
            }
            Self::Packet(head) => {
                to.u8(kind::PACKET);
                head.encode(to);
            }
            Self::Applied(_)
            | Self::Stepped(_)
            | Self::Opened(_)
            | Self::Granted(..)
            | Self::Counted(..)
            | Self::Closed(_) => {}
        }
    }
}

impl AppliedCommand {
    fn encode(&self, to: &mut Writer) {
        let client = self.client.as_ref();
        match client.filter(|_| Ownership::concerns(&self.command)) {
            None => to.u8(kind::APPLIED),
            Some(client) => {
                to.u8(kind::OWNED);
                to.sized(client.as_bytes());
            }
        }
        let mut bytes = Writer::new();
        self.command.encode(&mut bytes);
        to.sized(bytes.as_bytes());
    }

    fn decode(client: Option<ClientName>, from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut inner = Reader::new(from.sized(LONG_MESSAGE_BYTES_MAX)?);
        let command = Command::decode(&mut inner)?;
        inner.finish()?;
        if client.is_some() && !Ownership::concerns(&command) {
            return Err(Malformed::OutOfRange);
        }
        Ok(Self {
            command,
            client,
            author: None,
        })
    }
}

impl Wire for ReceivedCommand {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.member.0);
        to.varint(self.number);
        to.varint(u64::from(self.length));
        to.sized(&self.bytes);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(Self {
            member: Peer(from.varint()?),
            number: from.varint()?,
            length: from.varint32()?,
            bytes: from.sized(COMMAND_BYTES_KEPT)?.to_vec(),
        })
    }
}

impl Wire for PacketHead {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.length));
        to.raw(self.bytes());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let length = from.varint32()?;
        let kept = from.raw((length as usize).min(HEAD_BYTES_KEPT))?;
        Ok(Self {
            length,
            ..Self::of(kept)
        })
    }
}

impl Wire for TickMetrics {
    fn encode(&self, to: &mut Writer) {
        let counts = [self.members, self.bodies, self.awake, self.waiting];
        to.varint(self.tick.value());
        counts.iter().for_each(|count| to.varint(*count as u64));
        to.varint(self.load);
        to.varint(self.step.as_nanos());
        to.varint(self.publish.as_nanos());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let count = |from: &mut Reader<'_>| from.varint32().map(|count| count as usize);
        Ok(Self {
            tick: Tick::new(from.varint()?),
            members: count(from)?,
            bodies: count(from)?,
            awake: count(from)?,
            waiting: count(from)?,
            load: from.varint()?,
            step: Span::from_nanos(from.varint()?),
            publish: Span::from_nanos(from.varint()?),
        })
    }
}

/// Eight bytes, little-endian.
///
/// # Errors
///
/// [`Malformed::Truncated`] for fewer.
pub fn decode_u64(from: &mut Reader<'_>) -> Result<u64, Malformed> {
    let bytes = from.raw(8)?;
    bytes
        .try_into()
        .map(u64::from_le_bytes)
        .map_err(|_| Malformed::Truncated)
}

/// Entries that are written as a whole or not at all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Batch {
    /// The scene's tick before them.
    pub tick: Tick,
    /// Their bytes.
    pub records: Vec<u8>,
}

impl Batch {
    /// Bytes that it takes in memory.
    #[must_use]
    pub fn memory_bytes(&self) -> usize {
        size_of::<Self>() + self.records.capacity()
    }
}

/// Bytes of entries beyond which a rollback is given up: a scene of which no copy can be made would fill the memory.
const ROLLBACK_BYTES_MAX: usize = 16 << 20;

/// The newest entries of a scene, decoded: those since the base of its rollback, and those that its log has not got yet.
///
/// It keeps nothing for what does not read it: a scene without both has an empty record. Invariant: an entry stays
/// until all that read it are past it.
#[derive(Debug, Default)]
pub struct RunRecord {
    entries: Vec<LogEntry>,
    /// Place of the first entry since the base; `None` without a base.
    base: Option<usize>,
    /// Place of the first entry that the log lacks; `None` without a log.
    unlogged: Option<usize>,
    /// The scene's tick before that entry.
    tick: Option<Tick>,
    /// About the bytes that the entries since the base take in memory beside the scene.
    bytes: usize,
    /// Bytes of the shapes that were added since the base and are still in the scene.
    shapes: BTreeMap<ShapeId, usize>,
}

impl RunRecord {
    /// Adds what has changed the scene, if anything reads it. `tick`: before the change.
    pub(crate) fn push(&mut self, tick: Tick, change: impl FnOnce() -> LogEntry) {
        if self.base.is_none() && self.unlogged.is_none() {
            return;
        }
        let change = change();
        if self.unlogged.is_some() {
            self.tick.get_or_insert(tick);
        }
        if self.base.is_some() {
            self.count(&change);
        }
        self.entries.push(change);
        if self.bytes > ROLLBACK_BYTES_MAX {
            self.base = None;
            self.forget();
        }
    }

    /// Adds what concerns a session, if there is a log.
    pub fn note(&mut self, tick: Tick, entry: LogEntry) {
        if self.unlogged.is_some() {
            self.tick.get_or_insert(tick);
            self.entries.push(entry);
        }
    }

    /// Names the client and the member of the command that was just applied.
    pub(crate) fn attribute(&mut self, author: Author, client: Option<ClientName>) {
        if let Some(LogEntry::Applied(applied)) = self.entries.last_mut() {
            applied.author = Some(author);
            applied.client = client;
        }
    }

    /// Starts to keep entries for a log, from now on.
    pub fn begin_log(&mut self) {
        self.unlogged = Some(self.entries.len());
        self.tick = None;
        self.forget();
    }

    /// Starts to keep entries for a rollback, from now on.
    pub(crate) fn begin_base(&mut self) {
        self.base = Some(self.entries.len());
        self.bytes = 0;
        self.shapes.clear();
        self.forget();
    }

    /// The changes since the base; `None` without a base.
    pub(crate) fn since_base(&self) -> Option<impl Iterator<Item = &LogEntry>> {
        let entries = &self.entries[self.base?..];
        Some(entries.iter().filter(|entry| entry.is_change()))
    }

    /// About the bytes that the entries since the base take; `None` without a base.
    pub(crate) fn bytes_since_base(&self) -> Option<usize> {
        self.base.map(|_| self.bytes)
    }

    /// Everything that the log has not got yet.
    pub fn take_batch(&mut self) -> Option<Batch> {
        let (unlogged, tick) = (self.unlogged?, self.tick.take()?);
        let mut to = Writer::new();
        let entries = &self.entries[unlogged..];
        entries.iter().for_each(|entry| entry.encode(&mut to));
        self.unlogged = Some(self.entries.len());
        self.forget();
        let records = to.into_bytes();
        Some(Batch { tick, records })
    }

    fn count(&mut self, change: &LogEntry) {
        self.bytes += size_of::<LogEntry>();
        let LogEntry::Applied(applied) = change else {
            return;
        };
        self.bytes += size_of::<AppliedCommand>();
        match &applied.command {
            // While the scene has the shape, both share its memory.
            Command::AddShape { id, shape } => {
                self.shapes.insert(*id, shape.bytes());
            }
            Command::RemoveShape { id } => self.bytes += self.shapes.remove(id).unwrap_or(0),
            _ => {}
        }
    }

    /// Forgets the entries that nothing reads any more.
    fn forget(&mut self) {
        let length = self.entries.len();
        let read = self.base.unwrap_or(length);
        let read = read.min(self.unlogged.unwrap_or(length));
        self.entries.drain(..read);
        for place in [&mut self.base, &mut self.unlogged].into_iter().flatten() {
            *place -= read;
        }
        if self.base.is_none() {
            self.bytes = 0;
            self.shapes.clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;
    use rhumb_protocol::scene::{BodyDesc, BodyKind, Heights, SceneConfig, Shape};
    use rhumb_reckoning::{BodyId, Damping};

    use super::*;
    use crate::scene::Scene;

    fn applied(command: Command, client: Option<&str>) -> LogEntry {
        let applied = AppliedCommand {
            command,
            client: client.map(Into::into),
            author: None,
        };
        LogEntry::Applied(applied.into())
    }

    /// One entry of each kind.
    fn every_kind() -> Vec<LogEntry> {
        let (number, id) = (SessionNumber(300), ShapeId(7));
        let shape = Shape::ball(0.5);
        let key = SessionKey([9; 16]);
        let received = ReceivedCommand {
            member: Peer(1 << 40),
            number: 3,
            length: 1 << 20,
            bytes: vec![5; COMMAND_BYTES_KEPT],
        };
        let metrics = TickMetrics {
            tick: Tick::new(1 << 33),
            members: 2,
            bodies: 5_000,
            awake: 300,
            waiting: 0,
            load: 300_000,
            step: Span::from_millis(3),
            publish: Span::from_nanos(700),
        };
        vec![
            applied(Command::AddShape { id, shape }, Some("anna")),
            applied(Command::RemoveShape { id }, None),
            LogEntry::Stepped(u64::MAX - 1),
            LogEntry::opened(number, key, Some("anna".into())),
            LogEntry::Granted(number, IdRange::new(4_096, 64, 2).unwrap()),
            LogEntry::Counted(number, None),
            LogEntry::Counted(number, Some(CommandError::TooManyBodies)),
            LogEntry::Closed(number),
            LogEntry::Joined(Peer(3), None),
            LogEntry::Joined(Peer(4), Some("bert".into())),
            LogEntry::Left(Peer(3)),
            LogEntry::Received(received.into()),
            LogEntry::Refused(CommandError::UnknownShape(id)),
            LogEntry::StepBegan(Instant::from_nanos(u64::MAX), Tick::new(9)),
            LogEntry::Measured(metrics.into()),
            LogEntry::Packet(PacketHead::of(&[1; 3])),
            LogEntry::Packet(PacketHead::of(&[2; 1_200])),
        ]
    }

    fn encoded(entries: &[LogEntry]) -> Vec<u8> {
        let mut to = Writer::new();
        entries.iter().for_each(|entry| entry.encode(&mut to));
        to.into_bytes()
    }

    #[test]
    fn every_entry_is_read_back_and_every_cut_one_is_refused() {
        let entries = every_kind();
        let all = LogEntry::decode_all(&encoded(&entries));
        assert_eq!(all, Ok(entries.clone()));
        for entry in entries {
            let bytes = encoded(std::slice::from_ref(&entry));
            for end in 1..bytes.len() {
                let cut = LogEntry::decode_all(&bytes[..end]);
                assert!(cut.is_err(), "{entry:?} cut at {end}");
            }
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_are_refused_or_have_one_encoding(bytes: Vec<u8>, kind in 0_u8..18) {
            let bytes = [&[kind][..], &bytes].concat();
            let mut from = Reader::new(&bytes);
            if let Ok(entry) = LogEntry::decode(&mut from) {
                let read = bytes.len() - from.rest().len();
                prop_assert_eq!(encoded(&[entry]), &bytes[..read]);
            }
        }
    }

    #[test]
    fn the_log_has_the_client_of_every_command_that_changes_its_part_of_a_scene() {
        let id = BodyId::new(1, 0);
        let mut desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
        desc.damping = Some(Damping {
            linear: 0.25,
            angular: 0.5,
        });
        let push = Command::Impulse {
            id,
            impulse: Vec3::X,
        };
        for (command, has_client) in [(Command::ChangeBody { desc }, true), (push, false)] {
            let bytes = encoded(&[applied(command.clone(), Some("anna"))]);
            let client = has_client.then_some("anna");
            let expected = Ok(vec![applied(command, client)]);
            assert_eq!(LogEntry::decode_all(&bytes), expected);
        }
    }

    #[test]
    fn an_entry_stays_until_rollback_and_log_are_past_it() {
        let mut record = RunRecord::default();
        let step = |record: &mut RunRecord, number: u64| {
            record.push(Tick::new(number), || LogEntry::Stepped(number));
        };
        let since_base = |record: &RunRecord| record.since_base().map(Iterator::count);
        let logged = |record: &mut RunRecord| {
            let batch = record.take_batch();
            batch.map(|batch| (batch.tick.value(), LogEntry::decode_all(&batch.records)))
        };
        step(&mut record, 0);
        assert_eq!((since_base(&record), record.entries.len()), (None, 0));
        record.begin_base();
        step(&mut record, 1);
        record.begin_log();
        step(&mut record, 2);
        record.note(Tick::new(3), LogEntry::Closed(SessionNumber(1)));
        assert_eq!(since_base(&record), Some(2));
        record.begin_base();
        step(&mut record, 3);
        assert_eq!(since_base(&record), Some(1));
        let closed = LogEntry::Closed(SessionNumber(1));
        let expected = vec![LogEntry::Stepped(2), closed, LogEntry::Stepped(3)];
        assert_eq!(logged(&mut record), Some((2, Ok(expected))));
        assert_eq!(logged(&mut record), None);
        assert_eq!((since_base(&record), record.entries.len()), (Some(1), 1));
    }

    /// A lockstep scene that no client advances can never be copied, so that its entries would grow for ever.
    #[test]
    fn the_entries_of_a_scene_that_never_steps_are_bounded() {
        let mut scene = Scene::new(SceneConfig::default()).expect("the default config is valid");
        scene.record_mut().begin_base();
        let posts = vec![0.0; 512 * 512];
        let heights = Heights::new(512, 1.0, 1.0, &posts).expect("within the limits");
        let (id, shape) = (ShapeId(0), Shape::Heights(heights));
        let mut longest = 0;
        for _ in 0..40 {
            let shape = shape.clone();
            for command in [Command::AddShape { id, shape }, Command::RemoveShape { id }] {
                scene.apply(&command).expect("the shape is free");
                longest = longest.max(scene.record().bytes_since_base().unwrap_or(0));
            }
        }
        assert!(longest > ROLLBACK_BYTES_MAX / 2, "{longest}");
        assert!(longest <= ROLLBACK_BYTES_MAX, "{longest}");
        let bytes = scene.record().bytes_since_base();
        assert_eq!(bytes, None, "a copy begins it anew");
    }
}
