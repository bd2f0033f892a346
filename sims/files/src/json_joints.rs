//! Joints of the JSON scene.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{Joint, JointFrame, JointKind, JointLimits, LockedAxes, Motor, Spring};
use rhumb_reckoning::BodyId;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::assemble::LoadedJoint;
use crate::report::Problem;

/// A joint of two bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SceneFileJoint {
    /// Its name.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Places of its bodies in the list, from zero.
    pub bodies: [usize; 2],
    /// Its free motions.
    pub kind: SceneFileJointKind,
    /// Position and rotation (frame → body) of its frame in each body, from the centre of mass.
    pub frames: [SceneFileFrame; 2],
    /// True if the bodies also collide with each other.
    #[serde(default, skip_serializing_if = "is_false")]
    pub collide: bool,
    /// Motors of axes 0 to 5: translations along x, y, z, then turns about them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub motors: BTreeMap<u8, SceneFileMotor>,
    /// Fields that no version has.
    #[serde(flatten)]
    pub other: BTreeMap<String, Value>,
}

/// Frame of a joint in one of its bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFileFrame {
    /// Metres.
    pub position: [f32; 3],
    /// Frame → body.
    #[serde(default = "identity")]
    pub rotation: [f32; 4],
}

/// Free motions of a joint: radians or metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
#[expect(missing_docs, reason = "the fields are those of the protocol's joints")]
pub enum SceneFileJointKind {
    /// None.
    Fixed,
    /// Every turn.
    Spherical { limits: Option<[[f32; 2]; 3]> },
    /// The turn about x.
    Revolute { limits: Option<[f32; 2]> },
    /// The displacement along x.
    Prismatic { limits: Option<[f32; 2]> },
    /// Everything within a distance.
    Rope { length: f32 },
    /// Everything against a spring.
    Spring {
        length: f32,
        stiffness: f32,
        damping: f32,
    },
    /// Axes that are not among the locked bits.
    Generic {
        locked: u8,
        limits: [Option<[f32; 2]>; 6],
    },
}

/// A motor of an axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneFileMotor {
    /// Metres or radians.
    pub position: f32,
    /// m/s or rad/s.
    pub velocity: f32,
    /// 1/s².
    pub stiffness: f32,
    /// 1/s.
    pub damping: f32,
    /// N or N·m.
    pub force: f32,
}

pub(crate) fn is_false(value: &bool) -> bool {
    !value
}

pub(crate) const fn identity() -> [f32; 4] {
    [0.0, 0.0, 0.0, 1.0]
}

const fn limits([least, most]: [f32; 2]) -> JointLimits {
    JointLimits { least, most }
}

const fn pair(limits: JointLimits) -> [f32; 2] {
    [limits.least, limits.most]
}

impl SceneFileJoint {
    pub(crate) fn load(&self, name: &str) -> Result<LoadedJoint, Problem> {
        let senseless = |rule| Problem::Senseless {
            name: name.to_owned(),
            rule,
        };
        let kind = match self.kind {
            SceneFileJointKind::Fixed => JointKind::Fixed,
            SceneFileJointKind::Spherical { limits: own } => {
                JointKind::Spherical(own.map(|all| all.map(limits)))
            }
            SceneFileJointKind::Revolute { limits: own } => JointKind::Revolute(own.map(limits)),
            SceneFileJointKind::Prismatic { limits: own } => JointKind::Prismatic(own.map(limits)),
            SceneFileJointKind::Rope { length } => JointKind::Rope(length),
            SceneFileJointKind::Spring {
                length,
                stiffness,
                damping,
            } => JointKind::Spring(Spring {
                length,
                stiffness,
                damping,
            }),
            SceneFileJointKind::Generic {
                locked,
                limits: own,
            } => {
                let rule = "the locked axes of a generic joint are bits 0 to 5: 63 at most";
                let locked = LockedAxes::new(locked).ok_or_else(|| senseless(rule))?;
                JointKind::Generic(locked, own.map(|one| one.map(limits)))
            }
        };
        let frames = (self.frames.each_ref()).map(|frame| JointFrame {
            anchor: Vec3::from_array(frame.position),
            rotation: Quat::from_array(frame.rotation),
        });
        let mut joint = Joint::plain(kind, [BodyId::new(0, 0); 2], frames);
        joint.collide = self.collide;
        for (axis, motor) in &self.motors {
            let Some(place) = joint.motors.get_mut(usize::from(*axis)) else {
                return Err(senseless("the axis of a motor is 0 to 5"));
            };
            *place = Some(Motor {
                position: motor.position,
                velocity: motor.velocity,
                stiffness: motor.stiffness,
                damping: motor.damping,
                force: motor.force,
            });
        }
        joint.check().map_err(|invalid| Problem::Refused {
            name: name.to_owned(),
            invalid: Box::new(invalid),
        })?;
        Ok(LoadedJoint {
            name: self.name.clone(),
            bodies: self.bodies,
            joint,
        })
    }

    pub(crate) fn of(one: &LoadedJoint) -> Self {
        let kind = match one.joint.kind {
            JointKind::Fixed => SceneFileJointKind::Fixed,
            JointKind::Spherical(own) => SceneFileJointKind::Spherical {
                limits: own.map(|all| all.map(pair)),
            },
            JointKind::Revolute(own) => SceneFileJointKind::Revolute {
                limits: own.map(pair),
            },
            JointKind::Prismatic(own) => SceneFileJointKind::Prismatic {
                limits: own.map(pair),
            },
            JointKind::Rope(length) => SceneFileJointKind::Rope { length },
            JointKind::Spring(own) => SceneFileJointKind::Spring {
                length: own.length,
                stiffness: own.stiffness,
                damping: own.damping,
            },
            JointKind::Generic(locked, own) => SceneFileJointKind::Generic {
                locked: locked.bits(),
                limits: own.map(|one| one.map(pair)),
            },
        };
        let motor = |(axis, motor): (usize, &Option<Motor>)| {
            let motor = motor.as_ref()?;
            let own = SceneFileMotor {
                position: motor.position,
                velocity: motor.velocity,
                stiffness: motor.stiffness,
                damping: motor.damping,
                force: motor.force,
            };
            Some((axis as u8, own))
        };
        Self {
            name: one.name.clone(),
            bodies: one.bodies,
            kind,
            frames: one.joint.frames.map(|frame| SceneFileFrame {
                position: frame.anchor.to_array(),
                rotation: frame.rotation.to_array(),
            }),
            collide: one.joint.collide,
            motors: one
                .joint
                .motors
                .iter()
                .enumerate()
                .filter_map(motor)
                .collect(),
            other: BTreeMap::new(),
        }
    }
}
