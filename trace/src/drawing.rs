//! Draws a set of bodies on two topics, `moving` and `resting`.
//!
//! After a seek, a viewer shows only the last message of each topic. So each message is complete: every body is in
//! exactly one of the two last messages, in its current pose. A body moves to `resting` only after it lies still for a
//! while: a body that wakes often must not cause all resting bodies to be rewritten. When a resting body moves, both
//! are written.

use foxglove::messages::{Color, PosesInFrame, SceneEntity, SceneUpdate, Timestamp};

use crate::primitives;
use crate::primitives::DrawnBody;

/// The content of the last messages of both topics.
#[derive(Debug)]
pub struct DrawnScene {
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
pub type Painted<'a> = (DrawnBody<'a>, Color);

/// The messages of a drawing: those whose content changed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// Bodies that move.
    pub moving: Option<SceneUpdate>,
    /// Bodies that rest.
    pub resting: Option<SceneUpdate>,
}

impl DrawnScene {
    /// Nothing is drawn yet; a body moves to `resting` after `rest_delay_ticks` of stillness.
    #[must_use]
    pub const fn new(rest_delay_ticks: u64) -> Self {
        Self {
            rests: Vec::new(),
            at_rest: 0,
            written: None,
            rest_delay_ticks,
        }
    }

    /// Makes both messages at the next drawing.
    pub fn redraw(&mut self) {
        self.written = None;
    }

    /// Draws the bodies of a tick.
    pub fn draw(&mut self, (tick, at_ns): (u64, u64), bodies: &[Painted<'_>]) -> Drawing {
        let mut drawing = Drawing::default();
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
            drawing.resting = Some(self.update("resting", at_ns, bodies, true));
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
            drawing.moving = Some(self.update("moving", at_ns, bodies, false));
        }
        drawing
    }

    /// Updates the stillness record of a body.
    fn update_rest(&mut self, tick: u64, body: &DrawnBody<'_>) -> DrawState {
        let index = body.id.index() as usize;
        if index >= self.rests.len() {
            self.rests.resize(index + 1, None);
        }
        let fresh = RestingBody {
            generation: body.id.generation(),
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
            let rest = self.rests.get(body.id.index() as usize).copied().flatten();
            if rest.is_some_and(|rest| rest.at_rest) == at_rest {
                primitives::add(
                    &mut entity,
                    body.shape,
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

fn timestamp(at_ns: u64) -> Timestamp {
    let seconds = u32::try_from(at_ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new(seconds, (at_ns % 1_000_000_000) as u32)
}

/// The poses of all bodies as drawn, in their order.
pub(crate) fn draw_poses(at_ns: u64, bodies: &[Painted<'_>]) -> PosesInFrame {
    let poses = bodies.iter();
    PosesInFrame {
        timestamp: Some(timestamp(at_ns)),
        frame_id: primitives::FRAME.to_owned(),
        poses: poses.map(|(body, _)| primitives::pose(body)).collect(),
    }
}

/// An empty entity; it replaces the entity of the same id.
fn entity(id: &str, at_ns: u64) -> SceneEntity {
    SceneEntity {
        timestamp: Some(timestamp(at_ns)),
        frame_id: primitives::FRAME.to_owned(),
        id: id.to_owned(),
        ..SceneEntity::default()
    }
}

/// Draws static bodies.
#[must_use]
pub fn draw_statics<'a>(at_ns: u64, bodies: impl Iterator<Item = DrawnBody<'a>>) -> SceneUpdate {
    let mut entity = entity("static", at_ns);
    for body in bodies {
        primitives::add(
            &mut entity,
            body.shape,
            body.position,
            body.rotation,
            STATIC,
        );
    }
    SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    }
}

/// The colour of an engine's awake body.
pub const AWAKE: Color = grey(0.80, 1.0);
/// The colour of an engine's sleeping body.
pub const ASLEEP: Color = grey(0.50, 1.0);
/// Translucent, because walls stand in front of the bodies they contain.
const STATIC: Color = grey(0.60, 0.25);

const fn grey(share: f64, a: f64) -> Color {
    Color {
        r: share,
        g: share,
        b: share,
        a,
    }
}
