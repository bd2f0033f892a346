//! Metadata records: what was run, and figures that no message holds.
//!
//! With them, every figure of `summary.json` can be computed from the trace alone.

use std::collections::BTreeMap;

use crate::record::{Experiment, Load, Replayed, Run, SubscriptionSettings};
use crate::summary::DATAGRAM_HEADER_BYTES;

/// Name and content of the metadata record of the experiment.
pub(super) fn of_experiment(
    experiment: &Experiment,
    loads: &[String],
) -> (String, BTreeMap<String, String>) {
    let pairs = [
        ("command", experiment.command.clone()),
        ("seed", experiment.seed.to_string()),
        ("machine", experiment.machine.clone()),
        ("loads", loads.join(" ")),
        ("datagram_header_bytes", DATAGRAM_HEADER_BYTES.to_string()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
    ];
    ("rhumb.experiment".to_owned(), named(pairs))
}

/// Name and content of the metadata record of a load's truth.
pub(super) fn of_truth(prefix: &str, load: &Load) -> (String, BTreeMap<String, String>) {
    let pairs = [
        ("truth_hash", format!("{:016x}", load.truth.digest)),
        ("ticks", load.truth.ticks.len().to_string()),
        ("placed", load.truth.placed.len().to_string()),
        ("removed", load.truth.removed.len().to_string()),
    ];
    let mut record = named(pairs);
    record.extend(load.facts.to_metadata());
    (format!("rhumb.truth.{prefix}"), record)
}

/// Name and content of the metadata record of a run; `place` is its index in the summary, from 0.
pub(super) fn of_run(
    prefix: &str,
    name: &str,
    place: usize,
    run: &Run,
) -> (String, BTreeMap<String, String>) {
    let (config, join) = (&run.config, &run.join);
    let mut record = named([
        ("place", place.to_string()),
        ("load", prefix.to_owned()),
        ("name", name.to_owned()),
        ("scene", config.scene.clone()),
        ("bodies", config.bodies.to_string()),
        ("mode", config.mode.name().to_owned()),
        ("depth", config.depth.to_string()),
        ("link", config.link.clone()),
        ("seed", config.seed.to_string()),
        ("step_s", config.step_s.to_string()),
        ("ticks", config.ticks.to_string()),
        ("frames", run.frames.len().to_string()),
        ("truth_hash", format!("{:016x}", run.truth_checksum)),
        ("join_wire_bytes_down", join.wire_bytes_down.to_string()),
        (
            "join_wire_datagrams_down",
            join.wire_datagrams_down.to_string(),
        ),
        ("join_wire_bytes_up", join.wire_bytes_up.to_string()),
        ("join_wire_datagrams_up", join.wire_datagrams_up.to_string()),
        ("step_ns_p50", run.step_ns_p50.to_string()),
        ("step_ns_p99", run.step_ns_p99.to_string()),
        ("step_ns_total", run.step_ns_total.to_string()),
        ("publish_ns_total", run.publish_ns_total.to_string()),
        ("mismatches", run.mismatches.to_string()),
    ]);
    if let Some(tolerance_m) = config.tolerance_m {
        record.insert("tolerance_m".to_owned(), tolerance_m.to_string());
    }
    if let Some(budget) = config.budget_bytes_per_second {
        record.insert("budget_bytes_per_second".to_owned(), budget.to_string());
    }
    if let Some(subscription) = &config.subscription {
        record.extend(of_subscription(subscription));
    }
    if let Some(replayed) = &config.replayed {
        record.extend(of_replay(replayed));
    }
    (format!("rhumb.run.{prefix}.{name}"), record)
}

/// Publish and subscribe settings of a free-running scene.
fn of_subscription(subscription: &SubscriptionSettings) -> BTreeMap<String, String> {
    named([
        (
            "publish_interval",
            subscription.publish_interval.to_string(),
        ),
        ("lookahead_ticks", subscription.lookahead_ticks.to_string()),
        ("delay_ticks", subscription.delay_ticks.to_string()),
    ])
}

/// Settings that only a replay has.
fn of_replay(replayed: &Replayed) -> BTreeMap<String, String> {
    let mut record = named([
        ("publish_interval", replayed.publish_interval.to_string()),
        ("lookahead_ticks", replayed.lookahead_ticks.to_string()),
        ("link_seed", replayed.link_seed.to_string()),
        ("without", replayed.without.join(" ")),
    ]);
    let parts = [
        ("position_m", replayed.position_m),
        ("turn_rad", replayed.turn_rad),
    ];
    for (name, value) in parts {
        record.extend(value.map(|value| (name.to_owned(), value.to_string())));
    }
    record
}

fn named<const COUNT: usize>(pairs: [(&str, String); COUNT]) -> BTreeMap<String, String> {
    pairs.map(|(name, value)| (name.to_owned(), value)).into()
}
