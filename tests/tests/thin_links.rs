//! Members on thin links are moved to what these carry, and back, and told
//!
//! Proved as in `pretend_network`, over links of a limited rate.

use glam::Vec3;
use rhumb_protocol::Span;
use rhumb_protocol::message::{MoveCause, Moves, StreamChoice};
use rhumb_protocol::scene::{BodyKind, BodyTerms, Command, Pace, SceneTerms, Shape, ShapeId};
use rhumb_reckoning::{BodyId, LengthBound, Tick, Tolerance, Verbatim};
use rhumb_sims::{Script, by_name};
use rhumb_tests::{COMMANDER, Stage, seed};
use rhumb_transport::{Direction, LinkTerms};

const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
const COARSE: StreamChoice = StreamChoice::Within(Tolerance::COARSE);

/// Balls in free space, each of which gets another velocity at every tick: fine tiers must speak of all of them each
/// time, coarse ones now and then.
struct Restless {
    terms: SceneTerms,
    chance: u64,
}

const BALLS: u32 = 40;

impl Restless {
    fn new() -> Self {
        let script = by_name("zoo", 1, 1).expect("the scene is known by name");
        let terms = SceneTerms {
            gravity: Vec3::ZERO,
            ..script.terms()
        };
        Self { terms, chance: 1 }
    }

    /// From -1 to 1.
    fn roll(&mut self) -> f32 {
        self.chance = self
            .chance
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.chance >> 40) as f32 / (1 << 23) as f32 - 1.0
    }
}

impl Script for Restless {
    fn name(&self) -> &'static str {
        "restless"
    }

    fn terms(&self) -> SceneTerms {
        self.terms
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
                    terms: BodyTerms::plain(id, BodyKind::Dynamic, ShapeId(0)),
                    motion: Verbatim::new(
                        [id.index() as f32 * 50.0, 0.0, 0.0],
                        [0.0, 0.0, 0.0, 1.0],
                        [0.0; 3],
                        [0.0; 3],
                    )
                    .expect("a place is finite"),
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

/// A member who follows restless balls exactly, over a good link.
fn stage(seed: u64) -> (Stage, usize) {
    let links: LinkTerms = "rtt=40ms".parse().expect("these are terms of a link");
    let script = Box::new(Restless::new());
    let mut stage = Stage::new(script, Pace::FreeRunning, COARSE, links, seed);
    let member = stage.enter(EXACT);
    stage.drive(Span::from_millis(4_000));
    assert_eq!(stage.copy(member).choice(), EXACT);
    (stage, member)
}

fn narrow(stage: &mut Stage, member: usize, terms: &str) {
    let terms = terms.parse().expect("these are terms of a link");
    stage.arena.set_terms_of(member, Direction::Down, terms);
}

/// Bytes a second that a member's stream takes.
fn rate(stage: &mut Stage, member: usize) -> u64 {
    let mut look = || {
        stage
            .arena
            .client_mut(member)
            .inspect()
            .expect("it is a member");
        stage.drive(Span::from_millis(2_000));
        stage.witnesses[member]
            .inspections
            .last()
            .expect("it was answered")
            .packet_bytes
    };
    let before = look();
    (look() - before) / 2
}

#[test]
fn a_member_on_a_thin_link_is_moved_to_what_it_carries_and_back_and_is_told() {
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
    stage.drive(Span::from_millis(30_000));
    let moved = stage.witnesses[member].moved.clone();
    assert!(
        moved.iter().any(|(_, cause)| *cause == MoveCause::Thin),
        "seed {seed}: {moved:?}"
    );
    println!(
        "{exact} {coarse} {moved:?} {:?}",
        stage.witnesses[member].following
    );
    let present = stage.copy(member).choice();
    assert!(
        present.tolerance() > Tolerance::EXACT,
        "seed {seed}: {present:?}"
    );
    // What it shows is not late any more.
    let behind = |stage: &Stage| {
        let newest = stage.copy(COMMANDER).stream().vouched().value();
        newest.saturating_sub(stage.copy(member).stream().vouched().value())
    };
    assert!(
        behind(&stage) < 60,
        "seed {seed}: {} ticks behind",
        behind(&stage)
    );
    assert_eq!(stage.witnesses[COMMANDER].moved, [], "its link is wide");
    narrow(&mut stage, member, "delay=20ms");
    stage.drive(Span::from_millis(120_000));
    assert_eq!(stage.copy(member).choice(), EXACT, "seed {seed}");
    let last = stage.witnesses[member].moved.last().copied();
    assert_eq!(last, Some((EXACT, MoveCause::Eased)));
    // Every move was told before the copy changed, and all bounds were those of the stream in force.
    let followed = &stage.witnesses[member].following;
    let told: Vec<_> = stage.witnesses[member]
        .moved
        .iter()
        .map(|(to, _)| *to)
        .collect();
    assert!(followed.iter().all(|choice| told.contains(choice)));
    let truth = stage.truth();
    stage.witnesses[member].judge(&truth, &format!("who was moved, seed {seed}"));
}

#[test]
fn who_forbids_it_stays_and_nobody_is_moved_beyond_what_they_take() {
    let fine = StreamChoice::Within(Tolerance::FINE);
    let least = LengthBound::from_micrometres(20_000).expect("within bounds");
    for (moves, where_to) in [(Moves::Never, None), (Moves::UpTo(least), Some(fine))] {
        let (mut stage, member) = stage(1);
        let bits = rate(&mut stage, member) * 8 / 3;
        let session = stage.arena.client_mut(member);
        session.allow(moves).expect("it is a member");
        stage.drive(Span::from_millis(500));
        narrow(
            &mut stage,
            member,
            &format!("delay=20ms,rate={bits}bit,queue=200kB"),
        );
        stage.drive(Span::from_millis(20_000));
        let moved = &stage.witnesses[member].moved;
        let first = moved.first().map(|(to, _)| *to);
        assert_eq!(first, where_to, "{moves:?}: {moved:?}");
        assert!(
            moved.iter().all(|(to, _)| [EXACT, fine].contains(to)),
            "{moved:?}"
        );
    }
}

#[test]
fn one_choice_of_the_member_undoes_all_moves() {
    let (mut stage, member) = stage(1);
    let bits = rate(&mut stage, COMMANDER) * 16;
    narrow(
        &mut stage,
        member,
        &format!("delay=20ms,rate={bits}bit,queue=200kB"),
    );
    stage.run_until_or(Span::from_millis(60_000), |stage| {
        !stage.witnesses[member].following.is_empty()
    });
    narrow(&mut stage, member, "delay=20ms");
    let fine = StreamChoice::Within(Tolerance::FINE);
    let asked = stage.arena.client_mut(member).follow(fine);
    assert_eq!(asked, Ok(()));
    stage.drive(Span::from_millis(3_000));
    println!(
        "{:?} {:?} {:?}",
        stage.witnesses[member].moved,
        stage.witnesses[member].following,
        stage.witnesses[member].denied
    );
    assert_eq!(stage.copy(member).choice(), fine);
    let moves = stage.witnesses[member].moved.len();
    stage.drive(Span::from_millis(60_000));
    assert_eq!(
        stage.witnesses[member].moved.len(),
        moves,
        "what it chose is what it has"
    );
}

#[test]
fn whoever_is_moved_can_choose_at_any_time() {
    let seed = seed(42);
    let (mut stage, member) = stage(seed);
    let bits = rate(&mut stage, member) * 5;
    let thin = format!("delay=20ms,loss=5%,rate={bits}bit,queue=20kB");
    narrow(&mut stage, member, &thin);
    let normal = StreamChoice::Within(Tolerance::NORMAL);
    for choice in [COARSE, EXACT, normal, EXACT, EXACT, normal] {
        let asked = stage.arena.client_mut(member).follow(choice);
        assert_eq!(asked, Ok(()), "seed {seed}");
        let moves = stage.witnesses[member].moved.len();
        let mut steps = 0;
        while steps < 200 && stage.witnesses[member].moved.len() == moves {
            stage.drive(Span::from_millis(50));
            steps += 1;
        }
    }
    assert!(stage.witnesses[member].moved.len() >= 2, "seed {seed}");
    narrow(&mut stage, member, "delay=20ms");
    let asked = stage.arena.client_mut(member).follow(normal);
    assert_eq!(asked, Ok(()), "seed {seed}");
    // What waits on the link passes first.
    stage.drive(Span::from_millis(20_000));
    assert_eq!(stage.copy(member).choice(), normal, "seed {seed}");
    assert_eq!(stage.witnesses[member].denied, [], "seed {seed}");
    let truth = stage.truth();
    stage.witnesses[member].judge(&truth, &format!("who was moved and chose, seed {seed}"));
}

/// Many bodies that never move: a large snapshot, and next to nothing to say after it.
struct Crowd;

impl Script for Crowd {
    fn name(&self) -> &'static str {
        "crowd"
    }

    fn terms(&self) -> SceneTerms {
        Restless::new().terms
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
                terms: BodyTerms::plain(BodyId::new(index, 0), BodyKind::Static, ShapeId(0)),
                motion: Verbatim::new(
                    [index as f32 * 2.0, 0.0, 0.0],
                    [0.0, 0.0, 0.0, 1.0],
                    [0.0; 3],
                    [0.0; 3],
                )
                .expect("a place is finite"),
            }
        }));
    }
}

#[test]
fn no_link_is_thin_for_a_snapshot_that_takes_long() {
    let links: LinkTerms = "rtt=40ms".parse().expect("these are terms of a link");
    let mut stage = Stage::new(Box::new(Crowd), Pace::FreeRunning, COARSE, links, 1);
    stage.drive(Span::from_millis(1_000));
    let member = stage.connect();
    narrow(&mut stage, member, "delay=20ms,rate=150kbit,queue=2MB");
    let asked = stage.arena.now();
    stage.join(member, EXACT);
    let took = stage.arena.now().since(asked);
    assert!(took > Span::from_millis(4_000), "it took {took}");
    stage.drive(Span::from_millis(20_000));
    assert_eq!(stage.witnesses[member].moved, [], "while it joined");
    let fine = StreamChoice::Within(Tolerance::FINE);
    let asked = stage.arena.client_mut(member).follow(fine);
    assert_eq!(asked, Ok(()));
    stage.drive(Span::from_millis(20_000));
    assert_eq!(stage.witnesses[member].moved, [], "while it changed");
    assert_eq!(stage.copy(member).choice(), fine);
}

#[test]
fn a_longer_way_moves_nobody() {
    let (mut stage, member) = stage(1);
    narrow(&mut stage, member, "delay=320ms");
    stage.drive(Span::from_millis(30_000));
    assert_eq!(stage.witnesses[member].moved, []);
    assert_eq!(stage.copy(member).choice(), EXACT);
}
