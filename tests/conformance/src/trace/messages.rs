//! The messages of a `rhumb-bench` trace, as far as the comparison needs them.
//!
//! Field numbers are those of `trace/proto/rhumb.proto`; other fields are skipped.

/// The engine's bodies at a tick.
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
    #[prost(bool, repeated, tag = "17")]
    pub(super) awake: Vec<bool>,
    #[prost(message, repeated, tag = "18")]
    pub(super) placed: Vec<Placement>,
    #[prost(uint32, repeated, tag = "19")]
    pub(super) removed_index: Vec<u32>,
    #[prost(uint32, repeated, tag = "20")]
    pub(super) removed_generation: Vec<u32>,
    #[prost(sint64, repeated, tag = "21")]
    pub(super) step_px: Vec<i64>,
    #[prost(sint64, repeated, tag = "22")]
    pub(super) step_py: Vec<i64>,
    #[prost(sint64, repeated, tag = "23")]
    pub(super) step_pz: Vec<i64>,
    #[prost(sint64, repeated, tag = "24")]
    pub(super) step_qx: Vec<i64>,
    #[prost(sint64, repeated, tag = "25")]
    pub(super) step_qy: Vec<i64>,
    #[prost(sint64, repeated, tag = "26")]
    pub(super) step_qz: Vec<i64>,
    #[prost(sint64, repeated, tag = "27")]
    pub(super) step_qw: Vec<i64>,
}

/// A placed body.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Placement {
    #[prost(uint32, tag = "1")]
    pub(super) index: u32,
    #[prost(uint32, tag = "2")]
    pub(super) generation: u32,
    #[prost(int32, tag = "3")]
    pub(super) kind: i32,
    #[prost(double, tag = "6")]
    pub(super) bounding_radius_m: f64,
    #[prost(float, repeated, tag = "7")]
    pub(super) motion: Vec<f32>,
    #[prost(sint32, tag = "9")]
    pub(super) tolerance_scale: i32,
}

/// The poses that a copy displayed at a frame: the changes since the frame before.
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
    #[prost(uint32, repeated, tag = "13")]
    pub(super) gone_index: Vec<u32>,
    #[prost(uint32, repeated, tag = "14")]
    pub(super) gone_generation: Vec<u32>,
    #[prost(sint64, repeated, tag = "15")]
    pub(super) step_px: Vec<i64>,
    #[prost(sint64, repeated, tag = "16")]
    pub(super) step_py: Vec<i64>,
    #[prost(sint64, repeated, tag = "17")]
    pub(super) step_pz: Vec<i64>,
    #[prost(sint64, repeated, tag = "18")]
    pub(super) step_qx: Vec<i64>,
    #[prost(sint64, repeated, tag = "19")]
    pub(super) step_qy: Vec<i64>,
    #[prost(sint64, repeated, tag = "20")]
    pub(super) step_qz: Vec<i64>,
    #[prost(sint64, repeated, tag = "21")]
    pub(super) step_qw: Vec<i64>,
    #[prost(bool, tag = "22")]
    pub(super) from_truth: bool,
}

/// A frame.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct TickStats {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, tag = "2")]
    pub(super) frame: u32,
    #[prost(uint64, tag = "10")]
    pub(super) body_ticks: u64,
}

/// A body whose error exceeded its tolerance, and the cause.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct Breach {
    #[prost(uint64, tag = "1")]
    pub(super) tick: u64,
    #[prost(uint32, tag = "2")]
    pub(super) index: u32,
    #[prost(uint32, tag = "3")]
    pub(super) generation: u32,
    #[prost(int32, tag = "6")]
    pub(super) cause: i32,
}

/// Columns of a pose: position, then rotation.
pub(super) type Columns<'a> = [&'a [f32]; 7];
/// Columns of residuals on the grid, in the same order.
pub(super) type Steps<'a> = [&'a [i64]; 7];

impl States {
    pub(super) fn columns(&self) -> Columns<'_> {
        [
            &self.px, &self.py, &self.pz, &self.qx, &self.qy, &self.qz, &self.qw,
        ]
    }

    pub(super) fn steps(&self) -> Steps<'_> {
        [
            &self.step_px,
            &self.step_py,
            &self.step_pz,
            &self.step_qx,
            &self.step_qy,
            &self.step_qz,
            &self.step_qw,
        ]
    }
}

impl Poses {
    pub(super) fn columns(&self) -> Columns<'_> {
        [
            &self.px, &self.py, &self.pz, &self.qx, &self.qy, &self.qz, &self.qw,
        ]
    }

    pub(super) fn steps(&self) -> Steps<'_> {
        [
            &self.step_px,
            &self.step_py,
            &self.step_pz,
            &self.step_qx,
            &self.step_qy,
            &self.step_qz,
            &self.step_qw,
        ]
    }
}

/// The pose at an index of these columns, if all columns have one.
pub(super) fn pose(columns: &Columns<'_>, place: usize) -> Option<[f32; 7]> {
    row(columns, place)
}

/// The residual at an index of these columns, if all columns have one.
pub(super) fn steps(columns: &Steps<'_>, place: usize) -> Option<[i64; 7]> {
    row(columns, place)
}

fn row<T: Copy + Default>(columns: &[&[T]; 7], place: usize) -> Option<[T; 7]> {
    let mut row = [T::default(); 7];
    for (part, column) in row.iter_mut().zip(columns) {
        *part = *column.get(place)?;
    }
    Some(row)
}
