//! The Rust client passes every case; each client mutant fails one.
//!
//! The mutants test the suite itself: a case that no mutant fails may be impossible to fail. They are defined in
//! `conformance/mutants`; each runs against one case only.

use std::time::Duration;

use rhumb_conformance::LocalServer;
use rhumb_conformance::conditions::{Conditions, Subject};
use rhumb_conformance::matrix;
use rhumb_conformance::mutants::ClientMutant;
use rhumb_conformance::run::run;
use rhumb_conformance::suite::{self, Selection};
use rhumb_conformance::{Role, Verdict};
use rhumb_netsim::{Carrier, LinkConfig};

const TESTEE: &str = env!("CARGO_BIN_EXE_rhumb-testee");

/// Each mutant with its command-line name and its case.
const CAUGHT: [(ClientMutant, &str, &str); 25] = [
    (ClientMutant::AnyVersion, "any-version", "L1.51.2"),
    (ClientMutant::CriticalPasses, "critical-passes", "L1.51.3"),
    (
        ClientMutant::OptionalRefused,
        "optional-refused",
        "L1.51.13",
    ),
    (ClientMutant::WrongCode, "wrong-code", "L1.51.3"),
    (
        ClientMutant::NeverReportsLoss,
        "never-reports-loss",
        "L2.51.20",
    ),
    (ClientMutant::OffByOne, "off-by-one", "L2.51.20"),
    (ClientMutant::AsksForOne, "asks-for-one", "L2.51.22"),
    (ClientMutant::LateIsAll, "late-is-all", "L2.51.45"),
    (ClientMutant::RefreshIgnored, "refresh-ignored", "L2.51.7"),
    (ClientMutant::StaleTaken, "stale-taken", "L2.51.41"),
    (ClientMutant::RevisionIgnored, "revision-ignored", "L2.51.1"),
    (ClientMutant::RestLost, "rest-lost", "L4.51.5"),
    (
        ClientMutant::RepairSymbolWrong,
        "repair-symbol-wrong",
        "L2.52.10",
    ),
    (
        ClientMutant::SceneEventsIgnored,
        "scene-events-ignored",
        "L1.52.66",
    ),
    (ClientMutant::NanTaken, "nan-taken", "L5.51.3"),
    (ClientMutant::NeverResyncs, "never-resyncs", "L2.51.24"),
    (ClientMutant::LastBitWrong, "last-bit-wrong", "L4.51.1"),
    (
        ClientMutant::CompleteTooEarly,
        "complete-too-early",
        "L2.51.40",
    ),
    (
        ClientMutant::NeverSubscribed,
        "never-subscribed",
        "L2.52.21",
    ),
    (
        ClientMutant::SendsBeforeWelcome,
        "sends-before-welcome",
        "L1.51.6",
    ),
    (
        ClientMutant::UpstreamBeyondTolerance,
        "upstream-beyond-tolerance",
        "L3.51.1",
    ),
    (ClientMutant::WatermarkOnce, "watermark-once", "L3.51.2"),
    (
        ClientMutant::NeverRetakesAuthority,
        "never-retakes-authority",
        "L3.51.3",
    ),
    (
        ClientMutant::JointRemovalIgnored,
        "joint-removal-ignored",
        "L1.52.8",
    ),
    (
        ClientMutant::ShapeRemovalIgnored,
        "shape-removal-ignored",
        "L1.52.15",
    ),
];

fn conditions(exec: String) -> Conditions {
    Conditions {
        subject: Subject::Client {
            listen: "127.0.0.1:0".parse().expect("loopback"),
            exec,
        },
        // A long time limit, so that a busy machine fails no case.
        timeout: Duration::from_secs(20),
        seed: 1,
        link: LinkConfig::PERFECT,
        carrier: Carrier::Quic,
        without: Vec::new(),
        token: None,
    }
}

#[test]
fn the_rust_client_passes_every_case() {
    let (cases, selection) = (suite::cases(Role::Client), Selection::default());
    let results = run(
        cases,
        &selection,
        &conditions(TESTEE.to_owned()),
        4,
        &mut std::io::sink(),
    );
    assert!(results.len() >= 150, "{} cases", results.len());
    for result in results {
        // SHOULD is checked too.
        assert!(
            result.outcome.verdict == Verdict::Pass && result.outcome.closing.is_good(),
            "{:?}: {:?}",
            result.case,
            result.outcome
        );
    }
}

#[test]
fn the_rust_client_follows_this_server_bit_exactly() {
    let server = LocalServer::start().expect("loopback has a free port");
    let (address, pin) = (server.address, server.fingerprint);
    let servers = [format!("rust={address},{pin}")
        .parse()
        .expect("a valid server argument")];
    let honest = format!("rust={TESTEE}")
        .parse()
        .expect("a valid client argument");
    let wrong = format!("wrong={TESTEE} --mutant last-bit-wrong");
    let clients = [honest, wrong.parse().expect("a valid client argument")];
    let (pairs, results) = matrix::run(
        &servers,
        &clients,
        &Selection::default(),
        &conditions(String::new()),
        4,
        &mut std::io::sink(),
    );
    let [honest, wrong] = &pairs[..] else {
        panic!("two pairs: {pairs:?}");
    };
    for result in &results[..honest.tried] {
        let outcome = &result.outcome;
        let passed = outcome.verdict == Verdict::Pass && outcome.closing.is_good();
        assert!(passed, "{:?}: {outcome:?}", result.case);
    }
    assert!(honest.tried >= 8, "{pairs:?}");
    assert!(wrong.passed == 0, "a mutant passes: {pairs:?}");
}

#[test]
fn each_client_that_breaks_a_promise_is_caught_by_its_case() {
    for (mutant, name, id) in CAUGHT {
        let exec = format!("{TESTEE} --mutant {name}");
        let mut conditions = conditions(exec);
        conditions.timeout = Duration::from_secs(3);
        let selection = Selection {
            patterns: vec![id.to_owned()],
            ..Selection::default()
        };
        let results = run(
            suite::cases(Role::Client),
            &selection,
            &conditions,
            1,
            &mut std::io::sink(),
        );
        let result = results.first().expect("an existing case");
        assert_eq!(results.len(), 1, "{id} selects one case");
        let caught = matches!(result.outcome.verdict, Verdict::Fail | Verdict::Lax)
            || !result.outcome.closing.is_good();
        assert!(caught, "{mutant:?} passes {id}: {:?}", result.outcome);
    }
}
