//! Foreign recordings of boxes: `.rhtrace.zst`.
//!
//! Little-endian, compressed by zstd as a whole. Header: the magic; u32 bodies, u32 frames; f32 seconds per frame;
//! three f32 of gravity. For each body four f32: half extents and bounding radius. For each frame a u16 count and that
//! many records.
//!
//! A record is a u16 body, thirteen f32 (position, quaternion x y z w, linear and angular velocity) and a u8 whose bit
//! 0 means awake. A body without a record in a frame has not changed, so it sleeps whatever its last flag. Frame 0 has
//! a record of every body. Damping is not stored and taken as zero, with one substep.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use glam::Vec3;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Integrator, Rate, Tick};
use rhumb_server::Digest;

use super::error::RecordingError;
use super::recorded::Recording;
use crate::record::{Placed, Truth};

/// Magic number at the start of the file.
pub const MAGIC: [u8; 8] = *b"RHTRACE1";

/// Limit of the decompressed size: two gigabytes.
const BYTES_MAX: u64 = 2 << 30;
/// Limit of the frame count: two days at 60 Hz. An empty frame takes two bytes and compresses to almost nothing.
const FRAMES_MAX: u32 = 10_368_000;

/// Reads a compressed recording.
///
/// # Errors
///
/// [`RecordingError`] if the bytes are no recording.
pub fn read(name: &str, packed: &[u8]) -> Result<Recording, RecordingError> {
    use std::io::Read as _;
    let decoder = zstd::Decoder::new(packed).map_err(RecordingError::Unpack)?;
    let mut bytes = Vec::new();
    let mut limited = decoder.take(BYTES_MAX);
    limited
        .read_to_end(&mut bytes)
        .map_err(RecordingError::Unpack)?;
    let mut reader = ByteReader { rest: &bytes };
    if reader.take()? != MAGIC {
        return Err(RecordingError::NotARecording);
    }
    let (bodies, frames) = (reader.u32()?, reader.u32()?);
    if frames == 0 {
        return Err(RecordingError::NoTruth);
    }
    if frames > FRAMES_MAX {
        return Err(RecordingError::Frames { frames });
    }
    let step_s = reader.f32()?;
    let gravity = Vec3::from_array(reader.f32s()?);
    let integrator = Integrator {
        rate: rate(f64::from(step_s))?,
        substeps: NonZeroU32::MIN,
    };
    let mut shapes = Vec::new();
    for index in 0..bodies {
        shapes.push(shape(&mut reader, index)?);
    }
    let mut truth = Truth::default();
    for frame in 0..u64::from(frames) {
        let row = row(&mut reader, Tick::new(frame), bodies)?;
        if frame == 0 {
            truth.placed = place(row, &shapes)?;
        } else {
            truth.ticks.push(row);
        }
    }
    if !reader.rest.is_empty() {
        return Err(RecordingError::Length);
    }
    activity_from_records(&mut truth);
    let mut digest = Digest::START;
    for (row, tick) in truth.ticks.iter().zip(1..) {
        digest.fold_tick(Tick::new(tick), row);
    }
    truth.digest = digest.value();
    Ok(Recording {
        name: name.to_owned(),
        played: None,
        truth,
        integrator,
        gravity,
        damping: Damping::default(),
        inertias: BTreeMap::new(),
    })
}

/// Derives activity from the records instead of the flags. A body with a record in the next frame moves, so it is
/// awake; a body without one has not changed, so it sleeps.
fn activity_from_records(truth: &mut Truth) {
    let is_in = |row: &[Observation], of: &Observation| {
        let found = row.binary_search_by_key(&of.id.index(), |observation| observation.id.index());
        found.is_ok()
    };
    if let Some(first) = truth.ticks.first() {
        for placed in &mut truth.placed {
            if !is_in(first, &placed.observation) {
                placed.observation.activity = Activity::Asleep;
            }
        }
    }
    for next in 1..truth.ticks.len() {
        let (before, after) = truth.ticks.split_at_mut(next);
        for observation in &mut before[next - 1] {
            observation.activity = match is_in(&after[0], observation) {
                true => Activity::Awake,
                false => Activity::Asleep,
            };
        }
    }
}

/// The whole rate nearest to a step; they must agree up to rounding.
pub(super) fn rate(step_s: f64) -> Result<Rate, RecordingError> {
    let wrong = RecordingError::Step { step_s };
    let hertz = (1.0 / step_s).round();
    if !(1.0..=1_000.0).contains(&hertz) || (hertz * step_s - 1.0).abs() > 1e-5 {
        return Err(wrong);
    }
    Rate::new(hertz as u32, 1).ok_or(wrong)
}

fn shape(reader: &mut ByteReader<'_>, index: u32) -> Result<Shape, RecordingError> {
    let half_extents = Vec3::from_array(reader.f32s()?);
    let radius = f64::from(reader.f32()?);
    let shape = Shape::Cuboid { half_extents };
    let computed = shape.bounding_radius().metres();
    let fits = (computed - radius).abs() <= 1e-4 * computed;
    if shape.check().is_err() || !fits {
        return Err(RecordingError::Extents { index });
    }
    Ok(shape)
}

fn row(
    reader: &mut ByteReader<'_>,
    tick: Tick,
    bodies: u32,
) -> Result<Vec<Observation>, RecordingError> {
    let count = reader.u16()?;
    let mut row: Vec<Observation> = Vec::with_capacity(count.into());
    for _ in 0..count {
        let index = u32::from(reader.u16()?);
        let (position, rotation) = (reader.f32s()?, reader.f32s()?);
        let (linear, angular) = (reader.f32s()?, reader.f32s()?);
        let [flags] = reader.take()?;
        let in_order = row.last().is_none_or(|last| last.id.index() < index);
        if index >= bodies || !in_order {
            return Err(RecordingError::Record { tick, index });
        }
        let motion = BodyState::new(position, rotation, linear, angular);
        let awake = flags & 1 == 1;
        row.push(Observation {
            id: BodyId::new(index, 0),
            motion: motion.map_err(|_| RecordingError::Number { tick })?,
            activity: if awake {
                Activity::Awake
            } else {
                Activity::Asleep
            },
        });
    }
    Ok(row)
}

/// Placements of all bodies from frame 0.
fn place(row: Vec<Observation>, shapes: &[Shape]) -> Result<Vec<Placed>, RecordingError> {
    if row.len() != shapes.len() {
        return Err(RecordingError::NoTruth);
    }
    let placed = row.into_iter().zip(shapes).zip(0..);
    Ok(placed
        .map(|((observation, shape), number)| Placed {
            tick: Tick::ZERO,
            desc: BodyDesc::plain(observation.id, BodyKind::Dynamic, ShapeId(number)),
            shape: shape.clone(),
            observation,
        })
        .collect())
}

/// Reader over the remaining bytes.
struct ByteReader<'a> {
    rest: &'a [u8],
}

impl ByteReader<'_> {
    fn take<const COUNT: usize>(&mut self) -> Result<[u8; COUNT], RecordingError> {
        let (taken, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(RecordingError::Length)?;
        self.rest = rest;
        Ok(*taken)
    }

    fn u16(&mut self) -> Result<u16, RecordingError> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Result<u32, RecordingError> {
        self.take().map(u32::from_le_bytes)
    }

    fn f32(&mut self) -> Result<f32, RecordingError> {
        self.take().map(f32::from_le_bytes)
    }

    fn f32s<const COUNT: usize>(&mut self) -> Result<[f32; COUNT], RecordingError> {
        let mut all = [0.0; COUNT];
        for one in &mut all {
            *one = self.f32()?;
        }
        Ok(all)
    }
}
