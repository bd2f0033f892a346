//! `rhumb-bench replay` holds the tolerance on generated recordings.
//!
//! The recording shows boxes that bounce lower and lower and then fall asleep, in the format of a foreign engine.

use std::num::NonZeroU32;

use rhumb_bench::record::{Cause, Experiment, Load, Run};
use rhumb_bench::recording::{self, ReadOptions, Recording, RecordingError, rhtrace};
use rhumb_bench::replay::{EnabledFeatures, Feature, ReplayConfig, ReplayError, run};
use rhumb_bench::summary::{RunFigures, Summary};
use rhumb_bench::trace::{TraceOptions, write};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{Metres, Tick, Ticks, Tolerance};

use crate::bounce::{self, FRAMES, packed, unpacked};

fn recording() -> Recording {
    rhtrace::read("bounce", &packed()).expect("the recording is valid")
}

fn replayed(recording: &Recording, link: &str, publish_interval: u32) -> Run {
    within(recording, link, publish_interval, None)
}

fn within(recording: &Recording, link: &str, publish_interval: u32, budget: Option<Budget>) -> Run {
    let config = ReplayConfig {
        budget,
        ..config(link, publish_interval)
    };
    run(recording, &config, &mut |_| {}).expect("the replay succeeds")
}

fn config(link: &str, publish_interval: u32) -> ReplayConfig {
    ReplayConfig {
        tolerance: Tolerance::from_metres(Metres::new(0.02)).expect("within bounds"),
        link: link.parse().expect("the link is valid"),
        publish_interval: NonZeroU32::new(publish_interval).expect("not zero"),
        seed: 3,
        lookahead: Ticks::ZERO,
        budget: None,
        largest_packet: LargestPacket::DEFAULT,
        features: EnabledFeatures::ALL,
    }
}

fn experiment(recording: &Recording, run: Run) -> Experiment {
    Experiment {
        command: String::new(),
        seed: 3,
        machine: String::new(),
        loads: vec![Load {
            truth: recording.truth.clone(),
            facts: recording.facts(),
            runs: vec![run],
            unfinished: Vec::new(),
        }],
    }
}

fn figures(recording: &Recording, run: &Run) -> RunFigures {
    let summary = Summary::of(&experiment(recording, run.clone()));
    summary.runs.into_iter().next().expect("there is one run")
}

#[test]
fn without_loss_every_published_tick_is_within_the_tolerance() {
    let recording = recording();
    for (link, publish_interval) in [
        ("", 1),
        ("rtt=300ms", 1),
        ("rtt=50ms,jitter=30ms", 1),
        ("", 3),
    ] {
        let run = replayed(&recording, link, publish_interval);
        assert_eq!(run.breaches, [], "{link} every {publish_interval}");
        assert_eq!(
            run.frames.len() as u32,
            (FRAMES - 1) / publish_interval,
            "{link}"
        );
        let figures = figures(&recording, &run);
        let moving = figures.moving.expect("boxes move");
        assert!(moving.surface_error_m.max > 0.0 && moving.surface_error_m.max <= 0.02);
        assert_eq!(figures.recovery, None);
    }
}

#[test]
fn a_body_without_further_records_rests_whatever_its_flag() {
    let mut bytes = unpacked();
    // A header of 32 bytes and the boxes; then for each frame a count, and records that end with a flag.
    let record = 2 + 13 * 4 + 1;
    let frames = 32 + bounce::BODIES as usize * 16;
    let frame = 2 + bounce::BODIES as usize * record;
    let last = frames + (FRAMES as usize - 20) * frame;
    for body in 1..=bounce::BODIES as usize {
        let flag = &mut bytes[last + 2 + body * record - 1];
        assert_eq!(std::mem::replace(flag, 1), 0, "the body is asleep");
    }
    let packed = zstd::encode_all(&*bytes, 1).expect("writing to memory succeeds");
    let recording = rhtrace::read("awake", &packed).expect("the recording is valid");
    let run = replayed(&recording, "", 1);
    assert_eq!(run.breaches, []);
}

#[test]
fn with_lookahead_every_published_tick_is_within_the_tolerance_for_fewer_bytes() {
    let recording = recording();
    let replayed = |publish_interval, lookahead, features| {
        let config = ReplayConfig {
            lookahead: Ticks::new(lookahead),
            features,
            ..config("", publish_interval)
        };
        let run = run(&recording, &config, &mut |_| {}).expect("the replay succeeds");
        assert_eq!(
            run.breaches,
            [],
            "every {publish_interval}, {lookahead} ticks later"
        );
        let bytes = run.captured.iter().map(|captured| captured.bytes.len());
        bytes.sum::<usize>()
    };
    for publish_interval in [1, 2] {
        let at_once = replayed(publish_interval, 0, EnabledFeatures::ALL);
        for lookahead in 1..=6 {
            let later = replayed(publish_interval, lookahead, EnabledFeatures::ALL);
            // These boxes fly: three ticks or fewer cannot tell ballistic motion from constant acceleration.
            let limit = if lookahead < 4 {
                at_once * 11 / 10
            } else {
                at_once
            };
            assert!(
                later < limit,
                "{later} of {at_once}, {lookahead} ticks later"
            );
        }
    }
    let blind = Feature::all_but(&[Feature::ModeDecision]);
    let [chosen, guessed] = [EnabledFeatures::ALL, blind].map(|features| replayed(1, 6, features));
    assert!(chosen < guessed, "{chosen} of {guessed}");
}

#[test]
fn a_budget_holds_and_over_budget_bodies_are_reported() {
    let recording = recording();
    let seconds = f64::from(recording.ticks()) * recording.integrator.rate.step().seconds();
    let free = replayed(&recording, "", 1);
    let payload = |run: &Run| {
        figures(&recording, run)
            .payload_bytes_down
            .unwrap_or_default()
    };
    for link in ["", "rtt=100ms"] {
        let budget = Budget::new(400, 1_150);
        let run = within(&recording, link, 1, budget);
        assert!(!run.breaches.is_empty(), "{link}: the budget is tight");
        let by_choice = run
            .breaches
            .iter()
            .all(|breach| breach.cause == Cause::Budget);
        assert!(by_choice, "{link}");
        // A burst, the earned bytes, one excess update, and the rare watermarks.
        let limit = 1_150.0 + 400.0 * seconds + 64.0 + 40.0 * 12.0;
        assert!(
            (payload(&run) as f64) < limit,
            "{link}: {} of {limit}",
            payload(&run)
        );
        assert!(payload(&run) < payload(&free), "{link}");
    }
}

/// Bytes of two watermarks with headers: a frame may close before or after those that cover its silence.
const TWO_WATERMARKS: u64 = 128;

#[test]
fn traffic_does_not_rise_with_latency() {
    let recording = recording();
    for budget in [None, Budget::new(400, 1_150), Budget::per_second(100_000)] {
        let bytes = |link: &str| {
            let run = within(&recording, link, 1, budget);
            let figures = figures(&recording, &run);
            // Requests for the last watermarks continue until the copy is complete, which takes one link delay longer.
            let last = run.frames.len() - 1;
            let sent = run.frames[..last]
                .iter()
                .map(|frame| frame.wire_bytes_down)
                .sum::<u64>();
            (sent, figures.updates)
        };
        let near = bytes("");
        for far in ["rtt=50ms", "rtt=300ms", "rtt=300ms,jitter=40ms"] {
            let far = bytes(far);
            assert!(
                far.0 <= near.0 + TWO_WATERMARKS && far.1 == near.1,
                "{budget:?}: {far:?} of {near:?}"
            );
        }
    }
}

#[test]
fn errors_under_loss_are_caused_by_loss_and_recovered() {
    let recording = recording();
    let run = replayed(&recording, "rtt=100ms,loss=10%", 1);
    assert!(
        run.breaches
            .iter()
            .all(|breach| breach.cause == Cause::Loss)
    );
    let recovery = figures(&recording, &run)
        .recovery
        .expect("packets are lost");
    // A refresh arrives only after its request.
    assert!(recovery.losses > 0 && recovery.p50_ms > 0.0);
}

#[test]
fn one_seed_gives_one_replay() {
    let recording = recording();
    let bytes = |run: Run| -> Vec<_> { run.captured.into_iter().map(|p| p.bytes).collect() };
    let link = "rtt=80ms,loss=5%,jitter=9ms";
    let once = bytes(replayed(&recording, link, 1));
    assert_eq!(once, bytes(replayed(&recording, link, 1)));
}

#[test]
fn a_replay_without_any_update_is_refused() {
    let recording = recording();
    let refused = run(&recording, &config("", recording.ticks() + 1), &mut |_| {});
    let last = Tick::new(u64::from(recording.ticks()));
    assert_eq!(refused.err(), Some(ReplayError::IntervalTooLong(last)));
}

#[test]
fn the_trace_of_a_replay_is_a_recording_of_the_same_motion() {
    let recording = recording();
    let run = replayed(&recording, "", 1);
    let path = std::path::Path::new(env!("CARGO_TARGET_TMPDIR")).join("replay.mcap");
    let options = TraceOptions::default();
    write(&path, &experiment(&recording, run), &options, &mut |_| {})
        .expect("the trace is written");
    let again = recording::read(&path, &ReadOptions::default()).expect("it states its engine");
    assert_eq!((&*again.name, again.played), ("bounce", None));
    assert_eq!(again.truth.digest, recording.truth.digest);
    assert_eq!(again.facts(), recording.facts());
}

#[test]
fn bytes_that_are_no_recording_are_refused() {
    let whole = unpacked();
    let read = |bytes: &[u8]| {
        let packed = zstd::encode_all(bytes, 1).expect("writing to memory succeeds");
        rhtrace::read("bounce", &packed)
    };
    for length in [0, 7, 8, 31, 40, whole.len() - 1] {
        let refused = read(&whole[..length]);
        assert!(
            matches!(refused, Err(RecordingError::Short { .. })),
            "{length}"
        );
    }
    let last = read(&whole[..whole.len() - 1]).expect_err("it is cut");
    assert_eq!(
        last.to_string(),
        format!("the recording ends within frame {}", FRAMES - 1)
    );
    let mut longer = whole.clone();
    longer.push(0);
    assert!(matches!(
        read(&longer),
        Err(RecordingError::Long { bytes: 1 })
    ));
    let mut other = whole.clone();
    other[0] = b'X';
    assert!(matches!(read(&other), Err(RecordingError::NotARecording)));
    let mut endless = whole.clone();
    endless[12..16].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(
        read(&endless),
        Err(RecordingError::Frames { frames: u32::MAX })
    ));
    let mut still = whole;
    still[16..20].copy_from_slice(&0.0_f32.to_le_bytes());
    assert!(matches!(read(&still), Err(RecordingError::Step { .. })));
    assert!(matches!(
        rhtrace::read("x", b"no zstd"),
        Err(RecordingError::Unpack(_))
    ));
}
