//! URDF: a robot as a tree of links and joints.
//!
//! Links that fixed joints connect become one body. The inertial's rotation counts, a link without mass never becomes a
//! body of no mass, and what the format has beyond bodies, joints and shapes is noted.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DQuat, DVec3};
use rhumb_protocol::scene::{CollisionGroups, JointKind, JointLimits, LockedAxes};

use crate::files::Files;
use crate::inertia::{Inertia, Pose, along_x};
use crate::mesh::Meshes;
use crate::model::{
    Base, Drive, FileUp, LoadOptions, Model, ModelBody, ModelJoint, OwnContacts, Placed, Solid,
    scale_masses, settle_masses,
};
use crate::report::{Effect, LoadError, Problem, Report};
use crate::xml::Element;

/// Links of a robot.
const LINKS_MAX: usize = 20_000;

/// A joint of the file between links of these places.
struct Edge<'a> {
    element: &'a Element,
    parent: usize,
    child: usize,
}

/// Reads a robot.
pub(crate) fn read(
    robot: &Element,
    files: &dyn Files,
    options: &LoadOptions,
    report: &mut Report,
) -> Result<Model, LoadError> {
    let links: Vec<_> = robot.each("link").collect();
    note_rest(robot, report);
    note_attributes(robot, report);
    let edges = edges(robot, &links)?;
    let order = order(robot, &links, &edges)?;
    let mut reader = Reader {
        meshes: Meshes::new(files, &options.packages),
        options,
        report,
        links: &links,
        bodies: Vec::new(),
        joints: Vec::new(),
        of_link: vec![(0, Pose::IDENTITY); links.len()],
    };
    reader.root(order.root)?;
    for edge in order.edges {
        reader.follow(edge)?;
    }
    reader.settle_masses();
    let Reader { bodies, joints, .. } = reader;
    Ok(Model {
        name: robot.text("name").unwrap_or("robot").to_owned(),
        up: FileUp::Z,
        gravity: DVec3::new(0.0, 0.0, -9.81),
        step: None,
        bodies,
        joints,
    })
}

/// Notes elements of the robot that are neither links nor joints.
fn note_rest(robot: &Element, report: &mut Report) {
    for element in &robot.children {
        let why = match element.name.as_str() {
            "link" | "joint" => continue,
            "material" => "colours are about drawing alone",
            _ => "a scene has no such thing",
        };
        report.again(&element.place(), element.name.clone(), Effect::Left, why);
    }
}

/// Elements of links and joints with the attributes that are read, or that say nothing of physics.
const READ: [(&str, &[&str]); 20] = [
    ("link", &["name", "type"]),
    ("joint", &["name", "type"]),
    ("origin", &["xyz", "rpy"]),
    ("parent", &["link"]),
    ("child", &["link"]),
    ("axis", &["xyz"]),
    ("dynamics", &["damping", "friction"]),
    ("limit", &["lower", "upper", "effort", "velocity"]),
    ("inertial", &[]),
    ("mass", &["value"]),
    ("inertia", &["ixx", "iyy", "izz", "ixy", "ixz", "iyz"]),
    ("collision", &["name", "group"]),
    ("geometry", &[]),
    ("box", &["size"]),
    ("sphere", &["radius"]),
    ("cylinder", &["length", "radius"]),
    ("capsule", &["length", "radius"]),
    ("mesh", &["filename", "scale"]),
    ("plane", &["normal"]),
    ("lateral_friction", &["value"]),
];

/// Notes attributes that are not read, of elements that are.
fn note_attributes(element: &Element, report: &mut Report) {
    let why = "the format has no such attribute, or it is not read";
    for part in &element.children {
        let known = READ.iter().find(|(name, _)| *name == part.name);
        if let Some((_, known)) = known {
            part.note_unread(&[known], why, report);
            note_attributes(part, report);
        }
    }
}

/// The joints, with the places of their links.
fn edges<'a>(robot: &'a Element, links: &[&Element]) -> Result<Vec<Edge<'a>>, LoadError> {
    if links.len() > LINKS_MAX {
        return Err(robot.wrong(Problem::TooMany {
            what: "links",
            found: links.len(),
            most: LINKS_MAX,
        }));
    }
    let mut places = BTreeMap::new();
    for (place, link) in links.iter().enumerate() {
        let name = link.needs("name")?;
        if places.insert(name, place).is_some() {
            let (what, name) = ("a link", name.to_owned());
            return Err(link.wrong(Problem::Twice { what, name }));
        }
    }
    let (mut edges, mut names) = (Vec::new(), BTreeSet::new());
    for element in robot.each("joint") {
        let name = element.needs("name")?;
        if !names.insert(name) {
            let (what, name) = ("a joint", name.to_owned());
            return Err(element.wrong(Problem::Twice { what, name }));
        }
        let end = |which| {
            let end = element.needs_child(which)?;
            let name = end.needs("link")?;
            places.get(name).copied().ok_or_else(|| {
                let (what, name) = ("link", name.to_owned());
                end.wrong(Problem::UnknownName { what, name })
            })
        };
        edges.push(Edge {
            element,
            parent: end("parent")?,
            child: end("child")?,
        });
    }
    Ok(edges)
}

/// The root of a tree of links, and its joints from there outward.
struct Order<'a> {
    root: usize,
    edges: Vec<Edge<'a>>,
}

fn order<'a>(
    robot: &Element,
    links: &[&Element],
    edges: &[Edge<'a>],
) -> Result<Order<'a>, LoadError> {
    let name = |link: usize| links[link].text("name").unwrap_or_default().to_owned();
    let mut held = vec![false; links.len()];
    let mut from: Vec<Vec<&Edge<'a>>> = links.iter().map(|_| Vec::new()).collect();
    for edge in edges {
        if edge.parent == edge.child {
            return Err(edge.element.wrong(Problem::Cycle(name(edge.child))));
        }
        if std::mem::replace(&mut held[edge.child], true) {
            return Err(edge.element.wrong(Problem::TwoParents(name(edge.child))));
        }
        from[edge.parent].push(edge);
    }
    let roots: Vec<_> = (0..links.len()).filter(|link| !held[*link]).collect();
    let root = match (roots.as_slice(), links.first()) {
        ([root], _) => *root,
        ([], Some(first)) => return Err(first.wrong(Problem::Cycle(name(0)))),
        _ => return Err(robot.wrong(Problem::Roots(roots.len()))),
    };
    let mut seen = vec![false; links.len()];
    seen[root] = true;
    let (mut open, mut order) = (vec![root], Vec::with_capacity(edges.len()));
    while let Some(link) = open.pop() {
        for Edge {
            element,
            parent,
            child,
        } in from[link].iter().rev()
        {
            seen[*child] = true;
            open.push(*child);
            order.push(Edge {
                element,
                parent: *parent,
                child: *child,
            });
        }
    }
    // Every link has at most one parent: what the root does not reach hangs on itself.
    match seen.iter().position(|seen| !seen) {
        Some(lost) => Err(links[lost].wrong(Problem::Cycle(name(lost)))),
        None => Ok(Order { root, edges: order }),
    }
}

struct Reader<'a> {
    meshes: Meshes<'a>,
    options: &'a LoadOptions,
    report: &'a mut Report,
    links: &'a [&'a Element],
    bodies: Vec<ModelBody>,
    joints: Vec<ModelJoint>,
    /// The body of each link, and the link's frame in the body's.
    of_link: Vec<(usize, Pose)>,
}

impl Reader<'_> {
    fn root(&mut self, link: usize) -> Result<(), LoadError> {
        self.new_body(link, Pose::IDENTITY);
        self.add_link(link)
    }

    /// A body whose frame is that of a link.
    fn new_body(&mut self, link: usize, pose: Pose) -> usize {
        let bit = 1 << (self.options.group & 31);
        let groups = match self.options.own_contacts {
            OwnContacts::AsFile => CollisionGroups {
                members: bit,
                touches: !bit,
            },
            OwnContacts::All => CollisionGroups::ALL,
        };
        let place = self.bodies.len();
        self.bodies.push(ModelBody {
            name: self.links[link].text("name").unwrap_or_default().to_owned(),
            place: self.links[link].place(),
            pose,
            fixed: false,
            inertia: Inertia::NONE,
            solids: Vec::new(),
            groups,
            friction: None,
            gravity_scale: 1.0,
        });
        self.of_link[link] = (place, Pose::IDENTITY);
        place
    }

    fn follow(&mut self, edge: Edge<'_>) -> Result<(), LoadError> {
        let element = edge.element;
        let (holding, frame) = self.of_link[edge.parent];
        let origin = element.child("origin").map_or(Ok(Pose::IDENTITY), origin)?;
        let in_body = frame.of(&origin);
        let kind = element.needs("type")?;
        if kind == "fixed" {
            self.of_link[edge.child] = (holding, in_body);
            return self.add_link(edge.child);
        }
        let pose = self.bodies[holding].pose.of(&in_body);
        let held = self.new_body(edge.child, pose);
        self.add_link(edge.child)?;
        self.note_joint(element);
        let along = axis(element)?;
        let turned = along_x(along);
        let (kind, axis) = match kind {
            "floating" => return Ok(()),
            "continuous" => (JointKind::Revolute(None), 3),
            "revolute" => (JointKind::Revolute(self.limits(element)?), 3),
            "prismatic" => (JointKind::Prismatic(self.limits(element)?), 0),
            "spherical" | "ball" => (JointKind::Spherical(None), 3),
            "planar" => (plane(), 3),
            _ => return Err(element.unknown_word("type")),
        };
        let mut drives = [None; 6];
        let dynamics = element.child("dynamics");
        drives[axis] = dynamics
            .map(|part| self.dynamics(element, part))
            .transpose()?;
        self.joints.push(ModelJoint {
            name: element.text("name").unwrap_or_default().to_owned(),
            place: element.place(),
            bodies: [holding, held],
            frame: pose.of(&Pose::new(DVec3::ZERO, turned)),
            start: Pose::IDENTITY,
            kind,
            drives,
            collide: false,
            holds: true,
        });
        Ok(())
    }

    /// Notes what a joint has beyond motion, limits and passive forces.
    fn note_joint(&mut self, element: &Element) {
        for part in &element.children {
            let why = match part.name.as_str() {
                "origin" | "parent" | "child" | "axis" | "dynamics" => continue,
                "limit" if part.text("effort").is_none() && part.text("velocity").is_none() => {
                    continue;
                }
                "limit" => {
                    let why = "effort and velocity bound actuators, and none is made: give the joint a motor";
                    let subject = "limit effort and velocity".to_owned();
                    self.report.again(&part.place(), subject, Effect::Left, why);
                    continue;
                }
                "mimic" => "joints are not coupled: the joint moves freely",
                _ => "a joint has no such thing",
            };
            let subject = format!("{} {}", element.title(), part.name);
            let values = part
                .attributes
                .iter()
                .map(|(name, value)| format!("{name} {value}"));
            let value = values.collect::<Vec<_>>().join(", ");
            self.report
                .add(&part.place(), subject, value, Effect::Left, why);
        }
    }

    /// The limits of a joint; `None` where it has none.
    fn limits(&mut self, element: &Element) -> Result<Option<JointLimits>, LoadError> {
        let limit = element.child("limit");
        let least = limit.map_or(Ok(None), |limit| limit.number("lower"))?;
        let most = limit.map_or(Ok(None), |limit| limit.number("upper"))?;
        let (least, most) = (least.unwrap_or(0.0), most.unwrap_or(0.0));
        if limit.is_none() || least > most {
            let value = format!("lower {least}, upper {most}");
            let why =
                "without limits, or with the lower one above the upper one, a joint moves freely";
            self.report.add(
                &element.place(),
                element.title(),
                value,
                Effect::Changed,
                why,
            );
            return Ok(None);
        }
        let [least, most] = [least, most].map(|limit| limit as f32);
        Ok(Some(JointLimits { least, most }))
    }

    /// The passive forces of a joint; those below zero would drive it, and are left out.
    fn dynamics(&mut self, joint: &Element, element: &Element) -> Result<Drive, LoadError> {
        let mut part = |name| -> Result<f64, LoadError> {
            let found = element.number(name)?.unwrap_or_default();
            if found < 0.0 {
                let why = "damping and friction are not below zero";
                let (subject, value) = (format!("{} {name}", joint.title()), found.to_string());
                self.report
                    .add(&element.place(), subject, value, Effect::Left, why);
            }
            Ok(found.max(0.0))
        };
        Ok(Drive {
            damping: part("damping")?,
            friction: part("friction")?,
            ..Drive::default()
        })
    }

    /// Adds mass and shapes of a link to its body.
    fn add_link(&mut self, link: usize) -> Result<(), LoadError> {
        let element = self.links[link];
        let (body, frame) = self.of_link[link];
        for part in &element.children {
            match part.name.as_str() {
                "inertial" => {
                    let inertia = inertial(part)?.moved(&frame);
                    let sum = self.bodies[body].inertia.plus(&inertia);
                    self.bodies[body].inertia = sum;
                }
                "collision" => self.add_collision(element, part, body, &frame)?,
                "visual" => {
                    let why = "only collision shapes have physics, and are drawn";
                    self.report
                        .again(&part.place(), "visual".to_owned(), Effect::Left, why);
                }
                "contact" => self.contact(part, body)?,
                name => {
                    let why = "a body has no such thing";
                    self.report
                        .again(&part.place(), format!("link {name}"), Effect::Left, why);
                }
            }
        }
        Ok(())
    }

    /// Bullet's element: friction is taken, the rest noted.
    fn contact(&mut self, part: &Element, body: usize) -> Result<(), LoadError> {
        for child in &part.children {
            if child.name == "lateral_friction" {
                self.bodies[body].friction = Some(child.needs_number("value")?);
                continue;
            }
            let why = "a material has friction and restitution alone";
            self.report.again(
                &child.place(),
                format!("contact {}", child.name),
                Effect::Left,
                why,
            );
        }
        Ok(())
    }

    fn add_collision(
        &mut self,
        link: &Element,
        part: &Element,
        body: usize,
        frame: &Pose,
    ) -> Result<(), LoadError> {
        let own = part.child("origin").map_or(Ok(Pose::IDENTITY), origin)?;
        let geometry = part.needs_child("geometry")?;
        let name = format!("collision of {}", link.title());
        let Some(shape) = geometry.children.first() else {
            return Err(geometry.wrong(Problem::Missing {
                element: name,
                part: "shape",
            }));
        };
        if let Some(solid) = self.solid(shape, &name)? {
            let pose = frame.of(&own);
            self.bodies[body].solids.push(Placed { pose, solid, name });
        }
        Ok(())
    }

    fn solid(&mut self, shape: &Element, name: &str) -> Result<Option<Solid>, LoadError> {
        let long = || -> Result<_, LoadError> {
            let half = shape.needs_number("length")? * 0.5;
            Ok((half, shape.needs_number("radius")?))
        };
        Ok(Some(match shape.name.as_str() {
            "sphere" => Solid::Ball {
                radius: shape.needs_number("radius")?,
            },
            "box" => {
                shape.needs("size")?;
                let half = shape.vector("size")?.unwrap_or_default() * 0.5;
                Solid::Cuboid { half }
            }
            "cylinder" => {
                let (half, radius) = long()?;
                Solid::Cylinder { half, radius }
            }
            "capsule" => {
                let (half, radius) = long()?;
                Solid::Capsule { half, radius }
            }
            "plane" => Solid::Plane,
            "mesh" => {
                let file = shape.needs("filename")?;
                let scale = match shape.numbers("scale")?.as_deref() {
                    None => DVec3::ONE,
                    Some([all]) => DVec3::splat(*all),
                    Some([x, y, z]) => DVec3::new(*x, *y, *z),
                    Some(other) => return Err(shape.count("scale", other.len(), "1 or 3")),
                };
                let mesh = self.meshes.get(shape, file, scale, name, self.report)?;
                return Ok(mesh.map(Solid::Mesh));
            }
            other => {
                let why = "a shape is a box, sphere, cylinder, capsule, plane or mesh";
                let subject = format!("{name} {other}");
                self.report
                    .add(&shape.place(), subject, String::new(), Effect::Left, why);
                return Ok(None);
            }
        }))
    }

    /// Fixes the root where it is to be, and gives every other body a mass.
    fn settle_masses(&mut self) {
        if let Some(root) = self.bodies.first_mut() {
            let is_bare = root.inertia.mass <= 0.0;
            let is_world = root.name == "world";
            root.fixed = match self.options.base {
                Base::AsFile => is_world || is_bare,
                Base::Fixed => true,
                Base::Free => false,
            };
            if is_bare && !is_world && self.options.base == Base::AsFile {
                let why = "a root without mass is fixed";
                let subject = format!("link \"{}\"", root.name);
                let place = root.place.clone();
                (self.report).add(&place, subject, String::new(), Effect::Changed, why);
            }
        }
        let density = f64::from(self.options.density);
        settle_masses(&mut self.bodies, &self.joints, density, self.report);
        scale_masses(&mut self.bodies, &mut self.joints, self.report);
    }
}

/// The pose of an `origin`: displacement, then turns about the fixed axes x, y, z.
fn origin(element: &Element) -> Result<Pose, LoadError> {
    let position = element.vector("xyz")?.unwrap_or_default();
    let rpy = element.vector("rpy")?.unwrap_or_default();
    let rotation = DQuat::from_rotation_z(rpy.z)
        * DQuat::from_rotation_y(rpy.y)
        * DQuat::from_rotation_x(rpy.x);
    Ok(Pose::new(position, rotation.normalize()))
}

fn inertial(element: &Element) -> Result<Inertia, LoadError> {
    let pose = element.child("origin").map_or(Ok(Pose::IDENTITY), origin)?;
    let mass = element.needs_child("mass")?.needs_number("value")?;
    if mass < 0.0 {
        let name = element.title();
        let rule = "a mass is not negative";
        return Err(element.wrong(Problem::Senseless { name, rule }));
    }
    let tensor = match element.child("inertia") {
        None => DMat3::ZERO,
        Some(inertia) => {
            let part = |name| inertia.number(name).map(Option::unwrap_or_default);
            let (xy, xz, yz) = (part("ixy")?, part("ixz")?, part("iyz")?);
            DMat3::from_cols(
                DVec3::new(part("ixx")?, xy, xz),
                DVec3::new(xy, part("iyy")?, yz),
                DVec3::new(xz, yz, part("izz")?),
            )
        }
    };
    let centre = DVec3::ZERO;
    let own = Inertia {
        mass,
        centre,
        tensor,
    };
    Ok(own.moved(&pose))
}

/// The direction of a joint's axis: x without one, and of unit length.
fn axis(element: &Element) -> Result<DVec3, LoadError> {
    let Some(axis) = element.child("axis") else {
        return Ok(DVec3::X);
    };
    let along = axis.vector("xyz")?.unwrap_or(DVec3::X);
    let length = along.length();
    if length < 1e-9 {
        let name = format!("axis of {}", element.title());
        let rule = "an axis of no length has no direction";
        return Err(axis.wrong(Problem::Senseless { name, rule }));
    }
    Ok(along / length)
}

/// Motion in the plane whose normal is x, and the turn about it.
fn plane() -> JointKind {
    let [x, _, _, _, y_turn, z_turn] = LockedAxes::EACH;
    JointKind::Generic(x | y_turn | z_turn, [None; 6])
}

#[cfg(test)]
mod tests;
