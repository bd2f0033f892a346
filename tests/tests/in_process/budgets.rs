//! Streams keep their budgets, and state their error scale truthfully.
//!
//! As in `simulated_network`, each bound of each member is checked against the truth at regular times.

use std::num::NonZeroU32;

use bytes::Bytes;
use glam::{EulerRot, Quat, Vec3};
use rhumb_netsim::{Direction, Lane};
use rhumb_protocol::Span;
use rhumb_protocol::message::{Inspection, StreamChoice};
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::{PublishSchedule, Stepping};
use rhumb_protocol::stream::{
    Activity, Budget, ErrorBound, Features, Observation, ObservationHistory, PredictionParameters,
    Publisher, Redundancy, StreamConfig,
};
use rhumb_reckoning::{BodyId, BodyState, Integrator, Metres, Rate, Tick, Tolerance, Track};
use rhumb_sims::by_name;
use rhumb_tests::{COMMANDER, Stage, seed};

fn capped(bytes_per_second: u32) -> StreamChoice {
    StreamChoice::Capped {
        tolerance: Tolerance::NORMAL,
        budget: Budget::new(bytes_per_second, 1_150).expect("within the limits"),
    }
}

fn stage(scene: &str, choice: StreamChoice, stepping: Stepping, links: &str, seed: u64) -> Stage {
    let script = by_name(scene, 60, 1).expect("an existing script");
    let links = links.parse().expect("a valid link configuration");
    Stage::new(script, stepping, choice, links, seed)
}

fn inspect(stage: &mut Stage) -> Inspection {
    stage
        .network
        .client_mut(COMMANDER)
        .inspect()
        .expect("a member");
    stage.run(Span::from_millis(1_000));
    *stage.histories[COMMANDER]
        .inspections
        .last()
        .expect("an answer")
}

/// Number of claims whose bound exceeds the tolerance.
fn exceeding(stage: &Stage, member: usize) -> usize {
    let claims = stage.histories[member].claims.iter();
    claims.filter(|claim| claim.error_scale > 1.0).count()
}

#[test]
fn bounds_are_true_while_a_budget_does_not_suffice() {
    for (scene, links) in [
        ("ball-pit", ""),
        ("tumbler", ""),
        ("tumbler", "rtt=80ms,loss=5%,jitter=10ms"),
        ("zoo", "rtt=40ms,loss=10%,burst=4,reorder=5%,dup=5%"),
    ] {
        let seed = seed(31);
        let what = format!("{scene} over {links:?}, seed {seed}");
        let mut stage = stage(scene, capped(700), Stepping::FreeRunning, links, seed);
        stage.run_script(Span::from_millis(2_000));
        let late = stage.enter(capped(700));
        stage.run_script(Span::from_millis(4_000));
        assert!(exceeding(&stage, COMMANDER) > 100, "{what}");
        assert!(exceeding(&stage, late) > 100, "{what}");
        let truth = stage.truth();
        for member in [COMMANDER, late] {
            stage.histories[member].judge(&truth, &what);
        }
    }
}

#[test]
fn losses_are_restored_from_repair_symbols_that_an_ample_budget_pays() {
    let links = "rtt=80ms,loss=5%,jitter=10ms";
    let choice = capped(40_000);
    let mut stage = stage("tumbler", choice, Stepping::FreeRunning, links, seed(31));
    stage.run_script(Span::from_millis(12_000));
    let truth = stage.truth();
    stage.histories[COMMANDER].judge(&truth, "the member with a budget");
    let read = stage.copy(COMMANDER).stream().statistics();
    assert!(read.rebuilt > 10, "{read:?}");
    assert!(read.rebuilt > 2 * read.refreshes, "{read:?}");
}

#[test]
fn a_budget_is_kept_in_every_second() {
    let mut stage = stage("tumbler", capped(500), Stepping::FreeRunning, "", 1);
    let mut seconds = vec![(0, 0)];
    for _ in 0..8 {
        stage.run_script(Span::from_millis(1_000));
        stage
            .network
            .client_mut(COMMANDER)
            .inspect()
            .expect("a member");
        stage.run(Span::from_millis(4));
        let inspection = stage.histories[COMMANDER].inspections.last();
        let inspection = inspection.expect("an answer");
        seconds.push((inspection.packet_bytes, inspection.over_budget));
    }
    let mut tight = 0;
    for (second, pair) in seconds.windows(2).enumerate() {
        let (bytes, waiting) = (pair[1].0 - pair[0].0, pair[1].1 - pair[0].1);
        let burst = if second == 0 { 1_150 } else { 0 };
        // An update may overdraw the budget, and a second of the simulated clock is not always 60 ticks.
        assert!(bytes <= 500 + burst + 64, "{bytes} in second {second}");
        if waiting > 0 {
            tight += 1;
            assert!(
                bytes >= 400,
                "{waiting} wait, and {bytes} bytes are sent in second {second}"
            );
        }
    }
    assert!(tight >= 3, "the budget is tight in {tight} seconds");
}

#[test]
fn every_waiting_body_is_updated_in_the_end() {
    // The balls fall and come to rest; then the budget suffices, and each rest pose must be published.
    let mut stage = stage("ball-pit", capped(300), Stepping::FreeRunning, "", 1);
    stage.run_script(Span::from_millis(6_000));
    assert!(exceeding(&stage, COMMANDER) > 100);
    let over_budget = inspect(&mut stage).over_budget;
    assert!(over_budget > 1_000, "{over_budget}");
    stage.run(Span::from_millis(60_000));
    let before = inspect(&mut stage).over_budget;
    stage.run(Span::from_millis(5_000));
    assert_eq!(inspect(&mut stage).over_budget, before);
    let copy = stage.copy(COMMANDER);
    for desc in copy.bodies() {
        let radius = copy
            .shape(desc.shape)
            .expect("a body has a shape")
            .bounding_radius();
        let bound = Some(ErrorBound::Within(Tolerance::NORMAL.reach(radius)));
        assert_eq!(copy.stream().bound(desc.id), bound);
    }
    let truth = stage.truth();
    stage.histories[COMMANDER].judge(&truth, "the member with a budget");
}

/// Number of bodies that teleport at each tick, so that only keyframes fit. One more body, with a higher index, moves
/// a little once per second.
const TELEPORTING_BODIES: u32 = 8;
const SECOND: u64 = 60;

fn motion(body: u32, tick: u64) -> BodyState {
    let mixed = |part: u64| {
        let seed = (tick << 16) + (u64::from(body) << 4) + part + 1;
        let mixed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        (mixed >> 40) as f32 / (1 << 24) as f32 - 0.5
    };
    let mut at = [body as f32 * 2_000.0, 0.0, 0.0];
    let mut turned = Quat::IDENTITY;
    let mut linear = [0.0; 3];
    if body == TELEPORTING_BODIES {
        at[0] += (tick / SECOND) as f32 * 0.07;
    } else {
        at = [0, 1, 2].map(|axis| mixed(axis) * 1e5);
        turned = Quat::from_euler(EulerRot::XYZ, mixed(3) * 6.0, mixed(4), mixed(5));
        linear = [6, 7, 8].map(|axis| mixed(axis) * 1e3);
    }
    BodyState::new(at, turned.to_array(), linear, [0.0; 3]).expect("a finite state")
}

/// The publisher of a stream of these bodies with a budget.
struct CappedStream {
    publisher: Publisher,
    observation_history: ObservationHistory,
    tick: u64,
}

impl CappedStream {
    fn new(budget: Budget) -> Self {
        let config = StreamConfig {
            tolerance: Tolerance::NORMAL,
            integrator: Integrator {
                rate: Rate::HZ_60,
                substeps: NonZeroU32::MIN,
            },
            publish_interval: PublishSchedule::EACH_TICK.publish_interval,
            largest_packet: LargestPacket::DEFAULT,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let mut publisher = Publisher::new(StreamId(0), &config, Tick::ZERO);
        for body in 0..=TELEPORTING_BODIES {
            let parameters =
                PredictionParameters::plain(Metres::new(if body == TELEPORTING_BODIES {
                    0.5
                } else {
                    5_000.0
                }));
            let track = Track::resting(Tick::ZERO, motion(body, 0));
            assert!(publisher.place(BodyId::new(body, 0), &parameters, track));
        }
        publisher.limit(budget);
        Self {
            publisher,
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            tick: 0,
        }
    }

    /// Publishes one tick on a link that loses much; returns the bytes of its packets, and of its repair symbols.
    fn step_with_symbols(&mut self) -> [usize; 2] {
        let packets = self.step();
        let mut symbols = Vec::new();
        self.publisher
            .encode_repair_symbols(Redundancy::Thick, &mut symbols);
        [packets, symbols.iter().map(Bytes::len).sum()]
    }

    /// Publishes one tick; returns the bytes of its packets.
    fn step(&mut self) -> usize {
        self.tick += 1;
        let observed = |body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, self.tick),
            activity: Activity::Awake,
        };
        let observed: Vec<_> = (0..=TELEPORTING_BODIES).map(observed).collect();
        self.observation_history
            .observe(Tick::new(self.tick), &observed);
        let mut sent = Vec::new();
        self.publisher
            .publish(&self.observation_history, 0, &mut sent);
        sent.iter().map(Bytes::len).sum()
    }
}

#[test]
fn a_waiting_body_is_updated_even_beside_worse_errors_that_never_rest() {
    let mut stage = CappedStream::new(Budget::new(600, 1_150).expect("within the limits"));
    let id = BodyId::new(TELEPORTING_BODIES, 0);
    let reported = |stage: &CappedStream| {
        let mut tracks = stage.publisher.tracks();
        let found = tracks.find(|(of, _)| *of == id);
        found.expect("an existing body").1.origin.value()
    };
    let mut longest = 0;
    while stage.tick < 60 * SECOND {
        stage.step();
        // The body moves a little at the beginning of each second.
        let off_since = (reported(&stage) / SECOND + 1) * SECOND;
        longest = longest.max(stage.tick.saturating_sub(off_since));
    }
    assert!(stage.publisher.statistics().over_budget > 1_000);
    assert!(longest < 5 * SECOND, "{longest} ticks without an update");
}

#[test]
fn the_body_with_the_largest_error_is_named_with_its_start_tick() {
    let mut stage = CappedStream::new(Budget::new(600, 1_150).expect("within the limits"));
    let mut waited = 0;
    for _ in 0..10 * SECOND {
        stage.step();
        let Some(worst) = stage.publisher.worst_waiting() else {
            assert_eq!(stage.publisher.waiting(), 0);
            continue;
        };
        let wild = worst.body.index() < TELEPORTING_BODIES && worst.share > 100.0;
        assert!(wild || stage.publisher.waiting() == 1, "{worst:?}");
        waited = waited.max(stage.tick - worst.since.value());
    }
    assert!(waited > 10, "{waited}");
}

#[test]
fn other_datagrams_count_against_the_budget() {
    let budget = Budget::new(600, 1_150).expect("within the limits");
    let sent = |beside: usize| -> usize {
        let mut stage = CappedStream::new(budget);
        let second = |stage: &mut CappedStream| -> usize {
            stage.publisher.pay(beside);
            (0..SECOND).map(|_| stage.step()).sum()
        };
        (0..20).map(|_| second(&mut stage)).sum()
    };
    let (alone, beside) = (sent(0), sent(100));
    assert!(alone > 20 * 500, "{alone}");
    assert!(alone - beside > 20 * 90, "{beside} of {alone}");
}

#[test]
fn repair_symbols_are_paid_from_a_budget_that_suffices() {
    // The bodies of a tick take some 400 bytes, so the first budget never suffices and the second one always does.
    for (bytes_per_second, suffices) in [(600, false), (100_000, true)] {
        let burst = (bytes_per_second / 4).max(1_150);
        let budget = Budget::new(bytes_per_second, burst).expect("within the limits");
        let mut stage = CappedStream::new(budget);
        let mut sent = [0; 2];
        for _ in 0..20 * SECOND {
            let [packets, symbols] = stage.step_with_symbols();
            sent = [sent[0] + packets, sent[1] + symbols];
        }
        let over_budget = stage.publisher.statistics().over_budget;
        assert_eq!(over_budget == 0, suffices, "{over_budget}");
        assert_eq!(sent[1] > sent[0] / 2, suffices, "{sent:?}");
        // Where it does not suffice, half of the first burst is all that symbols may take.
        assert!(suffices || sent[1] < burst as usize, "{sent:?}");
        let most = 20 * bytes_per_second as usize + burst as usize;
        assert!(sent[0] + sent[1] <= most, "{sent:?} of {most}");
    }
}

#[test]
fn an_ample_budget_costs_nothing_and_changes_nothing() {
    let sent = |choice| {
        let mut stage = stage("ball-pit", choice, Stepping::Lockstep, "", 1);
        for _ in 0..240 {
            stage.tick();
        }
        let inspection = inspect(&mut stage);
        (
            inspection.packets,
            inspection.packet_bytes,
            inspection.over_budget,
        )
    };
    let ample = StreamChoice::Capped {
        tolerance: Tolerance::NORMAL,
        budget: Budget::per_second(10_000_000).expect("within the limits"),
    };
    assert_eq!(sent(ample), sent(StreamChoice::Within(Tolerance::NORMAL)));
}

#[test]
fn a_stream_does_not_depend_on_the_delay_of_its_subscribers() {
    for choice in [capped(700), StreamChoice::Within(Tolerance::NORMAL)] {
        let sent = |links| {
            let script = by_name("tumbler", 60, 1).expect("an existing script");
            let links: rhumb_netsim::LinkConfig = links;
            let mut stage = Stage::new(script, Stepping::Lockstep, choice, links, 1);
            for _ in 0..200 {
                stage.tick();
            }
            let down = stage
                .network
                .counts(COMMANDER, Direction::Down, Lane::State)
                .pushed
                .bytes;
            let inspection = inspect(&mut stage);
            (inspection.packets, inspection.packet_bytes, down)
        };
        let parse = |text: &str| text.parse().expect("a valid link configuration");
        let near = sent(parse(""));
        // Below the retry time of a lockstep client, which asks again after a tenth of a second.
        let far = sent(parse("rtt=90ms"));
        assert_eq!(near, far, "{choice:?}");
    }
}
