//! A set of bodies as a person sees it: on two topics, `moving` and `resting`.
//!
//! After a seek a viewer shows the last message of each topic and nothing before it, so each message is whole: every
//! body is in exactly one of the two last messages, in its pose. A body is drawn on `resting` once it has lain still
//! for a while, so that one that flaps does not repeat all sleepers each time; when one of them stirs, both are written.

use std::io::{Seek, Write};

use foxglove::messages::{Color, SceneEntity, SceneUpdate, Timestamp};
use mcap::McapError;

use super::bodies::Body;
use super::file::{File, Schema, Topic};
use super::primitives;

/// A pair of topics and what their last messages show.
#[derive(Debug)]
pub(super) struct Scene {
    moving: Topic,
    resting: Topic,
    /// By index of the body.
    rests: Vec<Option<Rest>>,
    settled: usize,
    written: Option<Written>,
    patience_ticks: u64,
}

/// A body that lies still, and since when.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rest {
    generation: u16,
    position: [f32; 3],
    rotation: [f32; 4],
    since: u64,
    /// Whether the last message of `resting` shows it.
    settled: bool,
}

#[derive(Clone, Copy, Debug)]
struct Written {
    resting: u64,
    moving_was_empty: bool,
}

/// A body and the colour to draw it in.
pub(super) type Painted<'a> = (&'a Body<'a>, Color);

impl Scene {
    /// On `{prefix}/moving` and `{prefix}/resting`; a body settles after `patience_ticks`.
    pub(super) fn new(prefix: &str, patience_ticks: u64) -> Self {
        Self {
            moving: Topic::new(format!("{prefix}/moving"), Schema::Scene),
            resting: Topic::new(format!("{prefix}/resting"), Schema::Scene),
            rests: Vec::new(),
            settled: 0,
            written: None,
            patience_ticks,
        }
    }

    /// Writes what changed, if anything did.
    pub(super) fn draw<W: Write + Seek>(
        &mut self,
        file: &mut File<W>,
        (tick, at_ns): (u64, u64),
        bodies: &[Painted<'_>],
    ) -> Result<(), McapError> {
        let (mut kept, mut may_settle) = (0, 0);
        for (body, _) in bodies {
            match self.note(tick, body) {
                Standing::Settled => kept += 1,
                Standing::Patient => may_settle += 1,
                Standing::Stirring => {}
            }
        }
        let last = self.written.map(|written| written.resting);
        let waited = last.is_none_or(|last| last + self.patience_ticks <= tick);
        let stirred = kept < self.settled;
        if last.is_none() || stirred || (waited && may_settle > 0) {
            self.settled = kept + may_settle;
            self.settle(tick);
            let update = self.update("resting", at_ns, bodies, true);
            file.put(&mut self.resting, at_ns, &update)?;
            self.written = Some(Written {
                resting: tick,
                moving_was_empty: self.written.is_some_and(|written| written.moving_was_empty),
            });
        }
        let empty = self.settled == bodies.len();
        if let Some(written) = &mut self.written
            && !(empty && written.moving_was_empty)
        {
            written.moving_was_empty = empty;
            let update = self.update("moving", at_ns, bodies, false);
            file.put(&mut self.moving, at_ns, &update)?;
        }
        Ok(())
    }

    /// Keeps the account of who lies still.
    fn note(&mut self, tick: u64, body: &Body<'_>) -> Standing {
        let index = body.id().index() as usize;
        if index >= self.rests.len() {
            self.rests.resize(index + 1, None);
        }
        let fresh = Rest {
            generation: body.id().generation(),
            position: body.position,
            rotation: body.rotation,
            since: tick,
            settled: false,
        };
        let slot = &mut self.rests[index];
        if !body.still {
            *slot = None;
            return Standing::Stirring;
        }
        let rest = slot.insert(match *slot {
            Some(rest)
                if rest
                    == (Rest {
                        since: rest.since,
                        settled: rest.settled,
                        ..fresh
                    }) =>
            {
                rest
            }
            _ => fresh,
        });
        if rest.settled {
            Standing::Settled
        } else if rest.since + self.patience_ticks <= tick {
            Standing::Patient
        } else {
            Standing::Stirring
        }
    }

    fn settle(&mut self, tick: u64) {
        for rest in self.rests.iter_mut().flatten() {
            rest.settled |= rest.since + self.patience_ticks <= tick;
        }
    }

    fn update(&self, id: &str, at_ns: u64, bodies: &[Painted<'_>], settled: bool) -> SceneUpdate {
        let mut entity = entity(id, at_ns);
        for (body, color) in bodies {
            let rest = self
                .rests
                .get(body.id().index() as usize)
                .copied()
                .flatten();
            if rest.is_some_and(|rest| rest.settled) == settled {
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
enum Standing {
    Stirring,
    /// Has lain still for long enough to settle.
    Patient,
    Settled,
}

/// An entity without anything in it; it replaces the one of its name.
pub(super) fn entity(id: &str, at_ns: u64) -> SceneEntity {
    let seconds = u32::try_from(at_ns / 1_000_000_000).unwrap_or(u32::MAX);
    SceneEntity {
        timestamp: Some(Timestamp::new(seconds, (at_ns % 1_000_000_000) as u32)),
        frame_id: primitives::FRAME.to_owned(),
        id: id.to_owned(),
        ..SceneEntity::default()
    }
}
