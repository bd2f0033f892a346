//! Views of a lockstep scene's tick have the bodies of that tick.
//!
//! One member commands and steps at a random depth; others poll at random moments. The bodies of a tick are those of the
//! commands before the request that stepped to it. The exception is a member's first view: its snapshot is of the moment.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU32;

use rhumb_client::scene::{
    BodyBuilder, BodyDesc, BodyKind, Command, PublishSchedule, SceneConfig, Shape,
};
use rhumb_client::{BodyId, Client, JoinMode, JoinOptions, LocalServer, PipelineDepth, Tick};
use rhumb_tests::{Dice, seed};

/// The bodies of each published tick, by the commands.
type Expected = BTreeMap<Tick, BTreeSet<BodyId>>;

fn shown(client: &Client) -> (Tick, BTreeSet<BodyId>) {
    let time = client.view().time().expect("a member has a view");
    (time.tick, client.view().ids().iter().copied().collect())
}

/// Compares a view; returns its tick.
fn check(client: &Client, expected: &Expected, what: &str) -> Tick {
    let (tick, bodies) = shown(client);
    let of_tick = &expected[&tick];
    let come: Vec<_> = bodies.difference(of_tick).collect();
    let gone: Vec<_> = of_tick.difference(&bodies).collect();
    assert!(
        come.is_empty() && gone.is_empty(),
        "{what}, view of {tick}: too many {come:?}, missing {gone:?}"
    );
    tick
}

fn any_body(dice: &mut Dice) -> BodyBuilder {
    let at = dice.below(1_000) as f32;
    BodyDesc::dynamic(Shape::ball(0.2)).at(at, 50.0, 0.0)
}

/// Adds, removes or changes some bodies.
fn command(stepper: &mut Client, live: &mut BTreeSet<BodyId>, dice: &mut Dice) {
    for _ in 0..dice.below(3) {
        match (dice.below(5), live.iter().next().copied()) {
            (0..=2, _) | (_, None) => {
                let body = any_body(dice);
                live.insert(stepper.add_body(body).expect("room for a body"));
            }
            (3, Some(id)) => {
                stepper
                    .command(Command::RemoveBody { id })
                    .expect("a member may");
                live.remove(&id);
            }
            (_, Some(id)) => {
                let desc = stepper.replica().and_then(|replica| replica.body(id));
                if let Some(desc) = desc {
                    let kind = match desc.kind {
                        BodyKind::Dynamic => BodyKind::Kinematic,
                        _ => BodyKind::Dynamic,
                    };
                    let desc = BodyDesc { kind, ..desc };
                    stepper
                        .command(Command::ChangeBody { desc })
                        .expect("a member may");
                }
            }
        }
    }
}

/// Runs one scene; returns the number of views compared.
fn run(server: &LocalServer, interval: u32, depth: u32, members: usize, seed: u64) -> usize {
    let mut dice = Dice::new(seed ^ u64::from(interval) << 8 ^ u64::from(depth) << 16);
    let what = format!("interval {interval}, depth {depth}, {members} members, seed {seed}");
    let scene = format!("s{interval}d{depth}m{members}n{seed}");
    let schedule = PublishSchedule {
        publish_interval: NonZeroU32::new(interval).expect("not zero"),
        ..PublishSchedule::EACH_TICK
    };
    let config = SceneConfig {
        publish_schedule: schedule,
        ..SceneConfig::default()
    };
    let join = |mode| {
        let options = JoinOptions {
            mode,
            ..JoinOptions::default()
        };
        let joined = server.connect().join_with(&scene, options);
        joined.expect("the scene is there")
    };
    let mut stepper = join(JoinMode::Create(config));
    let mut others: Vec<_> = (1..members).map(|_| join(JoinMode::Join)).collect();
    let mut live = BTreeSet::new();
    let mut expected = Expected::from([(Tick::ZERO, live.clone())]);
    let mut views = 0;
    let mut newest = Tick::ZERO;
    for step in 0..40 {
        command(&mut stepper, &mut live, &mut dice);
        if dice.below(4) == 0 {
            // Commands that are applied while the scene stands still change nothing that is shown.
            stepper.flush();
        }
        for _ in 0..=dice.below(2) {
            let tick = stepper.request_tick().expect("the scene runs");
            expected.insert(tick, live.clone());
        }
        stepper
            .wait(PipelineDepth::new(depth))
            .expect("the scene runs");
        newest = newest.max(check(&stepper, &expected, &what));
        for other in &mut others {
            for _ in 0..dice.below(4) {
                other.poll().expect("the scene runs");
                check(other, &expected, &what);
                views += 1;
            }
        }
        if step % 8 == 7 && dice.below(2) == 0 {
            stepper.poll().expect("the scene runs");
            check(&stepper, &expected, &what);
        }
        views += 1;
    }
    assert!(newest > Tick::ZERO);
    views
}

#[test]
fn members_that_show_one_tick_show_the_bodies_of_that_tick() {
    let mut views = 0;
    for seed in [seed(1), 2] {
        for interval in 1..=16 {
            let servers = [
                LocalServer::new(),
                LocalServer::spawn().expect("a thread can start"),
            ];
            for depth in 0..=8_u32 {
                let members = 1 + (interval + depth + seed as u32) as usize % 4;
                let server = &servers[depth as usize % 2];
                views += run(server, interval, depth, members, seed);
            }
        }
    }
    println!("{views} views compared");
}

#[test]
fn a_member_that_joins_shows_what_commands_added_since_the_tick() {
    let server = LocalServer::new();
    let join = |mode| {
        let options = JoinOptions {
            mode,
            ..JoinOptions::default()
        };
        let joined = server.connect().join_with("joined", options);
        joined.expect("the scene is there")
    };
    let at_once = PipelineDepth::new(0);
    let mut stepper = join(JoinMode::Create(SceneConfig::default()));
    let tick = stepper.advance(at_once).expect("the scene runs");
    let body = any_body(&mut Dice::new(1));
    let id = stepper.add_body(body).expect("room for a body");
    stepper.flush();
    stepper.poll().expect("the scene runs");
    let mut joined = join(JoinMode::Join);
    let with_body = BTreeSet::from([id]);
    assert_eq!(shown(&stepper), (tick, BTreeSet::new()));
    assert_eq!(shown(&joined), (tick, with_body.clone()));
    let next = stepper.advance(at_once).expect("the scene runs");
    for _ in 0..100 {
        joined.poll().expect("the scene runs");
    }
    assert_eq!(shown(&stepper), (next, with_body.clone()));
    assert_eq!(shown(&joined), (next, with_body));
}
