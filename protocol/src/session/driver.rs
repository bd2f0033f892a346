//! A member's own stream to its server: how the bodies that it drives move.
//!
//! The publisher's end. Does not know by which lane its packets go. Invariant: after `publish` the server, once it has
//! heard all of it, believes each body within the tolerance of what was said here.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use bytes::Bytes;
use glam::Vec3;
use rhumb_reckoning::{BodyId, Integrator, Tick, Tolerance, Verbatim};

use super::cadence::Cadence;
use crate::limits::TICK_JUMP_MAX;
use crate::message::Driving;
use crate::packet::{Doubt, Echo, Head, Kind};
use crate::scene;
use crate::stream::{
    Activity, Features, Losses, Manner, Observation, Publisher, PublisherStatistics, Reassurance,
    StreamTerms, Witness,
};
use crate::time::{Instant, Span};
use crate::wire::Wire;
use crate::wire::bytes::Reader;

/// A body that is driven.
#[derive(Clone, Copy, Debug)]
struct Body {
    /// None once it has left the scene.
    id: Option<BodyId>,
    /// Where it was said to be last.
    latest: Verbatim,
    /// Since when it has stood there.
    still_since: Tick,
}

/// What was done with the truth of a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Told {
    /// It was compared with what was said, and said as far as that was needed.
    Yes,
    /// A tick as new was told before.
    Before,
    /// The tick lies so far ahead that the stream must begin anew.
    TooFar,
}

/// The only listener.
const SERVER: u64 = 0;

/// The stream at its source.
#[derive(Debug)]
pub(crate) struct Driver {
    publisher: Publisher,
    /// What the server loses.
    losses: Losses,
    witness: Witness,
    /// In rising order of id. The place is the index in the stream.
    bodies: Vec<Body>,
    seen: Vec<Observation>,
    cadence: Cadence,
    /// The tick of the newest packet, and the length of silence since that is vouched for next, in ticks.
    spoken: Tick,
    vouch_at: u64,
    /// When the sum over all tracks was last said, and what it was.
    digest: (Tick, u64),
    /// When each lost packet was last made good.
    answered: BTreeMap<u64, Instant>,
}

/// What the source of an upstream may use: nothing pulls at what no engine moves, and no body holds another.
const FEATURES: Features = Features {
    ballistic: false,
    tumbling: false,
    held: false,
    ..Features::ALL
};

/// There is only one count of notices in an upstream, and it stays there.
const NOTICES: u64 = 0;

impl Driver {
    /// A stream as the server has granted it. `manner` says what predictors need to know of a body that is there.
    pub(crate) fn new(
        driving: &Driving,
        tolerance: Tolerance,
        integrator: Integrator,
        manner: impl Fn(BodyId) -> Option<Manner>,
    ) -> Self {
        let terms = StreamTerms {
            tolerance,
            integrator,
            every: scene::Cadence::EACH_TICK.every,
            gravity: Vec3::ZERO,
            features: FEATURES,
        };
        let mut publisher = Publisher::new(driving.stream, &terms, driving.tick);
        let mut bodies = Vec::with_capacity(driving.bodies.len());
        for (id, motion) in &driving.bodies {
            let index = BodyId::new(bodies.len() as u32, 0);
            let track = driving.first_track(*motion);
            let placed = manner(*id).is_some_and(|manner| publisher.place(index, &manner, track));
            bodies.push(Body {
                id: placed.then_some(*id),
                latest: *motion,
                still_since: driving.tick,
            });
        }
        Self {
            publisher,
            witness: Witness::new(scene::Cadence::EACH_TICK),
            bodies,
            seen: Vec::new(),
            cadence: Cadence::of(integrator.rate),
            spoken: driving.tick,
            vouch_at: Cadence::of(integrator.rate).vouch_after(0),
            digest: (driving.tick, 0),
            answered: BTreeMap::new(),
            losses: Losses::default(),
        }
    }

    /// The bodies that it drives, in rising order.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.bodies.iter().filter_map(|body| body.id)
    }

    /// What it said so far.
    pub(crate) const fn statistics(&self) -> PublisherStatistics {
        self.publisher.statistics()
    }

    /// A body has left the scene. Its track stays, since the server does not know at the same tick.
    pub(crate) fn remove(&mut self, id: BodyId) {
        for body in &mut self.bodies {
            body.id = body.id.filter(|known| *known != id);
        }
    }

    /// Takes in the truth of a tick, and appends the packets that it takes. Bodies that are not named stand still where
    /// they were named last.
    pub(crate) fn publish(
        &mut self,
        tick: Tick,
        motions: &[(BodyId, Verbatim)],
        out: &mut Vec<Bytes>,
    ) -> Told {
        let before = self.publisher.tick();
        if tick <= before {
            return Told::Before;
        }
        if tick.value() - before.value() > TICK_JUMP_MAX {
            return Told::TooFar;
        }
        let named: BTreeMap<BodyId, Verbatim> = motions.iter().copied().collect();
        self.seen.clear();
        for (place, body) in self.bodies.iter_mut().enumerate() {
            let Some(id) = body.id else { continue };
            let motion = named.get(&id).copied();
            let motion = motion.unwrap_or_else(|| body.latest.stilled());
            if motion != body.latest || motion != motion.stilled() {
                body.still_since = tick;
            }
            body.latest = motion;
            let still = tick.since(body.still_since);
            let rests = still.is_none_or(|ticks| ticks >= self.cadence.second);
            self.seen.push(Observation {
                id: BodyId::new(place as u32, 0),
                motion,
                activity: if rests {
                    Activity::Asleep
                } else {
                    Activity::Awake
                },
            });
        }
        self.witness.observe(tick, &self.seen);
        let first = out.len();
        self.publisher.publish(&self.witness, NOTICES, out);
        self.close_tick(tick, out.len() > first, out);
        let redundancy = self.losses.redundancy(1, self.publisher.next_number());
        self.publisher.say_parities(redundancy, out);
        Told::Yes
    }

    /// Says what is due at the end of a tick: a sum over all tracks, or a vouch for silence.
    fn close_tick(&mut self, tick: Tick, spoke: bool, out: &mut Vec<Bytes>) {
        if spoke {
            self.spoken = tick;
            self.vouch_at = self.cadence.vouch_after(0);
            out.extend(self.due_digest(tick));
            return;
        }
        let silence = tick.value() - self.spoken.value();
        if silence >= self.vouch_at {
            self.vouch_at = self.cadence.vouch_after(silence);
            // A digest vouches too.
            let digest = self.due_digest(tick);
            out.push(digest.unwrap_or_else(|| self.publisher.vouch(NOTICES)));
        }
    }

    fn due_digest(&mut self, tick: Tick) -> Option<Bytes> {
        let (last, sum) = self.digest;
        if tick.since(last)? < self.cadence.second || self.publisher.agreement() == sum {
            return None;
        }
        self.digest = (tick, self.publisher.agreement());
        Some(self.publisher.digest(NOTICES))
    }

    /// Whether a datagram names this stream.
    pub(crate) fn is_about(&self, datagram: &[u8]) -> bool {
        let head = Head::decode(&mut Reader::new(datagram));
        head.is_ok_and(|head| head.stream == self.publisher.stream())
    }

    /// Answers what the server says of this stream: what it lost, or what it believes otherwise. A packet that was made
    /// good less than a round trip ago is not again.
    pub(crate) fn handle_datagram(
        &mut self,
        now: Instant,
        round_trip: Span,
        datagram: &[u8],
        out: &mut Vec<Bytes>,
    ) {
        let mut reader = Reader::new(datagram);
        let Ok(head) = Head::decode(&mut reader) else {
            return;
        };
        match head.kind {
            Kind::Echo => {
                if let Ok(echo) = Echo::decode(reader) {
                    self.answer(now, round_trip, &echo, out);
                }
            }
            Kind::Doubt => {
                let doubt = Doubt::decode(reader);
                match doubt.map(|doubt| self.publisher.reassure(doubt, NOTICES)) {
                    Ok(Reassurance::Sums(datagram)) => out.push(datagram),
                    Ok(Reassurance::Amendment(_, datagrams)) => out.extend(datagrams),
                    Err(_) => {}
                }
            }
            _ => {}
        }
    }

    fn answer(&mut self, now: Instant, round_trip: Span, echo: &Echo, out: &mut Vec<Bytes>) {
        self.answered.retain(|_, at| now < *at + round_trip);
        self.losses.hear(SERVER, echo, self.publisher.next_number());
        for number in self.publisher.answer(echo, out) {
            if self.answered.contains_key(&number) {
                continue;
            }
            // One that is forgotten is not repaired: the vouch tells how much was missed.
            if let Some(datagrams) = self.publisher.repair(number, NOTICES) {
                out.extend(datagrams);
                self.answered.insert(number, now);
            }
        }
        out.push(self.publisher.vouch(NOTICES));
    }
}
