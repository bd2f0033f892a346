//! Exact engine states, read from the messages of a trace.
//!
//! `messages` defines the fields. Poses on a grid are not read.

use glam::Vec3;
use prost::Message as _;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Hull, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Tick, ToleranceScale};

use super::body::Placed;
use super::messages::{Placement, States};

/// The contents of one message of the topic `truth/state`.
#[derive(Clone, Debug)]
pub struct TickStates {
    /// The tick.
    pub tick: Tick,
    /// Observations after its step.
    pub observed: Vec<Observation>,
    /// Bodies placed after its step.
    pub placed: Vec<Placed>,
    /// Bodies that were removed in its step or after it, with the tick.
    pub removed: Vec<(Tick, BodyId)>,
}

/// Decodes a message. `None` if a motion, shape, kind or id in it is invalid, or if it has poses on a grid alone.
///
/// # Errors
///
/// [`prost::DecodeError`] if the bytes are not such a message.
pub fn read_states(bytes: &[u8]) -> Result<Option<TickStates>, prost::DecodeError> {
    let states = States::decode(bytes)?;
    Ok(parse(&states))
}

fn parse(states: &States) -> Option<TickStates> {
    let tick = Tick::new(states.tick);
    let observed = (0..states.index.len()).map(|place| observation(states, place));
    let placed = states
        .placed
        .iter()
        .map(|placement| placed(tick, placement));
    let removed = states.removed_index.iter().zip(&states.removed_generation);
    let removed = removed.map(|(index, generation)| Some((tick, id(*index, *generation)?)));
    Some(TickStates {
        tick,
        observed: observed.collect::<Option<_>>()?,
        placed: placed.collect::<Option<_>>()?,
        removed: removed.collect::<Option<_>>()?,
    })
}

fn id(index: u32, generation: u32) -> Option<BodyId> {
    Some(BodyId::new(index, u16::try_from(generation).ok()?))
}

fn observation(states: &States, place: usize) -> Option<Observation> {
    let columns = [
        &states.px, &states.py, &states.pz, &states.qx, &states.qy, &states.qz, &states.qw,
        &states.vx, &states.vy, &states.vz, &states.wx, &states.wy, &states.wz,
    ];
    let mut parts = [0.0; 13];
    for (part, column) in parts.iter_mut().zip(columns) {
        *part = *column.get(place)?;
    }
    let index = *states.index.get(place)?;
    let generation = *states.generation.get(place)?;
    Some(Observation {
        id: id(index, generation)?,
        motion: motion(&parts)?,
        activity: activity(*states.awake.get(place)?),
    })
}

const fn activity(awake: bool) -> Activity {
    if awake {
        Activity::Awake
    } else {
        Activity::Asleep
    }
}

fn motion(parts: &[f32]) -> Option<BodyState> {
    let [px, py, pz, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz] = *parts.first_chunk::<13>()?;
    BodyState::new([px, py, pz], [qx, qy, qz, qw], [vx, vy, vz], [wx, wy, wz]).ok()
}

fn placed(tick: Tick, placement: &Placement) -> Option<Placed> {
    let id = id(placement.index, placement.generation)?;
    let kind = match placement.kind {
        1 => BodyKind::Fixed,
        2 => BodyKind::Dynamic,
        3 => BodyKind::Kinematic,
        _ => return None,
    };
    let shape = shape(placement.shape, &placement.extents)?;
    shape.check().ok()?;
    let tolerance_scale = i8::try_from(placement.tolerance_scale)
        .ok()
        .and_then(ToleranceScale::new)?;
    Some(Placed {
        tick,
        desc: BodyDesc {
            tolerance_scale,
            ..BodyDesc::plain(id, kind, ShapeId(0))
        },
        shape,
        observation: Observation {
            id,
            motion: motion(&placement.motion)?,
            activity: activity(placement.awake),
        },
    })
}

fn shape(kind: i32, extents: &[f32]) -> Option<Shape> {
    Some(match (kind, extents) {
        (1, &[radius]) => Shape::Ball { radius },
        (2, &[x, y, z]) => Shape::Cuboid {
            half_extents: Vec3::new(x, y, z),
        },
        (3, &[half_height, radius]) => Shape::Capsule {
            half_height,
            radius,
        },
        (4, &[half_height, radius]) => Shape::Cylinder {
            half_height,
            radius,
        },
        (5, points) => {
            let points: Vec<_> = points.chunks_exact(3).map(Vec3::from_slice).collect();
            Shape::Hull(Hull::new(&points).ok()?)
        }
        (6, &[x, y, z, radius]) => Shape::RoundedCuboid {
            half_extents: Vec3::new(x, y, z),
            radius,
        },
        (7, &[half_height, radius]) => Shape::Cone {
            half_height,
            radius,
        },
        (8, &[x, y, z]) => Shape::HalfSpace {
            normal: Vec3::new(x, y, z),
        },
        _ => return None,
    })
}
