//! What the page says in words: runs, modes, and where the limits lie.
//!
//! Every number comes from the summary; a limit that an experiment does not show is not mentioned.

use std::fmt::Write as _;

use super::plot::plain;
use crate::record::{Experiment, Mode, RunConfig};
use crate::summary::{RunFigures, Summary, number};

/// Text made safe to stand in HTML.
pub(crate) fn escape(text: &str) -> String {
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

/// What was run, in a paragraph.
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
        "A physics scene, {}, was stepped {} times ({} simulated seconds, {} steps a second), with {} bodies. A \
         simulator that is another program keeps a copy of all of them; this page says what the copy costs and how \
         true it is.",
        first.scene,
        first.ticks,
        plain(f64::from(first.ticks) * first.step_s),
        plain(1.0 / first.step_s),
        spoken(&loads),
    );
    if let Some(tolerance_m) = tolerance {
        let millimetres = plain(tolerance_m * 1e3);
        let _ = write!(
            text,
            " Rhumb promised that no point of any body is ever farther off than {millimetres} mm."
        );
    }
    if let Some(link) = link.filter(|link| !link.is_empty()) {
        let _ = write!(text, " The link between the programs: {link}.");
    }
    if experiment.loads.iter().any(|load| load.runs.len() > 1) {
        text.push_str(
            " The same script with the same seed ran in every mode, in turn, tick by tick, so that the machine's noise \
             fell on all alike.",
        );
    }
    let _ = write!(text, " The seed was {}.", experiment.seed);
    escape(&text)
}

/// The recording, and how often it was replayed.
fn what_was_replayed(first: &RunConfig, runs: usize, seed: u64) -> String {
    let times = match runs {
        1 => "once".to_owned(),
        _ => format!("{runs} times, once for each row"),
    };
    format!(
        "A recording, {}, of {} bodies and {} simulated seconds ({} steps a second) was published and followed {times}, \
         over a link in simulated time. This page says what each copy cost and how true it was. One seed gives one \
         result, to the bit; it was {seed}.",
        first.scene,
        first.bodies,
        plain(f64::from(first.ticks) * first.step_s),
        plain((1.0 / first.step_s * 1e3).round() / 1e3),
    )
}

/// `a`, `a and b`, `a, b and c`.
fn spoken(items: &[String]) -> String {
    match items {
        [] => String::new(),
        [only] => only.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

/// What a mode is.
pub(super) const fn mode(mode: Mode) -> &'static str {
    match mode {
        Mode::Integrated => {
            "the engine runs in the simulator itself. No network; the frame time to beat."
        }
        Mode::Naive => {
            "the engine runs in another process and sends every body's full state each tick, 56 bytes a body."
        }
        Mode::Rhumb => {
            "the engine runs in another process and sends only what the copy could not have predicted_after; the simulator \
             waits for each tick."
        }
        Mode::RhumbPipelined => {
            "the engine runs in another process and sends as little; the simulator goes on while it steps, and sees \
             each tick one tick later."
        }
        Mode::NaiveFree => {
            "the same server that runs by its own clock sends every body's full state each tick."
        }
        Mode::RhumbFree => {
            "the engine runs in another process by its own clock, in real time, and sends as little; nobody waits."
        }
        Mode::AppAll => {
            "the engine runs in another process and speaks the paper's protocol: every body's state each tick, a datagram each."
        }
        Mode::AppActive => {
            "the paper's protocol, of bodies that are awake: their states each tick, a datagram each."
        }
        Mode::AppPacked => {
            "the paper's protocol with as many states in a datagram as fit: what packing alone would give it."
        }
        Mode::Replay => {
            "a recorded scene is published and followed over a simulated link in simulated time; each tick is judged when \
             the stream watermarks for it, and bytes are counted as they are sent."
        }
    }
}

/// Where Rhumb loses, and what these figures cannot say: sentences, ready for HTML.
pub(super) fn limits(summary: &Summary) -> Vec<String> {
    let runs = &summary.runs;
    let largest = runs.iter().map(|run| run.bodies).max().unwrap_or(0);
    let find = |mode: Mode| {
        runs.iter()
            .find(|run| run.bodies == largest && run.mode == mode.name())
    };
    let mut said = Vec::new();
    let integrated = find(Mode::Integrated).and_then(|run| run.frame_ms);
    if let Some((base, own)) = integrated.zip(find(Mode::Rhumb).and_then(|run| run.frame_ms)) {
        said.push(format!(
            "In lockstep the simulator waits for the engine and for the way there and back: at {largest} bodies a frame \
             took {} ms, in process {} ms, {} times as long. A real link adds its round trip to every frame.",
            number(Some(own.p50)),
            number(Some(base.p50)),
            number(Some(own.p50 / base.p50)),
        ));
    }
    if find(Mode::RhumbPipelined).is_some() {
        said.push(
            "Pipelined, a frame is short because the simulator had other work while the server stepped: here, stepping \
             the other modes. One that has nothing else to do waits for the engine all the same, and what it commands \
             shows a tick later."
                .to_owned(),
        );
    }
    said.extend(
        find(Mode::Rhumb)
            .or(find(Mode::RhumbFree))
            .map(of_bandwidth),
    );
    let faults: u64 = runs
        .iter()
        .filter_map(|run| run.over_tolerance.as_ref()?.by_cause.get("fault"))
        .sum();
    if faults > 0 {
        said.push(format!(
            "<span class=\"warn\">{faults} body-ticks were over tolerance without anything to explain it: a defect.</span>"
        ));
    }
    if summary.is_of_replays() {
        said.extend(limits_of_replays(runs));
        return said;
    }
    said.extend(of_limit(runs));
    said.push(
        "Times are of one run on one machine that other programs share: compare them with each other, not with those of \
         another machine. Bytes, updates and errors of the modes that wait are repeatable; times are not."
            .to_owned(),
    );
    said.push(
        "Errors are measured at whole ticks against the engine at the very same tick. Smoothing between ticks, as a \
         display does it, is not in them."
            .to_owned(),
    );
    said
}

/// What replays cannot say.
fn limits_of_replays(runs: &[RunFigures]) -> Vec<String> {
    let mut said = Vec::new();
    if runs.iter().any(|run| run.of_all_on.is_some()) {
        said.push(
            "Each row switches off what it names and nothing else. Grids follow from tolerances, and what sleeps is \
             told at rest, in every row. The coder is the wire's own: what its numbers would take in plain codes (forms in \
             five bits, numbers in Exp-Golomb codes) is counted. Means that serve each other hide each other: what two of \
             them are worth together may be more than the sum of their rows."
                .to_owned(),
        );
    }
    said.extend(of_limit(runs));
    said.push(
        "Bytes are counted as the publisher sends them, with 22 of QUIC and 28 of headers for each datagram; \
         acknowledgements, heartbeats and the first state are not in them."
            .to_owned(),
    );
    said
}

/// What the limit is that runs are set beside, if they are.
fn of_limit(runs: &[RunFigures]) -> Option<String> {
    let beside = runs.iter().any(|run| run.of_limit.is_some());
    beside.then(|| {
        "The limit is what was found with the future known: each body's way cut into the longest segments by any of the \
         predictors, each verified, and coded by an ideal coder that learns as it goes. Better fits may be found, so that the \
         true least is lower still; and a publisher has more to do: it says packets and exact rests, and does not know the \
         future. On the grid means that motions were rounded as the protocol says them, and judged as rounded."
            .to_owned()
    })
}

/// What the mean bandwidth of a run hides.
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
            " {} % of the bytes are not ours but those of QUIC, UDP and IP; they are counted.",
            number(Some(share))
        );
    }
    if let Some(join) = run.join {
        let kilobytes = number(Some(join.bytes_down as f64 / 1e3));
        let _ = write!(
            text,
            " Coming in cost {kilobytes} kB once, which is counted apart."
        );
    }
    text
}
