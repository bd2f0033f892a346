//! Draws a set of bodies on two topics, `moving` and `resting`.
//!
//! After a seek, a viewer shows only the last message of each topic. So each message is complete: every body is in
//! exactly one of the two last messages, in its current pose. A body moves to `resting` only after it lies still for a
//! while: a body that wakes often must not cause all resting bodies to be rewritten. When a resting body moves, both
//! are written.

use std::io::{Seek, Write};

use foxglove::messages::{Color, SceneEntity, SceneUpdate, Timestamp};
use mcap::McapError;

use super::bodies::Body;
use super::file::{Schema, Topic, TraceFile};
use super::primitives;

/// The two topics and the content of their last messages.
#[derive(Debug)]
pub(super) struct DrawnScene {
    moving: Topic,
    resting: Topic,
    /// Indexed by body index.
    rests: Vec<Option<RestingBody>>,
    at_rest: usize,
    written: Option<WrittenEntities>,
    rest_delay_ticks: u64,
}

/// A still body and the tick since which it is still.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RestingBody {
    generation: u16,
    position: [f32; 3],
    rotation: [f32; 4],
    since: u64,
    /// True if the last message of `resting` contains it.
    at_rest: bool,
}

#[derive(Clone, Copy, Debug)]
struct WrittenEntities {
    resting: u64,
    moving_was_empty: bool,
}

/// A body and its colour.
pub(super) type Painted<'a> = (&'a Body<'a>, Color);

impl DrawnScene {
    /// Topics `{prefix}/moving` and `{prefix}/resting`; a body moves to `resting` after `rest_delay_ticks` of
    /// stillness.
    pub(super) fn new(prefix: &str, rest_delay_ticks: u64) -> Self {
        Self {
            moving: Topic::new(format!("{prefix}/moving"), Schema::Scene),
            resting: Topic::new(format!("{prefix}/resting"), Schema::Scene),
            rests: Vec::new(),
            at_rest: 0,
            written: None,
            rest_delay_ticks,
        }
    }

    /// Writes the topics whose content changed.
    pub(super) fn draw<W: Write + Seek>(
        &mut self,
        file: &mut TraceFile<W>,
        (tick, at_ns): (u64, u64),
        bodies: &[Painted<'_>],
    ) -> Result<(), McapError> {
        let (mut kept, mut eligible) = (0, 0);
        for (body, _) in bodies {
            match self.update_rest(tick, body) {
                DrawState::Resting => kept += 1,
                DrawState::Waiting => eligible += 1,
                DrawState::Moving => {}
            }
        }
        let last = self.written.map(|written| written.resting);
        let waited = last.is_none_or(|last| last + self.rest_delay_ticks <= tick);
        let woke = kept < self.at_rest;
        if last.is_none() || woke || (waited && eligible > 0) {
            self.at_rest = kept + eligible;
            self.mark_resting(tick);
            let update = self.update("resting", at_ns, bodies, true);
            file.put(&mut self.resting, at_ns, &update)?;
            self.written = Some(WrittenEntities {
                resting: tick,
                moving_was_empty: self.written.is_some_and(|written| written.moving_was_empty),
            });
        }
        let empty = self.at_rest == bodies.len();
        if let Some(written) = &mut self.written
            && !(empty && written.moving_was_empty)
        {
            written.moving_was_empty = empty;
            let update = self.update("moving", at_ns, bodies, false);
            file.put(&mut self.moving, at_ns, &update)?;
        }
        Ok(())
    }

    /// Updates the stillness record of a body.
    fn update_rest(&mut self, tick: u64, body: &Body<'_>) -> DrawState {
        let index = body.id().index() as usize;
        if index >= self.rests.len() {
            self.rests.resize(index + 1, None);
        }
        let fresh = RestingBody {
            generation: body.id().generation(),
            position: body.position,
            rotation: body.rotation,
            since: tick,
            at_rest: false,
        };
        let slot = &mut self.rests[index];
        if !body.still {
            *slot = None;
            return DrawState::Moving;
        }
        let rest = slot.insert(match *slot {
            Some(rest)
                if rest
                    == (RestingBody {
                        since: rest.since,
                        at_rest: rest.at_rest,
                        ..fresh
                    }) =>
            {
                rest
            }
            _ => fresh,
        });
        if rest.at_rest {
            DrawState::Resting
        } else if rest.since + self.rest_delay_ticks <= tick {
            DrawState::Waiting
        } else {
            DrawState::Moving
        }
    }

    fn mark_resting(&mut self, tick: u64) {
        for rest in self.rests.iter_mut().flatten() {
            rest.at_rest |= rest.since + self.rest_delay_ticks <= tick;
        }
    }

    fn update(&self, id: &str, at_ns: u64, bodies: &[Painted<'_>], at_rest: bool) -> SceneUpdate {
        let mut entity = entity(id, at_ns);
        for (body, color) in bodies {
            let rest = self
                .rests
                .get(body.id().index() as usize)
                .copied()
                .flatten();
            if rest.is_some_and(|rest| rest.at_rest) == at_rest {
                primitives::add(
                    &mut entity,
                    &body.placed.shape,
                    body.position,
                    body.rotation,
                    *color,
                );
            }
        }
        SceneUpdate {
            deletions: Vec::new(),
            entities: vec![entity],
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DrawState {
    Moving,
    /// Still for long enough to move to `resting`.
    Waiting,
    Resting,
}

/// An empty entity; it replaces the entity of the same id.
pub(super) fn entity(id: &str, at_ns: u64) -> SceneEntity {
    let seconds = u32::try_from(at_ns / 1_000_000_000).unwrap_or(u32::MAX);
    SceneEntity {
        timestamp: Some(Timestamp::new(seconds, (at_ns % 1_000_000_000) as u32)),
        frame_id: primitives::FRAME.to_owned(),
        id: id.to_owned(),
        ..SceneEntity::default()
    }
}
