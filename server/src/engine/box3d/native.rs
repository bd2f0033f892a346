//! Calls of Box3D's C interface: the only unsafe code of the server.
//!
//! Compiled with the feature `box3d` alone. Invariants: a handle is checked before each call, so that a stale one, or one
//! of another world, does nothing; a world keeps every mesh that a shape of it may refer to; `World` is not `Sync`, so
//! that one thread at a time works on a world. Calls with numbers that are not finite are the caller's mistake, and do no
//! harm to memory.
#![expect(unsafe_code, reason = "Box3D is written in C")]

use core::cell::Cell;
use core::marker::PhantomData;
use core::ptr::{self, NonNull};
use core::slice;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use box3d_sys as sys;
use glam::{Mat3, Quat, Vec3};

/// Box3D's list of worlds has no lock of its own.
static WORLDS: Mutex<()> = Mutex::new(());

/// A world of Box3D, which ends with this.
pub(super) struct World {
    id: sys::b3WorldId,
    /// The meshes that shapes refer to.
    meshes: BTreeMap<NativeShape, Arc<MeshData>>,
    _not_sync: PhantomData<Cell<()>>,
}

/// A body of a world.
#[derive(Clone, Copy, Debug)]
pub(super) struct NativeBody(sys::b3BodyId);

/// A shape of a world: its number, its world and its generation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct NativeShape(i32, u16, u16);

/// A pose: metres, and body → world.
pub(super) type Placement = (Vec3, Quat);

/// Kind of a body's motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mobility {
    Static,
    Dynamic,
    Kinematic,
}

/// A new body without shapes.
pub(super) struct NewBody {
    pub(super) mobility: Mobility,
    pub(super) at: Placement,
    pub(super) linear: Vec3,
    pub(super) angular: Vec3,
    /// Comes back with its moves.
    pub(super) tag: usize,
}

/// Geometry in the axes of a body.
#[derive(Clone)]
pub(super) enum NativePiece {
    Sphere(Vec3, f32),
    Capsule([Vec3; 2], f32),
    /// Half extents, and its pose in the body.
    Cuboid(Vec3, Placement),
    Hull(Arc<HullData>),
    Mesh(Arc<MeshData>),
}

/// Surface and filter of a shape. Its density is none: bodies have masses of their own.
pub(super) struct Surface {
    pub(super) friction: f32,
    pub(super) restitution: f32,
    pub(super) members: u32,
    pub(super) touches: u32,
    pub(super) is_sensor: bool,
}

/// Two touching shapes, and their deepest point.
pub(super) struct Touching {
    pub(super) shapes: [NativeShape; 2],
    /// On each body, from its centre of mass, world axes.
    pub(super) anchors: [Vec3; 2],
    /// From the first towards the second.
    pub(super) normal: Vec3,
    pub(super) separation: f32,
    /// Sum of all points over the step, N·s.
    pub(super) impulse: f32,
}

/// A convex hull.
pub(super) struct HullData(NonNull<sys::b3HullData>);

/// A triangle mesh.
pub(super) struct MeshData(NonNull<sys::b3MeshData>);

// SAFETY: hulls and meshes are read only once they are made, and freed by their last owner.
unsafe impl Send for HullData {}
// SAFETY: as above.
unsafe impl Sync for HullData {}
// SAFETY: as above.
unsafe impl Send for MeshData {}
// SAFETY: as above.
unsafe impl Sync for MeshData {}

impl HullData {
    /// The hull of some points; `None` for a flat one, or with more than 128 corners.
    pub(super) fn new(points: &[Vec3]) -> Option<Self> {
        let raw: Vec<_> = points.iter().copied().map(vector).collect();
        let most = sys::B3_MAX_HULL_VERTICES as i32;
        // SAFETY: the points are read during the call.
        let made = unsafe { sys::b3CreateHull(raw.as_ptr(), raw.len() as i32, most) };
        NonNull::new(made).map(Self)
    }
}

impl Drop for HullData {
    fn drop(&mut self) {
        // SAFETY: it was made by Box3D; shapes have copies of it.
        unsafe { sys::b3DestroyHull(self.0.as_ptr()) };
    }
}

impl MeshData {
    /// A mesh; `None` if Box3D refuses it, or a triangle names a point that is not there.
    pub(super) fn new(points: &[Vec3], triangles: &[[u32; 3]]) -> Option<Self> {
        let is_there = |corner: &u32| (*corner as usize) < points.len();
        if triangles.is_empty() || !triangles.as_flattened().iter().all(is_there) {
            return None;
        }
        let mut raw: Vec<_> = points.iter().copied().map(vector).collect();
        let corners = triangles.as_flattened().iter();
        let mut corners: Vec<i32> = corners.map(|corner| corner.cast_signed()).collect();
        let def = sys::b3MeshDef {
            vertices: raw.as_mut_ptr(),
            indices: corners.as_mut_ptr(),
            vertexCount: raw.len() as i32,
            triangleCount: triangles.len() as i32,
            identifyEdges: true,
            ..sys::b3MeshDef::default()
        };
        // SAFETY: the arrays have the lengths that the definition says, and are read during the call.
        let made = unsafe { sys::b3CreateMesh(&raw const def, ptr::null_mut(), 0) };
        NonNull::new(made).map(Self)
    }
}

impl Drop for MeshData {
    fn drop(&mut self) {
        // SAFETY: it was made by Box3D; worlds keep the meshes of their shapes.
        unsafe { sys::b3DestroyMesh(self.0.as_ptr()) };
    }
}

impl World {
    /// An empty world; `None` if the process has as many as Box3D allows.
    ///
    /// `speed_max`: of its bodies, m/s.
    pub(super) fn new(gravity: Vec3, speed_max: f32) -> Option<Self> {
        let _one_at_a_time = WORLDS.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: plain values; the callbacks are functions without state.
        let id = unsafe {
            if sys::b3GetWorldCount() >= sys::B3_MAX_WORLDS as i32 {
                return None;
            }
            let mut def = sys::b3DefaultWorldDef();
            def.gravity = vector(gravity);
            def.workerCount = 1;
            def.maximumLinearSpeed = speed_max;
            def.frictionCallback = Some(mean);
            def.restitutionCallback = Some(mean);
            let id = sys::b3CreateWorld(&raw const def);
            sys::b3World_IsValid(id).then_some(id)?
        };
        Some(Self {
            id,
            meshes: BTreeMap::new(),
            _not_sync: PhantomData,
        })
    }

    /// Steps by `dt` seconds.
    pub(super) fn step(&mut self, dt: f32, substeps: i32) {
        // SAFETY: the world lives as long as this.
        unsafe { sys::b3World_Step(self.id, dt, substeps) };
    }

    pub(super) fn gravity(&self) -> Vec3 {
        // SAFETY: as above.
        from_vector(unsafe { sys::b3World_GetGravity(self.id) })
    }

    pub(super) fn set_gravity(&mut self, gravity: Vec3) {
        // SAFETY: as above.
        unsafe { sys::b3World_SetGravity(self.id, vector(gravity)) };
    }

    /// Tags of the awake bodies and of those that fell asleep in the last step, and true for the latter.
    pub(super) fn moves(&self) -> Vec<(usize, bool)> {
        // SAFETY: the events are copied before another call of the world.
        let moves = unsafe {
            let events = sys::b3World_GetBodyEvents(self.id);
            array(events.moveEvents, events.moveCount)
        };
        let tagged = moves
            .iter()
            .map(|event| (event.userData.addr(), event.fellAsleep));
        tagged.collect()
    }

    /// Pairs of a sensor and a shape: those that ended in the last step, and those that began.
    pub(super) fn sensor_changes(&self) -> [Vec<(NativeShape, NativeShape)>; 2] {
        // SAFETY: the events are copied before another call of the world.
        let (ended, began) = unsafe {
            let events = sys::b3World_GetSensorEvents(self.id);
            (
                array(events.endEvents, events.endCount),
                array(events.beginEvents, events.beginCount),
            )
        };
        let pair = |one, other| (shape(one), shape(other));
        let ended = ended.iter();
        let began = began.iter();
        [
            ended
                .map(|e| pair(e.sensorShapeId, e.visitorShapeId))
                .collect(),
            began
                .map(|e| pair(e.sensorShapeId, e.visitorShapeId))
                .collect(),
        ]
    }

    pub(super) fn add_body(&mut self, new: &NewBody) -> NativeBody {
        // SAFETY: plain values.
        let id = unsafe {
            let mut def = sys::b3DefaultBodyDef();
            def.type_ = mobility(new.mobility);
            (def.position, def.rotation) = (vector(new.at.0), quaternion(new.at.1));
            def.linearVelocity = vector(new.linear);
            def.angularVelocity = vector(new.angular);
            def.allowFastRotation = true;
            def.userData = ptr::without_provenance_mut(new.tag);
            sys::b3CreateBody(self.id, &raw const def)
        };
        NativeBody(id)
    }

    /// Removes a body with its shapes and joints, and wakes what it touched.
    pub(super) fn remove_body(&mut self, body: NativeBody) {
        if let Some(id) = self.live(body) {
            // SAFETY: the body is of this world.
            unsafe { sys::b3DestroyBody(id) };
        }
    }

    /// Gives a body a shape.
    pub(super) fn attach(
        &mut self,
        body: NativeBody,
        piece: &NativePiece,
        surface: &Surface,
    ) -> Option<NativeShape> {
        let id = self.live(body)?;
        // SAFETY: plain values; the body is of this world; a mesh is kept beside its shape.
        let made = unsafe {
            let mut def = sys::b3DefaultShapeDef();
            def.density = 0.0;
            def.updateBodyMass = false;
            def.baseMaterial.friction = surface.friction;
            def.baseMaterial.restitution = surface.restitution;
            def.filter.categoryBits = surface.members.into();
            def.filter.maskBits = surface.touches.into();
            def.isSensor = surface.is_sensor;
            def.enableSensorEvents = true;
            let def = &raw const def;
            match piece {
                NativePiece::Sphere(center, radius) => {
                    let center = vector(*center);
                    let radius = *radius;
                    sys::b3CreateSphereShape(id, def, &sys::b3Sphere { center, radius })
                }
                NativePiece::Capsule([one, other], radius) => {
                    let capsule = sys::b3Capsule {
                        center1: vector(*one),
                        center2: vector(*other),
                        radius: *radius,
                    };
                    sys::b3CreateCapsuleShape(id, def, &raw const capsule)
                }
                NativePiece::Cuboid(half, at) => {
                    let at = transform(*at);
                    let hull = sys::b3MakeTransformedBoxHull(half.x, half.y, half.z, at);
                    sys::b3CreateHullShape(id, def, &raw const hull.base)
                }
                NativePiece::Hull(hull) => sys::b3CreateHullShape(id, def, hull.0.as_ptr()),
                NativePiece::Mesh(mesh) => {
                    let scale = vector(Vec3::ONE);
                    sys::b3CreateMeshShape(id, def, mesh.0.as_ptr(), scale)
                }
            }
        };
        // SAFETY: the id is Box3D's own.
        let made = unsafe { sys::b3Shape_IsValid(made) }.then(|| shape(made))?;
        if let NativePiece::Mesh(mesh) = piece {
            self.meshes.insert(made, Arc::clone(mesh));
        }
        Some(made)
    }

    /// Takes a shape off its body.
    pub(super) fn detach(&mut self, of: NativeShape) {
        let NativeShape(index1, world0, generation) = of;
        let id = sys::b3ShapeId {
            index1,
            world0,
            generation,
        };
        // SAFETY: the shape is of this world.
        unsafe {
            if self.has(world0) && sys::b3Shape_IsValid(id) {
                sys::b3DestroyShape(id, false);
            }
        }
        self.meshes.remove(&of);
    }

    /// The contacts of a body after the last step.
    pub(super) fn contacts(&self, body: NativeBody) -> Vec<Touching> {
        let Some(id) = self.live(body) else {
            return Vec::new();
        };
        // SAFETY: the array has room for as many as the call may write; what they point to is read before another call of
        // the world.
        unsafe {
            let most = sys::b3Body_GetContactCapacity(id).max(0);
            let mut found = vec![sys::b3ContactData::default(); most as usize];
            let count = sys::b3Body_GetContactData(id, found.as_mut_ptr(), most);
            found.truncate(count.max(0) as usize);
            let mut touching = Vec::new();
            for pair in &found {
                let manifolds = array(pair.manifolds, pair.manifoldCount);
                let shapes = [shape(pair.shapeIdA), shape(pair.shapeIdB)];
                touching.extend(manifolds.iter().filter_map(|one| deepest(shapes, one)));
            }
            touching
        }
    }

    /// The body's id, if it is a live body of this world.
    fn live(&self, body: NativeBody) -> Option<sys::b3BodyId> {
        let id = body.0;
        // SAFETY: Box3D takes any id here.
        (self.has(id.world0) && unsafe { sys::b3Body_IsValid(id) }).then_some(id)
    }

    /// True for the number of this world in an id.
    const fn has(&self, world0: u16) -> bool {
        world0.wrapping_add(1) == self.id.index1
    }
}

/// Calls of one body: the value of a call, or the default for a body that is gone.
macro_rules! of_body {
    ($($(#[$doc:meta])* fn $name:ident($id:ident $(, $arg:ident: $type:ty)*) $(-> $back:ty)? = $call:expr;)*) => {
        impl World {
            $($(#[$doc])*
            pub(super) fn $name(&self, body: NativeBody $(, $arg: $type)*) $(-> $back)? {
                let Some($id) = self.live(body) else {
                    return Default::default();
                };
                // SAFETY: the body is of this world; the arguments are plain values.
                unsafe { $call }
            })*
        }
    };
}

of_body! {
    fn pose(id) -> Placement = {
        let at = sys::b3Body_GetTransform(id);
        (from_vector(at.p), from_quaternion(at.q))
    };
    fn set_pose(id, to: Placement) = sys::b3Body_SetTransform(id, vector(to.0), quaternion(to.1));
    /// Sets the velocities with which a body is at a pose after `dt` seconds, and wakes it.
    fn go_to(id, to: Placement, dt: f32) =
        sys::b3Body_SetTargetTransform(id, transform(to), dt, true);
    fn velocities(id) -> (Vec3, Vec3) = (
        from_vector(sys::b3Body_GetLinearVelocity(id)),
        from_vector(sys::b3Body_GetAngularVelocity(id)),
    );
    fn set_velocities(id, to: (Vec3, Vec3)) = {
        sys::b3Body_SetLinearVelocity(id, vector(to.0));
        sys::b3Body_SetAngularVelocity(id, vector(to.1));
    };
    fn set_mobility(id, to: Mobility) = {
        if sys::b3Body_GetType(id) != mobility(to) {
            sys::b3Body_SetType(id, mobility(to));
        }
    };
    /// Per second: linear, then angular.
    fn set_damping(id, to: (f32, f32)) = {
        sys::b3Body_SetLinearDamping(id, to.0);
        sys::b3Body_SetAngularDamping(id, to.1);
    };
    fn set_gravity_scale(id, to: f32) = sys::b3Body_SetGravityScale(id, to);
    fn set_swept(id, to: bool) = sys::b3Body_SetBullet(id, to);
    /// Speed below which it may sleep, m/s, or Box3D's own; `None`: it never does.
    fn set_sleep(id, below: Option<Option<f32>>) = {
        if let Some(speed) = below {
            let own = sys::b3DefaultBodyDef().sleepThreshold;
            sys::b3Body_SetSleepThreshold(id, speed.unwrap_or(own));
        }
        if sys::b3Body_IsSleepEnabled(id) != below.is_some() {
            sys::b3Body_EnableSleep(id, below.is_some());
        }
    };
    fn set_locks(id, locks: [bool; 6]) = {
        let [x, y, z, about_x, about_y, about_z] = locks;
        let locks = sys::b3MotionLocks {
            linearX: x,
            linearY: y,
            linearZ: z,
            angularX: about_x,
            angularY: about_y,
            angularZ: about_z,
        };
        sys::b3Body_SetMotionLocks(id, locks);
    };
    fn set_enabled(id, to: bool) = {
        if sys::b3Body_IsEnabled(id) != to {
            if to { sys::b3Body_Enable(id) } else { sys::b3Body_Disable(id) }
        }
    };
    /// Only a dynamic body is put to sleep, with what touches it: others have no island.
    fn set_awake(id, to: bool) = {
        if to || sys::b3Body_GetType(id) == sys::b3BodyType_b3_dynamicBody {
            sys::b3Body_SetAwake(id, to);
        }
    };
    fn is_awake(id) -> bool = sys::b3Body_IsAwake(id);
    /// Kilograms, and the inertia about the origin in the body's axes.
    fn set_mass(id, mass: f32, inertia: Mat3) = {
        let [cx, cy, cz] = inertia.to_cols_array_2d().map(|column| vector(column.into()));
        let inertia = sys::b3Matrix3 { cx, cy, cz };
        let center = vector(Vec3::ZERO);
        sys::b3Body_SetMassData(id, sys::b3MassData { mass, center, inertia });
    };
    fn inverse_mass(id) -> f32 = sys::b3Body_GetInverseMass(id);
    fn inverse_inertia(id) -> Mat3 = {
        let inverse = sys::b3Body_GetWorldInverseRotationalInertia(id);
        let [x, y, z] = [inverse.cx, inverse.cy, inverse.cz].map(from_vector);
        Mat3::from_cols(x, y, z)
    };
    fn push_force(id, force: Vec3) = sys::b3Body_ApplyForceToCenter(id, vector(force), true);
    fn push_torque(id, torque: Vec3) = sys::b3Body_ApplyTorque(id, vector(torque), true);
    fn push_impulse(id, impulse: Vec3) =
        sys::b3Body_ApplyLinearImpulseToCenter(id, vector(impulse), true);
    fn push_torque_impulse(id, impulse: Vec3) =
        sys::b3Body_ApplyAngularImpulse(id, vector(impulse), true);
}

impl Drop for World {
    fn drop(&mut self) {
        let _one_at_a_time = WORLDS.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the world is this one's own; its meshes are dropped later.
        unsafe { sys::b3DestroyWorld(self.id) };
    }
}

/// The deepest point of a manifold.
fn deepest(shapes: [NativeShape; 2], manifold: &sys::b3Manifold) -> Option<Touching> {
    let count = usize::try_from(manifold.pointCount).unwrap_or_default();
    let points = manifold.points.get(..count)?;
    let deepest = points
        .iter()
        .min_by(|a, b| a.separation.total_cmp(&b.separation))?;
    Some(Touching {
        shapes,
        anchors: [from_vector(deepest.anchorA), from_vector(deepest.anchorB)],
        normal: from_vector(manifold.normal),
        separation: deepest.separation,
        impulse: points.iter().map(|point| point.totalNormalImpulse).sum(),
    })
}

/// An array of Box3D.
///
/// # Safety
///
/// It must have so many values, unless that is zero, and stay as it is while the result is used.
const unsafe fn array<'a, T>(first: *const T, count: i32) -> &'a [T] {
    if count <= 0 || first.is_null() {
        return &[];
    }
    // SAFETY: the caller's.
    unsafe { slice::from_raw_parts(first, count as usize) }
}

/// Friction or restitution of two touching surfaces: the mean, as with Rapier.
extern "C" fn mean(one: f32, _: u64, other: f32, _: u64) -> f32 {
    (one + other) * 0.5
}

const fn shape(id: sys::b3ShapeId) -> NativeShape {
    NativeShape(id.index1, id.world0, id.generation)
}

const fn mobility(kind: Mobility) -> sys::b3BodyType {
    match kind {
        Mobility::Static => sys::b3BodyType_b3_staticBody,
        Mobility::Dynamic => sys::b3BodyType_b3_dynamicBody,
        Mobility::Kinematic => sys::b3BodyType_b3_kinematicBody,
    }
}

const fn vector(v: Vec3) -> sys::b3Vec3 {
    sys::b3Vec3 {
        x: v.x,
        y: v.y,
        z: v.z,
    }
}

const fn from_vector(v: sys::b3Vec3) -> Vec3 {
    Vec3::new(v.x, v.y, v.z)
}

/// A rotation of unit length.
fn quaternion(q: Quat) -> sys::b3Quat {
    let q = q.as_dquat().normalize().as_quat();
    sys::b3Quat {
        v: vector(Vec3::new(q.x, q.y, q.z)),
        s: q.w,
    }
}

const fn from_quaternion(q: sys::b3Quat) -> Quat {
    Quat::from_xyzw(q.v.x, q.v.y, q.v.z, q.s)
}

fn transform((position, rotation): Placement) -> sys::b3Transform {
    sys::b3Transform {
        p: vector(position),
        q: quaternion(rotation),
    }
}

/// A joint of a world.
#[derive(Clone, Copy, Debug)]
pub(super) struct NativeJoint(sys::b3JointId);

/// Free motions of a joint.
pub(super) enum JointShape {
    Weld,
    Ball,
    /// The turn about the z axis, between two angles.
    Hinge(Option<[f32; 2]>),
    /// The displacement along the x axis, between two lengths.
    Slider(Option<[f32; 2]>),
    /// Anchors at most so far apart, metres.
    Rope(f32),
}

impl World {
    /// Joins two bodies by a frame in each, and wakes them; `None` if one of them is gone.
    pub(super) fn join(
        &mut self,
        bodies: [NativeBody; 2],
        frames: [Placement; 2],
        (shape, collide): (&JointShape, bool),
    ) -> Option<NativeJoint> {
        let [Some(first), Some(second)] = bodies.map(|body| self.live(body)) else {
            return None;
        };
        let placed = |base: &mut sys::b3JointDef| {
            (base.bodyIdA, base.bodyIdB) = (first, second);
            let [one, other] = frames.map(transform);
            (base.localFrameA, base.localFrameB) = (one, other);
            base.collideConnected = collide;
        };
        // SAFETY: both bodies are of this world; the rest are plain values.
        let id = unsafe {
            match *shape {
                JointShape::Weld => {
                    let mut def = sys::b3DefaultWeldJointDef();
                    placed(&mut def.base);
                    sys::b3CreateWeldJoint(self.id, &raw const def)
                }
                JointShape::Ball => {
                    let mut def = sys::b3DefaultSphericalJointDef();
                    placed(&mut def.base);
                    sys::b3CreateSphericalJoint(self.id, &raw const def)
                }
                JointShape::Hinge(limits) => {
                    let mut def = sys::b3DefaultRevoluteJointDef();
                    placed(&mut def.base);
                    def.enableLimit = limits.is_some();
                    [def.lowerAngle, def.upperAngle] = limits.unwrap_or_default();
                    sys::b3CreateRevoluteJoint(self.id, &raw const def)
                }
                JointShape::Slider(limits) => {
                    let mut def = sys::b3DefaultPrismaticJointDef();
                    placed(&mut def.base);
                    def.enableLimit = limits.is_some();
                    [def.lowerTranslation, def.upperTranslation] = limits.unwrap_or_default();
                    sys::b3CreatePrismaticJoint(self.id, &raw const def)
                }
                JointShape::Rope(length) => {
                    let mut def = sys::b3DefaultDistanceJointDef();
                    placed(&mut def.base);
                    // A spring without stiffness leaves the distance free below the limit.
                    (def.enableSpring, def.hertz, def.length) = (true, 0.0, length);
                    (def.enableLimit, def.minLength, def.maxLength) = (true, 0.0, length);
                    sys::b3CreateDistanceJoint(self.id, &raw const def)
                }
            }
        };
        // SAFETY: the id is Box3D's own.
        unsafe {
            if !sys::b3Joint_IsValid(id) {
                return None;
            }
            sys::b3Joint_WakeBodies(id);
        }
        Some(NativeJoint(id))
    }

    /// Removes a joint, if it is there, and wakes its bodies.
    pub(super) fn part(&mut self, joint: NativeJoint) {
        if let Some(id) = self.live_joint(joint) {
            // SAFETY: the joint is of this world.
            unsafe { sys::b3DestroyJoint(id, true) };
        }
    }

    /// The force and the torque that a joint bore in the last step: N, N·m.
    pub(super) fn load(&self, joint: NativeJoint) -> Option<(Vec3, Vec3)> {
        let id = self.live_joint(joint)?;
        // SAFETY: the joint is of this world.
        let (force, torque) = unsafe {
            (
                sys::b3Joint_GetConstraintForce(id),
                sys::b3Joint_GetConstraintTorque(id),
            )
        };
        Some((from_vector(force), from_vector(torque)))
    }

    fn live_joint(&self, NativeJoint(id): NativeJoint) -> Option<sys::b3JointId> {
        // SAFETY: Box3D takes any id here.
        (self.has(id.world0) && unsafe { sys::b3Joint_IsValid(id) }).then_some(id)
    }
}
