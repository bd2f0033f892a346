//! Actors of an APP client, their joints, and what these are in the scene.
//!
//! A body of a scene has its origin in its centre of mass, one shape, one density and one surface. An actor has its
//! origin anywhere, and several shapes, each with density and surface. The body's density gives it the actor's mass;
//! its surface is that of the first attached part.
//!
//! A client's joint makes each of six motions locked, limited or free. Scenes have four kinds of joint; all other
//! combinations are refused. A joint to the world that only prevents rotation, as avatars have, becomes a body without
//! rotation instead.

use glam::{Quat, Vec3};
use rhumb_protocol::limits::{DENSITY_MAX, DENSITY_MIN, FRICTION_MAX};
use rhumb_protocol::scene::{
    BodyKind, Compound, Joint, JointFrame, JointKind, JointLimits, Material, Part as ScenePart,
    Shape, ShapeId,
};
use rhumb_reckoning::BodyId;

use crate::codec::Surface;
use crate::gateway::Refusal;
use crate::message::{AddJoint, Grip};
use crate::shape_definition::ShapeDefinition;

/// An actor.
#[derive(Clone, Debug)]
pub(super) struct Actor {
    pub(super) kind: BodyKind,
    /// Position at its creation or a requested one; the present position is the body's.
    pub(super) position: Vec3,
    pub(super) rotation: Quat,
    pub(super) linear: Vec3,
    pub(super) angular: Vec3,
    pub(super) gravity: f32,
    /// True if its collisions are reported.
    pub(super) reports: bool,
    /// True if a joint to the world prevents rotation: an avatar.
    pub(super) upright: bool,
    pub(super) parts: Vec<ActorPart>,
    pub(super) target_motion: TargetMotion,
    /// The mass that was sent to the client, if it requested it.
    pub(super) reported_mass: Option<f32>,
    pub(super) body: Option<ActorBody>,
}

/// Motion that was set since the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct TargetMotion {
    pub(super) position: Option<Vec3>,
    pub(super) rotation: Option<Quat>,
    pub(super) linear: Option<Vec3>,
    pub(super) angular: Option<Vec3>,
}

/// Body of an actor in the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ActorBody {
    pub(super) id: BodyId,
    pub(super) shape: ShapeId,
    pub(super) frame: Frame,
    pub(super) material: Option<Material>,
    pub(super) gravity: f32,
    pub(super) upright: bool,
}

impl Actor {
    pub(super) const fn new(kind: BodyKind, position: Vec3, rotation: Quat) -> Self {
        Self {
            kind,
            position,
            rotation,
            linear: Vec3::ZERO,
            angular: Vec3::ZERO,
            gravity: 1.0,
            reports: false,
            upright: false,
            parts: Vec::new(),
            target_motion: TargetMotion {
                position: None,
                rotation: None,
                linear: None,
                angular: None,
            },
            reported_mass: None,
            body: None,
        }
    }

    /// Takes the requested motion as the present one.
    pub(super) fn fulfil(&mut self) {
        let target_motion = std::mem::take(&mut self.target_motion);
        self.position = target_motion.position.unwrap_or(self.position);
        self.rotation = target_motion.rotation.unwrap_or(self.rotation);
        self.linear = target_motion.linear.unwrap_or(self.linear);
        self.angular = target_motion.angular.unwrap_or(self.angular);
    }

    /// Detaches a shape by its name, if the actor has it.
    ///
    /// The published plug-in stores one shape name for all avatars: if an avatar lacks the named shape, its only shape
    /// is meant.
    pub(super) fn detach(&mut self, name: u32) {
        let before = self.parts.len();
        self.parts.retain(|part| part.name != name);
        if self.parts.len() == before && self.upright && before == 1 {
            self.parts.clear();
        }
    }
}

/// The next id of the same index; `None` for one whose generations are used up.
pub(super) fn again(id: BodyId) -> Option<BodyId> {
    let generation = id.generation().checked_add(1)?;
    Some(BodyId::new(id.index(), generation))
}

/// A shape on an actor.
#[derive(Clone, Debug)]
pub(super) struct ActorPart {
    /// The client's name of the shape.
    pub(super) name: u32,
    /// The shape when it was attached; `None` for an undefined name.
    pub(super) definition: Option<ShapeDefinition>,
    pub(super) material: Material,
    /// Metres, in the actor's axes.
    pub(super) position: Vec3,
    /// Shape → actor.
    pub(super) rotation: Quat,
}

/// Pose of a body's axes in its actor's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    /// The body's origin, metres.
    pub(super) position: Vec3,
    /// Body → actor.
    pub(super) rotation: Quat,
}

/// Body properties of an actor.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ActorProperties {
    pub(super) shape: Shape,
    pub(super) frame: Frame,
    /// `None`: the scene's own.
    pub(super) material: Option<Material>,
    /// Mass, kg.
    pub(super) mass: f32,
}

impl Frame {
    const IDENTITY: Self = Self {
        position: Vec3::ZERO,
        rotation: Quat::IDENTITY,
    };

    /// The body's pose for an actor's. A body that shares the actor's frame keeps every bit.
    pub(super) fn body_of(&self, position: Vec3, rotation: Quat) -> (Vec3, Quat) {
        if *self == Self::IDENTITY {
            return (position, rotation);
        }
        let (wide, offset) = (rotation.as_dquat(), self.position.as_dvec3());
        let at = position.as_dvec3() + wide * offset;
        let turned = (wide * self.rotation.as_dquat()).normalize();
        (at.as_vec3(), turned.as_quat())
    }

    /// The actor's pose for a body's.
    pub(super) fn actor_of(&self, position: Vec3, rotation: Quat) -> (Vec3, Quat) {
        if *self == Self::IDENTITY {
            return (position, rotation);
        }
        let wide = (rotation.as_dquat() * self.rotation.as_dquat().conjugate()).normalize();
        let at = position.as_dvec3() - wide * self.position.as_dvec3();
        (at.as_vec3(), wide.as_quat())
    }
}

/// A rotation of unit length, from one that is nearly so; the published plug-in rounds.
pub(super) fn unit(rotation: Quat) -> Result<Quat, Refusal> {
    let wide = rotation.as_dquat();
    let squared = wide.length_squared();
    if !squared.is_finite() || squared < 1e-6 {
        return Err(Refusal::Number);
    }
    if (squared - 1.0).abs() <= 1e-6 {
        return Ok(rotation);
    }
    Ok(wide.normalize().as_quat())
}

/// A scene's material for a client's surface. Numbers beyond the limits are clamped; numbers that are not finite are
/// refused.
pub(super) fn material(surface: &Surface) -> Result<Material, Refusal> {
    let Surface {
        density,
        kinetic_friction,
        restitution,
        ..
    } = *surface;
    if !(density.is_finite() && kinetic_friction.is_finite() && restitution.is_finite()) {
        return Err(Refusal::Number);
    }
    Ok(Material {
        // An engine has one coefficient, that of sliding: a resting body then needs the same force.
        friction: kinetic_friction.clamp(0.0, FRICTION_MAX),
        restitution: restitution.clamp(0.0, 1.0),
        density: density.clamp(DENSITY_MIN, DENSITY_MAX),
    })
}

/// The mass of an actor of these parts, kg; a kilogram without any solid part.
pub(super) fn mass(kind: BodyKind, parts: &[ActorPart]) -> f32 {
    let counts =
        |definition: &&ShapeDefinition| kind == BodyKind::Fixed || definition.solid().is_some();
    let masses = parts.iter().filter_map(|part| {
        let definition = part.definition.as_ref().filter(counts)?;
        Some(definition.bulk.volume * part.material.density)
    });
    let (count, sum) = masses.fold((0, 0.0), |(count, sum), mass| (count + 1, sum + mass));
    match count {
        0 => 1.0,
        _ => f32::max(sum, f32::MIN_POSITIVE),
    }
}

/// The body of an actor of these parts. `scenes`: the scene's default material.
pub(super) fn body_properties(
    kind: BodyKind,
    parts: &[ActorPart],
    scenes: Material,
) -> ActorProperties {
    let placed: Vec<(ShapeDefinition, &ActorPart)> = parts
        .iter()
        .filter_map(|part| {
            let definition = part.definition.as_ref()?;
            let definition = match kind {
                BodyKind::Fixed => Some(definition.clone()),
                BodyKind::Dynamic | BodyKind::Kinematic => definition.solid(),
            };
            Some((definition?, part))
        })
        .collect();
    let volume: f32 = placed
        .iter()
        .map(|(definition, _)| definition.bulk.volume)
        .sum();
    let masses = placed
        .iter()
        .map(|(definition, part)| definition.bulk.volume * part.material.density);
    let mass: f32 = masses.sum();
    let (shape, frame) = match placed.as_slice() {
        [] => (Shape::Compound(Compound::nothing()), Frame::IDENTITY),
        [(definition, part)] => single(definition, part),
        _ => several(kind, &placed, mass),
    };
    let Some((_, first)) = placed.first() else {
        // A body without shape weighs a kilogram, as in the engine.
        return ActorProperties {
            shape,
            frame,
            material: None,
            mass: 1.0,
        };
    };
    let mean = if volume > 0.0 && placed.len() > 1 {
        (mass / volume).clamp(DENSITY_MIN, DENSITY_MAX)
    } else {
        first.material.density
    };
    let material = Material {
        density: mean,
        ..first.material
    };
    ActorProperties {
        shape,
        frame,
        material: (material != scenes).then_some(material),
        mass: mass.max(f32::MIN_POSITIVE),
    }
}

fn frame_of(definition: &ShapeDefinition, part: &ActorPart) -> Frame {
    let rotation = (part.rotation.as_dquat() * definition.rotation.as_dquat()).normalize();
    let offset = part.rotation.as_dquat() * definition.position.as_dvec3();
    let plain = part.rotation == Quat::IDENTITY && definition.rotation == Quat::IDENTITY;
    Frame {
        position: (part.position.as_dvec3() + offset).as_vec3(),
        rotation: if plain {
            Quat::IDENTITY
        } else {
            rotation.as_quat()
        },
    }
}

fn single(definition: &ShapeDefinition, part: &ActorPart) -> (Shape, Frame) {
    let (shape, centre) = definition.centred();
    let mut frame = frame_of(definition, part);
    frame.position += frame.rotation * centre;
    (shape, frame)
}

fn several(kind: BodyKind, placed: &[(ShapeDefinition, &ActorPart)], mass: f32) -> (Shape, Frame) {
    let frames: Vec<Frame> = placed
        .iter()
        .map(|(definition, part)| frame_of(definition, part))
        .collect();
    let moments = placed
        .iter()
        .zip(&frames)
        .map(|((definition, part), frame)| {
            let own = frame.position + frame.rotation * definition.bulk.centre;
            own * (definition.bulk.volume * part.material.density)
        });
    let centre = if kind == BodyKind::Dynamic && mass > 0.0 {
        moments.sum::<Vec3>() / mass
    } else {
        Vec3::ZERO
    };
    let parts = placed
        .iter()
        .zip(&frames)
        .map(|((definition, _), frame)| ScenePart {
            position: frame.position - centre,
            rotation: frame.rotation,
            shape: definition.shape.clone(),
        });
    // Parts are counted when they are attached, and each was checked at its definition.
    let compound = Compound::new(parts.collect()).unwrap_or_else(|_| Compound::nothing());
    let frame = Frame {
        position: centre,
        rotation: Quat::IDENTITY,
    };
    (Shape::Compound(compound), frame)
}

/// Freedom of one motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Freedom {
    Locked,
    Limited(JointLimits),
    Free,
}

/// Linear, then angular.
fn freedoms(message: &AddJoint) -> [[Freedom; 3]; 2] {
    let one = |least: f32, most: f32| {
        if least > most {
            Freedom::Free
        } else if least == most {
            Freedom::Locked
        } else {
            Freedom::Limited(JointLimits { least, most })
        }
    };
    let three = |lower: Vec3, upper: Vec3| {
        [
            one(lower.x, upper.x),
            one(lower.y, upper.y),
            one(lower.z, upper.z),
        ]
    };
    [
        three(message.linear_lower, message.linear_upper),
        three(message.angular_lower, message.angular_upper),
    ]
}

/// True if it prevents rotation and leaves all translation free.
pub(super) fn keeps_upright(message: &AddJoint) -> bool {
    freedoms(message) == [[Freedom::Free; 3], [Freedom::Locked; 3]]
}

/// A joint's kind, and the turn that puts the remaining free axis along x.
fn kind(message: &AddJoint) -> Option<(JointKind, Quat)> {
    let [linear, angular] = freedoms(message);
    let locked = |freedoms: [Freedom; 3]| freedoms == [Freedom::Locked; 3];
    let limits = |freedom| match freedom {
        Freedom::Limited(limits) => Some(limits),
        Freedom::Locked | Freedom::Free => None,
    };
    let only = |freedoms: [Freedom; 3]| {
        let mut free = (0..3).filter(|axis| freedoms[*axis] != Freedom::Locked);
        free.next().filter(|_| free.next().is_none())
    };
    if locked(linear) && locked(angular) {
        return Some((JointKind::Fixed, Quat::IDENTITY));
    }
    if locked(linear)
        && let Some(axis) = only(angular)
    {
        return Some((JointKind::Revolute(limits(angular[axis])), along(axis)));
    }
    if locked(angular)
        && let Some(axis) = only(linear)
    {
        return Some((JointKind::Prismatic(limits(linear[axis])), along(axis)));
    }
    let ball = locked(linear) && !angular.contains(&Freedom::Locked);
    let whole = |freedom| {
        limits(freedom).unwrap_or(JointLimits {
            least: -core::f32::consts::PI,
            most: core::f32::consts::PI,
        })
    };
    match (ball, angular == [Freedom::Free; 3]) {
        (true, true) => Some((JointKind::Spherical(None), Quat::IDENTITY)),
        (true, false) => Some((
            JointKind::Spherical(Some(angular.map(whole))),
            Quat::IDENTITY,
        )),
        (false, _) => None,
    }
}

/// Turns x into an axis.
const fn along(axis: usize) -> Quat {
    use core::f32::consts::FRAC_1_SQRT_2 as HALF;
    match axis {
        0 => Quat::IDENTITY,
        1 => Quat::from_xyzw(0.0, 0.0, HALF, HALF),
        _ => Quat::from_xyzw(0.0, -HALF, 0.0, HALF),
    }
}

/// Checks that a scene can have the joint.
pub(super) fn check_joint(message: &AddJoint) -> Result<(), Refusal> {
    for grip in [&message.first, &message.second] {
        unit(grip.rotation)?;
        if !grip.anchor.is_finite() {
            return Err(Refusal::Number);
        }
    }
    let limits = [
        message.linear_lower,
        message.linear_upper,
        message.angular_lower,
        message.angular_upper,
    ];
    if !limits.iter().all(|limit| limit.is_finite()) {
        return Err(Refusal::Number);
    }
    if keeps_upright(message) || kind(message).is_some() {
        Ok(())
    } else {
        Err(Refusal::Joint)
    }
}

/// The joint between two bodies, whose frames are given in their actors.
pub(super) fn joint_between(message: &AddJoint, bodies: [(BodyId, Frame); 2]) -> Option<Joint> {
    let (kind, turn) = kind(message)?;
    let grips = [&message.first, &message.second];
    let mut frames = [JointFrame::at(Vec3::ZERO); 2];
    for ((to, grip), (_, frame)) in frames.iter_mut().zip(grips).zip(&bodies) {
        *to = in_body(grip, frame, turn).ok()?;
    }
    Some(Joint {
        kind,
        bodies: bodies.map(|(id, _)| id),
        frames,
        collide: false,
        motors: [None; 6],
        strength: None,
    })
}

fn in_body(grip: &Grip, frame: &Frame, turn: Quat) -> Result<JointFrame, Refusal> {
    let to_body = frame.rotation.conjugate();
    Ok(JointFrame {
        anchor: to_body * (grip.anchor - frame.position),
        rotation: unit(to_body * unit(grip.rotation)? * turn)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::codec::Id;
    use crate::message::ConvexMesh;

    const STONE: Material = Material {
        friction: 0.2,
        restitution: 0.0,
        density: 1_000.0,
    };

    fn part(definition: ShapeDefinition, position: Vec3, density: f32) -> ActorPart {
        ActorPart {
            name: 1,
            definition: Some(definition),
            material: Material { density, ..STONE },
            position,
            rotation: Quat::IDENTITY,
        }
    }

    #[test]
    fn a_plain_ball_keeps_its_pose_to_the_bit_and_its_scenes_material() {
        let ball = ShapeDefinition::ball(Vec3::ZERO, 0.5).unwrap();
        let properties =
            body_properties(BodyKind::Dynamic, &[part(ball, Vec3::ZERO, 1_000.0)], STONE);
        assert_eq!(properties.shape, Shape::Ball { radius: 0.5 });
        assert_eq!(
            (properties.material, properties.frame),
            (None, Frame::IDENTITY)
        );
        assert!((properties.mass - 523.6).abs() < 0.1, "{}", properties.mass);
        let pose = (
            Vec3::new(0.1, 0.2, 0.3),
            Quat::from_xyzw(0.1, 0.7, 0.1, 0.7),
        );
        assert_eq!(properties.frame.body_of(pose.0, pose.1), pose);
    }

    #[test]
    fn two_linked_boxes_weigh_and_balance_as_two() {
        let cube = ShapeDefinition::cuboid(Vec3::ONE).unwrap();
        let parts = [
            part(cube.clone(), Vec3::ZERO, 1_000.0),
            part(cube, Vec3::new(2.0, 0.0, 0.0), 3_000.0),
        ];
        let properties = body_properties(BodyKind::Dynamic, &parts, STONE);
        assert!((properties.mass - 4_000.0).abs() < 0.1);
        assert_eq!(properties.material.unwrap().density, 2_000.0);
        assert!((properties.frame.position.x - 1.5).abs() < 1e-6);
        let Shape::Compound(compound) = &properties.shape else {
            panic!("two parts are a compound");
        };
        let places: Vec<f32> = compound
            .parts()
            .iter()
            .map(|part| part.position.x)
            .collect();
        assert_eq!(places, [-1.5, 0.5]);
        let (position, rotation) = properties.frame.body_of(Vec3::ONE, Y);
        let (back, turned) = properties.frame.actor_of(position, rotation);
        assert!(back.distance(Vec3::ONE) < 1e-6 && turned.angle_between(Y) < 1e-3);
    }

    /// A quarter turn about y.
    const Y: Quat = Quat::from_xyzw(0.0, 0.707_106_77, 0.0, 0.707_106_77);

    #[test]
    fn a_hull_is_centred_on_its_centre_of_mass() {
        let corners: Vec<Vec3> = (0..8)
            .map(|bits| {
                Vec3::new(
                    (bits & 1) as f32,
                    (bits >> 1 & 1) as f32,
                    (bits >> 2) as f32,
                )
            })
            .collect();
        let shape = Id {
            simulation: 0,
            object: 1,
        };
        let hull = ShapeDefinition::hull(&ConvexMesh {
            shape,
            points: corners,
        })
        .unwrap();
        let properties =
            body_properties(BodyKind::Dynamic, &[part(hull, Vec3::ZERO, 1_000.0)], STONE);
        assert!(properties.frame.position.distance(Vec3::splat(0.5)) < 1e-5);
        assert!((properties.shape.bounding_radius().metres() - 0.75_f64.sqrt()).abs() < 1e-5);
    }

    #[test]
    fn an_actor_without_shape_weighs_a_kilogram() {
        let properties = body_properties(BodyKind::Dynamic, &[], STONE);
        assert_eq!(properties.shape, Shape::Compound(Compound::nothing()));
        assert_eq!(properties.mass, 1.0);
    }

    #[test]
    fn an_avatars_capsule_is_upright_and_has_its_height() {
        let capsule = ShapeDefinition::capsule(0.3, 1.9).unwrap();
        let mut upright = part(capsule, Vec3::ZERO, 1_062.0);
        upright.rotation = Y;
        let properties = body_properties(BodyKind::Dynamic, &[upright], STONE);
        let (_, rotation) = properties.frame.body_of(Vec3::ZERO, Quat::IDENTITY);
        let axis = rotation * Vec3::Y;
        assert!(axis.z.abs() > 0.999_99, "{axis}");
        assert_eq!(properties.shape.bounding_radius().metres() as f32, 0.95);
    }
}
