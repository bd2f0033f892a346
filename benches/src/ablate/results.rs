//! The results of an ablation: `ablation.json`, and its tables.
//!
//! The tables are written for a terminal or for Markdown.

use serde::{Deserialize, Serialize};

use crate::record::{Cause, PacketDirection, Run};
use crate::summary::{markdown, number};
use crate::task::Provenance;

/// Content of `ablation.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ablation {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// The link with delay and loss.
    pub link: String,
    /// Seeds of that link, from 1 on.
    pub seeds: u64,
    /// The loads.
    pub loads: Vec<AblationLoad>,
    /// Body-ticks beyond the tolerance without a cause, in all replays: a defect.
    pub faults: u64,
    /// One row per mechanism.
    pub rows: Vec<AblationRow>,
}

/// One load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblationLoad {
    /// Its name.
    pub name: String,
    /// Scene or file.
    pub source: String,
    /// Number of dynamic bodies.
    pub bodies: u32,
    /// Number of ticks.
    pub ticks: u32,
    /// Tolerance, metres.
    pub tolerance_m: f64,
    /// Tolerance of the rotation, where it has one of its own, radians.
    pub turn_rad: Option<f64>,
    /// Ticks between publications.
    pub publish_interval: u32,
}

/// One mechanism.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AblationRow {
    /// The mechanism.
    pub name: String,
    /// The feature that users name, if the mechanism is one.
    pub feature: Option<String>,
    /// Name of the switch, as `replay --without` has it; `null` if the mechanism cannot be switched off.
    pub without: Option<String>,
    /// Ticks of lookahead with which it is measured.
    pub lookahead_ticks: u32,
    /// Lines of code.
    pub lines: u64,
    /// Requirements of the specification.
    pub requirements: u64,
    /// One per load.
    pub comparisons: Vec<Comparison>,
}

impl AblationRow {
    /// True if the mechanism can be switched off.
    #[must_use]
    pub const fn is_measured(&self) -> bool {
        self.without.is_some()
    }
}

/// One mechanism on one load.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Name of the load.
    pub load: String,
    /// Bytes with the mechanism: over a perfect link, and over the one with loss.
    pub with: [Sent; 2],
    /// The same without it.
    pub without: [Sent; 2],
}

/// Figures of a replay, or their means over several seeds; `null` where a replay failed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Sent {
    /// Bytes handed to QUIC.
    pub payload_bytes: Option<f64>,
    /// Share of moving body-ticks beyond the tolerance.
    pub over_share: Option<f64>,
    /// Processor time of publishing, divided by the number of updates, nanoseconds.
    pub publish_ns_per_update: Option<f64>,
    /// Cause of a failure.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failed: Option<String>,
}

impl Sent {
    /// Figures of one replay.
    pub(super) fn of(run: &Run) -> Self {
        let down = [PacketDirection::StateDown, PacketDirection::ControlDown];
        let down = run
            .captured
            .iter()
            .filter(|captured| down.contains(&captured.direction));
        let bytes: u64 = down.map(|captured| captured.counted).sum();
        let body_ticks: usize = run.frames.iter().map(|f| f.moving_errors_m.len()).sum();
        let updates: u64 = run.frames.iter().map(|frame| frame.updates).sum();
        let ratio = |part: f64, all: f64| (all > 0.0).then(|| part / all);
        Self {
            payload_bytes: Some(bytes as f64),
            over_share: ratio(run.breaches.len() as f64, body_ticks as f64),
            publish_ns_per_update: ratio(run.publish_ns_total as f64, updates as f64),
            failed: None,
        }
    }

    /// No figures.
    pub(super) fn failed(cause: String) -> Self {
        Self {
            failed: Some(cause),
            ..Self::default()
        }
    }

    /// The means of some replays.
    pub(super) fn mean(all: &[Self]) -> Self {
        let mean = |figure: fn(&Self) -> Option<f64>| {
            let figures: Option<Vec<f64>> = all.iter().map(figure).collect();
            let figures = figures.filter(|figures| !figures.is_empty())?;
            Some(figures.iter().sum::<f64>() / figures.len() as f64)
        };
        Self {
            payload_bytes: mean(|sent| sent.payload_bytes),
            over_share: mean(|sent| sent.over_share),
            publish_ns_per_update: mean(|sent| sent.publish_ns_per_update),
            failed: None,
        }
    }
}

/// Body-ticks beyond the tolerance without a cause.
pub(super) fn faults(run: &Run) -> u64 {
    let unexplained = run
        .breaches
        .iter()
        .filter(|breach| breach.cause == Cause::Fault);
    unexplained.count() as u64
}

/// Share of the bytes of one load that a mechanism must save to stay for its bytes.
const WORTH: f64 = 0.03;

impl Ablation {
    /// Titles and tables.
    pub(super) fn tables(&self) -> [(&'static str, Vec<Vec<String>>); 3] {
        [
            (
                "payload without the mechanism, % more than with it",
                self.bytes(),
            ),
            ("moving body-ticks beyond the tolerance, %", self.errors()),
            ("what it costs", self.price()),
        ]
    }

    /// Text of a block of the documents; `None` if the block does not exist.
    #[must_use]
    pub fn block(&self, what: &str) -> Option<String> {
        Some(match what {
            "command" => self.provenance.paragraph(),
            "loads" => markdown(&self.load_rows()),
            "bytes" => markdown(&self.bytes()),
            "errors" => markdown(&self.errors()),
            "price" => markdown(&self.price()),
            _ => return None,
        })
    }

    fn load_rows(&self) -> Vec<Vec<String>> {
        let titles = [
            "load",
            "source",
            "bodies",
            "ticks",
            "tolerance mm",
            "mrad",
            "interval",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        rows.extend(self.loads.iter().map(|load| {
            vec![
                load.name.clone(),
                load.source.clone(),
                load.bodies.to_string(),
                load.ticks.to_string(),
                number(Some(load.tolerance_m * 1e3)),
                number(load.turn_rad.map(|turn| turn * 1e3)),
                load.publish_interval.to_string(),
            ]
        }));
        rows
    }

    /// A column for each load and link, after the name of the mechanism.
    fn titles(&self) -> Vec<String> {
        let each = self.loads.iter();
        let each = each.flat_map(|load| [load.name.clone(), format!("{}, loss", load.name)]);
        std::iter::once("mechanism".to_owned())
            .chain(each)
            .collect()
    }

    fn measured(&self) -> impl Iterator<Item = &AblationRow> {
        self.rows.iter().filter(|row| row.is_measured())
    }

    fn bytes(&self) -> Vec<Vec<String>> {
        let mut rows = vec![self.titles()];
        let kilobytes = |sent: &Sent| number(sent.payload_bytes.map(|bytes| bytes / 1e3));
        rows.extend(self.base("everything on, kB", false, kilobytes));
        rows.extend(self.base("with lookahead, kB", true, kilobytes));
        rows.extend(self.measured().map(|row| {
            let cells = row.comparisons.iter().flat_map(Comparison::saved);
            let percent = |saved: Option<f64>| match saved {
                Some(saved) => format!("{:+.1}", saved * 100.0),
                None => "–".to_owned(),
            };
            let name = std::iter::once(row.name.clone());
            name.chain(cells.map(percent)).collect()
        }));
        rows
    }

    /// The row of everything on, with lookahead or without it.
    fn base(
        &self,
        title: &str,
        ahead: bool,
        cell: impl Fn(&Sent) -> String,
    ) -> Option<Vec<String>> {
        let mut rows = self.measured();
        let row = rows.find(|row| (row.lookahead_ticks > 0) == ahead)?;
        let cells = row.comparisons.iter().flat_map(|of| &of.with);
        let name = std::iter::once(title.to_owned());
        Some(name.chain(cells.map(cell)).collect())
    }

    fn errors(&self) -> Vec<Vec<String>> {
        let mut rows = vec![self.titles()];
        let percent = |sent: &Sent| number(sent.over_share.map(|share| share * 100.0));
        rows.extend(self.base("everything on", false, percent));
        rows.extend(self.base("with lookahead", true, percent));
        rows.extend(self.measured().map(|row| {
            let cells = row.comparisons.iter().flat_map(|of| &of.without);
            let name = std::iter::once(row.name.clone());
            name.chain(cells.map(percent)).collect()
        }));
        rows
    }

    fn price(&self) -> Vec<Vec<String>> {
        let titles = [
            "mechanism",
            "most saved, %",
            "time/update without it",
            "lines of code",
            "requirements",
            "stays for",
        ];
        let mut rows = vec![titles.map(str::to_owned).to_vec()];
        rows.extend(self.rows.iter().map(|row| {
            let saved = row.most_saved();
            let stays = match (saved.is_some_and(|saved| saved >= WORTH), &row.feature) {
                (true, None) => "bytes".to_owned(),
                (true, Some(feature)) => format!("{feature}, bytes"),
                (false, Some(feature)) => feature.clone(),
                (false, None) => "nothing".to_owned(),
            };
            vec![
                row.name.clone(),
                saved.map_or("–".to_owned(), |saved| format!("{:+.1}", saved * 100.0)),
                number(row.time_ratio()),
                row.lines.to_string(),
                row.requirements.to_string(),
                stays,
            ]
        }));
        rows
    }
}

impl AblationRow {
    /// Greatest share of the bytes that it saves, over loads and links.
    fn most_saved(&self) -> Option<f64> {
        let saved = self.comparisons.iter().flat_map(Comparison::saved);
        saved.flatten().reduce(f64::max)
    }

    /// Publishing time per update without it over that with it, without loss: the mean over the loads.
    fn time_ratio(&self) -> Option<f64> {
        let ratio = |of: &Comparison| {
            let [with, without] = [&of.with[0], &of.without[0]].map(|of| of.publish_ns_per_update);
            Some(without? / with?)
        };
        let ratios: Option<Vec<f64>> = self.comparisons.iter().map(ratio).collect();
        let ratios = ratios.filter(|ratios| !ratios.is_empty())?;
        Some(ratios.iter().sum::<f64>() / ratios.len() as f64)
    }
}

impl Comparison {
    /// The share by which the bytes without the mechanism exceed those with it, over each link.
    fn saved(&self) -> [Option<f64>; 2] {
        [0, 1].map(|link| {
            let (with, without) = (&self.with[link], &self.without[link]);
            Some(without.payload_bytes? / with.payload_bytes? - 1.0)
        })
    }
}
