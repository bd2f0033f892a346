//! Sessions, which outlive connections, and the log, which outlives a process.
//!
//! Knows neither streams nor connections. Invariants: a command of a session counts once; a session has at most one
//! member; what a log or an image brings back equals what was written.
//!
//! By its command log and the store of all, a scene survives its process. They are kept elsewhere: in files, by another
//! process. Invariant: neither a log nor a store makes a scene wait.

use std::cmp::Reverse;
use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::message::SessionKey;
use rhumb_protocol::scene::{CommandError, IdRange, SceneConfig, SceneName};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::Tick;

use crate::permit::{ClientName, Ownership, decode_client_of, encode_client_of};
use crate::record::{Batch, LogEntry, SessionNumber};
use crate::scene::{Digest, FrozenScene, Scene};

/// Refusals that a session keeps, for a client that has not seen them.
pub(crate) const REFUSALS_KEPT: usize = 256;
/// Sessions that a scene keeps, twice its members at most. After a restart, all of them are without a member at first.
const SESSIONS_MAX: usize = 512;
/// A session whose member is away for so long is over.
const ABSENT_FOR: Span = Span::from_millis(300_000);

/// One session.
#[derive(Clone, Debug, PartialEq)]
pub struct ResumableSession {
    key: SessionKey,
    /// The client that began it, whose alone it is; `None` without a token.
    client: Option<ClientName>,
    /// Commands that were applied or refused.
    pub commands: u64,
    /// Body indices granted to it.
    pub ranges: Vec<IdRange>,
    /// The last refusals with the numbers of their commands.
    refusals: VecDeque<(u64, CommandError)>,
    presence: Presence,
}

/// True if a session has a member.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Presence {
    Member(Peer),
    /// Since when not; `None` for a session that came back with its scene.
    Absent(Option<Instant>),
}

/// All sessions of one scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sessions {
    sessions: BTreeMap<SessionNumber, ResumableSession>,
    next: u32,
}

impl Sessions {
    /// The session of a client's key. The same key of another client is another session: a stolen key opens nothing.
    pub(crate) fn of_key(
        &self,
        key: SessionKey,
        client: Option<&ClientName>,
    ) -> Option<SessionNumber> {
        let mut sessions = self.sessions.iter();
        sessions.find_map(|(number, session)| {
            let is_it = session.key == key && session.client.as_ref() == client;
            is_it.then_some(*number)
        })
    }

    /// A session by its number.
    #[must_use]
    pub fn get(&self, number: SessionNumber) -> Option<&ResumableSession> {
        self.sessions.get(&number)
    }

    /// The number of the next session.
    pub(crate) const fn next_number(&self) -> SessionNumber {
        SessionNumber(self.next)
    }

    /// The member of a session.
    pub(crate) fn member_of(&self, number: SessionNumber) -> Option<Peer> {
        match self.sessions.get(&number)?.presence {
            Presence::Member(peer) => Some(peer),
            Presence::Absent(_) => None,
        }
    }

    /// Gives a session a member.
    pub(crate) fn attach(&mut self, number: SessionNumber, peer: Peer) {
        if let Some(session) = self.sessions.get_mut(&number) {
            session.presence = Presence::Member(peer);
        }
    }

    /// The member of a session is gone.
    pub(crate) fn detach(&mut self, number: SessionNumber, now: Instant) {
        if let Some(session) = self.sessions.get_mut(&number) {
            session.presence = Presence::Absent(Some(now));
        }
    }

    /// The sessions that are over because their member is away for too long, or because too many are.
    pub(crate) fn expired(&mut self, now: Instant) -> Vec<SessionNumber> {
        for session in self.sessions.values_mut() {
            if let Presence::Absent(since) = &mut session.presence {
                since.get_or_insert(now);
            }
        }
        let away_for = |number: SessionNumber| match self.sessions[&number].presence {
            Presence::Absent(since) => since.map_or(Span::ZERO, |since| now.since(since)),
            Presence::Member(_) => Span::ZERO,
        };
        let absent = self.absent();
        let (mut over, kept): (Vec<_>, Vec<_>) =
            (absent.into_iter()).partition(|number| away_for(*number) >= ABSENT_FOR);
        let too_many = (self.sessions.len() - over.len()).saturating_sub(SESSIONS_MAX);
        over.extend(kept.iter().take(too_many));
        over
    }

    /// The sessions without a member, in the order in which they give way to others: that of the client that has most of
    /// them goes first, and of its own the one that left first.
    pub(crate) fn absent(&self) -> Vec<SessionNumber> {
        let mut newest_first: Vec<_> = (self.sessions.iter())
            .filter_map(|(number, session)| match session.presence {
                Presence::Absent(since) => Some((since, *number, &session.client)),
                Presence::Member(_) => None,
            })
            .collect();
        newest_first.sort_unstable_by(|one, other| other.cmp(one));
        let mut newer = BTreeMap::new();
        let mut absent: Vec<_> = (newest_first.into_iter())
            .map(|(since, number, client)| {
                let place: &mut usize = newer.entry(client).or_default();
                *place += 1;
                (Reverse(*place), since, number)
            })
            .collect();
        absent.sort_unstable();
        absent.into_iter().map(|(_, _, number)| number).collect()
    }

    /// All sessions with their numbers.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (SessionNumber, &ResumableSession)> {
        self.sessions
            .iter()
            .map(|(number, session)| (*number, session))
    }

    /// Does what an entry says. Those that do not concern a session change nothing here.
    pub fn replay(&mut self, entry: &LogEntry) {
        match entry {
            LogEntry::Opened(opened) => {
                self.next = opened.number.0 + 1;
                let session = ResumableSession {
                    key: opened.key,
                    client: opened.client.clone(),
                    commands: 0,
                    ranges: Vec::new(),
                    refusals: VecDeque::new(),
                    presence: Presence::Absent(None),
                };
                self.sessions.insert(opened.number, session);
            }
            LogEntry::Granted(number, range) => {
                if let Some(session) = self.sessions.get_mut(number) {
                    session.ranges.push(*range);
                }
            }
            LogEntry::Counted(number, refused) => {
                if let Some(session) = self.sessions.get_mut(number) {
                    session.count(*refused);
                }
            }
            LogEntry::Closed(number) => drop(self.sessions.remove(number)),
            _ => {}
        }
    }
}

impl ResumableSession {
    fn count(&mut self, refused: Option<CommandError>) {
        if let Some(error) = refused {
            if self.refusals.len() == REFUSALS_KEPT {
                self.refusals.pop_front();
            }
            self.refusals.push_back((self.commands, error));
        }
        self.commands += 1;
    }

    /// The kept refusals of commands from a number on.
    pub fn refusals_from(&self, number: u64) -> impl Iterator<Item = (u64, CommandError)> {
        let refusals = self.refusals.iter().copied();
        refusals.filter(move |(refused, _)| *refused >= number)
    }
}

impl Wire for Sessions {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.next));
        to.varint(self.sessions.len() as u64);
        for (number, session) in &self.sessions {
            number.encode(to);
            session.key.encode(to);
            encode_client_of(session.client.as_ref(), to);
            to.varint(session.commands);
            to.varint(session.ranges.len() as u64);
            session.ranges.iter().for_each(|range| range.encode(to));
            to.varint(session.refusals.len() as u64);
            for (number, error) in &session.refusals {
                to.varint(*number);
                error.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut sessions = Self {
            next: from.varint32()?,
            sessions: BTreeMap::new(),
        };
        for _ in 0..from.varint()? {
            let number = SessionNumber::decode(from)?;
            let mut session = ResumableSession {
                key: SessionKey::decode(from)?,
                client: decode_client_of(from)?,
                commands: from.count()?,
                ranges: Vec::new(),
                refusals: VecDeque::new(),
                presence: Presence::Absent(None),
            };
            for _ in 0..from.varint()? {
                session.ranges.push(IdRange::decode(from)?);
            }
            for _ in 0..from.varint()? {
                let number = from.count()?;
                session
                    .refusals
                    .push_back((number, CommandError::decode(from)?));
            }
            sessions.sessions.insert(number, session);
        }
        Ok(sessions)
    }
}

/// A scene's end of its log. Batches are durable in their order.
pub trait CommandLog: Send {
    /// Hands over a batch; returns its number, for [`Self::durable`]. Once the log is given up, a batch is lost and
    /// only counts: the next snapshot has what it did.
    fn append(&mut self, batch: Batch) -> u64;

    /// Number of batches so far.
    fn appended(&self) -> u64;

    /// Number of batches that are durable.
    fn durable(&self) -> u64;

    /// Bytes of the log since the last snapshot.
    fn bytes(&self) -> usize;

    /// True if another snapshot may begin.
    fn may_snapshot(&self) -> bool;

    /// True if only a snapshot makes the log whole again.
    fn is_broken(&self) -> bool;

    /// Gives the log up until the next snapshot: the scene continues from another state, which counts as a batch. A
    /// snapshot that was handed over before does not count.
    fn give_up(&mut self);

    /// Hands over a snapshot of the scene after all batches so far.
    fn snapshot(&mut self, frozen: Frozen);

    /// Removes everything that the log keeps of the scene.
    fn delete(self: Box<Self>);
}

/// The state of a scene at a moment, for a snapshot.
pub struct Frozen {
    /// The newest tick.
    pub tick: Tick,
    /// Digest of all observations up to it.
    pub digest: Digest,
    /// Sessions of its clients.
    pub sessions: Sessions,
    /// Owners of its bodies, shapes and joints.
    pub ownership: Ownership,
    /// Its bodies.
    pub scene: FrozenScene,
}

/// The logs of all scenes, and those that are damaged: they are not served, and keep their names until a client deletes
/// them.
pub trait SceneStore: Send + Sync {
    /// The log of a scene that begins; `None` if it cannot be kept.
    fn create(&self, scene: &SceneName, config: &SceneConfig) -> Option<Box<dyn CommandLog>>;

    /// True for a scene that is damaged.
    fn is_damaged(&self, scene: &SceneName) -> bool;

    /// Removes a damaged scene; `false` for any other scene, and if it cannot be removed.
    fn delete_damaged(&self, scene: &SceneName) -> bool;

    /// Number of damaged scenes.
    fn damaged(&self) -> usize;
}

/// A scene that continues where its log ends.
pub struct RestoredScene {
    /// Its bodies.
    pub scene: Scene,
    /// Sessions of its clients.
    pub sessions: Sessions,
    /// Owners of its bodies, shapes and joints.
    pub ownership: Ownership,
    /// Entries of sessions that the log lacks.
    pub unnoted: Vec<LogEntry>,
    /// The log, which continues; `None` if it cannot be kept any longer.
    pub log: Option<Box<dyn CommandLog>>,
    /// Time that the restoration took.
    pub took: Span,
}

/// Time of steps after which a snapshot is due: a third of the time for a restart.
const SNAPSHOT_AFTER: Span = Span::from_millis(1_000);
/// Bytes of the log after which a snapshot is due.
const SNAPSHOT_BYTES: usize = 4 << 20;
/// Steps after which a snapshot is tried that makes a broken log whole.
const REPAIR_STEPS: u64 = 60;

/// The log of a scene, and the work since its last snapshot.
pub(crate) struct Durability {
    pub(crate) log: Box<dyn CommandLog>,
    /// Time of the steps since the last snapshot.
    pub(crate) stepped: Span,
    pub(crate) snapshot_tick: Tick,
}

impl Durability {
    /// `stepped`: time that the replay of the log took.
    pub(crate) fn new(log: Box<dyn CommandLog>, stepped: Span, tick: Tick) -> Self {
        Self {
            log,
            stepped,
            snapshot_tick: tick,
        }
    }

    pub(crate) fn is_snapshot_due(&self, tick: Tick) -> bool {
        let steps = tick.value().saturating_sub(self.snapshot_tick.value());
        let due = if self.log.is_broken() {
            steps >= REPAIR_STEPS
        } else {
            self.stepped >= SNAPSHOT_AFTER || self.log.bytes() >= SNAPSHOT_BYTES
        };
        due && self.log.may_snapshot()
    }

    /// True if a snapshot is due by the bytes of the log alone, in whatever state the scene is.
    pub(crate) fn is_long(&self) -> bool {
        !self.log.is_broken() && self.log.bytes() >= SNAPSHOT_BYTES && self.log.may_snapshot()
    }

    /// True if the log is longer than so many bytes and still grows.
    pub(crate) fn is_beyond(&self, bytes: usize) -> bool {
        !self.log.is_broken() && self.log.bytes() >= bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: SessionKey = SessionKey([5; 16]);
    const NUMBER: SessionNumber = SessionNumber(3);

    fn client(name: &str) -> Option<ClientName> {
        (!name.is_empty()).then(|| name.into())
    }

    fn sessions() -> Sessions {
        let mut sessions = Sessions::default();
        let range = IdRange::new(8, 16, 1).unwrap();
        for record in [
            LogEntry::opened(NUMBER, KEY, client("anna")),
            LogEntry::Granted(NUMBER, range),
            LogEntry::Counted(NUMBER, None),
            LogEntry::Counted(NUMBER, Some(CommandError::UnknownCommand)),
        ] {
            sessions.replay(&record);
        }
        sessions
    }

    #[test]
    fn an_image_brings_back_the_same_sessions() {
        let sessions = sessions();
        let mut writer = Writer::new();
        sessions.encode(&mut writer);
        let bytes = writer.into_bytes();
        let decoded = Sessions::decode(&mut Reader::new(&bytes));
        assert_eq!(decoded.as_ref(), Ok(&sessions));
        for cut in 0..bytes.len() {
            assert!(Sessions::decode(&mut Reader::new(&bytes[..cut])).is_err());
        }
    }

    #[test]
    fn a_client_learns_of_the_refusals_that_it_has_not_seen() {
        let sessions = sessions();
        let session = sessions.get(NUMBER).unwrap();
        assert_eq!((session.commands, sessions.next_number().0), (2, 4));
        let unseen: Vec<_> = session.refusals_from(0).collect();
        assert_eq!(unseen, [(1, CommandError::UnknownCommand)]);
        assert_eq!(session.refusals_from(2).count(), 0);
    }

    #[test]
    fn a_session_without_a_member_is_over_after_its_time() {
        let mut sessions = sessions();
        sessions.attach(NUMBER, Peer(1));
        let late = Instant::ZERO + ABSENT_FOR;
        assert_eq!(sessions.expired(late), []);
        sessions.detach(NUMBER, Instant::ZERO);
        assert_eq!(sessions.expired(Instant::ZERO), []);
        assert_eq!(sessions.expired(late), [NUMBER]);
        sessions.replay(&LogEntry::Closed(NUMBER));
        assert_eq!(sessions.of_key(KEY, client("anna").as_ref()), None);
    }

    #[test]
    fn a_client_that_leaves_many_sessions_ends_its_own_and_no_other() {
        let mut sessions = sessions();
        sessions.detach(NUMBER, Instant::ZERO);
        let of_bert = |place: usize| SessionNumber(10 + place as u32);
        for place in 0..=SESSIONS_MAX {
            let record = LogEntry::opened(of_bert(place), SessionKey([6; 16]), client("bert"));
            sessions.replay(&record);
            let later = Instant::ZERO + Span::from_millis(1 + place as u64);
            sessions.detach(of_bert(place), later);
        }
        let now = Instant::ZERO + Span::from_millis(1_000);
        assert_eq!(sessions.expired(now), [of_bert(0), of_bert(1)]);
        let last = [of_bert(SESSIONS_MAX - 1), NUMBER, of_bert(SESSIONS_MAX)];
        assert!(sessions.absent().ends_with(&last));
    }

    #[test]
    fn a_key_opens_the_session_of_its_own_client_only() {
        let sessions = sessions();
        let of = |client: Option<ClientName>| sessions.of_key(KEY, client.as_ref());
        assert_eq!(of(client("anna")), Some(NUMBER));
        assert_eq!(of(client("bert")), None);
        assert_eq!(of(client("")), None);
        assert_eq!(
            sessions.of_key(SessionKey([6; 16]), client("anna").as_ref()),
            None
        );
    }
}
