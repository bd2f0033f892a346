//! A member's copy of a scene: its shapes, bodies, joints, stream.
//!
//! Changed by notices, in order, and by datagrams. Invariant: every body of the copy has a shape that is known, every
//! joint two bodies.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Damping, Inertia, Track};

use super::asking::Asking;
use super::close::CloseCode;
use crate::kinds::{Kind, Kinds};
use crate::limits::{SHAPE_BYTES_PER_SCENE_MAX, SHAPES_MAX};
use crate::message::{Joined, Notice, StreamChoice};
use crate::scene::{BodyTerms, Joints, Shape, ShapeId};
use crate::stream::{Manner, Subscriber};
use crate::time::{Instant, Span};
use crate::wire::Wire;
use crate::wire::bytes::Writer;

/// The copy.
#[derive(Debug)]
pub struct Replica {
    choice: StreamChoice,
    subscriber: Subscriber,
    asking: Asking,
    damping: Damping,
    gravity: Vec3,
    shapes: BTreeMap<ShapeId, Shape>,
    shape_bytes: usize,
    /// What its bodies are, each kind kept once: its numbers are the labels of the stream's bodies.
    kinds: Kinds<BodyTerms>,
    joints: Joints,
    whole: bool,
}

impl Replica {
    /// An empty copy that the snapshot after `joined` fills.
    #[must_use]
    pub(crate) fn new(joined: &Joined) -> Self {
        Self {
            choice: joined.choice,
            subscriber: match joined.choice {
                StreamChoice::Capped { .. } => Subscriber::limited(&joined.start),
                StreamChoice::Within(_) | StreamChoice::Full => Subscriber::new(&joined.start),
            },
            asking: Asking::default(),
            damping: joined.terms.damping,
            gravity: joined.start.gravity,
            shapes: BTreeMap::new(),
            shape_bytes: 0,
            kinds: Kinds::default(),
            joints: Joints::default(),
            whole: false,
        }
    }

    /// Which of the scene's streams it is by.
    #[must_use]
    pub const fn choice(&self) -> StreamChoice {
        self.choice
    }

    /// Whether nothing is lost by showing this copy in place of another one of the same scene.
    pub(crate) fn is_as_far_as(&self, other: &Self) -> bool {
        other.subscriber.has_lost_touch()
            || self.subscriber.complete() >= other.subscriber.complete()
    }

    /// The stream.
    #[must_use]
    pub const fn stream(&self) -> &Subscriber {
        &self.subscriber
    }

    /// Where the bodies' changes are drained from.
    pub const fn stream_mut(&mut self) -> &mut Subscriber {
        &mut self.subscriber
    }

    /// Whether the snapshot has arrived.
    #[must_use]
    pub const fn is_whole(&self) -> bool {
        self.whole
    }

    /// The gravity that pulls now, m/s².
    #[must_use]
    pub const fn gravity(&self) -> Vec3 {
        self.gravity
    }

    /// What a body is.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<BodyTerms> {
        let kind = self.subscriber.label(id)?;
        let terms = *self.kinds.get(kind);
        Some(BodyTerms { id, ..terms })
    }

    /// A shape.
    #[must_use]
    pub fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.shapes.get(&id)
    }

    /// All bodies in order of index.
    pub fn bodies(&self) -> impl Iterator<Item = BodyTerms> {
        let indices = 0..self.subscriber.index_end() as u32;
        let ids = indices.filter_map(|index| self.subscriber.body(index));
        ids.filter_map(|id| self.body(id))
    }

    /// What holds bodies together.
    #[must_use]
    pub const fn joints(&self) -> &Joints {
        &self.joints
    }

    /// Looks at what is missing now.
    pub(crate) fn watch_missing(&mut self, now: Instant) {
        self.asking.watch(now, &self.subscriber);
    }

    /// When to ask for what is missing.
    pub(crate) fn missing_due(&self) -> Option<Instant> {
        self.asking.due()
    }

    /// What to ask the server for now, if something is due.
    pub(crate) fn ask(&mut self, now: Instant, patient: Span) -> Option<Vec<u8>> {
        let due: Vec<u64> = self.asking.ask(now, patient).collect();
        let echo = (!due.is_empty()).then(|| self.subscriber.echo_for(&due))?;
        Some(echo.encode(self.subscriber.stream()))
    }

    /// The next body whose track was made right.
    pub(crate) fn poll_amended(&mut self) -> Option<BodyId> {
        self.subscriber.poll_amended()
    }

    /// Takes the place of a copy of the same scene: all that it held counts as changed, since it may be gone.
    pub(crate) fn succeed(&mut self, old: &Self) {
        self.subscriber.touch_below(old.subscriber.index_end());
    }

    /// The snapshot is whole.
    pub(crate) fn end_snapshot(&mut self) {
        self.whole = true;
        self.subscriber.handle_snapshot_end();
    }

    /// Takes in a notice. Those before the snapshot's end are the snapshot and do not count.
    ///
    /// # Errors
    ///
    /// The code to close with, when a notice contradicts what was said before or breaks a limit.
    pub(crate) fn handle_notice(&mut self, notice: &Notice) -> Result<(), CloseCode> {
        match notice {
            Notice::ShapeAdded { id, shape } => {
                if self.shapes.len() >= SHAPES_MAX as usize {
                    return Err(CloseCode::LIMIT);
                }
                self.shape_bytes += shape.bytes();
                if self.shape_bytes > SHAPE_BYTES_PER_SCENE_MAX {
                    return Err(CloseCode::LIMIT);
                }
                if let Some(before) = self.shapes.insert(*id, shape.clone()) {
                    self.shape_bytes -= before.bytes();
                }
            }
            Notice::ShapeRemoved { id } => {
                let shape = self.shapes.remove(id).ok_or(CloseCode::VIOLATION)?;
                self.shape_bytes -= shape.bytes();
            }
            Notice::BodyPlaced {
                terms,
                inertia,
                track,
                seat,
            } => {
                self.place(terms, *inertia, *track)?;
                if let Some(seat) = seat {
                    self.subscriber.seat(terms.id, *seat);
                }
            }
            Notice::BodyRemoved { id, .. } => {
                self.remove(*id)?;
            }
            Notice::GravityChanged { since, gravity } => {
                self.gravity = *gravity;
                self.subscriber.change_gravity(*since, *gravity);
            }
            Notice::SceneFaulted { .. } | Notice::Unknown { .. } => {}
            Notice::JointAdded { id, joint } => {
                let known = joint.bodies.map(|body| self.body(body).is_some());
                if known != [true; 2] || !self.joints.insert(*id, *joint) {
                    return Err(CloseCode::VIOLATION);
                }
            }
            Notice::JointRemoved { id } => {
                self.joints.remove(*id).ok_or(CloseCode::VIOLATION)?;
            }
        }
        if self.whole {
            self.subscriber.handle_notice();
        }
        Ok(())
    }

    fn place(
        &mut self,
        terms: &BodyTerms,
        inertia: Option<Inertia>,
        track: Track,
    ) -> Result<(), CloseCode> {
        let shape = self.shapes.get(&terms.shape).ok_or(CloseCode::VIOLATION)?;
        let manner = Manner::of(terms, shape, self.damping, inertia);
        let before = self.subscriber.body(terms.id.index());
        let kind_before = before.and_then(|id| self.subscriber.label(id));
        let kind = self.kinds.join(nameless(terms));
        let stream = &mut self.subscriber;
        if !stream.place_labelled(terms.id, &manner, track, Some(kind)) {
            self.kinds.leave(kind);
            return Err(CloseCode::LIMIT);
        }
        if let Some(id) = before {
            self.joints.remove_body(id);
        }
        if let Some(kind) = kind_before {
            self.kinds.leave(kind);
        }
        Ok(())
    }

    fn remove(&mut self, id: BodyId) -> Result<(), CloseCode> {
        let kind = self.subscriber.label(id);
        if !self.subscriber.remove(id) {
            return Err(CloseCode::VIOLATION);
        }
        if let Some(kind) = kind {
            self.kinds.leave(kind);
        }
        self.joints.remove_body(id);
        Ok(())
    }
}

/// What many bodies can have in common.
fn nameless(terms: &BodyTerms) -> BodyTerms {
    BodyTerms {
        id: BodyId::new(0, 0),
        ..*terms
    }
}

impl Kind for BodyTerms {
    type Key = Vec<u8>;

    /// What is said of it: one value has one encoding.
    fn key(&self) -> Vec<u8> {
        let mut bytes = Writer::new();
        self.encode(&mut bytes);
        bytes.into_bytes()
    }
}
