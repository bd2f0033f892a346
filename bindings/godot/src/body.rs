//! A node that stands for a body of a scene.
//!
//! Before the body is in the scene, the properties describe it. After that the scene's node writes the transform and the
//! velocities, and commands change the body.

use std::cell::RefCell;
use std::rc::{Rc, Weak};

use godot::classes::node::PhysicsInterpolationMode;
use godot::classes::notify::Node3DNotification;
use godot::classes::{Engine, INode3D, Node3D, PhysicsMaterial, Shape3D};
use godot::global::Error;
use godot::prelude::*;
use rhumb_bindings::{BodyParams, StateRecord, packed_id};
use rhumb_client::BodyId;
use rhumb_client::glam::{Mat3, Quat, Vec3};
use rhumb_client::scene::{
    BodyBuilder, BodyDesc, BodyKind, CollisionGroups, Command, Edges, Locomotion, Material, Shape,
    Sleep, SleepThresholds, Stepping,
};

use crate::conversion::{AXES, DescriptionError, node_shape, quaternion, resource, vec3, vector};
use crate::membership::{SceneMembership, outcome};

/// The scene that the nodes of its bodies share with its own node.
pub(crate) type SharedMembership = Rc<RefCell<SceneMembership<Gd<BodyNode>>>>;

/// Kind of a body's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeKind {
    /// It stands still.
    Fixed,
    /// Forces move it.
    #[default]
    Dynamic,
    /// Commands move it.
    Kinematic,
}

/// A node that stands for a body of a `RhumbScene`, which is its parent.
///
/// Its transform is that of the body. To free it hides the body; [`remove`](Self::remove) removes the body for all
/// members of the scene.
#[derive(GodotClass)]
#[class(init, base = Node3D, rename = RhumbBody)]
pub(crate) struct BodyNode {
    /// Kind of its motion.
    #[export]
    kind: NodeKind,
    /// A ball, box, capsule, cylinder, convex or concave polygon, height map or world boundary. Points of a convex
    /// polygon are given from the centre of mass.
    #[export]
    shape: Option<Gd<Shape3D>>,
    /// Kilograms; zero: volume times density.
    #[export(range = (0.0, 100_000.0, or_greater, suffix = "kg"))]
    mass: f32,
    /// kg/m³; zero: the scene's.
    #[export(range = (0.0, 20_000.0, or_greater))]
    density: f32,
    /// Friction and bounce; none: the scene's.
    #[export]
    physics_material: Option<Gd<PhysicsMaterial>>,
    /// Factor on the scene's gravity.
    #[export]
    #[init(val = 1.0)]
    gravity_scale: f32,
    /// m/s.
    #[export]
    linear_velocity: Vector3,
    /// rad/s about world axes.
    #[export]
    angular_velocity: Vector3,
    /// True if bodies pass through it.
    #[export]
    sensor: bool,
    /// True if it is swept against moving bodies.
    #[export]
    continuous_cd: bool,
    /// False: its axis of spin stays, though its moments of inertia differ.
    #[export]
    #[init(val = true)]
    gyroscopic: bool,
    /// Its own condition of sleep in place of the scene's.
    #[export]
    sleep: NodeSleep,
    /// With `Below`: speed of its fastest point, m/s.
    #[export(range = (0.0, 10.0, or_greater, suffix = "m/s"))]
    #[init(val = 0.1)]
    sleep_speed: f32,
    /// With `Below`: rad/s.
    #[export(range = (0.0, 10.0, or_greater, suffix = "rad/s"))]
    #[init(val = 1.0)]
    sleep_angular_speed: f32,
    /// With `Below`: time for which it must be as slow as that.
    #[export(range = (0.0, 10.0, or_greater, suffix = "s"))]
    #[init(val = 0.5)]
    sleep_seconds: f32,
    /// Of a concave polygon or a height map: how bodies touch the edges between its triangles.
    #[export]
    edges: NodeEdges,
    /// Layers that it is in. Two bodies touch if each one's mask has a layer of the other.
    #[export(flags_3d_physics)]
    #[init(val = u32::MAX)]
    collision_layer: u32,
    /// Layers that it touches.
    #[export(flags_3d_physics)]
    #[init(val = u32::MAX)]
    collision_mask: u32,
    /// The body, once it is queued or shown.
    subject: Option<BodySubject>,
    /// True if the scene's node made this one.
    is_spawned: bool,
    base: Base<Node3D>,
}

/// The body that a node stands for.
struct BodySubject {
    membership: Weak<RefCell<SceneMembership<Gd<BodyNode>>>>,
    id: BodyId,
    /// The body's origin, in the node's axes.
    origin: Vec3,
}

#[godot_api]
impl INode3D for BodyNode {
    /// A script on the node may replace `_ready`, but no notification.
    fn on_notification(&mut self, what: Node3DNotification) {
        if what != Node3DNotification::READY {
            return;
        }
        let parent = self.base().get_parent();
        if !parent.is_some_and(|parent| parent.is_class("RhumbScene")) {
            let name = self.base().get_name();
            let _free_for_scripts = self.base_mut();
            godot_warn!(
                "{name}: the parent of a RhumbBody must be a RhumbScene; it stands for no body"
            );
        }
    }
}

#[godot_api]
impl BodyNode {
    /// The body's number in its scene; zero before it is queued.
    #[func]
    fn get_id(&self) -> i64 {
        self.id().map_or(0, |id| packed_id(id) as i64)
    }

    /// How far any point of the body may be from its true place, metres; infinite while that is not known.
    #[func]
    fn error_bound(&self) -> f64 {
        let bound = self
            .membership()
            .and_then(|(membership, id)| membership.borrow().client.error_bound(id));
        bound.map_or(f64::INFINITY, |bound| bound.metres())
    }

    /// True while the body rests.
    #[func]
    fn is_resting(&self) -> bool {
        self.membership().is_some_and(|(membership, id)| {
            let membership = membership.borrow();
            let view = membership.client.view();
            view.place(id).is_some_and(|place| view.resting()[place])
        })
    }

    /// Puts the body elsewhere, and turns it. The pose is relative to the node of the scene; its scale does not count.
    #[func]
    fn teleport(&self, pose: Transform3D) -> Error {
        let Some((position, rotation)) = body_pose(pose, Vec3::ZERO) else {
            godot_error!("teleport: {}", DescriptionError::Pose);
            return Error::ERR_INVALID_PARAMETER;
        };
        self.command("teleport", |id| Command::SetPose {
            id,
            position,
            rotation,
        })
    }
}

impl BodyNode {
    /// The body that it stands for.
    pub(crate) fn id(&self) -> Option<BodyId> {
        self.subject.as_ref().map(|subject| subject.id)
    }

    /// The origin of the body, its centre of mass, in the node's axes.
    pub(crate) fn origin(&self) -> Vec3 {
        let subject = self.subject.as_ref();
        subject.map_or(Vec3::ZERO, |subject| subject.origin)
    }

    /// Lets the node stand for a body.
    pub(crate) fn stand_for(&mut self, membership: &SharedMembership, id: BodyId, origin: Vec3) {
        self.subject = Some(BodySubject {
            membership: Rc::downgrade(membership),
            id,
            origin,
        });
    }

    /// Forgets the body, as the nodes of a scene that was left; true if the project made the node.
    pub(crate) fn forget(&mut self) -> bool {
        self.subject = None;
        !self.is_spawned
    }

    pub(crate) const fn make_spawned(&mut self) {
        self.is_spawned = true;
    }

    /// The body to add that the properties describe, and its origin in the node's axes.
    pub(crate) fn builder(&self, scene: Material) -> Result<(BodyBuilder, Vec3), DescriptionError> {
        let shape = self.shape.as_ref().ok_or(DescriptionError::Missing)?;
        let placed = node_shape(shape, self.edges.edges())?;
        let pose = body_pose(self.base().get_transform(), placed.origin);
        let (position, rotation) = pose.ok_or(DescriptionError::Pose)?;
        let kind = match self.kind {
            NodeKind::Fixed => BodyKind::Fixed,
            NodeKind::Dynamic => BodyKind::Dynamic,
            NodeKind::Kinematic => BodyKind::Kinematic,
        };
        let params = BodyParams {
            position,
            rotation,
            linear_velocity: vec3(self.linear_velocity),
            angular_velocity: vec3(self.angular_velocity),
            material: self.material(scene),
            mass: (self.mass > 0.0).then_some(self.mass),
            gravity_scale: self.gravity_scale,
            groups: CollisionGroups {
                members: self.collision_layer,
                touches: self.collision_mask,
            },
            sensor: self.sensor,
            swept: self.continuous_cd,
            gyroscopic: self.gyroscopic,
            sleep: self.sleep.rule(SleepThresholds {
                speed: self.sleep_speed,
                angular_speed: self.sleep_angular_speed,
                seconds: self.sleep_seconds,
            }),
            ..BodyParams::new(kind, placed.shape)
        };
        // A shape that is not given from its centre of mass is moved there, and the origin with it.
        let (builder, centre) = params.builder(AXES)?.centred();
        // One that the client would refuse must not keep its siblings out.
        builder.check()?;
        builder.state()?;
        Ok((builder, placed.origin + AXES.vector_out(centre)))
    }

    /// `None`: the scene's.
    fn material(&self, scene: Material) -> Option<Material> {
        let own = self.physics_material.as_ref();
        (own.is_some() || self.density > 0.0).then(|| Material {
            friction: own.map_or(scene.friction, |own| own.get_friction()),
            restitution: own.map_or(scene.restitution, |own| own.get_bounce()),
            density: match self.density > 0.0 {
                true => self.density,
                false => scene.density,
            },
        })
    }

    /// Takes over the description of a body that another member added.
    pub(crate) fn describe(&mut self, desc: &BodyDesc, shape: Option<&Shape>) {
        self.kind = match desc.kind {
            BodyKind::Fixed => NodeKind::Fixed,
            BodyKind::Dynamic => NodeKind::Dynamic,
            BodyKind::Kinematic => NodeKind::Kinematic,
        };
        self.shape = shape.and_then(resource);
        self.gravity_scale = desc.gravity_scale;
        self.sensor = desc.sensor;
        self.continuous_cd = desc.swept;
        self.gyroscopic = desc.gyroscopic;
        let (sleep, thresholds) = NodeSleep::of(desc.sleep);
        self.sleep = sleep;
        if let Some(thresholds) = thresholds {
            self.sleep_speed = thresholds.speed;
            self.sleep_angular_speed = thresholds.angular_speed;
            self.sleep_seconds = thresholds.seconds;
        }
        self.edges = NodeEdges::of(match shape {
            Some(Shape::Mesh(mesh)) => mesh.edges(),
            Some(Shape::Heights(heights)) => heights.edges(),
            _ => Edges::DEFAULT,
        });
        self.collision_layer = desc.groups.members;
        self.collision_mask = desc.groups.touches;
    }

    /// Moves a node to the state of its body.
    pub(crate) fn show(this: &mut Gd<Self>, state: &StateRecord) {
        let origin = {
            let mut body = this.bind_mut();
            body.linear_velocity = vector(state.linear_velocity);
            body.angular_velocity = vector(state.angular_velocity);
            body.origin()
        };
        let at = state.position - state.rotation * origin;
        let basis = Basis::from_quaternion(quaternion(state.rotation));
        this.set_transform(Transform3D::new(basis, vector(at)));
    }

    fn membership(&self) -> Option<(SharedMembership, BodyId)> {
        let subject = self.subject.as_ref()?;
        Some((subject.membership.upgrade()?, subject.id))
    }

    pub(crate) fn command(&self, call: &str, command: impl FnOnce(BodyId) -> Command) -> Error {
        let Some((membership, id)) = self.membership() else {
            godot_error!(
                "{call}: the node {} stands for no body of a scene",
                self.base().get_name()
            );
            return Error::ERR_UNCONFIGURED;
        };
        let command = about_centre(command(id), self.origin());
        let queued = membership.borrow_mut().command(command);
        outcome(call, queued)
    }
}

/// A command about a node, as one about the body whose origin lies there in the node's axes.
fn about_centre(mut command: Command, origin: Vec3) -> Command {
    match &mut command {
        Command::SetPose {
            position, rotation, ..
        } => *position += *rotation * origin,
        Command::SetLocomotion { locomotion, .. } => {
            if let Locomotion::Vehicle(vehicle) = &mut **locomotion {
                for wheel in &mut vehicle.wheels {
                    wheel.position -= origin;
                }
            }
        }
        _ => {}
    }
    command
}

/// Position and rotation of a body whose node has this transform; `None` for one that has no rotation, such as a scale of
/// zero. Of a mirrored one, z is turned back.
fn body_pose(transform: Transform3D, origin: Vec3) -> Option<(Vec3, Quat)> {
    let [x, y] = [Vector3::RIGHT, Vector3::UP].map(|axis| vec3(transform.basis * axis));
    let x = x.try_normalize()?;
    let z = x.cross(y.try_normalize()?).try_normalize()?;
    let axes = Mat3::from_cols(x, z.cross(x), z);
    let rotation = Quat::from_mat3(&axes);
    Some((vec3(transform.origin) + rotation * origin, rotation))
}

/// Sets the node of a body that is shown from now on.
pub(crate) fn set_node(membership: &SharedMembership, state: &StateRecord, body: &Gd<BodyNode>) {
    let is_free_running = {
        let follower = &mut membership.borrow_mut().follower;
        follower.set_object(state.body, body.clone());
        follower.stepping() == Stepping::FreeRunning
    };
    if is_free_running {
        // It is moved in each frame, not in each physics frame.
        let mut body = body.clone();
        body.set_physics_interpolation_mode(PhysicsInterpolationMode::OFF);
    }
}

/// Queues the bodies of nodes. A node without a good description is left out, and an error says why.
pub(crate) fn add(membership: &SharedMembership, nodes: Vec<Gd<BodyNode>>) {
    let material = membership.borrow().client.config().material;
    let (mut builders, mut described) = (Vec::new(), Vec::new());
    for node in nodes {
        let description = node.bind().builder(material);
        match description {
            Ok((builder, origin)) => {
                builders.push(builder);
                described.push((node, origin));
            }
            Err(error) => godot_error!("{}: {error}", node.get_name()),
        }
    }
    let added = membership.borrow_mut().client.add_bodies(builders);
    match added {
        Ok(ids) => {
            for (id, (mut node, origin)) in ids.into_iter().zip(described) {
                node.bind_mut().stand_for(membership, id, origin);
                membership.borrow_mut().follower.reserve(id, node);
            }
        }
        Err(error) => {
            outcome("the bodies of the children were not added", Err(error));
        }
    }
}

/// A lockstep scene and Godot's physics frames should take the same time.
pub(crate) fn warn_of_other_rate(membership: &SharedMembership) {
    let (stepping, step) = {
        let membership = membership.borrow();
        (
            membership.follower.stepping(),
            membership.follower.fixed_step(),
        )
    };
    let own = 1.0 / f64::from(Engine::singleton().get_physics_ticks_per_second());
    if stepping == Stepping::Lockstep && (step.as_secs_f64() - own).abs() > 1e-6 {
        godot_warn!(
            "a tick of the scene takes {} s and a physics frame {own} s: set physics/common/physics_ticks_per_second",
            step.as_secs_f64()
        );
    }
}

/// Condition under which a body falls asleep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeSleep {
    /// Of a body: as the scene has it. Of a new scene: as `Settled`.
    #[default]
    Default,
    /// It is slow, and neither gravity nor a motor still moves it.
    Settled,
    /// It is slower than `sleep_speed` and `sleep_angular_speed` for `sleep_seconds`, whatever moves it.
    Below,
    /// It never falls asleep by itself, and neither does what it touches.
    Never,
}

impl NodeSleep {
    /// The rule with the thresholds of the other properties; `None` for the default.
    pub(crate) const fn rule(self, thresholds: SleepThresholds) -> Option<Sleep> {
        match self {
            Self::Default => None,
            Self::Settled => Some(Sleep::Settled),
            Self::Below => Some(Sleep::Below(thresholds)),
            Self::Never => Some(Sleep::Never),
        }
    }

    /// The property for a rule, and its thresholds if it has some.
    pub(crate) const fn of(rule: Option<Sleep>) -> (Self, Option<SleepThresholds>) {
        match rule {
            None => (Self::Default, None),
            Some(Sleep::Settled) => (Self::Settled, None),
            Some(Sleep::Below(thresholds)) => (Self::Below, Some(thresholds)),
            Some(Sleep::Never) => (Self::Never, None),
        }
    }
}

/// How bodies touch the edges that two triangles of a concave polygon or a height map share.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, GodotConvert, Var, Export)]
#[godot(via = i64)]
pub(crate) enum NodeEdges {
    /// Each triangle is touched as if it were alone: a body that slides over flat ground may catch on an edge.
    Plain,
    /// A body slides and rolls over flat ground as over one face. Heights are then touched from above only.
    #[default]
    Smooth,
}

impl NodeEdges {
    const fn edges(self) -> Edges {
        match self {
            Self::Plain => Edges::Plain,
            Self::Smooth => Edges::Smooth,
        }
    }

    const fn of(edges: Edges) -> Self {
        match edges {
            Edges::Plain => Self::Plain,
            Edges::Smooth => Self::Smooth,
        }
    }
}
