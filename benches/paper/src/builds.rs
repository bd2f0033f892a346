//! Two builds side by side, as `benches/compare_builds.py` measures them.

use rhumb_bench::numbers::{markdown, number};
use serde::Deserialize;

/// Content of `builds.json`.
#[derive(Debug, Deserialize)]
pub(crate) struct Builds {
    machine: String,
    /// Commits.
    old: String,
    new: String,
    #[serde(default)]
    rows: Vec<BuildRow>,
    #[serde(default)]
    bytes: Vec<LoadRow>,
    #[serde(default)]
    stages: Vec<StageRow>,
}

/// A figure of both builds.
#[derive(Debug, Deserialize)]
struct BuildRow {
    what: String,
    unit: String,
    /// `None` where only the new build can do it.
    old: Option<f64>,
    new: f64,
    ratio: Option<f64>,
    /// The least and the greatest ratio of the pairs.
    least: Option<f64>,
    most: Option<f64>,
    /// `None` where the aim is another row's.
    aim: Option<String>,
    met: Option<bool>,
    /// A floor of the same run, in words.
    beside: Option<String>,
    /// How it was measured, in words.
    by: String,
    /// The command: a task of `rhumb-bench`, or a Criterion bench.
    command: String,
}

/// Bytes of a load.
#[derive(Debug, Deserialize)]
struct LoadRow {
    load: String,
    /// Payload, kbit/s.
    old: f64,
    new: f64,
    ratio: f64,
    /// Moving body-ticks that are off, percent.
    old_off: Option<f64>,
    new_off: Option<f64>,
    /// True if the engine took the same path.
    same_truth: bool,
    /// Body-ticks of both builds that are off without a cause.
    faults: u64,
    command: String,
}

/// A Criterion bench, mean processor time.
#[derive(Debug, Deserialize)]
struct StageRow {
    stage: String,
    old_ns: f64,
    new_ns: f64,
}

impl Builds {
    /// Text of a block of the documents; `None` if the block does not exist.
    pub(crate) fn block(&self, what: &str) -> Option<String> {
        match what {
            "machine" => Some(format!(
                "Builds of {} and {}, on {}.",
                self.old, self.new, self.machine
            )),
            "table" => Some(markdown(&self.table())),
            "bytes" => Some(markdown(&self.loads())),
            "stages" => Some(markdown(&self.stages())),
            _ => None,
        }
    }

    fn titles(&self, before: &[&str], behind: &[&str]) -> Vec<String> {
        let before = before.iter().map(|title| (*title).to_owned());
        let builds = [self.old.clone(), self.new.clone(), "ratio".to_owned()];
        let behind = behind.iter().map(|title| (*title).to_owned());
        before.chain(builds).chain(behind).collect()
    }

    fn table(&self) -> Vec<Vec<String>> {
        let behind = ["aim", "met", "floor", "by", "command"];
        let mut table = vec![self.titles(&["what", "unit"], &behind)];
        for row in &self.rows {
            let mut cells = vec![row.what.clone(), row.unit.clone()];
            cells.extend([row.old, Some(row.new)].map(number));
            let ratio = number(row.ratio);
            cells.push(match row.least.zip(row.most) {
                Some((least, most)) => {
                    format!(
                        "{ratio} ({} to {})",
                        number(Some(least)),
                        number(Some(most))
                    )
                }
                None => ratio,
            });
            cells.push(row.aim.clone().unwrap_or_else(|| number(None)));
            cells.push(match row.met {
                Some(true) => "yes".to_owned(),
                Some(false) => "**no**".to_owned(),
                None => number(None),
            });
            cells.push(row.beside.clone().unwrap_or_else(|| number(None)));
            cells.extend([row.by.clone(), format!("`{}`", row.command)]);
            table.push(cells);
        }
        table
    }

    fn loads(&self) -> Vec<Vec<String>> {
        let behind = ["off, %", "off, %", "same truth", "faults", "command"];
        let mut table = vec![self.titles(&["load"], &behind)];
        for row in &self.bytes {
            let mut cells = vec![row.load.clone()];
            cells.extend([row.old, row.new, row.ratio].map(|value| number(Some(value))));
            cells.extend([row.old_off, row.new_off].map(number));
            let same = if row.same_truth { "yes" } else { "no" };
            cells.extend([same.to_owned(), row.faults.to_string()]);
            cells.push(format!("`{}`", row.command));
            table.push(cells);
        }
        table
    }

    fn stages(&self) -> Vec<Vec<String>> {
        let mut table = vec![self.titles(&["stage, us"], &[])];
        for row in &self.stages {
            let microseconds = [row.old_ns, row.new_ns].map(|ns| Some(ns * 1e-3));
            let mut cells = vec![row.stage.clone()];
            cells.extend(microseconds.map(number));
            cells.push(number(Some(row.new_ns / row.old_ns)));
            table.push(cells);
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_says_whether_its_aim_is_met() {
        let text = r#"{"machine": "m", "old": "a", "new": "b", "rows": [
            {"what": "w", "unit": "us", "old": 4.0, "new": 2.0, "ratio": 0.5, "least": 0.4, "most": 0.75,
             "aim": "≤ 0.45 ×", "met": false, "by": "5 pairs", "command": "cost"}]}"#;
        let builds: Builds = serde_json::from_str(text).unwrap();
        let expected = "| what | unit | a | b | ratio | aim | met | floor | by | command |";
        let table = builds.block("table").unwrap();
        assert!(table.starts_with(expected), "{table}");
        let row = "| w | us | 4.00 | 2.00 | 0.500 (0.400 to 0.750) | ≤ 0.45 × | **no** | – | 5 pairs | `cost` |";
        assert!(table.contains(row), "{table}");
    }
}
