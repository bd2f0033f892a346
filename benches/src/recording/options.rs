//! Facts of a recording that the caller states where the file does not.

use std::str::FromStr;

use glam::Vec3;
use rhumb_protocol::scene::Shape;
use rhumb_reckoning::Rate;

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
        let forms = "must be ball:R, cuboid:X,Y,Z, capsule:H,R or cylinder:H,R in metres, of half extents and half heights";
        let (kind, numbers) = shape.split_once(':').ok_or(forms)?;
        let numbers: Result<Vec<f32>, _> = numbers.split(',').map(|n| n.trim().parse()).collect();
        let shape = match (kind, numbers.as_deref()) {
            ("ball", Ok(&[radius])) => Shape::Ball { radius },
            ("cuboid", Ok(&[x, y, z])) => Shape::Cuboid {
                half_extents: Vec3::new(x, y, z),
            },
            ("capsule", Ok(&[half_height, radius])) => Shape::Capsule {
                half_height,
                radius,
            },
            ("cylinder", Ok(&[half_height, radius])) => Shape::Cylinder {
                half_height,
                radius,
            },
            _ => return Err(forms.to_owned()),
        };
        shape.check().map_err(|invalid| invalid.to_string())?;
        Ok(Self { body, shape })
    }
}

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

    /// The shape of a body that has none in the file: a ball of 10 cm, unless one is chosen.
    pub(super) fn shape(&self, body: &str) -> Shape {
        let of_body = |choice: &&ShapeChoice| choice.body.as_deref() == Some(body);
        let of_all = |choice: &&ShapeChoice| choice.body.is_none();
        let mut choices = self.shapes.iter();
        let chosen = choices
            .clone()
            .find(of_body)
            .or_else(|| choices.find(of_all));
        chosen.map_or(Shape::Ball { radius: 0.1 }, |choice| choice.shape.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
