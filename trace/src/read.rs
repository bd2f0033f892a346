//! Engine states, read from the messages of a trace.
//!
//! `messages` defines the fields. Poses on a grid come without velocities.

use glam::Vec3;
use prost::Message as _;
use rhumb_protocol::limits::{EXTENT_MAX, EXTENT_MIN};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Hull, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Inertia, Tick, ToleranceScale};

use crate::drawing::Placed;
use crate::messages::{GridHistory, Placement, STEPS, States};

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
    /// True if the observations are exact; otherwise they are poses on the grid, whose velocities stand at zero.
    pub is_exact: bool,
}

/// Reads the messages of a topic `truth/state`, in order.
#[derive(Clone, Debug, Default)]
pub struct StatesReader(GridHistory);

impl StatesReader {
    /// Decodes the next message. `None` if a motion, shape, kind or id in it is invalid.
    ///
    /// # Errors
    ///
    /// [`prost::DecodeError`] if the bytes are not such a message.
    pub fn read(&mut self, bytes: &[u8]) -> Result<Option<TickStates>, prost::DecodeError> {
        let states = States::decode(bytes)?;
        Ok(parse(&states, &mut self.0))
    }
}

/// Decodes one message of exact states. `None` if a motion, shape, kind or id in it is invalid.
///
/// # Errors
///
/// [`prost::DecodeError`] if the bytes are not such a message.
pub fn read_states(bytes: &[u8]) -> Result<Option<TickStates>, prost::DecodeError> {
    StatesReader::default().read(bytes)
}

fn parse(states: &States, history: &mut GridHistory) -> Option<TickStates> {
    let tick = Tick::new(states.tick);
    let is_on_grid = !states.step_px.is_empty();
    let is_exact = !is_on_grid && states.vx.len() == states.px.len();
    let observed = (0..states.index.len()).map(|place| match is_on_grid {
        true => grid_observation(states, place, history),
        false => observation(states, place, history),
    });
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
        is_exact,
    })
}

fn id(index: u32, generation: u32) -> Option<BodyId> {
    Some(BodyId::new(index, u16::try_from(generation).ok()?))
}

/// An observation on the grid: a pose at rest.
fn grid_observation(
    states: &States,
    place: usize,
    history: &mut GridHistory,
) -> Option<Observation> {
    let columns = [
        &states.step_px,
        &states.step_py,
        &states.step_pz,
        &states.step_qx,
        &states.step_qy,
        &states.step_qz,
        &states.step_qw,
    ];
    let mut residual = [0; 7];
    for (part, column) in residual.iter_mut().zip(columns) {
        *part = *column.get(place)?;
    }
    let id = id(*states.index.get(place)?, *states.generation.get(place)?)?;
    let pose = history.decode(id, residual);
    let mut parts = [0.0; 13];
    for (part, steps) in parts.iter_mut().zip(pose) {
        *part = (steps as f64 / STEPS) as f32;
    }
    Some(Observation {
        id,
        motion: motion(&parts)?,
        activity: activity(*states.awake.get(place)?),
    })
}

/// An exact observation, which begins the history of its body anew. A topic on the grid has exact poses where one is too
/// far out; they have no velocities.
fn observation(states: &States, place: usize, history: &mut GridHistory) -> Option<Observation> {
    let columns = [
        &states.px, &states.py, &states.pz, &states.qx, &states.qy, &states.qz, &states.qw,
        &states.vx, &states.vy, &states.vz, &states.wx, &states.wy, &states.wz,
    ];
    let mut parts = [0.0; 13];
    let has_velocities = !states.vx.is_empty();
    for (number, (part, column)) in parts.iter_mut().zip(columns).enumerate() {
        if number < 7 || has_velocities {
            *part = *column.get(place)?;
        }
    }
    let index = *states.index.get(place)?;
    let generation = *states.generation.get(place)?;
    let id = id(index, generation)?;
    history.forget(id);
    Some(Observation {
        id,
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
    let shape = shape(placement)?;
    shape.check().ok()?;
    let tolerance_scale = i8::try_from(placement.tolerance_scale)
        .ok()
        .and_then(ToleranceScale::new)?;
    Some(Placed {
        tick,
        desc: BodyDesc {
            tolerance_scale,
            damping: damping(&placement.damping)?,
            gravity_scale: placement.gravity_scale.unwrap_or(1.0),
            ..BodyDesc::plain(id, kind, ShapeId(0))
        },
        shape,
        inertia: inertia(&placement.inertia)?,
        observation: Observation {
            id,
            motion: motion(&placement.motion)?,
            activity: activity(placement.awake),
        },
    })
}

/// The damping of a body; `Some(None)` where it is the scene's.
fn damping(numbers: &[f32]) -> Option<Option<Damping>> {
    match *numbers {
        [] => Some(None),
        [linear, angular] if linear >= 0.0 && angular >= 0.0 => {
            Some(Some(Damping { linear, angular }))
        }
        _ => None,
    }
}

/// The inertia of a body; `Some(None)` where it is not stated.
fn inertia(numbers: &[f32]) -> Option<Option<Inertia>> {
    match *numbers {
        [] => Some(None),
        [a, b, c, x, y, z, w] => Inertia::new([a, b, c], [x, y, z, w]).ok().map(Some),
        _ => None,
    }
}

fn shape(placement: &Placement) -> Option<Shape> {
    let extents = placement.extents.as_slice();
    Some(match (placement.shape, extents) {
        // Height fields, meshes and compounds have no measures: a ball has their bounding radius, which is all that an
        // error needs.
        (0, &[]) => {
            let radius = placement.bounding_radius_m as f32;
            // NaN is none.
            let is_radius = radius > 0.0;
            is_radius.then_some(Shape::Ball {
                radius: radius.clamp(EXTENT_MIN, EXTENT_MAX),
            })?
        }
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
