//! What one body costs on its way from truth to view: nanoseconds, by stage.
//!
//! Ten thousand bodies that fly, each struck every so often, at the 5 cm tier. Reported per pass over all of them:
//! `predict` and `view` look at every body; `encode` judges every body and says about a tenth; `decode` hears that tenth,
//! whose bodies had no seats before. `decode in the midst` hears twenty ticks of a run in which each body is turned back
//! three times a second.

use std::hint::black_box;
use std::num::NonZeroU32;

use bytes::Bytes;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::Vec3;
use rhumb_client::{DisplayTime, Glass, View};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Features, Manner, Observation, Publisher, StreamStart, StreamTerms, Subscriber,
    Witness,
};
use rhumb_reckoning::{
    Anchor, BodyId, Class, Damping, Integrator, Metres, Predictor, Rate, Seconds, Tick, Tolerance,
    Track, Verbatim,
};

const BODIES: u32 = 10_000;
const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);
const STREAM: StreamId = StreamId(0);

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

fn integrator() -> Integrator {
    Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(4).expect("four is not zero"),
    }
}

fn manner() -> Manner {
    Manner {
        radius: Metres::new(0.5),
        damping: Damping::default(),
        gravity_scale: 0.0,
        inertia: None,
        class: Class::USUAL,
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

fn publisher() -> Publisher {
    let terms = StreamTerms {
        tolerance: Tolerance::NORMAL,
        integrator: integrator(),
        every: Cadence::EACH_TICK.every,
        gravity: GRAVITY,
        features: Features::ALL,
    };
    let mut publisher = Publisher::new(STREAM, &terms, Tick::ZERO);
    for index in 0..BODIES {
        assert!(publisher.place(BodyId::new(index, 0), &manner(), track(index)));
    }
    publisher
}

fn subscriber() -> Subscriber {
    let mut subscriber = Subscriber::new(&StreamStart {
        stream: STREAM,
        tolerance: Tolerance::NORMAL,
        integrator: integrator(),
        every: Cadence::EACH_TICK.every,
        gravity: GRAVITY,
        tick: Tick::ZERO,
        next: 0,
        notices: 0,
    });
    for index in 0..BODIES {
        assert!(subscriber.place(BodyId::new(index, 0), &manner(), track(index)));
    }
    subscriber.handle_snapshot_end();
    subscriber
}

fn observations() -> Vec<Observation> {
    (0..BODIES)
        .map(|index| Observation {
            id: BodyId::new(index, 0),
            motion: state(index, 1),
            activity: Activity::Awake,
        })
        .collect()
}

/// Ticks of a run that are heard before the clock runs, and while it does.
const HEARD: [u64; 2] = [60, 20];
/// Of so many bodies one is struck in each tick of a run.
const STRUCK: u64 = 20;

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

/// A listener in the midst of a run, and the datagrams of the ticks that follow.
fn midst() -> (Subscriber, Vec<Bytes>) {
    let (mut publisher, mut subscriber) = (publisher(), subscriber());
    let mut witness = Witness::new(Cadence::EACH_TICK);
    let mut following = Vec::new();
    for tick in 1..=HEARD[0] + HEARD[1] {
        let seen = |index| Observation {
            id: BodyId::new(index, 0),
            motion: struck_state(index, tick),
            activity: Activity::Awake,
        };
        witness.observe(Tick::new(tick), &(0..BODIES).map(seen).collect::<Vec<_>>());
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
    (subscriber, following)
}

fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("10,000 bodies");
    let observations = observations();
    let mut datagrams: Vec<Bytes> = Vec::new();
    let mut witness = Witness::new(Cadence::EACH_TICK);
    witness.observe(Tick::new(1), &observations);
    publisher().publish(&witness, 0, &mut datagrams);
    let mut heard = subscriber();
    for datagram in &datagrams {
        heard.handle_datagram(datagram);
    }
    let updates = heard.statistics().updates;

    group.throughput(Throughput::Elements(u64::from(BODIES)));
    group.bench_function("predict", |bencher| {
        let subscriber = subscriber();
        bencher.iter(|| {
            for index in 0..BODIES {
                black_box(subscriber.believed(BodyId::new(index, 0), Tick::new(30)));
            }
        });
    });
    group.bench_function("encode", |bencher| {
        bencher.iter_batched_ref(
            publisher,
            |publisher| {
                let mut out = Vec::new();
                publisher.publish(&witness, 0, &mut out);
                out
            },
            criterion::BatchSize::LargeInput,
        );
    });
    group.bench_function("view", |bencher| {
        let mut subscriber = subscriber();
        let mut view = View::default();
        let mut tick = 0;
        bencher.iter(|| {
            tick = (tick + 1) % 60;
            let at = DisplayTime::at(Tick::new(tick));
            let (now, smooth) = (Seconds::new(0.0), false);
            view.refresh(&mut subscriber, &Glass { at, now, smooth });
        });
    });
    group.throughput(Throughput::Elements(updates));
    group.bench_function("decode", |bencher| {
        bencher.iter_batched_ref(
            subscriber,
            |subscriber| {
                for datagram in &datagrams {
                    subscriber.handle_datagram(datagram);
                }
            },
            criterion::BatchSize::LargeInput,
        );
    });
    group.finish();
}

/// What hearing costs in a run that has gone on for a while.
fn run(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("10,000 bodies");
    let (listener, following) = midst();
    let mut heard = listener.clone();
    for datagram in &following {
        heard.handle_datagram(datagram);
    }
    let updates = heard.statistics().updates - listener.statistics().updates;
    group.throughput(Throughput::Elements(updates));
    group.bench_function("decode in the midst", |bencher| {
        bencher.iter_batched_ref(
            || listener.clone(),
            |subscriber| {
                for datagram in &following {
                    subscriber.handle_datagram(datagram);
                }
            },
            criterion::BatchSize::LargeInput,
        );
    });
    group.finish();
}

criterion_group!(benches, stages, run);
criterion_main!(benches);
