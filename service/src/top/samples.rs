//! Reads the text format of Prometheus, as far as a server uses it.
//!
//! Labels are kept, comments and time stamps are not. Escapes within labels do not occur in figures of a server.

use std::collections::BTreeMap;
use std::fmt;

/// Values by name of figure.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Samples(BTreeMap<String, Vec<Sample>>);

/// One value of a figure.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sample {
    labels: Vec<(String, String)>,
    pub(super) value: f64,
}

/// A line that is no figure, counted from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct UnreadableFigures {
    line: usize,
}

impl fmt::Display for UnreadableFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {} of the answer is no figure", self.line)
    }
}

impl Samples {
    /// Reads a whole answer.
    pub(super) fn parse(text: &str) -> Result<Self, UnreadableFigures> {
        let mut samples = Self::default();
        for (place, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let unreadable = UnreadableFigures { line: place + 1 };
            let (name, sample) = sample(line).ok_or(unreadable)?;
            samples.0.entry(name).or_default().push(sample);
        }
        Ok(samples)
    }

    /// All values of a figure.
    pub(super) fn of(&self, name: &str) -> &[Sample] {
        self.0.get(name).map_or(&[], Vec::as_slice)
    }

    /// The value of a figure without labels.
    pub(super) fn plain(&self, name: &str) -> Option<f64> {
        self.of(name).first().map(|sample| sample.value)
    }

    /// Every figure with its values, in the order of names.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &Sample)> {
        let figures = self.0.iter();
        figures.flat_map(|(name, all)| all.iter().map(|one| (name.as_str(), one)))
    }
}

impl Sample {
    /// The value of a label.
    pub(super) fn label(&self, name: &str) -> Option<&str> {
        let label = self.labels.iter().find(|(of, _)| of == name);
        label.map(|(_, value)| value.as_str())
    }
}

/// `name value` or `name{label="value",…} value`.
fn sample(line: &str) -> Option<(String, Sample)> {
    let (name, labels, rest) = match line.split_once('{') {
        Some((name, rest)) => {
            let (labels, rest) = rest.split_once('}')?;
            (name, labels, rest)
        }
        None => {
            let (name, rest) = line.split_once(char::is_whitespace)?;
            (name, "", rest)
        }
    };
    let value = rest.split_whitespace().next()?.parse().ok()?;
    let labels = labels.split(',').filter(|label| !label.is_empty());
    let labels = labels.map(|label| {
        let (name, value) = label.split_once('=')?;
        let value = value.strip_prefix('"')?.strip_suffix('"')?;
        Some((name.trim().to_owned(), value.to_owned()))
    });
    let labels = labels.collect::<Option<_>>()?;
    Some((name.trim().to_owned(), Sample { labels, value }))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn figures_with_and_without_labels_are_read() {
        let text = "# HELP a An a.\n# TYPE a gauge\na 3\n\nb{scene=\"team/pit\",le=\"+Inf\"} 4.5 1700\n\
                    b{scene=\"pit\",le=\"0.1\"} NaN\n";
        let samples = Samples::parse(text).unwrap();
        assert_eq!(samples.plain("a"), Some(3.0));
        let [first, second] = samples.of("b") else {
            panic!("b has two values");
        };
        assert_eq!(first.label("scene"), Some("team/pit"));
        assert_eq!(first.label("le"), Some("+Inf"));
        assert!(first.value == 4.5 && second.value.is_nan());
        assert_eq!(samples.plain("c"), None);
    }

    #[test]
    fn a_line_that_is_no_figure_is_named() {
        for (text, line) in [("a 1\nhello", 2), ("a{b} 1", 1), ("a{b=\"c\" 1", 1)] {
            let refused = Samples::parse(text);
            assert_eq!(refused, Err(UnreadableFigures { line }), "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in ".*") {
            let _ = Samples::parse(&text);
        }
    }
}
