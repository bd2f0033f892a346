//! Axes of joints, from other coordinates to Rhumb's.
//!
//! A joint's frames turn with the axes of their bodies. The first axis of a frame stays the first one in all coordinates, so
//! a hinge stays a hinge; limits and motors go to the axis that the application's becomes, with its direction.

use glam::Vec3;
use rhumb_client::scene::{JointKind, JointLimits, JointStrength, LockedAxes, Motor, Spring};

/// The axes of an application's joints, as Rhumb's.
pub(super) struct JointAxes {
    each: [JointAxis; 6],
    metres_per_unit: f32,
}

/// The axis of Rhumb's that corresponds to one of the application's.
struct JointAxis {
    place: usize,
    /// −1 where it points the other way.
    sign: f32,
    /// Rhumb's metres or radians in one unit.
    unit: f32,
    /// Rhumb's newtons or newton metres in one unit.
    load: f32,
}

impl JointAxis {
    /// A position or velocity. A zero stays without a sign.
    fn value(&self, value: f32) -> f32 {
        let scaled = value * self.unit;
        match self.sign < 0.0 {
            true => 0.0 - scaled,
            false => scaled,
        }
    }

    fn limits(&self, limits: JointLimits) -> JointLimits {
        let ends = [self.value(limits.least), self.value(limits.most)];
        let [least, most] = match self.sign < 0.0 {
            true => [ends[1], ends[0]],
            false => ends,
        };
        JointLimits { least, most }
    }

    fn motor(&self, motor: Motor) -> Motor {
        Motor {
            position: self.value(motor.position),
            velocity: self.value(motor.velocity),
            force: motor.force * self.load,
            ..motor
        }
    }
}

impl JointAxes {
    /// The axes by what a direction and an angular velocity of the application become.
    pub(super) fn new(
        direction: impl Fn(Vec3) -> Vec3,
        angular: impl Fn(Vec3) -> Vec3,
        metres_per_unit: f32,
    ) -> Self {
        let translation = |axis: usize| {
            let turned = direction(Vec3::AXES[axis]);
            let place = turned.abs().max_position();
            JointAxis {
                place,
                sign: turned[place],
                unit: metres_per_unit,
                load: metres_per_unit,
            }
        };
        let rotation = |axis: usize| {
            let turned = angular(Vec3::AXES[axis]);
            let place = turned.abs().max_position();
            JointAxis {
                place: place + 3,
                sign: turned[place],
                unit: 1.0,
                load: metres_per_unit * metres_per_unit,
            }
        };
        let each = std::array::from_fn(|axis| match axis {
            0..3 => translation(axis),
            _ => rotation(axis - 3),
        });
        Self {
            each,
            metres_per_unit,
        }
    }

    /// Values of six axes, at Rhumb's.
    fn six<T: Copy>(
        &self,
        values: [Option<T>; 6],
        convert: impl Fn(&JointAxis, T) -> T,
    ) -> [Option<T>; 6] {
        let mut turned = [None; 6];
        for (axis, value) in self.each.iter().zip(values) {
            turned[axis.place] = value.map(|value| convert(axis, value));
        }
        turned
    }

    fn locked(&self, locked: LockedAxes) -> LockedAxes {
        let axes = self.each.iter().enumerate();
        let turned = axes.filter(|(axis, _)| locked.locks(*axis));
        turned.fold(LockedAxes::NONE, |all, (_, axis)| {
            all | LockedAxes::EACH[axis.place]
        })
    }

    pub(super) fn kind(&self, kind: JointKind) -> JointKind {
        let limits = self.six(kind.limits(), JointAxis::limits);
        match kind {
            JointKind::Fixed | JointKind::Spherical(None) => kind,
            JointKind::Spherical(Some(_)) => JointKind::Spherical(match limits {
                [_, _, _, Some(x), Some(y), Some(z)] => Some([x, y, z]),
                _ => None,
            }),
            JointKind::Revolute(_) => JointKind::Revolute(limits[3]),
            JointKind::Prismatic(_) => JointKind::Prismatic(limits[0]),
            JointKind::Rope(length) => JointKind::Rope(length * self.metres_per_unit),
            // Newtons per metre have no unit of length.
            JointKind::Spring(spring) => JointKind::Spring(Spring {
                length: spring.length * self.metres_per_unit,
                ..spring
            }),
            JointKind::Generic(locked, _) => JointKind::Generic(self.locked(locked), limits),
        }
    }

    pub(super) fn motors(&self, motors: [Option<Motor>; 6]) -> [Option<Motor>; 6] {
        self.six(motors, JointAxis::motor)
    }

    pub(super) fn strength(&self, strength: JointStrength) -> JointStrength {
        JointStrength {
            force: strength.force * self.metres_per_unit,
            torque: strength.torque * (self.metres_per_unit * self.metres_per_unit),
        }
    }
}
