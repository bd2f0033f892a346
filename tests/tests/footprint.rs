//! Allocations per tick and memory per body, counted by a special allocator.
//!
//! Ten thousand balls are published and subscribed to in one process, without a network. Only allocations of the
//! test's own thread count. Memory is the growth of the heap, spare capacity of tables and buffers included.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use rhumb_client::{RenderParams, RenderTime, View};
use rhumb_protocol::message::{SceneEvent, StreamChoice};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{BodyDesc, BodyKind, PublishSchedule, SceneConfig, Shape, ShapeId};
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig, Subscriber,
};
use rhumb_protocol::{Endpoint, Instant};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Integrator, Metres, Predictor, Rate, Seconds, Tick,
    Tolerance, ToleranceScale, Track,
};
use rhumb_sims::by_name;
use rhumb_tests::ScriptedSession;

/// The system's allocator, with counters.
struct Counting;

thread_local! {
    static CALLS: Cell<u64> = const { Cell::new(0) };
    static BYTES: Cell<i64> = const { Cell::new(0) };
}

fn note(calls: u64, bytes: i64) {
    CALLS.with(|all| all.set(all.get() + calls));
    BYTES.with(|all| all.set(all.get() + bytes));
}

// SAFETY: every call goes to the system's allocator as it came; the counters neither allocate nor unwind.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(1, layout.size() as i64);
        // SAFETY: the caller keeps the promises of this very method.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, place: *mut u8, layout: Layout) {
        note(0, -(layout.size() as i64));
        // SAFETY: as above.
        unsafe { System.dealloc(place, layout) }
    }

    unsafe fn realloc(&self, place: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(1, size as i64 - layout.size() as i64);
        // SAFETY: as above.
        unsafe { System.realloc(place, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Number of allocator calls, and growth of the heap in bytes, during `work`.
fn count<T>(work: impl FnOnce() -> T) -> (T, u64, i64) {
    let before = (CALLS.get(), BYTES.get());
    let done = work();
    (done, CALLS.get() - before.0, BYTES.get() - before.1)
}

const BODIES: u32 = 10_000;
const STREAM: StreamId = StreamId(0);
const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);
/// Limit of allocator calls per packet at a publisher, regardless of the number of updates.
const PER_PACKET: u64 = 10;
/// One in this number of bodies is hit in each tick.
const STRUCK: u64 = 20;

fn config(tolerance: Tolerance) -> StreamConfig {
    StreamConfig {
        tolerance,
        integrator: integrator(),
        publish_interval: PublishSchedule::EACH_TICK.publish_interval,
        largest_packet: LargestPacket::DEFAULT,
        gravity: GRAVITY,
        features: Features::ALL,
    }
}

fn integrator() -> Integrator {
    Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(4).expect("four is positive"),
    }
}

/// Moving balls, some of which reverse their direction regularly.
#[derive(Clone, Copy)]
enum Scene {
    /// Each ball is hit at regular intervals.
    Struck,
    /// No ball is ever hit.
    Free,
}

impl Scene {
    fn state(self, index: u32, tick: u64) -> BodyState {
        let phase = tick + u64::from(index) % STRUCK;
        let (struck, last) = match self {
            Self::Struck => (phase / STRUCK, phase / STRUCK * STRUCK),
            Self::Free => (0, 0),
        };
        let speed = if struck % 2 == 0 { 3.0 } else { -3.0 };
        let since = (phase - last) as f32 / 60.0;
        // A triangle wave: hits happen at the start and at the end of the path.
        let path = 3.0 * STRUCK as f32 / 60.0;
        let from = if struck % 2 == 0 { 0.0 } else { path };
        let x = from + speed * since + (index % 100) as f32;
        BodyState::new(
            [x, 0.0, (index / 100) as f32],
            [0.0, 0.0, 0.0, 1.0],
            [speed, 0.0, 0.0],
            [0.0; 3],
        )
        .expect("finite numbers")
    }

    fn observations(self, tick: u64) -> Vec<Observation> {
        let observed = |index| Observation {
            id: BodyId::new(index, 0),
            motion: self.state(index, tick),
            activity: Activity::Awake,
        };
        (0..BODIES).map(observed).collect()
    }

    fn bodies(self) -> impl Iterator<Item = (BodyId, PredictionParameters, Track)> {
        (0..BODIES).map(move |index| {
            let parameters = PredictionParameters {
                radius: Metres::new(0.5),
                damping: Damping::default(),
                gravity_scale: 0.0,
                inertia: None,
                tolerance_scale: ToleranceScale::default(),
            };
            let track = Track {
                origin: Tick::ZERO,
                predictor: Predictor::Uniform,
                anchor: Anchor::Exact(self.state(index, 0)),
                parent: None,
            };
            (BodyId::new(index, 0), parameters, track)
        })
    }

    fn config(self) -> SceneConfig {
        SceneConfig {
            integrator: integrator(),
            gravity: GRAVITY,
            damping: Damping::default(),
            ..by_name("free-fall", 1, 1)
                .expect("an existing script")
                .config()
        }
    }

    /// The snapshot of the bodies for a new member.
    fn scene_events(self) -> Vec<SceneEvent> {
        let ball = ShapeId(0);
        let shape = Shape::Ball { radius: 0.5 };
        let mut scene_events = vec![SceneEvent::ShapeAdded { id: ball, shape }];
        let placed = self.bodies().map(|(id, _, track)| SceneEvent::BodyPlaced {
            desc: BodyDesc {
                gravity_scale: 0.0,
                ..BodyDesc::plain(id, BodyKind::Dynamic, ball)
            },
            inertia: None,
            track,
            alias: None,
        });
        scene_events.extend(placed);
        scene_events
    }

    fn publisher(self, tolerance: Tolerance) -> Publisher {
        let mut publisher = Publisher::new(STREAM, &config(tolerance), Tick::ZERO);
        for (id, parameters, track) in self.bodies() {
            assert!(publisher.place(id, &parameters, track));
        }
        publisher
    }

    fn subscriber(self, tolerance: Tolerance) -> Subscriber {
        let mut subscriber = Subscriber::new(&config(tolerance).start(STREAM, Tick::ZERO));
        for (id, parameters, track) in self.bodies() {
            assert!(subscriber.place(id, &parameters, track));
        }
        subscriber.handle_snapshot_end();
        subscriber
    }

    /// The datagrams of each tick.
    fn published(self, ticks: u64, tolerance: Tolerance) -> Vec<Vec<Bytes>> {
        let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        let mut publisher = self.publisher(tolerance);
        let publish_tick = |tick| {
            let mut out = Vec::new();
            observation_history.observe(Tick::new(tick), &self.observations(tick));
            publisher.publish(&observation_history, 0, &mut out);
            out
        };
        let published: Vec<_> = (1..=ticks).map(publish_tick).collect();
        assert_eq!(publisher.tick(), Tick::new(ticks));
        published
    }
}

fn update_view(view: &mut View, subscriber: &mut Subscriber, tick: u64) {
    let render_params = RenderParams {
        at: RenderTime::at(Tick::new(tick)),
        now: Seconds::new(tick as f64 / 60.0),
        smooth: false,
        step: Rate::HZ_60.step(),
    };
    view.refresh(subscriber, &render_params);
}

#[test]
fn a_tick_without_updates_allocates_nothing() {
    let tiers = [
        Tolerance::EXACT,
        Tolerance::FINE,
        Tolerance::NORMAL,
        Tolerance::COARSE,
    ];
    let mut publishers = tiers.map(|tier| Scene::Free.publisher(tier));
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let mut out = Vec::new();
    for tick in 1..=120 {
        let observations = Scene::Free.observations(tick);
        let ((), calls, _) = count(|| {
            observation_history.observe(Tick::new(tick), &observations);
            for publisher in &mut publishers {
                publisher.publish(&observation_history, 0, &mut out);
            }
        });
        assert!(out.is_empty());
        assert!(calls == 0 || tick < 10, "{calls} at tick {tick}");
    }
}

#[test]
fn publishing_in_four_tiers_allocates_by_packet_and_not_by_update() {
    let tiers = [
        Tolerance::EXACT,
        Tolerance::FINE,
        Tolerance::NORMAL,
        Tolerance::COARSE,
    ];
    let mut publishers = tiers.map(|tier| Scene::Struck.publisher(tier));
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let mut updates = 0;
    for tick in 1..=120 {
        let observations = Scene::Struck.observations(tick);
        let mut out = Vec::with_capacity(1_000);
        let ((), calls, _) = count(|| {
            observation_history.observe(Tick::new(tick), &observations);
            for publisher in &mut publishers {
                publisher.publish(&observation_history, 0, &mut out);
            }
        });
        // Head and payload of a datagram, the history of its bodies, and its source symbol.
        let most = PER_PACKET * out.len() as u64;
        assert!(
            calls <= most || tick < 60,
            "{calls} for {} at tick {tick}",
            out.len()
        );
        let published: u64 = publishers.iter().map(|p| p.statistics().updates).sum();
        assert!(published - updates > 40 * out.len() as u64 || tick < 60);
        updates = published;
    }
}

#[test]
fn receiving_and_rendering_a_tick_allocates_nothing() {
    let published = Scene::Struck.published(200, Tolerance::NORMAL);
    let mut subscriber = Scene::Struck.subscriber(Tolerance::NORMAL);
    let mut view = View::default();
    for (tick, datagrams) in (1..).zip(&published) {
        let ((), calls, _) = count(|| {
            for datagram in datagrams {
                subscriber.handle_datagram(datagram);
            }
            update_view(&mut view, &mut subscriber, tick);
        });
        // The subscriber's list of changed bodies has as much memory as the busiest tick so far needed. The view gives
        // its excess back after the first ticks (at tick 81 the last time), and busier ticks grow it again until 103.
        assert!(calls == 0 || tick < 104, "{calls} at tick {tick}");
    }
    assert!(subscriber.statistics().updates > 1_000);
    assert_eq!(subscriber.statistics().malformed, 0);
}

#[test]
fn a_body_takes_78_bytes_per_stream_at_a_server_and_at_most_256_while_it_is_awake() {
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let (mut publisher, _, placed) = count(|| Scene::Struck.publisher(Tolerance::NORMAL));
    let mut observed = 0;
    let ((), _, grown) = count(|| {
        for tick in 1..=2 * STRUCK {
            let observations = Scene::Struck.observations(tick);
            let ((), _, kept) =
                count(|| observation_history.observe(Tick::new(tick), &observations));
            observed += kept;
            publisher.publish(&observation_history, 0, &mut Vec::new());
        }
    });
    // Memory shared by all streams does not count, and the sent datagrams are dropped.
    let published = grown - observed;
    assert!(publisher.statistics().updates >= u64::from(BODIES));
    let each = (placed + published) / i64::from(BODIES);
    assert!(placed / i64::from(BODIES) <= 78, "{placed}");
    assert!(each <= 256, "{each}: {placed} and {published}");
}

#[test]
fn a_body_takes_no_more_than_384_bytes_at_a_client_while_it_moves() {
    let published = Scene::Struck.published(2 * STRUCK, Tolerance::NORMAL);
    let reported = Scene::Struck.scene_events();
    let config = Scene::Struck.config();
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    let mut member = ScriptedSession::welcomed(choice);
    let ((), _, placed) =
        count(|| member.send_snapshot(&config, choice, (STREAM, Tick::ZERO), &reported));
    let mut view = View::default();
    let session = &mut member.session;
    let ((), _, received) = count(|| {
        for (tick, datagrams) in (1..).zip(&published) {
            for datagram in datagrams {
                session.handle_datagram(Instant::ZERO, ScriptedSession::SERVER, datagram);
            }
            let copy = session.replica_mut().expect("a member has a copy");
            update_view(&mut view, copy.stream_mut(), tick);
        }
    });
    let copy = session.replica().expect("a member has a copy");
    assert_eq!(copy.bodies().count(), BODIES as usize);
    assert!(copy.stream().statistics().updates >= u64::from(BODIES));
    let each = (placed + received) / i64::from(BODIES);
    assert!(each <= 384, "{each}: {placed} and {received}");
}
