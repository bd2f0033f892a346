//! `rhumb-bench cost`: processor time of a stream, stage by stage.
//!
//! Covers publishing beside the engine's step, a tick in which all bodies sleep, decoding, rendering, and one more
//! member of a stream. All but the members run in the calling thread, one after the other. Times are processor times of
//! that thread, so that other programs hardly change them. Each figure is the median of its repeats, beside its target.

mod decoding;
mod median;
mod members;
mod publishing;

use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use serde::{Deserialize, Serialize};

use crate::machine;
use crate::output;
use crate::replay::{Failure, ended};
use crate::summary::{aligned, markdown, number};

pub use decoding::Decoding;
use decoding::measure_decoding;
pub use members::Members;
pub use publishing::{Publishing, Sleeping};
use publishing::{measure_publishing, measure_sleeping, publishing_steps};

/// Arguments: bodies, members, repeats, output.
#[derive(Clone, Debug, Args)]
pub struct CostArguments {
    /// Bodies that are published, decoded and rendered.
    #[arg(long, default_value = "10000", value_parser = clap::value_parser!(u32).range(100..=50_000))]
    bodies: u32,
    /// Repeats per measurement; the median counts.
    #[arg(long, default_value = "5")]
    repeats: NonZeroU32,
    /// Numbers of members of a stream over loopback, smallest first.
    #[arg(long, value_delimiter = ',', default_value = "1,8,16,32")]
    members: Vec<NonZeroUsize>,
    /// Seconds of measurement for each number of members.
    #[arg(long, default_value = "4")]
    member_seconds: NonZeroU32,
    /// Skip the measurement of members.
    #[arg(long)]
    no_members: bool,
    /// Folder for cost.json; created if missing.
    #[arg(long, default_value = "results/cost")]
    out: PathBuf,
}

/// Content of `cost.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// The command line, as typed.
    pub command: String,
    /// Processor, cores, operating system.
    pub machine: String,
    /// Commit and optimisation of the build.
    pub build: String,
    /// Publishing of awake bodies, as one stream and as four.
    pub publishing: Vec<Publishing>,
    /// Publishing of sleeping bodies, by their number.
    pub sleeping: Vec<Sleeping>,
    /// Decoding and rendering.
    pub decoding: Decoding,
    /// Cost of one more member; empty if not measured or if the system does not report thread times.
    pub members: Vec<Members>,
}

/// Runs the measurements. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn cost(arguments: &CostArguments) -> ExitCode {
    ended(cost_all(arguments))
}

fn cost_all(arguments: &CostArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let costs = Costs::measure(arguments).map_err(Failure::Terms)?;
    output::write_json(&arguments.out.join("cost.json"), &costs)?;
    for (title, rows) in [
        (
            "publishing, beside the engine's step",
            costs.publishing_rows(),
        ),
        ("a tick in which all sleep", costs.sleeping_rows()),
        ("decoding and rendering", costs.decoding_rows()),
        (
            "a member's datagram, microseconds of a processor",
            costs.member_rows(),
        ),
    ] {
        if rows.len() > 1 {
            output::print_text(&format!("\n{title}\n{}", aligned(&rows)))?;
        }
    }
    output::print_text(&format!("\nwritten to {}\n", arguments.out.display()))?;
    Ok(())
}

impl Costs {
    fn measure(arguments: &CostArguments) -> Result<Self, String> {
        let (bodies, repeats) = (arguments.bodies, arguments.repeats.get());
        let counts = match arguments.no_members || !members::can_be_measured() {
            true => &[][..],
            false => &arguments.members[..],
        };
        let steps = publishing_steps(repeats) + 2 * counts.len() as u64;
        let bar = output::progress_bar(steps, "cost".to_owned());
        let mut progress = || bar.inc(1);
        let publishing = measure_publishing(bodies, repeats, &mut progress)?;
        let sleepers = [bodies / 100, bodies / 10, bodies];
        let long = Duration::from_secs(u64::from(arguments.member_seconds.get()));
        let costs = Self {
            command: output::command_line(),
            machine: machine::describe(),
            build: machine::build(),
            publishing,
            sleeping: sleepers
                .map(|bodies| measure_sleeping(bodies, repeats))
                .to_vec(),
            decoding: measure_decoding(bodies, repeats),
            members: members::members(counts, long, &mut progress)?,
        };
        bar.finish_and_clear();
        Ok(costs)
    }

    /// Text of a block of the documents; `None` if the block does not exist.
    pub fn block(&self, what: &str) -> Option<String> {
        let rows = match what {
            "command" => {
                return Some(machine::provenance(
                    &self.command,
                    &self.machine,
                    &self.build,
                ));
            }
            "publishing" => self.publishing_rows(),
            "sleeping" => self.sleeping_rows(),
            "decoding" => self.decoding_rows(),
            "members" => self.member_rows(),
            _ => return None,
        };
        Some(markdown(&rows))
    }

    fn publishing_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles([
            "scene",
            "awake",
            "streams",
            "step ms",
            "observe ms",
            "publish ms",
            "% of step",
            "aimed at",
            "upd/tick",
            "ns/upd",
        ])];
        for of in &self.publishing {
            let each_ns = of.publish_ms * 1e6 / of.updates_per_tick;
            rows.push(vec![
                of.scene.clone(),
                of.awake.to_string(),
                of.streams.to_string(),
                number(Some(of.step_ms)),
                number(Some(of.observe_ms)),
                number(Some(of.publish_ms)),
                number(Some(100.0 * of.of_step)),
                if of.streams == 1 { "3" } else { "8" }.to_owned(),
                number(Some(of.updates_per_tick)),
                // With few updates, scanning for them takes the time, so a cost per update would mislead.
                number(
                    (of.updates_per_tick >= of.awake as f64 / 100.0 && of.updates_per_tick > 0.0)
                        .then_some(each_ns),
                ),
            ]);
        }
        rows
    }

    fn sleeping_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles(["sleepers", "publish us"])];
        let row = |of: &Sleeping| vec![of.bodies.to_string(), number(Some(of.publish_us))];
        rows.extend(self.sleeping.iter().map(row));
        rows
    }

    fn decoding_rows(&self) -> Vec<Vec<String>> {
        let of = &self.decoding;
        let row = |what: String, found: f64, aim: &str, floor: f64| {
            let [found, floor] = [found, floor].map(|figure| number(Some(figure)));
            vec![what, found, aim.to_owned(), floor]
        };
        let first = "a body's first update, ns".to_owned();
        let view = format!("a view of {} moving bodies, ms", of.bodies);
        vec![
            titles(["what", "found", "aimed at", "least"]),
            row(
                "an update, ns".to_owned(),
                of.update_ns,
                "200",
                of.correcting_ns,
            ),
            row(first, of.first_ns, "200", of.correcting_ns),
            row(view, of.view_ms, "0.3", of.predicting_ms),
        ]
    }

    fn member_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles([
            "members",
            "rtt ms",
            "host us",
            "sockets us",
            "one more us",
            "aimed at",
            "its least us",
            "least of all us",
        ])];
        for (place, of) in self.members.iter().enumerate() {
            let before = place.checked_sub(1).map(|before| &self.members[before]);
            rows.push(vec![
                of.members.to_string(),
                of.round_trip_ms.to_string(),
                number(Some(of.server_loop_us)),
                number(Some(of.sockets_us)),
                number(of.one_more_us),
                "3".to_owned(),
                number(before.and_then(|before| of.floor_of_one_more_us(before))),
                number(Some(of.floor_us)),
            ]);
        }
        rows
    }
}

fn titles<const N: usize>(titles: [&str; N]) -> Vec<String> {
    titles.map(str::to_owned).to_vec()
}
