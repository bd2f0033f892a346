//! The server changes the tier of members on slow links, and notifies them.
//!
//! As in `simulated_network`, over links of a limited rate.

use glam::Vec3;
use rhumb_netsim::{Direction, LinkConfig};
use rhumb_protocol::Span;
use rhumb_protocol::message::{StreamChoice, TierChangeCause, TierPolicy};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId, Stepping};
use rhumb_reckoning::{BodyId, BodyState, LengthBound, Tick, Tolerance};
use rhumb_sims::{Script, by_name};
use rhumb_tests::{COMMANDER, Stage, seed};

const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
const COARSE: StreamChoice = StreamChoice::Within(Tolerance::COARSE);

/// Balls in free space whose velocities change at every tick: fine tiers need an update for each ball each time,
/// coarse ones rarely.
struct RestlessBalls {
    config: SceneConfig,
    chance: u64,
}

const BALLS: u32 = 40;

impl RestlessBalls {
    fn new() -> Self {
        let script = by_name("zoo", 1, 1).expect("an existing script");
        let config = SceneConfig {
            gravity: Vec3::ZERO,
            ..script.config()
        };
        Self { config, chance: 1 }
    }

    /// A random number from -1 to 1.
    fn roll(&mut self) -> f32 {
        self.chance = self
            .chance
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.chance >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

impl Script for RestlessBalls {
    fn name(&self) -> &'static str {
        "restless"
    }

    fn config(&self) -> SceneConfig {
        self.config
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        let ids = (0..BALLS).map(|index| BodyId::new(index, 0));
        if tick == Tick::ZERO {
            let shape = Shape::Ball { radius: 0.5 };
            out.push(Command::AddShape {
                id: ShapeId(0),
                shape,
            });
            out.extend(ids.map(|id| {
                Command::AddBody {
                    desc: BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0)),
                    motion: BodyState::new(
                        [id.index() as f32 * 50.0, 0.0, 0.0],
                        [0.0, 0.0, 0.0, 1.0],
                        [0.0; 3],
                        [0.0; 3],
                    )
                    .expect("a finite state"),
                }
            }));
            return;
        }
        for id in ids {
            let linear = Vec3::new(self.roll(), self.roll(), self.roll());
            let angular = Vec3::ZERO;
            out.push(Command::SetVelocity {
                id,
                linear,
                angular,
            });
        }
    }
}

/// A member with the exact tier of the restless balls, over a good link.
fn stage(seed: u64) -> (Stage, usize) {
    let links: LinkConfig = "rtt=40ms".parse().expect("a valid link configuration");
    let script = Box::new(RestlessBalls::new());
    let mut stage = Stage::new(script, Stepping::FreeRunning, COARSE, links, seed);
    let member = stage.enter(EXACT);
    stage.run_script(Span::from_millis(4_000));
    assert_eq!(stage.copy(member).choice(), EXACT);
    (stage, member)
}

fn narrow(stage: &mut Stage, member: usize, config: &str) {
    let config = config.parse().expect("a valid link configuration");
    stage.network.set_config_of(member, Direction::Down, config);
}

/// Bytes per second of a member's stream.
fn rate(stage: &mut Stage, member: usize) -> u64 {
    let mut look = || {
        stage
            .network
            .client_mut(member)
            .inspect()
            .expect("a member");
        stage.run_script(Span::from_millis(2_000));
        stage.histories[member]
            .inspections
            .last()
            .expect("an answer")
            .packet_bytes
    };
    let before = look();
    (look() - before) / 2
}

#[test]
fn a_member_on_a_thin_link_changes_tier_and_back_and_is_notified() {
    let seed = seed(41);
    let (mut stage, member) = stage(seed);
    let (exact, coarse) = (rate(&mut stage, member), rate(&mut stage, COMMANDER));
    assert!(exact > 3 * coarse, "{exact} {coarse}");
    let bits = (exact + coarse) / 2 * 8;
    narrow(
        &mut stage,
        member,
        &format!("delay=20ms,rate={bits}bit,queue=200kB"),
    );
    stage.run_script(Span::from_millis(30_000));
    let moved = stage.histories[member].moved.clone();
    assert!(
        moved
            .iter()
            .any(|(_, cause)| *cause == TierChangeCause::LinkCongested),
        "seed {seed}: {moved:?}"
    );
    println!(
        "{exact} {coarse} {moved:?} {:?}",
        stage.histories[member].following
    );
    let present = stage.copy(member).choice();
    assert!(
        present.tolerance() > Tolerance::EXACT,
        "seed {seed}: {present:?}"
    );
    // Its display is not delayed any more.
    let behind = |stage: &Stage| {
        let newest = stage.copy(COMMANDER).stream().watermark_tick().value();
        newest.saturating_sub(stage.copy(member).stream().watermark_tick().value())
    };
    assert!(
        behind(&stage) < 60,
        "seed {seed}: {} ticks behind",
        behind(&stage)
    );
    assert_eq!(
        stage.histories[COMMANDER].moved,
        [],
        "its link is fast enough"
    );
    narrow(&mut stage, member, "delay=20ms");
    stage.run_script(Span::from_millis(120_000));
    assert_eq!(stage.copy(member).choice(), EXACT, "seed {seed}");
    let last = stage.histories[member].moved.last().copied();
    assert_eq!(last, Some((EXACT, TierChangeCause::LinkRecovered)));
    // Every change was notified before the copy changed, and each bound belongs to the stream in force.
    let followed = &stage.histories[member].following;
    let reported: Vec<_> = stage.histories[member]
        .moved
        .iter()
        .map(|(to, _)| *to)
        .collect();
    assert!(followed.iter().all(|choice| reported.contains(choice)));
    let truth = stage.truth();
    stage.histories[member].judge(
        &truth,
        &format!("the member whose tier changed, seed {seed}"),
    );
}

#[test]
fn a_fixed_tier_policy_is_kept_and_no_tier_is_coarser_than_allowed() {
    let fine = StreamChoice::Within(Tolerance::FINE);
    let least = LengthBound::from_micrometres(20_000).expect("a valid length");
    for (moves, where_to) in [
        (TierPolicy::Never, None),
        (TierPolicy::UpTo(least), Some(fine)),
    ] {
        let (mut stage, member) = stage(1);
        let bits = rate(&mut stage, member) * 8 / 3;
        let session = stage.network.client_mut(member);
        session.set_tier_policy(moves).expect("a member");
        stage.run_script(Span::from_millis(500));
        narrow(
            &mut stage,
            member,
            &format!("delay=20ms,rate={bits}bit,queue=200kB"),
        );
        stage.run_script(Span::from_millis(20_000));
        let moved = &stage.histories[member].moved;
        let first = moved.first().map(|(to, _)| *to);
        assert_eq!(first, where_to, "{moves:?}: {moved:?}");
        assert!(
            moved.iter().all(|(to, _)| [EXACT, fine].contains(to)),
            "{moved:?}"
        );
    }
}

#[test]
fn one_choice_of_the_member_undoes_all_tier_changes() {
    let (mut stage, member) = stage(1);
    let bits = rate(&mut stage, COMMANDER) * 16;
    narrow(
        &mut stage,
        member,
        &format!("delay=20ms,rate={bits}bit,queue=200kB"),
    );
    stage.run_until_or(Span::from_millis(60_000), |stage| {
        !stage.histories[member].following.is_empty()
    });
    narrow(&mut stage, member, "delay=20ms");
    let fine = StreamChoice::Within(Tolerance::FINE);
    let asked = stage.network.client_mut(member).subscribe(fine);
    assert_eq!(asked, Ok(()));
    stage.run_script(Span::from_millis(3_000));
    println!(
        "{:?} {:?} {:?}",
        stage.histories[member].moved,
        stage.histories[member].following,
        stage.histories[member].denied
    );
    assert_eq!(stage.copy(member).choice(), fine);
    let moves = stage.histories[member].moved.len();
    stage.run_script(Span::from_millis(60_000));
    assert_eq!(
        stage.histories[member].moved.len(),
        moves,
        "it has the tier that it chose"
    );
}

#[test]
fn a_member_can_choose_a_tier_at_any_time_after_a_tier_change() {
    let seed = seed(42);
    let (mut stage, member) = stage(seed);
    let bits = rate(&mut stage, member) * 5;
    let thin = format!("delay=20ms,loss=5%,rate={bits}bit,queue=20kB");
    narrow(&mut stage, member, &thin);
    let normal = StreamChoice::Within(Tolerance::NORMAL);
    for choice in [COARSE, EXACT, normal, EXACT, EXACT, normal] {
        let asked = stage.network.client_mut(member).subscribe(choice);
        assert_eq!(asked, Ok(()), "seed {seed}");
        let moves = stage.histories[member].moved.len();
        let mut steps = 0;
        while steps < 200 && stage.histories[member].moved.len() == moves {
            stage.run_script(Span::from_millis(50));
            steps += 1;
        }
    }
    assert!(stage.histories[member].moved.len() >= 2, "seed {seed}");
    narrow(&mut stage, member, "delay=20ms");
    let asked = stage.network.client_mut(member).subscribe(normal);
    assert_eq!(asked, Ok(()), "seed {seed}");
    // The queue of the link is drained first.
    stage.run_script(Span::from_millis(20_000));
    assert_eq!(stage.copy(member).choice(), normal, "seed {seed}");
    assert_eq!(stage.histories[member].denied, [], "seed {seed}");
    let truth = stage.truth();
    stage.histories[member].judge(
        &truth,
        &format!("the member that chose after a change, seed {seed}"),
    );
}

/// Many bodies that never move: a large snapshot, and hardly any updates after it.
struct StillBodies;

impl Script for StillBodies {
    fn name(&self) -> &'static str {
        "crowd"
    }

    fn config(&self) -> SceneConfig {
        RestlessBalls::new().config
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let shape = Shape::Ball { radius: 0.5 };
        out.push(Command::AddShape {
            id: ShapeId(0),
            shape,
        });
        out.extend((0..4_000).map(|index| {
            Command::AddBody {
                desc: BodyDesc::plain(BodyId::new(index, 0), BodyKind::Fixed, ShapeId(0)),
                motion: BodyState::new(
                    [index as f32 * 2.0, 0.0, 0.0],
                    [0.0, 0.0, 0.0, 1.0],
                    [0.0; 3],
                    [0.0; 3],
                )
                .expect("a finite state"),
            }
        }));
    }
}

#[test]
fn a_long_snapshot_changes_no_tier() {
    let links: LinkConfig = "rtt=40ms".parse().expect("a valid link configuration");
    let mut stage = Stage::new(
        Box::new(StillBodies),
        Stepping::FreeRunning,
        COARSE,
        links,
        1,
    );
    stage.run_script(Span::from_millis(1_000));
    let member = stage.connect();
    narrow(&mut stage, member, "delay=20ms,rate=150kbit,queue=2MB");
    let asked = stage.network.now();
    stage.join(member, EXACT);
    let took = stage.network.now().since(asked);
    assert!(took > Span::from_millis(4_000), "it took {took}");
    stage.run_script(Span::from_millis(20_000));
    assert_eq!(
        stage.histories[member].moved,
        [],
        "no change while it joins"
    );
    let fine = StreamChoice::Within(Tolerance::FINE);
    let asked = stage.network.client_mut(member).subscribe(fine);
    assert_eq!(asked, Ok(()));
    stage.run_script(Span::from_millis(20_000));
    assert_eq!(
        stage.histories[member].moved,
        [],
        "no change while it changes its stream"
    );
    assert_eq!(stage.copy(member).choice(), fine);
}

#[test]
fn a_longer_round_trip_changes_no_tier() {
    let (mut stage, member) = stage(1);
    narrow(&mut stage, member, "delay=320ms");
    stage.run_script(Span::from_millis(30_000));
    assert_eq!(stage.histories[member].moved, []);
    assert_eq!(stage.copy(member).choice(), EXACT);
}
