//! `rhumb-bench cost`: what a stream takes of a processor, stage by stage
//!
//! Publishing beside the engine's step, silence where all sleep, hearing, showing, and one more member of a stream. All but
//! the members run in the calling thread, one after the other; each figure is the median of its repeats, beside what was
//! aimed at.

pub mod decoding;
mod floor;
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
use crate::quantile;
use crate::replay::{Failure, ended};
use crate::summary::{aligned, markdown, number};

pub use decoding::Decoding;
pub use members::Members;
pub use publishing::{Publishing, Sleeping};

/// How many bodies and members, how often, and where to write what it took.
#[derive(Clone, Debug, Args)]
pub struct CostArguments {
    /// Bodies that are published, heard and shown.
    #[arg(long, default_value = "10000", value_parser = clap::value_parser!(u32).range(100..=50_000))]
    bodies: u32,
    /// The median of so many counts.
    #[arg(long, default_value = "5")]
    repeats: NonZeroU32,
    /// Members of a stream over loopback: so many at a time, fewest first.
    #[arg(long, value_delimiter = ',', default_value = "1,8,16,32")]
    members: Vec<NonZeroUsize>,
    /// Seconds for which each number of members is measured.
    #[arg(long, default_value = "4")]
    member_seconds: NonZeroU32,
    /// Measure no members.
    #[arg(long)]
    no_members: bool,
    /// Folder for cost.json; made if it is not there.
    #[arg(long, default_value = "results/cost")]
    out: PathBuf,
}

/// What `cost.json` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// The command line, as typed.
    pub command: String,
    /// Processor, cores, system.
    pub machine: String,
    /// Of which commit, with which optimisation.
    pub build: String,
    /// Scenes whose bodies are awake, as one stream and as four.
    pub publishing: Vec<Publishing>,
    /// Streams of more and more sleepers.
    pub sleeping: Vec<Sleeping>,
    /// Hearing and showing.
    pub decoding: Decoding,
    /// One more member; empty where it was not measured or the system does not tell.
    pub members: Vec<Members>,
}

/// Measures. Exit code 0 when everything was measured and written, 1 otherwise.
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

/// The value in the midst of several; zero of none.
fn median(values: impl Iterator<Item = Duration>) -> Duration {
    let mut all: Vec<u64> = values.map(|value| value.as_nanos() as u64).collect();
    Duration::from_nanos(quantile::of_nanoseconds(&mut all, 50).unwrap_or(0))
}

impl Costs {
    fn measure(arguments: &CostArguments) -> Result<Self, String> {
        let (bodies, repeats) = (arguments.bodies, arguments.repeats.get());
        let counts = match arguments.no_members || !members::can_be_measured() {
            true => &[][..],
            false => &arguments.members[..],
        };
        let steps = publishing::steps(repeats) + 2 * counts.len() as u64;
        let bar = output::progress_bar(steps, "cost".to_owned());
        let mut progress = || bar.inc(1);
        let publishing = publishing::publishing(bodies, repeats, &mut progress)?;
        let sleepers = [bodies / 100, bodies / 10, bodies];
        let long = Duration::from_secs(u64::from(arguments.member_seconds.get()));
        let costs = Self {
            command: output::command_line(),
            machine: machine::describe(),
            build: machine::build(),
            publishing,
            sleeping: sleepers
                .map(|bodies| publishing::sleeping(bodies, repeats))
                .to_vec(),
            decoding: decoding::decoding(bodies, repeats),
            members: members::members(counts, long, &mut progress)?,
        };
        bar.finish_and_clear();
        Ok(costs)
    }

    /// What stands in a block of a page; none if there is no such block.
    pub(crate) fn block(&self, what: &str) -> Option<String> {
        let rows = match what {
            "command" => {
                return Some(format!(
                    "    {}\n\nOn {} ({}).",
                    self.command, self.machine, self.build
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
                // Where few are said, looking for them is what takes the time.
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
