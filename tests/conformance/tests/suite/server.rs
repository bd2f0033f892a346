//! The conformance suite against this project's server.
//!
//! A server process, as an operator runs it, must pass all server cases over loopback. Mutants of the server test the
//! suite itself, each with one case. Caught so far: answers to later messages came before a command's own answer; a
//! member whose advance was lost repeated it only after three seconds.

use std::time::Duration;

use rhumb_conformance::LocalServer;
use rhumb_conformance::conditions::{Conditions, Subject};
use rhumb_conformance::mutants::ServerMutant;
use rhumb_conformance::report::{Report, RunSettings, html, json, junit};
use rhumb_conformance::schedule::Profile;
use rhumb_conformance::suite::{Selection, cases};
use rhumb_conformance::{Role, Verdict, coverage, run};
use rhumb_netsim::{Carrier, LinkConfig};
use rhumb_transport::Trust;
use serde_json::{Value, json as value_of};

/// Conditions with a time limit that a busy machine meets.
fn conditions(server: &LocalServer, link: LinkConfig, carrier: Carrier) -> Conditions {
    Conditions {
        subject: Subject::Server {
            target: server.address,
            name: "localhost".into(),
            trust: Trust::Fingerprint(match carrier {
                Carrier::Quic => server.fingerprint,
                Carrier::WebTransport => server.certificate_hash,
            }),
        },
        timeout: Duration::from_secs(10),
        seed: 1,
        link,
        carrier,
        without: Vec::new(),
        token: None,
    }
}

fn tried(patterns: &[&str], link: LinkConfig) -> Report {
    tried_over(Carrier::Quic, patterns, link)
}

fn tried_over(carrier: Carrier, patterns: &[&str], link: LinkConfig) -> Report {
    let server = LocalServer::start().expect("loopback has a free port");
    let selection = Selection {
        patterns: patterns.iter().map(|&pattern| pattern.to_owned()).collect(),
        profile: Profile::BitExact,
        without: Vec::new(),
    };
    let conditions = conditions(&server, link, carrier);
    let mut progress = Vec::new();
    let results = run::run(
        cases(Role::Server),
        &selection,
        &conditions,
        8,
        &mut progress,
    );
    let report = Report {
        subject: server.address.to_string(),
        config: Some(RunSettings {
            seed: conditions.seed,
            timeout_s: conditions.timeout.as_secs_f64(),
            link,
            profile: selection.profile,
            without: selection.without.clone(),
        }),
        strict: true,
        results,
        pairs: Vec::new(),
        coverage: coverage::coverage(),
    };
    let traces = report.bad().flat_map(|result| &result.outcome.trace);
    let traces: Vec<_> = traces.take(200).cloned().collect();
    let progress = String::from_utf8_lossy(&progress);
    assert!(report.passed(), "{progress}\n{}", traces.join("\n"));
    report
}

#[test]
fn this_server_passes_every_case() {
    let report = tried(&[], LinkConfig::PERFECT);
    assert!(report.results.len() >= 200, "{}", report.summary());
    // The settings of the run must be in each form of the report.
    let value: Value = serde_json::from_str(&json(&report)).expect("JSON");
    assert_eq!(value["passed"], true);
    assert_eq!(
        value["cases"].as_array().map(Vec::len),
        Some(report.results.len())
    );
    let xml = junit(&report).expect("writing to memory");
    assert_eq!(xml.matches("<testcase ").count(), report.results.len());
    assert!(!xml.contains("<failure"));
    let reported =
        ["seed", "timeout_s", "link", "profile", "without"].map(|name| value[name].clone());
    let config = [
        value_of!(1),
        value_of!(10.0),
        value_of!(""),
        value_of!("bit-exact"),
        value_of!([]),
    ];
    assert_eq!(reported, config);
    let page = html(&report);
    assert!(page.contains("seed 1, timeout 10 s, profile bit-exact, strict"));
    assert!(report.results.iter().all(|one| page.contains(&one.case.id)));
}

#[test]
fn this_server_passes_over_webtransport() {
    let levels = ["L1", "L2.1", "L3.1", "L4.1.1", "L5.2"];
    let report = tried_over(Carrier::WebTransport, &levels, LinkConfig::PERFECT);
    assert!(report.results.len() >= 60, "{}", report.summary());
}

#[test]
fn this_server_passes_behind_a_bad_link() {
    let link = "rtt=20ms,loss=3%,reorder=2%,dup=1%"
        .parse()
        .expect("a valid link configuration");
    let report = tried(&["L1.1", "L1.4", "L2.1", "L3.1", "L4.1.1"], link);
    assert!(report.results.len() >= 20, "{}", report.summary());
}

/// Each mutant with its case, by id or by words of its name.
const CAUGHT: [(ServerMutant, &str); 22] = [
    (ServerMutant::AnyVersion, "L1.1.3"),
    (ServerMutant::WrongCode, "L0.1.7"),
    (ServerMutant::CriticalPasses, "L0.1.7"),
    (ServerMutant::OptionalRefused, "L0.1.2"),
    (ServerMutant::CommandRefused, "L3.2.32"),
    (ServerMutant::NanTaken, "SetGravity: command.gravity NaN"),
    (ServerMutant::RefreshIgnored, "L2.2.5"),
    (ServerMutant::OffByOne, "L2.2.3"),
    (ServerMutant::NeverSendsWatermark, "L2.2.2"),
    (ServerMutant::RestLost, "L4.1.9"),
    (ServerMutant::ToleranceIgnored, "L4.1.1"),
    (ServerMutant::ChecksumsWrong, "L4.1.3"),
    (ServerMutant::RepairSymbolWrong, "L2.2.8"),
    (ServerMutant::StepsTooFar, "L2.1.1"),
    (ServerMutant::GravityNotSent, "L3.4.11"),
    (ServerMutant::RefusalsNotSent, "L3.2.1"),
    (ServerMutant::JointsNotSent, "L3.3.7"),
    (ServerMutant::GroundNotSent, "L3.8.2"),
    (ServerMutant::PongWrong, "L1.4.12"),
    (ServerMutant::FrictionOff, "L4.3.1"),
    (ServerMutant::SpeedsOff, "L4.3.2"),
    (ServerMutant::QueuesWithoutBound, "L5.1.8"),
];

/// Outcomes of the selected cases with a mutant.
fn tried_mutant(
    mutant: ServerMutant,
    patterns: &[&str],
    profile: Profile,
    side_by_side: usize,
) -> Vec<run::Tried> {
    let serving = mutant.serve();
    let conditions = Conditions {
        subject: Subject::Server {
            target: serving.address,
            name: "localhost".into(),
            trust: Trust::Fingerprint(serving.fingerprint),
        },
        timeout: Duration::from_secs(2 * side_by_side as u64),
        seed: 1,
        link: LinkConfig::PERFECT,
        carrier: Carrier::Quic,
        without: Vec::new(),
        token: None,
    };
    let selection = Selection {
        patterns: patterns.iter().map(|&pattern| pattern.to_owned()).collect(),
        profile,
        without: Vec::new(),
    };
    let sink = &mut std::io::sink();
    run::run(
        cases(Role::Server),
        &selection,
        &conditions,
        side_by_side,
        sink,
    )
}

#[test]
fn each_server_that_breaks_a_promise_is_caught_by_its_case() {
    let mut passed = Vec::new();
    for (mutant, pattern) in CAUGHT {
        let results = tried_mutant(mutant, &[pattern], Profile::BitExact, 1);
        assert_eq!(results.len(), 1, "{pattern} selects one case");
        let outcome = &results[0].outcome;
        let caught = outcome.verdict == Verdict::Fail || !outcome.closing.is_good();
        if !caught {
            passed.push(format!("{mutant:?} passes {pattern}: {outcome:?}"));
        }
    }
    assert!(passed.is_empty(), "{passed:#?}");
}

#[test]
fn a_server_whose_engine_differs_by_a_bit_passes_all_but_the_bit_exact_profile() {
    // Levels L0 and L5 and the sessions of L1 do not depend on an engine.
    let physics = ["L2", "L3", "L4", "L1.4"];
    for mutant in [ServerMutant::FrictionOff, ServerMutant::SpeedsOff] {
        let results = tried_mutant(mutant, &physics, Profile::Core, 8);
        let bad = results.iter().filter(|one| !one.outcome.is_good(true));
        let bad: Vec<_> = bad.map(|one| (&one.case, &one.outcome.why)).collect();
        assert!(bad.is_empty(), "{mutant:?}: {bad:#?}");
        assert!(results.len() > 100, "{mutant:?}: {} cases", results.len());
        let exact = tried_mutant(mutant, &["L4.3"], Profile::BitExact, 8);
        let failed = exact
            .iter()
            .filter(|one| one.outcome.verdict == Verdict::Fail);
        let failed: Vec<_> = failed.map(|one| &one.case.id).collect();
        assert!(!failed.is_empty(), "{mutant:?}: {failed:?}");
        println!("{mutant:?} fails {failed:?}");
    }
}

#[test]
fn every_requirement_has_a_case_or_a_reason() {
    let holes = coverage::holes();
    assert!(
        holes.is_empty(),
        "{} holes\n{}",
        holes.len(),
        holes.join("\n")
    );
}
