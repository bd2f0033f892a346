//! The server's states of published bodies are within tolerance.
//!
//! The tests run in virtual time, over simulated links, with `Walk`: at each tick whose upstream was complete in time,
//! avatars must be within tolerance. Grants of authority are tested in `authority`.

use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{Command, Stepping};
use rhumb_protocol::stream::PublisherStatistics;
use rhumb_reckoning::{BodyState, Divergence, Tick, Ticks, Tolerance};
use rhumb_tests::{Avatars, COMMANDER, TICK, Walk, seed};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// Over disturbed links: upstream that was complete in time is correct, and few steps are late.
fn survives(config: &str, lead: u64, late: f64, seed: u64) {
    let mut walk = Walk::new(Stepping::FreeRunning, 3, lead, seed);
    walk.set_link(config);
    for _ in 0..900 {
        walk.frame();
    }
    let status = walk.statistics().expect("the commander has authority");
    let share = status.late_steps as f64 / status.steps as f64;
    assert!(
        share <= late,
        "{config}, seed {seed}: {share} of the steps were late"
    );
    assert!(
        walk.judged > 1_000,
        "{config}: only {} states were checked",
        walk.judged
    );
    assert!(walk.worst > 0.3, "{config}: no prediction was used");
    assert_eq!((status.received.malformed, status.refused), (0, 0));
    assert_eq!(status.received.mismatches, 0);
    walk.set_link("");
    for _ in 0..120 {
        walk.frame();
    }
    let (before, judged) = (
        walk.statistics().expect("it still has authority"),
        walk.judged,
    );
    for _ in 0..60 {
        walk.frame();
    }
    let after = walk.statistics().expect("it still has authority");
    assert_eq!(after.late_steps, before.late_steps, "{config}, seed {seed}");
    assert!(walk.judged > judged + 100);
}

#[test]
fn the_servers_state_of_an_avatar_is_within_tolerance_over_any_link() {
    for (config, lead, known) in [
        ("", 1, 0.0),
        ("rtt=60ms", 3, 0.02),
        ("rtt=60ms,jitter=30ms", 6, 0.1),
        ("rtt=100ms,loss=5%", 14, 0.2),
        ("rtt=40ms,loss=20%,jitter=10ms,reorder=10%,dup=10%", 14, 0.9),
        ("rtt=100ms,loss=5%,burst=6,jitter=20ms", 16, 0.4),
    ] {
        survives(config, lead, known, seed(21));
    }
}

#[test]
fn without_a_lead_the_server_predicts_over_the_delay() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 0, 1);
    walk.set_link("rtt=100ms");
    let mut worst: f64 = 0.0;
    for frame in 0..200 {
        walk.frame();
        // The trajectory pauses between its seconds 4 and 6; until then it is smooth.
        if frame > 30 && walk.newest() < Tick::new(230) {
            let truth = Avatars::walk(0, walk.newest()).motion().pose();
            let apart = Divergence::between(&truth, &walk.at(Avatars::id(0)).pose());
            worst = worst.max(apart.position.metres());
        }
    }
    assert!(worst > 0.0 && worst < 0.1, "the error is {worst} m");
    let status = walk.statistics().expect("it has authority");
    assert!(status.late_steps > 10, "{status:?}");
}

#[test]
fn a_still_avatar_costs_only_watermarks() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    let stands = Avatars::walk(0, Tick::ZERO).stilled();
    let stand = |walk: &mut Walk, frames| {
        let before = walk.bytes_up();
        for _ in 0..frames {
            let tick = walk.newest() + Ticks::new(2);
            let session = walk.stage.network.client_mut(COMMANDER);
            session
                .publish(tick, &[(id, stands)])
                .expect("the commander has authority");
            walk.stage.run(TICK);
        }
        walk.bytes_up() - before
    };
    stand(&mut walk, 600);
    let upstream = walk
        .stage
        .network
        .client(COMMANDER)
        .upstream()
        .expect("it has authority");
    let bytes = stand(&mut walk, 3_000);
    let after = walk
        .stage
        .network
        .client(COMMANDER)
        .upstream()
        .expect("it has authority");
    let counters = |of: PublisherStatistics| (of.updates, of.packets, of.bytes, of.over_budget);
    assert_eq!(
        counters(after),
        counters(upstream),
        "a standing body needs no updates"
    );
    // About twenty watermarks of eight bytes in fifty seconds, and the clock queries.
    assert!(bytes < 400, "{bytes} bytes in fifty seconds");
}

#[test]
fn a_walking_avatar_costs_a_fraction_of_what_commands_cost() {
    let frames = 1_200;
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    let before = walk.bytes_up();
    for _ in 0..frames {
        walk.frame();
    }
    let published = walk.bytes_up() - before;
    let id = Avatars::id(0);
    assert_eq!(walk.take_authority(&[]), Ok(vec![]));
    let before = walk.bytes_up();
    for _ in 0..frames {
        let pose = Avatars::walk(0, walk.newest()).motion().pose();
        let command = Command::SetPose {
            id,
            position: pose.position.as_vec3(),
            rotation: pose.rotation.as_quat(),
        };
        walk.stage.command(&[command]);
        walk.stage.run(TICK);
    }
    let commanded = walk.bytes_up() - before;
    println!("{frames} frames of a walk: {published} bytes by upstream, {commanded} by commands");
    assert!(
        published * 10 < commanded,
        "{published} and {commanded} bytes"
    );
}

#[test]
fn in_lockstep_every_step_has_its_upstream_input() {
    let digest = |config: &str, seed| {
        let mut walk = Walk::new(Stepping::Lockstep, 2, 0, seed);
        walk.set_link(config);
        for _ in 0..400 {
            let tick = walk.newest().next();
            walk.publish(tick);
            walk.stage.advance(COMMANDER);
            walk.stage.run_until_or(Span::from_millis(1_000), |stage| {
                stage.copy(walk.watcher).stream().complete() >= tick
            });
            for (id, published) in walk.published.last().expect("a published state").1.clone() {
                walk.check(id, tick, &published, &walk.at(id));
            }
        }
        let statistics = walk.statistics().expect("the commander has authority");
        assert_eq!((statistics.late_steps, statistics.steps), (0, 400));
        let session = walk.stage.network.client_mut(COMMANDER);
        session.inspect().expect("a member");
        walk.stage.run(Span::from_millis(2_000));
        walk.stage.histories[COMMANDER].inspections[0].truth
    };
    let truth = digest("", 1);
    assert_eq!(digest("", 2), truth);
    assert_eq!(digest("rtt=30ms,loss=20%,dup=10%,reorder=10%", 3), truth);
}

#[test]
fn a_body_on_a_platform_under_authority_moves_along_and_sleeps_with_it() {
    let mut walk = Walk::new(Stepping::Lockstep, 0, 0, 1);
    let (platform, freight) = (Avatars::platform(), Avatars::freight());
    assert_eq!(walk.take_authority(&[platform]), Ok(vec![platform]));
    let start = Avatars::platform_start().position();
    let way = |tick: u64| {
        let moved = tick.clamp(60, 180) - 60;
        let speed = if (60..180).contains(&tick) { 0.5 } else { 0.0 };
        let position = [start[0] + moved as f32 / 120.0, start[1], start[2]];
        BodyState::new(position, [0.0, 0.0, 0.0, 1.0], [speed, 0.0, 0.0], [0.0; 3])
            .expect("a finite state")
    };
    for tick in 1..=400 {
        let session = walk.stage.network.client_mut(COMMANDER);
        session
            .publish(Tick::new(tick), &[(platform, way(tick))])
            .expect("it has authority");
        walk.stage.advance(COMMANDER);
    }
    let carried = walk.at(freight).pose().position;
    assert!((carried.x - 1.0).abs() < 0.1, "the freight is at {carried}");
    let moved = walk.at(platform).pose().position;
    // A body that stands for a second is bit-exact, within the engine's precision.
    assert!((moved.x - 1.0).abs() < 1e-6, "the platform is at {moved}");
    let session = walk.stage.network.client_mut(COMMANDER);
    session.inspect().expect("a member");
    walk.stage.run(TICK);
    let inspection = walk.stage.histories[COMMANDER].inspections[0];
    // Only the turning body is awake.
    assert_eq!(inspection.awake, 1);
}

#[test]
fn upstream_continues_while_the_copy_changes_streams() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 8, seed(22));
    walk.set_link("rtt=80ms,loss=3%");
    for choice in [
        StreamChoice::Within(Tolerance::EXACT),
        StreamChoice::Full,
        NORMAL,
    ] {
        let session = walk.stage.network.client_mut(COMMANDER);
        session
            .subscribe(choice)
            .expect("no other change is pending");
        for _ in 0..120 {
            walk.frame();
        }
        assert_eq!(walk.stage.copy(COMMANDER).choice(), choice);
    }
    assert!(
        walk.judged > 200,
        "only {} states were checked",
        walk.judged
    );
    assert_eq!(walk.stage.histories[COMMANDER].authority_answers.len(), 1);
}
