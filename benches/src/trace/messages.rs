//! Trace messages, as `proto/rhumb.proto` defines them.
//!
//! Each trace embeds the schema as compiled by protoc. The compiled form is checked in; a test compares it with its
//! source.

use rhumb_protocol::scene::{BodyKind, Shape as Solid};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, Tick};

use crate::quantile::rank;
use crate::record::{self, CapturedPacket, CopiedPose, Frame, Placed};

/// `proto/rhumb.proto` as `protoc --descriptor_set_out=rhumb.binpb rhumb.proto` compiles it.
pub(super) const DESCRIPTORS: &[u8] = include_bytes!("../../proto/rhumb.binpb");

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct TickStats {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, tag = "2")]
    pub(super) frame: u32,
    #[prost(uint64, tag = "3")]
    pub(super) frame_ns: u64,
    #[prost(uint64, tag = "4")]
    pub(super) wire_bytes_down: u64,
    #[prost(uint64, tag = "5")]
    pub(super) wire_bytes_up: u64,
    #[prost(uint64, tag = "6")]
    pub(super) wire_datagrams_down: u64,
    #[prost(uint64, tag = "7")]
    pub(super) wire_datagrams_up: u64,
    #[prost(uint64, tag = "8")]
    pub(super) payload_bytes_down: u64,
    #[prost(uint64, tag = "9")]
    pub(super) updates: u64,
    #[prost(uint64, tag = "10")]
    pub(super) body_ticks: u64,
    #[prost(double, tag = "11")]
    pub(super) error_m_p50: f64,
    #[prost(double, tag = "12")]
    pub(super) error_m_p99: f64,
    #[prost(double, tag = "13")]
    pub(super) error_m_max: f64,
}

impl TickStats {
    pub(super) fn of(number: u32, frame: &Frame, payload_bytes_down: u64) -> Self {
        let exact = frame.exact as usize;
        let count = exact + frame.errors_m.len();
        let error = |percent| {
            let place = rank(percent, count)?.checked_sub(exact)?;
            frame.errors_m.get(place).copied().map(f64::from)
        };
        Self {
            tick: frame.tick.value(),
            frame: number,
            frame_ns: frame.frame_ns,
            wire_bytes_down: frame.wire_bytes_down,
            wire_bytes_up: frame.wire_bytes_up,
            wire_datagrams_down: frame.wire_datagrams_down,
            wire_datagrams_up: frame.wire_datagrams_up,
            payload_bytes_down,
            updates: frame.updates,
            body_ticks: count as u64,
            error_m_p50: error(50).unwrap_or(0.0),
            error_m_p99: error(99).unwrap_or(0.0),
            error_m_max: error(100).unwrap_or(0.0),
        }
    }
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct BreachMessage {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, tag = "2")]
    pub(super) index: u32,
    #[prost(uint32, tag = "3")]
    pub(super) generation: u32,
    #[prost(double, tag = "4")]
    pub(super) error_m: f64,
    #[prost(double, tag = "5")]
    pub(super) tolerance_m: f64,
    #[prost(int32, tag = "6")]
    pub(super) cause: i32,
}

impl From<&record::Breach> for BreachMessage {
    fn from(breach: &record::Breach) -> Self {
        Self {
            tick: breach.tick.value(),
            index: breach.id.index(),
            generation: u32::from(breach.id.generation()),
            error_m: breach.error_m,
            tolerance_m: breach.tolerance_m,
            cause: match breach.cause {
                record::Cause::Loss => 1,
                record::Cause::Late => 2,
                record::Cause::Fault => 3,
                record::Cause::Budget => 4,
            },
        }
    }
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct States {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, repeated, tag = "2")]
    pub(super) index: Vec<u32>,
    #[prost(uint32, repeated, tag = "3")]
    pub(super) generation: Vec<u32>,
    #[prost(float, repeated, tag = "4")]
    pub(super) px: Vec<f32>,
    #[prost(float, repeated, tag = "5")]
    pub(super) py: Vec<f32>,
    #[prost(float, repeated, tag = "6")]
    pub(super) pz: Vec<f32>,
    #[prost(float, repeated, tag = "7")]
    pub(super) qx: Vec<f32>,
    #[prost(float, repeated, tag = "8")]
    pub(super) qy: Vec<f32>,
    #[prost(float, repeated, tag = "9")]
    pub(super) qz: Vec<f32>,
    #[prost(float, repeated, tag = "10")]
    pub(super) qw: Vec<f32>,
    #[prost(float, repeated, tag = "11")]
    pub(super) vx: Vec<f32>,
    #[prost(float, repeated, tag = "12")]
    pub(super) vy: Vec<f32>,
    #[prost(float, repeated, tag = "13")]
    pub(super) vz: Vec<f32>,
    #[prost(float, repeated, tag = "14")]
    pub(super) wx: Vec<f32>,
    #[prost(float, repeated, tag = "15")]
    pub(super) wy: Vec<f32>,
    #[prost(float, repeated, tag = "16")]
    pub(super) wz: Vec<f32>,
    #[prost(bool, repeated, tag = "17")]
    pub(super) awake: Vec<bool>,
    #[prost(message, repeated, tag = "18")]
    pub(super) placed: Vec<Placement>,
    #[prost(uint32, repeated, tag = "19")]
    pub(super) removed_index: Vec<u32>,
    #[prost(uint32, repeated, tag = "20")]
    pub(super) removed_generation: Vec<u32>,
}

impl States {
    pub(super) fn of(
        tick: Tick,
        observed: &[Observation],
        placed: &[Placed],
        removed: &[(Tick, BodyId)],
    ) -> Self {
        let column = |part: usize| observed.iter().map(|o| o.motion.parts()[part]).collect();
        Self {
            tick: tick.value(),
            index: observed.iter().map(|o| o.id.index()).collect(),
            generation: observed.iter().map(|o| o.id.generation().into()).collect(),
            px: column(0),
            py: column(1),
            pz: column(2),
            qx: column(3),
            qy: column(4),
            qz: column(5),
            qw: column(6),
            vx: column(7),
            vy: column(8),
            vz: column(9),
            wx: column(10),
            wy: column(11),
            wz: column(12),
            awake: observed
                .iter()
                .map(|o| o.activity == Activity::Awake)
                .collect(),
            placed: placed.iter().map(Placement::from).collect(),
            removed_index: removed.iter().map(|(_, id)| id.index()).collect(),
            removed_generation: removed
                .iter()
                .map(|(_, id)| id.generation().into())
                .collect(),
        }
    }
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Placement {
    #[prost(uint32, tag = "1")]
    pub(super) index: u32,
    #[prost(uint32, tag = "2")]
    pub(super) generation: u32,
    #[prost(int32, tag = "3")]
    pub(super) kind: i32,
    #[prost(int32, tag = "4")]
    pub(super) shape: i32,
    #[prost(float, repeated, tag = "5")]
    pub(super) extents: Vec<f32>,
    #[prost(double, tag = "6")]
    pub(super) bounding_radius_m: f64,
    #[prost(float, repeated, tag = "7")]
    pub(super) motion: Vec<f32>,
    #[prost(bool, tag = "8")]
    pub(super) awake: bool,
    #[prost(sint32, tag = "9")]
    pub(super) tolerance_scale: i32,
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
            // No script uses these shapes; they are drawn, but the trace has no number for them.
            Solid::Heights(_)
            | Solid::Mesh(_)
            | Solid::Compound(_)
            | Solid::RoundedCuboid { .. }
            | Solid::Cone { .. }
            | Solid::HalfSpace { .. } => (0, Vec::new()),
        };
        Self {
            index: placed.desc.id.index(),
            generation: placed.desc.id.generation().into(),
            kind: match placed.desc.kind {
                BodyKind::Static => 1,
                BodyKind::Dynamic => 2,
                BodyKind::Kinematic => 3,
            },
            shape,
            extents,
            bounding_radius_m: placed.shape.bounding_radius().metres(),
            motion: placed.observation.motion.parts().into(),
            awake: placed.observation.activity == Activity::Awake,
            tolerance_scale: placed.desc.tolerance_scale.exponent().into(),
        }
    }
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Poses {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, tag = "2")]
    pub(super) frame: u32,
    #[prost(uint32, repeated, tag = "3")]
    pub(super) index: Vec<u32>,
    #[prost(uint32, repeated, tag = "4")]
    pub(super) generation: Vec<u32>,
    #[prost(float, repeated, tag = "5")]
    pub(super) px: Vec<f32>,
    #[prost(float, repeated, tag = "6")]
    pub(super) py: Vec<f32>,
    #[prost(float, repeated, tag = "7")]
    pub(super) pz: Vec<f32>,
    #[prost(float, repeated, tag = "8")]
    pub(super) qx: Vec<f32>,
    #[prost(float, repeated, tag = "9")]
    pub(super) qy: Vec<f32>,
    #[prost(float, repeated, tag = "10")]
    pub(super) qz: Vec<f32>,
    #[prost(float, repeated, tag = "11")]
    pub(super) qw: Vec<f32>,
    #[prost(bool, repeated, tag = "12")]
    pub(super) resting: Vec<bool>,
    #[prost(uint32, repeated, tag = "13")]
    pub(super) gone_index: Vec<u32>,
    #[prost(uint32, repeated, tag = "14")]
    pub(super) gone_generation: Vec<u32>,
}

impl Poses {
    pub(super) fn of(number: u32, frame: &Frame) -> Self {
        let changed: &[CopiedPose] = &frame.changed;
        let position = |part: usize| changed.iter().map(|s| s.position[part]).collect();
        let rotation = |part: usize| changed.iter().map(|s| s.rotation[part]).collect();
        Self {
            tick: frame.tick.value(),
            frame: number,
            index: changed.iter().map(|s| s.id.index()).collect(),
            generation: changed.iter().map(|s| s.id.generation().into()).collect(),
            px: position(0),
            py: position(1),
            pz: position(2),
            qx: rotation(0),
            qy: rotation(1),
            qz: rotation(2),
            qw: rotation(3),
            resting: changed.iter().map(|s| s.resting).collect(),
            gone_index: frame.removed.iter().map(|id| id.index()).collect(),
            gone_generation: frame
                .removed
                .iter()
                .map(|id| id.generation().into())
                .collect(),
        }
    }
}

#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Packet {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, tag = "2")]
    pub(super) frame: u32,
    #[prost(int32, tag = "3")]
    pub(super) direction: i32,
    #[prost(bytes = "bytes", tag = "4")]
    pub(super) data: bytes::Bytes,
}

impl Packet {
    pub(super) fn of(tick: Tick, captured: &CapturedPacket) -> Self {
        Self {
            tick: tick.value(),
            frame: captured.frame,
            direction: match captured.direction {
                record::PacketDirection::StateDown => 1,
                record::PacketDirection::StateUp => 2,
                record::PacketDirection::ControlDown => 3,
                record::PacketDirection::ControlUp => 4,
            },
            data: captured.bytes.clone(),
        }
    }
}
