//! The truth of a load: the messages of its topic `truth/state`.
//!
//! A trace begins at tick 0, a recording of a server at any tick, which becomes tick 0 here. A recording may lack ticks:
//! the next message then has every body.

use std::collections::BTreeMap;

use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Tick};
use rhumb_trace::{FileContents, StatesReader, TickStates};

use super::activity::set_digest;
use super::error::RecordingError;
use crate::record::{Placed, Truth};

/// Ticks that a recording may lack at a time: an hour at 60 Hz.
const MISSING_MAX: u64 = 216_000;

/// A truth as it is read.
pub(super) struct ReadTruth {
    pub(super) truth: Truth,
    /// False if the poses have no velocities.
    pub(super) has_velocities: bool,
    pub(super) notes: Vec<String>,
}

/// The truth of a load, from the messages of its topic.
pub(super) fn read_truth(contents: &FileContents, load: &str) -> Result<ReadTruth, RecordingError> {
    let mut reader = StatesReader::default();
    let mut building = Building::default();
    for message in &contents.messages {
        let states = reader.read(&message.bytes);
        let states = states.map_err(|cause| RecordingError::Message {
            topic: contents.topic(message).to_owned(),
            log_ns: message.log_ns,
            cause,
        })?;
        let states = states.ok_or(RecordingError::Number {
            tick: building.last,
            index: 0,
        })?;
        building.add(states, load)?;
    }
    if building.truth.ticks.is_empty() {
        return Err(RecordingError::NoTruth);
    }
    set_digest(&mut building.truth);
    let missing = building.missing;
    Ok(ReadTruth {
        truth: building.truth,
        has_velocities: building.has_velocities,
        notes: (missing > 0)
            .then(|| format!("the recording lacks {missing} ticks: its bodies stand still in them"))
            .into_iter()
            .collect(),
    })
}

/// A truth while its messages come.
struct Building {
    truth: Truth,
    /// Bodies that are there: the places of their placements.
    there: BTreeMap<BodyId, usize>,
    first: Option<Tick>,
    last: Tick,
    missing: u64,
    has_velocities: bool,
}

impl Default for Building {
    fn default() -> Self {
        Self {
            truth: Truth::default(),
            there: BTreeMap::new(),
            first: None,
            last: Tick::ZERO,
            missing: 0,
            has_velocities: true,
        }
    }
}

impl Building {
    fn add(&mut self, states: TickStates, load: &str) -> Result<(), RecordingError> {
        let first = *self.first.get_or_insert(states.tick);
        let since = states
            .tick
            .since(first)
            .map(|ticks| u64::from(ticks.count()));
        let twice = || RecordingError::TickTwice {
            tick: states.tick,
            load: load.to_owned(),
        };
        // Log times grow with ticks, so a tick that does not follow is one of another run.
        let since = since.ok_or_else(twice)?;
        let is_first = since == 0 && self.truth.ticks.is_empty() && self.there.is_empty();
        let due = self.truth.ticks.len() as u64 + 1;
        if !is_first {
            if since < due {
                return Err(twice());
            }
            if since - due > MISSING_MAX {
                return Err(RecordingError::Record {
                    tick: states.tick,
                    index: 0,
                });
            }
            if since > due {
                self.missing += since - due;
                self.stand_still();
            }
            self.truth.ticks.resize(since as usize - 1, Vec::new());
        }
        self.last = states.tick;
        self.has_velocities &= states.is_exact || states.observed.is_empty();
        let tick = Tick::new(since);
        let mut row = states.observed;
        for id in states.removed.iter().map(|(_, id)| *id) {
            // A body that was placed and removed between two messages is unknown.
            if self.there.remove(&id).is_some() {
                self.truth.removed.push((tick, id));
            }
        }
        for placed in states.placed {
            self.place(Placed { tick, ..placed }, &mut row);
        }
        if is_first {
            return Ok(());
        }
        if let Some(unknown) = row.iter().find(|of| !self.is_known(of, tick)) {
            return Err(RecordingError::NotPlaced {
                tick: states.tick,
                index: unknown.id.index(),
            });
        }
        row.sort_by_key(|observation| observation.id.index());
        self.truth.ticks.push(row);
        Ok(())
    }

    /// Ticks are missing: what moved stands still until the next one.
    fn stand_still(&mut self) {
        let last = Tick::new(self.truth.ticks.len() as u64);
        let placed = self.truth.placed.iter_mut().rev();
        for placed in placed.take_while(|placed| placed.tick == last) {
            placed.observation.activity = Activity::Asleep;
        }
        for observation in self.truth.ticks.last_mut().into_iter().flatten() {
            observation.activity = Activity::Asleep;
        }
    }

    /// A body may be observed in the tick in which it is removed.
    fn is_known(&self, observation: &Observation, tick: Tick) -> bool {
        let removed = || (self.truth.removed.iter().rev()).take_while(|(when, _)| *when == tick);
        self.there.contains_key(&observation.id) || removed().any(|(_, id)| *id == observation.id)
    }

    /// Places a body; one that is there already moves to its new place, or is exchanged if it has changed.
    fn place(&mut self, placed: Placed, row: &mut Vec<Observation>) {
        let id = placed.desc.id;
        if let Some(known) = self.there.get(&id) {
            let known = &self.truth.placed[*known];
            let is_same = known.shape == placed.shape && known.desc == placed.desc;
            if is_same && known.inertia == placed.inertia {
                row.retain(|observation| observation.id != id);
                row.push(placed.observation);
                return;
            }
            row.retain(|observation| observation.id != id);
            self.truth.removed.push((placed.tick, id));
        }
        self.there.insert(id, self.truth.placed.len());
        self.truth.placed.push(placed);
    }
}
