//! The streams of one scene: each said once, however many follow it.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::limits::{HISTORY_PACKETS, STREAMS_PER_SCENE_MAX};
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::packet::{Doubt, Echo, StreamId};
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Features, FullPublisher, Losses, Manner, Observation, Publisher, PublisherStatistics,
    Reassurance, StreamTerms, Witness,
};
use rhumb_reckoning::{BodyId, Tick, Ticks, Tolerance, Track, Verbatim};

use crate::scene::Scene;

/// One stream at its source.
#[derive(Debug)]
pub(crate) enum Source {
    Reckoned(Box<Publisher>),
    Full(FullPublisher),
}

impl Source {
    /// What a choice of stream is made of, without bodies yet.
    pub(crate) fn new(choice: StreamChoice, id: StreamId, scene: &Scene) -> Self {
        let tick = scene.tick();
        match choice {
            StreamChoice::Within(tolerance) | StreamChoice::Capped { tolerance, .. } => {
                let terms = StreamTerms {
                    tolerance,
                    integrator: scene.terms().integrator,
                    every: scene.terms().cadence.every,
                    gravity: scene.gravity(),
                    features: Features::ALL,
                };
                let mut publisher = Publisher::new(id, &terms, tick);
                if let StreamChoice::Capped { budget, .. } = choice {
                    publisher.limit(budget);
                }
                Self::Reckoned(Box::new(publisher))
            }
            StreamChoice::Full => Self::Full(FullPublisher::new(id, tick)),
        }
    }
}

/// A stream, who wants it, and how long it has been silent.
#[derive(Debug)]
pub(crate) struct Stream {
    pub(crate) choice: StreamChoice,
    source: Source,
    followers: usize,
    /// Ticks that were spoken of, and of which nothing had to be said.
    silent: u32,
    /// When the sum over all tracks was last said, and what it was.
    digest: (Tick, u64),
    /// Tracks that a member had otherwise.
    pub(crate) amended: u64,
    /// Whether bodies wait for a word, for want of budget.
    in_arrears: bool,
    /// The datagrams of the last tick.
    packets: Vec<Bytes>,
    /// The parities behind them.
    parities: Vec<Bytes>,
    /// What its members lose.
    losses: Losses,
    /// What makes good lost packets, as asked for since the last tick: encoded once for all who lost the same.
    repairs: BTreeMap<(u64, u64), Vec<Bytes>>,
}

impl Stream {
    pub(crate) fn id(&self) -> StreamId {
        match &self.source {
            Source::Reckoned(publisher) => publisher.stream(),
            Source::Full(publisher) => publisher.stream(),
        }
    }

    pub(crate) fn tolerance(&self) -> Tolerance {
        self.choice.tolerance()
    }

    /// The tick up to which everything was said.
    pub(crate) fn tick(&self) -> Tick {
        match &self.source {
            Source::Reckoned(publisher) => publisher.tick(),
            Source::Full(publisher) => publisher.tick(),
        }
    }

    pub(crate) fn next_number(&self) -> u64 {
        match &self.source {
            Source::Reckoned(publisher) => publisher.next_number(),
            Source::Full(publisher) => publisher.next_number(),
        }
    }

    pub(crate) fn statistics(&self) -> PublisherStatistics {
        match &self.source {
            Source::Reckoned(publisher) => publisher.statistics(),
            Source::Full(publisher) => publisher.statistics(),
        }
    }

    /// Every body's track, in order of index.
    pub(crate) fn tracks(&self) -> Vec<(BodyId, Track)> {
        match &self.source {
            Source::Reckoned(publisher) => publisher.tracks().collect(),
            Source::Full(publisher) => publisher.tracks().collect(),
        }
    }

    /// The seat of a body, if it has one.
    pub(crate) fn seat(&self, id: BodyId) -> Option<u32> {
        match &self.source {
            Source::Reckoned(publisher) => publisher.seat(id),
            Source::Full(_) => None,
        }
    }

    /// What pulled from which tick on, oldest first, if tracks refer to more than one gravity.
    pub(crate) fn gravity_changes(&self) -> Vec<(Tick, Vec3)> {
        let changes: Vec<_> = match &self.source {
            Source::Reckoned(publisher) => publisher.gravity_changes().collect(),
            Source::Full(_) => Vec::new(),
        };
        if changes.len() > 1 {
            changes
        } else {
            Vec::new()
        }
    }

    pub(crate) fn place(&mut self, id: BodyId, manner: &Manner, track: Track, motion: Verbatim) {
        match &mut self.source {
            Source::Reckoned(publisher) => {
                let placed = publisher.place(id, manner, track);
                debug_assert!(placed, "the scene keeps the limits of its streams");
            }
            Source::Full(publisher) => {
                publisher.place(id, track.origin, motion, track.is_resting());
            }
        }
    }

    fn remove(&mut self, id: BodyId) {
        match &mut self.source {
            Source::Reckoned(publisher) => publisher.remove(id),
            Source::Full(publisher) => publisher.remove(id),
        }
    }

    pub(crate) fn vouch(&self, notices: u64) -> Bytes {
        match &self.source {
            Source::Reckoned(publisher) => publisher.vouch(notices),
            Source::Full(publisher) => publisher.vouch(notices),
        }
    }

    /// A member says how far it heard: what gives it back what it lost, or makes it good, and a vouch for what it could not
    /// know of.
    pub(crate) fn answer(&mut self, peer: Peer, echo: &Echo, notices: u64) -> Vec<Bytes> {
        let next = self.next_number();
        self.losses.hear(peer.0, echo, next);
        let mut datagrams = Vec::new();
        let lost: BTreeSet<u64> = match &mut self.source {
            Source::Reckoned(publisher) => {
                publisher.answer(echo, &mut datagrams).into_iter().collect()
            }
            Source::Full(_) => echo.lost.iter().map(|lost| lost.expand(next)).collect(),
        };
        for number in lost {
            match self.repair(number, notices) {
                Some(repair) => datagrams.extend_from_slice(repair),
                // Forgotten: the vouch below tells the member how much it missed, and it asks for everything.
                None => tracing::debug!(number, "a lost packet is no longer known"),
            }
        }
        datagrams.push(self.vouch(notices));
        datagrams
    }

    /// The datagrams that make good a lost packet; none when it is not known any more.
    fn repair(&mut self, number: u64, notices: u64) -> Option<&[Bytes]> {
        if self.repairs.len() >= HISTORY_PACKETS {
            self.repairs.clear();
        }
        let entry = match self.repairs.entry((number, notices)) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(place) => place.insert(match &self.source {
                Source::Reckoned(publisher) => publisher.repair(number, notices),
                Source::Full(publisher) => publisher.repair(number, notices),
            }?),
        };
        Some(entry)
    }

    /// Says what must be said now, if a tick is spoken of. A silent stream vouches ever more rarely, within bounds.
    fn publish(&mut self, at: &Moment<'_>, witness: &Witness) {
        self.packets.clear();
        self.parities.clear();
        self.repairs.clear();
        let before = self.tick();
        match &mut self.source {
            Source::Reckoned(publisher) => {
                publisher.publish(witness, at.notices, &mut self.packets);
            }
            Source::Full(publisher) => {
                publisher.publish(witness, at.notices, &mut self.packets);
            }
        }
        if self.tick() == before {
            return;
        }
        self.tell_of_arrears();
        self.vouch_or_sum_up(at);
        let redundancy = self.losses.redundancy(self.followers, self.next_number());
        if let Source::Reckoned(publisher) = &mut self.source {
            publisher.say_parities(redundancy, &mut self.parities);
        }
    }

    /// What goes with the packets of a tick, or in place of them.
    fn vouch_or_sum_up(&mut self, at: &Moment<'_>) {
        if !self.packets.is_empty() {
            self.silent = 0;
            let digest = self.due_digest(at);
            self.packets.extend(digest);
            return;
        }
        self.silent += 1;
        let due = self.silent.is_power_of_two() && self.silent < at.vouch_within;
        if due || self.silent.is_multiple_of(at.vouch_within) {
            // A digest vouches too.
            let digest = self.due_digest(at);
            self.packets
                .push(digest.unwrap_or_else(|| self.vouch(at.notices)));
        }
    }

    /// Logs when a budget begins not to suffice, and when it suffices again.
    fn tell_of_arrears(&mut self) {
        let Source::Reckoned(publisher) = &self.source else {
            return;
        };
        let (waiting, withheld) = (publisher.waiting(), publisher.statistics().withheld);
        let stream = publisher.stream();
        if waiting > 0 && !self.in_arrears {
            tracing::info!(%stream, waiting, cause = "budget", "bodies wait for a word");
        } else if waiting == 0 && self.in_arrears {
            tracing::info!(%stream, withheld, "the budget suffices again");
        }
        self.in_arrears = waiting > 0;
    }

    /// What says the sum over all tracks, if that is another than the one said last, and that is a second ago.
    fn due_digest(&mut self, at: &Moment<'_>) -> Option<Bytes> {
        let Source::Reckoned(publisher) = &self.source else {
            return None;
        };
        let (last, sum) = self.digest;
        let age = publisher.tick().since(last)?;
        // A digest states nothing of a budget's arrears: silence is vouched for by what does.
        let capped = matches!(self.choice, StreamChoice::Capped { .. });
        if age < at.second || publisher.agreement() == sum || capped && self.packets.is_empty() {
            return None;
        }
        self.digest = (publisher.tick(), publisher.agreement());
        Some(publisher.digest(at.notices))
    }

    /// Answers a member whose sum over some tracks is another.
    pub(crate) fn reassure(&mut self, doubt: Doubt, notices: u64) -> Vec<Bytes> {
        let Source::Reckoned(publisher) = &self.source else {
            return Vec::new();
        };
        match publisher.reassure(doubt, notices) {
            Reassurance::Sums(datagram) => vec![datagram],
            Reassurance::Amendment(id, datagrams) => {
                self.amended += 1;
                let name = id.map(tracing::field::display);
                tracing::warn!(stream = %publisher.stream(), body = name, "a member's track was another");
                datagrams
            }
        }
    }
}

/// A tick as a stream sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment<'a> {
    pub(crate) tick: Tick,
    pub(crate) observations: &'a [Observation],
    /// Notices given up to this tick.
    pub(crate) notices: u64,
    /// A silent stream vouches at least once in so many ticks that are spoken of: one where somebody waits for this very
    /// tick.
    pub(crate) vouch_within: u32,
    /// Ticks in a second, at least one.
    pub(crate) second: Ticks,
}

/// All streams of a scene that somebody follows.
#[derive(Debug)]
pub(crate) struct Streams {
    streams: Vec<Stream>,
    /// What all reckoned streams speak of.
    witness: Witness,
}

impl Streams {
    /// None yet; they will be said by this cadence.
    pub(crate) fn new(cadence: Cadence) -> Self {
        Self {
            streams: Vec::new(),
            witness: Witness::new(cadence),
        }
    }

    pub(crate) fn get(&self, id: StreamId) -> Option<&Stream> {
        self.streams.iter().find(|stream| stream.id() == id)
    }

    pub(crate) fn get_mut(&mut self, id: StreamId) -> Option<&mut Stream> {
        self.streams.iter_mut().find(|stream| stream.id() == id)
    }

    /// The datagrams of a stream's last tick that a member is sent: parities only if it loses packets, whoever else does.
    pub(crate) fn packets(&self, id: StreamId, peer: Peer) -> impl Iterator<Item = &Bytes> {
        let stream = self.get(id);
        let packets = stream.map_or(&[][..], |stream| &stream.packets);
        let parities = stream
            .filter(|stream| stream.losses.loses(peer.0, stream.next_number()))
            .map_or(&[][..], |stream| &stream.parities);
        packets.iter().chain(parities)
    }

    /// The stream of a choice, if somebody follows it.
    pub(crate) fn of_choice(&self, choice: StreamChoice) -> Option<StreamId> {
        let found = self.streams.iter().find(|stream| stream.choice == choice);
        found.map(Stream::id)
    }

    /// The stream of a choice with one follower more, or what makes a new one.
    pub(crate) fn follow(&mut self, choice: StreamChoice) -> Result<Option<StreamId>, Denial> {
        if let Some(stream) = self
            .streams
            .iter_mut()
            .find(|stream| stream.choice == choice)
        {
            stream.followers += 1;
            return Ok(Some(stream.id()));
        }
        if self.streams.len() >= STREAMS_PER_SCENE_MAX {
            return Err(Denial::TooManyStreams);
        }
        Ok(None)
    }

    /// Adds a stream with one follower.
    pub(crate) fn begin(&mut self, choice: StreamChoice, source: Source) -> &mut Stream {
        self.streams.push(Stream {
            choice,
            source,
            followers: 1,
            silent: 0,
            digest: (Tick::ZERO, 0),
            amended: 0,
            in_arrears: false,
            packets: Vec::new(),
            parities: Vec::new(),
            losses: Losses::default(),
            repairs: BTreeMap::new(),
        });
        self.streams.last_mut().expect("one was just added")
    }

    /// One follower less; a stream that nobody follows ends.
    pub(crate) fn unfollow(&mut self, id: StreamId) {
        for stream in &mut self.streams {
            if stream.id() == id {
                stream.followers -= 1;
            }
        }
        self.streams.retain(|stream| stream.followers > 0);
    }

    pub(crate) fn place(&mut self, id: BodyId, manner: &Manner, track: Track, motion: Verbatim) {
        for stream in &mut self.streams {
            stream.place(id, manner, track, motion);
        }
    }

    pub(crate) fn remove(&mut self, id: BodyId) {
        for stream in &mut self.streams {
            stream.remove(id);
        }
    }

    pub(crate) fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        for stream in &mut self.streams {
            if let Source::Reckoned(publisher) = &mut stream.source {
                publisher.change_gravity(since, gravity);
            }
        }
    }

    pub(crate) fn publish(&mut self, at: &Moment<'_>) {
        self.witness.observe(at.tick, at.observations);
        for stream in &mut self.streams {
            stream.publish(at, &self.witness);
        }
    }
}
