//! Trace messages, as `proto/rhumb.proto` defines them.
//!
//! Each trace embeds the schema as compiled by protoc. The compiled form is checked in; a test compares it with its
//! source.
//!
//! Poses are on a grid, as second differences of whole numbers. A moving body hardly changes its velocity, so its
//! second difference is a small number, which takes a byte or two where an exact pose takes 28. Whole numbers give the
//! same result in every language.

use std::collections::BTreeMap;

use rhumb_protocol::scene::{BodyKind, Shape as Solid};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Tick};

use crate::drawing::Placed;

/// `proto/rhumb.proto` as `protoc --descriptor_set_out=rhumb.binpb rhumb.proto` compiles it.
pub const DESCRIPTORS: &[u8] = include_bytes!("../proto/rhumb.binpb");

/// One frame of one mode's caller.
#[derive(Clone, PartialEq, prost::Message)]
pub struct TickStats {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Number of the frame, from 0.
    #[prost(uint32, tag = "2")]
    pub frame: u32,
    /// Time of the frame in the caller's thread, nanoseconds.
    #[prost(uint64, tag = "3")]
    pub frame_ns: u64,
    /// UDP payload received since the previous frame, bytes.
    #[prost(uint64, tag = "4")]
    pub wire_bytes_down: u64,
    /// UDP payload sent since the previous frame, bytes.
    #[prost(uint64, tag = "5")]
    pub wire_bytes_up: u64,
    /// UDP datagrams received since the previous frame.
    #[prost(uint64, tag = "6")]
    pub wire_datagrams_down: u64,
    /// UDP datagrams sent since the previous frame.
    #[prost(uint64, tag = "7")]
    pub wire_datagrams_up: u64,
    /// State datagrams and control stream, bytes.
    #[prost(uint64, tag = "8")]
    pub payload_bytes_down: u64,
    /// Updates decoded.
    #[prost(uint64, tag = "9")]
    pub updates: u64,
    /// Bodies compared with the truth.
    #[prost(uint64, tag = "10")]
    pub body_ticks: u64,
    /// Median surface error, metres.
    #[prost(double, tag = "11")]
    pub error_m_p50: f64,
    /// 99th percentile of the surface error, metres.
    #[prost(double, tag = "12")]
    pub error_m_p99: f64,
    /// Largest surface error, metres.
    #[prost(double, tag = "13")]
    pub error_m_max: f64,
}

/// One body-tick over tolerance.
#[derive(Clone, PartialEq, prost::Message)]
pub struct BreachMessage {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Index of each body.
    #[prost(uint32, tag = "2")]
    pub index: u32,
    /// Generation of each body.
    #[prost(uint32, tag = "3")]
    pub generation: u32,
    /// Surface error, metres.
    #[prost(double, tag = "4")]
    pub error_m: f64,
    /// Tolerance of the body, metres.
    #[prost(double, tag = "5")]
    pub tolerance_m: f64,
    /// Number of the cause.
    #[prost(int32, tag = "6")]
    pub cause: i32,
}

/// States of the engine at a tick.
#[derive(Clone, PartialEq, prost::Message)]
pub struct States {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Index of each body.
    #[prost(uint32, repeated, tag = "2")]
    pub index: Vec<u32>,
    /// Generation of each body.
    #[prost(uint32, repeated, tag = "3")]
    pub generation: Vec<u32>,
    /// Position x, metres.
    #[prost(float, repeated, tag = "4")]
    pub px: Vec<f32>,
    /// Position y, metres.
    #[prost(float, repeated, tag = "5")]
    pub py: Vec<f32>,
    /// Position z, metres.
    #[prost(float, repeated, tag = "6")]
    pub pz: Vec<f32>,
    /// Component x of the rotation.
    #[prost(float, repeated, tag = "7")]
    pub qx: Vec<f32>,
    /// Component y of the rotation.
    #[prost(float, repeated, tag = "8")]
    pub qy: Vec<f32>,
    /// Component z of the rotation.
    #[prost(float, repeated, tag = "9")]
    pub qz: Vec<f32>,
    /// Component w of the rotation.
    #[prost(float, repeated, tag = "10")]
    pub qw: Vec<f32>,
    /// Linear velocity x, metres per second.
    #[prost(float, repeated, tag = "11")]
    pub vx: Vec<f32>,
    /// Linear velocity y, metres per second.
    #[prost(float, repeated, tag = "12")]
    pub vy: Vec<f32>,
    /// Linear velocity z, metres per second.
    #[prost(float, repeated, tag = "13")]
    pub vz: Vec<f32>,
    /// Angular velocity x, radians per second.
    #[prost(float, repeated, tag = "14")]
    pub wx: Vec<f32>,
    /// Angular velocity y, radians per second.
    #[prost(float, repeated, tag = "15")]
    pub wy: Vec<f32>,
    /// Angular velocity z, radians per second.
    #[prost(float, repeated, tag = "16")]
    pub wz: Vec<f32>,
    /// True for a body that is awake.
    #[prost(bool, repeated, tag = "17")]
    pub awake: Vec<bool>,
    /// Bodies placed after this tick's step.
    #[prost(message, repeated, tag = "18")]
    pub placed: Vec<Placement>,
    /// Index of each removed body.
    #[prost(uint32, repeated, tag = "19")]
    pub removed_index: Vec<u32>,
    /// Generation of each removed body.
    #[prost(uint32, repeated, tag = "20")]
    pub removed_generation: Vec<u32>,
    /// Residual of `px`, steps of the grid.
    #[prost(sint64, repeated, tag = "21")]
    pub step_px: Vec<i64>,
    /// Residual of `py`, steps of the grid.
    #[prost(sint64, repeated, tag = "22")]
    pub step_py: Vec<i64>,
    /// Residual of `pz`, steps of the grid.
    #[prost(sint64, repeated, tag = "23")]
    pub step_pz: Vec<i64>,
    /// Residual of `qx`, steps of the grid.
    #[prost(sint64, repeated, tag = "24")]
    pub step_qx: Vec<i64>,
    /// Residual of `qy`, steps of the grid.
    #[prost(sint64, repeated, tag = "25")]
    pub step_qy: Vec<i64>,
    /// Residual of `qz`, steps of the grid.
    #[prost(sint64, repeated, tag = "26")]
    pub step_qz: Vec<i64>,
    /// Residual of `qw`, steps of the grid.
    #[prost(sint64, repeated, tag = "27")]
    pub step_qw: Vec<i64>,
}

/// The form of an engine's states.
#[derive(Clone, Debug)]
pub enum StateForm {
    /// Whole states, bit exact.
    Exact,
    /// Poses on the grid, without velocities.
    Grid(GridHistory),
}

impl States {
    /// The states after a tick's step, and the bodies placed and removed after it.
    #[must_use]
    pub fn of(
        tick: Tick,
        observed: &[Observation],
        (placed, removed): (&[Placed], &[BodyId]),
        form: &mut StateForm,
    ) -> Self {
        let mut states = Self {
            tick: tick.value(),
            index: observed.iter().map(|o| o.id.index()).collect(),
            generation: observed.iter().map(|o| o.id.generation().into()).collect(),
            awake: observed
                .iter()
                .map(|o| o.activity == Activity::Awake)
                .collect(),
            placed: placed.iter().map(Placement::from).collect(),
            removed_index: removed.iter().map(|id| id.index()).collect(),
            removed_generation: removed.iter().map(|id| id.generation().into()).collect(),
            ..Self::default()
        };
        let poses = observed
            .iter()
            .map(|o| (o.id, o.motion.position(), o.motion.rotation()));
        match form {
            StateForm::Exact => {
                states.put_exact(observed);
                states.put_velocities(observed);
            }
            StateForm::Grid(history) => match residuals(poses, history) {
                Some(residuals) => states.put_residuals(&residuals),
                None => states.put_exact(observed),
            },
        }
        states
    }

    fn put_exact(&mut self, observed: &[Observation]) {
        let column = |part: usize| observed.iter().map(|o| o.motion.parts()[part]).collect();
        (self.px, self.py, self.pz) = (column(0), column(1), column(2));
        (self.qx, self.qy, self.qz, self.qw) = (column(3), column(4), column(5), column(6));
    }

    fn put_velocities(&mut self, observed: &[Observation]) {
        let column = |part: usize| observed.iter().map(|o| o.motion.parts()[part]).collect();
        (self.vx, self.vy, self.vz) = (column(7), column(8), column(9));
        (self.wx, self.wy, self.wz) = (column(10), column(11), column(12));
    }

    fn put_residuals(&mut self, residuals: &[GridPose]) {
        let column = |part: usize| residuals.iter().map(|pose| pose[part]).collect();
        (self.step_px, self.step_py, self.step_pz) = (column(0), column(1), column(2));
        (self.step_qx, self.step_qy) = (column(3), column(4));
        (self.step_qz, self.step_qw) = (column(5), column(6));
    }
}

/// A pose of a copy, or of the truth.
type PoseOf = (BodyId, [f32; 3], [f32; 4]);

/// The residuals of poses; `None`, with the bodies forgotten, if one of them is not on the grid.
fn residuals(
    poses: impl Iterator<Item = PoseOf> + Clone,
    history: &mut GridHistory,
) -> Option<Vec<GridPose>> {
    let points = poses.clone().map(|(id, position, rotation)| {
        let point = GridHistory::quantise(position, rotation)?;
        Some((id, point))
    });
    let Some(points) = points.collect::<Option<Vec<_>>>() else {
        poses.for_each(|(id, ..)| history.forget(id));
        return None;
    };
    let encoded = points.iter().map(|(id, point)| history.encode(*id, *point));
    Some(encoded.collect())
}

/// A body and its initial state.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Placement {
    /// Index of each body.
    #[prost(uint32, tag = "1")]
    pub index: u32,
    /// Generation of each body.
    #[prost(uint32, tag = "2")]
    pub generation: u32,
    /// Number of the kind.
    #[prost(int32, tag = "3")]
    pub kind: i32,
    /// Number of the shape.
    #[prost(int32, tag = "4")]
    pub shape: i32,
    /// Measures of the shape, metres.
    #[prost(float, repeated, tag = "5")]
    pub extents: Vec<f32>,
    /// Bounding radius, metres.
    #[prost(double, tag = "6")]
    pub bounding_radius_m: f64,
    /// Position, rotation, linear and angular velocity.
    #[prost(float, repeated, tag = "7")]
    pub motion: Vec<f32>,
    /// True for a body that is awake.
    #[prost(bool, tag = "8")]
    pub awake: bool,
    /// Binary exponent of the body's tolerance relative to the run's.
    #[prost(sint32, tag = "9")]
    pub tolerance_scale: i32,
    /// Principal moments, and the quaternion of their axes; empty if unknown.
    #[prost(float, repeated, tag = "10")]
    pub inertia: Vec<f32>,
    /// Linear and angular damping, 1/s; empty for the scene's.
    #[prost(float, repeated, tag = "11")]
    pub damping: Vec<f32>,
    /// Factor on the scene's gravity, if it is not one.
    #[prost(float, optional, tag = "12")]
    pub gravity_scale: Option<f32>,
}

impl From<&Placed> for Placement {
    fn from(placed: &Placed) -> Self {
        let (shape, extents) = match placed.shape {
            Solid::Hull(ref hull) => {
                let points = hull.points().iter();
                (5, points.flat_map(glam::Vec3::to_array).collect())
            }
            Solid::Ball { radius } => (1, vec![radius]),
            Solid::Cuboid { half_extents } => (2, half_extents.to_array().into()),
            Solid::Capsule {
                half_height,
                radius,
            } => (3, vec![half_height, radius]),
            Solid::Cylinder {
                half_height,
                radius,
            } => (4, vec![half_height, radius]),
            Solid::RoundedCuboid {
                half_extents,
                radius,
            } => {
                let mut extents = half_extents.to_array().to_vec();
                extents.push(radius);
                (6, extents)
            }
            Solid::Cone {
                half_height,
                radius,
            } => (7, vec![half_height, radius]),
            Solid::HalfSpace { normal } => (8, normal.to_array().into()),
            // They are drawn, but states have no numbers for them.
            Solid::Heights(_) | Solid::Mesh(_) | Solid::Compound(_) => (0, Vec::new()),
        };
        Self {
            index: placed.desc.id.index(),
            generation: placed.desc.id.generation().into(),
            kind: match placed.desc.kind {
                BodyKind::Fixed => 1,
                BodyKind::Dynamic => 2,
                BodyKind::Kinematic => 3,
            },
            shape,
            extents,
            bounding_radius_m: placed.shape.bounding_radius().metres(),
            motion: placed.observation.motion.parts().into(),
            awake: placed.observation.activity == Activity::Awake,
            tolerance_scale: placed.desc.tolerance_scale.exponent().into(),
            inertia: placed.inertia.map_or_else(Vec::new, |inertia| {
                [&inertia.moments()[..], &inertia.frame()[..]].concat()
            }),
            damping: (placed.desc.damping)
                .map_or_else(Vec::new, |damping| vec![damping.linear, damping.angular]),
            gravity_scale: Some(placed.desc.gravity_scale).filter(|scale| *scale != 1.0),
        }
    }
}

/// Changes of a client's copy in one frame.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Poses {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Number of the frame, from 0.
    #[prost(uint32, tag = "2")]
    pub frame: u32,
    /// Index of each body.
    #[prost(uint32, repeated, tag = "3")]
    pub index: Vec<u32>,
    /// Generation of each body.
    #[prost(uint32, repeated, tag = "4")]
    pub generation: Vec<u32>,
    /// Position x, metres.
    #[prost(float, repeated, tag = "5")]
    pub px: Vec<f32>,
    /// Position y, metres.
    #[prost(float, repeated, tag = "6")]
    pub py: Vec<f32>,
    /// Position z, metres.
    #[prost(float, repeated, tag = "7")]
    pub pz: Vec<f32>,
    /// Component x of the rotation.
    #[prost(float, repeated, tag = "8")]
    pub qx: Vec<f32>,
    /// Component y of the rotation.
    #[prost(float, repeated, tag = "9")]
    pub qy: Vec<f32>,
    /// Component z of the rotation.
    #[prost(float, repeated, tag = "10")]
    pub qz: Vec<f32>,
    /// Component w of the rotation.
    #[prost(float, repeated, tag = "11")]
    pub qw: Vec<f32>,
    /// True for a body that the copy counts as resting.
    #[prost(bool, repeated, tag = "12")]
    pub resting: Vec<bool>,
    /// Index of each body that left the copy.
    #[prost(uint32, repeated, tag = "13")]
    pub gone_index: Vec<u32>,
    /// Generation of each body that left the copy.
    #[prost(uint32, repeated, tag = "14")]
    pub gone_generation: Vec<u32>,
    /// Residual of `px`, steps of the grid.
    #[prost(sint64, repeated, tag = "15")]
    pub step_px: Vec<i64>,
    /// Residual of `py`, steps of the grid.
    #[prost(sint64, repeated, tag = "16")]
    pub step_py: Vec<i64>,
    /// Residual of `pz`, steps of the grid.
    #[prost(sint64, repeated, tag = "17")]
    pub step_pz: Vec<i64>,
    /// Residual of `qx`, steps of the grid.
    #[prost(sint64, repeated, tag = "18")]
    pub step_qx: Vec<i64>,
    /// Residual of `qy`, steps of the grid.
    #[prost(sint64, repeated, tag = "19")]
    pub step_qy: Vec<i64>,
    /// Residual of `qz`, steps of the grid.
    #[prost(sint64, repeated, tag = "20")]
    pub step_qz: Vec<i64>,
    /// Residual of `qw`, steps of the grid.
    #[prost(sint64, repeated, tag = "21")]
    pub step_qw: Vec<i64>,
    /// True if the residuals are differences from the truth.
    #[prost(bool, tag = "22")]
    pub from_truth: bool,
}

/// The base of which the poses of a copy are differences.
pub enum PoseBase<'a> {
    /// The last poses of the same topic.
    History(&'a mut GridHistory),
    /// The truth of the same tick.
    Truth(&'a dyn Fn(BodyId) -> Option<([f32; 3], [f32; 4])>),
}

impl Poses {
    /// The poses that changed, and whether each body rests. Of the fields, `tick`, `frame`, `gone_index` and
    /// `gone_generation` are left to the caller.
    #[must_use]
    pub fn of(changed: &[(BodyId, [f32; 3], [f32; 4], bool)], base: PoseBase<'_>) -> Self {
        let mut poses = Self {
            index: changed.iter().map(|(id, ..)| id.index()).collect(),
            generation: changed
                .iter()
                .map(|(id, ..)| id.generation().into())
                .collect(),
            resting: changed.iter().map(|(.., resting)| *resting).collect(),
            ..Self::default()
        };
        let plain = changed.iter().map(|(id, at, turn, _)| (*id, *at, *turn));
        let residuals = match base {
            PoseBase::History(history) => residuals(plain, history),
            PoseBase::Truth(truth) => {
                poses.from_truth = true;
                differences(plain, truth)
            }
        };
        match residuals {
            Some(residuals) => poses.put_residuals(&residuals),
            None => poses.put_exact(changed),
        }
        poses
    }

    fn put_residuals(&mut self, residuals: &[GridPose]) {
        let column = |part: usize| residuals.iter().map(|pose| pose[part]).collect();
        (self.step_px, self.step_py, self.step_pz) = (column(0), column(1), column(2));
        (self.step_qx, self.step_qy) = (column(3), column(4));
        (self.step_qz, self.step_qw) = (column(5), column(6));
    }

    fn put_exact(&mut self, changed: &[(BodyId, [f32; 3], [f32; 4], bool)]) {
        self.from_truth = false;
        let position = |part: usize| changed.iter().map(|(_, at, ..)| at[part]).collect();
        let rotation = |part: usize| changed.iter().map(|(_, _, turn, _)| turn[part]).collect();
        (self.px, self.py, self.pz) = (position(0), position(1), position(2));
        (self.qx, self.qy, self.qz, self.qw) = (rotation(0), rotation(1), rotation(2), rotation(3));
    }
}

/// Differences from the truth; `None` if a body has none, or is not on the grid.
fn differences(
    poses: impl Iterator<Item = PoseOf>,
    truth: &dyn Fn(BodyId) -> Option<([f32; 3], [f32; 4])>,
) -> Option<Vec<GridPose>> {
    poses
        .map(|(id, position, rotation)| {
            let pose = GridHistory::quantise(position, rotation)?;
            let (position, rotation) = truth(id)?;
            let real = GridHistory::quantise(position, rotation)?;
            Some(std::array::from_fn(|part| pose[part] - real[part]))
        })
        .collect()
}

/// A captured packet.
#[derive(Clone, PartialEq, prost::Message)]
pub struct Packet {
    /// The tick.
    #[prost(uint64, tag = "1")]
    pub tick: u64,
    /// Number of the frame, from 0.
    #[prost(uint32, tag = "2")]
    pub frame: u32,
    /// Number of the direction and kind.
    #[prost(int32, tag = "3")]
    pub direction: i32,
    /// The bytes, unless they are left out.
    #[prost(bytes = "bytes", tag = "4")]
    pub data: bytes::Bytes,
    /// Number of the bytes.
    #[prost(uint32, tag = "5")]
    pub length: u32,
}

/// Steps of the grid in a metre, and in a unit of a quaternion's components.
pub const STEPS: f64 = 1_048_576.0;
/// Poses further out are not on the grid: whole numbers stay exact in every language's floating-point numbers.
const LIMIT_M: f64 = (1_u64 << 31) as f64;

/// Position and quaternion in steps of the grid.
pub type GridPose = [i64; 7];

/// The last two poses of each body on one topic.
#[derive(Clone, Debug, Default)]
pub struct GridHistory(BTreeMap<BodyId, [GridPose; 2]>);

impl GridHistory {
    /// The point of the grid nearest to a pose; `None` for one that is too far out.
    #[must_use]
    pub fn quantise(position: [f32; 3], rotation: [f32; 4]) -> Option<GridPose> {
        let [px, py, pz] = position.map(f64::from);
        let [qx, qy, qz, qw] = rotation.map(f64::from);
        let parts = [px, py, pz, qx, qy, qz, qw];
        let fits = parts.iter().all(|part| part.abs() < LIMIT_M);
        fits.then(|| parts.map(|part| (part * STEPS + 0.5).floor() as i64))
    }

    /// The residual of a pose: its second difference, which becomes part of the history.
    pub fn encode(&mut self, id: BodyId, pose: GridPose) -> GridPose {
        let predicted = self.predict(id);
        self.note(id, pose);
        std::array::from_fn(|part| pose[part].wrapping_sub(predicted[part]))
    }

    /// The pose of a residual, which becomes part of the history.
    pub fn decode(&mut self, id: BodyId, residual: GridPose) -> GridPose {
        let predicted = self.predict(id);
        let pose = std::array::from_fn(|part| residual[part].wrapping_add(predicted[part]));
        self.note(id, pose);
        pose
    }

    /// Forgets a body, whose next pose is written whole.
    pub fn forget(&mut self, id: BodyId) {
        self.0.remove(&id);
    }

    fn predict(&self, id: BodyId) -> GridPose {
        let Some([last, before]) = self.0.get(&id) else {
            return [0; 7];
        };
        std::array::from_fn(|part| {
            let step = last[part].wrapping_sub(before[part]);
            last[part].wrapping_add(step)
        })
    }

    fn note(&mut self, id: BodyId, pose: GridPose) {
        let last = self.0.get(&id).map_or(pose, |[last, _]| *last);
        self.0.insert(id, [pose, last]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use prost::Message as _;
    use prost_types::{DescriptorProto, EnumDescriptorProto, FileDescriptorSet};

    use super::*;

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded(
            poses in prop::collection::vec((0_u32..3, prop::array::uniform7(any::<i64>())), 0..40),
        ) {
            let (mut from, mut to) = (GridHistory::default(), GridHistory::default());
            for (index, pose) in poses {
                let id = BodyId::new(index, 0);
                let residual = from.encode(id, pose);
                prop_assert_eq!(to.decode(id, residual), pose);
            }
        }

        #[test]
        fn a_pose_on_the_grid_is_within_half_a_step(
            position in prop::array::uniform3(-1e6_f32..1e6),
        ) {
            let pose = GridHistory::quantise(position, [0.0, 0.0, 0.0, 1.0]).unwrap();
            for (part, exact) in pose.iter().zip(position) {
                let error = *part as f64 / STEPS - f64::from(exact);
                prop_assert!(error.abs() <= 0.5 / STEPS, "{error}");
            }
        }
    }

    #[test]
    fn steady_motion_takes_small_residuals() {
        let (mut history, id) = (GridHistory::default(), BodyId::new(1, 0));
        let pose = |tick: i64| [tick * 1_000, -7 * tick, 0, 0, 0, 0, 1 << 20];
        assert_eq!(history.encode(id, pose(5)), pose(5), "the first is whole");
        history.encode(id, pose(6));
        assert_eq!(history.encode(id, pose(7)), [0; 7]);
    }

    #[test]
    fn a_pose_too_far_out_is_not_on_the_grid() {
        let rotation = [0.0, 0.0, 0.0, 1.0];
        assert!(GridHistory::quantise([3e9, 0.0, 0.0], rotation).is_none());
        assert!(GridHistory::quantise([f32::MAX; 3], rotation).is_none());
        assert!(GridHistory::quantise([2e9, 0.0, 0.0], rotation).is_some());
    }

    const SOURCE: &str = include_str!("../proto/rhumb.proto");
    const COMPILED: &[u8] = include_bytes!("../proto/rhumb.binpb");

    /// Names and numbers of the fields of each message and the values of each enumeration.
    type Named = BTreeMap<String, Vec<(String, i32)>>;

    fn from_source() -> Named {
        let mut named = Named::new();
        let mut inside = String::new();
        for line in SOURCE
            .lines()
            .map(str::trim)
            .filter(|line| !line.starts_with("//"))
        {
            let words: Vec<_> = line.trim_end_matches(';').split_whitespace().collect();
            match words.as_slice() {
                ["message" | "enum", name, "{"] => inside = (*name).to_owned(),
                [.., name, "=", number] if !inside.is_empty() => {
                    let number = number.parse().expect("a field has a number");
                    named
                        .entry(inside.clone())
                        .or_default()
                        .push(((*name).to_owned(), number));
                }
                _ => {}
            }
        }
        named
    }

    fn from_compiled() -> Named {
        let mut set = FileDescriptorSet::decode(COMPILED).expect("protoc output is valid");
        assert_eq!(set.file.len(), 1);
        let file = set.file.remove(0);
        assert_eq!(file.package(), "rhumb");
        let fields = |message: &DescriptorProto| {
            let fields = message
                .field
                .iter()
                .map(|field| (field.name().to_owned(), field.number()));
            (message.name().to_owned(), fields.collect())
        };
        let values = |list: &EnumDescriptorProto| {
            let values = list
                .value
                .iter()
                .map(|value| (value.name().to_owned(), value.number()));
            (list.name().to_owned(), values.collect())
        };
        let messages = file.message_type.iter().map(fields);
        messages.chain(file.enum_type.iter().map(values)).collect()
    }

    #[test]
    fn the_compiled_schema_matches_its_source() {
        let source = from_source();
        assert!(source.len() > 5 && source["States"].len() == 27);
        assert_eq!(source, from_compiled());
    }
}
