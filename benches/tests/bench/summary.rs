//! Figures of a small experiment, computed by hand.

use crate::support::experiment;
use rhumb_bench::record::Mode;
use rhumb_bench::summary::{RunFigures, Summary};

fn figures(mode: Mode) -> RunFigures {
    let summary = Summary::of(&experiment());
    let mut runs = summary.runs.into_iter();
    runs.find(|run| run.mode == mode.name())
        .expect("the experiment has every mode")
}

fn close(value: Option<f64>, expected: f64) -> bool {
    value.is_some_and(|value| (value - expected).abs() <= expected.abs() * 1e-12)
}

#[test]
fn bytes_include_28_of_headers_for_each_datagram() {
    let rhumb = figures(Mode::Rhumb);
    assert_eq!(rhumb.bytes_down, Some(500 + 4 * 28));
    assert_eq!(rhumb.bytes_up, Some(4 * (40 + 28)));
    assert_eq!(rhumb.datagrams_down, Some(4));
    assert_eq!(rhumb.payload_bytes_down, Some(100 + 30 + 40 + 60));
}

#[test]
fn joining_is_counted_separately() {
    let join = figures(Mode::Rhumb).join.unwrap();
    assert_eq!((join.bytes_down, join.datagrams_down), (4_000 + 5 * 28, 5));
    assert_eq!((join.bytes_up, join.datagrams_up), (2_000 + 4 * 28, 4));
}

#[test]
fn rates_are_over_simulated_time() {
    let rhumb = figures(Mode::Rhumb);
    // 612 B in 0.4 s; the run is shorter than a second, so its worst second spans all of it.
    assert!(close(rhumb.mean_kbps_down, 12.24));
    assert!(close(rhumb.worst_second_kbps_down, 12.24));
    assert!(close(rhumb.payload_kbps_down, 4.6));
    assert!(close(rhumb.updates_per_second(), 12.5));
}

#[test]
fn the_worst_second_is_the_worst_window_of_a_second() {
    let mut experiment = experiment();
    let run = &mut experiment.loads[0].runs[1];
    let frame = run.frames[0].clone();
    run.config.ticks = 30;
    run.frames = (1..=30)
        .map(|tick| {
            let mut frame = frame.clone();
            frame.tick = rhumb_reckoning::Tick::new(tick);
            // A burst that spans two calendar seconds.
            frame.wire_bytes_down = if (8..=13).contains(&tick) { 972 } else { 0 };
            frame.wire_datagrams_down = frame.wire_bytes_down / 972;
            frame
        })
        .collect();
    let naive = &Summary::of(&experiment).runs[1];
    assert!(close(naive.worst_second_kbps_down, 6.0 * 8.0));
    assert!(close(naive.mean_kbps_down, 6.0 * 8.0 / 3.0));
}

#[test]
fn bits_per_update_count_state_datagrams_only() {
    let rhumb = figures(Mode::Rhumb);
    assert_eq!(rhumb.updates, Some(5));
    assert!(close(rhumb.bits_per_update, 8.0 * 200.0 / 5.0));
}

#[test]
fn errors_cover_all_body_ticks_including_exact_ones() {
    let errors = figures(Mode::Rhumb).surface_error_m.unwrap();
    // Ten body-ticks: seven exact, then 1/64, 1/32 and 1/16 m.
    assert_eq!(
        (errors.p50, errors.p95, errors.p99, errors.max),
        (0.0, 0.0625, 0.0625, 0.0625)
    );
    let naive = figures(Mode::Naive).surface_error_m.unwrap();
    assert_eq!((naive.p50, naive.max), (0.0, 0.0));
}

#[test]
fn breaches_are_counted_by_cause() {
    let over = figures(Mode::Rhumb).over_tolerance.unwrap();
    assert_eq!(over.count, 1);
    assert_eq!(over.share, 0.1);
    let causes: Vec<_> = over
        .by_cause
        .iter()
        .map(|(cause, count)| (cause.as_str(), *count))
        .collect();
    assert_eq!(
        causes,
        [("budget", 0), ("fault", 0), ("late", 0), ("loss", 1)]
    );
}

#[test]
fn times_are_in_milliseconds() {
    let rhumb = figures(Mode::Rhumb);
    let frame = rhumb.frame_ms.unwrap();
    assert_eq!((frame.p50, frame.p99, frame.mean), (2.0, 12.0, 5.0));
    assert_eq!((rhumb.step_ms.p50, rhumb.step_ms.p99), (1.0, 3.0));
    assert_eq!(rhumb.publish_share, Some(0.25));
}

#[test]
fn sim_fps_never_exceeds_the_papers_maximum() {
    assert_eq!(figures(Mode::Rhumb).sim_fps, Some(11.33));
    let mut slow = experiment();
    for frame in &mut slow.loads[0].runs[2].frames {
        frame.frame_ns = 200_000_000;
    }
    assert!(close(Summary::of(&slow).runs[2].sim_fps, 5.0));
}

#[test]
fn figures_without_meaning_are_null() {
    let summary = Summary::of(&experiment());
    let json: serde_json::Value = serde_json::from_str(&summary.to_json()).unwrap();
    let integrated = &json["runs"][0];
    for name in [
        "bytes_down",
        "bytes_up",
        "updates",
        "surface_error_m",
        "over_tolerance",
        "publish_share",
        "join",
        "link",
    ] {
        assert!(
            integrated.get(name).is_some_and(serde_json::Value::is_null),
            "{name}"
        );
    }
    assert_eq!(integrated["truth_hash"], "0123456789abcdef");
    assert_eq!(json["runs"][1]["tolerance_m"], serde_json::Value::Null);
    assert_eq!(json["runs"][2]["tolerance_m"], 0.05);
}

#[test]
fn the_json_reads_back_equal() {
    let summary = Summary::of(&experiment());
    let again: Summary = serde_json::from_str(&summary.to_json()).unwrap();
    assert_eq!(again, summary);
}

#[test]
fn the_table_has_an_aligned_line_for_each_run() {
    let summary = Summary::of(&experiment());
    let text = summary.table().to_string();
    let lines: Vec<_> = text.lines().collect();
    assert_eq!(lines.len(), 4);
    // Naive: 4,112 B in 0.4 s. Rhumb: 6.72 times less, twice the median frame of... the integrated one.
    assert!(lines[2].contains("82.2"), "{text}");
    assert!(lines[3].contains("6.72"), "{text}");
    let width = lines[0].chars().count();
    assert!(
        lines.iter().all(|line| line.chars().count() == width),
        "{text}"
    );
    assert_eq!(summary.table().to_markdown().lines().count(), 5);
}

#[test]
fn an_experiment_without_frames_has_no_figures_and_does_not_panic() {
    let mut experiment = experiment();
    for run in &mut experiment.loads[0].runs {
        run.frames.clear();
        run.captured.clear();
        run.breaches.clear();
        run.step_ns_total = 0;
    }
    let summary = Summary::of(&experiment);
    assert_eq!(summary.runs[2].surface_error_m, None);
    assert_eq!(summary.runs[2].frame_ms, None);
    assert_eq!(summary.runs[2].worst_second_kbps_down, None);
    assert!(summary.table().to_string().contains('–'));
}

#[test]
fn less_than_naive_covers_the_whole_run_and_the_first_seconds() {
    let mut experiment = experiment();
    // Ten seconds in steps of a tenth; the first five are busy.
    for run in &mut experiment.loads[0].runs[1..] {
        let frame = run.frames[0].clone();
        let busy = |number: u64| u64::from(number <= 50);
        let naive = run.config.mode == Mode::Naive;
        run.config.ticks = 100;
        run.frames = (1..=100)
            .map(|number| {
                let mut frame = frame.clone();
                frame.tick = rhumb_reckoning::Tick::new(number);
                frame.wire_datagrams_down = 1;
                frame.wire_bytes_down = if naive { 972 } else { 72 + 100 * busy(number) };
                frame
            })
            .collect();
    }
    let summary = Summary::of(&experiment);
    let rhumb = &summary.runs[2];
    let first = rhumb.first_seconds.unwrap();
    assert_eq!((first.seconds, first.bytes_down), (5.0, 50 * 200));
    let less = rhumb.less_than_naive.unwrap();
    assert!(close(Some(less.with_headers_first), 5.0));
    assert!(close(Some(less.with_headers), 100_000.0 / 15_000.0));
    // Four datagrams of 900 B against the copy's traffic, all of it in the first frames.
    assert!(close(Some(less.payload), 3_600.0 / 230.0));
    assert_eq!(less.payload, less.payload_first);
    assert_eq!(summary.runs[1].less_than_naive, None);
    assert!(summary.ratios().contains("first 5 s"));
    let page = rhumb_bench::report::html(&experiment, &summary);
    assert!(page.contains("Less than naive"));
}

#[test]
fn a_run_with_another_truth_is_void_in_summary_and_table() {
    let mut experiment = experiment();
    experiment.loads[0].runs[2].truth_checksum += 1;
    let summary = Summary::of(&experiment);
    let void: Vec<_> = summary.runs.iter().map(|run| run.void).collect();
    assert_eq!(void, [false, false, true]);
    assert!(summary.table().to_string().contains("rhumb (void)"));
}
