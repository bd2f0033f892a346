//! A report as JUnit XML, for build servers.
//!
//! A candidate may print anything. XML cannot hold every character, not even escaped: those that it cannot are written as
//! their number, as `\u{1b}`.

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

/// A text in characters that XML 1.0 can hold (production 2, `Char`); the others as their number.
fn writable(text: &str) -> String {
    let is_held = |c: char| match c {
        '\t' | '\n' => true,
        // A reader of XML makes a line break of it.
        '\r' => false,
        '\u{fffe}' | '\u{ffff}' => false,
        c => c >= ' ',
    };
    let mut written = String::with_capacity(text.len());
    for c in text.chars() {
        if is_held(c) {
            written.push(c);
        } else {
            written.extend(c.escape_unicode());
        }
    }
    written
}

fn case(writer: &mut Writer<Vec<u8>>, result: &Tried, strict: bool) -> io::Result<()> {
    let Tried { case, outcome } = result;
    let group = case.id.rsplit_once('.').map_or("", |(group, _)| group);
    let (group, name) = (
        writable(group),
        writable(&format!("{} {}", case.id, case.name)),
    );
    let seconds = format!("{:.3}", outcome.took.as_secs_f64());
    let element = writer.create_element("testcase").with_attributes([
        ("classname", &*group),
        ("name", &*name),
        ("time", &*seconds),
    ]);
    let trace = writable(&outcome.trace.join("\n"));
    let message = writable(&format!("{} {}", outcome.why, outcome.closing));
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

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use quick_xml::Reader;

    use super::*;
    use crate::case::Case;
    use crate::outcome::{CaseOutcome, Closing};

    #[test]
    fn a_report_is_xml_whatever_a_candidate_prints() {
        let wild: String = (0..0x250_u32)
            .chain([0xfffe, 0xffff, 0x1_f600])
            .filter_map(char::from_u32)
            .collect();
        let wild = format!("{wild}]]><!-- & <end/> \u{1b}[31m");
        let report = Report {
            subject: wild.clone(),
            config: None,
            strict: false,
            results: vec![Tried {
                case: Case::decoder(&format!("L0.{wild}.1"), &wild),
                outcome: CaseOutcome {
                    verdict: Verdict::Fail,
                    why: wild.clone(),
                    closing: Closing::NotJudged,
                    took: Duration::ZERO,
                    trace: vec![wild],
                },
            }],
            pairs: Vec::new(),
            coverage: Vec::new(),
        };
        let xml = junit(&report).expect("writing to memory succeeds");
        let is_held =
            |c: char| matches!(c, '\t' | '\n') || c >= ' ' && !matches!(c, '\u{fffe}' | '\u{ffff}');
        assert!(xml.chars().all(is_held), "{xml:?}");
        assert!(!xml.contains("]]>"), "{xml}");
        let mut reader = Reader::from_str(&xml);
        let mut elements = 0;
        loop {
            match reader.read_event().expect("it is XML") {
                Event::Eof => break,
                Event::Start(_) | Event::Empty(_) => elements += 1,
                _ => {}
            }
        }
        assert_eq!(elements, 3, "{xml}");
        assert!(xml.contains("\\u{1b}[31m"), "{xml}");
    }
}
