//! Foreign recordings: `.rhtrace` 1 and 2; packed by zstd or not.
//!
//! `spec/RHTRACE.md` has both layouts. Version 1 has boxes: a body without a record in a frame has not changed, so it sleeps
//! whatever its last flag; damping is not stored and taken as zero, with one substep. Version 2 has the parameters that
//! predictions need. Reading it turns poses into those of the centres of mass, and damping into this project's formula.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU32;

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{BODIES_MAX, GRAVITY_MAX, SUBSTEPS_MAX};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Damping, Inertia, Integrator, Rate, Tick};

use super::error::{Place, RecordingError, RowDefect};
use super::options::rate_of_step;
use super::recorded;
use super::recorded::{FRAMES_MAX, Recording, Velocities, activity_from_records, set_digest};
use crate::record::{Placed, Truth};

/// Largest relative change of a step by rounding to single precision, with a margin of two.
const ROUNDED: f64 = 1.2e-7;

/// Magic number at the start of a file of version 1.
pub const MAGIC: [u8; 8] = *b"RHTRACE1";

/// Limit of the decompressed size: two gigabytes.
const BYTES_MAX: u64 = 2 << 30;

/// The body is awake.
const AWAKE: u8 = 1;
/// The body is gone after this frame.
const GONE: u8 = 2;

/// True for bytes that begin as an `.rhtrace` of either version.
pub(super) fn is_plain(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC) || bytes.starts_with(&MAGIC_2)
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
    if magic == MAGIC_2 {
        return read_second(name, &bytes[magic.len()..]);
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
        shapes.push(box_shape(&mut reader, index)?);
    }
    let mut truth = Truth::default();
    let mut there = vec![Stay::default(); shapes.len()];
    for frame in 0..u64::from(frames) {
        reader.begin(frame);
        let tick = Tick::new(frame);
        let row = first_row(&mut reader, tick, &shapes, (&mut there, &mut truth))?;
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

/// Presence of a body, and the number of times that it went.
#[derive(Clone, Copy, Debug, Default)]
struct Stay {
    is_there: bool,
    ended: u32,
}

fn box_shape(reader: &mut ByteReader<'_>, index: u32) -> Result<Shape, RecordingError> {
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
fn first_row(
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
            id: stay_id(index, stay.ended)?,
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
            stay.ended += 1;
        }
    }
    Ok(row)
}

/// Magic number at the start of the file.
const MAGIC_2: [u8; 8] = *b"RHTRACE2";

/// Largest damping, 1/s.
const DAMPING_MAX: f64 = 1_000.0;
/// Largest distance of the centre of mass from the origin, metres.
const CENTRE_MAX: f32 = 1_000.0;

/// The body has not changed in this frame: the record says that it is gone, and no more.
const UNCHANGED: u8 = 4;

/// The axis of a body's spin wanders as its moments say.
const GYROSCOPIC: u8 = 1;
/// Moments of inertia follow.
const MOMENTS: u8 = 2;

/// The formula by which damping takes velocity in a tick of this many seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DampingFormula {
    /// v / (1 + d·t): Rapier, and this project.
    Implicit,
    /// v·exp(−d·t).
    Exponential,
    /// v·(1 − d·t): Jolt, Bullet's older ones.
    Explicit,
    /// v·(1 − d)^t: PyBullet, cannon-es.
    Share,
}

impl DampingFormula {
    fn of(number: u8) -> Option<Self> {
        let all = [
            Self::Implicit,
            Self::Exponential,
            Self::Explicit,
            Self::Share,
        ];
        all.get(usize::from(number)).copied()
    }

    /// The damping of our formula that takes as much in a tick.
    fn ours(self, damping: f32, step_s: f64) -> Option<f32> {
        let d = f64::from(damping);
        let kept = match self {
            Self::Implicit => return (0.0..=DAMPING_MAX).contains(&d).then_some(damping),
            Self::Exponential => (-d * step_s).exp(),
            Self::Explicit => 1.0 - d * step_s,
            Self::Share => (1.0 - d).max(0.0).powf(step_s),
        };
        let ours = (1.0 / kept - 1.0) / step_s;
        (0.0..=DAMPING_MAX).contains(&ours).then_some(ours as f32)
    }
}

/// The point of a body to which the velocities of a file belong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum VelocityPoint {
    Centre,
    Origin,
    None,
}

/// A body's constants.
struct Body {
    desc: BodyDesc,
    shape: Shape,
    inertia: Option<Inertia>,
    /// From the origin, body axes.
    centre: Vec3,
    is_there: bool,
    /// Those that have ended.
    stays: u32,
}

/// Reads the bytes behind the magic number.
fn read_second(name: &str, bytes: &[u8]) -> Result<Recording, RecordingError> {
    let mut reader = ByteReader::new(bytes);
    let (bodies, frames) = (reader.u32()?, reader.u32()?);
    if frames < 2 {
        return Err(RecordingError::NoTruth);
    }
    if frames > FRAMES_MAX {
        return Err(RecordingError::Frames { frames });
    }
    if bodies > BODIES_MAX {
        return Err(RecordingError::Bodies {
            bodies: u64::from(bodies),
        });
    }
    let (ticks, seconds) = (reader.u32()?, reader.u32()?);
    let step_s = f64::from(seconds) / f64::from(ticks);
    let rate = Rate::new(ticks, seconds).filter(|_| (0.001..=1.0).contains(&step_s));
    let rate = rate.ok_or(RecordingError::Step { step_s })?;
    let head = |of| RecordingError::Row {
        place: Place::Whole,
        defect: RowDefect::OutOfRange { of, most: None },
    };
    let substeps = reader.u32()?.max(1);
    let substeps = NonZeroU32::new(substeps).filter(|count| count.get() <= SUBSTEPS_MAX);
    let substeps = substeps.ok_or_else(|| head("number of substeps (1 to 16)"))?;
    let gravity = Vec3::from_array(reader.f32s()?);
    if !gravity.is_finite() || gravity.abs().max_element() > GRAVITY_MAX {
        return Err(head("gravity"));
    }
    let [formula, point] = reader.take()?;
    let formula = DampingFormula::of(formula).ok_or_else(|| head("damping formula"))?;
    let point = match point {
        0 => VelocityPoint::Centre,
        1 => VelocityPoint::Origin,
        2 => VelocityPoint::None,
        _ => return Err(head("point of the velocities")),
    };
    let mut all = Vec::new();
    for index in 0..bodies {
        all.push(body(&mut reader, index, (formula, step_s))?);
    }
    let mut truth = Truth::default();
    for frame in 0..u64::from(frames) {
        reader.begin(frame);
        let row = row(&mut reader, frame, &mut all, (point, &mut truth))?;
        if frame > 0 {
            truth.ticks.push(row);
        }
    }
    reader.end()?;
    activity_from_records(&mut truth);
    let mut recording = Recording {
        name: name.to_owned(),
        played: None,
        truth,
        integrator: Integrator { rate, substeps },
        gravity,
        damping: Damping::default(),
        inertias: BTreeMap::new(),
        velocities: Velocities::Recorded,
        notes: Vec::new(),
    };
    if point == VelocityPoint::None {
        let note = "the file has no velocities, so they are fitted to the poses";
        recording.notes.push(note.to_owned());
        recorded::derive(&mut recording)?;
    }
    set_digest(&mut recording.truth);
    Ok(recording)
}

fn body(
    reader: &mut ByteReader<'_>,
    index: u32,
    (formula, step_s): (DampingFormula, f64),
) -> Result<Body, RecordingError> {
    let wrong = |of| RecordingError::Row {
        place: Place::Record {
            frame: 0,
            body: u64::from(index),
        },
        defect: RowDefect::OutOfRange { of, most: None },
    };
    let [kind, flags] = reader.take()?;
    let kind = match kind {
        0 => BodyKind::Fixed,
        1 => BodyKind::Dynamic,
        2 => BodyKind::Kinematic,
        _ => return Err(wrong("kind")),
    };
    let [linear, angular, gravity_scale] = reader.f32s()?;
    let ours = |damping| {
        formula
            .ours(damping, step_s)
            .ok_or_else(|| wrong("damping"))
    };
    let damping = Damping {
        linear: ours(linear)?,
        angular: ours(angular)?,
    };
    let centre = Vec3::from_array(reader.f32s()?);
    // NaN is none.
    let is_near = centre.abs().max_element() <= CENTRE_MAX;
    if !is_near || !centre.is_finite() {
        return Err(wrong("centre of mass"));
    }
    let mut inertia = None;
    if flags & MOMENTS != 0 {
        let (moments, frame) = (reader.f32s()?, reader.f32s()?);
        let read = Inertia::new(moments, frame);
        inertia = Some(read.map_err(|_| wrong("moments of inertia"))?);
    }
    let shape = shape(reader)?;
    let shape = shape.filter(|shape| shape.check().is_ok());
    let shape = shape.ok_or_else(|| wrong("shape"))?;
    let shape = if centre == Vec3::ZERO {
        shape
    } else {
        // Only the bounding radius matters, which is that about the centre.
        let radius = shape.bounding_radius().metres() as f32 + centre.length();
        Shape::Ball { radius }
    };
    let desc = BodyDesc {
        damping: Some(damping),
        gravity_scale,
        gyroscopic: flags & GYROSCOPIC != 0,
        ..BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(index))
    };
    desc.check().map_err(|_| wrong("gravity factor"))?;
    Ok(Body {
        desc,
        shape,
        inertia: inertia.filter(|inertia| !inertia.is_isotropic()),
        centre,
        is_there: false,
        stays: 0,
    })
}

/// A shape; `None` for an unknown one.
fn shape(reader: &mut ByteReader<'_>) -> Result<Option<Shape>, RecordingError> {
    let [number] = reader.take()?;
    Ok(Some(match number {
        // Any shape within this distance of the origin.
        0 | 1 => Shape::Ball {
            radius: reader.f32()?,
        },
        2 => Shape::Cuboid {
            half_extents: Vec3::from_array(reader.f32s()?),
        },
        3..=5 => {
            let [half_height, radius] = reader.f32s()?;
            match number {
                3 => Shape::Capsule {
                    half_height,
                    radius,
                },
                4 => Shape::Cylinder {
                    half_height,
                    radius,
                },
                _ => Shape::Cone {
                    half_height,
                    radius,
                },
            }
        }
        6 => Shape::RoundedCuboid {
            half_extents: Vec3::from_array(reader.f32s()?),
            radius: reader.f32()?,
        },
        _ => return Ok(None),
    }))
}

/// True for flags that stand for something. A body that goes without a change was there.
const fn is_sound(flags: u8, is_there: bool) -> bool {
    let is_known = flags & !(AWAKE | GONE | UNCHANGED) == 0;
    is_known && (flags & UNCHANGED == 0 || flags & GONE != 0 && is_there)
}

/// The id of a body after as many stays.
fn stay_id(index: u32, stays: u32) -> Result<BodyId, RecordingError> {
    let generation = u16::try_from(stays);
    let generation = generation.map_err(|_| RecordingError::Stays {
        body: index.to_string(),
    });
    Ok(BodyId::new(index, generation?))
}

/// The records of a frame. A body's first record places it.
fn row(
    reader: &mut ByteReader<'_>,
    frame: u64,
    bodies: &mut [Body],
    (point, truth): (VelocityPoint, &mut Truth),
) -> Result<Vec<Observation>, RecordingError> {
    let tick = Tick::new(frame);
    let mut row = Vec::new();
    let mut last = None;
    for _ in 0..reader.u32()? {
        let index = reader.u32()?;
        let (position, rotation) = (reader.f32s()?, reader.f32s()?);
        let (linear, angular) = (reader.f32s()?, reader.f32s()?);
        let [flags] = reader.take()?;
        let in_order = last.is_none_or(|last| last < index);
        let (Some(body), true) = (bodies.get_mut(index as usize), in_order) else {
            return Err(RecordingError::Record { tick, index });
        };
        if !is_sound(flags, body.is_there) {
            return Err(RecordingError::Flags { tick, index, flags });
        }
        last = Some(index);
        let turn = Quat::from_array(rotation);
        let arm = turn * body.centre;
        let position = Vec3::from_array(position) + arm;
        let angular = Vec3::from_array(angular);
        let (linear, spin) = match point {
            VelocityPoint::Centre => (Vec3::from_array(linear), angular),
            VelocityPoint::Origin => (Vec3::from_array(linear) + angular.cross(arm), angular),
            VelocityPoint::None => (Vec3::ZERO, Vec3::ZERO),
        };
        let motion = BodyState::new(
            position.to_array(),
            rotation,
            linear.to_array(),
            spin.to_array(),
        );
        let id = stay_id(index, body.stays)?;
        let observation = Observation {
            id,
            motion: motion.map_err(|_| RecordingError::Number { tick, index })?,
            activity: if flags & AWAKE == 0 {
                Activity::Asleep
            } else {
                Activity::Awake
            },
        };
        if body.is_there {
            row.extend((flags & UNCHANGED == 0).then_some(observation));
        } else {
            body.is_there = true;
            truth.placed.push(Placed {
                tick,
                desc: BodyDesc { id, ..body.desc },
                shape: body.shape.clone(),
                observation,
                inertia: body.inertia.filter(|_| body.desc.gyroscopic),
            });
        }
        if flags & GONE != 0 {
            truth.removed.push((tick, id));
            body.is_there = false;
            body.stays += 1;
        }
    }
    Ok(row)
}

/// The bytes of a recording, whose bodies have the indices 0, 1, 2 and so on. Stays of one index that differ in what the file
/// says of a body are bodies of their own.
///
/// # Errors
///
/// [`RecordingError::Bodies`] if there are more bodies than a file may have.
pub fn write(recording: &Recording) -> Result<Vec<u8>, RecordingError> {
    let truth = &recording.truth;
    let (bodies, numbers) = file_bodies(recording);
    let count = bodies.len() as u64;
    if count > u64::from(BODIES_MAX) {
        return Err(RecordingError::Bodies { bodies: count });
    }
    let mut to = MAGIC_2.to_vec();
    let Integrator { rate, substeps } = recording.integrator;
    let frames = truth.ticks.len() as u32 + 1;
    for number in [
        count as u32,
        frames,
        rate.ticks(),
        rate.seconds(),
        substeps.get(),
    ] {
        to.extend(number.to_le_bytes());
    }
    put(&mut to, &recording.gravity.to_array());
    to.extend([0, 0]);
    bodies.iter().for_each(|body| to.extend(body));
    let mut starts = (0..).zip(&truth.placed).peekable();
    let gone = last_frames(truth, &numbers);
    // The stay of each body, and the last record of each of the file's.
    let mut stays: BTreeMap<BodyId, usize> = BTreeMap::new();
    let mut last: BTreeMap<u32, Observation> = BTreeMap::new();
    for frame in 0..u64::from(frames) {
        let mut row: BTreeMap<u32, (Observation, u8)> = BTreeMap::new();
        let observed = frame
            .checked_sub(1)
            .map(|before| &truth.ticks[before as usize]);
        for observation in observed.into_iter().flatten() {
            if let Some(stay) = stays.get(&observation.id) {
                row.insert(numbers[*stay], (*observation, 0));
            }
        }
        while let Some((stay, one)) = starts.next_if(|(_, one)| one.tick.value() <= frame) {
            row.insert(numbers[stay], (one.observation, 0));
            stays.insert(one.desc.id, stay);
        }
        for (_, stay) in gone.range((frame, 0)..(frame + 1, 0)) {
            let (id, number) = (truth.placed[*stay].desc.id, numbers[*stay]);
            let known = last.get(&number).map(|known| (*known, UNCHANGED));
            let record = row.get(&number).copied().or(known);
            if let Some((observation, flags)) = record.filter(|(known, _)| known.id == id) {
                row.insert(number, (observation, flags | GONE));
            }
        }
        to.extend((row.len() as u32).to_le_bytes());
        for (number, (observation, flags)) in row {
            to.extend(number.to_le_bytes());
            put(&mut to, &observation.motion.parts());
            let awake = observation.activity == Activity::Awake;
            to.push((u8::from(awake) * AWAKE) | flags);
            last.insert(number, observation);
        }
    }
    Ok(to)
}

/// The bodies of the file, and the number of that of each stay.
fn file_bodies(recording: &Recording) -> (Vec<Vec<u8>>, Vec<u32>) {
    let described = |placed: &Placed| {
        let mut bytes = Vec::new();
        put_body(&mut bytes, recording, placed);
        (placed.desc.id.index(), bytes)
    };
    let stays: Vec<(u32, Vec<u8>)> = recording.truth.placed.iter().map(described).collect();
    let mut numbers: BTreeMap<&(u32, Vec<u8>), u32> = BTreeMap::new();
    for stay in &stays {
        numbers.insert(stay, 0);
    }
    for (number, known) in (0..).zip(numbers.values_mut()) {
        *known = number;
    }
    let of_stays = stays.iter().map(|stay| numbers[stay]).collect();
    let bodies = numbers.keys().map(|(_, bytes)| bytes.clone()).collect();
    (bodies, of_stays)
}

/// The last frame of each stay that ends: the one before, where another of its body begins in that of its end.
fn last_frames(truth: &Truth, numbers: &[u32]) -> BTreeSet<(u64, usize)> {
    let begins = truth.placed.iter().zip(numbers);
    let begins: BTreeSet<(u64, u32)> = begins
        .map(|(one, number)| (one.tick.value(), *number))
        .collect();
    let ends = truth.ends().into_iter().enumerate();
    let ends = ends.filter_map(|(stay, end)| Some((stay, end?)));
    let last = ends.map(|(stay, end)| {
        let is_own = truth.placed[stay].tick == end;
        let follows = !is_own && begins.contains(&(end.value(), numbers[stay]));
        (end.value() - u64::from(follows), stay)
    });
    last.collect()
}

fn put_body(to: &mut Vec<u8>, recording: &Recording, placed: &Placed) {
    let desc = &placed.desc;
    let inertia = placed
        .inertia
        .or_else(|| recording.inertias.get(&desc.id).copied());
    to.push(match desc.kind {
        BodyKind::Fixed => 0,
        BodyKind::Dynamic => 1,
        BodyKind::Kinematic => 2,
    });
    to.push((u8::from(desc.gyroscopic) * GYROSCOPIC) | (u8::from(inertia.is_some()) * MOMENTS));
    let damping = desc.damping.unwrap_or(recording.damping);
    put(to, &[damping.linear, damping.angular, desc.gravity_scale]);
    put(to, &[0.0; 3]);
    if let Some(inertia) = inertia {
        put(to, &inertia.moments());
        put(to, &inertia.frame());
    }
    let (number, numbers): (u8, Vec<f32>) = match &placed.shape {
        Shape::Ball { radius } => (1, vec![*radius]),
        Shape::Cuboid { half_extents } => (2, half_extents.to_array().to_vec()),
        Shape::Capsule {
            half_height,
            radius,
        } => (3, vec![*half_height, *radius]),
        Shape::Cylinder {
            half_height,
            radius,
        } => (4, vec![*half_height, *radius]),
        Shape::Cone {
            half_height,
            radius,
        } => (5, vec![*half_height, *radius]),
        Shape::RoundedCuboid {
            half_extents: Vec3 { x, y, z },
            radius,
        } => (6, vec![*x, *y, *z, *radius]),
        other => (0, vec![other.bounding_radius().metres() as f32]),
    };
    to.push(number);
    put(to, &numbers);
}

fn put(to: &mut Vec<u8>, numbers: &[f32]) {
    to.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}

/// Reader over the remaining bytes.
pub(super) struct ByteReader<'a> {
    rest: &'a [u8],
    /// The frame that is being read; none in the head of the file.
    frame: Option<u64>,
}

impl<'a> ByteReader<'a> {
    pub(super) const fn new(rest: &'a [u8]) -> Self {
        Self { rest, frame: None }
    }

    /// Begins a frame: errors that follow name it.
    pub(super) const fn begin(&mut self, frame: u64) {
        self.frame = Some(frame);
    }

    pub(super) fn take<const COUNT: usize>(&mut self) -> Result<[u8; COUNT], RecordingError> {
        let short = || RecordingError::Short {
            within: (self.frame)
                .map_or_else(|| "its head".to_owned(), |frame| format!("frame {frame}")),
        };
        let (taken, rest) = self.rest.split_first_chunk().ok_or_else(short)?;
        self.rest = rest;
        Ok(*taken)
    }

    pub(super) fn u16(&mut self) -> Result<u16, RecordingError> {
        self.take().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Result<u32, RecordingError> {
        self.take().map(u32::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Result<f32, RecordingError> {
        self.take().map(f32::from_le_bytes)
    }

    pub(super) fn f32s<const COUNT: usize>(&mut self) -> Result<[f32; COUNT], RecordingError> {
        let mut all = [0.0; COUNT];
        for one in &mut all {
            *one = self.f32()?;
        }
        Ok(all)
    }

    /// Refuses bytes behind the last frame.
    pub(super) const fn end(&self) -> Result<(), RecordingError> {
        match self.rest.len() {
            0 => Ok(()),
            bytes => Err(RecordingError::Long { bytes }),
        }
    }
}

#[cfg(test)]
mod tests;
