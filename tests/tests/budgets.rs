//! Streams keep their budgets, and say truly how far off bodies are meanwhile
//!
//! Proved as in `pretend_network`: each bound that a member gives is held against the truth, at every look.

use rhumb_protocol::Span;
use rhumb_protocol::message::{Inspection, StreamChoice};
use rhumb_protocol::scene::Pace;
use rhumb_protocol::stream::{Bound, Budget};
use rhumb_reckoning::Tolerance;
use rhumb_sims::by_name;
use rhumb_tests::{COMMANDER, Stage, seed};
use rhumb_transport::{Direction, Lane};

fn capped(bytes_per_second: u32) -> StreamChoice {
    StreamChoice::Capped {
        tolerance: Tolerance::NORMAL,
        budget: Budget::new(bytes_per_second, 1_150).expect("within the limits"),
    }
}

fn stage(scene: &str, choice: StreamChoice, pace: Pace, links: &str, seed: u64) -> Stage {
    let script = by_name(scene, 60, 1).expect("the scene is known by name");
    let links = links.parse().expect("the tests write possible terms");
    Stage::new(script, pace, choice, links, seed)
}

fn inspect(stage: &mut Stage) -> Inspection {
    stage
        .arena
        .client_mut(COMMANDER)
        .inspect()
        .expect("it is a member");
    stage.run(Span::from_millis(1_000));
    *stage.witnesses[COMMANDER]
        .inspections
        .last()
        .expect("it was answered")
}

/// How many claims allow for more than the tolerance.
fn exceeding(stage: &Stage, member: usize) -> usize {
    let claims = stage.witnesses[member].claims.iter();
    claims.filter(|claim| claim.excess > 1.0).count()
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
        let mut stage = stage(scene, capped(700), Pace::FreeRunning, links, seed);
        stage.drive(Span::from_millis(2_000));
        let late = stage.enter(capped(700));
        stage.drive(Span::from_millis(4_000));
        assert!(exceeding(&stage, COMMANDER) > 100, "{what}");
        assert!(exceeding(&stage, late) > 100, "{what}");
        let truth = stage.truth();
        for member in [COMMANDER, late] {
            stage.witnesses[member].judge(&truth, &what);
        }
    }
}

#[test]
fn a_budget_is_kept_in_every_second() {
    let mut stage = stage("tumbler", capped(500), Pace::FreeRunning, "", 1);
    let mut said = vec![0];
    for _ in 0..8 {
        stage.drive(Span::from_millis(1_000));
        stage
            .arena
            .client_mut(COMMANDER)
            .inspect()
            .expect("it is a member");
        stage.run(Span::from_millis(4));
        let inspection = stage.witnesses[COMMANDER].inspections.last();
        said.push(inspection.expect("it was answered").packet_bytes);
    }
    for (second, pair) in said.windows(2).enumerate() {
        let bytes = pair[1] - pair[0];
        let burst = if second == 0 { 1_150 } else { 0 };
        // An update may overdraw, and a second of the pretended clock is not always 60 ticks.
        assert!(bytes <= 500 + burst + 64, "{bytes} in second {second}");
    }
    let bytes = said[8] - said[1];
    assert!(
        bytes >= 7 * 300,
        "a tight budget is used: {bytes} in seven seconds"
    );
}

#[test]
fn who_waits_has_a_word_in_the_end() {
    // Balls fall and lie: afterwards nothing is off any more, and every body is told to rest.
    let mut stage = stage("ball-pit", capped(300), Pace::FreeRunning, "", 1);
    stage.drive(Span::from_millis(6_000));
    assert!(exceeding(&stage, COMMANDER) > 100);
    let withheld = inspect(&mut stage).withheld;
    assert!(withheld > 1_000, "{withheld}");
    stage.run(Span::from_millis(60_000));
    let before = inspect(&mut stage).withheld;
    stage.run(Span::from_millis(5_000));
    assert_eq!(inspect(&mut stage).withheld, before);
    let copy = stage.copy(COMMANDER);
    for terms in copy.bodies() {
        let radius = copy
            .shape(terms.shape)
            .expect("it has a shape")
            .bounding_radius();
        let bound = Some(Bound::Within(Tolerance::NORMAL.reach(radius)));
        assert_eq!(copy.stream().bound(terms.id), bound);
    }
    let truth = stage.truth();
    stage.witnesses[COMMANDER].judge(&truth, "who waited");
}

#[test]
fn an_ample_budget_costs_nothing_and_changes_nothing() {
    let said = |choice| {
        let mut stage = stage("ball-pit", choice, Pace::Lockstep, "", 1);
        for _ in 0..240 {
            stage.tick();
        }
        let inspection = inspect(&mut stage);
        (
            inspection.packets,
            inspection.packet_bytes,
            inspection.withheld,
        )
    };
    let ample = StreamChoice::Capped {
        tolerance: Tolerance::NORMAL,
        budget: Budget::per_second(10_000_000).expect("within the limits"),
    };
    assert_eq!(said(ample), said(StreamChoice::Within(Tolerance::NORMAL)));
}

#[test]
fn what_a_stream_says_does_not_depend_on_how_far_away_its_listeners_are() {
    for choice in [capped(700), StreamChoice::Within(Tolerance::NORMAL)] {
        let said = |links| {
            let script = by_name("tumbler", 60, 1).expect("the scene is known by name");
            let links: rhumb_transport::LinkTerms = links;
            let mut stage = Stage::new(script, Pace::Lockstep, choice, links, 1);
            for _ in 0..200 {
                stage.tick();
            }
            let down = stage
                .arena
                .counts(COMMANDER, Direction::Down, Lane::State)
                .pushed
                .bytes;
            let inspection = inspect(&mut stage);
            (inspection.packets, inspection.packet_bytes, down)
        };
        let parse = |text: &str| text.parse().expect("the tests write possible terms");
        let near = said(parse(""));
        // Within the patience of a lockstep client, which asks again after a tenth of a second.
        let far = said(parse("rtt=90ms"));
        assert_eq!(near, far, "{choice:?}");
    }
}
