//! What hearing and showing a stream costs, by the update and by the view
//!
//! Bodies that fly, each struck every so often, at the 5 cm tier. A listener that was just told of all of them hears of a
//! tenth, whose velocities are all said; in the midst of a run, in which each body is turned back three times a second,
//! one hears twenty ticks. A view shows all of them anew, none of which rests.

use std::hint::black_box;
use std::num::NonZeroU32;
use std::time::{Duration, Instant};

use bytes::Bytes;
use glam::Vec3;
use rhumb_client::{DisplayTime, Glass, View};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Features, Manner, Observation, Publisher, StreamTerms, Subscriber, Witness,
};
use rhumb_reckoning::{
    Anchor, BodyId, Grid, Integrator, Metres, Predictor, Rate, Seconds, Snapped, Tick, Tolerance,
    Track, Verbatim,
};
use serde::{Deserialize, Serialize};

use super::least::Least;
use super::median;

const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);
const STREAM: StreamId = StreamId(0);

/// Ticks that a view shows in turn.
const SHOWN: u64 = 60;
/// Ticks of a run that are heard before the clock runs, and while it does.
const HEARD: [u64; 2] = [60, 20];
/// Of so many bodies one is struck in each tick of a run.
const STRUCK: u64 = 20;

/// One body's state at a tick; a tenth of them are struck at tick 1.
fn state(index: u32, tick: u64) -> Verbatim {
    let place = index as f32;
    let seconds = tick as f32 / 60.0;
    let struck = if index.is_multiple_of(10) && tick > 0 {
        30.0
    } else {
        0.0
    };
    let position = [place % 100.0 + struck * seconds, place / 100.0, 0.0];
    Verbatim::new(
        position,
        [0.0, 0.0, 0.0, 1.0],
        [struck, 0.0, 0.0],
        [0.0, 1.0, 0.0],
    )
    .expect("these numbers are finite")
}

fn terms() -> StreamTerms {
    StreamTerms {
        tolerance: Tolerance::NORMAL,
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        },
        every: Cadence::EACH_TICK.every,
        gravity: GRAVITY,
        features: Features::ALL,
    }
}

/// Of a body that nothing pulls at.
fn manner() -> Manner {
    Manner {
        gravity_scale: 0.0,
        ..Manner::plain(Metres::new(0.5))
    }
}

fn track(index: u32) -> Track {
    Track {
        origin: Tick::ZERO,
        predictor: Predictor::Ballistic,
        anchor: Anchor::Verbatim(state(index, 0)),
        carrier: None,
    }
}

/// One body's state in a run: to and fro, turned back each time that it is struck.
fn struck_state(index: u32, tick: u64) -> Verbatim {
    let phase = tick + u64::from(index) % STRUCK;
    let seconds = (phase % STRUCK) as f32 / 60.0;
    let back = (phase / STRUCK) % 2 == 1;
    let (speed, from) = if back {
        (-3.0, STRUCK as f32 / 20.0)
    } else {
        (3.0, 0.0)
    };
    let place = index as f32;
    Verbatim::new(
        [place % 100.0 + from + speed * seconds, place / 100.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [speed, 0.0, 0.0],
        [0.0; 3],
    )
    .expect("these numbers are finite")
}

/// A stream of so many bodies, of which nothing was said yet.
#[must_use]
pub fn publisher(bodies: u32) -> Publisher {
    let mut publisher = Publisher::new(STREAM, &terms(), Tick::ZERO);
    for index in 0..bodies {
        assert!(publisher.place(BodyId::new(index, 0), &manner(), track(index)));
    }
    publisher
}

/// Who was just told of so many bodies.
#[must_use]
pub fn subscriber(bodies: u32) -> Subscriber {
    let mut subscriber = Subscriber::new(&terms().start(STREAM, Tick::ZERO));
    for index in 0..bodies {
        assert!(subscriber.place(BodyId::new(index, 0), &manner(), track(index)));
    }
    subscriber.handle_snapshot_end();
    subscriber
}

/// What the first tick shows, at which a tenth of the bodies was struck.
#[must_use]
pub fn first_tick(bodies: u32) -> Witness {
    let seen = |index| Observation {
        id: BodyId::new(index, 0),
        motion: state(index, 1),
        activity: Activity::Awake,
    };
    let mut witness = Witness::new(Cadence::EACH_TICK);
    witness.observe(Tick::new(1), &(0..bodies).map(seen).collect::<Vec<_>>());
    witness
}

/// Who hears, and what.
#[derive(Clone, Debug)]
pub struct Audience {
    /// Before it hears.
    pub listener: Subscriber,
    /// In order.
    pub datagrams: Vec<Bytes>,
    /// How many updates they hold.
    pub updates: u64,
}

impl Audience {
    fn of(listener: Subscriber, datagrams: Vec<Bytes>) -> Self {
        let mut audience = Self {
            listener,
            datagrams,
            updates: 0,
        };
        let mut heard = audience.listener.clone();
        audience.hear(&mut heard);
        let updates = |of: &Subscriber| of.statistics().updates;
        audience.updates = updates(&heard) - updates(&audience.listener);
        audience
    }

    /// Who was just told of so many bodies, and hears of a tenth.
    #[must_use]
    pub fn new(bodies: u32) -> Self {
        let mut datagrams = Vec::new();
        publisher(bodies).publish(&first_tick(bodies), 0, &mut datagrams);
        Self::of(subscriber(bodies), datagrams)
    }

    /// Who is in the midst of a run, and hears what follows.
    #[must_use]
    pub fn in_the_midst(bodies: u32) -> Self {
        let (mut publisher, mut subscriber) = (publisher(bodies), subscriber(bodies));
        let mut witness = Witness::new(Cadence::EACH_TICK);
        let mut following = Vec::new();
        for tick in 1..=HEARD[0] + HEARD[1] {
            let seen = |index| Observation {
                id: BodyId::new(index, 0),
                motion: struck_state(index, tick),
                activity: Activity::Awake,
            };
            witness.observe(Tick::new(tick), &(0..bodies).map(seen).collect::<Vec<_>>());
            let mut said = Vec::new();
            publisher.publish(&witness, 0, &mut said);
            if tick > HEARD[0] {
                following.extend(said);
                continue;
            }
            for datagram in &said {
                subscriber.handle_datagram(datagram);
            }
            subscriber.forget_before(Tick::new(tick));
        }
        Self::of(subscriber, following)
    }

    /// Hears everything.
    pub fn hear(&self, listener: &mut Subscriber) {
        for datagram in &self.datagrams {
            listener.handle_datagram(datagram);
        }
    }

    fn measure(&self, repeats: u32) -> f64 {
        let once = || {
            let mut listener = self.listener.clone();
            let begun = Instant::now();
            self.hear(&mut listener);
            let took = begun.elapsed();
            black_box(listener);
            took
        };
        let took = median((0..repeats).map(|_| once()));
        took.as_nanos() as f64 / self.updates.max(1) as f64
    }
}

/// Shows all of a stream's bodies at the next of sixty ticks, over and over.
#[derive(Debug)]
pub struct Show {
    subscriber: Subscriber,
    view: View,
    tick: u64,
}

impl Show {
    /// Of so many bodies.
    #[must_use]
    pub fn new(bodies: u32) -> Self {
        Self {
            subscriber: subscriber(bodies),
            view: View::default(),
            tick: 0,
        }
    }

    /// Shows the next tick.
    pub fn refresh(&mut self) {
        self.tick = (self.tick + 1) % SHOWN;
        let glass = Glass {
            at: DisplayTime::at(Tick::new(self.tick)),
            now: Seconds::new(0.0),
            smooth: false,
        };
        self.view.refresh(&mut self.subscriber, &glass);
    }

    fn measure(&mut self, repeats: u32) -> Duration {
        let mut each = || {
            let begun = Instant::now();
            self.refresh();
            begun.elapsed()
        };
        median((0..repeats * SHOWN as u32).map(|_| each()))
    }
}

/// What hearing and showing costs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hearing {
    /// Bodies of the stream.
    pub bodies: u32,
    /// An update of a body of which nothing was said before, nanoseconds.
    pub first_ns: f64,
    /// An update in the midst of a run, nanoseconds.
    pub update_ns: f64,
    /// A view of all bodies, milliseconds.
    pub view_ms: f64,
    /// Predicting and correcting a body, and nothing else, nanoseconds.
    pub correcting_ns: f64,
    /// Predicting all bodies, and nothing else, milliseconds.
    pub predicting_ms: f64,
}

/// The median of so many repeats.
pub(super) fn hearing(bodies: u32, repeats: u32) -> Hearing {
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let often = repeats * SHOWN as u32;
    let least =
        |track: &dyn Fn(u32) -> Track| Least::of((0..bodies).map(track), terms().integrator, grid);
    // What was said in the midst of a run lies on the grid, and what a snapshot said does not.
    let said = |index| Track {
        anchor: Anchor::Snapped(Snapped::of(&struck_state(index, 0).motion(), &grid)),
        ..track(index)
    };
    Hearing {
        bodies,
        first_ns: Audience::new(bodies).measure(repeats),
        update_ns: Audience::in_the_midst(bodies).measure(repeats),
        view_ms: Show::new(bodies).measure(repeats).as_secs_f64() * 1e3,
        correcting_ns: least(&said).correcting(often),
        predicting_ms: least(&track).predicting(often).as_secs_f64() * 1e3,
    }
}
