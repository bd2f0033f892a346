//! The form of the golden vectors: sections of cases, one case a line.
//!
//! Writes JSON and reads none. Every float is its IEEE bits in hexadecimal, so that nothing is lost; a decimal of six
//! digits for readers follows under the same name with `_near`.

use std::fmt::Write;

/// One case under construction: fields in the order in which they were added.
pub(crate) struct CaseJson {
    fields: Vec<String>,
}

impl CaseJson {
    pub(crate) fn new() -> Self {
        Self { fields: Vec::new() }
    }

    pub(crate) fn text(self, name: &str, value: &str) -> Self {
        self.field(name, &format!("\"{value}\""))
    }

    pub(crate) fn texts(self, name: &str, values: &[&str]) -> Self {
        self.field(
            name,
            &list(values.iter().map(|value| format!("\"{value}\""))),
        )
    }

    pub(crate) fn integer(self, name: &str, value: impl Into<i64>) -> Self {
        self.field(name, &value.into().to_string())
    }

    pub(crate) fn integers(self, name: &str, values: &[i32]) -> Self {
        self.field(name, &list(values.iter().map(ToString::to_string)))
    }

    pub(crate) fn nothing(self, name: &str) -> Self {
        self.field(name, "null")
    }

    /// f64s: sixteen hexadecimal digits each.
    pub(crate) fn doubles(self, name: &str, values: &[f64]) -> Self {
        let bits = values.iter().map(|v| format!("\"{:016x}\"", v.to_bits()));
        self.field(name, &list(bits)).near(name, values)
    }

    /// f32s: eight hexadecimal digits each.
    pub(crate) fn singles(self, name: &str, values: &[f32]) -> Self {
        let bits = values.iter().map(|v| format!("\"{:08x}\"", v.to_bits()));
        let wide: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
        self.field(name, &list(bits)).near(name, &wide)
    }

    fn near(self, name: &str, values: &[f64]) -> Self {
        self.field(
            &format!("{name}_near"),
            &list(values.iter().map(|v| near(*v))),
        )
    }

    fn field(mut self, name: &str, value: &str) -> Self {
        self.fields.push(format!("\"{name}\": {value}"));
        self
    }
}

/// The whole file, from its sections.
pub(crate) fn written(sections: &[(&str, Vec<CaseJson>)]) -> String {
    let mut text = String::from("{\n\"format\": \"rhumb reckoning vectors 1\"");
    for (name, cases) in sections {
        let lines: Vec<_> = cases
            .iter()
            .map(|case| format!("{{{}}}", case.fields.join(", ")))
            .collect();
        write!(text, ",\n\"{name}\": [\n{}\n]", lines.join(",\n")).expect("a string takes text");
    }
    text.push_str("\n}\n");
    text
}

fn list(items: impl Iterator<Item = String>) -> String {
    format!("[{}]", items.collect::<Vec<_>>().join(", "))
}

/// The value in decimal, rounded; null for values that JSON lacks.
fn near(value: f64) -> String {
    let six_digits = format!("{value:.5e}").parse::<f64>();
    match six_digits {
        Ok(rounded) if rounded.is_finite() => format!("{rounded:?}"),
        _ => "null".to_owned(),
    }
}
