//! `rhumb-bench dev fit`: fits the packet coder's tables to recordings.
//!
//! Publishes each recording without loss and counts the symbols of its packets; all recordings weigh alike. Then
//! alternates two steps. An alphabet becomes the histogram of its class, blended with a smooth distribution. A
//! context's initial expectation becomes the one with the lowest cost for its numbers. Publishers choose by cost, so a
//! second run with the new tables fits slightly better.

use std::fmt::Write;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

use clap::Args;
use rhumb_netsim::LinkConfig;
use rhumb_protocol::packet::{LargestPacket, SymbolCounts, Tables};
use rhumb_protocol::stream::LOOKAHEAD_MAX;
use rhumb_reckoning::{Metres, Radians, Ticks, Tolerance};

use crate::output::{self, Failure, ended};
use crate::record::PacketDirection;
use crate::recording::{self, DEFAULT_TOLERANCE, ReadOptions, print_notes};
use crate::replay::{EnabledFeatures, ReplayConfig, run, tally};

/// Arguments: recordings to fit to, and the file of the tables.
#[derive(Clone, Debug, Args)]
pub struct FitArguments {
    /// Recordings and how they are published, such as cubes.rhtrace.zst,tolerance=0.01,lookahead=6,weight=2; further
    /// settings: turn (degrees), publish-interval, and load, the name of one of the file's loads. The tolerance is 0.05
    /// m unless it is set.
    #[arg(required = true)]
    loads: Vec<FitLoad>,
    /// Source file whose tables are replaced; without it the tables are printed.
    #[arg(long)]
    into: Option<PathBuf>,
}

/// A recording, its publish settings, and its weight.
#[derive(Clone, Debug, PartialEq)]
struct FitLoad {
    path: PathBuf,
    /// One of the file's; its first, unless it is named.
    load: Option<String>,
    config: ReplayConfig,
    weight: f64,
}

fn number(name: &str, text: &str) -> Result<f64, String> {
    text.parse()
        .map_err(|_| format!("{name} is {text:?}, and must be a number"))
}

impl FromStr for FitLoad {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.split(',');
        let path = PathBuf::from(parts.next().unwrap_or_default());
        let (mut tolerance, mut turn, mut publish_interval, mut lookahead, mut weight) =
            (number("tolerance", DEFAULT_TOLERANCE)?, None, 1.0, 0.0, 1.0);
        let mut load = None;
        for part in parts {
            let (name, value) = part
                .split_once('=')
                .ok_or_else(|| format!("{part} is not a setting"))?;
            match name {
                "load" => load = Some(value.to_owned()),
                "tolerance" => tolerance = number(name, value)?,
                "turn" => turn = Some(number(name, value)?),
                "publish-interval" => publish_interval = number(name, value)?,
                "lookahead" => lookahead = number(name, value)?,
                "weight" => weight = number(name, value)?,
                _ => {
                    return Err(format!(
                        "{name:?} is no setting of a load: load, tolerance, turn, publish-interval, lookahead or weight"
                    ));
                }
            }
        }
        let length = Metres::new(tolerance);
        let allowed = match turn {
            None => Tolerance::from_metres(length),
            Some(degrees) => Tolerance::parts(length, Radians::new(degrees.to_radians())),
        };
        let most = f64::from(LOOKAHEAD_MAX.count());
        if !(0.0..=most).contains(&lookahead) {
            return Err(format!(
                "lookahead is {lookahead}, and must be 0 to {most} ticks"
            ));
        }
        if !(weight > 0.0 && weight.is_finite()) {
            return Err(format!(
                "weight is {weight}, and must be finite and above 0"
            ));
        }
        let interval = NonZeroU32::new(publish_interval as u32).ok_or_else(|| {
            format!("publish-interval is {publish_interval}, and must be at least 1")
        })?;
        Ok(Self {
            path,
            load,
            config: ReplayConfig {
                budget: None,
                largest_packet: LargestPacket::DEFAULT,
                tolerance: allowed
                    .map_err(|wrong| format!("tolerance is {tolerance} m: {wrong}"))?,
                link: LinkConfig::PERFECT,
                publish_interval: interval,
                seed: 1,
                lookahead: Ticks::new(lookahead as u32),
                features: EnabledFeatures::ALL,
            },
            weight,
        })
    }
}

/// Fits tables. Exit code 0 if they were fitted and written, 1 otherwise.
pub fn fit(arguments: &FitArguments) -> ExitCode {
    ended(fit_all(arguments))
}

fn fit_all(arguments: &FitArguments) -> Result<(), Failure> {
    let mut fit = Fit::new();
    for load in &arguments.loads {
        let options = ReadOptions {
            load: load.load.clone(),
            ..ReadOptions::default()
        };
        let recording = recording::read(&load.path, &options)?;
        print_notes(&recording);
        let bar = output::progress_bar(u64::from(recording.ticks()), recording.name.clone());
        let run = run(&recording, &load.config, &mut |_| bar.inc(1))?;
        bar.finish_and_clear();
        let packets = run
            .captured
            .iter()
            .filter(|captured| captured.direction == PacketDirection::StateDown);
        fit.add(
            load.weight,
            packets
                .filter_map(|captured| tally(&captured.bytes))
                .collect(),
        );
    }
    let [before, after] = fit.run();
    let summary = format!("{before:.4} bits per number became {after:.4}\n");
    let written = match &arguments.into {
        None => fit.to_rust(),
        Some(path) => {
            let text = std::fs::read_to_string(path).map_err(|e| file_error(path, &e))?;
            let replaced = fit.replaced(&text);
            let text =
                replaced.ok_or_else(|| format!("{} holds no coder tables", path.display()))?;
            std::fs::write(path, text).map_err(|e| file_error(path, &e))?;
            String::new()
        }
    };
    Ok(output::print_text(&(summary + &written))?)
}

fn file_error(path: &std::path::Path, why: &std::io::Error) -> String {
    format!("{}: {why}", path.display())
}

const CONTEXTS: usize = SymbolCounts::NUMBERS[0];
const GROUPS: usize = SymbolCounts::NUMBERS[1];
const CLASSES: usize = SymbolCounts::NUMBERS[2];
const SYMBOLS: usize = SymbolCounts::NUMBERS[3];
/// Sum of an alphabet's frequencies.
const PARTS: f64 = 4_096.0;
/// Rounds of fitting; later ones change almost nothing.
const ROUNDS: usize = 3;
/// A context forgets its initial expectation after this many numbers.
const FORGOTTEN: usize = 24;
/// Weight of the smooth alphabet, in numbers per million observed.
const SMOOTH: f64 = 60.0;
/// Weight of a context's present expectation, in numbers per million observed.
const INERTIA: f64 = 1.0;

/// Symbols of the packets of several loads, each with its weight.
#[derive(Debug, Default)]
struct Fit {
    packets: Vec<(f64, SymbolCounts)>,
    expected: Vec<u32>,
    shapes: Vec<Vec<f64>>,
    modes: Vec<Vec<f64>>,
    /// Bits of each symbol of each alphabet.
    costs: Vec<Vec<f64>>,
}

impl Fit {
    /// Starts from the present tables.
    fn new() -> Self {
        let sizes = |starts: &[u16]| {
            let pairs = starts.windows(2);
            pairs.map(|pair| f64::from(pair[1] - pair[0])).collect()
        };
        let mut fit = Self {
            costs: Vec::new(),
            packets: Vec::new(),
            expected: Tables::ALL.expected.iter().map(|e| u32::from(*e)).collect(),
            shapes: Tables::ALL.shapes.iter().map(|row| sizes(row)).collect(),
            modes: Tables::ALL.modes.iter().map(|row| sizes(row)).collect(),
        };
        fit.update_costs();
        fit
    }

    fn update_costs(&mut self) {
        let bits = |size: &f64| -(size / PARTS).log2();
        let rows = self.shapes.iter();
        self.costs = rows.map(|row| row.iter().map(bits).collect()).collect();
    }

    /// Adds the packets of one load; each load counts alike, times its weight.
    fn add(&mut self, weight: f64, packets: Vec<SymbolCounts>) {
        let numbers: usize = packets.iter().map(|packet| packet.numbers.len()).sum();
        let each = weight * 1e6 / numbers.max(1) as f64;
        self.packets
            .extend(packets.into_iter().map(|packet| (each, packet)));
    }

    /// Fits the tables; returns the cost before and after, in bits per number.
    fn run(&mut self) -> [f64; 2] {
        let before = self.cost();
        for _ in 0..ROUNDS {
            self.fit_shapes();
            self.fit_expectations();
        }
        self.fit_shapes();
        self.fit_modes();
        [before, self.cost()]
    }

    fn cost(&self) -> f64 {
        let (mut bits, mut all) = (0.0, 0.0);
        for (weight, packet) in &self.packets {
            let mut expected = self.expected.clone();
            for &(context, number) in &packet.numbers {
                bits += weight * self.bits(context, expected[context], number);
                all += weight;
                adapt(&mut expected[context], number);
            }
        }
        bits / all
    }

    fn bits(&self, context: usize, expected: u32, number: u32) -> f64 {
        let (raw, class) = class(expected);
        let high = number >> raw;
        let symbol = (high as usize).min(SYMBOLS - 1);
        let size = self.costs[SymbolCounts::group(context) * CLASSES + class][symbol];
        let mut bits = size + f64::from(raw);
        if symbol == SYMBOLS - 1 {
            bits += f64::from(2 * (high - symbol as u32 + 1).ilog2() + 1);
        }
        bits
    }

    fn fit_shapes(&mut self) {
        let mut counts = vec![vec![0.0; SYMBOLS]; GROUPS * CLASSES];
        for (weight, packet) in &self.packets {
            let mut expected = self.expected.clone();
            for &(context, number) in &packet.numbers {
                let (raw, class) = class(expected[context]);
                let symbol = ((number >> raw) as usize).min(SYMBOLS - 1);
                counts[SymbolCounts::group(context) * CLASSES + class][symbol] += weight;
                adapt(&mut expected[context], number);
            }
        }
        for (place, counts) in counts.iter().enumerate() {
            let mean = mean_of(place % CLASSES);
            let stay = mean / (1.0 + mean);
            let smooth = |symbol: usize| {
                let tail = stay.powi(symbol as i32);
                if symbol + 1 == SYMBOLS {
                    tail
                } else {
                    tail * (1.0 - stay)
                }
            };
            let blended = (0..SYMBOLS).map(|symbol| counts[symbol] + SMOOTH * smooth(symbol));
            self.shapes[place] = whole_parts(&blended.collect::<Vec<_>>());
        }
        self.update_costs();
    }

    fn fit_expectations(&mut self) {
        let mut observed: Vec<Vec<(f64, Vec<u32>)>> = vec![Vec::new(); CONTEXTS];
        for (weight, packet) in &self.packets {
            let mut numbers: Vec<Vec<u32>> = vec![Vec::new(); CONTEXTS];
            for &(context, number) in &packet.numbers {
                if numbers[context].len() < FORGOTTEN {
                    numbers[context].push(number);
                }
            }
            for (context, numbers) in numbers.into_iter().enumerate() {
                if !numbers.is_empty() {
                    observed[context].push((*weight, numbers));
                }
            }
        }
        for (context, observed) in observed.iter().enumerate() {
            let now = self.expected[context];
            let cost = |first: u32| {
                let away = (f64::from(first + 16) / f64::from(now + 16)).log2().abs();
                let mut bits = INERTIA * away;
                for (weight, numbers) in observed {
                    let mut expected = first;
                    for &number in numbers {
                        bits += weight * self.bits(context, expected, number);
                        adapt(&mut expected, number);
                    }
                }
                bits
            };
            let least = candidates().map(|first| (cost(first), first));
            let least = least.min_by(|a, b| a.0.total_cmp(&b.0));
            self.expected[context] = least.map_or(now, |(_, first)| first);
        }
    }

    fn fit_modes(&mut self) {
        let [rows, codes] = SymbolCounts::CODES;
        let mut counts = vec![vec![20.0; codes]; rows];
        for (weight, packet) in &self.packets {
            for &[row, code] in &packet.codes {
                counts[row][code] += weight;
            }
        }
        self.modes = counts.iter().map(|counts| whole_parts(counts)).collect();
    }

    /// Bodies of the tables, by name, as in `protocol/src/packet/tables.rs`.
    fn bodies(&self) -> [(&'static str, String); 3] {
        let mut expected = String::new();
        for row in self.expected.chunks(16) {
            let row: Vec<_> = row.iter().map(u32::to_string).collect();
            let _ = writeln!(expected, "    {},", row.join(", "));
        }
        let starts = |table: &[Vec<f64>]| {
            let mut text = String::new();
            for row in table {
                let mut start = 0.0;
                let mut starts = vec!["0".to_owned()];
                for size in row {
                    start += size;
                    starts.push(start.to_string());
                }
                let _ = writeln!(text, "    [{}],", starts.join(", "));
            }
            text
        };
        [
            ("EXPECTED", expected),
            ("SHAPES", starts(&self.shapes)),
            ("MODES", starts(&self.modes)),
        ]
    }

    /// The tables as Rust source.
    fn to_rust(&self) -> String {
        let tables = self.bodies();
        let tables = tables.iter().map(|(name, body)| format!("{name}\n{body}"));
        tables.collect()
    }

    /// `text` with its tables replaced; `None` if it lacks one.
    fn replaced(&self, text: &str) -> Option<String> {
        let mut text = text.to_owned();
        for (name, body) in self.bodies() {
            let begin = text.find(&format!("const {name}:"))?;
            let begin = begin + text[begin..].find("= [\n")? + 4;
            let end = begin + text[begin..].find("];\n")?;
            text.replace_range(begin..end, &body);
        }
        Some(text)
    }
}

/// Initial expectations to try: eight per octave.
fn candidates() -> impl Iterator<Item = u32> {
    let steps = (0..=8 * 11).map(|step: i32| 16.0 * 2_f64.powf(f64::from(step) / 8.0) - 16.0);
    steps.map(|first| first as u32)
}

/// Raw bits and class of an expectation (PROTOCOL 5.4).
fn class(expected: u32) -> (u32, usize) {
    let sixteenths = expected / 16 + 1;
    let octave = sixteenths.ilog2();
    let raw = octave.saturating_sub(6);
    let octave = octave - raw;
    let quarter = (((sixteenths >> raw) << 2) >> octave) & 3;
    (raw, (octave * 4 + quarter) as usize)
}

/// Mean expectation of a class.
fn mean_of(class: usize) -> f64 {
    let (octave, quarter) = ((class / 4) as i32, (class % 4) as f64);
    (2_f64.powi(octave) * (1.0 + (quarter + 0.5) / 4.0) - 0.5) / 16.0
}

fn adapt(expected: &mut u32, number: u32) {
    let off = i64::from(256 * number.min(4_095)) - i64::from(*expected);
    *expected = (i64::from(*expected) + (off >> 3)) as u32;
}

/// Scales counts to an alphabet; each symbol gets a frequency of at least one.
fn whole_parts(counts: &[f64]) -> Vec<f64> {
    let all: f64 = counts.iter().sum();
    let free = PARTS - counts.len() as f64;
    let mut parts: Vec<f64> = counts
        .iter()
        .map(|count| 1.0 + (free * count / all).floor())
        .collect();
    let rest = PARTS - parts.iter().sum::<f64>();
    let most = (0..parts.len()).max_by(|a, b| parts[*a].total_cmp(&parts[*b]));
    parts[most.unwrap_or_default()] += rest;
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A packet whose positions all have this value.
    fn packet(number: u32) -> SymbolCounts {
        let context = (0..CONTEXTS).find(|context| SymbolCounts::group(*context) == 1);
        SymbolCounts {
            codes: vec![[1, 0]; 4],
            numbers: vec![(context.unwrap(), number); 4],
        }
    }

    #[test]
    fn a_frequent_symbol_gets_cheap() {
        let mut fit = Fit::new();
        fit.add(1.0, vec![packet(3); 500]);
        let [before, after] = fit.run();
        assert!(after < before && after < 0.2, "{before} {after}");
        for row in fit.shapes.iter().chain(&fit.modes) {
            assert!(row.iter().all(|size| *size >= 1.0));
            assert!((row.iter().sum::<f64>() - PARTS).abs() < 1e-9);
        }
    }

    #[test]
    fn fitted_tables_replace_those_of_the_source() {
        let fit = Fit::new();
        let source =
            "const EXPECTED: x = [\n1\n];\nconst SHAPES: y = [\n2\n];\nconst MODES: z = [\n3\n];\n";
        let replaced = fit.replaced(source).unwrap();
        assert_eq!(fit.replaced(&replaced), Some(replaced.clone()));
        assert!(replaced.starts_with("const EXPECTED: x = [\n    "));
        assert_eq!(fit.replaced("const EXPECTED: x = [\n];\n"), None);
    }

    #[test]
    fn loads_are_read_and_wrong_ones_refused() {
        let load: FitLoad =
            "a.mcap,load=n50,tolerance=0.02,publish-interval=2,lookahead=6,weight=2"
                .parse()
                .unwrap();
        assert_eq!(load.load.as_deref(), Some("n50"));
        assert_eq!(
            (load.config.publish_interval.get(), load.config.lookahead),
            (2, Ticks::new(6))
        );
        for wrong in [
            "a,publish-interval=0",
            "a,colour=1",
            "a,weight=0",
            "a,lookahead=7",
            "a,turn",
        ] {
            assert!(wrong.parse::<FitLoad>().is_err(), "{wrong}");
        }
    }
}
