//! Each body is within its own scaled tolerance, in every stream.
//!
//! As in `simulated_network`, the claims of members about each body are checked against the truth, by the body's own
//! tolerance.

use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyKind, Command, Stepping};
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{Tolerance, ToleranceScale};
use rhumb_sims::by_name;
use rhumb_tests::{AlteredScript, COMMANDER, Stage, seed};

/// Each tolerance scale in turn.
fn all_in_turn(index: u32) -> ToleranceScale {
    ToleranceScale::new((index % 7) as i8 - 3).expect("one of seven tolerance scales")
}

fn stage(
    tolerance_scale: fn(u32) -> ToleranceScale,
    stepping: Stepping,
    links: &str,
    seed: u64,
) -> Stage {
    let script = by_name("ball-pit", 60, 1).expect("an existing script");
    let script = AlteredScript::new(script, move |_, commands: &mut Vec<Command>| {
        for command in commands {
            if let Command::AddBody { desc, .. } = command {
                desc.tolerance_scale = tolerance_scale(desc.id.index());
            }
        }
    });
    let links = links.parse().expect("a valid link configuration");
    Stage::new(
        Box::new(script),
        stepping,
        StreamChoice::Within(Tolerance::NORMAL),
        links,
        seed,
    )
}

#[test]
fn every_body_is_within_its_scaled_tolerance_in_every_tier() {
    let mut stage = stage(all_in_turn, Stepping::Lockstep, "", 1);
    let tiers = [Tolerance::EXACT, Tolerance::FINE, Tolerance::COARSE];
    let others = tiers.map(|tier| stage.enter(StreamChoice::Within(tier)));
    for _ in 0..240 {
        stage.tick();
    }
    let mut bounded = 0;
    for member in [COMMANDER].into_iter().chain(others) {
        let copy = stage.copy(member);
        for desc in copy.bodies().filter(|desc| desc.kind == BodyKind::Dynamic) {
            assert_eq!(desc.tolerance_scale, all_in_turn(desc.id.index()));
            let tolerance = copy.stream().tolerance().scaled(desc.tolerance_scale);
            let radius = copy
                .shape(desc.shape)
                .expect("a body has a shape")
                .bounding_radius();
            let bound = Some(ErrorBound::Within(tolerance.reach(radius)));
            assert_eq!(copy.stream().bound(desc.id), bound);
            bounded += 1;
        }
    }
    assert!(bounded > 4 * 40, "only {bounded} bodies have bounds");
    let truth = stage.truth();
    for member in [COMMANDER].into_iter().chain(others) {
        stage.histories[member].judge(&truth, "a member");
    }
}

#[test]
fn tolerance_scales_hold_over_a_bad_link_and_for_late_joiners() {
    let seed = seed(23);
    let mut stage = stage(all_in_turn, Stepping::FreeRunning, "rtt=80ms,loss=5%", seed);
    stage.run_script(Span::from_millis(3_000));
    let late = stage.enter(StreamChoice::Within(Tolerance::FINE));
    stage.run_script(Span::from_millis(3_000));
    let truth = stage.truth();
    for member in [COMMANDER, late] {
        let who = format!("member {member}, seed {seed}");
        stage.histories[member].judge(&truth, &who);
        assert!(!stage.histories[member].claims.is_empty(), "{who}");
    }
}

#[test]
fn debris_costs_less_than_avatars() {
    let cost = |tolerance_scale: fn(u32) -> ToleranceScale| {
        let mut stage = stage(tolerance_scale, Stepping::Lockstep, "", 1);
        for _ in 0..300 {
            stage.tick();
        }
        stage
            .network
            .client_mut(COMMANDER)
            .inspect()
            .expect("a member");
        stage.tick();
        stage.histories[COMMANDER].inspections[0].packet_bytes
    };
    let (avatars, debris) = (
        cost(|_| ToleranceScale::AVATAR),
        cost(|_| ToleranceScale::DEBRIS),
    );
    assert!(debris * 10 < avatars * 9, "{debris} of {avatars} bytes");
}
