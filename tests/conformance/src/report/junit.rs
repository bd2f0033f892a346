//! A report as JUnit XML, for build servers.

use std::io;

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};

use super::results::Report;
use crate::outcome::Verdict;
use crate::run::Tried;

/// The report as JUnit XML.
///
/// # Errors
///
/// The error of the writer, which writes to memory.
pub fn junit(report: &Report) -> io::Result<String> {
    let mut writer = Writer::new_with_indent(Vec::new(), b' ', 1);
    writer.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    let tests = report.results.len().to_string();
    let failures = report.bad().count().to_string();
    let skipped = report
        .counts()
        .get(&Verdict::Unsupported)
        .copied()
        .unwrap_or_default();
    writer
        .create_element("testsuite")
        .with_attributes([
            ("name", "rhumb-conformance"),
            ("tests", &tests),
            ("failures", &failures),
            ("skipped", &skipped.to_string()),
        ])
        .write_inner_content(|writer| {
            for result in &report.results {
                case(writer, result, report.strict)?;
            }
            Ok(())
        })?;
    let mut text = String::from_utf8_lossy(&writer.into_inner()).into_owned();
    text.push('\n');
    Ok(text)
}

fn case(writer: &mut Writer<Vec<u8>>, result: &Tried, strict: bool) -> io::Result<()> {
    let Tried { case, outcome } = result;
    let group = case.id.rsplit_once('.').map_or("", |(group, _)| group);
    let name = format!("{} {}", case.id, case.name);
    let seconds = format!("{:.3}", outcome.took.as_secs_f64());
    let element = writer.create_element("testcase").with_attributes([
        ("classname", group),
        ("name", &name),
        ("time", &seconds),
    ]);
    let trace = outcome.trace.join("\n");
    let message = format!("{} {}", outcome.why, outcome.closing);
    let word = if !outcome.is_good(strict) {
        "failure"
    } else if outcome.verdict == Verdict::Unsupported {
        "skipped"
    } else {
        element.write_empty()?;
        return Ok(());
    };
    element.write_inner_content(|writer| {
        let inner = writer.create_element(word);
        let inner = inner.with_attributes([
            ("type", outcome.verdict.word()),
            ("message", message.trim()),
        ]);
        inner.write_text_content(BytesText::new(&trace))?;
        Ok(())
    })?;
    Ok(())
}
