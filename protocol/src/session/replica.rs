//! A member's copy of a scene: its shapes, bodies, joints, stream.
//!
//! Changed by scene_events, in order, and by datagrams. Invariant: every body of the copy has a shape that is known, every
//! joint two bodies.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use glam::Vec3;
use rhumb_reckoning::{BodyId, Damping, Inertia, Track};

use super::close::CloseCode;
use crate::interner::{Internable, Interner};
use crate::limits::{SHAPE_BYTES_PER_SCENE_MAX, SHAPES_MAX};
use crate::message::{Joined, SceneEvent, StreamChoice};
use crate::scene::{BodyDesc, Joints, Shape, ShapeId};
use crate::stream::{PredictionParameters, StreamReceiver, Subscriber};
use crate::wire::Wire;
use crate::wire::bytes::Writer;

/// The copy.
#[derive(Debug)]
pub struct Replica {
    choice: StreamChoice,
    pub(crate) receiver: StreamReceiver,
    damping: Damping,
    gravity: Vec3,
    shapes: BTreeMap<ShapeId, Shape>,
    shape_bytes: usize,
    /// What its bodies are, each kind kept once: its numbers are the labels of the stream's bodies.
    kinds: Interner<BodyDesc>,
    joints: Joints,
    whole: bool,
}

impl Replica {
    /// An empty copy that the snapshot after `joined` fills.
    #[must_use]
    pub(crate) fn new(joined: &Joined) -> Self {
        Self {
            choice: joined.choice,
            receiver: StreamReceiver::new(match joined.choice {
                StreamChoice::Capped { .. } => Subscriber::limited(&joined.start),
                StreamChoice::Within(_) | StreamChoice::Full => Subscriber::new(&joined.start),
            }),
            damping: joined.config.damping,
            gravity: joined.start.gravity,
            shapes: BTreeMap::new(),
            shape_bytes: 0,
            kinds: Interner::default(),
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
    pub(crate) fn has_caught_up_with(&self, other: &Self) -> bool {
        other.stream().has_lost_sync() || self.stream().complete() >= other.stream().complete()
    }

    /// The stream.
    #[must_use]
    pub const fn stream(&self) -> &Subscriber {
        self.receiver.subscriber()
    }

    /// Where the bodies' changes are drained from.
    pub const fn stream_mut(&mut self) -> &mut Subscriber {
        self.receiver.subscriber_mut()
    }

    /// Whether the snapshot has arrived.
    #[must_use]
    pub const fn is_complete(&self) -> bool {
        self.whole
    }

    /// The gravity that pulls now, m/s².
    #[must_use]
    pub const fn gravity(&self) -> Vec3 {
        self.gravity
    }

    /// What a body is.
    #[must_use]
    pub fn body(&self, id: BodyId) -> Option<BodyDesc> {
        let kind = self.stream().label(id)?;
        let desc = *self.kinds.get(kind);
        Some(BodyDesc { id, ..desc })
    }

    /// A shape.
    #[must_use]
    pub fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.shapes.get(&id)
    }

    /// All bodies in order of index.
    pub fn bodies(&self) -> impl Iterator<Item = BodyDesc> {
        let indices = 0..self.stream().index_end() as u32;
        let ids = indices.filter_map(|index| self.stream().body(index));
        ids.filter_map(|id| self.body(id))
    }

    /// What holds bodies together.
    #[must_use]
    pub const fn joints(&self) -> &Joints {
        &self.joints
    }

    /// Takes the place of a copy of the same scene: all that it held counts as changed, since it may be gone.
    pub(crate) fn take_over(&mut self, old: &Self) {
        self.stream_mut().succeed(old.stream());
    }

    /// The snapshot is whole.
    pub(crate) fn end_snapshot(&mut self) {
        self.whole = true;
        self.stream_mut().handle_snapshot_end();
    }

    /// Takes in a scene_event. Those before the snapshot's end are the snapshot and do not count.
    ///
    /// # Errors
    ///
    /// The code to close with, when a scene_event contradicts what was said before or breaks a limit.
    pub(crate) fn apply_scene_event(&mut self, scene_event: &SceneEvent) -> Result<(), CloseCode> {
        match scene_event {
            SceneEvent::ShapeAdded { id, shape } => {
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
            SceneEvent::ShapeRemoved { id } => {
                let shape = self.shapes.remove(id).ok_or(CloseCode::VIOLATION)?;
                self.shape_bytes -= shape.bytes();
            }
            SceneEvent::BodyPlaced {
                desc,
                inertia,
                track,
                alias,
            } => {
                self.place(desc, *inertia, *track)?;
                if let Some(alias) = alias {
                    self.stream_mut().alias(desc.id, *alias);
                }
            }
            SceneEvent::BodyRemoved { id, .. } => {
                self.remove(*id)?;
            }
            SceneEvent::GravityChanged { since, gravity } => {
                self.gravity = *gravity;
                self.stream_mut().change_gravity(*since, *gravity);
            }
            SceneEvent::SceneFaulted { .. } | SceneEvent::Unknown { .. } => {}
            SceneEvent::JointAdded { id, joint } => {
                let known = joint.bodies.map(|body| self.body(body).is_some());
                if known != [true; 2] || !self.joints.insert(*id, *joint) {
                    return Err(CloseCode::VIOLATION);
                }
            }
            SceneEvent::JointRemoved { id } => {
                self.joints.remove(*id).ok_or(CloseCode::VIOLATION)?;
            }
        }
        if self.whole {
            self.stream_mut().apply_scene_event();
        }
        Ok(())
    }

    fn place(
        &mut self,
        desc: &BodyDesc,
        inertia: Option<Inertia>,
        track: Track,
    ) -> Result<(), CloseCode> {
        let shape = self.shapes.get(&desc.shape).ok_or(CloseCode::VIOLATION)?;
        let parameters = PredictionParameters::of(desc, shape, self.damping, inertia);
        let before = self.stream().body(desc.id.index());
        let kind_before = before.and_then(|id| self.stream().label(id));
        let kind = self.kinds.join(nameless(desc));
        let stream = self.receiver.subscriber_mut();
        if !stream.place_labelled(desc.id, &parameters, track, Some(kind)) {
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
        let kind = self.stream().label(id);
        if !self.stream_mut().remove(id) {
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
fn nameless(desc: &BodyDesc) -> BodyDesc {
    BodyDesc {
        id: BodyId::new(0, 0),
        ..*desc
    }
}

impl Internable for BodyDesc {
    type Key = Vec<u8>;

    /// What is said of it: one value has one encoding.
    fn key(&self) -> Vec<u8> {
        let mut bytes = Writer::new();
        self.encode(&mut bytes);
        bytes.into_bytes()
    }
}
