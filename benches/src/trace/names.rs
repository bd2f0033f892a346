//! Names of loads and runs in topics and metadata.
//!
//! Names are distinct: the second `rhumb` run of a load is `rhumb-2`.

use std::collections::BTreeMap;

use crate::record::{Experiment, Load, PacketDirection};

/// Prefix of each load, such as `n500`, in the order of the record.
pub(crate) fn load_names(experiment: &Experiment) -> Vec<String> {
    let bodies = |load: &Load| load.runs.first().map_or(0, |run| run.config.bodies);
    distinct(
        experiment
            .loads
            .iter()
            .map(|load| format!("n{}", bodies(load))),
    )
}

/// Name of each run of a load, such as `rhumb`, in the order of the record.
pub(crate) fn run_names(load: &Load) -> Vec<String> {
    distinct(
        load.runs
            .iter()
            .map(|run| run.config.mode.name().to_owned()),
    )
}

/// Last part of the topic name for packets of one direction.
pub(super) const fn direction_name(direction: PacketDirection) -> &'static str {
    match direction {
        PacketDirection::StateDown => "state-down",
        PacketDirection::StateUp => "state-up",
        PacketDirection::ControlDown => "control-down",
        PacketDirection::ControlUp => "control-up",
    }
}

fn distinct(names: impl Iterator<Item = String>) -> Vec<String> {
    let mut taken: BTreeMap<String, u32> = BTreeMap::new();
    names
        .map(|name| {
            let count = taken.entry(name.clone()).or_default();
            *count += 1;
            if *count == 1 {
                name
            } else {
                format!("{name}-{count}")
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    #[test]
    fn names_are_distinct() {
        let names = ["naive", "rhumb", "rhumb"].map(str::to_owned);
        assert_eq!(
            super::distinct(names.into_iter()),
            ["naive", "rhumb", "rhumb-2"]
        );
    }
}
