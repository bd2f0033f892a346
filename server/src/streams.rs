//! The streams of one scene: each said once, however many follow it.

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::limits::STREAMS_PER_SCENE_MAX;
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::stream::{FullPublisher, Manner, Observation, Publisher, PublisherStatistics};
use rhumb_reckoning::{BodyId, Tick, Tolerance, Track, Verbatim};

/// One stream at its source.
#[derive(Debug)]
pub(crate) enum Source {
    Reckoned(Box<Publisher>),
    Full(FullPublisher),
}

/// A stream, who wants it, and how long it has been silent.
#[derive(Debug)]
pub(crate) struct Stream {
    pub(crate) choice: StreamChoice,
    source: Source,
    followers: usize,
    silent_ticks: u32,
    /// The datagrams of the last tick.
    pub(crate) packets: Vec<Bytes>,
}

impl Stream {
    pub(crate) fn id(&self) -> StreamId {
        match &self.source {
            Source::Reckoned(publisher) => publisher.stream(),
            Source::Full(publisher) => publisher.stream(),
        }
    }

    pub(crate) fn tolerance(&self) -> Tolerance {
        match self.choice {
            StreamChoice::Within(tolerance) => tolerance,
            // A full stream promises the bits; the grid of this tolerance is never used.
            StreamChoice::Full => Tolerance::LEAST,
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
            Source::Full(publisher) => publisher.place(id, motion, track.is_resting()),
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

    pub(crate) fn repair(&self, number: u64, notices: u64) -> Option<Vec<Bytes>> {
        match &self.source {
            Source::Reckoned(publisher) => publisher.repair(number, notices),
            Source::Full(publisher) => publisher.repair(number, notices),
        }
    }

    /// Says what must be said at a tick. A silent stream vouches ever more rarely, within bounds.
    fn publish(&mut self, at: &Moment<'_>) {
        self.packets.clear();
        match &mut self.source {
            Source::Reckoned(publisher) => {
                publisher.publish(at.tick, at.observations, at.notices, &mut self.packets);
            }
            Source::Full(publisher) => {
                publisher.publish(at.tick, at.observations, at.notices, &mut self.packets);
            }
        }
        if !self.packets.is_empty() {
            self.silent_ticks = 0;
            return;
        }
        self.silent_ticks += 1;
        let due = self.silent_ticks.is_power_of_two() && self.silent_ticks < at.vouch_within;
        if due || self.silent_ticks.is_multiple_of(at.vouch_within) {
            self.packets.push(self.vouch(at.notices));
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
    /// A silent stream vouches at least once in so many ticks: one where somebody waits for this very tick.
    pub(crate) vouch_within: u32,
}

/// All streams of a scene that somebody follows.
#[derive(Debug, Default)]
pub(crate) struct Streams {
    streams: Vec<Stream>,
}

impl Streams {
    pub(crate) fn get(&self, id: StreamId) -> Option<&Stream> {
        self.streams.iter().find(|stream| stream.id() == id)
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
            silent_ticks: 0,
            packets: Vec::new(),
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
        for stream in &mut self.streams {
            stream.publish(at);
        }
    }
}
