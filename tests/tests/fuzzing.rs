//! Replays the findings and kept inputs of the fuzzers with a stable compiler.
//!
//! The tests replay every kept input and every golden vector to its target, plus some noise. `FUZZ_INPUT=FILE
//! FUZZ_TARGET=NAME` replays one file in the format of a fuzzer.

use std::collections::BTreeSet;

use rhumb_tests::fuzzing::inputs::{kept, seeds};
use rhumb_tests::fuzzing::{TARGETS, Target, target};
use rhumb_tests::{Dice, seed};

/// Number of random inputs for each target: enough to reach its first branches, not a search.
const NOISE: usize = 60;

fn replay(target: &Target, inputs: &[Vec<u8>], what: &str) {
    for (number, input) in inputs.iter().enumerate() {
        let shown = format!("{what} {number} of {}", target.name);
        let input = input.clone();
        let run = target.run;
        let held = std::panic::catch_unwind(move || run(&input));
        assert!(held.is_ok(), "{shown} breaks a promise");
    }
}

fn known(name: &str) -> &'static Target {
    target(name).unwrap_or_else(|| panic!("unknown target {name}"))
}

macro_rules! replays {
    ($($name:ident)*) => {
        $(
            #[test]
            fn $name() {
                let target = known(stringify!($name));
                replay(target, &kept(target), "kept input");
                replay(target, &seeds(target), "golden vector");
                let mut dice = Dice::new(seed(1));
                let noise = |_| {
                    let length = dice.below(400);
                    (0..length).map(|_| dice.below(256) as u8).collect()
                };
                let noise: Vec<Vec<u8>> = (0..NOISE).map(noise).collect();
                replay(target, &noise, "noise");
            }
        )*

        #[test]
        fn every_target_is_replayed() {
            let replayed = BTreeSet::from([$(stringify!($name)),*]);
            let all: BTreeSet<_> = TARGETS.iter().map(|target| target.name).collect();
            assert_eq!(replayed, all);
            for target in TARGETS {
                assert!(!kept(target).is_empty(), "{} has no kept inputs", target.name);
            }
        }
    };
}

replays! {
    app_messages app_scene client_messages client_session control_script dis_datagrams upstream prefilter quantiser
    link mesh_files repair_symbols recordings scene_commands scene_files server_messages side_packets state_packets subscriber
}

#[test]
fn one_input_of_the_environment() {
    let variable = |name| std::env::var(name).ok();
    let Some((name, path)) = variable("FUZZ_TARGET").zip(variable("FUZZ_INPUT")) else {
        return;
    };
    let input = std::fs::read(&path);
    let input = input.unwrap_or_else(|cause| panic!("{path}: {cause}: give its absolute path"));
    (known(&name).run)(&input);
}
