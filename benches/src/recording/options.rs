//! Facts that a recording may lack: options of the caller, the constant rate.
//!
//! The rate comes from the recording's step or from its times.

use std::str::FromStr;

use glam::Vec3;
use rhumb_protocol::scene::Shape;
use rhumb_reckoning::{Metres, Rate};

use super::bvh::PositionChannels;
use super::error::RecordingError;

/// Facts that the caller states where a file does not.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// The load of a trace, the scene of a recording, or the kind of poses; by default the file's first.
    pub load: Option<String>,
    /// The rate of poses by time; by default it is found.
    pub rate: Option<Rate>,
    /// Gravity of poses by time, m/s²; by default none.
    pub gravity: Option<Vec3>,
    /// Shapes of bodies without one.
    pub shapes: Vec<ShapeChoice>,
    /// A body without a pose in a frame.
    pub missing: MissingPoses,
    /// A rate at which all poses are interpolated.
    pub resample: Option<Rate>,
    /// The order of quaternions where the file does not say it.
    pub quaternion: Option<QuaternionOrder>,
    /// The length of one unit of positions, for files of cameras, which may not say it.
    pub unit: Option<Metres>,
    /// The reading of a BVH file's positions; by default that of its first frame.
    pub positions: Option<PositionChannels>,
}

/// The order of a quaternion's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum QuaternionOrder {
    /// The scalar part last: ROS, PyBullet, glTF, this project.
    Xyzw,
    /// The scalar part first: MuJoCo, Jolt's scripts, EuRoC.
    Wxyz,
}

/// The meaning of a frame without a pose of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum MissingPoses {
    /// Up to three frames are filled; beyond them the body is gone until its next pose.
    #[default]
    Gone,
    /// The body has not moved.
    Hold,
}

/// A shape, and the body that has it; all bodies without a name.
#[derive(Clone, Debug, PartialEq)]
pub struct ShapeChoice {
    /// The body's name in the file.
    pub body: Option<String>,
    /// Its shape.
    pub shape: Shape,
}

impl FromStr for ShapeChoice {
    type Err = String;

    /// `ball:0.1`, `cuboid:0.2,0.1,0.3` (half extents), `capsule:0.5,0.1`, `cylinder:0.5,0.1` (half height, radius); with
    /// `NAME=` before it for one body.
    fn from_str(text: &str) -> Result<Self, String> {
        let (body, shape) = match text.split_once('=') {
            Some((body, shape)) => (Some(body.to_owned()), shape),
            None => (None, text),
        };
        let shape = rhumb_dis::rules::shape(shape)?;
        Ok(Self { body, shape })
    }
}

/// Most bodies that a sentence names.
const NAMED_MAX: usize = 5;

impl ReadOptions {
    /// The requested load, or the first.
    pub(super) fn choose<'a>(&self, loads: &'a [String]) -> Result<&'a str, RecordingError> {
        let chosen = match &self.load {
            None => loads.first(),
            Some(name) => loads.iter().find(|load| *load == name),
        };
        let unknown = || RecordingError::UnknownLoad {
            name: self.load.clone().unwrap_or_default(),
            loads: loads.to_vec(),
        };
        chosen.map(String::as_str).ok_or_else(unknown)
    }

    /// A sentence on what the caller states and a file with states of its own says already.
    pub(super) fn note_of_states(&self) -> Option<String> {
        let stated = [
            ("--rate", self.rate.is_some()),
            ("--resample", self.resample.is_some()),
            ("--gravity", self.gravity.is_some()),
            ("--shape", !self.shapes.is_empty()),
            ("--missing", self.missing != MissingPoses::default()),
            ("--quaternion", self.quaternion.is_some()),
            ("--unit", self.unit.is_some()),
            ("--bvh-positions", self.positions.is_some()),
        ];
        let stated = stated.iter().filter(|(_, is_stated)| *is_stated);
        let flags: Vec<&str> = stated.map(|(flag, _)| *flag).collect();
        let note = || {
            format!(
                "the file has states, not poses alone, so this is not used: {}",
                flags.join(", ")
            )
        };
        (!flags.is_empty()).then(note)
    }

    /// A sentence on shapes of bodies that the file has not.
    pub(super) fn note_of_shapes(&self, bodies: &[&str]) -> Option<String> {
        let named = self
            .shapes
            .iter()
            .filter_map(|choice| choice.body.as_deref());
        let unknown: Vec<&str> = named.filter(|name| !bodies.contains(name)).collect();
        let known = bodies[..bodies.len().min(NAMED_MAX)].join(", ");
        (!unknown.is_empty()).then(|| {
            format!(
                "--shape is not used for {}: the file has no body of that name, but {known}{}",
                unknown.join(", "),
                if bodies.len() > NAMED_MAX {
                    " and others"
                } else {
                    ""
                }
            )
        })
    }

    /// A sentence on what the caller states and files of a form do not ask for; `used`: what they do.
    pub(super) fn note_unused(&self, form: &str, used: &[&str]) -> Option<String> {
        let stated = [
            ("--load", self.load.is_some()),
            ("--quaternion", self.quaternion.is_some()),
            ("--unit", self.unit.is_some()),
            ("--bvh-positions", self.positions.is_some()),
        ];
        let unused = stated
            .iter()
            .filter(|(flag, is_stated)| *is_stated && !used.contains(flag));
        let flags: Vec<&str> = unused.map(|(flag, _)| *flag).collect();
        (!flags.is_empty()).then(|| format!("{form} do not use this: {}", flags.join(", ")))
    }

    /// The shape that is chosen for a body.
    pub(super) fn chosen(&self, body: &str) -> Option<&Shape> {
        let of_body = |choice: &&ShapeChoice| choice.body.as_deref() == Some(body);
        let of_all = |choice: &&ShapeChoice| choice.body.is_none();
        let mut choices = self.shapes.iter();
        let chosen = choices
            .clone()
            .find(of_body)
            .or_else(|| choices.find(of_all));
        chosen.map(|choice| &choice.shape)
    }

    /// The shape of a body that has none in the file: a ball of 10 cm, unless one is chosen.
    pub(super) fn shape(&self, body: &str) -> Shape {
        let chosen = self.chosen(body).cloned();
        chosen.unwrap_or(Shape::Ball { radius: 0.1 })
    }
}

/// Rates of recordings, Hz.
const HERTZ: std::ops::RangeInclusive<f64> = 1.0..=1_000.0;
/// Denominators of rates that are neither whole nor NTSC's.
const SECONDS_MAX: u32 = 10_000;

/// The simplest rate whose step is within `share` of this one: a whole one, or 1000/1001 of one as of film and
/// television, or the first of a hundred hertz with the fewest decimals. `None` beyond 1 to 1000 Hz.
pub(super) fn rate_of_step(step_s: f64, share: f64) -> Option<Rate> {
    let hertz = 1.0 / step_s;
    let in_range = (0.999..=1_000.5).contains(&hertz);
    if !in_range {
        return None;
    }
    let rate = |ticks: f64, seconds: u32| {
        let rate = Rate::new(ticks as u32, seconds)?;
        let hertz = f64::from(rate.ticks()) / f64::from(rate.seconds());
        let fits = (hertz * step_s - 1.0).abs() <= share && HERTZ.contains(&hertz);
        fits.then_some(rate)
    };
    let decimals = [10, 100, 1_000].map(|seconds| (hertz * f64::from(seconds), seconds));
    let simple = [(hertz, 1), (hertz * 1.001, 1)];
    let whole = rate(simple[0].0.round(), 1);
    let television = || rate((simple[1].0).round() * 1_000.0, 1_001);
    let decimal = || {
        let mut all = decimals.iter();
        all.find_map(|(ticks, seconds)| rate(ticks.round(), *seconds))
    };
    // Some clocks count whole microseconds: 36 ms are 250/9 Hz.
    let microseconds = || rate(1_000_000.0, (step_s * 1e6).round() as u32);
    let finest = || rate((hertz * f64::from(SECONDS_MAX)).round(), SECONDS_MAX);
    let simple = whole.or_else(television).or_else(decimal);
    let found = simple.or_else(microseconds).or_else(finest)?;
    reduced(found)
}

/// The rate in lowest terms.
fn reduced(rate: Rate) -> Option<Rate> {
    let (mut a, mut b) = (rate.ticks(), rate.seconds());
    while b > 0 {
        (a, b) = (b, a % b);
    }
    Rate::new(rate.ticks() / a, rate.seconds() / a)
}

/// The rate of a number of hertz on the command line.
pub(super) fn rate_of_hertz(text: &str) -> Result<Rate, String> {
    let hertz: Option<f64> = text.parse().ok();
    let hertz = hertz.filter(|hertz| HERTZ.contains(hertz));
    let rate = hertz.and_then(|hertz| rate_of_step(1.0 / hertz, 1e-7));
    rate.ok_or_else(|| "must be a number of hertz from 1 to 1000".to_owned())
}

/// Lengths by their names, metres; the first of each are those of the command line.
const UNITS: [(&str, f64); 13] = [
    ("mm", 0.001),
    ("cm", 0.01),
    ("m", 1.0),
    ("in", 0.0254),
    ("ft", 0.3048),
    ("millimeters", 0.001),
    ("millimetres", 0.001),
    ("centimeters", 0.01),
    ("centimetres", 0.01),
    ("meters", 1.0),
    ("metres", 1.0),
    ("inches", 0.0254),
    ("feet", 0.3048),
];

/// The length of this name.
pub(super) fn unit_of_name(name: &str) -> Option<Metres> {
    let mut units = UNITS.iter();
    let known = units.find(|(known, _)| known.eq_ignore_ascii_case(name.trim()));
    known.map(|(_, metres)| Metres::new(*metres))
}

/// The length of a unit on the command line: a name, or a number of metres.
pub(super) fn unit(text: &str) -> Result<Metres, String> {
    let number = || {
        let metres = text.parse::<f64>().ok();
        metres.filter(|metres| (1e-6..=1e6).contains(metres))
    };
    let unit = unit_of_name(text).or_else(|| number().map(Metres::new));
    unit.ok_or_else(|| {
        "must be mm, cm, m, in, ft, or a number of metres from 0.000001 to 1000000".to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_is_a_name_or_a_number_of_metres() {
        for (text, metres) in [
            ("mm", 0.001),
            ("CM", 0.01),
            ("m", 1.0),
            ("0.0254", 0.0254),
            ("feet", 0.3048),
        ] {
            assert_eq!(unit(text), Ok(Metres::new(metres)), "{text}");
        }
        for wrong in ["", "0", "-1", "NaN", "inf", "parsec", "1e7"] {
            assert!(unit(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn shapes_are_chosen_for_one_body_or_for_all() {
        let options = ReadOptions {
            shapes: ["cuboid:0.2,0.1,0.3", "arm=capsule:0.5,0.1"]
                .map(|text| text.parse().unwrap())
                .into(),
            ..ReadOptions::default()
        };
        assert!(matches!(options.shape("arm"), Shape::Capsule { .. }));
        assert!(matches!(options.shape("leg"), Shape::Cuboid { .. }));
        assert!(
            matches!(ReadOptions::default().shape("leg"), Shape::Ball { radius } if radius == 0.1)
        );
        for wrong in [
            "",
            "ball",
            "ball:",
            "ball:x",
            "ball:1,2",
            "cuboid:1,2",
            "ball:-1",
            "ball:NaN",
            "egg:1",
        ] {
            assert!(wrong.parse::<ShapeChoice>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn rates_of_cameras_and_engines_are_exact_from_a_step_in_single_precision() {
        for (hertz, ticks, seconds) in [
            (60.0, 60, 1),
            (1.0, 1, 1),
            (1_000.0, 1_000, 1),
            (30_000.0 / 1_001.0, 30_000, 1_001),
            (29.97, 2_997, 100),
            (119.88, 2_997, 25),
            (120_000.0 / 1_001.0, 120_000, 1_001),
            (22.5, 45, 2),
            (11.33, 1_133, 100),
            (59.94, 2_997, 50),
            (1.0 / 0.036, 250, 9),
        ] {
            let step_s = f64::from((1.0 / hertz) as f32);
            let rate = rate_of_step(step_s, 1e-7).unwrap();
            assert_eq!((rate.ticks(), rate.seconds()), (ticks, seconds), "{hertz}");
        }
        for step_s in [0.0, -1.0, 2.0, 1e-4, f64::NAN, f64::INFINITY] {
            assert_eq!(rate_of_step(step_s, 1e-7), None, "{step_s}");
        }
    }

    #[test]
    fn a_rate_on_the_command_line_is_exact() {
        assert_eq!(
            rate_of_hertz("29.97").unwrap(),
            Rate::new(2_997, 100).unwrap()
        );
        for wrong in ["", "0", "-60", "1001", "fast", "NaN"] {
            assert!(rate_of_hertz(wrong).is_err(), "{wrong}");
        }
    }
}
