//! glTF, as text or binary: nodes with meshes, and bodies of its physics.
//!
//! In a file without physics each mesh is a fixed body with its triangles; where the extras of a node have a `mass`, the
//! node and all below it are one body that moves. In a file with KHR_physics_rigid_bodies its colliders are the shapes,
//! meshes are for drawing, and its joints hold bodies together. y points up. A part of the file that a scene cannot have
//! is noted.

mod buffers;
mod document;
mod joints;

use std::rc::Rc;

use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::CollisionGroups;
use serde_json::{Map, Value};

pub(crate) use buffers::MAGIC;
use buffers::{Buffers, Primitives, TRIANGLES_OF_ALL};
use document::{Collider, Document, Geometry, Motion, Node, RigidBody, title};
use joints::Joints;

use crate::files::Files;
use crate::inertia::{Inertia, Pose};
use crate::mesh::{self, MESH_TRIANGLES_MAX, TriangleMesh, ending};
use crate::model::{FileUp, LoadOptions, Model, ModelBody, Placed, Solid, settle_masses};
use crate::report::{Effect, LoadError, Place, Problem, Report};

/// Extensions that are read.
const EXTENSIONS: [&str; 2] = ["KHR_physics_rigid_bodies", "KHR_implicit_shapes"];
/// Difference of two radii that counts as none, metres.
const EVEN: f64 = 1e-9;
/// The cosine between two axes of a node that counts as none: files have rotations in single precision.
const SQUARE: f64 = 1e-5;

/// True for a file of this form: by its ending, or by the element that every one has.
pub(crate) fn is_gltf(path: &str, text: &str) -> bool {
    #[derive(serde::Deserialize)]
    struct Probe {
        asset: Option<serde::de::IgnoredAny>,
    }
    let has_asset = || serde_json::from_str::<Probe>(text).is_ok_and(|probe| probe.asset.is_some());
    ending(path) == "gltf" || has_asset()
}

/// Reads a binary file.
pub(crate) fn read_binary(
    path: &str,
    bytes: &[u8],
    files: &dyn Files,
    options: &LoadOptions,
    report: &mut Report,
) -> Result<Model, LoadError> {
    let split = buffers::container(bytes).map_err(|problem| at(path, problem))?;
    let text = String::from_utf8_lossy(split.0);
    read_with(path, (&text, split.1), files, options, report)
}

/// Reads a text.
pub(crate) fn read(
    path: &str,
    text: &str,
    files: &dyn Files,
    options: &LoadOptions,
    report: &mut Report,
) -> Result<Model, LoadError> {
    read_with(path, (text, None), files, options, report)
}

fn at(path: &str, problem: Problem) -> LoadError {
    let place = Place::of(path);
    LoadError { place, problem }
}

fn read_with(
    path: &str,
    (text, binary): (&str, Option<&[u8]>),
    files: &dyn Files,
    options: &LoadOptions,
    report: &mut Report,
) -> Result<Model, LoadError> {
    let text = text.trim_start_matches('\u{feff}');
    let document: Document = serde_json::from_str(text).map_err(|error| LoadError {
        place: Place {
            file: path.to_owned(),
            line: u32::try_from(error.line()).ok().filter(|line| *line > 0),
        },
        problem: Problem::Syntax(error.to_string()),
    })?;
    let version = &document.asset.version;
    if !version.starts_with("2.") {
        let what = format!("glTF of version {version:?}");
        return Err(at(path, Problem::UnknownFormat(what)));
    }
    let needed = document.asset.min_version.as_deref();
    if let Some(needed) = needed.filter(|needed| *needed != "2.0") {
        let what = format!("glTF that needs version {needed:?}");
        return Err(at(path, Problem::UnknownFormat(what)));
    }
    let buffers = Buffers::read(&document, path, files, binary);
    let buffers = buffers.map_err(|problem| at(path, problem))?;
    let mut reader = Reader {
        place: Place::of(path),
        has_physics: document.has_physics(),
        primitives: Primitives::new(&document, buffers),
        document: &document,
        report,
        triangles: 0,
        bodies: Vec::new(),
        masses: Vec::new(),
        joints: Joints::new(document.nodes.len()),
    };
    reader.note_rest();
    let name = reader.walk().map_err(|problem| at(path, problem))?;
    reader.give_masses();
    let Reader {
        place,
        mut bodies,
        joints,
        report,
        ..
    } = reader;
    let world = || fixed("world", &place, Pose::IDENTITY, Inertia::NONE);
    let joints = joints.made(&document, &mut bodies, world, (&place, report));
    let joints = joints.map_err(|problem| at(path, problem))?;
    settle_masses(&mut bodies, &joints, f64::from(options.density), report);
    Ok(Model {
        name,
        up: FileUp::Y,
        gravity: DVec3::new(0.0, -9.80665, 0.0),
        step: None,
        bodies,
        joints,
    })
}

impl Document {
    fn has_physics(&self) -> bool {
        let has_body = |node: &Node| node.extensions.body.is_some();
        self.extensions.physics.is_some() || self.nodes.iter().any(has_body)
    }
}

impl Node {
    /// Node → the node above.
    fn local(&self) -> Option<DMat4> {
        if let Some(matrix) = &self.matrix {
            return Some(DMat4::from_cols_array(matrix));
        }
        let rotation = self.rotation.map_or(DQuat::IDENTITY, DQuat::from_array);
        let length = rotation.length();
        let is_rotation = length.is_finite() && length > 1e-6;
        let scale = self.scale.map_or(DVec3::ONE, DVec3::from_array);
        let translation = self.translation.map_or(DVec3::ZERO, DVec3::from_array);
        is_rotation.then(|| {
            DMat4::from_scale_rotation_translation(scale, rotation.normalize(), translation)
        })
    }

    /// The mass that its extras give it, kg: it moves.
    fn mass(&self) -> Option<f64> {
        let mass = self.extras.get("mass").and_then(Value::as_f64);
        mass.filter(|mass| *mass > 0.0)
    }

    /// True if its extras have a mass that is none.
    fn has_wrong_mass(&self) -> bool {
        self.mass().is_none() && self.extras.get("mass").is_some()
    }
}

/// Place and axes of a node, without its scale.
fn pose_of(matrix: &DMat4) -> Pose {
    let x = matrix.x_axis.truncate().normalize_or(DVec3::X);
    let second = matrix.y_axis.truncate();
    let y = (second - x * x.dot(second)).normalize_or(x.any_orthonormal_vector());
    let axes = DMat3::from_cols(x, y, x.cross(y));
    Pose::new(
        matrix.w_axis.truncate(),
        DQuat::from_mat3(&axes).normalize(),
    )
}

struct Reader<'a> {
    place: Place,
    document: &'a Document,
    has_physics: bool,
    primitives: Primitives<'a>,
    report: &'a mut Report,
    /// Triangles of all bodies.
    triangles: usize,
    bodies: Vec<ModelBody>,
    /// Bodies whose mass extras say, kg.
    masses: Vec<(usize, f64)>,
    joints: Joints<'a>,
}

impl Reader<'_> {
    fn note(&mut self, subject: String, effect: Effect, why: &'static str) {
        self.report.again(&self.place, subject, effect, why);
    }

    /// Notes what a file has besides nodes and meshes.
    fn note_rest(&mut self) {
        let document = self.document;
        let drawing = document.cameras.len() + document.materials.len() + document.images.len();
        for (count, subject, why) in [
            (
                document.animations.len(),
                "animation",
                "no body moves along a curve: send its poses",
            ),
            (document.skins.len(), "skin", "bodies do not bend"),
            (
                drawing,
                "cameras, materials and pictures",
                "they are about drawing alone",
            ),
        ] {
            (0..count).for_each(|_| self.note(subject.to_owned(), Effect::Left, why));
        }
        for (names, why) in [
            (
                &document.extensions_required,
                "the file requires it, and it is not read",
            ),
            (&document.extensions_used, "the extension is not read"),
        ] {
            for name in names
                .iter()
                .filter(|name| !EXTENSIONS.contains(&name.as_str()))
            {
                self.note(format!("extension {name}"), Effect::Left, why);
            }
        }
    }

    /// Reads the nodes of the scene, and returns its name.
    fn walk(&mut self) -> Result<String, Problem> {
        let document = self.document;
        let nodes = document.nodes.len();
        Problem::bound("nodes", nodes, BODIES_MAX as usize)?;
        let scene = match (document.scene, document.scenes.first()) {
            (Some(number), _) => Some(document.scenes.get(number).ok_or_else(|| {
                let count = document.scenes.len();
                Problem::Mesh(format!("it names scene {number}, and has {count}"))
            })?),
            (None, first) => first,
        };
        for _ in 1..document.scenes.len() {
            let why = "one scene of the file is read: the one that it names, or its first";
            self.note("scene".to_owned(), Effect::Left, why);
        }
        let roots: Vec<usize> = match scene {
            Some(scene) => scene.nodes.clone(),
            None => self.roots(),
        };
        const RING: &str = "it hangs on two nodes, or on itself";
        let mut seen = vec![false; nodes];
        let mut open: Vec<_> = roots
            .iter()
            .rev()
            .map(|root| (*root, DMat4::IDENTITY, None))
            .collect();
        while let Some((number, above, body)) = open.pop() {
            let Some(node) = document.nodes.get(number) else {
                return Err(Problem::Mesh(format!(
                    "it names node {number}, and has {nodes}"
                )));
            };
            let name = title(number, &node.name);
            if std::mem::replace(&mut seen[number], true) {
                let rule = RING;
                return Err(Problem::Senseless { name, rule });
            }
            let local = node.local().ok_or_else(|| Problem::Senseless {
                name: name.clone(),
                rule: "its rotation is no quaternion",
            })?;
            let world = above * local;
            if !world.is_finite() {
                let rule = "its place is not finite";
                return Err(Problem::Senseless { name, rule });
            }
            let body = self.visit((&name, node), &world, body)?;
            let physics = node.extensions.body.as_ref();
            let joint = physics.and_then(|body| body.joint.as_ref());
            (self.joints).visit((number, &name), pose_of(&world), body, joint);
            open.extend(
                node.children
                    .iter()
                    .rev()
                    .map(|child| (*child, world, body)),
            );
        }
        self.note_missed(&seen);
        // Without scenes all nodes are read, but those in a ring hang on no root.
        let missed = seen.iter().position(|seen| !seen);
        if let Some(number) = missed.filter(|_| scene.is_none()) {
            let name = title(number, &document.nodes[number].name);
            let rule = RING;
            return Err(Problem::Senseless { name, rule });
        }
        Ok(scene.map_or_else(String::new, |scene| scene.name.clone()))
    }

    /// Notes nodes that the only scene of a file has not.
    fn note_missed(&mut self, seen: &[bool]) {
        if self.document.scenes.len() == 1 {
            for _ in seen.iter().filter(|seen| !**seen) {
                let why = "it is not in the scene of the file";
                self.note("node".to_owned(), Effect::Left, why);
            }
        }
    }

    /// The nodes that hang on no other.
    fn roots(&self) -> Vec<usize> {
        let mut held = vec![false; self.document.nodes.len()];
        let children = self.document.nodes.iter().flat_map(|node| &node.children);
        for child in children {
            if let Some(held) = held.get_mut(*child) {
                *held = true;
            }
        }
        (0..held.len()).filter(|node| !held[*node]).collect()
    }

    /// Adds what a node has; returns the body that moves it and those below.
    fn visit(
        &mut self,
        (name, node): (&str, &Node),
        world: &DMat4,
        above: Option<usize>,
    ) -> Result<Option<usize>, Problem> {
        self.note_node(node);
        let physics = node.extensions.body.as_ref();
        let motion = physics.and_then(|body| body.motion.as_ref());
        let body = match (motion, node.mass()) {
            // It is a body of its own, and what is below it hangs on it.
            (Some(motion), _) if motion.is_kinematic => {
                let why = "a body that a program moves is a fixed one here";
                self.note("kinematic motion".to_owned(), Effect::Changed, why);
                None
            }
            (Some(motion), _) => Some(self.moving(name, world, motion.inertia())),
            (None, Some(mass)) => {
                let body = self.moving(name, world, Inertia::NONE);
                self.masses.push((body, mass));
                Some(body)
            }
            (None, None) => above,
        };
        if let Some(RigidBody {
            collider: Some(collider),
            ..
        }) = physics
        {
            self.collide(name, collider, world, body)?;
        }
        if let Some(mesh) = node.mesh.filter(|_| !self.has_physics) {
            self.add_mesh(name, mesh, world, body)?;
        } else if node.mesh.is_some() {
            let why = "in a file with physics only colliders are bodies";
            self.note("mesh".to_owned(), Effect::Left, why);
        }
        Ok(body)
    }

    /// A body that moves.
    fn moving(&mut self, name: &str, world: &DMat4, inertia: Inertia) -> usize {
        let body = self.body(name, pose_of(world), inertia);
        self.bodies[body].fixed = false;
        body
    }

    /// Notes what a node has and no body.
    fn note_node(&mut self, node: &Node) {
        for name in node.extensions.others.keys() {
            self.note(
                format!("extension {name}"),
                Effect::Left,
                "a body has no such thing",
            );
        }
        for name in node.extras.as_object().into_iter().flat_map(Map::keys) {
            if name != "mass" {
                let why = "of the extras of a node the mass is read";
                self.note(format!("extras {name}"), Effect::Left, why);
            }
        }
        if node.has_wrong_mass() {
            let why = "a mass is a number of kilograms above zero: the node does not move by it";
            self.note("extras mass".to_owned(), Effect::Left, why);
        }
        if let Some(body) = &node.extensions.body {
            self.note_body(body);
        }
    }

    /// Notes what the physics of a node has and no body.
    fn note_body(&mut self, body: &RigidBody) {
        let velocities =
            |motion: &Motion| motion.linear_velocity.is_some() || motion.angular_velocity.is_some();
        let motion = body.motion.as_ref();
        let collider = body.collider.as_ref();
        for (is_there, subject, why) in [
            (
                body.trigger.is_some(),
                "trigger",
                "triggers of this extension are not read",
            ),
            (
                motion.is_some_and(velocities),
                "velocity",
                "a loaded body begins at rest",
            ),
            (
                motion
                    .and_then(|motion| motion.mass)
                    .is_some_and(|mass| mass < 0.0),
                "mass below zero",
                "the mass is that of the shapes",
            ),
            (
                motion
                    .and_then(|motion| motion.inertia_diagonal)
                    .is_some_and(|moments| moments.iter().any(|moment| *moment < 0.0)),
                "moments of inertia below zero",
                "no solid has one",
            ),
            (
                motion
                    .and_then(|motion| motion.inertia_orientation)
                    .is_some_and(|turn| turn == [0.0; 4]),
                "inertia orientation",
                "it is no quaternion",
            ),
            (
                motion.is_some_and(|motion| {
                    motion.gravity_factor.is_some_and(|factor| factor != 1.0)
                }),
                "gravity factor",
                "a loaded body falls as all do",
            ),
            (
                collider.is_some_and(|collider| collider.collision_filter.is_some()),
                "collision filter",
                "all bodies of a file touch each other",
            ),
        ] {
            if is_there {
                self.note(subject.to_owned(), Effect::Left, why);
            }
        }
    }

    /// A fixed body.
    fn body(&mut self, name: &str, pose: Pose, inertia: Inertia) -> usize {
        self.bodies.push(fixed(name, &self.place, pose, inertia));
        self.bodies.len() - 1
    }

    /// Gives bodies the masses of their extras, spread over their shapes.
    fn give_masses(&mut self) {
        for (body, mass) in std::mem::take(&mut self.masses) {
            let body = &mut self.bodies[body];
            let solids = body.solids.iter();
            let solids =
                solids.filter_map(|placed| Some(placed.solid.inertia(1.0)?.moved(&placed.pose)));
            let sum = solids.fold(Inertia::NONE, |sum, one| sum.plus(&one));
            body.inertia = match sum.mass > 0.0 {
                true => sum.times(mass / sum.mass),
                false => Inertia::diagonal(mass, DVec3::ZERO),
            };
        }
    }

    /// Adds the shape of a collider.
    fn collide(
        &mut self,
        name: &str,
        collider: &Collider,
        world: &DMat4,
        body: Option<usize>,
    ) -> Result<(), Problem> {
        let before = self.bodies.len();
        let has_other = body.is_some_and(|body| !self.bodies[body].solids.is_empty());
        match self.named(name, &collider.geometry)? {
            Named::Mesh(mesh) => self.add_mesh(name, mesh, world, body)?,
            Named::Shape(shape) => self.add_shape(name, shape, world, body)?,
            Named::Nothing => return Ok(()),
        }
        let friction = self.friction(name, collider)?;
        if let Some(body) = body.filter(|_| has_other)
            && self.bodies[body].friction != friction
        {
            let why = "a body has one friction: that of its last collider with one";
            let subject = "friction of several colliders".to_owned();
            self.note(subject, Effect::Approximated, why);
        }
        let own = before..self.bodies.len();
        for place in body.into_iter().chain(own) {
            let body = &mut self.bodies[place];
            body.friction = friction.or(body.friction);
        }
        Ok(())
    }

    /// The thing that gives a collider its shape, with a note if that is nothing.
    fn named(&mut self, name: &str, geometry: &Geometry) -> Result<Named, Problem> {
        let document = self.document;
        let nodes = document.nodes.len();
        let node = geometry.node.map(|number| {
            let node = document.nodes.get(number);
            node.ok_or_else(|| {
                Problem::Mesh(format!(
                    "the collider of {name} names node {number}, and there are {nodes}"
                ))
            })
        });
        let node = node.transpose()?;
        let mesh = geometry.mesh.or(node.and_then(|node| node.mesh));
        let why = match (mesh, geometry.shape, node) {
            (Some(mesh), ..) => return Ok(Named::Mesh(mesh)),
            (None, Some(shape), _) => return Ok(Named::Shape(shape)),
            (None, None, Some(_)) => "the node that it names has no mesh",
            (None, None, None) => "it names no shape, mesh or node",
        };
        self.note("collider".to_owned(), Effect::Left, why);
        Ok(Named::Nothing)
    }

    /// The friction of a collider's material.
    fn friction(&mut self, name: &str, collider: &Collider) -> Result<Option<f64>, Problem> {
        let Some(number) = collider.physics_material else {
            return Ok(None);
        };
        let physics = self.document.extensions.physics.as_ref();
        let materials = physics.map_or(&[][..], |physics| &physics.physics_materials);
        let Some(material) = materials.get(number) else {
            let count = materials.len();
            return Err(Problem::Mesh(format!(
                "the collider of {name} names physics material {number}, and there are {count}"
            )));
        };
        if material
            .restitution
            .is_some_and(|restitution| restitution != 0.0)
        {
            let why = "of a material the friction is read";
            self.note("restitution".to_owned(), Effect::Left, why);
        }
        Ok(material.dynamic_friction)
    }

    /// Adds a shape without triangles: to a body that moves, or as a fixed body of its own.
    fn add_shape(
        &mut self,
        name: &str,
        shape: usize,
        world: &DMat4,
        body: Option<usize>,
    ) -> Result<(), Problem> {
        let axes = [world.x_axis, world.y_axis, world.z_axis].map(DVec4::truncate);
        let [x, y, z] = axes.map(DVec3::normalize_or_zero);
        if [x.dot(y), y.dot(z), z.dot(x)]
            .iter()
            .any(|cosine| cosine.abs() > SQUARE)
        {
            let why = "a node with a turn below an uneven scale shears it: it has the lengths of the node's axes";
            self.note("sheared collider".to_owned(), Effect::Approximated, why);
        }
        let scale = DVec3::from_array(axes.map(DVec3::length));
        let Some(solid) = self.implicit(name, shape, scale)? else {
            return Ok(());
        };
        let pose = pose_of(world);
        let body = body.unwrap_or_else(|| self.body(name, pose, Inertia::NONE));
        let inverse = self.bodies[body].pose.inverse();
        let pose = inverse.of(&pose).of(&along_z(&solid));
        let name = format!("collider of {name}");
        self.bodies[body].solids.push(Placed { pose, solid, name });
        Ok(())
    }

    /// A shape without triangles, stretched.
    fn implicit(
        &mut self,
        name: &str,
        number: usize,
        scale: DVec3,
    ) -> Result<Option<Solid>, Problem> {
        let document = self.document;
        let shapes = &document.extensions.shapes.shapes;
        let Some(shape) = shapes.get(number) else {
            let count = shapes.len();
            return Err(Problem::Mesh(format!(
                "{name} names shape {number}, and there are {count}"
            )));
        };
        let round = |round: &document::Round| {
            let radius = round.radius_bottom.max(round.radius_top);
            let is_even = (round.radius_bottom - round.radius_top).abs() < EVEN;
            (
                round.height * 0.5 * scale.y,
                radius * scale.x.max(scale.z),
                is_even,
            )
        };
        let (solid, is_exact) = match shape.kind.as_str() {
            "box" => {
                let half = DVec3::from_array(shape.cuboid.size) * scale * 0.5;
                (Solid::Cuboid { half }, true)
            }
            "sphere" => {
                let is_even =
                    scale.max_element() - scale.min_element() < EVEN * scale.max_element();
                let radius = shape.sphere.radius * scale.max_element();
                (Solid::Ball { radius }, is_even)
            }
            "capsule" => {
                let (half, radius, is_even) = round(&shape.capsule);
                (Solid::Capsule { half, radius }, is_even)
            }
            "cylinder" => {
                let (half, radius, is_even) = round(&shape.cylinder);
                (Solid::Cylinder { half, radius }, is_even)
            }
            other => {
                let why = "shapes are boxes, spheres, capsules and cylinders";
                self.note(format!("shape {other}"), Effect::Left, why);
                return Ok(None);
            }
        };
        if !is_exact {
            let why = "its greatest radius is taken for all of it";
            self.note(format!("shape {}", shape.kind), Effect::Approximated, why);
        }
        Ok(Some(solid))
    }

    /// Adds a mesh: to a body that moves, or as fixed bodies of its own.
    fn add_mesh(
        &mut self,
        name: &str,
        number: usize,
        world: &DMat4,
        body: Option<usize>,
    ) -> Result<(), Problem> {
        let pose = match body {
            Some(body) => self.bodies[body].pose,
            None => pose_of(world),
        };
        let inverse = pose.inverse();
        let (place, report) = (&self.place, &mut *self.report);
        let mut note = |subject, why| report.again(place, subject, Effect::Left, why);
        for primitive in self.primitives.of_mesh(number, &mut note)? {
            let points = primitive.points.iter();
            let baked = TriangleMesh {
                points: points
                    .map(|point| inverse.point(world.transform_point3(*point)))
                    .collect(),
                triangles: primitive.triangles.clone(),
            };
            self.triangles += baked.triangles.len();
            Problem::bound(TRIANGLES_OF_ALL, self.triangles, MESH_TRIANGLES_MAX)?;
            Problem::bound("bodies", self.bodies.len(), BODIES_MAX as usize)?;
            let baked = match world.determinant() < 0.0 {
                true => baked.mirrored(),
                false => baked,
            };
            let baked = mesh::check(baked)?;
            let title = format!("mesh of {name}");
            match body {
                Some(body) => {
                    let solid = Solid::Hull(Rc::new(baked));
                    let (pose, name) = (Pose::IDENTITY, title);
                    self.bodies[body].solids.push(Placed { pose, solid, name });
                }
                None => {
                    for part in baked.parts() {
                        let body = self.body(name, pose, Inertia::NONE);
                        let solid = Solid::Mesh(Rc::new(part));
                        let (pose, name) = (Pose::IDENTITY, title.clone());
                        self.bodies[body].solids.push(Placed { pose, solid, name });
                    }
                }
            }
        }
        Ok(())
    }
}

/// The thing that gives a collider its shape.
enum Named {
    Mesh(usize),
    Shape(usize),
    Nothing,
}

/// A fixed body without a shape.
fn fixed(name: &str, place: &Place, pose: Pose, inertia: Inertia) -> ModelBody {
    ModelBody {
        name: name.to_owned(),
        place: place.clone(),
        pose,
        fixed: true,
        inertia,
        solids: Vec::new(),
        groups: CollisionGroups::ALL,
        friction: None,
        gravity_scale: 1.0,
    }
}

/// The turn of a solid whose long axis is z here, and y in the file.
fn along_z(solid: &Solid) -> Pose {
    let turn = DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2);
    match solid {
        Solid::Capsule { .. } | Solid::Cylinder { .. } => Pose::new(DVec3::ZERO, turn),
        _ => Pose::IDENTITY,
    }
}

impl Motion {
    /// Mass, centre and moments; what is missing is that of the shapes.
    fn inertia(&self) -> Inertia {
        let positive = |number: f64| if number > 0.0 { number } else { 0.0 };
        let mass = self.mass.map_or(0.0, positive);
        let moments = self.inertia_diagonal.map_or(DVec3::ZERO, DVec3::from_array);
        let moments = DVec3::new(
            positive(moments.x),
            positive(moments.y),
            positive(moments.z),
        );
        let turn = self
            .inertia_orientation
            .map_or(DQuat::IDENTITY, DQuat::from_array);
        let turn = if turn.length() > 1e-6 {
            turn.normalize()
        } else {
            DQuat::IDENTITY
        };
        let centre = DVec3::from_array(self.center_of_mass);
        Inertia::diagonal(mass, moments).moved(&Pose::new(centre, turn))
    }
}

#[cfg(test)]
mod tests;
