//! Poses of bodies as arrays of NumPy, and trajectories of MuJoCo.
//!
//! The first index is the frame. An array of a known name that does not fit is refused by that name. A frame whose pose
//! has a NaN is a gap. Gravity, shapes and inertia are taken from the archive if it has them; the order of quaternions
//! is in their array's name, or the caller states it.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::limits::{DAMPING_MAX, GRAVITY_MAX, SUBSTEPS_MAX};
use rhumb_protocol::scene::Shape;
use rhumb_reckoning::Inertia;

use super::error::{BodyDefect, Place, RecordingError, RowDefect};
use super::npy::{self, Array};
use super::options::{QuaternionOrder, ReadOptions};
use super::poses::{TimedPose, TimedPoses};
use super::recorded::{FRAMES_MAX, Recording};

/// Names of the times, seconds.
const TIMES: [&str; 3] = ["time", "t", "timestamp"];
/// Names of one step, seconds.
const STEPS: [&str; 3] = ["timestep", "dt", "step"];
/// Names of linear velocities, m/s.
const LINEAR: [&str; 3] = ["linear", "linear_velocity", "velocity"];
/// Names of angular velocities, rad/s.
const ANGULAR: [&str; 2] = ["angular", "angular_velocity"];
/// Names of positions, metres.
const POSITIONS: [&str; 4] = ["position", "positions", "pos", "xpos"];
/// Names of rotations whose order they say.
const ORDERED_ROTATIONS: [&str; 3] = ["quat_xyzw", "quat_wxyz", "xquat"];
/// Names of rotations whose order the caller says.
const ROTATIONS: [&str; 5] = ["rotation", "rotations", "quaternion", "orientation", "quat"];
/// Names of the extents of shapes, metres.
const EXTENTS: [&str; 2] = ["half_extents", "radius"];
/// Longest time, seconds: nanoseconds fit a whole number.
const SECONDS_MAX: f64 = 9e9;
/// Time from which single precision has steps of a millisecond, seconds.
const SINGLE_MAX: f64 = 8_192.0;

/// Reads an archive.
pub(super) fn read_archive(
    name: &str,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    let npy::Archive { arrays, names } = npy::read_archive(bytes, &KNOWN)?;
    Arrays { arrays, names }.recording(name, options)
}

/// Reads one array: rows of time, position and rotation, of one body; velocities may follow.
pub(super) fn read_array(
    name: &str,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    let array = npy::read(name, bytes)?;
    let columns = match array.shape.as_slice() {
        [_, columns @ (8 | 14)] => *columns,
        _ => {
            return Err(RecordingError::Array {
                array: name.to_owned(),
                needed: "rows of time, x, y, z and four numbers of a quaternion, and of six velocities if it has them",
            });
        }
    };
    let order = options.quaternion.ok_or(RecordingError::QuaternionOrder {
        array: name.to_owned(),
    })?;
    let part = |from: usize, to: usize| Array {
        shape: vec![array.shape[0], to - from],
        values: array
            .values
            .chunks_exact(columns)
            .flat_map(|row| row[from..to].to_vec())
            .collect(),
        is_single: array.is_single,
    };
    let rotation = match order {
        QuaternionOrder::Xyzw => "quat_xyzw",
        QuaternionOrder::Wxyz => "quat_wxyz",
    };
    let time = Array {
        shape: vec![array.shape[0]],
        ..part(0, 1)
    };
    let mut all = BTreeMap::from([
        ("time".to_owned(), time),
        ("position".to_owned(), part(1, 4)),
        (rotation.to_owned(), part(4, 8)),
    ]);
    if columns == 14 {
        all.insert("linear".to_owned(), part(8, 11));
        all.insert("angular".to_owned(), part(11, 14));
    }
    let names = all.keys().cloned().collect();
    Arrays { arrays: all, names }.recording(name, options)
}

/// The arrays of an archive.
struct Arrays {
    /// The known arrays, by name.
    arrays: BTreeMap<String, Array>,
    /// The names of all.
    names: Vec<String>,
}

/// Names of all arrays that are read; others, such as pictures, are not unpacked.
const KNOWN: [&str; 32] = [
    "time",
    "t",
    "timestamp",
    "timestep",
    "dt",
    "step",
    "gravity",
    "substeps",
    "linear_damping",
    "angular_damping",
    "qpos",
    "qvel",
    "position",
    "positions",
    "pos",
    "xpos",
    "quat_xyzw",
    "quat_wxyz",
    "xquat",
    "rotation",
    "rotations",
    "quaternion",
    "orientation",
    "quat",
    "linear",
    "linear_velocity",
    "velocity",
    "angular",
    "angular_velocity",
    "half_extents",
    "radius",
    "inertia",
];

/// The arrays that hold the poses.
struct Columns<'a> {
    position: (&'a str, &'a Array),
    rotation: (&'a str, &'a Array),
    order: QuaternionOrder,
    /// Linear and angular velocity; true if the angular one is along the body's axes.
    velocities: Option<(&'a Array, &'a Array, bool)>,
    /// Offsets of a body's numbers in a row of each array, and the numbers of a body in a row.
    strides: Strides,
    bodies: usize,
    frames: usize,
}

/// Numbers of a body in a row: all of them in one array, or each kind in its own.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Strides {
    /// `qpos` and `qvel`.
    Joints,
    Apart,
}

impl Arrays {
    fn get(&self, name: &str) -> Option<&Array> {
        debug_assert!(KNOWN.contains(&name), "{name} is not unpacked");
        self.arrays.get(name)
    }

    fn first(&self, names: &[&'static str]) -> Option<(&'static str, &Array)> {
        names.iter().find_map(|name| Some((*name, self.get(name)?)))
    }

    /// Nothing among the arrays is poses.
    fn no_poses(&self) -> RecordingError {
        let found = self.names.clone();
        RecordingError::Arrays { found }
    }

    fn recording(&self, name: &str, options: &ReadOptions) -> Result<Recording, RecordingError> {
        let columns = self.columns(options)?;
        // An array without numbers may claim any other length.
        if columns.bodies == 0 {
            return Err(RecordingError::NoTruth);
        }
        if columns.frames > FRAMES_MAX as usize {
            let frames = u32::try_from(columns.frames).unwrap_or(u32::MAX);
            return Err(RecordingError::Frames { frames });
        }
        let times = self.times(columns.frames)?;
        let mut poses = TimedPoses::default();
        poses.left_out = self.left_out();
        poses.part_of_velocities = self.part_of_velocities();
        self.check_bodies(columns.bodies)?;
        for body in 0..columns.bodies {
            let number = poses.body(&body.to_string(), None)?;
            let known = &mut poses.bodies[number];
            known.shape = self.shape(body)?;
            known.inertia = self.inertia(body)?;
        }
        for (frame, at_ns) in times.into_iter().enumerate() {
            for body in 0..columns.bodies {
                poses.poses.extend(columns.pose(frame, body, at_ns));
            }
        }
        let options = ReadOptions {
            gravity: options.gravity.or(self.gravity()?),
            ..options.clone()
        };
        let mut recording = poses.recording(name, &options)?;
        self.engine(&mut recording)?;
        Ok(recording)
    }

    /// The velocities of an archive that has one kind alone.
    fn part_of_velocities(&self) -> Option<String> {
        if self.get("qpos").is_some() {
            return None;
        }
        match (self.first(&LINEAR), self.first(&ANGULAR)) {
            (Some((linear, _)), None) => Some(format!("{linear} without {}", ANGULAR[0])),
            (None, Some((angular, _))) => Some(format!("{angular} without {}", LINEAR[0])),
            _ => None,
        }
    }

    /// Sentences on arrays that are not read.
    fn left_out(&self) -> Vec<String> {
        let known = |name: &&String| KNOWN.contains(&name.as_str());
        let (_, others): (Vec<&String>, Vec<&String>) = self.names.iter().partition(known);
        let mut left_out = Vec::new();
        if !others.is_empty() {
            let named: Vec<&str> = others.iter().take(8).map(|name| name.as_str()).collect();
            let more = match others.len() - named.len() {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            left_out.push(format!(
                "arrays of names that are not read: {}{more}",
                named.join(", ")
            ));
        }
        let joints = &["qpos"][..];
        for names in [
            [&TIMES[..], &STEPS].concat(),
            [joints, &POSITIONS].concat(),
            [joints, &ORDERED_ROTATIONS, &ROTATIONS].concat(),
            [joints, &LINEAR].concat(),
            [joints, &ANGULAR].concat(),
            EXTENTS.to_vec(),
        ] {
            let mut found = names.iter().filter(|name| self.get(name).is_some());
            let read = found.next();
            let others: Vec<&str> = found.copied().collect();
            if let Some(read) = read.filter(|_| !others.is_empty()) {
                left_out.push(format!("{read} is read, so not {}", others.join(", ")));
            }
        }
        if self.get("qpos").is_none() && self.get("qvel").is_some() {
            left_out.push("qvel is not read without qpos".to_owned());
        }
        left_out
    }

    /// An array of this shape, but for lengths of one.
    fn shaped(
        &self,
        name: &'static str,
        needed: &[usize],
        of: &'static str,
    ) -> Result<Option<&Array>, RecordingError> {
        let Some(array) = self.get(name) else {
            return Ok(None);
        };
        let long = |shape: &[usize]| -> Vec<usize> {
            shape
                .iter()
                .copied()
                .filter(|length| *length != 1)
                .collect()
        };
        if long(&array.shape) != long(needed) {
            return Err(RecordingError::ArrayShape {
                array: name.to_owned(),
                shape: array.shape.clone(),
                needed: needed.to_vec(),
                of,
            });
        }
        Ok(Some(array))
    }

    /// Refuses arrays of bodies that are not of as many bodies.
    fn check_bodies(&self, bodies: usize) -> Result<(), RecordingError> {
        self.shaped(
            "half_extents",
            &[bodies, 3],
            "three half extents of each body",
        )?;
        self.shaped("radius", &[bodies], "a radius of each body")?;
        self.shaped("inertia", &[bodies, 3], "three moments of each body")?;
        Ok(())
    }

    fn gravity(&self) -> Result<Option<Vec3>, RecordingError> {
        let Some(array) = self.shaped("gravity", &[3], "x, y and z, m/s²")? else {
            return Ok(None);
        };
        let most = f64::from(GRAVITY_MAX);
        for number in &array.values {
            in_range("gravity", *number, "numbers", -most..=most)?;
        }
        Ok(Some(DVec3::from_slice(&array.values).as_vec3()))
    }

    /// Takes substeps and damping, as far as they are stated.
    ///
    /// # Errors
    ///
    /// [`RecordingError`] for more than one number, and for a number beyond those of a scene.
    fn engine(&self, recording: &mut Recording) -> Result<(), RecordingError> {
        let scalar = |name: &'static str, kind, range: std::ops::RangeInclusive<f64>| {
            let Some(array) = self.shaped(name, &[], "one number for all bodies")? else {
                return Ok(None);
            };
            in_range(name, array.values[0], kind, range).map(Some)
        };
        let whole = "a whole number";
        let most = f64::from(SUBSTEPS_MAX);
        if let Some(number) = scalar("substeps", whole, 1.0..=most)? {
            let substeps = std::num::NonZeroU32::new(number as u32);
            let substeps = substeps.filter(|_| number.fract() == 0.0);
            let wrong = || out_of_range("substeps", number, whole, 1.0..=most);
            recording.integrator.substeps = substeps.ok_or_else(wrong)?;
        }
        let damping = 0.0..=f64::from(DAMPING_MAX);
        if let Some(linear) = scalar("linear_damping", "a number", damping.clone())? {
            recording.damping.linear = linear as f32;
        }
        if let Some(angular) = scalar("angular_damping", "a number", damping)? {
            recording.damping.angular = angular as f32;
        }
        Ok(())
    }

    fn columns(&self, options: &ReadOptions) -> Result<Columns<'_>, RecordingError> {
        if let Some((name, array)) = self.first(&["qpos"]) {
            return self.joints((name, array));
        }
        let needed = || self.no_poses();
        let position = self.first(&POSITIONS).ok_or_else(needed)?;
        let (rotation, order) = match self.first(&ORDERED_ROTATIONS) {
            Some(rotation @ ("quat_xyzw", _)) => (rotation, QuaternionOrder::Xyzw),
            Some(rotation) => (rotation, QuaternionOrder::Wxyz),
            None => {
                let rotation = self.first(&ROTATIONS).ok_or_else(needed)?;
                let order = options.quaternion.ok_or(RecordingError::QuaternionOrder {
                    array: rotation.0.to_owned(),
                })?;
                (rotation, order)
            }
        };
        let (frames, bodies) = shape_of(position, 3)?;
        if shape_of(rotation, 4)? != (frames, bodies) {
            return Err(other_shape(rotation.0, position.0));
        }
        let linear = self.first(&LINEAR);
        let angular = self.first(&ANGULAR);
        let velocities = match linear.zip(angular) {
            None => None,
            Some((linear, angular)) => {
                for array in [linear, angular] {
                    if shape_of(array, 3)? != (frames, bodies) {
                        return Err(other_shape(array.0, position.0));
                    }
                }
                Some((linear.1, angular.1, false))
            }
        };
        Ok(Columns {
            position,
            rotation,
            order,
            velocities,
            strides: Strides::Apart,
            bodies,
            frames,
        })
    }

    /// Free bodies of MuJoCo: seven numbers of `qpos` and six of `qvel` each.
    fn joints<'a>(&'a self, qpos: (&'a str, &'a Array)) -> Result<Columns<'a>, RecordingError> {
        let wrong = |array: &str, needed| RecordingError::Array {
            array: array.to_owned(),
            needed,
        };
        let (frames, bodies) = match qpos.1.shape.as_slice() {
            [frames, numbers] if numbers % 7 == 0 && *numbers > 0 => (*frames, numbers / 7),
            _ => {
                let needed = "frames of seven numbers for each body: for bodies with other joints record xpos and xquat";
                return Err(wrong("qpos", needed));
            }
        };
        let velocities = match self.get("qvel") {
            None => None,
            Some(qvel) if qvel.shape == [frames, 6 * bodies] => Some((qvel, qvel, true)),
            Some(_) => {
                return Err(wrong(
                    "qvel",
                    "as many frames as qpos, of six numbers for each body",
                ));
            }
        };
        Ok(Columns {
            position: qpos,
            rotation: qpos,
            order: QuaternionOrder::Wxyz,
            velocities,
            strides: Strides::Joints,
            bodies,
            frames,
        })
    }

    /// The moment of each frame, nanoseconds since the first.
    fn times(&self, frames: usize) -> Result<Vec<i64>, RecordingError> {
        let Some((name, array)) = self.first(&TIMES) else {
            let (name, array) = self.first(&STEPS).ok_or_else(|| self.no_poses())?;
            let step = match array.values.as_slice() {
                [step] if step.is_finite() && *step > 0.0 => *step,
                _ => {
                    let array = name.to_owned();
                    let needed = "one number of seconds above 0";
                    return Err(RecordingError::Array { array, needed });
                }
            };
            let moment = |frame: usize| (frame as f64 * step * 1e9).round() as i64;
            return Ok((0..frames).map(moment).collect());
        };
        if array.values.len() != frames {
            return Err(other_shape(name, "the poses"));
        }
        let first = array.values.first().copied().unwrap_or_default();
        if array.is_single && array.values.iter().any(|time| time.abs() > SINGLE_MAX) {
            return Err(RecordingError::Array {
                array: name.to_owned(),
                needed: "64-bit numbers: those of 32 bits have steps of a millisecond and more at such times",
            });
        }
        let mut times = Vec::with_capacity(frames);
        for (frame, time) in array.values.iter().enumerate() {
            // NaN is none.
            let is_time = time.abs() <= SECONDS_MAX;
            if !is_time {
                return Err(RecordingError::Row {
                    place: place(name, frame, 0),
                    defect: RowDefect::OutOfRange {
                        of: "time",
                        most: Some("9e9 s"),
                    },
                });
            }
            times.push(((time - first) * 1e9).round() as i64);
        }
        Ok(times)
    }

    /// The shape of a body; the arrays have as many bodies as the poses.
    fn shape(&self, body: usize) -> Result<Option<Shape>, RecordingError> {
        let (name, shape) = match (self.get("half_extents"), self.get("radius")) {
            (Some(array), _) => {
                let half_extents = DVec3::from_slice(&array.values[3 * body..]).as_vec3();
                ("half_extents", Shape::Cuboid { half_extents })
            }
            (None, Some(array)) => {
                let radius = array.values[body] as f32;
                ("radius", Shape::Ball { radius })
            }
            (None, None) => return Ok(None),
        };
        shape.check().map_err(|invalid| RecordingError::ArrayBody {
            array: name.to_owned(),
            body,
            cause: BodyDefect::Extents(Box::new(invalid)),
        })?;
        Ok(Some(shape))
    }

    /// Moments about the axes of the body; the array has as many bodies as the poses.
    fn inertia(&self, body: usize) -> Result<Option<Inertia>, RecordingError> {
        let Some(array) = self.get("inertia") else {
            return Ok(None);
        };
        let wrong = |cause| RecordingError::ArrayBody {
            array: "inertia".to_owned(),
            body,
            cause,
        };
        let moments = DVec3::from_slice(&array.values[3 * body..]);
        let narrow = moments.as_vec3().to_array();
        let inertia = Inertia::new(narrow, Inertia::OWN_AXES).map_err(|cause| {
            wrong(BodyDefect::Moments {
                moments: narrow,
                cause,
            })
        })?;
        // A thin disc has one that is the sum of the other two, within its rounding.
        let most = moments.element_sum() - moments.max_element();
        if 1000.0 * moments.max_element() > 1001.0 * most {
            return Err(wrong(BodyDefect::Sums { moments: narrow }));
        }
        Ok(Some(inertia))
    }
}

impl Columns<'_> {
    /// The pose of a body in a frame; `None` for a gap.
    fn pose(&self, frame: usize, body: usize, at_ns: i64) -> Option<TimedPose> {
        let row = frame * self.bodies + body;
        let (position, rotation) = match self.strides {
            Strides::Joints => (
                &self.position.1.values[7 * row..7 * row + 3],
                &self.rotation.1.values[7 * row + 3..7 * row + 7],
            ),
            Strides::Apart => (
                &self.position.1.values[3 * row..3 * row + 3],
                &self.rotation.1.values[4 * row..4 * row + 4],
            ),
        };
        if position
            .iter()
            .chain(rotation)
            .any(|number| number.is_nan())
        {
            return None;
        }
        let rotation = match (self.order, rotation) {
            (QuaternionOrder::Xyzw, [x, y, z, w]) | (QuaternionOrder::Wxyz, [w, x, y, z]) => {
                DQuat::from_xyzw(*x, *y, *z, *w)
            }
            _ => return None,
        };
        let velocity = self.velocities.map(|(linear, angular, is_along_body)| {
            let (linear, angular) = match self.strides {
                Strides::Joints => (
                    &linear.values[6 * row..6 * row + 3],
                    &angular.values[6 * row + 3..6 * row + 6],
                ),
                Strides::Apart => (
                    &linear.values[3 * row..3 * row + 3],
                    &angular.values[3 * row..3 * row + 3],
                ),
            };
            let (linear, angular) = (DVec3::from_slice(linear), DVec3::from_slice(angular));
            let turn = if is_along_body {
                rotation.normalize()
            } else {
                DQuat::IDENTITY
            };
            [linear, turn * angular]
        });
        Some(TimedPose {
            at_ns,
            body,
            position: DVec3::from_slice(position),
            rotation,
            velocity,
            place: place(self.position.0, frame, body),
        })
    }
}

/// A number of an array within a range.
fn in_range(
    array: &str,
    number: f64,
    kind: &'static str,
    range: std::ops::RangeInclusive<f64>,
) -> Result<f64, RecordingError> {
    // NaN is in none.
    if range.contains(&number) {
        return Ok(number);
    }
    Err(out_of_range(array, number, kind, range))
}

fn out_of_range(
    array: &str,
    number: f64,
    kind: &'static str,
    range: std::ops::RangeInclusive<f64>,
) -> RecordingError {
    RecordingError::ArrayNumber {
        array: array.to_owned(),
        number,
        kind,
        least: *range.start(),
        most: *range.end(),
    }
}

fn place(array: &str, frame: usize, body: usize) -> Place {
    Place::Element {
        array: array.to_owned(),
        frame: frame as u64,
        body: body as u64,
    }
}

/// Frames and bodies of an array with this many numbers for each; without a second index it is of one body.
fn shape_of(
    (name, array): (&str, &Array),
    numbers: usize,
) -> Result<(usize, usize), RecordingError> {
    match array.shape.as_slice() {
        [frames, last] if *last == numbers => Ok((*frames, 1)),
        [frames, bodies, last] if *last == numbers => Ok((*frames, *bodies)),
        _ => Err(RecordingError::Array {
            array: name.to_owned(),
            needed: if numbers == 3 {
                "shape (frames, bodies, 3), or (frames, 3) for one body"
            } else {
                "shape (frames, bodies, 4), or (frames, 4) for one body"
            },
        }),
    }
}

fn other_shape(array: &str, beside: &str) -> RecordingError {
    RecordingError::OtherShape {
        array: array.to_owned(),
        beside: beside.to_owned(),
    }
}

#[cfg(test)]
pub(super) mod tests;
