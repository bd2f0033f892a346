//! Poses of bodies as rows of text: `time body x y z qx qy qz qw`.
//!
//! Fields are separated by commas, semicolons, tabs or spaces. A header names the columns, in any order; without one
//! they are these nine, or eight without the body, as in TUM's files. Lines that begin with `#` are comments.

use std::str::SplitWhitespace;

use glam::{DQuat, DVec3};

use super::error::{Place, RecordingError, RowDefect};
use super::options::{QuaternionOrder, ReadOptions};
use super::poses::{TimedPose, TimedPoses};
use super::recorded::Recording;

/// Columns that a file must have, unless they have a default.
const COLUMNS: [&str; 9] = ["time", "body", "x", "y", "z", "qx", "qy", "qz", "qw"];
/// Columns of velocities, world axes: all of them, or they are not used.
const VELOCITIES: [&str; 6] = ["vx", "vy", "vz", "wx", "wy", "wz"];
/// The body of a file without names.
const ONLY_BODY: &str = "body";
/// Longest time, seconds: nanoseconds fit a whole number. Errors name it.
const SECONDS_MAX: f64 = 9e9;

/// Reads the rows of a file.
pub(super) fn read(
    name: &str,
    text: &str,
    options: &ReadOptions,
) -> Result<Recording, RecordingError> {
    // Spreadsheets begin their files with a byte order mark.
    let text = text.trim_start_matches('\u{feff}');
    // The header of some files is a comment: EuRoC's begins with `#timestamp`.
    let is_names = |line: &str| {
        let names = line.trim_start_matches('#').trim();
        line.starts_with('#')
            && Layout::of_header(1, &Separator::of(names).split(names).collect::<Vec<_>>()).is_ok()
    };
    let mut lines = (1..).zip(text.lines()).filter(|(number, line)| {
        let line = line.trim();
        !line.is_empty() && (!line.starts_with('#') || (*number == 1 && is_names(line)))
    });
    let mut poses = TimedPoses::default();
    let Some((number, first)) = lines.next() else {
        return Err(RecordingError::NoTruth);
    };
    let first = first.trim_start_matches('#').trim();
    let separator = Separator::of(first);
    let fields: Vec<&str> = separator.split(first).collect();
    let layout = match Layout::of_header(number, &fields) {
        Ok(layout) => {
            poses.part_of_velocities = part_of_velocities(&fields);
            poses.left_out.extend(layout.left_out(&fields));
            if options.quaternion.is_some() {
                let note =
                    "the header names the numbers of quaternions, so --quaternion is not used";
                poses.left_out.push(note.to_owned());
            }
            layout
        }
        Err(error) => {
            // A first row of numbers needs no header.
            let mut layout = Layout::of_numbers(&fields).ok_or(error)?;
            if options.quaternion == Some(QuaternionOrder::Wxyz) {
                layout.put_w_first();
            }
            layout.take(number, &fields, &mut poses)?;
            layout
        }
    };
    for (number, line) in lines {
        let fields: Vec<&str> = separator.split(line).collect();
        layout.take(number, &fields, &mut poses)?;
    }
    poses.recording(name, options)
}

/// The sign between fields.
#[derive(Clone, Copy, Debug)]
enum Separator {
    Char(char),
    Spaces,
}

/// Fields of a line.
enum Fields<'a> {
    Char(std::str::Split<'a, char>),
    Spaces(SplitWhitespace<'a>),
}

impl<'a> Iterator for Fields<'a> {
    type Item = &'a str;

    fn next(&mut self) -> Option<&'a str> {
        match self {
            // R and spreadsheets put fields in quotes.
            Self::Char(fields) => fields.next().map(|field| field.trim().trim_matches('"')),
            Self::Spaces(fields) => fields.next(),
        }
    }
}

impl Separator {
    fn of(line: &str) -> Self {
        let found = [',', ';', '\t']
            .into_iter()
            .find(|mark| line.contains(*mark));
        found.map_or(Self::Spaces, Self::Char)
    }

    fn split(self, line: &str) -> Fields<'_> {
        match self {
            Self::Char(mark) => Fields::Char(line.split(mark)),
            Self::Spaces => Fields::Spaces(line.split_whitespace()),
        }
    }
}

/// The place of each column in a row.
#[derive(Clone, Debug)]
struct Layout {
    /// Columns of time, x, y, z, qx, qy, qz, qw.
    numbers: [(&'static str, usize); 8],
    body: Option<usize>,
    velocities: Option<[(&'static str, usize); 6]>,
    count: usize,
    /// True if times are whole nanoseconds: the header says it, or they have sixteen digits.
    is_ns: bool,
}

impl Layout {
    /// The columns of a header.
    fn of_header(line: u32, fields: &[&str]) -> Result<Self, RecordingError> {
        let names: Vec<String> = fields
            .iter()
            .map(|field| column(field.trim_matches('"')))
            .collect();
        let is_ns = fields.iter().any(|field| {
            let field = field.to_ascii_lowercase();
            field.contains("time") && field.contains("[ns]")
        });
        let place = |column: &str| names.iter().position(|name| name == column);
        let time = place("time")
            .or_else(|| place("timestamp"))
            .or_else(|| place("t"));
        let mut missing = Vec::new();
        let mut numbers = [("", 0); 8];
        let wanted = COLUMNS.iter().filter(|column| **column != "body");
        for (number, column) in numbers.iter_mut().zip(wanted) {
            let found = if *column == "time" {
                time
            } else {
                place(column)
            };
            match found {
                Some(found) => *number = (column, found),
                None => missing.push(*column),
            }
        }
        if !missing.is_empty() {
            return Err(RecordingError::Header { line, missing });
        }
        let velocities = VELOCITIES.map(|column| (column, place(column)));
        let velocities = velocities
            .iter()
            .all(|(_, place)| place.is_some())
            .then(|| velocities.map(|(column, place)| (column, place.unwrap_or_default())));
        Ok(Self {
            numbers,
            body: place("body")
                .or_else(|| place("name"))
                .or_else(|| place("id")),
            velocities,
            count: fields.len(),
            is_ns,
        })
    }

    /// A sentence on the columns of a header that are not read. Velocities in part have their own.
    fn left_out(&self, fields: &[&str]) -> Option<String> {
        let is_read = |place: &usize| {
            let is_at = |(_, at): &(&str, usize)| at == place;
            self.numbers.iter().any(is_at)
                || self.body == Some(*place)
                || self.velocities.iter().flatten().any(is_at)
        };
        let is_velocity = |field: &str| VELOCITIES.contains(&column(field).as_str());
        let others: Vec<&str> = (0..fields.len())
            .filter(|place| !is_read(place))
            .map(|place| fields[place].trim_matches('"'))
            .filter(|field| self.velocities.is_some() || !is_velocity(field))
            .collect();
        (!others.is_empty()).then(|| format!("columns that are not read: {}", others.join(", ")))
    }

    /// Exchanges the places of x, y, z, w for those of w, x, y, z.
    fn put_w_first(&mut self) {
        let places = [4, 5, 6, 7].map(|column: usize| self.numbers[column].1);
        for (column, place) in [(7, 0), (4, 1), (5, 2), (6, 3)] {
            self.numbers[column].1 = places[place];
        }
    }

    /// The columns of a file without a header, by its first row.
    fn of_numbers(fields: &[&str]) -> Option<Self> {
        let body = match fields.len() {
            9 => Some(1),
            8 => None,
            _ => return None,
        };
        let wanted = COLUMNS.iter().filter(|column| **column != "body");
        let mut numbers = [("", 0); 8];
        let places = (0..fields.len()).filter(|place| Some(*place) != body);
        for ((number, column), place) in numbers.iter_mut().zip(wanted).zip(places) {
            *number = (column, place);
        }
        let is_number = |(_, place): &(&str, usize)| fields[*place].parse::<f64>().is_ok();
        numbers.iter().all(is_number).then_some(Self {
            numbers,
            body,
            velocities: None,
            count: fields.len(),
            is_ns: false,
        })
    }

    /// Adds the pose of a row.
    fn take(&self, line: u32, fields: &[&str], to: &mut TimedPoses) -> Result<(), RecordingError> {
        let wrong = |defect| RecordingError::Row {
            place: Place::Line(line),
            defect,
        };
        if fields.len() != self.count {
            return Err(wrong(RowDefect::Fields {
                found: fields.len(),
                expected: self.count,
            }));
        }
        let number = |(column, place): (&'static str, usize)| {
            let text = fields[place];
            let not_one = |_| {
                wrong(RowDefect::NotANumber {
                    column,
                    text: text.to_owned(),
                })
            };
            text.parse::<f64>().map_err(not_one)
        };
        let stated = number(self.numbers[0])?;
        let text = fields[self.numbers[0].1];
        let is_ns =
            self.is_ns || (text.len() >= 16 && text.bytes().all(|byte| byte.is_ascii_digit()));
        let time_s = if is_ns { stated / 1e9 } else { stated };
        // NaN is none.
        let is_time = time_s.abs() <= SECONDS_MAX;
        if !is_time {
            return Err(wrong(RowDefect::OutOfRange {
                of: "time",
                most: Some("9e9 s"),
            }));
        }
        let mut parts = [0.0; 7];
        for (part, column) in parts.iter_mut().zip(&self.numbers[1..]) {
            *part = number(*column)?;
        }
        let velocity = match self.velocities {
            None => None,
            Some(columns) => {
                let [vx, vy, vz, wx, wy, wz] = columns.map(number);
                Some([DVec3::new(vx?, vy?, vz?), DVec3::new(wx?, wy?, wz?)])
            }
        };
        let [x, y, z, qx, qy, qz, qw] = parts;
        let name = self
            .body
            .map_or(ONLY_BODY, |place| fields[place].trim_matches('"'));
        let body = to
            .body(name, None)
            .map_err(|many| many.at(Place::Line(line)))?;
        to.poses.push(TimedPose {
            at_ns: if is_ns {
                text.parse().unwrap_or((time_s * 1e9) as i64)
            } else {
                nanoseconds(text, time_s)
            },
            body,
            position: DVec3::new(x, y, z),
            rotation: DQuat::from_xyzw(qx, qy, qz, qw),
            velocity,
            place: Place::Line(line),
        });
        Ok(())
    }
}

/// The velocities of a header that has some of their columns.
fn part_of_velocities(fields: &[&str]) -> Option<String> {
    let names: Vec<String> = fields
        .iter()
        .map(|field| column(field.trim_matches('"')))
        .collect();
    let is_there = |column: &&str| names.iter().any(|name| name == column);
    let (found, missing): (Vec<&str>, Vec<&str>) = VELOCITIES.into_iter().partition(is_there);
    let is_part = !found.is_empty() && !missing.is_empty();
    is_part.then(|| {
        format!(
            "the columns {} without {}",
            found.join(", "),
            missing.join(", ")
        )
    })
}

/// The usual name of a column: without its unit, and without the prefixes of EuRoC's and others' files.
fn column(name: &str) -> String {
    let name = name.to_ascii_lowercase();
    let name = name.split(['[', '(']).next().unwrap_or_default().trim();
    let ends = |prefixes: &[&str], axes: &[&str]| {
        let all = prefixes
            .iter()
            .flat_map(|prefix| axes.iter().map(move |axis| (*prefix, *axis)));
        let mut all = all.filter(|(prefix, axis)| name.strip_prefix(prefix) == Some(axis));
        all.next().map(|(_, axis)| axis.to_owned())
    };
    let position = ends(
        &["p_rs_r_", "position_", "position.", "pos_", "p_", "t"],
        &["x", "y", "z"],
    );
    let rotation = ends(
        &[
            "q_rs_",
            "quaternion_",
            "orientation_",
            "orientation.",
            "rotation_",
            "quat_",
            "q_",
        ],
        &["x", "y", "z", "w"],
    );
    let linear = ends(&["v_rs_r_", "linear_", "vel_"], &["x", "y", "z"]);
    let angular = ends(&["angular_", "omega_"], &["x", "y", "z"]);
    let with = |letter: &str, axis: Option<String>| axis.map(|axis| format!("{letter}{axis}"));
    position
        .or_else(|| with("q", rotation))
        .or_else(|| with("v", linear))
        .or_else(|| with("w", angular))
        .unwrap_or_else(|| name.to_owned())
}

/// Nanoseconds of a time in seconds. Decimals are taken from the text: a number of 64 bits knows a time since 1970 to a
/// quarter of a microsecond only.
fn nanoseconds(text: &str, seconds: f64) -> i64 {
    let exact = || {
        let (sign, digits) = match text.strip_prefix('-') {
            Some(digits) => (-1, digits),
            None => (1, text),
        };
        let (whole, decimals) = digits.split_once('.').unwrap_or((digits, ""));
        let is_plain = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
        if !is_plain(whole) || !is_plain(decimals) {
            return None;
        }
        let whole: i64 = if whole.is_empty() {
            0
        } else {
            whole.parse().ok()?
        };
        let nine: String = decimals
            .chars()
            .chain("000000000".chars())
            .take(9)
            .collect();
        whole
            .checked_mul(1_000_000_000)?
            .checked_add(nine.parse().ok()?)
            .map(|ns| sign * ns)
    };
    exact().unwrap_or_else(|| (seconds * 1e9).round() as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ground_truth_of_euroc_is_read_by_its_names_and_nanoseconds() {
        let mut text = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], \
                        v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1]\n"
            .to_owned();
        for frame in 0..10_i64 {
            let at_ns = 1_403_715_524_912_142_000 + frame * 5_000_000;
            text += &format!("{at_ns},{}.5,0,0,1,0,0,0,1,0,0\n", frame);
        }
        let recording = read("v1", &text, &ReadOptions::default()).expect("sound");
        assert_eq!(recording.integrator.rate.ticks(), 200);
        let motion = recording.truth.placed[0].observation.motion;
        assert_eq!(
            (motion.position()[0], motion.rotation()),
            (0.5, [0.0, 0.0, 0.0, 1.0])
        );
    }

    #[test]
    fn fields_in_quotes_are_read() {
        let text = "\"time\",\"body\",\"x\",\"y\",\"z\",\"qx\",\"qy\",\"qz\",\"qw\"\n\
                    \"0.0\",\"a\",\"1.5\",0,0,0,0,0,1\n\"0.1\",\"a\",\"2.5\",0,0,0,0,0,1\n";
        let recording = read("r", text, &ReadOptions::default()).expect("quotes are no numbers");
        let motion = recording.truth.placed[0].observation.motion;
        assert_eq!((motion.position()[0], recording.ticks()), (1.5, 1));
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_the_first_name() {
        let rows = "0,1,2,3,0,0,0,1\n0.1,1,2,4,0,0,0,1\n0.2,1,2,5,0,0,0,1\n";
        for text in [
            format!("\u{feff}time,x,y,z,qx,qy,qz,qw\n{rows}"),
            format!("\u{feff}# time,x,y,z,qx,qy,qz,qw\n{rows}"),
            format!("\u{feff}{rows}"),
        ] {
            let bytes = text.as_bytes();
            let read = crate::recording::read_bytes("rows", bytes, &ReadOptions::default());
            assert_eq!(read.expect("sound").ticks(), 2, "{text}");
        }
    }

    #[test]
    fn velocities_in_part_are_fitted_and_a_note_names_what_is_missing() {
        let text = "time,x,y,z,qx,qy,qz,qw,vx,vy,vz\n\
                    0,1,2,3,0,0,0,1,9,9,9\n0.1,1,2,4,0,0,0,1,9,9,9\n0.2,1,2,5,0,0,0,1,9,9,9\n";
        let recording = read("rows", text, &ReadOptions::default()).expect("sound");
        let notes = recording.notes.join("\n");
        let part = "the columns vx, vy, vz without wx, wy, wz";
        assert!(notes.contains(part), "{notes}");
        assert!(!notes.contains("--gravity), velocities"), "{notes}");
        let motion = recording.truth.placed[0].observation.motion.motion();
        assert!(motion.twist().linear.x.abs() < 1e-6, "it is not the file's");
    }

    #[test]
    fn columns_that_are_not_read_are_named() {
        let text = "time,x,y,z,qx,qy,qz,qw,vel_x,colour,x\n\
                    0,1,2,3,0,0,0,1,9,9,9\n0.1,1,2,4,0,0,0,1,9,9,9\n0.2,1,2,5,0,0,0,1,9,9,9\n";
        let recording = read("rows", text, &ReadOptions::default()).expect("sound");
        let notes = recording.notes.join("\n");
        assert!(
            notes.contains("columns that are not read: colour, x"),
            "{notes}"
        );
        assert!(notes.contains("the columns vx without"), "{notes}");
    }

    #[test]
    fn rows_without_names_have_w_where_the_caller_says() {
        let text = "0 1 2 3 1 0 0 0\n0.1 1 2 4 1 0 0 0\n0.2 1 2 5 1 0 0 0\n";
        let options = ReadOptions {
            quaternion: Some(QuaternionOrder::Wxyz),
            ..ReadOptions::default()
        };
        let recording = read("rows", text, &options).expect("sound");
        let motion = recording.truth.placed[0].observation.motion;
        assert_eq!(motion.rotation(), [0.0, 0.0, 0.0, 1.0]);
    }
}
