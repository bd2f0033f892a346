//! Requests that cost more to answer than to send.
//!
//! Proved on a router of scenes without sockets, whose driver reports what the links take, as the real one does. Each
//! flood arrives in one read. The figures are what waits for the link while it takes nothing, and what arrives when it
//! takes everything. Caught: 2,000 joins in 10 kB queued 7 GB; an inspection sorted 4,096 steps; a member that read
//! slower than another one uploaded was closed.

use std::sync::atomic::{AtomicU64, Ordering};

use rhumb_protocol::limits::{
    ANGULAR_MAX, DENSITY_MAX, EXTENT_MAX, GRANT, LINEAR_MAX, RATE_MAX, RESERVE_MAX,
};
use rhumb_protocol::message::{ClientMessage, Denial, ResyncCause, SessionKey, SessionRequest};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, Heights, IdRange, Invalid, JointId, Material,
    Quantity, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::{Limits, SceneSettings};

use crate::links::{Links, create, join};

const ATTACKER: Peer = Peer(1);
const VICTIM: Peer = Peer(2);
/// Most bytes that wait for a link that takes nothing: the window, and a piece.
const WINDOW: usize = (256 + 64) << 10;

/// A height field of about a megabyte.
fn large(id: u32) -> ClientMessage {
    let posts: Vec<_> = (0..512 * 512).map(|post| (post % 97) as f32).collect();
    let heights = Heights::new(512, 1.0, 1.0, &posts).expect("within the limits");
    ClientMessage::Command(Command::AddShape {
        id: ShapeId(id),
        shape: Shape::Heights(heights),
    })
}

/// The attacker in a scene with a large shape; its link has taken all that it was sent.
fn large_scene() -> Links {
    let mut links = Links::new();
    links.begin(ATTACKER, Stepping::Lockstep);
    links.send(ATTACKER, &[large(0)]);
    while links.links[&ATTACKER].waiting > 0 {
        links.take(ATTACKER, usize::MAX);
    }
    links.pass(Span::from_millis(1_000));
    links
}

#[test]
fn leaving_and_joining_again_and_again_keeps_one_snapshot_under_way() {
    let mut links = large_scene();
    let before = links.counts(ATTACKER);
    let flood: Vec<_> = (0..2_000)
        .flat_map(|_| [ClientMessage::Leave, join()])
        .collect();
    links.send(ATTACKER, &flood);
    assert!(links.links[&ATTACKER].waiting <= WINDOW);
    let joined = links.counts(ATTACKER).joined - before.joined;
    assert_eq!(joined, 1, "the link has not taken the first snapshot");
    // A link that takes everything gets one after the other, at a bounded rate.
    for _ in 0..50 {
        for _ in 0..10 {
            links.take(ATTACKER, usize::MAX);
        }
        links.pass(Span::from_millis(20));
    }
    let joined = links.counts(ATTACKER).joined - before.joined;
    assert!((5..=25).contains(&joined), "{joined} snapshots in a second");
}

#[test]
fn resyncs_while_a_snapshot_is_under_way_get_one_more() {
    let mut links = large_scene();
    let before = links.counts(ATTACKER).joined;
    let resync = ClientMessage::Resync(ResyncCause::LostSync);
    for _ in 0..10 {
        links.send(ATTACKER, &vec![resync.clone(); 400]);
    }
    assert!(links.links[&ATTACKER].waiting <= WINDOW);
    assert_eq!(links.counts(ATTACKER).joined - before, 1);
    for _ in 0..100 {
        links.take(ATTACKER, usize::MAX);
        links.pass(Span::from_millis(20));
    }
    assert_eq!(links.counts(ATTACKER).joined - before, 2);
}

#[test]
fn pipelined_inspections_and_pings_wait_unread_until_their_answers_are_taken() {
    let mut links = Links::new();
    links.begin(ATTACKER, Stepping::FreeRunning);
    links.pass(Span::from_millis(1_000));
    let ping = ClientMessage::Ping {
        sent: Instant::ZERO,
    };
    let mut flood = vec![ClientMessage::Inspect; 32_000];
    flood.extend(vec![ping; 32_000]);
    links.send(ATTACKER, &flood);
    links.pass(Span::from_millis(1_000));
    assert!(links.links[&ATTACKER].waiting <= WINDOW);
    assert!(links.unsent(ATTACKER) > 0, "the rest waits at the client");
    assert_eq!(links.counts(ATTACKER).pongs, 0);
    for _ in 0..1_000 {
        links.take(ATTACKER, usize::MAX);
        links.pass(Span::from_millis(1));
    }
    let counts = links.counts(ATTACKER);
    assert_eq!((counts.inspections, counts.pongs), (32_000, 32_000));
    assert_eq!(counts.closed, None);
}

#[test]
fn messages_in_many_reads_have_a_bounded_time_between_two_ticks() {
    const READS: usize = 40;
    const EACH: usize = 400;
    const READING: u64 = 10_000;
    // Each reading of the clock takes its time.
    let time = AtomicU64::new(0);
    let clock = move || Instant::from_nanos(time.fetch_add(READING, Ordering::Relaxed));
    let mut links = Links::with(SceneSettings::new(clock));
    links.begin(ATTACKER, Stepping::FreeRunning);
    links.connect(VICTIM);
    links.send(VICTIM, &[join()]);
    links.take(VICTIM, usize::MAX);
    links.pass(Span::from_millis(100));
    let ping = ClientMessage::Ping {
        sent: Instant::ZERO,
    };
    for _ in 0..READS {
        links.send(ATTACKER, &vec![ping.clone(); EACH]);
    }
    let at_once = links.counts(ATTACKER).pongs;
    assert!(
        (1..=200).contains(&at_once),
        "{at_once} in two milliseconds"
    );
    // One call for ticks has the next part of the flood, and whatever others sent.
    links.send(VICTIM, &[ping]);
    assert_eq!(links.counts(VICTIM).pongs, 0, "the time was used");
    links.server.handle_timeout(links.now);
    links.collect();
    assert_eq!(links.counts(VICTIM).pongs, 1);
    let then = links.counts(ATTACKER).pongs - at_once;
    assert!((1..=200).contains(&then), "{then} in two milliseconds");
    for _ in 0..100 {
        links.take(ATTACKER, usize::MAX);
        links.pass(Span::from_millis(20));
    }
    assert_eq!(links.counts(ATTACKER).pongs, READS * EACH, "none is lost");
    assert_eq!(links.counts(ATTACKER).closed, None);
}

#[test]
fn junk_behind_a_long_advance_closes_no_other_member() {
    let mut links = Links::new();
    links.begin(ATTACKER, Stepping::Lockstep);
    links.connect(VICTIM);
    links.send(VICTIM, &[join()]);
    let to = Tick::new(1_024);
    let junk = ClientMessage::Command(Command::RemoveJoint { id: JointId(9) });
    let mut flood = vec![ClientMessage::Advance { to }];
    flood.extend(vec![junk.clone(); 70_000]);
    links.send(ATTACKER, &flood);
    links.send(VICTIM, &[junk.clone(), junk]);
    links.pass(Span::from_millis(1));
    assert_eq!(links.counts(VICTIM).closed, None);
    assert_eq!(links.counts(ATTACKER).closed, None);
}

#[test]
fn an_upload_waits_for_a_member_that_reads_slower() {
    let mut links = Links::new();
    links.begin(ATTACKER, Stepping::Lockstep);
    links.connect(VICTIM);
    links.send(VICTIM, &[join()]);
    let remove = ClientMessage::Command(Command::RemoveShape { id: ShapeId(0) });
    let (mut uploaded, mut most) = (0, 0);
    // Twenty megabytes; the victim takes one in a second.
    for _ in 0..200 {
        if uploaded < 20 && links.unsent(ATTACKER) == 0 {
            links.send(ATTACKER, &[large(0), remove.clone()]);
            uploaded += 1;
        }
        links.take(ATTACKER, usize::MAX);
        links.take(VICTIM, 100 << 10);
        links.pass(Span::from_millis(100));
        most = most.max(links.links[&VICTIM].waiting);
    }
    assert_eq!(links.counts(VICTIM).closed, None);
    assert_eq!(links.counts(ATTACKER).closed, None);
    assert!(most <= WINDOW, "{most}");
    assert!((15..=20).contains(&uploaded), "{uploaded}");
}

#[test]
fn a_member_that_takes_nothing_is_closed_after_half_a_minute() {
    let mut links = large_scene();
    links.connect(VICTIM);
    links.send(VICTIM, &[join()]);
    let report = rhumb_protocol::LinkReport {
        waiting_bytes: 0,
        sent_bytes: 0,
        over: Span::from_millis(100),
        round_trip: Span::from_millis(1),
    };
    for second in 0..40_u64 {
        links.pass(Span::from_millis(1_000));
        let now = links.now;
        links.server.handle_link(now, VICTIM, &report);
        links.collect();
        let closed = links.counts(VICTIM).closed;
        assert_eq!(closed.is_some(), second >= 29, "after {second} s");
    }
    assert_eq!(links.counts(VICTIM).closed, Some(0x102));
}

/// A snapshot of so many bodies is more than the window; `BODIES` sets another number.
#[test]
fn a_scene_of_many_bodies_can_be_joined_over_a_thin_link() {
    let bodies = std::env::var("BODIES").map_or(20_000, |count| count.parse().expect("a number"));
    let mut links = Links::new();
    links.begin(ATTACKER, Stepping::Lockstep);
    let ball = Command::AddShape {
        id: ShapeId(0),
        shape: Shape::ball(0.5),
    };
    let mut commands = vec![
        ClientMessage::Command(ball),
        ClientMessage::Reserve { count: bodies },
    ];
    commands.extend((0..bodies).map(|index| {
        let at = [(index % 300) as f32 * 2.0, 0.0, (index / 300) as f32 * 2.0];
        let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        ClientMessage::Command(Command::AddBody {
            desc: BodyDesc::plain(BodyId::new(4_096 + index, 0), BodyKind::Fixed, ShapeId(0)),
            motion: motion.expect("finite"),
        })
    }));
    for some in commands.chunks(100) {
        links.send(ATTACKER, some);
        links.take(ATTACKER, usize::MAX);
        links.pass(Span::from_millis(1));
    }
    assert_eq!(links.unsent(ATTACKER), 0);
    links.connect(VICTIM);
    links.send(VICTIM, &[join()]);
    let mut most = 0;
    for _ in 0..2_000 {
        if links.counts(VICTIM).snapshots == 1 {
            break;
        }
        most = most.max(links.links[&VICTIM].waiting);
        links.take(VICTIM, 32 << 10);
        links.pass(Span::from_millis(20));
    }
    let counts = links.counts(VICTIM);
    assert_eq!((counts.snapshots, counts.closed), (1, None));
    assert_eq!(counts.bodies, bodies as usize);
    assert!(most <= WINDOW, "{most}");
}

#[test]
fn scenes_without_members_end_and_make_room() {
    let mut links = Links::with_limits(Limits::default());
    links.begin(ATTACKER, Stepping::FreeRunning);
    let left = |links: &Links| links.server.scenes().count();
    links.pass(Span::from_millis(700_000));
    assert_eq!(left(&links), 1, "it has a member");
    let now = links.now;
    links.server.handle_ended(now, ATTACKER, Ending::TimedOut);
    links.pass(Span::from_millis(599_000));
    assert_eq!(left(&links), 1);
    links.pass(Span::from_millis(1_001));
    assert_eq!(left(&links), 0);
}

/// A ball under an index of a range.
fn ball(range: IdRange, place: u32, at: [f32; 3]) -> ClientMessage {
    let id = range.id(place).expect("within the range");
    let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("finite");
    let desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
    ClientMessage::Command(Command::AddBody { desc, motion })
}

fn shape(id: u32, shape: Shape) -> ClientMessage {
    let id = ShapeId(id);
    ClientMessage::Command(Command::AddShape { id, shape })
}

#[test]
fn bodies_that_are_left_behind_keep_no_indices_but_their_own() {
    let mut links = Links::new();
    links.begin(VICTIM, Stepping::Lockstep);
    links.send(VICTIM, &[shape(0, Shape::ball(0.5))]);
    let mut highest = 0;
    for round in 0..200_u32 {
        let attacker = Peer(10 + u64::from(round));
        links.connect(attacker);
        links.send(
            attacker,
            &[join(), ClientMessage::Reserve { count: RESERVE_MAX }],
        );
        links.take(attacker, usize::MAX);
        let range = links.counts(attacker).granted.expect("it has joined");
        // The last index makes tables long, one in the middle leaves no long run.
        let place = [range.count() - 1, range.count() / 2][round as usize % 2];
        let at = [0.0, 2.0 * round as f32, 0.0];
        links.send(attacker, &[ball(range, place, at)]);
        assert_eq!(links.counts(attacker).refused, None);
        highest = highest.max(range.first() + place);
        let now = links.now;
        links.server.handle_ended(now, attacker, Ending::TimedOut);
        links.take(VICTIM, usize::MAX);
    }
    assert!(u64::from(highest) < Limits::default().indices_per_scene);
    links.connect(ATTACKER);
    links.send(ATTACKER, &[join()]);
    let range = links.counts(ATTACKER).granted.expect("it has joined");
    assert_eq!(links.counts(ATTACKER).bodies, 200);
    assert!(range.count() >= GRANT / 4, "{range:?}");
}

#[test]
fn a_session_without_vacant_indices_goes_on() {
    let mut links = Links::with_limits(Limits {
        indices_per_scene: u64::from(GRANT),
        members_per_scene: 1,
        ..Limits::default()
    });
    let enter = |links: &mut Links| {
        let (key, answered) = (SessionKey([7; 16]), 0);
        let session = ClientMessage::Session(SessionRequest { key, answered });
        links.connect(VICTIM);
        links.send(VICTIM, &[create(Stepping::Lockstep), session, join()]);
        links.take(VICTIM, usize::MAX);
    };
    enter(&mut links);
    assert_eq!(links.counts(VICTIM).resumed, Some(false));
    let share = links.counts(VICTIM).granted.expect("it has joined");
    let count = GRANT - share.count();
    let rest = [ClientMessage::Reserve { count }, shape(0, Shape::ball(0.5))];
    links.send(VICTIM, &rest);
    // A reservation ends the turn of its sender.
    links.pass(Span::from_millis(1));
    let rest = links.counts(VICTIM).granted.expect("the indices are free");
    assert_eq!(rest.count(), count);
    for range in [share, rest] {
        for place in 0..range.count() {
            let at = [0.0, 2.0 * (range.first() + place) as f32, 0.0];
            links.send(VICTIM, &[ball(range, place, at)]);
        }
    }
    assert_eq!(links.counts(VICTIM).refused, None);
    let now = links.now;
    links.server.handle_ended(now, VICTIM, Ending::TimedOut);
    links.connect(ATTACKER);
    links.send(ATTACKER, &[join()]);
    assert_eq!(links.counts(ATTACKER).denial, Some(Denial::NoIndicesLeft));
    enter(&mut links);
    assert_eq!(links.counts(VICTIM).resumed, Some(true));
}

#[test]
fn fast_scenes_are_charged_for_their_ticks() {
    let mut links = Links::new();
    links.begin(VICTIM, Stepping::FreeRunning);
    let rate = rhumb_reckoning::Rate::new(RATE_MAX, 1).expect("a rate");
    let mut config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    };
    config.integrator.rate = rate;
    let mut created = 0;
    for attempt in 0..250 {
        let attacker = Peer(10 + attempt);
        links.connect_to(attacker, &format!("fast-{attempt}"));
        links.send(attacker, &[ClientMessage::Create(config)]);
        match links.counts(attacker).denial {
            None => created += 1,
            Some(denial) => assert!(matches!(denial, Denial::Overloaded { .. }), "{denial}"),
        }
    }
    assert_eq!((created, links.server.scenes().count()), (79, 80));
    // A server that allows fewer ticks says which number is too great.
    let mut links = Links::with_limits(Limits {
        scene_ticks_per_second: 240,
        ..Limits::default()
    });
    links.connect(ATTACKER);
    links.send(ATTACKER, &[ClientMessage::Create(config)]);
    let too_fast = Denial::InvalidConfig(Invalid::out_of_range(Quantity::Rate));
    assert_eq!(links.counts(ATTACKER).denial, Some(too_fast));
    config.stepping = Stepping::Lockstep;
    links.send(ATTACKER, &[ClientMessage::Create(config), join()]);
    assert_eq!(links.counts(ATTACKER).joined, 1, "clients advance it");
}

#[test]
fn a_huge_dense_ball_removes_no_body_of_others() {
    let fast = [LINEAR_MAX, 0.0, 0.0];
    let spinning = [0.0, 0.0, ANGULAR_MAX];
    let still = [0.0; 3];
    for (depth, linear, angular) in [
        (0.0, still, still),
        (-EXTENT_MAX, still, spinning),
        (EXTENT_MAX, still, still),
        (-EXTENT_MAX, fast, spinning),
    ] {
        for swept in [false, true] {
            let mut links = Links::new();
            links.begin(VICTIM, Stepping::FreeRunning);
            links.send(VICTIM, &[shape(0, Shape::ball(0.5))]);
            let range = links.counts(VICTIM).granted.expect("it has joined");
            for place in 0..20 {
                let at = [0.0, place as f32 * 0.9, 0.0];
                links.send(VICTIM, &[ball(range, place, at)]);
            }
            links.connect(ATTACKER);
            links.send(ATTACKER, &[join(), shape(1, Shape::ball(EXTENT_MAX))]);
            let range = links.counts(ATTACKER).granted.expect("it has joined");
            let id = range.id(0).expect("within the range");
            let mut desc = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(1));
            desc.swept = swept;
            desc.material = Some(Material {
                density: DENSITY_MAX,
                friction: 1.0,
                restitution: 0.0,
            });
            let turn = [0.0, 0.0, 0.0, 1.0];
            let motion = BodyState::new([0.0, depth, 0.0], turn, linear, angular);
            let motion = motion.expect("finite");
            let add = Command::AddBody { desc, motion };
            links.send(ATTACKER, &[ClientMessage::Command(add)]);
            for _ in 0..60 {
                links.pass(Span::from_millis(17));
                links.take(VICTIM, usize::MAX);
                links.take(ATTACKER, usize::MAX);
            }
            let counts = links.counts(VICTIM);
            let attacked = (depth, linear, angular, swept);
            assert_eq!(
                (counts.not_finite, counts.closed),
                (0, None),
                "{attacked:?}"
            );
            assert_eq!(counts.bodies, 20);
            let too_heavy = CommandError::Invalid(Invalid::out_of_range(Quantity::Moments));
            assert_eq!(links.counts(ATTACKER).refused, Some(too_heavy));
        }
    }
}
