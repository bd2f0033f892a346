//! The tables of an ablation, for a terminal or for Markdown.

use super::results::{Ablation, AblationRow, Comparison, Sent};
use crate::machine;
use crate::summary::{markdown, number};

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
            "command" => machine::provenance(&self.command, &self.machine, &self.build),
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
    /// By how much the bytes without it exceed those with it, as a share of the latter, over each link.
    fn saved(&self) -> [Option<f64>; 2] {
        [0, 1].map(|link| {
            let (with, without) = (&self.with[link], &self.without[link]);
            Some(without.payload_bytes? / with.payload_bytes? - 1.0)
        })
    }
}
