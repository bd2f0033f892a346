//! Time spent per scene, stage by stage.

use rhumb_protocol::Instant;
use rhumb_protocol::message::StageTimes;

/// Steps for the median and the 99th percentile.
const RECENT: usize = 4_096;

/// Time of the stages of all ticks so far.
#[derive(Debug, Default)]
pub(crate) struct Times {
    step_total: u64,
    observe_total: u64,
    publish_total: u64,
    /// Duration of the last steps in nanoseconds; a ring once it is full.
    recent: Vec<u64>,
    next: usize,
    /// Median and 99th percentile of the recent steps, until another step is added: a scene answers more often than
    /// it steps.
    percentiles: Option<(u64, u64)>,
}

/// The moments between the stages of one tick.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timestamps {
    pub(crate) begun: Instant,
    pub(crate) stepped: Instant,
    pub(crate) observed: Instant,
    pub(crate) published: Instant,
}

impl Times {
    pub(crate) fn add(&mut self, timestamps: Timestamps) {
        let step = timestamps.stepped.since(timestamps.begun).as_nanos();
        self.step_total += step;
        self.observe_total += timestamps.observed.since(timestamps.stepped).as_nanos();
        self.publish_total += timestamps.published.since(timestamps.observed).as_nanos();
        if self.recent.len() < RECENT {
            self.recent.push(step);
        } else {
            self.recent[self.next] = step;
        }
        self.next = (self.next + 1) % RECENT;
        self.percentiles = None;
    }

    /// Adds the time of a report to the scene's owner.
    pub(crate) fn add_reporting(&mut self, took: rhumb_protocol::Span) {
        self.publish_total += took.as_nanos();
    }

    pub(crate) fn summary(&mut self) -> StageTimes {
        let recent = &self.recent;
        let (step_median, step_p99) = *self.percentiles.get_or_insert_with(|| {
            let mut steps = recent.clone();
            steps.sort_unstable();
            let at = |share: usize| steps.get(steps.len() * share / 100).copied().unwrap_or(0);
            (at(50), at(99))
        });
        StageTimes {
            step_total: self.step_total,
            step_median,
            step_p99,
            observe_total: self.observe_total,
            publish_total: self.publish_total,
        }
    }
}
