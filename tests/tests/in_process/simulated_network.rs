//! A server and members over simulated links: what holds at every tick.
//!
//! The tests run in virtual time. Every claim of every member, that a body is within a distance of a pose at a tick,
//! is stored several times per tick and checked against the truth afterwards. The truth is a replay of the commands at
//! the ticks stated by the server; its checksum must equal the server's. Runs are named by their seed.
//!
//! Caught so far: a member whose scene was deleted while its commands were in flight was closed for a violation. An
//! incomplete copy, and one refreshed from a later tick, claimed to be within tolerance at the tick before. A member
//! that joined just after a change of gravity predicted other falls than the publisher. A packet lost for longer than
//! it is remembered was reported forever. A lockstep member that did not lead never noticed the loss of the last
//! packet. A body that was removed while synchronisation was lost stayed in views.

use rhumb_netsim::{Direction, LinkConfig, Probability};
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::scene::{Command, Stepping};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Ending, Span};
use rhumb_reckoning::{Metres, Radians, Tick, Tolerance};
use rhumb_sims::{Script, Tumbler, by_name};
use rhumb_tests::{COMMANDER, Stage, TICK, assert_same_copy, seed};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);

/// Virtual time within which every copy converges after the faults stop: an idle scene sends a watermark within 2.5 s,
/// a loss report is repeated within half a second, and all of this may require a new snapshot first.
const SETTLES_WITHIN: Span = Span::from_millis(6_000);
/// Additional delay of control bytes that were lost repeatedly: 64 times the longest round trip here plus 25 ms (see
/// `Link`).
const CONTROL_WAITS: Span = Span::from_millis(64 * (360 + 25));

const SCENES: [&str; 2] = ["ball-pit", "zoo"];

fn script(name: &str) -> Box<dyn Script> {
    by_name(name, 60, 1).expect("an existing script")
}

fn links(text: &str) -> LinkConfig {
    text.parse().expect("a valid link configuration")
}

fn lockstep(scene: &str, choice: StreamChoice) -> Stage {
    Stage::new(
        script(scene),
        Stepping::Lockstep,
        choice,
        LinkConfig::PERFECT,
        1,
    )
}

fn free_running(scene: &str, links: LinkConfig) -> Stage {
    Stage::new(script(scene), Stepping::FreeRunning, NORMAL, links, 1)
}

/// A tolerance of 1 cm for the centre of a body and 2 mrad for its rotation.
fn parts() -> StreamChoice {
    let bounds = Tolerance::parts(Metres::new(0.01), Radians::new(0.002));
    StreamChoice::Within(bounds.expect("within range"))
}

fn assert_whole(stage: &Stage, index: usize, tick: Tick) {
    let stream = stage.copy(index).stream();
    assert_eq!(stream.complete(), tick, "member {index}");
    assert_eq!(stream.watermark_tick(), tick, "member {index}");
}

#[test]
fn in_lockstep_without_loss_every_tick_is_complete_and_every_body_within_tolerance() {
    for scene in SCENES {
        for choice in [NORMAL, EXACT, parts(), StreamChoice::Full] {
            let mut stage = lockstep(scene, choice);
            for _ in 0..420 {
                let tick = stage.tick();
                assert_whole(&stage, COMMANDER, tick);
            }
            let observation_history = &mut stage.histories[COMMANDER];
            observation_history.store_all_claims(stage.network.client(COMMANDER));
            // The member receives the placement of its new bodies before the tick that includes them.
            let truth = stage.truth();
            let worst = stage.histories[COMMANDER].judge(&truth, scene);
            if choice == StreamChoice::Full {
                // The difference of a quaternion from itself is not exactly zero, because of rounding.
                assert!(worst < Metres::new(1e-12), "{scene}: {worst}");
            } else {
                assert!(worst > Metres::new(0.0), "{scene}: no prediction was used");
            }
        }
    }
}

#[test]
fn two_members_of_a_tier_have_one_copy_to_the_bit() {
    for scene in SCENES {
        let mut stage = lockstep(scene, NORMAL);
        let second = stage.enter(NORMAL);
        let finer = stage.enter(EXACT);
        for _ in 0..400 {
            let tick = stage.tick();
            for member in [COMMANDER, second, finer] {
                assert_whole(&stage, member, tick);
            }
            assert_same_copy(stage.copy(COMMANDER), stage.copy(second));
        }
        let truth = stage.truth();
        for observation_history in &stage.histories {
            observation_history.judge(&truth, scene);
        }
    }
}

#[test]
fn a_late_joiner_sees_what_the_early_member_sees() {
    // The zoo changes gravity at ticks 300 and 360, so tracks from before and after it exist side by side.
    for joining in [1, 77, 301, 303, 361, 390] {
        let mut stage = lockstep("zoo", NORMAL);
        for _ in 0..joining {
            stage.tick();
        }
        let late = stage.enter(NORMAL);
        assert_same_copy(stage.copy(COMMANDER), stage.copy(late));
        for _ in 0..60 {
            let tick = stage.tick();
            assert_whole(&stage, late, tick);
            assert_same_copy(stage.copy(COMMANDER), stage.copy(late));
        }
        let truth = stage.truth();
        stage.histories[late].judge(&truth, "the late member");
    }
}

#[test]
fn either_of_two_lockstep_members_may_lead_and_both_see_every_tick() {
    let mut stage = lockstep("zoo", NORMAL);
    let second = stage.enter(NORMAL);
    for turn in 0..200 {
        stage.command(&[]);
        let leader = if turn % 2 == 0 { COMMANDER } else { second };
        let tick = stage.advance(leader);
        assert_whole(&stage, COMMANDER, tick);
        assert_whole(&stage, second, tick);
        // The other member requests the same tick: the scene steps only once.
        let now = stage.network.now();
        stage.network.client_mut(second).advance(now, tick).unwrap();
        stage.run(TICK);
        assert_whole(&stage, second, tick);
    }
    stage.truth();
}

#[test]
fn a_member_that_left_can_return_and_its_bodies_stay() {
    let mut stage = lockstep("ball-pit", NORMAL);
    let second = stage.enter(NORMAL);
    for round in 0..5 {
        for _ in 0..10 {
            stage.tick();
        }
        stage.network.client_mut(second).leave().unwrap();
        stage.run(TICK);
        assert_eq!(stage.histories[second].left, round + 1);
        assert!(stage.network.client(second).replica().is_none());
        for _ in 0..10 {
            stage.tick();
        }
        stage.join(second, NORMAL);
        assert_same_copy(stage.copy(COMMANDER), stage.copy(second));
    }
    let truth = stage.truth();
    stage.histories[second].judge(&truth, "the second member");
}

#[test]
fn messages_after_a_leave_close_no_connection() {
    let mut stage = lockstep("ball-pit", NORMAL);
    let second = stage.enter(NORMAL);
    stage.tick();
    let now = stage.network.now();
    let session = stage.network.client_mut(second);
    session.leave().unwrap();
    session.advance(now, Tick::new(50)).unwrap();
    session.inspect().unwrap();
    stage.run(TICK);
    assert_eq!(stage.histories[second].ended, None);
    assert_eq!(stage.histories[second].left, 1);
    stage.join(second, NORMAL);
    stage.tick();
    assert_same_copy(stage.copy(COMMANDER), stage.copy(second));
}

#[test]
fn a_deleted_scene_leaves_its_members_connected_whatever_was_in_flight() {
    let links = links("rtt=80ms");
    let mut stage = Stage::new(script("ball-pit"), Stepping::FreeRunning, NORMAL, links, 1);
    let other = stage.enter(NORMAL);
    stage.run_script(Span::from_millis(200));
    stage.network.client_mut(other).delete().unwrap();
    // The commander is not notified yet, and continues for a round trip.
    for _ in 0..3 {
        stage.command(&[]);
        let gravity = Command::SetGravity {
            gravity: glam::Vec3::ZERO,
        };
        stage
            .network
            .client_mut(COMMANDER)
            .command(gravity)
            .unwrap();
        stage.network.client_mut(COMMANDER).inspect().unwrap();
        stage
            .network
            .run_until(stage.network.now() + Span::from_millis(10));
    }
    stage.run(Span::from_millis(300));
    for member in [COMMANDER, other] {
        assert_eq!(stage.histories[member].ended, None, "member {member}");
        assert_eq!(stage.histories[member].deleted, 1, "member {member}");
        assert!(stage.network.client(member).replica().is_none());
    }
    // There is no scene to join; another one with the same name can be created and joined.
    stage.network.client_mut(other).join(NORMAL).unwrap();
    stage.run(Span::from_millis(300));
    assert_eq!(stage.histories[other].denied, [Denial::NoSuchScene]);
    let config = stage.config();
    stage.network.client_mut(other).create(config).unwrap();
    stage.join(other, NORMAL);
    stage.join(COMMANDER, NORMAL);
    assert_eq!(stage.copy(other).bodies().count(), 0);
}

fn all_converged(stage: &Stage, members: &[usize]) -> bool {
    let converged = |member: &usize| stage.copy(*member).stream().is_converged();
    members.iter().all(converged)
}

/// A free-running scene over bad links: checks claims, commands, and convergence after the faults stop.
fn survives(scene: &str, config: &str, seed: u64) {
    let what = format!("{scene} over {config:?}, seed {seed}");
    let mut stage = Stage::new(
        script(scene),
        Stepping::FreeRunning,
        NORMAL,
        links(config),
        seed,
    );
    let second = stage.enter(NORMAL);
    let exact = stage.enter(EXACT);
    let full = stage.enter(StreamChoice::Full);
    stage.run_script(Span::from_millis(2_500));
    let late = stage.enter(NORMAL);
    stage.run_script(Span::from_millis(1_500));
    let members = [COMMANDER, second, exact, full, late];
    stage.network.set_config(LinkConfig::PERFECT);
    let known = |stage: &Stage| stage.unanswered() == 0 && all_converged(stage, &members);
    stage.run_until_or(CONTROL_WAITS, known);
    stage.run(SETTLES_WITHIN);
    for member in members {
        assert_eq!(stage.histories[member].ended, None, "{what}");
        let stream = stage.copy(member).stream();
        assert!(
            stream.is_converged(),
            "{what}: member {member} does not converge"
        );
        assert_eq!(stream.statistics().malformed, 0, "{what}");
        let client = stage.network.client(member);
        let unknown = stage.histories[member].unknown;
        stage.histories[member].store_all_claims(client);
        assert_eq!(
            stage.histories[member].unknown, unknown,
            "{what}: member {member} has unknown bodies"
        );
    }
    assert_same_copy(stage.copy(COMMANDER), stage.copy(second));
    assert_same_copy(stage.copy(COMMANDER), stage.copy(late));
    let truth = stage.truth();
    for member in members {
        stage.histories[member].judge(&truth, &format!("{what}: member {member}"));
    }
}

#[test]
fn even_loss_breaks_no_claim_and_no_command() {
    for (scene, config) in [
        ("ball-pit", "loss=1%"),
        ("zoo", "loss=1%,rtt=60ms"),
        ("ball-pit", "loss=5%,rtt=100ms"),
        ("zoo", "loss=5%,rtt=300ms"),
        ("free-fall", "loss=20%,rtt=60ms"),
        ("zoo", "loss=20%,rtt=300ms"),
    ] {
        survives(scene, config, seed(11));
    }
}

#[test]
fn bursty_loss_breaks_no_claim_and_no_command() {
    for (scene, config) in [
        ("zoo", "loss=1%,burst=8"),
        ("ball-pit", "loss=1%,burst=20,rtt=150ms"),
        ("zoo", "loss=5%,burst=10,rtt=40ms"),
        ("ball-pit", "loss=5%,burst=5,rtt=300ms"),
        ("zoo", "loss=20%,burst=12,rtt=100ms"),
        ("free-fall", "loss=20%,burst=30,rtt=20ms"),
    ] {
        survives(scene, config, seed(12));
    }
}

#[test]
fn reordering_duplicates_and_jitter_break_no_claim_and_no_command() {
    for (scene, config) in [
        ("zoo", "rtt=50ms,jitter=60ms"),
        ("ball-pit", "rtt=30ms,reorder=20%,dup=10%"),
        ("zoo", "rtt=30ms,reorder=50%,dup=30%"),
        (
            "ball-pit",
            "rtt=200ms,jitter=40ms,loss=10%,burst=3,dup=5%,reorder=10%",
        ),
        ("zoo", "rtt=120ms,jitter=30ms,loss=10%,dup=5%,reorder=10%"),
    ] {
        survives(scene, config, seed(13));
    }
}

#[test]
fn lockstep_waits_out_every_loss() {
    for (scene, config) in [
        ("zoo", "rtt=20ms,loss=20%,burst=4"),
        ("ball-pit", "loss=20%,rtt=10ms,dup=10%,reorder=10%"),
    ] {
        let seed = seed(14);
        let mut stage = Stage::new(
            script(scene),
            Stepping::Lockstep,
            NORMAL,
            LinkConfig::PERFECT,
            seed,
        );
        let second = stage.enter(EXACT);
        stage.tick();
        stage.network.set_config(links(config));
        for _ in 0..150 {
            let tick = stage.tick();
            assert_whole(&stage, COMMANDER, tick);
        }
        stage.network.set_config(LinkConfig::PERFECT);
        stage.run(SETTLES_WITHIN);
        let tick = stage.copy(COMMANDER).stream().complete();
        assert_whole(&stage, second, tick);
        let truth = stage.truth();
        for observation_history in &stage.histories {
            observation_history.judge(&truth, &format!("{scene} over {config}, seed {seed}"));
        }
    }
}

/// Makes a member's link lose all datagrams in one direction.
fn lose_all_datagrams(stage: &mut Stage, member: usize, direction: Direction) {
    let nothing = LinkConfig::PERFECT.with_loss(Probability::ALL);
    stage.network.set_config_of(member, direction, nothing);
}

#[test]
fn a_member_that_was_cut_off_for_long_gets_a_new_snapshot() {
    let mut stage = free_running("zoo", LinkConfig::PERFECT);
    let lost = stage.enter(StreamChoice::Full);
    let early = stage.enter(StreamChoice::Full);
    stage.run_script(Span::from_millis(500));
    let before = stage.copy(early).stream().statistics().packets;
    lose_all_datagrams(&mut stage, lost, Direction::Down);
    // More packets than the publisher remembers.
    while stage.copy(early).stream().statistics().packets < before + 1_100 {
        stage.run_script(Span::from_millis(500));
    }
    assert!(stage.copy(lost).stream().complete() < stage.copy(early).stream().complete());
    stage.network.set_config(LinkConfig::PERFECT);
    // The control lane recovers after the longest interval between two attempts.
    stage.run(SETTLES_WITHIN);
    assert!(stage.copy(lost).stream().is_converged());
    let bodies = |member| stage.copy(member).bodies().count();
    assert_eq!(bodies(lost), bodies(early));
    let truth = stage.truth();
    for observation_history in &stage.histories {
        observation_history.judge(&truth, "a member that lost synchronisation, or another one");
    }
}

#[test]
fn a_body_removed_during_lost_sync_counts_as_changed() {
    let mut stage = free_running("ball-pit", LinkConfig::PERFECT);
    let lost = stage.enter(StreamChoice::Full);
    stage.run_script(Span::from_millis(100));
    let mut changed = Vec::new();
    let mut drain = |stage: &mut Stage| {
        let copy = stage.network.client_mut(lost).replica_mut();
        changed.clear();
        copy.unwrap().stream_mut().drain_changed(&mut changed);
        changed.clone()
    };
    drain(&mut stage);
    let ball = stage.copy(lost).bodies().last().unwrap().id;
    lose_all_datagrams(&mut stage, lost, Direction::Down);
    stage.command(&[Command::RemoveBody { id: ball }]);
    // Three packets per tick: more than the publisher remembers.
    stage.run_script(Span::from_millis(7_000));
    stage.network.set_config(LinkConfig::PERFECT);
    stage.run(SETTLES_WITHIN);
    assert!(stage.copy(lost).stream().is_converged());
    assert_eq!(stage.copy(lost).stream().body(ball.index()), None);
    assert!(drain(&mut stage).contains(&ball.index()));
}

#[test]
fn repair_symbols_go_only_to_members_that_lose_packets() {
    let mut stage = free_running("ball-pit", LinkConfig::PERFECT);
    let loses = stage.enter(NORMAL);
    let other = stage.enter(NORMAL);
    stage.run_script(Span::from_millis(300));
    let lossy = links("rtt=40ms,loss=10%");
    stage.network.set_config_of(loses, Direction::Down, lossy);
    stage.run_script(Span::from_millis(6_000));
    let received = |stage: &Stage, index: usize| stage.copy(index).stream().statistics();
    let (lossy, clean) = (received(&stage, loses), received(&stage, other));
    assert!(lossy.repair_symbols > 100 && lossy.rebuilt > 0, "{lossy:?}");
    assert_eq!((clean.repair_symbols, clean.missed), (0, 0));
    // A member whose losses begin later receives repair symbols as well.
    let lossy = links("rtt=40ms,loss=10%");
    stage.network.set_config_of(other, Direction::Down, lossy);
    stage.run_script(Span::from_millis(4_000));
    assert!(received(&stage, other).repair_symbols > 50);
    stage.network.set_config(LinkConfig::PERFECT);
    stage.run(SETTLES_WITHIN);
    let truth = stage.truth();
    for index in [loses, other] {
        assert!(stage.copy(index).stream().is_converged());
        stage.histories[index].judge(&truth, "a member that lost packets");
    }
}

/// Loses one tick of a member's stream; afterwards its link has this configuration.
fn lose_a_tick(stage: &mut Stage, member: usize, config: LinkConfig) {
    lose_all_datagrams(stage, member, Direction::Down);
    stage.run_script(TICK);
    stage.network.set_config_of(member, Direction::Down, config);
}

#[test]
fn a_first_loss_is_answered_at_once_whatever_others_are_sent() {
    let far = links("rtt=400ms");
    let mut stage = free_running("tumbler", far);
    let loses = stage.enter(EXACT);
    let other = stage.enter(EXACT);
    stage.run_script(Span::from_millis(2_000));
    let lossy = links("rtt=400ms,loss=10%");
    stage.network.set_config_of(loses, Direction::Down, lossy);
    stage.run_script(Span::from_millis(5_000));
    let received = |stage: &Stage, index: usize| stage.copy(index).stream().statistics();
    assert!(received(&stage, loses).repair_symbols > 50);
    assert_eq!(received(&stage, other).repair_symbols, 0);
    // Repeats until the lost datagram is a packet.
    while stage.copy(other).stream().missing() == 0 {
        lose_a_tick(&mut stage, other, far);
        stage.run_script(Span::from_millis(250));
    }
    // A round trip, and some ticks.
    stage.run_script(Span::from_millis(400 + 50));
    assert_eq!(stage.copy(other).stream().missing(), 0);
    assert!(received(&stage, other).rebuilt > 0);
}

#[test]
fn losses_of_a_departed_member_cost_others_nothing() {
    let near = links("rtt=40ms");
    // Few bodies suffice for a packet at each tick.
    let tumbler = Box::new(Tumbler::new(40, 1));
    let mut stage = Stage::new(tumbler, Stepping::FreeRunning, NORMAL, near, 1);
    let loses = stage.enter(NORMAL);
    let other = stage.enter(NORMAL);
    stage.run_script(Span::from_millis(1_000));
    let lossy = links("rtt=40ms,loss=10%");
    stage.network.set_config_of(loses, Direction::Down, lossy);
    stage.run_script(Span::from_millis(1_000));
    lose_a_tick(&mut stage, other, near);
    let received = |stage: &Stage, index: usize| stage.copy(index).stream().statistics();
    // Enough packets that the lost one is obsolete, and few enough that it is still remembered.
    let lost_at = received(&stage, other).packets;
    while received(&stage, other).packets < lost_at + 300 {
        stage.run_script(TICK);
    }
    stage.network.client_mut(loses).leave().unwrap();
    stage.run(Span::from_millis(100));
    let before = received(&stage, other);
    assert!(before.repair_symbols > 50, "{before:?}");
    while received(&stage, other).packets < lost_at + 400 {
        stage.run_script(TICK);
    }
    assert_eq!(
        received(&stage, other).repair_symbols,
        before.repair_symbols
    );
}

#[test]
fn a_forgotten_packet_is_not_reported_forever() {
    let perfect = LinkConfig::PERFECT;
    let mut stage = free_running("zoo", perfect);
    let lost = stage.enter(StreamChoice::Full);
    stage.run_script(Span::from_millis(300));
    // One tick is lost on the way down, and all loss reports are lost until it is forgotten; everything else arrives.
    lose_all_datagrams(&mut stage, lost, Direction::Up);
    lose_all_datagrams(&mut stage, lost, Direction::Down);
    stage.run_script(TICK);
    stage.network.set_config_of(lost, Direction::Down, perfect);
    // The packet is too old at last; the request for a new snapshot cannot leave yet.
    while !stage.copy(lost).stream().has_lost_sync() {
        stage.run_script(Span::from_millis(500));
    }
    stage.network.set_config(perfect);
    let converged = |stage: &Stage| all_converged(stage, &[lost]);
    stage.run_until_or(SETTLES_WITHIN, converged);
    assert!(stage.copy(lost).stream().is_converged());
    let truth = stage.truth();
    stage.histories[lost].judge(&truth, "the member");
}

#[test]
fn a_broken_connection_takes_its_member_and_no_body() {
    let mut stage = lockstep("ball-pit", NORMAL);
    let disconnected = stage.enter(NORMAL);
    for _ in 0..20 {
        stage.tick();
    }
    stage.network.sever(disconnected, Ending::TimedOut);
    stage.tick();
    assert_eq!(stage.histories[disconnected].ended, Some(Ending::TimedOut));
    let again = stage.enter(NORMAL);
    assert_same_copy(stage.copy(COMMANDER), stage.copy(again));
    stage.network.client_mut(again).close(CloseCode::DONE);
    stage.run(TICK);
    assert_eq!(
        stage.histories[again].ended,
        Some(Ending::Closed(CloseCode::DONE.0))
    );
    stage.tick();
    stage.truth();
}

#[test]
fn one_seed_is_one_run_over_any_links() {
    let run = |seed| {
        let links = links("rtt=60ms,loss=10%,jitter=20ms,dup=5%,reorder=5%");
        let mut stage = Stage::new(script("zoo"), Stepping::FreeRunning, NORMAL, links, seed);
        stage.run_script(Span::from_millis(1_500));
        stage.histories.swap_remove(COMMANDER).claims
    };
    let seed = seed(15);
    assert_eq!(run(seed), run(seed));
    assert_ne!(run(seed), run(seed + 1));
}
