//! A publisher and a subscriber over a bad network: what always holds.
//!
//! Proved on random motions with seeded loss, disorder and copies: whenever the stream is settled, track equals track to
//! the bit; whatever the subscriber bounds lies within its bound; when the losses stop, everything becomes known.

use std::collections::VecDeque;

use bytes::Bytes;
use glam::{DQuat, DVec3, Vec3};
use proptest::prelude::*;
use rhumb_protocol::packet::{Head, Kind, Parity, StreamId};
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Bound, Features, Manner, Observation, Publisher, Reassurance, Redundancy,
    StreamTerms, Subscriber, Witness,
};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{
    Anchor, BodyId, Class, Damping, Divergence, Integrator, Metres, Predictor, Radians, Rate, Tick,
    Tolerance, Track, Verbatim,
};

const BODIES: u32 = 24;
const GRAVITY: Vec3 = Vec3::new(0.0, -9.8, 0.0);

/// A small deterministic generator, so that a failure's numbers say all.
struct Dice(u64);

impl Dice {
    fn roll(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as f64) / f64::from(1_u32 << 31)
    }

    fn around_zero(&mut self) -> f64 {
        self.roll() * 2.0 - 1.0
    }

    fn vector(&mut self) -> DVec3 {
        DVec3::new(self.around_zero(), self.around_zero(), self.around_zero())
    }
}

/// A body that flies, is struck, slides and comes to rest.
#[derive(Clone, Copy)]
struct Puppet {
    position: DVec3,
    rotation: DQuat,
    linear: DVec3,
    angular: DVec3,
    asleep: bool,
}

impl Puppet {
    fn new(dice: &mut Dice) -> Self {
        Self {
            position: dice.vector() * 20.0,
            rotation: DQuat::IDENTITY,
            linear: DVec3::ZERO,
            angular: DVec3::ZERO,
            asleep: false,
        }
    }

    fn step(&mut self, dice: &mut Dice) {
        let fate = dice.roll();
        if fate < 0.02 {
            self.linear += dice.vector() * 6.0;
            self.angular += dice.vector() * 8.0;
            self.asleep = false;
        } else if fate < 0.03 {
            (self.linear, self.angular, self.asleep) = (DVec3::ZERO, DVec3::ZERO, true);
        }
        if !self.asleep {
            self.linear += GRAVITY.as_dvec3() / 60.0;
            if self.position.y < 0.0 {
                self.linear.y = self.linear.y.max(0.0);
            }
            self.position += self.linear / 60.0;
            self.rotation =
                (DQuat::from_scaled_axis(self.angular / 60.0) * self.rotation).normalize();
        }
    }

    fn verbatim(&self) -> Verbatim {
        let [x, y, z, w] = self.rotation.as_quat().to_array();
        Verbatim::new(
            self.position.as_vec3().to_array(),
            [x, y, z, w],
            self.linear.as_vec3().to_array(),
            self.angular.as_vec3().to_array(),
        )
        .expect("a puppet's motion is finite")
    }
}

fn integrator() -> Integrator {
    Integrator {
        rate: Rate::HZ_60,
        substeps: std::num::NonZeroU32::new(4).expect("four is not zero"),
    }
}

/// Of every body another class than its neighbour's.
fn manner(index: usize) -> Manner {
    Manner {
        radius: Metres::new(0.5),
        damping: Damping::default(),
        gravity_scale: 1.0,
        inertia: None,
        class: Class::new((index % 7) as i8 - 3).expect("there are seven classes"),
    }
}

struct Stage {
    dice: Dice,
    puppets: Vec<Puppet>,
    /// Where they were after each tick.
    past: Vec<Vec<Verbatim>>,
    witness: Witness,
    publisher: Publisher,
    subscriber: Subscriber,
    /// What is on its way, by the tick at which it arrives.
    air: VecDeque<(u64, Bytes)>,
    loss: f64,
    redundancy: Redundancy,
    tick: u64,
    worst: f64,
}

impl Stage {
    fn new(seed: u64, tolerance: Tolerance, loss: f64) -> Self {
        let mut dice = Dice(seed);
        let puppets: Vec<_> = (0..BODIES).map(|_| Puppet::new(&mut dice)).collect();
        let stream = StreamId(3);
        let terms = StreamTerms {
            tolerance,
            integrator: integrator(),
            every: Cadence::EACH_TICK.every,
            gravity: GRAVITY,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(stream, &terms, Tick::ZERO);
        let mut subscriber = Subscriber::new(&terms.start(stream, Tick::ZERO));
        for (index, puppet) in puppets.iter().enumerate() {
            let (id, manner) = (BodyId::new(index as u32, 0), manner(index));
            let track = Track {
                origin: Tick::ZERO,
                predictor: Predictor::Ballistic,
                anchor: Anchor::Verbatim(puppet.verbatim()),
                carrier: None,
            };
            assert!(publisher.place(id, &manner, track));
            assert!(subscriber.place(id, &manner, track));
        }
        subscriber.handle_snapshot_end();
        Self {
            dice,
            past: vec![puppets.iter().map(Puppet::verbatim).collect()],
            puppets,
            witness: Witness::new(Cadence::EACH_TICK),
            publisher,
            subscriber,
            air: VecDeque::new(),
            loss,
            redundancy: [
                Redundancy::Off,
                Redundancy::Thin,
                Redundancy::Plain,
                Redundancy::Thick,
            ][seed as usize % 4],
            tick: 0,
            worst: 0.0,
        }
    }

    /// Sends a datagram: maybe lost, maybe late, maybe twice.
    fn send(&mut self, datagram: &Bytes) {
        if self.dice.roll() < self.loss {
            return;
        }
        let copies = if self.dice.roll() < self.loss / 2.0 {
            2
        } else {
            1
        };
        for _ in 0..copies {
            let delay = if self.loss > 0.0 {
                (self.dice.roll() * 4.0) as u64
            } else {
                0
            };
            self.air.push_back((self.tick + delay, datagram.clone()));
        }
    }

    fn step(&mut self) {
        self.tick += 1;
        let mut observations = Vec::new();
        for (index, puppet) in self.puppets.iter_mut().enumerate() {
            let slept = puppet.asleep;
            puppet.step(&mut self.dice);
            if !(slept && puppet.asleep) {
                observations.push(Observation {
                    id: BodyId::new(index as u32, 0),
                    motion: puppet.verbatim(),
                    activity: if puppet.asleep {
                        Activity::Asleep
                    } else {
                        Activity::Awake
                    },
                });
            }
        }
        self.past
            .push(self.puppets.iter().map(Puppet::verbatim).collect());
        let mut datagrams = Vec::new();
        self.witness.observe(Tick::new(self.tick), &observations);
        self.publisher.publish(&self.witness, 0, &mut datagrams);
        if datagrams.is_empty() {
            datagrams.push(self.publisher.vouch(0));
        }
        if self.tick.is_multiple_of(10) {
            datagrams.push(self.publisher.digest(0));
        }
        self.publisher.say_parities(self.redundancy, &mut datagrams);
        for datagram in &datagrams {
            self.send(datagram);
        }
        self.deliver();
        if self.tick.is_multiple_of(5) {
            self.echo();
        }
    }

    fn deliver(&mut self) {
        let now = self.tick;
        let (due, later): (Vec<_>, Vec<_>) = self.air.drain(..).partition(|(at, _)| *at <= now);
        self.air.extend(later);
        for (_, datagram) in due {
            self.subscriber.handle_datagram(&datagram);
        }
    }

    fn echo(&mut self) {
        let echo = self.subscriber.echo();
        if self.dice.roll() < self.loss {
            return;
        }
        let mut parities = Vec::new();
        let lost = self.publisher.answer(&echo, &mut parities);
        for datagram in &parities {
            self.send(datagram);
        }
        for number in lost {
            for datagram in self
                .publisher
                .repair(number, 0)
                .expect("the history is long enough")
            {
                self.send(&datagram);
            }
        }
        let vouch = self.publisher.vouch(0);
        self.send(&vouch);
    }

    /// One packet, of these bodies, which are put elsewhere; it is not sent.
    fn say_of(&mut self, moved: impl Iterator<Item = usize>, notices: u64) -> Bytes {
        self.tick += 1;
        let mut observations = Vec::new();
        for index in moved {
            self.puppets[index].position += DVec3::X;
            observations.push(Observation {
                id: BodyId::new(index as u32, 0),
                motion: self.puppets[index].verbatim(),
                activity: Activity::Awake,
            });
        }
        let mut datagrams = Vec::new();
        self.witness.observe(Tick::new(self.tick), &observations);
        self.publisher
            .publish(&self.witness, notices, &mut datagrams);
        assert_eq!(datagrams.len(), 1, "a packet");
        datagrams.remove(0)
    }

    fn check(&mut self) -> Result<(), TestCaseError> {
        let vouched = self.subscriber.vouched();
        let current = vouched == Tick::new(self.tick);
        let radius = Metres::new(0.5);
        for (id, track) in self.publisher.tracks() {
            let Some(bound) = self.subscriber.bound(id) else {
                return Err(TestCaseError::fail("a body is not bounded at all"));
            };
            let Bound::Within(within) = bound else {
                continue;
            };
            if current {
                let copy = self.subscriber.track(id);
                prop_assert_eq!(copy, Some(track), "{} at {}", id, vouched);
            }
            let truth = self.past[vouched.value() as usize][id.index() as usize];
            let believed = self
                .subscriber
                .believed(id, vouched)
                .expect("a body that is bounded is believed");
            let apart = Divergence::between(&truth.motion().pose(), &believed.pose());
            let class = manner(id.index() as usize).class;
            let tolerance = self.publisher.tolerance().of_class(class);
            let error = apart.surface_error(radius);
            self.worst = self.worst.max(error.metres());
            prop_assert!(error <= within, "{} is off by {} at {}", id, error, vouched);
            prop_assert!(tolerance.share(&apart, radius) <= 1.0);
        }
        if current && self.subscriber.is_settled() {
            prop_assert_eq!(self.subscriber.agreement(), self.publisher.agreement());
        }
        let heard = self.subscriber.statistics();
        prop_assert_eq!(
            (heard.malformed, heard.mismatches, heard.amended),
            (0, 0, 0)
        );
        Ok(())
    }
}

/// What is rebuilt speaks of a body that nobody has heard of yet, and a late packet comes between.
#[test]
fn what_is_rebuilt_before_its_notice_is_read_after_it() {
    let mut stage = Stage::new(1, Tolerance::NORMAL, 0.0);
    let first = stage.say_of(0..3, 0);
    let late = stage.say_of(0..3, 0);
    let (id, manner) = (BodyId::new(BODIES, 0), manner(0));
    let newcomer = Puppet::new(&mut stage.dice);
    let track = Track {
        origin: Tick::new(stage.tick),
        predictor: Predictor::Rest,
        anchor: Anchor::Verbatim(newcomer.verbatim()),
        carrier: None,
    };
    stage.puppets.push(newcomer);
    assert!(stage.publisher.place(id, &manner, track));
    let lost = stage.say_of(2..BODIES as usize + 1, 1);
    let parity = Parity::of(3, &[(0, &first), (2, &lost)]).expect("both have columns");
    let subscriber = &mut stage.subscriber;
    subscriber.handle_datagram(&first);
    subscriber.handle_datagram(&parity.encode(subscriber.stream()));
    subscriber.handle_datagram(&late);
    assert!(!subscriber.is_settled());
    assert!(subscriber.place(id, &manner, track));
    subscriber.handle_notice();
    assert!(subscriber.is_settled());
    assert_eq!(subscriber.complete(), Tick::new(stage.tick));
    let track = |of| stage.publisher.tracks().find(|(other, _)| *other == of);
    assert_eq!(subscriber.track(id), track(id).map(|(_, track)| track));
    assert_eq!(subscriber.agreement(), stage.publisher.agreement());
}

fn tolerance() -> impl Strategy<Value = Tolerance> {
    prop_oneof![
        Just(Tolerance::EXACT),
        Just(Tolerance::FINE),
        Just(Tolerance::NORMAL),
        Just(Tolerance::COARSE),
        Just(Tolerance::parts(Metres::new(0.01), Radians::new(0.002)).expect("within bounds")),
        Just(Tolerance::parts(Metres::new(0.002), Radians::new(3.1)).expect("within bounds"))
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn without_loss_track_equals_track_at_every_tick(seed: u64, tolerance in tolerance()) {
        let mut stage = Stage::new(seed, tolerance, 0.0);
        for _ in 0..300 {
            stage.step();
            prop_assert_eq!(stage.subscriber.complete(), Tick::new(stage.tick));
            stage.check()?;
        }
        prop_assert!(stage.worst > 0.0);
        prop_assert_eq!(stage.subscriber.statistics().compared, 30);
    }

    #[test]
    fn a_track_that_is_another_is_named_and_made_right(seed: u64, place in 0..BODIES, still: bool) {
        let mut stage = Stage::new(seed, Tolerance::NORMAL, 0.0);
        for _ in 0..30 {
            stage.step();
        }
        // A track that the publisher never said: of this body it may just have said that it rests where it is.
        let elsewhere = Puppet {
            position: stage.puppets[0].position + DVec3::X,
            ..stage.puppets[0]
        };
        let track = Track {
            origin: Tick::new(stage.tick + u64::from(still)),
            predictor: Predictor::Rest,
            anchor: Anchor::Verbatim(elsewhere.verbatim().stilled()),
            carrier: None,
        };
        let id = BodyId::new(place, 0);
        prop_assert!(stage.subscriber.place(id, &manner(place as usize), track));
        prop_assert_ne!(stage.subscriber.agreement(), stage.publisher.agreement());
        stage.subscriber.handle_datagram(&stage.publisher.digest(0));
        let mut asked = 0;
        while let Some(doubt) = stage.subscriber.doubt() {
            asked += 1;
            prop_assert!(asked <= 4, "the search does not end");
            match stage.publisher.reassure(doubt, 0) {
                Reassurance::Sums(datagram) => stage.subscriber.handle_datagram(&datagram),
                Reassurance::Amendment(named, datagrams) => {
                    prop_assert_eq!(named, Some(id));
                    datagrams.iter().for_each(|datagram| stage.subscriber.handle_datagram(datagram));
                }
            }
        }
        prop_assert_eq!(stage.subscriber.poll_amended(), Some(id));
        prop_assert_eq!(stage.subscriber.poll_amended(), None);
        let heard = stage.subscriber.statistics();
        prop_assert_eq!((heard.mismatches, heard.amended, heard.malformed), (1, 1, 0));
        prop_assert_eq!(stage.subscriber.agreement(), stage.publisher.agreement());
        prop_assert_eq!(stage.subscriber.track(id), stage.publisher.tracks().find(|(of, _)| *of == id).map(|(_, track)| track));
    }

    #[test]
    fn with_loss_every_bound_that_is_given_holds(seed: u64, tolerance in tolerance(), loss in 0.01_f64..0.4) {
        let mut stage = Stage::new(seed, tolerance, loss);
        for _ in 0..300 {
            stage.step();
            stage.check()?;
        }
        // The losses stop: within a dozen echoes all is known again. What was lost in a row and builds on one another is made
        // good one after the other, which took five echoes of one stream in a hundred at the worst losses.
        stage.loss = 0.0;
        for _ in 0..60 {
            stage.step();
        }
        prop_assert!(stage.subscriber.is_settled());
        prop_assert_eq!(stage.subscriber.complete(), Tick::new(stage.tick));
        stage.check()?;
    }

    #[test]
    fn no_bit_flipped_in_a_stream_makes_it_panic_or_leave_the_limits(seed: u64, flips in proptest::collection::vec(any::<u32>(), 40)) {
        let mut stage = Stage::new(seed, Tolerance::NORMAL, 0.0);
        for flip in flips {
            stage.step();
            let mut observations = Vec::new();
            for (index, puppet) in stage.puppets.iter_mut().enumerate() {
                puppet.linear += DVec3::X;
                let id = BodyId::new(index as u32, 0);
                observations.push(Observation { id, motion: puppet.verbatim(), activity: Activity::Awake });
            }
            let mut datagrams = Vec::new();
            stage.witness.observe(Tick::new(stage.tick), &observations);
            stage.publisher.publish(&stage.witness, 0, &mut datagrams);
            for datagram in datagrams {
                let mut damaged = datagram.to_vec();
                let bit = flip as usize % (damaged.len() * 8);
                damaged[bit / 8] ^= 1 << (bit % 8);
                stage.subscriber.handle_datagram(&damaged);
            }
            for index in 0..BODIES {
                if let Some(id) = stage.subscriber.body(index) {
                    let motion = stage.subscriber.believed(id, Tick::new(stage.tick + 30)).unwrap();
                    prop_assert!(motion.pose().position.is_finite() && motion.pose().rotation.is_finite());
                }
            }
        }
    }
}

#[test]
fn a_body_at_rest_to_the_bit_costs_nothing_more() {
    let mut stage = Stage::new(7, Tolerance::NORMAL, 0.0);
    for puppet in &mut stage.puppets {
        puppet.asleep = true;
    }
    let asleep: Vec<_> = stage
        .puppets
        .iter()
        .enumerate()
        .map(|(index, puppet)| Observation {
            id: BodyId::new(index as u32, 0),
            motion: puppet.verbatim(),
            activity: Activity::Asleep,
        })
        .collect();
    let mut datagrams = Vec::new();
    stage.witness.observe(Tick::new(1), &asleep);
    stage.publisher.publish(&stage.witness, 0, &mut datagrams);
    assert!(!datagrams.is_empty());
    for datagram in datagrams.drain(..) {
        stage.subscriber.handle_datagram(&datagram);
    }
    stage.witness.observe(Tick::new(2), &asleep);
    stage.publisher.publish(&stage.witness, 0, &mut datagrams);
    assert!(datagrams.is_empty());
    let vouch = stage.publisher.vouch(0);
    assert_eq!(
        Head::decode(&mut Reader::new(&vouch)).unwrap().kind,
        Kind::Vouch
    );
    assert!(vouch.len() < 12);
    stage.subscriber.handle_datagram(&vouch);
    assert_eq!(stage.subscriber.complete(), Tick::new(2));
    for (index, puppet) in stage.puppets.iter().enumerate() {
        let track = stage
            .subscriber
            .track(BodyId::new(index as u32, 0))
            .unwrap();
        assert_eq!(track.anchor, Anchor::Verbatim(puppet.verbatim().stilled()));
    }
    // Woken, shifted and asleep again: within tolerance nobody is told of it, beyond it everybody.
    for (tick, shift, is_said) in [(3, 0.001, false), (4, 1.0, true), (5, 0.001, false)] {
        let shifted = asleep.iter().map(|observation| {
            let mut puppet = stage.puppets[observation.id.index() as usize];
            puppet.position += DVec3::X * shift;
            Observation {
                motion: puppet.verbatim(),
                ..*observation
            }
        });
        let shifted: Vec<_> = shifted.collect();
        stage.witness.observe(Tick::new(tick), &shifted);
        stage.publisher.publish(&stage.witness, 0, &mut datagrams);
        assert_eq!(!datagrams.is_empty(), is_said, "by {shift} m");
        for datagram in datagrams.drain(..) {
            stage.subscriber.handle_datagram(&datagram);
        }
        if !is_said {
            continue;
        }
        for observation in &shifted {
            let track = stage.subscriber.track(observation.id).unwrap();
            assert_eq!(track.anchor, Anchor::Verbatim(observation.motion.stilled()));
        }
        for puppet in &mut stage.puppets {
            puppet.position += DVec3::X * shift;
        }
    }
}
