//! Sentences of the page: runs, modes and limitations.
//!
//! Every number comes from the summary; a limitation that an experiment does not show is left out.

use std::fmt::Write as _;

use super::plot::plain;
use crate::record::{Experiment, Mode, RunConfig};
use crate::summary::{RunFigures, Summary, number};

/// Escapes text for HTML.
pub fn escape(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => safe.push_str("&amp;"),
            '<' => safe.push_str("&lt;"),
            '>' => safe.push_str("&gt;"),
            '"' => safe.push_str("&quot;"),
            other => safe.push(other),
        }
    }
    safe
}

/// A paragraph about what was run.
pub(super) fn what_was_run(experiment: &Experiment) -> String {
    let config: Vec<_> = experiment
        .loads
        .iter()
        .flat_map(|load| &load.runs)
        .map(|run| &run.config)
        .collect();
    let Some(first) = config.first() else {
        return "Nothing was run.".to_owned();
    };
    let mut loads: Vec<_> = config
        .iter()
        .map(|config| config.bodies.to_string())
        .collect();
    loads.dedup();
    let link = config
        .iter()
        .find(|config| config.mode != Mode::Integrated)
        .map(|config| &config.link);
    if config.iter().all(|config| config.replayed.is_some()) {
        return escape(&what_was_replayed(first, config.len(), experiment.seed));
    }
    let tolerance = config.iter().find_map(|config| config.tolerance_m);
    let mut text = format!(
        "The physics scene {} was stepped {} times ({} simulated seconds, {} steps per second), with {} bodies. A \
         simulator in another process keeps a copy of all of them. This page shows the cost of the copy and its \
         errors.",
        first.scene,
        first.ticks,
        plain(f64::from(first.ticks) * first.step_s),
        plain(1.0 / first.step_s),
        enumeration(&loads),
    );
    if let Some(tolerance_m) = tolerance {
        let millimetres = plain(tolerance_m * 1e3);
        let _ = write!(
            text,
            " Rhumb's tolerance for any point of any body was {millimetres} mm."
        );
    }
    if let Some(link) = link.filter(|link| !link.is_empty()) {
        let _ = write!(text, " The link between the programs: {link}.");
    }
    if experiment.loads.iter().any(|load| load.runs.len() > 1) {
        text.push_str(
            " The same script with the same seed ran in every mode, in turn, tick by tick, so machine noise \
             affected all modes alike.",
        );
    }
    let _ = write!(text, " The seed was {}.", experiment.seed);
    escape(&text)
}

/// The recording and the number of its replays.
fn what_was_replayed(first: &RunConfig, runs: usize, seed: u64) -> String {
    let times = match runs {
        1 => "once".to_owned(),
        _ => format!("{runs} times, once for each row"),
    };
    format!(
        "The recording {} of {} bodies and {} simulated seconds ({} steps per second) was replayed {times}, over a \
         link in simulated time. This page shows the cost of each copy and its errors. One seed gives one result, \
         bit exact; the seed was {seed}.",
        first.scene,
        first.bodies,
        plain(f64::from(first.ticks) * first.step_s),
        plain((1.0 / first.step_s * 1e3).round() / 1e3),
    )
}

/// Joins items: `a`, `a and b`, `a, b and c`.
fn enumeration(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// Description of a mode.
pub(super) const fn mode(mode: Mode) -> &'static str {
    match mode {
        Mode::Integrated => {
            "the engine runs in the simulator's own process. No network: the baseline of frame times."
        }
        Mode::Naive => {
            "the engine runs in another process and sends every body's full state each tick, 56 bytes per body."
        }
        Mode::Rhumb => {
            "the engine runs in another process and sends only updates that the copy cannot predict; the simulator \
             waits for each tick."
        }
        Mode::RhumbPipelined => {
            "like rhumb, but the simulator continues while the engine steps, and receives each tick one tick later."
        }
        Mode::NaiveFree => "the free-running server sends every body's full state each tick.",
        Mode::RhumbFree => {
            "like rhumb, but the engine runs by its own clock in real time; the simulator never waits."
        }
        Mode::AppAll => {
            "the engine runs in another process and uses the paper's protocol: every body's state each tick, one datagram each."
        }
        Mode::AppActive => {
            "the paper's protocol for awake bodies only: their states each tick, one datagram each."
        }
        Mode::AppPacked => {
            "the paper's protocol with as many states per datagram as fit: the effect of packing alone."
        }
        Mode::Replay => {
            "a recorded scene is replayed over a simulated link in simulated time; each tick is compared when the \
             stream's watermark reaches it, and bytes are counted as they are sent."
        }
    }
}

/// Limitations of Rhumb and of the figures: sentences, ready for HTML.
pub(super) fn limits(summary: &Summary) -> Vec<String> {
    let runs = &summary.runs;
    let largest = runs.iter().map(|run| run.bodies).max().unwrap_or(0);
    let find = |mode: Mode| {
        runs.iter()
            .find(|run| run.bodies == largest && run.mode == mode.name())
    };
    let mut sentences = Vec::new();
    let integrated = find(Mode::Integrated).and_then(|run| run.frame_ms);
    if let Some((base, own)) = integrated.zip(find(Mode::Rhumb).and_then(|run| run.frame_ms)) {
        sentences.push(format!(
            "In lockstep the simulator waits for the engine and the round trip: at {largest} bodies a frame took {} ms, \
             in process {} ms, {} times as long. A real link adds its round trip to every frame.",
            number(Some(own.p50)),
            number(Some(base.p50)),
            number(Some(own.p50 / base.p50)),
        ));
    }
    if find(Mode::RhumbPipelined).is_some() {
        sentences.push(
            "A pipelined frame is short because the simulator has other work while the server steps: here, stepping \
             the other modes. A simulator without other work waits for the engine as well, and its commands take \
             effect a tick later."
                .to_owned(),
        );
    }
    sentences.extend(
        find(Mode::Rhumb)
            .or(find(Mode::RhumbFree))
            .map(of_bandwidth),
    );
    let faults: u64 = runs
        .iter()
        .filter_map(|run| run.over_tolerance.as_ref()?.by_cause.get("fault"))
        .sum();
    if faults > 0 {
        sentences.push(format!(
            "<span class=\"warn\">{faults} body-ticks were over tolerance without an explanation: a defect.</span>"
        ));
    }
    if summary.is_of_replays() {
        sentences.extend(limits_of_replays(runs));
        return sentences;
    }
    sentences.extend(of_limit(runs));
    sentences.push(
        "Times come from one run on one shared machine: compare them with each other, not with those of another \
         machine. Bytes, updates and errors of the modes that wait are repeatable; times are not."
            .to_owned(),
    );
    sentences.push(
        "Errors are measured at whole ticks against the engine at the same tick. They exclude smoothing between \
         ticks, as a display does it."
            .to_owned(),
    );
    sentences
}

/// Limitations of replays.
fn limits_of_replays(runs: &[RunFigures]) -> Vec<String> {
    let mut sentences = Vec::new();
    let counts_plain_codes = |run: &RunFigures| {
        let replayed = run.replayed.as_ref();
        replayed.is_some_and(|of| of.without.iter().any(|name| name == "coder"))
    };
    if runs.iter().any(counts_plain_codes) {
        sentences.push(
            "The coder is part of the wire format; without it, plain codes are counted instead (forms in five bits, \
             numbers in Exp-Golomb codes)."
                .to_owned(),
        );
    }
    sentences.extend(of_limit(runs));
    sentences.push(
        "Bytes are counted as the publisher sends them, with 22 of QUIC and 28 of headers for each datagram. They \
         exclude acknowledgements, heartbeats and the initial state."
            .to_owned(),
    );
    sentences
}

/// Definition of the limit, if runs are compared to one.
fn of_limit(runs: &[RunFigures]) -> Option<String> {
    let beside = runs.iter().any(|run| run.of_limit.is_some());
    beside.then(|| {
        "The limit assumes a known future: each body's path is cut into the longest verified segments by any \
         predictor, coded by an ideal adaptive coder. Better fits may exist, so the true minimum is lower. A real \
         publisher has more to do: it sends packets and exact rest poses, and does not know the future. On the grid \
         means that motions are rounded to the protocol's grid and verified as rounded."
            .to_owned()
    })
}

/// A run's worst second, headers and joining, which its mean bandwidth hides.
fn of_bandwidth(run: &RunFigures) -> String {
    let mut text = format!(
        "The mean hides bursts: the worst second of {} with {} bodies took {} kbit/s, the mean was {}.",
        run.mode,
        run.bodies,
        number(run.worst_second_kbps_down),
        number(run.mean_kbps_down),
    );
    if let Some((payload, wire)) = run
        .payload_bytes_down
        .zip(run.bytes_down)
        .filter(|(_, wire)| *wire > 0)
    {
        let share = 100.0 * (1.0 - payload as f64 / wire as f64);
        let _ = write!(
            text,
            " {} % of the counted bytes belong to QUIC, UDP and IP.",
            number(Some(share))
        );
    }
    if let Some(join) = run.join {
        let kilobytes = number(Some(join.bytes_down as f64 / 1e3));
        let _ = write!(
            text,
            " Joining took {kilobytes} kB once, which is not included."
        );
    }
    text
}
