//! Skeletons and markers of motion capture as recordings.
//!
//! Each joint of a BVH file with channels, and each marker of a C3D file, becomes a body. Its positions are in the file's
//! axes, and in the unit that the file or the caller states. A marker never turns; where it is missing it has no pose.

use std::collections::BTreeSet;

use glam::DQuat;
use rhumb_reckoning::{Metres, Rate};

use super::bvh::{self, Motion};
use super::c3d::{File, Markers};
use super::error::{Place, RecordingError};
use super::options::{ReadOptions, rate_of_step, unit_of_name};
use super::poses::{TimedPose, TimedPoses};
use super::recorded::{FRAMES_MAX, Recording};

/// Distance of a frame time in decimals from that of a simple rate that is rounding, seconds.
const ROUNDED_S: f64 = 1e-6;
/// Rounding of a rate in single precision.
const RATE_ROUNDED: f64 = 1e-7;

/// Reads a BVH file.
pub(super) fn read_bvh(
    name: &str,
    text: &str,
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    let (skeleton, motion) = bvh::read(text)?;
    let unit = options.unit.ok_or(RecordingError::Unit {
        stated: String::new(),
    })?;
    let mut poses = TimedPoses::default();
    let rate = match options.rate {
        Some(rate) => rate,
        None => rate_of_frames(&motion, &mut poses)?,
    };
    let (readings, sentences) = skeleton.readings(options.positions, motion.rows.first());
    poses.left_out.extend(sentences);
    let mut known = BTreeSet::new();
    let mut numbers = Vec::new();
    for (place, joint) in skeleton.names().enumerate() {
        let name = match known.insert(joint) {
            true => joint.to_owned(),
            false => format!("{joint} (joint {place})"),
        };
        numbers.push(poses.body(&name, None)?);
    }
    for (frame, row) in motion.rows.iter().enumerate() {
        let worlds = skeleton.worlds(&row.values, &readings);
        for (body, (position, rotation)) in numbers.iter().zip(worlds) {
            poses.poses.push(TimedPose {
                at_ns: moment_ns(frame, rate),
                body: *body,
                position: position * unit.metres(),
                rotation,
                velocity: None,
                place: Place::Line(row.line),
            });
        }
    }
    poses.recording(name, &with_rate(options, rate))
}

/// The options with the rate of the file's frames.
fn with_rate(options: &ReadOptions, rate: Rate) -> ReadOptions {
    ReadOptions {
        rate: Some(rate),
        ..options.clone()
    }
}

fn moment_ns(frame: usize, rate: Rate) -> i64 {
    (frame as f64 * rate.step().seconds() * 1e9).round() as i64
}

/// The simplest rate of the frame time, which has few decimals in most files, with a note where that is another.
fn rate_of_frames(motion: &Motion, poses: &mut TimedPoses) -> Result<Rate, RecordingError> {
    let step_s = motion.step_s;
    // NaN is none.
    let is_step = step_s > 0.0;
    let rate = is_step.then(|| rate_of_step(step_s, ROUNDED_S / step_s));
    let rate = rate.flatten().ok_or(RecordingError::Interval { step_s })?;
    if (rate.step().seconds() / step_s - 1.0).abs() > 1e-9 {
        let hertz = f64::from(rate.ticks()) / f64::from(rate.seconds());
        let note = format!("the frame time of {step_s} s is taken as {hertz} Hz");
        poses.left_out.push(note);
    }
    Ok(rate)
}

/// Reads a C3D file.
pub(super) fn read_c3d(
    name: &str,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    let file = File::read(bytes)?;
    let markers = Markers::find(&file)?;
    if markers.frames > u64::from(FRAMES_MAX) {
        let frames = u32::try_from(markers.frames).unwrap_or(u32::MAX);
        return Err(RecordingError::Frames { frames });
    }
    let rate = match options.rate {
        Some(rate) => rate,
        None => {
            let step_s = 1.0 / markers.hertz(&file)?;
            rate_of_step(step_s, RATE_ROUNDED).ok_or(RecordingError::Interval { step_s })?
        }
    };
    let unit = match options.unit {
        Some(unit) => unit,
        None => {
            let stated = file.text("POINT", "UNITS").unwrap_or_default();
            unit_of_name(&stated).ok_or(RecordingError::Unit { stated })?
        }
    };
    let mut poses = TimedPoses::default();
    add_markers((&file, &markers), rate, unit, &mut poses)?;
    poses.left_out.extend(markers.notes(&file));
    poses.recording(name, &with_rate(options, rate))
}

/// Adds the poses of all markers.
fn add_markers(
    (file, markers): (&File<'_>, &Markers),
    rate: Rate,
    unit: Metres,
    poses: &mut TimedPoses,
) -> Result<(), RecordingError> {
    let mut never = Vec::new();
    for (marker, label) in markers.labels(file).into_iter().enumerate() {
        let mut body = None;
        for frame in 0..markers.frames as usize {
            let Some(position) = markers.position(file, frame, marker) else {
                continue;
            };
            let body = match body {
                Some(body) => body,
                None => *body.insert(poses.body(&label, None)?),
            };
            poses.poses.push(TimedPose {
                at_ns: moment_ns(frame, rate),
                body,
                position: position * unit.metres(),
                rotation: DQuat::IDENTITY,
                velocity: None,
                place: Place::Record {
                    frame: frame as u64,
                    body: marker as u64,
                },
            });
        }
        if body.is_none() {
            never.push(label);
        }
    }
    if !never.is_empty() {
        let never = never.join(", ");
        let note = format!("markers that are missing in all frames: {never}");
        poses.left_out.push(note);
    }
    Ok(())
}

#[cfg(test)]
mod bvh_tests;
#[cfg(test)]
mod c3d_tests;
