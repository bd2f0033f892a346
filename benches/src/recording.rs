//! Recorded motion of a scene: the input of a replay, and its arguments.
//!
//! ```text
//!   trace.mcap, a server's recording ──▶ states of a load ───────────────────┐
//!   .rhtrace.zst ──▶ records by frame ────────────────────────────────────────┼─▶ Recording
//!   MCAP of others, CSV, NumPy ──▶ poses by time ──▶ frames of a constant rate ┤
//!   BVH, C3D ──▶ poses by frame of a stated rate ──────────────────────────────┘
//! ```
//! A recording is checked when it is read, so a replay can rely on it. A fact that the file lacks is a note.
//!
//! The file's content tells its form.

mod arrays;
mod bvh;
mod c3d;
mod csv;
mod error;
pub(crate) mod estimates;
pub(crate) mod fit;
mod foxglove;
pub mod mcap;
mod mocap;
mod npy;
mod options;
mod poses;
pub(crate) mod recorded;
pub mod rhtrace;
mod ros2;
mod stays;

use std::io::{self, Read, Write};
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};

use clap::Args;
use glam::Vec3;
use rhumb_protocol::limits::{GRAVITY_MAX, SUBSTEPS_MAX};
use rhumb_reckoning::{Damping, Metres, Radians, Rate, Tolerance};

use crate::output::{self, Failure};
use options::{rate_of_hertz, unit};

pub use bvh::{BvhDefect, BvhError, PositionChannels};
pub use c3d::C3dError;
pub use error::{BodyDefect, CdrError, Place, RecordingError, RowDefect};
pub use npy::NpyError;
pub use options::{MissingPoses, QuaternionOrder, ReadOptions, ShapeChoice};
pub(crate) use recorded::first_track;
pub use recorded::{Recording, ScriptOrigin, Velocities};
pub use rhtrace::write as write_rhtrace;
pub use ros2::write_bag;

/// The first bytes of what zstd packs.
const ZSTD: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];
/// The first bytes of an MCAP file.
const MCAP: &[u8] = b"\x89MCAP0\r\n";

/// A rate on the command line, Hz.
pub(crate) fn hertz(text: &str) -> Result<Rate, String> {
    rate_of_hertz(text)
}

/// Reads a recording.
///
/// # Errors
///
/// [`RecordingError`] names the file and the defect.
pub fn read(path: &Path, options: &ReadOptions) -> Result<Recording, RecordingError> {
    let bytes = read_all(path, BYTES_MAX).map_err(|cause| RecordingError::read(path, cause))?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let name = name.split('.').next().unwrap_or_default();
    let recording = read_bytes(name, &bytes, options);
    recording.map_err(|cause| RecordingError::File {
        path: path.to_owned(),
        cause: Box::new(cause),
    })
}

/// Most bytes of a file.
const BYTES_MAX: u64 = 4 << 30;

/// The bytes of a file, of which there are this many at most.
fn read_all(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let file = std::fs::File::open(path)?;
    let mut bytes = Vec::new();
    file.take(most + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let text = format!("it has more than {most} bytes, the most that are read");
        return Err(io::Error::new(io::ErrorKind::FileTooLarge, text));
    }
    Ok(bytes)
}

/// Reads the bytes of a file, whose first ones tell its form.
///
/// # Errors
///
/// [`RecordingError`] names the defect and its place.
pub fn read_bytes(
    name: &str,
    bytes: &[u8],
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    if bytes.starts_with(MCAP) {
        return mcap::read(name, bytes, options);
    }
    if bytes.starts_with(ZSTD) || rhtrace::is_plain(bytes) {
        let mut recording = rhtrace::read(name, bytes)?;
        recording.notes.extend(options.note_of_states());
        return Ok(recording);
    }
    let (read, unused) = if bytes.starts_with(npy::ZIP) {
        let unused = options.note_unused("arrays", &["--quaternion"]);
        (arrays::read_archive(name, bytes, options), unused)
    } else if bytes.starts_with(npy::MAGIC) {
        let unused = options.note_unused("arrays", &["--quaternion"]);
        (arrays::read_array(name, bytes, options), unused)
    } else if c3d::is_c3d(bytes) {
        let unused = options.note_unused("C3D files", &["--unit"]);
        (mocap::read_c3d(name, bytes, options), unused)
    } else {
        let text = std::str::from_utf8(bytes)
            .ok()
            .filter(|text| !text.trim().is_empty());
        let text = text.ok_or(RecordingError::UnknownForm)?;
        if bvh::is_bvh(text) {
            let unused = options.note_unused("BVH files", &["--unit", "--bvh-positions"]);
            (mocap::read_bvh(name, text, options), unused)
        } else {
            let unused = options.note_unused("rows", &["--quaternion"]);
            (csv::read(name, text, options), unused)
        }
    };
    let mut recording = read?;
    recording.notes.extend(unused);
    Ok(recording)
}

/// The recording and the parameters of its engine.
#[derive(Clone, Debug, Args)]
pub struct RecordingSource {
    /// The recording: a trace.mcap, a recording of a server, poses of bodies in MCAP, CSV, .npz, .npy, BVH or C3D, or an
    /// .rhtrace.zst.
    trace: PathBuf,
    /// The load of a trace such as n500, the scene of a recording, or transforms, poses or scene of another program's
    /// file [default: the file's first].
    #[arg(long, value_name = "NAME")]
    load: Option<String>,
    /// Poses: their rate in hertz, such as 29.97 [default: found from the times].
    #[arg(long, value_name = "HZ", value_parser = hertz)]
    rate: Option<Rate>,
    /// Poses: interpolate all of them at this rate, for files whose bodies have rates of their own, or none.
    #[arg(long, value_name = "HZ", value_parser = hertz, conflicts_with = "rate")]
    resample: Option<Rate>,
    /// Poses: gravity in their frame, m/s² [default: none].
    #[arg(long, value_name = "X,Y,Z", value_parser = gravity, allow_hyphen_values = true)]
    gravity: Option<Vec3>,
    /// Poses: shape of all bodies, or of one, such as cuboid:0.2,0.1,0.3 or arm=capsule:0.5,0.1; may be repeated
    /// [default: ball:0.1].
    #[arg(long, value_name = "SHAPE")]
    shape: Vec<ShapeChoice>,
    /// Poses: what it means that a body has none in a frame.
    #[arg(long, value_enum, default_value = "gone")]
    missing: MissingPoses,
    /// Arrays and rows without names: where a quaternion has its w [default: of rows last; arrays have to say it].
    #[arg(long, value_enum, value_name = "ORDER")]
    quaternion: Option<QuaternionOrder>,
    /// BVH and C3D: the unit of positions: mm, cm, m, in, ft, or a number of metres [default: the one that the file states;
    /// BVH files state none].
    #[arg(long, value_name = "UNIT", value_parser = unit)]
    unit: Option<Metres>,
    /// BVH: the meaning of positions of joints with an offset [default: by the first frame].
    #[arg(long, value_enum, value_name = "READING")]
    bvh_positions: Option<PositionChannels>,
    /// Take gravity, substeps, damping, inertia and centres of mass as its poses and velocities say: see `check`.
    #[arg(long)]
    fit: bool,
    /// Linear and angular damping of the recorded bodies, 1/s, if they differ from the recording's scene.
    #[arg(long, value_parser = damping)]
    damping: Option<Damping>,
    /// Substeps of the recorded engine, if they differ from the recording's scene.
    #[arg(long, value_parser = substeps)]
    substeps: Option<NonZeroU32>,
}

impl RecordingSource {
    /// Refuses an output folder whose `trace.mcap` is the recording itself.
    pub(crate) fn refuse_overwriting(&self, out: &Path) -> Result<(), Failure> {
        let real = |path: &Path| path.canonicalize().ok();
        let own = real(&self.trace);
        if own.is_some() && own == real(&output::trace_of(out)) {
            return Err(format!(
                "the trace of this replay would overwrite {}: choose another folder by --out, or use --no-trace",
                self.trace.display()
            )
            .into());
        }
        Ok(())
    }

    pub(crate) fn read(&self) -> Result<Recording, RecordingError> {
        let options = ReadOptions {
            load: self.load.clone(),
            rate: self.rate,
            resample: self.resample,
            gravity: self.gravity,
            shapes: self.shape.clone(),
            missing: self.missing,
            quaternion: self.quaternion,
            unit: self.unit,
            positions: self.bvh_positions,
        };
        let mut recording = read(&self.trace, &options)?;
        print_notes(&recording);
        if self.fit {
            let found = fit::find(&recording, &recorded::paths(&recording).bodies);
            let known = recording.notes.len();
            fit::apply(&mut recording, &found)?;
            print_some_notes(&recording, known);
        }
        recording.damping = self.damping.unwrap_or(recording.damping);
        recording.integrator.substeps = self.substeps.unwrap_or(recording.integrator.substeps);
        Ok(recording)
    }
}

/// Prints the facts that a file lacks to standard error.
pub(crate) fn print_notes(recording: &Recording) {
    print_some_notes(recording, 0);
}

/// Prints the notes from this one on.
fn print_some_notes(recording: &Recording, first: usize) {
    for note in &recording.notes[first..] {
        // If standard error is closed, no other place is left to report to.
        let _ = writeln!(io::stderr(), "note: {}: {note}", recording.name);
    }
}

/// Parses a number of substeps.
fn substeps(text: &str) -> Result<NonZeroU32, String> {
    let count: Option<NonZeroU32> = text.parse().ok();
    let count = count.filter(|count| count.get() <= SUBSTEPS_MAX);
    count.ok_or_else(|| format!("must be a whole number from 1 to {SUBSTEPS_MAX}"))
}

/// Parses `0,-9.81,0`.
fn gravity(text: &str) -> Result<Vec3, String> {
    let numbers: Result<Vec<f32>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    let gravity = match numbers.as_deref() {
        Ok(&[x, y, z]) => Some(Vec3::new(x, y, z)),
        _ => None,
    };
    // NaN is none.
    let is_gravity = |of: &Vec3| of.is_finite() && of.abs().max_element() <= GRAVITY_MAX;
    let gravity = gravity.filter(is_gravity);
    gravity.ok_or_else(|| format!("must be three numbers, x,y,z, up to {GRAVITY_MAX} m/s²"))
}

/// Parses `0.1,0.05`.
fn damping(text: &str) -> Result<Damping, String> {
    let (linear, angular) = text
        .split_once(',')
        .ok_or("must be two numbers, linear,angular")?;
    let read = |text: &str| {
        let value = text.trim().parse::<f32>().ok();
        value.filter(|value| (0.0..=1_000.0).contains(value))
    };
    let pair = read(linear).zip(read(angular));
    let (linear, angular) = pair.ok_or("must be two numbers from 0 to 1000")?;
    Ok(Damping { linear, angular })
}

/// Tolerance of every task that is given none, metres.
pub(crate) const DEFAULT_TOLERANCE: &str = "0.05";

/// Arguments of the tolerance.
#[derive(Clone, Copy, Debug, Args)]
pub struct ToleranceOptions {
    /// Tolerance of a copied body's surface error, metres.
    #[arg(long, default_value = DEFAULT_TOLERANCE, allow_negative_numbers = true)]
    pub(crate) tolerance: f64,
    /// Tolerance of its rotation, degrees; --tolerance then bounds its position alone.
    #[arg(long, allow_negative_numbers = true)]
    pub(crate) turn: Option<f64>,
}

impl ToleranceOptions {
    pub(crate) fn tolerance(&self) -> Result<Tolerance, String> {
        let metres = Metres::new(self.tolerance);
        let read = match self.turn {
            Some(degrees) => Tolerance::parts(metres, Radians::new(degrees.to_radians())),
            None => Tolerance::from_metres(metres),
        };
        read.map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_file_and_what_would_be_read() {
        let folder = std::env::temp_dir().join(format!("rhumb-recording-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("the temporary folder is writable");
        let contents: [(&str, &[u8]); 4] = [
            ("empty.mcap", b""),
            ("picture.png", b"\x89PNG\r\n\xff"),
            ("letter.txt", b"Dear all, this is no recording.\n"),
            ("half.rhtrace.zst", b"\x28\xb5\x2f\xfd"),
        ];
        for (name, bytes) in contents {
            let path = folder.join(name);
            std::fs::write(&path, bytes).expect("it is our own folder");
            let error = read(&path, &ReadOptions::default()).expect_err("it is no recording");
            let (message, named) = (error.to_string(), path.display().to_string());
            assert!(message.contains(&named), "{message}");
        }
        let error = read(&folder.join("empty.mcap"), &ReadOptions::default());
        let message = error.expect_err("it is empty").to_string();
        assert!(message.contains("foxglove.FrameTransforms"), "{message}");
        let missing = read(&folder.join("nosuch.mcap"), &ReadOptions::default());
        assert!(matches!(missing, Err(RecordingError::Read { .. })));
        let letter = folder.join("letter.txt");
        let whole = read_all(&letter, 32).expect("it has as many");
        assert_eq!(whole.len(), 32);
        let error = read_all(&letter, 31).expect_err("it has more").to_string();
        assert!(error.contains("more than 31 bytes"), "{error}");
        std::fs::remove_dir_all(folder).expect("it is our own folder");
    }

    #[test]
    fn options_that_a_file_does_not_use_are_said() {
        let rows = "time,body,x,y,z,qx,qy,qz,qw\n0,a,0,0,0,0,0,0,1\n0.1,a,1,0,0,0,0,0,1\n";
        let options = ReadOptions {
            load: Some("x".to_owned()),
            unit: Some(Metres::new(0.01)),
            positions: Some(PositionChannels::Add),
            quaternion: Some(QuaternionOrder::Wxyz),
            shapes: vec!["b=ball:0.3".parse().expect("a shape")],
            ..ReadOptions::default()
        };
        let notes = read_bytes("r", rows.as_bytes(), &options)
            .expect("rows")
            .notes;
        let notes = notes.join("\n");
        for part in [
            "rows do not use this: --load, --unit, --bvh-positions",
            "names the numbers of quaternions, so --quaternion is not used",
            "--shape is not used for b: the file has no body of that name, but a",
            "a ball of 0.1 m for each body",
        ] {
            assert!(notes.contains(part), "{part}: {notes}");
        }
    }
}
