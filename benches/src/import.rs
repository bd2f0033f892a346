//! `rhumb-bench import` and `check`: recordings of other programs.
//!
//! An import becomes an `.rhtrace`, or a bag of ROS 2. A check says what a recording tells of the engine behind it.
//! Velocities are compared with poses under several readings: exchanged, along the body's axes, in degrees, of rotations
//! with w first. If another reading than the usual one fits, a warning says so: the recording would pass as it is, and
//! cost two to three times the bytes.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use glam::{DQuat, DVec3};

use crate::output::{Failure, OutputError, ended, print_text};
use crate::recording::estimates::{First, ShortTurn};
use crate::recording::fit::{self, Found, VelocityPoint};
use crate::recording::recorded::{BodyPath, Paths, paths};
use crate::recording::{Recording, RecordingSource, Velocities, write_bag, write_rhtrace};

/// Arguments: the recording, the file to write.
#[derive(Clone, Debug, Args)]
pub struct Import {
    #[command(flatten)]
    source: RecordingSource,
    /// File to write: an .rhtrace, packed by zstd unless it ends with .rhtrace; or a bag of ROS 2, with /clock and /tf, if
    /// it ends with .mcap.
    #[arg(long, value_name = "FILE", default_value = "recording.rhtrace.zst")]
    out: PathBuf,
}

/// Level of zstd: recordings are read more often than written.
const LEVEL: i32 = 9;

/// Reads the recording and writes it. Exit code 0 on success, 1 otherwise.
pub fn import(arguments: &Import) -> ExitCode {
    ended(import_one(arguments))
}

fn import_one(arguments: &Import) -> Result<(), Failure> {
    let recording = arguments.source.read()?;
    let bytes = write(&recording, &arguments.out)?;
    let seconds = f64::from(recording.ticks()) * recording.integrator.rate.step().seconds();
    let known = recording
        .truth
        .placed
        .iter()
        .filter(|placed| placed.inertia.is_some());
    print_text(&format!(
        "{}: {} bodies, {} with unequal moments of inertia, {} frames, {seconds:.3} s, {bytes} bytes\n",
        arguments.out.display(),
        recording.truth.placed.len(),
        known.count() + recording.inertias.len(),
        recording.ticks() + 1,
    ))?;
    Ok(())
}

/// Writes a recording, and returns its bytes.
fn write(recording: &Recording, path: &Path) -> Result<u64, OutputError> {
    let failed = |cause: io::Error| OutputError::Write {
        path: path.to_owned(),
        cause,
    };
    if path.extension().is_some_and(|end| end == "mcap") {
        let file = std::fs::File::create(path).map_err(failed)?;
        let written = write_bag(recording, io::BufWriter::new(&file));
        written.map_err(|cause| failed(io::Error::other(cause)))?;
        return Ok(file.metadata().map_err(failed)?.len());
    }
    let plain = write_rhtrace(recording).map_err(|cause| failed(io::Error::other(cause)))?;
    let bytes = if path.extension().is_some_and(|end| end == "rhtrace") {
        plain
    } else {
        zstd::encode_all(plain.as_slice(), LEVEL).map_err(failed)?
    };
    let mut file = std::fs::File::create(path).map_err(failed)?;
    file.write_all(&bytes).map_err(failed)?;
    Ok(bytes.len() as u64)
}

/// Arguments: the recording.
#[derive(Clone, Debug, Args)]
pub struct Check {
    #[command(flatten)]
    source: RecordingSource,
}

/// Prints what is found. Exit code 0 if the recording is read, whatever is found; 1 otherwise.
pub fn check(arguments: &Check) -> ExitCode {
    ended(check_one(arguments))
}

fn check_one(arguments: &Check) -> Result<(), Failure> {
    let recording = arguments.source.read()?;
    let lines = findings(&recording);
    Ok(print_text(&(lines.join("\n") + "\n"))?)
}

/// The findings, a line each; warnings last.
#[must_use]
pub fn findings(recording: &Recording) -> Vec<String> {
    let paths = paths(recording);
    let Paths { bodies, frames } = &paths;
    let found = fit::find(recording, bodies);
    let rate = recording.integrator.rate;
    let mut lines = vec![format!(
        "{} bodies that can move, {} frames at {:.6} Hz; {} of {} moving poses are of bodies that move as free ones do",
        bodies.len(),
        recording.ticks() + 1,
        f64::from(rate.ticks()) / f64::from(rate.seconds()),
        found.free[0],
        found.free[1],
    )];
    let mut warnings = Vec::new();
    if *frames <= recording.ticks() as usize {
        lines.push(format!(
            "the first {frames} frames are looked at: later ones of so many bodies need too much memory"
        ));
    }
    engine(recording, &found, &mut lines, &mut warnings);
    velocities(recording, bodies, &mut lines, &mut warnings);
    lines.extend(warnings.into_iter().map(|text| format!("warning: {text}")));
    lines
}

fn vector(of: DVec3) -> String {
    format!("{:.4},{:.4},{:.4}", of.x, of.y, of.z)
}

/// Largest difference of gravity that counts as equal, m/s².
const GRAVITY_SLACK: f64 = 0.1;

/// Gravity, substeps, damping, inertia and centres.
fn engine(
    recording: &Recording,
    found: &Found,
    lines: &mut Vec<String>,
    warnings: &mut Vec<String>,
) {
    if !found.driven.is_empty() {
        lines.push(format!(
            "{} bodies turn or accelerate as no free body does: motors, commands or contacts move them, and nothing of the engine follows from them",
            found.driven.len()
        ));
    }
    let Some(gravity) = found.gravity else {
        let sentence = match found.driven.is_empty() {
            true => "no body is in free motion for eight frames: of the engine nothing is found",
            false => "no body moves as a free one: of the engine nothing is found",
        };
        warnings.push(sentence.to_owned());
        return;
    };
    let up = [("x", DVec3::X), ("y", DVec3::Y), ("z", DVec3::Z)].into_iter();
    let axis = up.flat_map(|(name, axis)| [(name.to_owned(), axis), (format!("-{name}"), -axis)]);
    let up = axis.min_by(|a, b| a.1.dot(gravity).total_cmp(&b.1.dot(gravity)));
    let up = match up {
        Some((name, _)) if gravity.length() > GRAVITY_SLACK => format!("{name} points up"),
        _ => "there is none".to_owned(),
    };
    lines.push(format!("gravity {} m/s²: {up}", vector(gravity)));
    if (gravity - recording.gravity.as_dvec3()).length() > GRAVITY_SLACK {
        warnings.push(format!(
            "the recording is read with gravity {}: --gravity {}, or --fit",
            vector(recording.gravity.as_dvec3()),
            vector(gravity)
        ));
    }
    if let Some(fall) = found.fall {
        let ahead = fit::ahead(fall, recording.integrator.substeps);
        let steps = match (fit::substeps(fall), ahead) {
            (Some(count), _) => format!("{count} substeps"),
            (None, Some(ahead)) => format!(
                "as none of this engine's steps do: its velocities are {ahead:.3} g·t ahead, which --fit takes away"
            ),
            (None, None) => "as none of this engine's steps do".to_owned(),
        };
        lines.push(format!(
            "a body falls {fall:.3} g·t² in a tick beside its velocity: {steps}"
        ));
    }
    if let Some([linear, angular]) = found.kept {
        let rates = [linear, angular].map(|kept| -kept.ln());
        let shares = [linear, angular].map(|kept| 1.0 - kept);
        lines.push(format!(
            "damping: exponential {:.4} and {:.4} 1/s (linear, angular); by Bullet's formula {:.4} and {:.4}",
            rates[0], rates[1], shares[0], shares[1]
        ));
    }
    instants(recording, (found, gravity), lines);
    spins(recording, found, lines, warnings);
}

/// Finds the moment of a tick that recorded velocities belong to.
fn instants(recording: &Recording, (found, gravity): (&Found, DVec3), lines: &mut Vec<String>) {
    if found.instants.first == First::Damped {
        let step_s = recording.integrator.rate.step().seconds();
        let all = gravity / found.kept_in_substep(step_s);
        lines.push(format!(
            "a body is damped before it moves in a tick: if that takes of what gravity just added, gravity is {} m/s² there",
            vector(all)
        ));
    }
    if found.instants.behind != 0.0 {
        lines.push(format!(
            "angular velocities are those of {:.3} ticks before their poses",
            found.instants.behind
        ));
    }
}

/// Inertia and centres.
fn spins(
    recording: &Recording,
    found: &Found,
    lines: &mut Vec<String>,
    warnings: &mut Vec<String>,
) {
    lines.push(format!(
        "spin: {} bodies wander as their unequal moments say, {} keep their spin",
        found.inertias.len(),
        found.constant.len()
    ));
    if let Some((id, (moments, _))) = found.inertias.iter().next() {
        let least = moments.iter().copied().fold(f64::MAX, f64::min);
        let ratios = moments.map(|moment| format!("{:.3}", moment / least));
        lines.push(format!(
            "moments of body {}: {}",
            id.index(),
            ratios.join(" : ")
        ));
    }
    let known = recording
        .truth
        .placed
        .iter()
        .filter(|placed| placed.inertia.is_some())
        .count();
    if known + recording.inertias.len() < found.inertias.len() {
        warnings.push(
            "bodies wander, and the file has no inertia: --fit takes what is found".to_owned(),
        );
    }
    if known > 0 && found.constant.len() > found.inertias.len() {
        warnings.push(
            "the file has inertia, and the bodies keep their spin as if they had none: --fit"
                .to_owned(),
        );
    }
    if let Some((id, centre)) = found.centres.iter().next() {
        let velocities = match (recording.velocities, found.point) {
            (Velocities::Fitted, _) => "",
            (Velocities::Recorded, VelocityPoint::Origin) => ", nor are the velocities",
            (Velocities::Recorded, VelocityPoint::Centre) => ", but the velocities are",
        };
        warnings.push(format!(
            "the positions of {} bodies are not those of their centres of mass{velocities}; that of body {} is at {} m in its axes: --fit",
            found.centres.len(),
            id.index(),
            vector(*centre)
        ));
    }
}

/// A pose with its recorded velocities, and those that the poses beside it say.
struct Sample {
    rotation: DQuat,
    linear: DVec3,
    angular: DVec3,
    moved: DVec3,
    turned: DVec3,
    /// As if the stored rotations had w first.
    turned_w_first: DVec3,
}

/// Most samples: further ones hardly change a median.
const SAMPLES_MAX: usize = 20_000;

fn samples(paths: &[BodyPath], step_s: f64) -> Vec<Sample> {
    let all: usize = paths.iter().map(|path| path.states.len()).sum();
    let stride = (all / SAMPLES_MAX).max(1);
    let mut samples = Vec::new();
    for path in paths {
        for three in path.states.windows(3).step_by(stride) {
            let [before, here, after] = [0, 1, 2].map(|place| three[place].motion());
            let moved = (after.pose().position - before.pose().position) / (2.0 * step_s);
            let turn = |reading: fn(DQuat) -> DQuat| {
                let [a, b] = [&before, &after].map(|motion| reading(motion.pose().rotation));
                (b * a.conjugate()).to_scaled_axis_short() / (2.0 * step_s)
            };
            if before.pose() == after.pose() {
                continue;
            }
            samples.push(Sample {
                rotation: here.pose().rotation,
                linear: here.twist().linear,
                angular: here.twist().angular,
                moved,
                turned: turn(|q| q),
                turned_w_first: turn(|q| DQuat::from_xyzw(q.y, q.z, q.w, q.x)),
            });
        }
    }
    samples
}

/// The distance of a reading from what the poses say: the median, as a share of the median speed.
fn off(samples: &[Sample], pair: impl Fn(&Sample) -> (DVec3, DVec3)) -> f64 {
    let median = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().unwrap_or_default()
    };
    let distance = samples.iter().map(|sample| {
        let (read, said) = pair(sample);
        (read - said).length()
    });
    let said = median(
        samples
            .iter()
            .map(|sample| pair(sample).1.length())
            .collect(),
    );
    median(distance.collect()) / said.max(1e-9)
}

/// A reading agrees if it is off by less than this.
const AGREES: f64 = 0.1;

/// Readings of the linear velocities, and how far each is off; the first is right.
fn linear_readings(samples: &[Sample]) -> Vec<(&'static str, f64)> {
    vec![
        ("world axes", off(samples, |s| (s.linear, s.moved))),
        (
            "the body's axes",
            off(samples, |s| (s.rotation * s.linear, s.moved)),
        ),
        (
            "exchanged with the angular ones",
            off(samples, |s| (s.angular, s.moved)),
        ),
        (
            "of the opposite sign",
            off(samples, |s| (-s.linear, s.moved)),
        ),
    ]
}

/// Readings of the angular velocities, and how far each is off; the first is right.
fn angular_readings(samples: &[Sample]) -> Vec<(&'static str, f64)> {
    let degree = std::f64::consts::PI / 180.0;
    vec![
        ("world axes", off(samples, |s| (s.angular, s.turned))),
        (
            "the body's axes",
            off(samples, |s| (s.rotation * s.angular, s.turned)),
        ),
        (
            "exchanged with the linear ones",
            off(samples, |s| (s.linear, s.turned)),
        ),
        (
            "in degrees",
            off(samples, |s| (s.angular * degree, s.turned)),
        ),
        (
            "of the opposite sign",
            off(samples, |s| (-s.angular, s.turned)),
        ),
        (
            "right if rotations have w first",
            off(samples, |s| (s.angular, s.turned_w_first)),
        ),
    ]
}

/// Compares velocities with poses.
fn velocities(
    recording: &Recording,
    paths: &[BodyPath],
    lines: &mut Vec<String>,
    warnings: &mut Vec<String>,
) {
    if recording.velocities == Velocities::Fitted {
        warnings.push("the file has no velocities; those that are fitted cost more updates than an engine's own".to_owned());
        return;
    }
    let samples = samples(paths, recording.integrator.rate.step().seconds());
    if samples.is_empty() {
        return;
    }
    let (linear, angular) = (linear_readings(&samples), angular_readings(&samples));
    let is_zero = |of: fn(&Sample) -> DVec3| samples.iter().all(|sample| of(sample) == DVec3::ZERO);
    for (name, readings, zero) in [
        ("linear", &linear[..], is_zero(|s| s.linear)),
        ("angular", &angular[..], is_zero(|s| s.angular)),
    ] {
        let moves = samples
            .iter()
            .any(|s| if name == "linear" { s.moved } else { s.turned } != DVec3::ZERO);
        let Some(best) = readings
            .iter()
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .filter(|_| moves)
        else {
            continue;
        };
        if zero {
            warnings.push(format!(
                "all {name} velocities are zero although bodies move"
            ));
        } else if readings[0].1 <= AGREES {
            lines.push(format!(
                "{name} velocities: world axes, off by {:.2} % in the middle",
                100.0 * readings[0].1
            ));
        } else if best.1 <= AGREES {
            warnings.push(format!(
                "{name} velocities are {} ({:.2} % off; as they are {:.0} %)",
                best.0,
                100.0 * best.1,
                100.0 * readings[0].1
            ));
        } else {
            warnings.push(format!(
                "{name} velocities agree with the poses by no reading: {:.0} % off",
                100.0 * readings[0].1
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{ReadOptions, read_bytes};

    /// Two boxes that tumble and fall, whose columns `put` may change.
    fn rows(put: fn(&mut [f64; 13])) -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
        let step = 0.01;
        let moments = DVec3::new(1.0, 2.0, 2.4);
        for body in 0..2 {
            let side = f64::from(body);
            let mut q = DQuat::from_rotation_x(0.3 + side);
            let mut w = DVec3::new(2.0, 3.0 + side, -1.0);
            let (mut p, mut v) = (
                DVec3::new(side, 20.0, 0.0),
                DVec3::new(1.0, 3.0, 0.5 - side),
            );
            for frame in 0..150 {
                let turn = q.to_array();
                let mut row = [0.0; 13];
                row[..3].copy_from_slice(&p.to_array());
                row[3..7].copy_from_slice(&turn);
                row[7..10].copy_from_slice(&v.to_array());
                row[10..].copy_from_slice(&w.to_array());
                put(&mut row);
                let numbers: Vec<String> = row.iter().map(f64::to_string).collect();
                text += &format!(
                    "{},b{body},{}\n",
                    f64::from(frame) * step,
                    numbers.join(",")
                );
                v += DVec3::NEG_Y * (9.81 * step);
                p += v * step;
                for _ in 0..50 {
                    let own = q.conjugate() * w;
                    let torque = -own.cross(own * moments);
                    let own = own + torque / moments * (step / 50.0);
                    q = (q * DQuat::from_scaled_axis(own * (step / 50.0))).normalize();
                    w = q * own;
                }
            }
        }
        read_bytes("rows", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn gravity_substeps_and_moments_are_found_in_poses_and_velocities() {
        let recording = rows(|_| ());
        let found = fit::find(&recording, &paths(&recording).bodies);
        let gravity = found.gravity.expect("it falls");
        assert!((gravity - DVec3::NEG_Y * 9.81).length() < 0.02, "{gravity}");
        assert_eq!(found.fall.and_then(fit::substeps), Some(1));
        assert_eq!((found.inertias.len(), found.constant.len()), (2, 0));
        for (moments, _) in found.inertias.values() {
            let mut moments = *moments;
            moments.sort_by(f64::total_cmp);
            assert!((moments[1] / moments[0] - 2.0).abs() < 0.05, "{moments:?}");
            assert!((moments[2] / moments[0] - 2.4).abs() < 0.05, "{moments:?}");
        }
        let kept = found.kept.expect("it moves");
        assert!(
            kept.iter().all(|kept| (kept - 1.0).abs() < 2e-3),
            "{kept:?}"
        );
        assert!(found.centres.is_empty(), "{:?}", found.centres);
        let text = findings(&recording).join("\n");
        assert!(
            text.contains("y points up") && text.contains("world axes"),
            "{text}"
        );
        assert!(
            text.contains("warning: the recording is read with gravity"),
            "{text}"
        );
        assert!(
            text.contains("warning: bodies wander, and the file has no inertia"),
            "{text}"
        );
    }

    /// Bodies that a program turns, and moves evenly; `lift`: accelerations of each, m/s².
    fn driven_rows(lift: fn(f64) -> f64) -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
        let step = 0.01;
        for body in 0..4 {
            let side = f64::from(body);
            let (mut q, mut p) = (DQuat::IDENTITY, DVec3::X * side);
            let mut v = DVec3::new(1.0, 0.2, 0.0);
            for frame in 0..200 {
                let at = f64::from(frame) * step;
                let w = DVec3::new((3.0 * at).sin(), (2.0 * at + side).cos(), 1.0 + at.sin());
                let [turn, state] = [
                    q.to_array().map(|part| part.to_string()).join(","),
                    [v, w]
                        .map(|of| of.to_array().map(|part| part.to_string()).join(","))
                        .join(","),
                ];
                text += &format!("{at},b{body},{},{},{},{turn},{state}\n", p.x, p.y, p.z);
                v.y += lift(side) * step;
                p += v * step;
                q = (DQuat::from_scaled_axis(w * step) * q).normalize();
            }
        }
        read_bytes("rows", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn of_bodies_that_motors_turn_neither_moments_nor_centres_are_said() {
        let recording = driven_rows(|_| 0.0);
        let found = fit::find(&recording, &paths(&recording).bodies);
        assert_eq!(found.driven.len(), 4);
        assert!(
            found.inertias.is_empty() && found.centres.is_empty(),
            "{found:?}"
        );
        let text = findings(&recording).join("\n");
        assert!(
            text.contains("4 bodies turn or accelerate as no free body does"),
            "{text}"
        );
        assert!(
            text.contains("warning: no body moves as a free one"),
            "{text}"
        );
        assert!(!text.contains("wander"), "{text}");
    }

    #[test]
    fn bodies_that_accelerate_differently_say_nothing_of_gravity() {
        let recording = driven_rows(|side| 5.0 * side);
        let found = fit::find(&recording, &paths(&recording).bodies);
        assert_eq!((found.gravity, found.driven.len()), (None, 4));
    }

    /// Boxes that keep their axes of spin, in an engine of single precision that damps and then moves.
    fn damped_rows() -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
        let step = 1.0_f32 / 60.0;
        let kept = 1.0 - 0.05 * step;
        for body in 0..40 {
            let side = body as f32;
            let mut q = glam::Quat::from_rotation_y(side);
            let mut w = glam::Vec3::new(side.sin(), 4.0 * side.cos(), 0.3 + 0.1 * side);
            let mut p = glam::Vec3::new(side, 60.0, 0.0);
            let mut v = glam::Vec3::new(0.5, side.cos(), -1.0);
            for frame in 0..180 {
                let at = f64::from(frame) / 60.0;
                let turn = q.to_array().map(|part| part.to_string()).join(",");
                let state =
                    [p, v, w].map(|of| of.to_array().map(|part| part.to_string()).join(","));
                let [place, linear, angular] = state;
                text += &format!("{at},b{body},{place},{turn},{linear},{angular}\n");
                v = (v - glam::Vec3::Y * (9.81 * step)) * kept;
                w *= kept;
                p += v * step;
                q = (glam::Quat::from_scaled_axis(w * step) * q).normalize();
            }
        }
        read_bytes("rows", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn damped_bodies_that_keep_their_spin_do_not_wander_and_fall_by_one_substep() {
        let recording = damped_rows();
        let found = fit::find(&recording, &paths(&recording).bodies);
        assert_eq!((found.inertias.len(), found.constant.len()), (0, 40));
        assert_eq!(
            found.fall.and_then(fit::substeps),
            Some(1),
            "{:?}",
            found.fall
        );
        let text = findings(&recording).join("\n");
        assert!(text.contains("exponential 0.0500 and 0.0500 1/s"), "{text}");
        assert!(!text.contains("wander, and the file"), "{text}");
    }

    /// Boxes whose axes of spin wander, in an engine that damps first and turns a body by its new spin.
    fn late_rows() -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
        let step = 1.0 / 60.0;
        let kept = f64::powf(0.96, step);
        let moments = DVec3::new(1.0, 2.0, 2.4);
        for body in 0..8 {
            let side = f64::from(body);
            let mut q = DQuat::from_rotation_y(side);
            let mut w = DVec3::new(2.0, 3.0 + side / 4.0, -1.0);
            let (mut p, mut v) = (DVec3::new(side, 60.0, 0.0), DVec3::new(0.5, side, -1.0));
            for frame in 0..120 {
                let at = f64::from(frame) * step;
                let turn = q.to_array().map(|part| part.to_string()).join(",");
                let state =
                    [p, v, w].map(|of| of.to_array().map(|part| part.to_string()).join(","));
                let [place, linear, angular] = state;
                text += &format!("{at},b{body},{place},{turn},{linear},{angular}\n");
                v = v * kept + DVec3::NEG_Y * (9.81 * step);
                p += v * step;
                let own = q.conjugate() * w * kept;
                w = q * (own + (moments * own).cross(own) / moments * step);
                q = (DQuat::from_scaled_axis(w * step) * q).normalize();
            }
        }
        read_bytes("rows", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn velocities_become_those_of_this_project_s_step() {
        let mut recording = late_rows();
        let found = fit::find(&recording, &paths(&recording).bodies);
        let is_near = |gravity: f64| (gravity + 9.81).abs() < 1e-3;
        assert!(found.gravity.is_some_and(|gravity| is_near(gravity.y)));
        assert_eq!(found.instants.first, First::Damped);
        assert!((found.instants.behind - 0.5).abs() < 0.02, "{found:?}");
        let text = findings(&recording).join("\n");
        let parts = [
            "damped before it moves",
            "those of 0.5",
            "exponential 0.0408 and",
            "1 substeps",
        ];
        assert!(parts.iter().all(|part| text.contains(part)), "{text}");
        fit::apply(&mut recording, &found).expect("sound");
        assert!(is_near(f64::from(recording.gravity.y)));
        let again = fit::find(&recording, &paths(&recording).bodies);
        assert!(again.instants.is_own(), "{again:?}");
        // A step of this project's moves a body by its velocity before the step, and by all of gravity's.
        for path in paths(&recording).bodies {
            let step = recording.integrator.rate.step().seconds();
            for pair in path.states.windows(2).skip(1) {
                let [before, after] = [0, 1].map(|place| pair[place].motion());
                let fall = recording.gravity.as_dvec3() * (step * step);
                let to = before.pose().position + before.twist().linear * step + fall;
                assert!((after.pose().position - to).length() < 2e-5);
            }
        }
    }

    #[test]
    fn velocities_that_are_not_what_they_should_be_are_named() {
        type Change = fn(&mut [f64; 13]);
        let cases: [(Change, &str); 5] = [
            (
                |row| row[7..].rotate_left(3),
                "linear velocities are exchanged",
            ),
            (|row| row[10..].fill(0.0), "all angular velocities are zero"),
            (
                |row| row[10..].iter_mut().for_each(|w| *w *= 57.295_779_513),
                "in degrees",
            ),
            (|row| row[3..7].rotate_right(1), "rotations have w first"),
            (
                |row| {
                    let q = DQuat::from_slice(&row[3..7]);
                    let own = q.conjugate() * DVec3::from_slice(&row[10..]);
                    row[10..].copy_from_slice(&own.to_array());
                },
                "angular velocities are the body's axes",
            ),
        ];
        for (put, part) in cases {
            let text = findings(&rows(put)).join("\n");
            assert!(text.contains(part), "{part}: {text}");
        }
    }

    #[test]
    fn a_place_beside_the_centre_is_found_and_fitted_away() {
        let mut recording = rows(|row| {
            let arm = DQuat::from_slice(&row[3..7]) * DVec3::new(0.05, 0.0, -0.02);
            (0..3).for_each(|axis| row[axis] -= arm[axis]);
        });
        let found = fit::find(&recording, &paths(&recording).bodies);
        assert_eq!(found.centres.len(), 2);
        let centre = found.centres.values().next().expect("two");
        assert!(
            (*centre - DVec3::new(0.05, 0.0, -0.02)).length() < 2e-3,
            "{centre}"
        );
        fit::apply(&mut recording, &found).expect("sound");
        let found = fit::find(&recording, &paths(&recording).bodies);
        assert!(found.centres.is_empty(), "{:?}", found.centres);
        assert_eq!(recording.inertias.len(), 2);
        assert!((recording.gravity.y + 9.81).abs() < 0.02);
    }
}
