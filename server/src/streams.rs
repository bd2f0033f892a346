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

use crate::arrears::Arrears;
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
    arrears: Arrears,
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
        // What was said unasked so far went to who was known to lose packets then.
        let sent_from = self.losses.loses_from(peer.0);
        self.losses.hear(peer.0, echo, next);
        let mut datagrams = Vec::new();
        let lost: BTreeSet<u64> = match &mut self.source {
            Source::Reckoned(publisher) => {
                let lost = publisher.answer_one(echo, sent_from, &mut datagrams);
                lost.into_iter().collect()
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
    fn publish(&mut self, at: &Moment, witness: &Witness) {
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
        if let Source::Reckoned(publisher) = &self.source {
            self.arrears.tell(publisher, at.second);
        }
        self.vouch_or_sum_up(at);
        let redundancy = self.losses.redundancy(self.followers, self.next_number());
        if let Source::Reckoned(publisher) = &mut self.source {
            publisher.say_parities(redundancy, &mut self.parities);
        }
    }

    /// What goes with the packets of a tick, or in place of them.
    fn vouch_or_sum_up(&mut self, at: &Moment) {
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

    /// What says the sum over all tracks, if that is another than the one said last, and that is a second ago.
    fn due_digest(&mut self, at: &Moment) -> Option<Bytes> {
        let Source::Reckoned(publisher) = &mut self.source else {
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
        let digest = publisher.digest(at.notices);
        publisher.pay(digest.len());
        Some(digest)
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

/// The circumstances of what is said of a tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
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
            .filter(|stream| stream.losses.loses(peer.0))
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
            arrears: Arrears::default(),
            packets: Vec::new(),
            parities: Vec::new(),
            losses: Losses::default(),
            repairs: BTreeMap::new(),
        });
        self.streams.last_mut().expect("one was just added")
    }

    /// A member is told a stream from a snapshot on: what it lost before it counts no more.
    pub(crate) fn tell_anew(&mut self, id: StreamId, peer: Peer) {
        if let Some(stream) = self.get_mut(id) {
            stream.losses.forget(peer.0);
        }
    }

    /// A member follows a stream no more; one that nobody follows ends.
    pub(crate) fn unfollow(&mut self, id: StreamId, peer: Peer) {
        if let Some(stream) = self.get_mut(id) {
            stream.followers -= 1;
            stream.losses.forget(peer.0);
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

    /// Keeps what was seen after a tick, as far as somebody will look at it.
    pub(crate) fn observe(&mut self, tick: Tick, observations: &[Observation]) {
        self.witness.observe(tick, observations);
    }

    /// Says what must be said of a tick that was observed.
    pub(crate) fn publish(&mut self, at: &Moment) {
        for stream in &mut self.streams {
            stream.publish(at, &self.witness);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rhumb_protocol::packet::{Head, Kind, Low16};
    use rhumb_protocol::stream::{Activity, Budget};
    use rhumb_protocol::wire::Wire;
    use rhumb_protocol::wire::bytes::Reader;
    use rhumb_reckoning::{Integrator, Metres, Rate};
    use std::io::{self, Write};
    use std::num::NonZeroU32;
    use std::sync::{Arc, Mutex};

    const BODIES: u32 = 50;
    const STREAM: StreamId = StreamId(1);
    const SECOND: u64 = 60;
    const BURST: u32 = 1_150;

    /// Where a body is at a tick: somewhere else each time.
    fn motion(body: u32, tick: u64) -> Verbatim {
        let far = |axis: u64| {
            let seed = (tick << 16) + (u64::from(body) << 4) + axis + 1;
            let mixed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 10.0
        };
        let at = [far(0), far(1), far(2)];
        Verbatim::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("it is finite")
    }

    /// One stream with a budget, of bodies that never rest.
    fn capped(bytes_per_second: u32) -> Streams {
        let budget = Budget::new(bytes_per_second, BURST).expect("within the limits");
        let tolerance = Tolerance::NORMAL;
        let terms = StreamTerms {
            tolerance,
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::MIN,
            },
            every: Cadence::EACH_TICK.every,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(STREAM, &terms, Tick::ZERO);
        publisher.limit(budget);
        let mut streams = Streams::new(Cadence::EACH_TICK);
        let choice = StreamChoice::Capped { tolerance, budget };
        streams.begin(choice, Source::Reckoned(Box::new(publisher)));
        for body in 0..BODIES {
            let manner = Manner::plain(Metres::new(0.5));
            let begun = motion(body, 0);
            let track = Track::resting(Tick::ZERO, begun);
            streams.place(BodyId::new(body, 0), &manner, track, begun);
        }
        streams
    }

    /// Has a tick published.
    fn publish(streams: &mut Streams, tick: u64) {
        let seen = |body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, tick),
            activity: Activity::Awake,
        };
        let observations: Vec<_> = (0..BODIES).map(seen).collect();
        streams.observe(Tick::new(tick), &observations);
        streams.publish(&Moment {
            notices: 0,
            vouch_within: 150,
            second: Ticks::new(SECOND as u32),
        });
    }

    /// What is logged, as text.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<u8>>>);

    impl Write for Log {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().expect("nobody panics").write(bytes)
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    /// What is logged at a level while a stream with little budget is published for so many seconds; and that stream.
    fn logged(level: tracing::Level, seconds: u64) -> (String, Streams) {
        let log = Log::default();
        let writer = log.clone();
        let subscriber = tracing_subscriber::fmt()
            .with_ansi(false)
            .with_max_level(level)
            .with_writer(move || writer.clone())
            .finish();
        let mut streams = capped(600);
        tracing::subscriber::with_default(subscriber, || {
            for tick in 1..=seconds * SECOND {
                publish(&mut streams, tick);
            }
        });
        let text = String::from_utf8(log.0.lock().expect("nobody panics").clone());
        (text.expect("a log is text"), streams)
    }

    #[test]
    fn who_is_worst_off_for_want_of_budget_is_logged_once_a_second() {
        let (text, _) = logged(tracing::Level::INFO, 5);
        let lines: Vec<_> = text.lines().collect();
        assert!((4..=5).contains(&lines.len()), "{text}");
        for line in &lines {
            let fields = ["waiting=", "body=", "share=", "ticks=", "cause=\"budget\""];
            for field in fields {
                assert!(line.contains(field), "{line}");
            }
        }
    }

    #[test]
    fn whoever_is_off_for_want_of_budget_is_logged_where_every_trace_is_asked_for() {
        let (text, streams) = logged(tracing::Level::TRACE, 1);
        let lines = text.lines().filter(|line| line.contains("a body is off"));
        let lines: Vec<_> = lines.collect();
        let Source::Reckoned(publisher) = &streams.streams[0].source else {
            panic!("it has a budget");
        };
        let withheld = publisher.statistics().withheld;
        assert!(withheld > 0 && lines.len() as u64 == withheld, "{withheld}");
        for line in &lines {
            let fields = ["tick=", "body=", "share=", "ticks=", "cause=\"budget\""];
            for field in fields {
                assert!(line.contains(field), "{line}");
            }
        }
    }

    #[test]
    fn a_budget_pays_for_the_sums_that_are_said() {
        let (rate, seconds) = (600, 20);
        let mut streams = capped(rate);
        let (mut bytes, mut sums) = (0, 0);
        for tick in 1..=seconds * SECOND {
            publish(&mut streams, tick);
            for packet in streams.packets(STREAM, Peer(0)) {
                let head = Head::decode(&mut Reader::new(packet)).expect("a head");
                let vouches = matches!(head.kind, Kind::Vouch | Kind::VouchInArrears);
                bytes += if vouches { 0 } else { packet.len() };
                sums += u64::from(head.kind == Kind::Digest);
            }
        }
        assert!(sums >= seconds - 2, "{sums}");
        // A word and a sum may overdraw.
        let most = BURST as usize + (seconds as usize) * rate as usize + 100;
        assert!(bytes <= most, "{bytes} of {most}");
        assert!(
            bytes + 200 > most,
            "a tight budget is used: {bytes} of {most}"
        );
    }

    #[test]
    fn what_two_members_lost_is_encoded_once_for_both() {
        let mut streams = capped(100_000);
        publish(&mut streams, 1);
        let stream = &mut streams.streams[0];
        let next = stream.next_number();
        let echo = Echo {
            next: Low16::of(next),
            gone: Low16::of(1),
            parities: 0,
            lost: vec![Low16::of(next - 1)],
        };
        let [one, other] = [1, 2].map(|member| stream.answer(Peer(member), &echo, 0));
        assert!(one.len() > 1, "a repair, and a vouch behind it");
        for (one, other) in one[..one.len() - 1].iter().zip(&other) {
            assert_eq!(one.as_ptr(), other.as_ptr(), "the same bytes, not a copy");
        }
    }
}
