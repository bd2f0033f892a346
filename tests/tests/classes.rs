//! Bodies are followed as closely as their class says, in every stream
//!
//! Proved as in `pretend_network`: what members claim of each body is held against the truth, by the body's own tolerance.

use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{BodyKind, Command, Pace, SceneTerms};
use rhumb_protocol::stream::Bound;
use rhumb_reckoning::{Class, Tick, Tolerance};
use rhumb_sims::{Script, by_name};
use rhumb_tests::{COMMANDER, Stage, seed};

/// A script whose bodies are of classes.
struct Classed {
    script: Box<dyn Script>,
    class: fn(u32) -> Class,
}

impl Script for Classed {
    fn name(&self) -> &'static str {
        self.script.name()
    }

    fn terms(&self) -> SceneTerms {
        self.script.terms()
    }

    fn commands(&mut self, tick: Tick, out: &mut Vec<Command>) {
        self.script.commands(tick, out);
        for command in out {
            if let Command::AddBody { terms, .. } = command {
                terms.class = (self.class)(terms.id.index());
            }
        }
    }
}

/// Each class in turn.
fn all_in_turn(index: u32) -> Class {
    Class::new((index % 7) as i8 - 3).expect("there are seven classes")
}

fn stage(class: fn(u32) -> Class, pace: Pace, links: &str, seed: u64) -> Stage {
    let script = by_name("ball-pit", 60, 1).expect("the scene is known by name");
    let script = Box::new(Classed { script, class });
    let links = links.parse().expect("the tests write possible terms");
    Stage::new(
        script,
        pace,
        StreamChoice::Within(Tolerance::NORMAL),
        links,
        seed,
    )
}

#[test]
fn every_body_is_within_the_tolerance_of_its_class_in_every_tier() {
    let mut stage = stage(all_in_turn, Pace::Lockstep, "", 1);
    let tiers = [Tolerance::EXACT, Tolerance::FINE, Tolerance::COARSE];
    let others = tiers.map(|tier| stage.enter(StreamChoice::Within(tier)));
    for _ in 0..240 {
        stage.tick();
    }
    let mut bounded = 0;
    for member in [COMMANDER].into_iter().chain(others) {
        let copy = stage.copy(member);
        for terms in copy
            .bodies()
            .filter(|terms| terms.kind == BodyKind::Dynamic)
        {
            assert_eq!(terms.class, all_in_turn(terms.id.index()));
            let tolerance = copy.stream().tolerance().of_class(terms.class);
            let radius = copy
                .shape(terms.shape)
                .expect("it has a shape")
                .bounding_radius();
            let bound = Some(Bound::Within(tolerance.reach(radius)));
            assert_eq!(copy.stream().bound(terms.id), bound);
            bounded += 1;
        }
    }
    assert!(bounded > 4 * 40, "{bounded} bodies were bounded");
    let truth = stage.truth();
    for member in [COMMANDER].into_iter().chain(others) {
        stage.witnesses[member].judge(&truth, "a member");
    }
}

#[test]
fn classes_hold_over_a_bad_link_and_for_who_joins_late() {
    let seed = seed(23);
    let mut stage = stage(all_in_turn, Pace::FreeRunning, "rtt=80ms,loss=5%", seed);
    stage.drive(Span::from_millis(3_000));
    let late = stage.enter(StreamChoice::Within(Tolerance::FINE));
    stage.drive(Span::from_millis(3_000));
    let truth = stage.truth();
    for member in [COMMANDER, late] {
        let who = format!("member {member}, seed {seed}");
        stage.witnesses[member].judge(&truth, &who);
        assert!(!stage.witnesses[member].claims.is_empty(), "{who}");
    }
}

#[test]
fn debris_costs_less_than_avatars() {
    let cost = |class: fn(u32) -> Class| {
        let mut stage = stage(class, Pace::Lockstep, "", 1);
        for _ in 0..300 {
            stage.tick();
        }
        stage
            .arena
            .client_mut(COMMANDER)
            .inspect()
            .expect("it is a member");
        stage.tick();
        stage.witnesses[COMMANDER].inspections[0].packet_bytes
    };
    let (avatars, debris) = (cost(|_| Class::AVATAR), cost(|_| Class::DEBRIS));
    assert!(debris * 10 < avatars * 9, "{debris} of {avatars} bytes");
}
