//! Members of edges have the copies, bounds and answers of the server's own.
//!
//! The tests run in virtual time. Claims of every member are judged against a replay of the commands, whose checksum
//! must equal the server's: a command that was lost or applied twice would change it.

use std::collections::BTreeSet;

use glam::Vec3;
use rhumb_netsim::{Lane, LinkConfig};
use rhumb_protocol::limits::{EVENTS_PER_TICK_MAX, HISTORY_PACKETS, STREAMS_PER_SCENE_MAX};
use rhumb_protocol::message::{ClientMessage, Denial, SessionKey, StreamChoice};
use rhumb_protocol::packet::{Low16, Watermark};
use rhumb_protocol::scene::{
    ActiveEvents, BodyDesc, BodyKind, Command, CommandError, Query, SceneConfig, Shape, ShapeId,
    Stepping,
};
use rhumb_protocol::{Ending, Span};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tick, Tolerance};
use rhumb_scene::Permit;
use rhumb_sims::{Script, by_name};
use rhumb_tests::{EdgeStage, Place, assert_same_copy, seed};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);

/// Virtual time within which every copy converges after the faults stop.
const SETTLES_WITHIN: Span = Span::from_millis(6_000);
const SCENES: [&str; 2] = ["ball-pit", "zoo"];

fn script(name: &str) -> Box<dyn Script> {
    by_name(name, 60, 1).expect("an existing script")
}

fn links(text: &str) -> LinkConfig {
    text.parse().expect("a valid link configuration")
}

fn observers() -> Permit {
    Permit {
        role: rhumb_protocol::message::Role::Observer,
        ..Permit::OPEN
    }
}

fn judge_all(stage: &mut EdgeStage, scene: &str) {
    let truth = stage.truth();
    for (index, history) in stage.histories.iter().enumerate() {
        let worst = history.judge(&truth, &format!("{scene}, member {index}"));
        assert!(
            worst > Metres::new(0.0),
            "{scene}, member {index}: {} claims, {} unknown",
            history.claims.len(),
            history.unknown
        );
    }
}

#[test]
fn in_lockstep_members_of_edges_have_the_server_s_copy_to_the_bit() {
    for scene in SCENES {
        for choice in [NORMAL, EXACT, StreamChoice::Full] {
            let mut stage =
                EdgeStage::new(script(scene), Stepping::Lockstep, 2, LinkConfig::PERFECT, 1);
            stage.commander(Place::Edge(0), choice, None);
            let direct = stage.enter(Place::Owner, choice);
            let there = stage.enter(Place::Edge(1), choice);
            for _ in 0..200 {
                let tick = stage.tick();
                for member in [0, direct, there] {
                    assert_eq!(stage.copy(member).stream().watermark_tick(), tick);
                }
                assert_same_copy(stage.copy(direct), stage.copy(there));
                assert_same_copy(stage.copy(direct), stage.copy(0));
            }
            let late = stage.enter(Place::Edge(0), choice);
            for _ in 0..200 {
                stage.tick();
                assert_same_copy(stage.copy(direct), stage.copy(late));
                assert_same_copy(stage.copy(direct), stage.copy(0));
            }
            let truth = stage.truth();
            for history in &stage.histories {
                history.judge(&truth, scene);
            }
        }
    }
}

#[test]
fn observers_of_an_edge_cost_the_owner_one_member() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        LinkConfig::PERFECT,
        1,
    );
    let edge = stage.add_edge(observers(), LinkConfig::PERFECT);
    stage.commander(Place::Owner, NORMAL, None);
    let observers: Vec<_> = (0..12)
        .map(|_| stage.enter(Place::Edge(edge), NORMAL))
        .collect();
    assert_eq!(stage.links(), 1);
    stage.run_script(Span::from_millis(4_000));
    for observer in &observers {
        assert_same_copy(stage.copy(observers[0]), stage.copy(*observer));
        assert_eq!(stage.copy(*observer).stream().statistics().missed, 0);
    }
    judge_all(&mut stage, "ball-pit");
}

#[test]
fn an_observer_of_an_edge_acts_on_nothing() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        LinkConfig::PERFECT,
        1,
    );
    let edge = stage.add_edge(observers(), LinkConfig::PERFECT);
    let early = stage.connect(Place::Edge(edge));
    stage
        .session(early)
        .join(NORMAL)
        .expect("it is in the lobby");
    stage.run_until("a denial", |stage| {
        !stage.histories[early].denied.is_empty()
    });
    assert_eq!(stage.histories[early].denied, [Denial::NoSuchScene]);
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        LinkConfig::PERFECT,
        1,
    );
    let edge = stage.add_edge(observers(), LinkConfig::PERFECT);
    stage.commander(Place::Owner, NORMAL, None);
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    let gravity = Command::SetGravity { gravity: Vec3::X };
    for _ in 0..2 {
        stage
            .session(observer)
            .command(gravity.clone())
            .expect("a member may try");
    }
    stage
        .session(observer)
        .reserve(5)
        .expect("a member may try");
    stage.session(observer).inspect().expect("a member may");
    stage.run_script(Span::from_millis(1_000));
    let history = &stage.histories[observer];
    let refused = |number| (number, CommandError::NotAllowed);
    assert_eq!(history.refused, [refused(0), refused(1)]);
    assert_eq!(history.denied, [Denial::NotAllowed]);
    assert_eq!(history.inspections.len(), 1);
    judge_all(&mut stage, "ball-pit");
}

#[test]
fn over_lossy_links_on_both_sides_of_an_edge_every_claim_holds_and_all_converge() {
    for (scene, seed) in SCENES
        .into_iter()
        .flat_map(|scene| (0..1).map(move |add| (scene, seed(7) + add)))
    {
        for (upper, lower) in [
            ("rtt=20ms,loss=8%", "rtt=30ms,loss=8%"),
            ("rtt=10ms", "rtt=60ms,loss=15%,jitter=8ms"),
            ("rtt=40ms,loss=20%", "rtt=2ms"),
        ] {
            let mut stage = EdgeStage::new(
                script(scene),
                Stepping::FreeRunning,
                2,
                LinkConfig::PERFECT,
                seed,
            );
            stage.commander(Place::Edge(0), NORMAL, None);
            stage.enter(Place::Owner, NORMAL);
            stage.enter(Place::Edge(1), NORMAL);
            stage.enter(Place::Edge(1), EXACT);
            // Control bytes that are lost again and again would hold the bodies back.
            stage.run_script(Span::from_millis(500));
            stage.set_links(Place::Owner, links(upper));
            for edge in [0, 1] {
                stage.set_links(Place::Edge(edge), links(lower));
            }
            stage.run_script(Span::from_millis(3_000));
            // The simulated network takes a snapshot for one packet, which hardly ever arrives over such links.
            stage.set_links(Place::Edge(1), LinkConfig::PERFECT);
            let late = stage.enter(Place::Edge(1), NORMAL);
            stage.set_links(Place::Edge(1), links(lower));
            stage.run_script(Span::from_millis(3_000));
            for place in [Place::Owner, Place::Edge(0), Place::Edge(1)] {
                stage.set_links(place, LinkConfig::PERFECT);
            }
            stage.run(SETTLES_WITHIN);
            for member in 0..=late {
                let stream = stage.copy(member).stream();
                assert!(
                    stream.is_converged(),
                    "{scene}, {upper}, {lower}, SEED={seed}: member {member}"
                );
            }
            assert_same_copy(stage.copy(1), stage.copy(2));
            assert_same_copy(stage.copy(1), stage.copy(late));
            judge_all(&mut stage, scene);
        }
    }
}

#[test]
fn a_member_of_an_edge_changes_its_stream() {
    let mut stage = EdgeStage::new(
        script("zoo"),
        Stepping::FreeRunning,
        1,
        links("rtt=30ms,loss=5%"),
        3,
    );
    stage.commander(Place::Edge(0), NORMAL, None);
    let direct = stage.enter(Place::Owner, EXACT);
    let other = stage.enter(Place::Edge(0), NORMAL);
    for choice in [EXACT, NORMAL, EXACT] {
        stage.run_script(Span::from_millis(700));
        stage
            .session(other)
            .subscribe(choice)
            .expect("a member may");
        stage.run_script(Span::from_millis(700));
        assert_eq!(stage.histories[other].following.last(), Some(&choice));
    }
    stage.set_links(Place::Owner, LinkConfig::PERFECT);
    stage.set_links(Place::Edge(0), LinkConfig::PERFECT);
    stage.run(SETTLES_WITHIN);
    assert_same_copy(stage.copy(direct), stage.copy(other));
    judge_all(&mut stage, "zoo");
}

#[test]
fn a_killed_edge_loses_no_command_and_doubles_none() {
    for seed in (0..4).map(|add| seed(11) + add) {
        let mut stage = EdgeStage::new(
            script("ball-pit"),
            Stepping::FreeRunning,
            3,
            links("rtt=30ms,loss=4%"),
            seed,
        );
        stage.commander(Place::Edge(0), NORMAL, Some(SessionKey([7; 16])));
        let other = stage.enter(Place::Edge(2), NORMAL);
        let gravity = |y| Command::SetGravity {
            gravity: Vec3::new(0.0, y, 0.0),
        };
        for (round, (from, to)) in [(0, 1), (1, 2), (2, 1)].into_iter().enumerate() {
            stage.run_script(Span::from_millis(900));
            for step in 0..20 {
                stage.send(gravity(-9.0 - 0.1 * (round * 20 + step) as f32));
            }
            if from == 2 {
                break;
            }
            stage.kill(from);
            stage.run(Span::from_millis(100));
            stage.resume(0, Place::Edge(to));
            for _ in 0..5 {
                stage.send(gravity(-9.81));
            }
            stage.run_until("a copy", |stage| stage.client(0).replica().is_some());
        }
        stage.run_script(Span::from_millis(1_000));
        stage.run(SETTLES_WITHIN);
        assert_eq!(stage.histories[0].refused, [], "SEED={seed}");
        assert!(stage.copy(other).stream().is_converged());
        judge_all(&mut stage, "ball-pit");
    }
}

#[test]
fn an_edge_that_loses_the_owner_keeps_its_observers_and_comes_back() {
    let mut stage = EdgeStage::new(
        script("zoo"),
        Stepping::FreeRunning,
        0,
        links("rtt=20ms"),
        5,
    );
    let edge = stage.add_edge(observers(), links("rtt=20ms"));
    stage.commander(Place::Owner, NORMAL, None);
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    for _ in 0..3 {
        stage.run_script(Span::from_millis(1_000));
        stage.cut_off(edge);
        stage.run_script(Span::from_millis(1_000));
        assert_eq!(stage.histories[observer].ended, None);
    }
    stage.run(SETTLES_WITHIN);
    assert_same_copy(stage.copy(0), stage.copy(observer));
    judge_all(&mut stage, "zoo");
}

#[test]
fn a_member_that_acts_comes_back_by_its_session_when_its_edge_loses_the_owner() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        1,
        links("rtt=20ms"),
        5,
    );
    stage.commander(Place::Edge(0), NORMAL, Some(SessionKey([9; 16])));
    stage.run_script(Span::from_millis(1_000));
    stage.cut_off(0);
    stage.run_until("an end", |stage| stage.histories[0].ended.is_some());
    let going_away = rhumb_protocol::session::TransportCode::GOING_AWAY.0;
    assert_eq!(stage.histories[0].ended, Some(Ending::Closed(going_away)));
    stage.resume(0, Place::Edge(0));
    stage.run_until("a copy", |stage| stage.client(0).replica().is_some());
    stage.run_script(Span::from_millis(2_000));
    stage.run(SETTLES_WITHIN);
    judge_all(&mut stage, "ball-pit");
}

const FLOOR: BodyId = BodyId::new(0, 0);
/// More pairs than two ticks tell.
const BOXES: u32 = 2 * EVENTS_PER_TICK_MAX as u32 + 76;

/// Boxes that lie on a floor, which reports its contacts.
struct Crowd;

impl Script for Crowd {
    fn name(&self) -> &'static str {
        "crowd"
    }

    fn config(&self) -> SceneConfig {
        SceneConfig::default()
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        if tick != Tick::ZERO {
            return;
        }
        let half = [Vec3::new(50.0, 0.5, 50.0), Vec3::splat(0.5)];
        for (id, half) in (0..).map(ShapeId).zip(half) {
            let shape = Shape::cuboid(half.x, half.y, half.z);
            out.push(Command::AddShape { id, shape });
        }
        let mut add = |id, kind, shape, at: Vec3| {
            let still = [0.0; 3];
            let motion = BodyState::new(at.to_array(), [0.0, 0.0, 0.0, 1.0], still, still);
            let desc = BodyDesc::plain(id, kind, ShapeId(shape));
            let motion = motion.expect("a finite state");
            out.push(Command::AddBody { desc, motion });
        };
        add(FLOOR, BodyKind::Fixed, 0, Vec3::Y * -0.5);
        for number in 0..BOXES {
            let (x, z) = (number % 48, number / 48);
            let at = Vec3::new(x as f32 * 1.4 - 34.0, 0.5, z as f32 * 1.4 - 34.0);
            add(BodyId::new(1 + number, 0), BodyKind::Dynamic, 1, at);
        }
        let events = ActiveEvents {
            contacts: true,
            ..ActiveEvents::NONE
        };
        out.push(Command::SetEvents { id: FLOOR, events });
    }
}

/// Checks that a member knows that every box touches the floor.
fn assert_all_touch(stage: &EdgeStage, member: usize) {
    let boxes = (1..=BOXES).map(|index| BodyId::new(index, 0));
    let all: BTreeSet<_> = boxes.map(|id| (FLOOR, id)).collect();
    let known = &stage.histories[member].touching;
    assert!(
        *known == all,
        "member {member} knows {} of {}",
        known.len(),
        all.len()
    );
}

/// More stands than a tick tells: the next ticks tell the rest to a member of an edge, as they do to one of the server.
#[test]
fn a_late_member_of_an_edge_gets_all_that_stands() {
    let mut stage = EdgeStage::new(
        Box::new(Crowd),
        Stepping::Lockstep,
        2,
        LinkConfig::PERFECT,
        1,
    );
    stage.commander(Place::Edge(0), StreamChoice::Full, None);
    for _ in 0..5 {
        stage.tick();
    }
    let places = [Place::Owner, Place::Edge(0), Place::Edge(1)];
    let late = places.map(|place| stage.enter(place, StreamChoice::Full));
    for _ in 0..6 {
        stage.tick();
    }
    for member in [&[0][..], &late].concat() {
        assert_all_touch(&stage, member);
        let history = &stage.histories[member];
        assert!(history.begun_at_most <= EVENTS_PER_TICK_MAX);
    }
    for member in late {
        assert_eq!(stage.histories[member].events_missed, 0, "member {member}");
    }
}

/// In a scene in which nothing happens the ticks are rare: an edge that knows all asks for them.
#[test]
fn what_stands_is_known_within_a_second_while_nothing_happens() {
    let mut stage = EdgeStage::new(
        Box::new(Crowd),
        Stepping::FreeRunning,
        1,
        links("rtt=20ms"),
        1,
    );
    stage.commander(Place::Owner, NORMAL, None);
    stage.run_script(Span::from_millis(3_000));
    let first = stage.enter(Place::Edge(0), NORMAL);
    stage.run(Span::from_millis(6_000));
    assert_all_touch(&stage, first);
    let late = stage.enter(Place::Edge(0), NORMAL);
    stage.run(Span::from_millis(1_000));
    assert_all_touch(&stage, late);
    // Over another connection to the owner, and with another stream.
    stage.cut_off(0);
    stage.run_until("an end", |stage| stage.histories[late].ended.is_some());
    let edge = stage.add_edge(observers(), links("rtt=20ms"));
    let late = stage.enter(Place::Edge(edge), NORMAL);
    for change in 0..2 {
        match change {
            0 => stage.cut_off(edge),
            _ => stage.session(late).subscribe(EXACT).expect("a member may"),
        }
        stage.run(Span::from_millis(6_000));
        assert_all_touch(&stage, late);
        assert_eq!(stage.histories[late].ended, None);
    }
}

/// Questions outlive the connection that they were asked over, but not the membership of who asked.
#[test]
fn an_observer_s_questions_are_answered_while_it_is_a_member() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        links("rtt=20ms"),
        1,
    );
    let edge = stage.add_edge(observers(), links("rtt=20ms"));
    stage.commander(Place::Owner, NORMAL, None);
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    stage.run_script(Span::from_millis(500));
    let ray = || Query::ray(Vec3::Y * 20.0, Vec3::NEG_Y * 40.0);
    let ask = |stage: &mut EdgeStage, count: usize| {
        for _ in 0..count {
            let session = stage.session(observer);
            session.query(vec![ray()]).expect("a member may");
            session.inspect().expect("a member may");
        }
    };
    ask(&mut stage, 100);
    stage.cut_off(edge);
    stage.run(Span::from_millis(5));
    ask(&mut stage, 100);
    stage.run_script(Span::from_millis(3_000));
    let history = &stage.histories[observer];
    assert_eq!(history.queries, (0..200).collect::<Vec<_>>());
    assert_eq!(history.inspections.len(), 200);
    ask(&mut stage, 3);
    stage.session(observer).leave().expect("it is a member");
    stage.run_until("an end", |stage| stage.histories[observer].left > 0);
    stage.join(observer, NORMAL);
    ask(&mut stage, 1);
    stage.run_script(Span::from_millis(1_000));
    let history = &stage.histories[observer];
    assert_eq!((history.inspections.len(), history.ended), (201, None));
    assert_eq!(history.queries[200..], [0]);
}

#[test]
fn observers_learn_that_the_scene_has_gone_while_the_edge_was_cut_off() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        links("rtt=20ms"),
        1,
    );
    let edge = stage.add_edge(observers(), links("rtt=20ms"));
    stage.commander(Place::Owner, NORMAL, None);
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    stage.run_script(Span::from_millis(500));
    stage.session(0).delete().expect("it is a member");
    stage.cut_off(edge);
    stage.run_until("an end", |stage| stage.histories[observer].deleted > 0);
    // The scene is made again, and the observer comes back.
    let config = script("ball-pit").config();
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..config
    };
    stage.session(0).create(config).expect("it is in the lobby");
    stage.run_until("the scene", |stage| stage.histories[0].created == 2);
    stage.join(0, NORMAL);
    stage.join(observer, NORMAL);
    stage.run(SETTLES_WITHIN);
    assert_same_copy(stage.copy(0), stage.copy(observer));
}

/// An edge of observers in lockstep, with a commander at the server and one observer.
fn observed(scene: Box<dyn Script>) -> (EdgeStage, usize, usize) {
    let mut stage = EdgeStage::new(scene, Stepping::Lockstep, 0, LinkConfig::PERFECT, 1);
    let edge = stage.add_edge(observers(), LinkConfig::PERFECT);
    stage.commander(Place::Owner, NORMAL, None);
    for _ in 0..20 {
        stage.tick();
    }
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    (stage, edge, observer)
}

/// The watermark of a stream of the same name whose next packet is so many later.
fn watermark_of_another(stage: &EdgeStage, member: usize, later: u64) -> Vec<u8> {
    let stream = stage.copy(member).stream();
    let watermark = Watermark {
        next: Low16::of(stream.next_number() + later),
        tick: Low16::of(stream.watermark_tick().value()),
        scene_events: Low16::of(stream.scene_events()),
    };
    watermark.encode(stream.stream())
}

/// The stream that an owner has after its restart may have the name of one before. Packets of that one which a member has
/// not read are then taken for packets of this one, which no one can send again.
#[test]
fn late_datagrams_of_an_earlier_stream_do_not_freeze_a_member() {
    let (mut stage, _, observer) = observed(script("ball-pit"));
    let late = watermark_of_another(&stage, observer, 20);
    stage.deliver(observer, &late);
    assert!(!stage.copy(observer).stream().is_converged());
    stage.run(Span::from_millis(4_000));
    assert!(stage.copy(observer).stream().is_converged());
    for _ in 0..30 {
        stage.tick();
        assert_same_copy(stage.copy(0), stage.copy(observer));
    }
}

#[test]
fn an_edge_ends_a_malformed_connection_to_the_owner_and_comes_back() {
    let (mut stage, edge, observer) = observed(script("ball-pit"));
    assert_eq!(stage.links(), 1);
    stage.deliver_from_owner(edge, 0, Lane::Control, &[0xFF; 64]);
    stage.run(Span::from_millis(2_000));
    assert_eq!(stage.links(), 2);
    for _ in 0..30 {
        stage.tick();
        assert_same_copy(stage.copy(0), stage.copy(observer));
    }
}

/// A server tells what stands with a membership, not with each snapshot of it.
#[test]
fn an_edge_that_got_a_snapshot_again_knows_what_stands() {
    let (mut stage, edge, observer) = observed(Box::new(Crowd));
    let late = watermark_of_another(&stage, observer, 2 * HISTORY_PACKETS as u64);
    stage.deliver_from_owner(edge, 0, Lane::State, &late);
    stage.run(Span::from_millis(1_000));
    let late = stage.enter(Place::Edge(edge), NORMAL);
    for _ in 0..6 {
        stage.tick();
    }
    assert_all_touch(&stage, late);
    assert_all_touch(&stage, observer);
}

#[test]
fn a_snapshot_that_has_to_wait_is_sent_when_its_time_comes() {
    let scene = by_name("ball-pit", 1_000, 1).expect("an existing script");
    let mut stage = EdgeStage::new(scene, Stepping::Lockstep, 0, LinkConfig::PERFECT, 1);
    let edge = stage.add_paced_edge(observers(), LinkConfig::PERFECT);
    stage.commander(Place::Owner, NORMAL, None);
    stage.tick();
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    stage
        .session(observer)
        .subscribe(EXACT)
        .expect("a member may");
    stage.run(Span::from_millis(500));
    assert_eq!(stage.histories[observer].following.last(), Some(&EXACT));
}

#[test]
fn a_member_whose_mirror_came_back_hears_nothing_before_the_snapshot() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        LinkConfig::PERFECT,
        1,
    );
    let edge = stage.add_paced_edge(observers(), LinkConfig::PERFECT);
    stage.commander(Place::Owner, NORMAL, None);
    stage.run_script(Span::from_millis(500));
    // Its snapshot is on its way for long.
    stage.hold_links(edge);
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    stage.cut_off(edge);
    let id = BodyId::new(3_000, 0);
    let still = [0.0; 3];
    let motion = BodyState::new([0.0, 90.0, 0.0], [0.0, 0.0, 0.0, 1.0], still, still);
    stage.send(Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Fixed, ShapeId(0)),
        motion: motion.expect("a finite state"),
    });
    stage.run(Span::from_millis(1_000));
    stage.send(Command::RemoveBody { id });
    stage.run(Span::from_millis(1_000));
    assert_eq!(stage.histories[observer].ended, None);
    assert_eq!(stage.histories[0].refused, []);
    assert!(stage.copy(0).body(id).is_none());
    stage.release_links(edge);
    stage.run(SETTLES_WITHIN);
    assert_eq!(stage.histories[observer].ended, None);
    assert_same_copy(stage.copy(0), stage.copy(observer));
}

#[test]
fn members_that_act_hear_that_their_scene_is_deleted() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        1,
        links("rtt=20ms"),
        1,
    );
    stage.commander(Place::Edge(0), NORMAL, None);
    let others = [0; 2].map(|_| stage.enter(Place::Edge(0), NORMAL));
    stage.run_script(Span::from_millis(500));
    stage.session(others[0]).delete().expect("a member may");
    for member in [0, others[0], others[1]] {
        stage.run_until("an end", |stage| stage.histories[member].deleted > 0);
    }
}

#[test]
fn a_member_learns_that_a_stream_cannot_be_had() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        0,
        links("rtt=20ms"),
        1,
    );
    let edge = stage.add_edge(observers(), links("rtt=20ms"));
    stage.commander(Place::Owner, NORMAL, None);
    for millimetres in 1..STREAMS_PER_SCENE_MAX as u32 {
        stage.enter(Place::Owner, within(millimetres));
    }
    let observer = stage.enter(Place::Edge(edge), NORMAL);
    let session = stage.session(observer);
    session.subscribe(within(100)).expect("a member may");
    stage.run_until("a denial", |stage| {
        !stage.histories[observer].denied.is_empty()
    });
    assert_eq!(stage.histories[observer].denied, [Denial::TooManyStreams]);
    let session = stage.session(observer);
    session.subscribe(within(1)).expect("a member may");
    stage.run_until("a stream", |stage| {
        stage.histories[observer].following.last() == Some(&within(1))
    });
}

fn within(millimetres: u32) -> StreamChoice {
    let tolerance = Tolerance::from_micrometres(millimetres * 1_000);
    StreamChoice::Within(tolerance.expect("a tolerance"))
}

#[test]
fn a_member_has_few_connections_opened_whatever_it_asks() {
    let (mut stage, _, observer) = observed(script("ball-pit"));
    let mut bytes = Vec::new();
    for millimetres in 1..=200 {
        ClientMessage::Subscribe(within(millimetres)).encode(&mut bytes);
    }
    stage.write(observer, &bytes);
    stage.run(Span::from_millis(1_000));
    assert!(
        stage.links() <= STREAMS_PER_SCENE_MAX,
        "{} connections",
        stage.links()
    );
    // The last one counts.
    stage.run_until("a stream", |stage| {
        stage.copy(observer).choice() == within(200)
    });
    for _ in 0..10 {
        stage.tick();
    }
    assert!(stage.copy(observer).stream().is_converged());
}

/// The edge asked for the scene before it was created, and hears the answer after its member's.
#[test]
fn a_late_denial_does_not_keep_a_member_waiting() {
    let mut stage = EdgeStage::new(
        script("ball-pit"),
        Stepping::FreeRunning,
        1,
        links("rtt=20ms"),
        1,
    );
    let (first, second) = (stage.connect(Place::Edge(0)), stage.connect(Place::Edge(0)));
    let join = |stage: &mut EdgeStage, member| {
        let session = stage.session(member);
        session.join(NORMAL).expect("it is in the lobby");
    };
    join(&mut stage, second);
    stage.run_until("a denial", |stage| {
        !stage.histories[second].denied.is_empty()
    });
    stage.run(Span::from_millis(500));
    stage.set_link_from_owner(0, 2, links("rtt=300ms"));
    join(&mut stage, second);
    stage.run(Span::from_millis(2));
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..script("ball-pit").config()
    };
    stage
        .session(first)
        .create(config)
        .expect("it is in the lobby");
    join(&mut stage, first);
    stage.run_until("a membership", |stage| {
        stage.histories[first].granted.is_some()
    });
}
