//! Foreign recordings: `.rhtrace` 1, of boxes; packed by zstd or not.
//!
//! `spec/RHTRACE.md` has the layout. A body without a record in a
//! frame has not changed, so it sleeps whatever its last flag. Damping is not stored and taken as zero, with one
//! substep.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use glam::Vec3;
use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Integrator, Tick};

use super::error::RecordingError;
use super::options::rate_of_step;
use super::recorded::{self, FRAMES_MAX, Recording, Velocities, activity_from_records, set_digest};
use super::rhtrace2::{self, ByteReader};
use crate::record::{Placed, Truth};

/// Largest relative change of a step by rounding to single precision, with a margin of two.
const ROUNDED: f64 = 1.2e-7;

/// Magic number at the start of the file.
pub const MAGIC: [u8; 8] = *b"RHTRACE1";

/// Limit of the decompressed size: two gigabytes.
const BYTES_MAX: u64 = 2 << 30;

/// The body is awake.
const AWAKE: u8 = 1;
/// The body is gone after this frame.
const GONE: u8 = 2;

/// True for bytes that begin as an `.rhtrace` of either version.
pub(super) fn is_plain(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC) || bytes.starts_with(&rhtrace2::MAGIC)
}

/// Reads a recording.
///
/// # Errors
///
/// [`RecordingError`] if the bytes are no recording.
pub fn read(name: &str, bytes: &[u8]) -> Result<Recording, RecordingError> {
    if is_plain(bytes) {
        return read_plain(name, bytes);
    }
    use std::io::Read as _;
    let decoder = zstd::Decoder::new(bytes).map_err(RecordingError::Unpack)?;
    let mut plain = Vec::new();
    let mut limited = decoder.take(BYTES_MAX);
    limited
        .read_to_end(&mut plain)
        .map_err(RecordingError::Unpack)?;
    read_plain(name, &plain)
}

fn read_plain(name: &str, bytes: &[u8]) -> Result<Recording, RecordingError> {
    let mut reader = ByteReader::new(bytes);
    let magic: [u8; 8] = reader.take()?;
    if magic == rhtrace2::MAGIC {
        return rhtrace2::read(name, &bytes[magic.len()..]);
    }
    if magic != MAGIC {
        return Err(RecordingError::NotARecording);
    }
    let (bodies, frames) = (reader.u32()?, reader.u32()?);
    if frames < 2 {
        return Err(RecordingError::NoTruth);
    }
    if bodies > BODIES_MAX {
        return Err(RecordingError::Bodies {
            bodies: u64::from(bodies),
        });
    }
    if frames > FRAMES_MAX {
        return Err(RecordingError::Frames { frames });
    }
    let step_s = f64::from(reader.f32()?);
    let gravity = Vec3::from_array(reader.f32s()?);
    let rate = rate_of_step(step_s, ROUNDED).ok_or(RecordingError::Step { step_s })?;
    let mut shapes = Vec::new();
    for index in 0..bodies {
        shapes.push(shape(&mut reader, index)?);
    }
    let mut truth = Truth::default();
    let mut there = vec![Stay::default(); shapes.len()];
    for frame in 0..u64::from(frames) {
        reader.begin(frame);
        let tick = Tick::new(frame);
        let row = row(&mut reader, tick, &shapes, (&mut there, &mut truth))?;
        if frame > 0 {
            truth.ticks.push(row);
        }
    }
    reader.end()?;
    activity_from_records(&mut truth);
    set_digest(&mut truth);
    let is_still = |observation: &Observation| observation.motion == observation.motion.stilled();
    let placed = truth.placed.iter().map(|placed| &placed.observation);
    let has_velocities = !placed.chain(truth.ticks.iter().flatten()).all(is_still);
    let mut recording = Recording {
        name: name.to_owned(),
        played: None,
        truth,
        integrator: Integrator {
            rate,
            substeps: NonZeroU32::MIN,
        },
        gravity,
        damping: Damping::default(),
        inertias: BTreeMap::new(),
        velocities: Velocities::Recorded,
        notes: Vec::new(),
    };
    let moves = recording.truth.ticks.iter().any(|row| !row.is_empty());
    if moves && !has_velocities {
        let note = "all velocities are zero, so they are fitted to the poses";
        recording.notes.push(note.to_owned());
        recorded::derive(&mut recording)?;
        set_digest(&mut recording.truth);
    }
    Ok(recording)
}

/// Presence of a body, and the number of times that it was added.
#[derive(Clone, Copy, Debug, Default)]
struct Stay {
    is_there: bool,
    generation: u16,
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

/// The records of a frame. A body's first record places it; all of frame 0 are such.
fn row(
    reader: &mut ByteReader<'_>,
    tick: Tick,
    shapes: &[Shape],
    (there, truth): (&mut [Stay], &mut Truth),
) -> Result<Vec<Observation>, RecordingError> {
    let count = reader.u16()?;
    let mut row: Vec<Observation> = Vec::with_capacity(count.into());
    let mut last = None;
    for _ in 0..count {
        let index = u32::from(reader.u16()?);
        let (position, rotation) = (reader.f32s()?, reader.f32s()?);
        let (linear, angular) = (reader.f32s()?, reader.f32s()?);
        let [flags] = reader.take()?;
        let in_order = last.is_none_or(|last| last < index);
        let (Some(shape), true) = (shapes.get(index as usize), in_order) else {
            return Err(RecordingError::Record { tick, index });
        };
        last = Some(index);
        let motion = BodyState::new(position, rotation, linear, angular);
        let stay = &mut there[index as usize];
        let observation = Observation {
            id: BodyId::new(index, stay.generation),
            motion: motion.map_err(|_| RecordingError::Number { tick, index })?,
            activity: match flags & AWAKE {
                0 => Activity::Asleep,
                _ => Activity::Awake,
            },
        };
        if stay.is_there {
            row.push(observation);
        } else {
            stay.is_there = true;
            truth.placed.push(Placed {
                tick,
                desc: BodyDesc::plain(observation.id, BodyKind::Dynamic, ShapeId(index)),
                shape: shape.clone(),
                observation,
                inertia: None,
            });
        }
        if flags & GONE != 0 {
            truth.removed.push((tick, observation.id));
            stay.is_there = false;
            stay.generation = stay.generation.wrapping_add(1);
        }
    }
    Ok(row)
}
