//! `rhumb-bench fit`: the tables of the packets' coder, fitted to what is said of recordings.
//!
//! Each recording is published without loss, and what its packets say is counted; all recordings count alike. Then, in
//! turns: alphabets are the histograms of what is said in their class, blended with what smooth ones would be; and each
//! context expects at first what makes its numbers cheapest. What is said depends on what it costs, so that a second run
//! with the new tables fits a little better.

use std::fmt::Write;

use rhumb_protocol::packet::{Tables, Tally};

const CONTEXTS: usize = Tally::NUMBERS[0];
const GROUPS: usize = Tally::NUMBERS[1];
const CLASSES: usize = Tally::NUMBERS[2];
const SYMBOLS: usize = Tally::NUMBERS[3];
/// Parts of an alphabet.
const PARTS: f64 = 4_096.0;
/// Turns of fitting; later ones change next to nothing.
const TURNS: usize = 3;
/// A context has forgotten what it expected at first after so many numbers.
const FORGOTTEN: usize = 24;
/// Numbers that a smooth alphabet counts for, if a million were said.
const SMOOTH: f64 = 60.0;
/// Numbers that stand for a context's present expectation, if a million were said.
const LOYALTY: f64 = 1.0;

/// What was said in the packets of several loads, each with its weight.
#[derive(Debug, Default)]
pub struct Fit {
    packets: Vec<(f64, Tally)>,
    expected: Vec<u32>,
    shapes: Vec<Vec<f64>>,
    modes: Vec<Vec<f64>>,
    /// Bits of each symbol of each shape.
    costs: Vec<Vec<f64>>,
}

impl Fit {
    /// Begins with the tables as they are.
    #[must_use]
    pub fn new() -> Self {
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
        fit.reckon_costs();
        fit
    }

    fn reckon_costs(&mut self) {
        let bits = |size: &f64| -(size / PARTS).log2();
        let rows = self.shapes.iter();
        self.costs = rows.map(|row| row.iter().map(bits).collect()).collect();
    }

    /// Adds the packets of one load; loads count alike but for their weight.
    pub fn add(&mut self, weight: f64, packets: Vec<Tally>) {
        let numbers: usize = packets.iter().map(|packet| packet.numbers.len()).sum();
        let each = weight * 1e6 / numbers.max(1) as f64;
        self.packets
            .extend(packets.into_iter().map(|packet| (each, packet)));
    }

    /// Fits; returns what all numbers cost before and after, in bits a number.
    pub fn run(&mut self) -> [f64; 2] {
        let before = self.cost();
        for _ in 0..TURNS {
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
                learn(&mut expected[context], number);
            }
        }
        bits / all
    }

    fn bits(&self, context: usize, expected: u32, number: u32) -> f64 {
        let (raw, class) = class(expected);
        let high = number >> raw;
        let symbol = (high as usize).min(SYMBOLS - 1);
        let size = self.costs[Tally::group(context) * CLASSES + class][symbol];
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
                counts[Tally::group(context) * CLASSES + class][symbol] += weight;
                learn(&mut expected[context], number);
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
        self.reckon_costs();
    }

    fn fit_expectations(&mut self) {
        let mut said: Vec<Vec<(f64, Vec<u32>)>> = vec![Vec::new(); CONTEXTS];
        for (weight, packet) in &self.packets {
            let mut numbers: Vec<Vec<u32>> = vec![Vec::new(); CONTEXTS];
            for &(context, number) in &packet.numbers {
                if numbers[context].len() < FORGOTTEN {
                    numbers[context].push(number);
                }
            }
            for (context, numbers) in numbers.into_iter().enumerate() {
                if !numbers.is_empty() {
                    said[context].push((*weight, numbers));
                }
            }
        }
        for (context, said) in said.iter().enumerate() {
            let now = self.expected[context];
            let cost = |first: u32| {
                let away = (f64::from(first + 16) / f64::from(now + 16)).log2().abs();
                let mut bits = LOYALTY * away;
                for (weight, numbers) in said {
                    let mut expected = first;
                    for &number in numbers {
                        bits += weight * self.bits(context, expected, number);
                        learn(&mut expected, number);
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
        let [rows, codes] = Tally::CODES;
        let mut counts = vec![vec![20.0; codes]; rows];
        for (weight, packet) in &self.packets {
            for &[row, code] in &packet.codes {
                counts[row][code] += weight;
            }
        }
        self.modes = counts.iter().map(|counts| whole_parts(counts)).collect();
    }

    /// The tables as `protocol/src/packet/tables.rs` holds them.
    #[must_use]
    pub fn to_rust(&self) -> String {
        let mut text = String::from("EXPECTED\n");
        for row in self.expected.chunks(16) {
            let row: Vec<_> = row.iter().map(u32::to_string).collect();
            let _ = writeln!(text, "    {},", row.join(", "));
        }
        for (name, table) in [("SHAPES", &self.shapes), ("MODES", &self.modes)] {
            let _ = writeln!(text, "{name}");
            for row in table {
                let mut start = 0.0;
                let mut starts = vec!["0".to_owned()];
                for size in row {
                    start += size;
                    starts.push(start.to_string());
                }
                let _ = writeln!(text, "    [{}],", starts.join(", "));
            }
        }
        text
    }
}

/// First expectations to try: eight to an octave.
fn candidates() -> impl Iterator<Item = u32> {
    let steps = (0..=8 * 11).map(|step: i32| 16.0 * 2_f64.powf(f64::from(step) / 8.0) - 16.0);
    steps.map(|first| first as u32)
}

/// As PROTOCOL 5.4 has it: how many bits go raw, and the class of the rest.
fn class(expected: u32) -> (u32, usize) {
    let sixteenths = expected / 16 + 1;
    let octave = sixteenths.ilog2();
    let raw = octave.saturating_sub(6);
    let octave = octave - raw;
    let quarter = (((sixteenths >> raw) << 2) >> octave) & 3;
    (raw, (octave * 4 + quarter) as usize)
}

/// What a class expects, in the middle.
fn mean_of(class: usize) -> f64 {
    let (octave, quarter) = ((class / 4) as i32, (class % 4) as f64);
    (2_f64.powi(octave) * (1.0 + (quarter + 0.5) / 4.0) - 0.5) / 16.0
}

fn learn(expected: &mut u32, number: u32) {
    let off = i64::from(256 * number.min(4_095)) - i64::from(*expected);
    *expected = (i64::from(*expected) + (off >> 3)) as u32;
}

/// Counts as parts of an alphabet, of which each symbol has one at least.
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
