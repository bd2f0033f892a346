//! Writes the records of one scene to a file or to viewers, as messages of a trace.

use std::collections::BTreeSet;

use rhumb_protocol::stream::Observation;
use rhumb_reckoning::BodyId;
use rhumb_trace::{ASLEEP, AWAKE, SceneTopics, StateForm, States, TraceSink};

use super::mirror::{MirrorChanges, SceneMirror};
use super::tap::TickRecord;

/// Drawings in a simulated second.
const DRAWINGS_PER_SECOND: u64 = 30;
/// Simulated time that a body lies still before it is drawn as resting, nanoseconds.
const REST_DELAY_NS: u64 = 500_000_000;

/// One scene, written record by record.
#[derive(Debug)]
pub(super) struct SceneWriter {
    prefix: String,
    step_ns: u64,
    mirror: SceneMirror,
    topics: SceneTopics,
    /// True if the sink has nothing of the scene yet.
    begins: bool,
    statics_due: bool,
    drawn: Option<u64>,
}

impl SceneWriter {
    /// A scene of which nothing is written yet.
    pub(super) fn new(record: &TickRecord) -> Self {
        let prefix = format!("/{}", record.scene);
        let step_ns = record.step_ns.max(1);
        Self {
            topics: SceneTopics::new(&prefix, REST_DELAY_NS / step_ns),
            prefix,
            step_ns,
            mirror: SceneMirror::default(),
            begins: true,
            statics_due: true,
            drawn: None,
        }
    }

    /// The beginning of the names of its topics.
    #[cfg(feature = "foxglove")]
    pub(super) fn prefix(&self) -> &str {
        &self.prefix
    }

    /// The simulated time of a step, nanoseconds.
    pub(super) const fn step_ns(&self) -> u64 {
        self.step_ns
    }

    /// Has the next record written whole, to another sink.
    pub(super) fn begin(&mut self) {
        self.topics = SceneTopics::new(&self.prefix, REST_DELAY_NS / self.step_ns);
        self.begin_for_viewer();
    }

    /// Has the next record written whole, to the same sink.
    pub(super) fn begin_for_viewer(&mut self) {
        self.begins = true;
        self.statics_due = true;
        self.drawn = None;
        self.topics.redraw();
    }

    /// Takes a record without writing it.
    pub(super) fn skip(&mut self, record: &TickRecord) {
        self.mirror.apply(record);
        self.begins = true;
    }

    /// Takes a record, and writes it.
    pub(super) fn write<S: TraceSink>(
        &mut self,
        sink: &mut S,
        record: &TickRecord,
    ) -> Result<(), S::Error> {
        let changes = self.mirror.apply(record);
        self.put(sink, &record.observed, &changes)
    }

    /// Writes the newest tick once more, whole.
    #[cfg(feature = "foxglove")]
    pub(super) fn write_whole<S: TraceSink>(&mut self, sink: &mut S) -> Result<(), S::Error> {
        self.begin_for_viewer();
        self.put(sink, &[], &MirrorChanges::default())
    }

    fn put<S: TraceSink>(
        &mut self,
        sink: &mut S,
        observed: &[Observation],
        changes: &MirrorChanges,
    ) -> Result<(), S::Error> {
        let tick = self.mirror.tick();
        let at_ns = tick.value().saturating_mul(self.step_ns);
        let placed = if std::mem::take(&mut self.begins) {
            self.mirror.all_placed()
        } else {
            let ids = changes.placed.iter();
            ids.filter_map(|id| self.mirror.placed(*id)).collect()
        };
        // The placement of a body has its state after this tick.
        let new: BTreeSet<BodyId> = placed.iter().map(|placed| placed.desc.id).collect();
        let others = observed.iter().filter(|o| !new.contains(&o.id));
        let observed: Vec<_> = others.copied().collect();
        let after = (placed.as_slice(), changes.removed.as_slice());
        let states = States::of(tick, &observed, after, &mut StateForm::Exact);
        self.topics.put_states(sink, at_ns, &states)?;
        self.statics_due |= changes.statics;
        let stride = (1_000_000_000 / DRAWINGS_PER_SECOND / self.step_ns).max(1);
        let number = tick.value() / stride;
        if self.drawn == Some(number) {
            return Ok(());
        }
        self.drawn = Some(number);
        if std::mem::take(&mut self.statics_due) {
            self.topics
                .draw_statics(sink, at_ns, self.mirror.drawn(true))?;
        }
        let painted: Vec<_> = (self.mirror.drawn(false))
            .map(|body| (body, if body.still { ASLEEP } else { AWAKE }))
            .collect();
        self.topics.draw(sink, (tick.value(), at_ns), &painted)
    }
}
