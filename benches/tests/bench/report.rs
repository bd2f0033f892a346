//! The page holds every run, draws with valid SVG, and is self-contained.

use crate::support::experiment;
use rhumb_bench::report;
use rhumb_bench::summary::Summary;

fn page() -> String {
    let experiment = experiment();
    report::html(&experiment, &Summary::of(&experiment))
}

#[test]
fn every_run_has_its_row() {
    let page = page();
    for mode in ["integrated", "naive", "rhumb"] {
        let cell = format!(
            "<tr><td><span class=\"key\" style=\"--own: var(--{mode})\">{mode}</span></td>"
        );
        assert_eq!(page.matches(&cell).count(), 1, "{mode}");
    }
}

#[test]
fn the_first_figure_stands_above_the_table_and_names_its_curves() {
    let page = page();
    let (figure, table) = (page.find("<svg "), page.find("<table"));
    assert!(figure.is_some() && figure < table, "{figure:?} {table:?}");
    let first = page
        .split("<svg ")
        .nth(1)
        .unwrap()
        .split("</svg>")
        .next()
        .unwrap();
    for curve in ["naive", "rhumb"] {
        let label = first.lines().any(|line| line.trim() == curve);
        assert!(label, "{curve}");
    }
}

#[test]
fn the_page_is_self_contained() {
    let page = page();
    for foreign in ["<script", "<link", "<img", "@import", "url("] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    let addresses = page.matches("http").count();
    assert_eq!(
        addresses,
        page.matches("xmlns=\"http://www.w3.org/2000/svg\"").count()
    );
}

#[test]
fn the_command_line_is_escaped() {
    assert!(page().contains("--scene &lt;fall&gt;"));
}

#[test]
fn each_figure_is_closed_svg_of_finite_numbers() {
    let page = page();
    let figures: Vec<_> = page.split("<svg ").skip(1).collect();
    assert_eq!(figures.len(), 4);
    for figure in figures {
        let svg = figure.split("</svg>").next().unwrap();
        assert!(figure.contains("</svg>"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        assert_eq!(svg.matches("<text").count(), svg.matches("</text>").count());
        assert!(svg.contains("<polyline") || svg.contains("<circle"));
    }
}

#[test]
fn elements_are_closed_in_the_order_they_were_opened() {
    let page = page();
    let mut open: Vec<String> = Vec::new();
    for tag in page.split('<').skip(1) {
        let tag = tag.split('>').next().unwrap();
        let name: String = tag
            .chars()
            .take_while(|c| c.is_alphanumeric() || *c == '/')
            .collect();
        match name.strip_prefix('/') {
            Some(name) => assert_eq!(open.pop().as_deref(), Some(name)),
            None if tag.ends_with('/') || tag.starts_with('!') || name == "meta" => {}
            None => open.push(name),
        }
    }
    assert_eq!(open, [""; 0]);
}

#[test]
fn a_run_with_another_truth_is_marked_void() {
    let mut experiment = experiment();
    experiment.loads[0].runs[2].truth_checksum += 1;
    let page = report::html(&experiment, &Summary::of(&experiment));
    assert!(page.contains("are void") && page.contains("rhumb"));
}

#[test]
fn an_empty_experiment_gives_a_valid_page() {
    let mut experiment = experiment();
    experiment.loads.clear();
    let page = report::html(&experiment, &Summary::of(&experiment));
    assert!(page.ends_with("</html>\n"));
}
