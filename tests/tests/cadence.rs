//! Scenes that are published every so many ticks, or with hindsight.
//!
//! Proved as in `pretend_network`: what members claim is held against the truth, each claim at its own tick.

use std::num::NonZeroU32;

use glam::Vec3;
use rhumb_protocol::Span;
use rhumb_protocol::message::{Inspection, StreamChoice};
use rhumb_protocol::scene::{BodyKind, Cadence, Command, Invalid, Pace, Quantity, SceneTerms};
use rhumb_protocol::session::Misuse;
use rhumb_protocol::stream::Bound;
use rhumb_reckoning::{BodyId, Rate, Tick, Ticks, Tolerance};
use rhumb_server::Scene;
use rhumb_sims::by_name;
use rhumb_tests::{COMMANDER, Stage, TICK, assert_same_copy, seed};
use rhumb_transport::LinkTerms;

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
const COARSE: StreamChoice = StreamChoice::Within(Tolerance::COARSE);

fn cadence(every: u32, hindsight: u32) -> Cadence {
    Cadence {
        every: NonZeroU32::new(every).expect("the tests name no zero"),
        hindsight: Ticks::new(hindsight),
    }
}

fn stage(name: &str, bodies: u32, cadence: Cadence, links: &str, seed: u64) -> Stage {
    let script = by_name(name, bodies, 1).expect("the scene is known by name");
    let links: LinkTerms = links.parse().expect("the tests write possible terms");
    let terms = SceneTerms {
        pace: Pace::FreeRunning,
        cadence,
        ..script.terms()
    };
    Stage::of(script, terms, NORMAL, links, seed)
}

fn inspect(stage: &mut Stage) -> Inspection {
    let client = stage.arena.client_mut(COMMANDER);
    client.inspect().expect("a member may ask");
    stage.run(Span::from_millis(20));
    stage.witnesses[COMMANDER]
        .inspections
        .pop()
        .expect("an answer comes at once")
}

#[test]
fn every_claim_holds_and_is_about_a_tick_that_is_spoken_of() {
    for (every, hindsight) in [(2, 0), (1, 6), (3, 5), (7, 2)] {
        for links in ["", "rtt=100ms,loss=5%,jitter=10ms"] {
            let seed = seed(31);
            let what = format!("every {every}, hindsight {hindsight}, {links}, seed {seed}");
            let mut stage = stage("zoo", 60, cadence(every, hindsight), links, seed);
            stage.drive(Span::from_millis(1_500));
            let late = stage.enter(NORMAL);
            let full = stage.enter(StreamChoice::Full);
            let coarse = stage.enter(COARSE);
            let starts = [late, full, coarse].map(|member| stage.copy(member).stream().vouched());
            stage.drive(Span::from_millis(2_500));
            stage.arena.set_terms(LinkTerms::PERFECT);
            stage.run(Span::from_millis(8_000));
            let newest = stage.copy(COMMANDER).stream().vouched();
            for member in [COMMANDER, late, full, coarse] {
                let stream = stage.copy(member).stream();
                assert!(stream.is_settled(), "{what}: member {member}");
                assert!(newest.value() > 200, "{what}: vouched for {newest} only");
                for claim in &stage.witnesses[member].claims {
                    let spoken = claim.tick.value().is_multiple_of(u64::from(every));
                    let begun = starts.contains(&claim.tick);
                    assert!(spoken || begun, "{what}: a claim at {}", claim.tick);
                }
                assert!(stage.witnesses[member].claims.len() > 1_000, "{what}");
            }
            assert_same_copy(stage.copy(COMMANDER), stage.copy(late));
            let truth = stage.truth();
            for member in [COMMANDER, late, full, coarse] {
                stage.witnesses[member].judge(&truth, &what);
            }
        }
    }
}

#[test]
fn between_two_ticks_that_are_spoken_of_nothing_is_claimed() {
    let mut stage = stage("ball-pit", 60, cadence(3, 0), "", 1);
    stage.drive(Span::from_millis(3_000));
    let copy = stage.copy(COMMANDER);
    let stream = copy.stream();
    let vouched = stream.vouched();
    assert!(vouched.value().is_multiple_of(3) && vouched > Tick::ZERO);
    let dynamic = copy
        .bodies()
        .filter(|terms| terms.kind == BodyKind::Dynamic);
    let ids: Vec<BodyId> = dynamic.map(|terms| terms.id).collect();
    let mut known = 0;
    for id in ids {
        assert!(matches!(stream.bound(id), Some(Bound::Within(_))));
        for ticks in [1, 2, 4, 5] {
            let tick = vouched.before(Ticks::new(ticks)).unwrap();
            let bound = stream.bound_at(id, tick);
            assert!(matches!(bound, Some(Bound::Unknown { .. })), "{id} {tick}");
        }
        let before = vouched.before(Ticks::new(3)).unwrap();
        known += u32::from(matches!(
            stream.bound_at(id, before),
            Some(Bound::Within(_))
        ));
    }
    assert!(known > 0, "nothing is known of the tick before");
}

#[test]
fn commands_act_at_ticks_that_are_not_spoken_of_too() {
    let mut stage = stage("zoo", 60, cadence(4, 3), "", 1);
    for strength in 1..=20 {
        let gravity = Vec3::NEG_Y * strength as f32;
        stage.command(&[Command::SetGravity { gravity }]);
        stage.run(TICK);
    }
    let applied = &stage.witnesses[COMMANDER].applied;
    for rest in 0..4 {
        let at = |(_, tick): &(u64, Tick)| tick.value() % 4 == rest;
        assert!(applied.iter().any(at), "nothing acted at {rest} of 4");
    }
}

#[test]
fn hindsight_costs_fewer_bytes_and_so_does_publishing_more_rarely() {
    let cost = |cadence: Cadence| {
        let mut stage = stage("ball-pit", 100, cadence, "", 1);
        stage.drive(Span::from_millis(8_000));
        let inspection = inspect(&mut stage);
        let truth = stage.truth();
        stage.witnesses[COMMANDER].judge(&truth, "who pays");
        assert!(stage.copy(COMMANDER).stream().is_settled());
        (inspection.packet_bytes, inspection.tick, inspection.truth)
    };
    let (at_once, tick, truth) = cost(Cadence::EACH_TICK);
    let (later, same_tick, same_truth) = cost(cadence(1, 6));
    // What is published changes nothing of the truth.
    assert_eq!((tick, truth), (same_tick, same_truth));
    let (rarer, ..) = cost(cadence(2, 0));
    let (both, ..) = cost(cadence(2, 6));
    println!("bytes: {at_once} at once, {later} with hindsight, {rarer} rarer, {both} both");
    // An eighth, a fifth and a twelfth, with room.
    assert!(later * 100 < at_once * 90, "{later} of {at_once}");
    assert!(rarer * 100 < at_once * 85, "{rarer} of {at_once}");
    assert!(both * 100 < rarer * 95, "{both} of {rarer}");
}

#[test]
fn a_cadence_that_cannot_be_kept_is_refused_by_name() {
    let script = by_name("zoo", 60, 1).expect("the scene is known by name");
    let refused = |pace, rate, cadence: Cadence| {
        let mut terms = SceneTerms {
            pace,
            cadence,
            ..script.terms()
        };
        terms.integrator.rate = rate;
        let refused = Scene::new(terms).err();
        assert_eq!(refused, terms.check().err());
        match refused {
            None => None,
            Some(Invalid::OutOfRange(quantity)) => Some(quantity),
            Some(other) => panic!("{other}"),
        }
    };
    let free =
        |every, hindsight| refused(Pace::FreeRunning, Rate::HZ_60, cadence(every, hindsight));
    assert_eq!(free(60, 6), None);
    assert_eq!(free(61, 0), Some(Quantity::PublishedEvery));
    assert_eq!(free(u32::MAX, 0), Some(Quantity::PublishedEvery));
    assert_eq!(free(1, 7), Some(Quantity::Hindsight));
    let slow = Rate::new(1, 1).unwrap();
    assert_eq!(refused(Pace::FreeRunning, slow, cadence(1, 6)), None);
    let rarely = refused(Pace::FreeRunning, slow, cadence(2, 0));
    assert_eq!(rarely, Some(Quantity::PublishedEvery));
    let lockstep =
        |every, hindsight| refused(Pace::Lockstep, Rate::HZ_60, cadence(every, hindsight));
    assert_eq!(lockstep(1, 0), None);
    assert_eq!(lockstep(60, 0), None);
    assert_eq!(lockstep(61, 0), Some(Quantity::PublishedEvery));
    for (every, hindsight) in [(1, 1), (2, 6)] {
        let refused = lockstep(every, hindsight);
        assert_eq!(refused, Some(Quantity::LockstepCadence));
    }
}

#[test]
fn a_client_does_not_ask_for_a_lockstep_scene_with_hindsight() {
    let mut stage = stage("zoo", 60, Cadence::EACH_TICK, "", 1);
    let visitor = stage.connect();
    let terms = SceneTerms {
        pace: Pace::Lockstep,
        cadence: cadence(1, 2),
        ..stage.terms()
    };
    let asked = stage.arena.client_mut(visitor).create(terms);
    let why = Invalid::OutOfRange(Quantity::LockstepCadence);
    assert_eq!(asked, Err(Misuse::Invalid(why)));
    assert!(
        why.to_string()
            .starts_with("a lockstep scene says its ticks at once")
    );
}
