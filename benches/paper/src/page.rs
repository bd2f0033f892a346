//! A page of HTML that stands alone, and a figure in it.

use std::fmt::Write as _;

use super::figures::PaperFigure;
use rhumb_bench::report::{STYLE, escape};

/// A self-contained page.
pub(crate) fn page(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<h1>{title}</h1>\n{body}</body>\n</html>\n"
    )
}

/// A figure with its legend.
pub(crate) fn figure_html(figure: &PaperFigure) -> String {
    let mut text = format!("<h3>{}</h3>\n<div class=\"legend\">", escape(figure.title));
    for (color, label) in &figure.keys {
        let hue = format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2);
        let _ = write!(
            text,
            "<span class=\"key\" style=\"--own: {hue}\">{}</span>",
            escape(label)
        );
    }
    let svg = figure.svg.replacen("<svg ", "<svg role=\"img\" ", 1);
    let _ = writeln!(
        text,
        "</div>\n<figure aria-label=\"{}\">{svg}</figure>",
        escape(figure.title)
    );
    text
}
