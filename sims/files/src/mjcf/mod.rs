//! MJCF: bodies inside each other, with geoms, joints, default classes.
//!
//! Bodies without joints become part of the one that holds them, or of the world. Geoms of the world are fixed bodies.
//! Parts of the format beyond bodies, joints, shapes and their contacts are noted.

mod classes;
mod geoms;
mod joints;

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DVec3};
use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::{CollisionGroups, JointKind};

use classes::{Classes, Compiler, InertiaFrom, expand, truth};
use geoms::{Assets, Bits, Rules, groups, note_settings};
use joints::{Hinge, connect};

use crate::files::Files;
use crate::inertia::{Inertia, Pose};
use crate::model::{
    LoadOptions, Model, ModelBody, ModelJoint, OwnContacts, Placed, Solid, add_armatures,
    bound_masses, scale_masses, settle_masses,
};
use crate::report::{Effect, LoadError, Place, Problem, Report};
use crate::xml::Element;

/// Elements after replication.
const ELEMENTS_MAX: usize = 500_000;
/// Bodies inside each other.
const DEPTH_MAX: usize = 200;

/// Reads a world.
pub(crate) fn read(
    root: Element,
    files: &dyn Files,
    options: &LoadOptions,
    report: &mut Report,
) -> Result<Model, LoadError> {
    let main = root.place();
    let root = expand(root, files, &main.file)?;
    let mut reader = Reader {
        compiler: Compiler::read(&root)?,
        classes: Classes::read(&root)?,
        assets: Assets::default(),
        report,
        model: Model {
            name: root.text("model").unwrap_or("world").to_owned(),
            gravity: DVec3::new(0.0, 0.0, -9.81),
            step: Some(0.002),
            bodies: Vec::new(),
            joints: Vec::new(),
        },
        without_contacts: false,
        without_gravity: false,
        bits: Vec::new(),
        names: BTreeMap::new(),
        anchor: None,
        apart: BTreeSet::new(),
        elements: 0,
        depth: 0,
    };
    reader.sections(&root)?;
    if reader.without_gravity {
        reader.model.gravity = DVec3::ZERO;
    }
    let rules = Rules {
        classes: &reader.classes,
        compiler: &reader.compiler,
        main: &main,
    };
    reader.assets = Assets::read(&root, files, options, &rules, reader.report)?;
    for element in root.each("worldbody") {
        let mut all = Vec::new();
        reader.flatten(element, Pose::IDENTITY, None, &mut all)?;
        reader.parts(&all, element, None)?;
        reader.bodies(&all, None)?;
    }
    let Model { bodies, joints, .. } = &mut reader.model;
    settle_masses(bodies, joints, f64::from(options.density), reader.report);
    let Compiler {
        bounds, total_mass, ..
    } = reader.compiler;
    bound_masses(bodies, bounds, total_mass);
    scale_masses(bodies, joints, reader.report);
    add_armatures(bodies, joints, reader.report);
    let excluded = reader.excluded(&root)?;
    reader.equalities(&root)?;
    if options.own_contacts == OwnContacts::AsFile {
        let groups = groups(&reader.bits, &excluded, &main, reader.report);
        for (body, groups) in reader.model.bodies.iter_mut().zip(groups) {
            body.groups = groups;
        }
    }
    Ok(reader.model)
}

/// The body that holds what is read, and the frame of the element around it.
#[derive(Clone, Copy)]
struct Held {
    /// `None`: the world.
    body: Option<usize>,
    /// In the file's world.
    frame: Pose,
}

struct Reader<'a> {
    compiler: Compiler,
    classes: Classes,
    assets: Assets,
    report: &'a mut Report,
    model: Model,
    /// True if a flag of the options says so.
    without_contacts: bool,
    without_gravity: bool,
    /// Of each body of the model.
    bits: Vec<Bits>,
    /// Body of each name, and its frame in the file's world.
    names: BTreeMap<String, Held>,
    /// A body without shape to which joints of the world are made.
    anchor: Option<usize>,
    /// Pairs that a chain of joints connects.
    apart: BTreeSet<(usize, usize)>,
    elements: usize,
    depth: usize,
}

/// An element of a body, with the frame and class that frames around it give.
struct Inner<'a> {
    element: &'a Element,
    frame: Pose,
    class: Option<&'a str>,
    /// Number of the copy, for names.
    copy: usize,
}

impl Reader<'_> {
    /// Options, and notes on sections that a scene has nothing for.
    fn sections(&mut self, root: &Element) -> Result<(), LoadError> {
        for section in &root.children {
            match section.name.as_str() {
                "compiler" | "default" | "worldbody" | "asset" | "contact" | "equality" => {}
                "size" | "visual" | "statistic" => {}
                "option" => self.option(section)?,
                name => {
                    for element in &section.children {
                        let why = "a scene has no such thing";
                        let subject = format!("{name} {}", element.name);
                        self.report
                            .again(&element.place(), subject, Effect::Left, why);
                    }
                }
            }
        }
        Ok(())
    }

    fn option(&mut self, element: &Element) -> Result<(), LoadError> {
        if let Some(gravity) = element.vector("gravity")? {
            self.model.gravity = gravity;
        }
        self.model.step = element.number("timestep")?.or(self.model.step);
        for flag in element.each("flag") {
            for (name, value) in &flag.attributes {
                match (name.as_str(), value.as_str()) {
                    ("contact", value) => self.without_contacts = value == "disable",
                    ("gravity", value) => self.without_gravity = value == "disable",
                    _ => {
                        let why = "the scene's engine has settings of its own";
                        let subject = format!("flag {name}");
                        self.report.again(&flag.place(), subject, Effect::Left, why);
                    }
                }
            }
        }
        for (name, _) in &element.attributes {
            if !matches!(name.as_str(), "gravity" | "timestep") {
                let why = "the scene's engine has settings of its own";
                self.report.again(
                    &element.place(),
                    format!("option {name}"),
                    Effect::Left,
                    why,
                );
            }
        }
        Ok(())
    }

    /// All elements of a body, those of its frames and copies among them.
    fn flatten<'b>(
        &mut self,
        element: &'b Element,
        frame: Pose,
        class: Option<&'b str>,
        out: &mut Vec<Inner<'b>>,
    ) -> Result<(), LoadError> {
        for child in &element.children {
            match child.name.as_str() {
                "frame" => {
                    let frame = frame.of(&self.compiler.pose(child)?);
                    let class = child.text("childclass").or(class);
                    self.flatten(child, frame, class, out)?;
                }
                "replicate" => {
                    let count = child.needs_number("count")?;
                    let offset = child.vector("offset")?.unwrap_or_default();
                    let euler = child.vector("euler")?.unwrap_or_default();
                    let mut turn = child.with(Vec::new());
                    turn.attributes.retain(|(name, _)| name == "euler");
                    let step = Pose::new(offset, self.compiler.pose(&turn)?.rotation);
                    if !(0.0..=ELEMENTS_MAX as f64).contains(&count) {
                        return Err(too_many(child, count.clamp(0.0, 1e18) as usize));
                    }
                    let mut at = Pose::IDENTITY;
                    for copy in 0..count as usize {
                        let before = out.len();
                        self.flatten(child, frame.of(&at), class, out)?;
                        out[before..].iter_mut().for_each(|inner| inner.copy = copy);
                        // The offset is along the axes of the first copy, the turns add up.
                        let position = at.position + offset;
                        let rotation = (at.rotation * step.rotation).normalize();
                        at = match euler == DVec3::ZERO {
                            true => Pose::new(position, rotation),
                            false => Pose::new(at.rotation * offset + at.position, rotation),
                        };
                    }
                }
                _ => {
                    self.elements += 1;
                    if self.elements > ELEMENTS_MAX {
                        return Err(too_many(child, self.elements));
                    }
                    let copy = 0;
                    out.push(Inner {
                        element: child,
                        frame,
                        class,
                        copy,
                    });
                }
            }
        }
        Ok(())
    }

    /// Reads the bodies among the elements of a body or the world.
    fn bodies(&mut self, all: &[Inner<'_>], holding: Option<usize>) -> Result<(), LoadError> {
        let bodies = all.iter().filter(|inner| inner.element.name == "body");
        bodies
            .into_iter()
            .try_for_each(|inner| self.body(inner, holding))
    }

    /// Reads geoms and inertia among the elements of a body or the world.
    fn parts(
        &mut self,
        all: &[Inner<'_>],
        holder: &Element,
        body: Option<usize>,
    ) -> Result<(), LoadError> {
        let from_geoms = match self.compiler.inertia {
            InertiaFrom::Geoms => true,
            InertiaFrom::Inertial => false,
            InertiaFrom::Either => holder.child("inertial").is_none(),
        };
        for inner in all {
            match inner.element.name.as_str() {
                "geom" => self.geom(inner, body, from_geoms)?,
                "inertial" if self.compiler.inertia != InertiaFrom::Geoms => {
                    let inertia = self.inertial(inner)?;
                    self.add_inertia(body, &inertia);
                }
                "body" | "joint" | "freejoint" | "inertial" => {}
                name => {
                    let why = "a body has no such thing";
                    let place = inner.element.place();
                    self.report
                        .again(&place, name.to_owned(), Effect::Left, why);
                }
            }
        }
        Ok(())
    }

    fn body(&mut self, inner: &Inner<'_>, holding: Option<usize>) -> Result<(), LoadError> {
        let element = inner.element;
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(element.wrong(Problem::TooMany {
                what: "bodies inside each other",
                found: self.depth,
                most: DEPTH_MAX,
            }));
        }
        let class = element.text("childclass").or(inner.class);
        let frame = inner.frame.of(&self.compiler.pose(element)?);
        let hinges = self.hinges(element, class, &frame)?;
        let is_held = !hinges.is_empty() && !hinges.iter().any(Hinge::is_free);
        let holder = match (is_held, holding) {
            (false, _) => None,
            (true, Some(holder)) => Some(holder),
            (true, None) => Some(self.world_anchor(&element.place())?),
        };
        let own = match hinges.is_empty() {
            true => None,
            false => Some(self.push(element, inner.copy, frame, false)?),
        };
        let mut all = Vec::new();
        self.flatten(element, frame, class, &mut all)?;
        self.parts(&all, element, own.or(holding))?;
        let now = match (holder, own) {
            (Some(holder), Some(own)) => Some(self.join(holder, own, &hinges, holding.is_none())),
            (_, own) => own,
        };
        let body = now.or(holding);
        if let Some(name) = element.text("name") {
            self.names.insert(name.to_owned(), Held { body, frame });
        }
        self.bodies(&all, body)?;
        self.depth -= 1;
        Ok(())
    }

    fn hinges(
        &mut self,
        element: &Element,
        class: Option<&str>,
        frame: &Pose,
    ) -> Result<Vec<Hinge>, LoadError> {
        if truth(element, "mocap")? == Some(true) {
            let why = "a body that a program moves is fixed here: a command can make it kinematic";
            let place = element.place();
            self.report
                .add(&place, element.title(), String::new(), Effect::Changed, why);
        }
        let mut hinges = Vec::new();
        for joint in &element.children {
            if matches!(joint.name.as_str(), "joint" | "freejoint") {
                let joint = self.classes.apply(joint, class)?;
                hinges.push(Hinge::read(joint, &self.compiler, frame, self.report)?);
            }
        }
        Ok(hinges)
    }

    /// Adds the joints of the newest body; returns its place, which a chain changes.
    fn join(&mut self, holder: usize, own: usize, hinges: &[Hinge], collide: bool) -> usize {
        connect(&mut self.model, [holder, own], hinges, collide, self.report);
        let now = self.model.bodies.len() - 1;
        if now != own {
            self.bits.resize(now + 1, Bits::default());
            self.bits.swap(own, now);
            if !collide {
                self.apart.insert((holder, now));
            }
        }
        now
    }

    /// A body of an element.
    fn push(
        &mut self,
        element: &Element,
        copy: usize,
        pose: Pose,
        fixed: bool,
    ) -> Result<usize, LoadError> {
        let place = self.model.bodies.len();
        if place >= BODIES_MAX as usize {
            return Err(too_many(element, place + 1));
        }
        let name = element.text("name").map_or_else(
            || format!("{} {place}", element.name),
            |name| match copy {
                0 => name.to_owned(),
                copy => format!("{name} {copy}"),
            },
        );
        self.model.bodies.push(ModelBody {
            name,
            place: element.place(),
            pose,
            fixed,
            inertia: Inertia::NONE,
            solids: Vec::new(),
            groups: CollisionGroups::ALL,
            friction: None,
        });
        self.bits.resize(place + 1, Bits::default());
        Ok(place)
    }

    /// The fixed body without a shape to which joints of the world are made.
    fn world_anchor(&mut self, place: &Place) -> Result<usize, LoadError> {
        if let Some(anchor) = self.anchor {
            return Ok(anchor);
        }
        let world = Element::named("world", place);
        let anchor = self.push(&world, 0, Pose::IDENTITY, true)?;
        self.anchor = Some(anchor);
        Ok(anchor)
    }

    fn inertial(&self, inner: &Inner<'_>) -> Result<Inertia, LoadError> {
        let element = inner.element;
        let mass = element.needs_number("mass")?;
        let tensor = match element.array::<6>("fullinertia", "6")? {
            Some([xx, yy, zz, xy, xz, yz]) => DMat3::from_cols(
                DVec3::new(xx, xy, xz),
                DVec3::new(xy, yy, yz),
                DVec3::new(xz, yz, zz),
            ),
            None => DMat3::from_diagonal(element.vector("diaginertia")?.unwrap_or_default()),
        };
        if mass < 0.0 {
            let name = element.title();
            let rule = "a mass is not negative";
            return Err(element.wrong(Problem::Senseless { name, rule }));
        }
        let own = Inertia {
            mass,
            centre: DVec3::ZERO,
            tensor,
        };
        Ok(own.moved(&inner.frame.of(&self.compiler.pose(element)?)))
    }

    /// Adds a mass, given in the file's world, to a body; the world needs none.
    fn add_inertia(&mut self, body: Option<usize>, inertia: &Inertia) {
        if let Some(body) = body {
            let body = &mut self.model.bodies[body];
            let inertia = inertia.moved(&body.pose.inverse());
            body.inertia = body.inertia.plus(&inertia);
        }
    }

    fn geom(
        &mut self,
        inner: &Inner<'_>,
        body: Option<usize>,
        from_geoms: bool,
    ) -> Result<(), LoadError> {
        let element = self.classes.apply(inner.element, inner.class)?;
        note_settings(&element, self.report);
        let Some((solid, pose)) = self.assets.solid(&element, &self.compiler, self.report)? else {
            return Ok(());
        };
        let pose = inner.frame.of(&pose);
        let [least, most] = self.compiler.groups;
        let group = element.number("group")?.unwrap_or(0.0);
        if from_geoms && body.is_some() && (least..=most).contains(&group) {
            let density = element.number("density")?.unwrap_or(1_000.0);
            let given = element.number("mass")?;
            let own = solid.inertia(if given.is_some() { 1.0 } else { density });
            let own = own.map(|own| given.map_or(own, |mass| own.times(mass / own.mass)));
            if let Some(own) = own.filter(|own| own.mass.is_finite()) {
                self.add_inertia(body, &own.moved(&pose));
            }
        }
        let bit = |name| -> Result<u32, LoadError> {
            Ok(element.number(name)?.unwrap_or(1.0) as i64 as u32)
        };
        let bits = match self.without_contacts {
            true => Bits::default(),
            false => Bits {
                contype: bit("contype")?,
                conaffinity: bit("conaffinity")?,
            },
        };
        if bits == Bits::default() {
            let why = "a geom that touches nothing is about drawing alone, but for its mass";
            self.report
                .again(&element.place(), "geom".to_owned(), Effect::Left, why);
            return Ok(());
        }
        self.place_solid(&element, inner, body, (solid, pose), bits)
    }

    /// Adds a solid to its body, or to the world as a fixed body.
    fn place_solid(
        &mut self,
        element: &Element,
        inner: &Inner<'_>,
        body: Option<usize>,
        (solid, pose): (Solid, Pose),
        bits: Bits,
    ) -> Result<(), LoadError> {
        let name = element.title();
        let friction = element.numbers("friction")?.unwrap_or_default();
        let friction = friction.first().copied().unwrap_or(1.0);
        let body = match body {
            Some(body) => body,
            None => self.push(element, inner.copy, pose, true)?,
        };
        let all = &mut self.bits[body];
        if *all != bits && *all != Bits::default() {
            let why = "contact bits are those of a body: of its geoms together";
            let subject = "geom contype and conaffinity".to_owned();
            self.report
                .again(&element.place(), subject, Effect::Approximated, why);
        }
        all.contype |= bits.contype;
        all.conaffinity |= bits.conaffinity;
        let own = &mut self.model.bodies[body];
        own.friction = Some(own.friction.map_or(friction, |other| other.max(friction)));
        let pose = own.pose.inverse().of(&pose);
        own.solids.push(Placed { pose, solid, name });
        Ok(())
    }

    fn named(&self, element: &Element, attribute: &'static str) -> Result<Held, LoadError> {
        let name = element.needs(attribute)?;
        if name == "world" {
            let (body, frame) = (None, Pose::IDENTITY);
            return Ok(Held { body, frame });
        }
        self.names.get(name).copied().ok_or_else(|| {
            let (what, name) = ("body", name.to_owned());
            element.wrong(Problem::UnknownName { what, name })
        })
    }

    /// Pairs of bodies that do not touch, the lower place first.
    fn excluded(&mut self, root: &Element) -> Result<BTreeSet<(usize, usize)>, LoadError> {
        let mut pairs = std::mem::take(&mut self.apart);
        for element in root.each("contact").flat_map(|contact| &contact.children) {
            if element.name != "exclude" {
                let why = "bodies touch by groups, not by pairs";
                let subject = format!("contact {}", element.name);
                self.report
                    .again(&element.place(), subject, Effect::Left, why);
                continue;
            }
            let ends = [
                self.named(element, "body1")?.body,
                self.named(element, "body2")?.body,
            ];
            if let [Some(a), Some(b)] = ends
                && a != b
            {
                pairs.insert((a.min(b), a.max(b)));
            }
        }
        Ok(pairs)
    }

    fn equalities(&mut self, root: &Element) -> Result<(), LoadError> {
        for element in root.each("equality").flat_map(|all| &all.children) {
            let whole = self.classes.apply(&element.renamed("equality"), None)?;
            let is_on = truth(element, "active")?.or(truth(&whole, "active")?) != Some(false);
            let names = element.text("body1").is_some();
            let kind = match element.name.as_str() {
                "connect" if is_on && names => JointKind::Spherical(None),
                "weld" if is_on && names => JointKind::Fixed,
                name => {
                    let why =
                        "joints close loops between bodies by connect and weld that are active";
                    let subject = format!("equality {name}");
                    self.report
                        .again(&element.place(), subject, Effect::Left, why);
                    continue;
                }
            };
            self.loop_joint(element, kind)?;
        }
        Ok(())
    }

    fn loop_joint(&mut self, element: &Element, kind: JointKind) -> Result<(), LoadError> {
        let first = self.named(element, "body1")?;
        let second = match element.text("body2") {
            Some(_) => self.named(element, "body2")?.body,
            None => None,
        };
        let mut bodies = [0; 2];
        for (place, body) in bodies.iter_mut().zip([first.body, second]) {
            *place = match body {
                Some(body) => body,
                None => self.world_anchor(&element.place())?,
            };
        }
        if bodies[0] == bodies[1] {
            return Ok(());
        }
        if element.text("relpose").is_some() {
            let why = "bodies are welded as they start";
            let subject = "weld relpose".to_owned();
            self.report
                .again(&element.place(), subject, Effect::Approximated, why);
        }
        let anchor = element.vector("anchor")?.unwrap_or_default();
        self.model.joints.push(ModelJoint {
            name: element.text("name").unwrap_or("equality").to_owned(),
            place: element.place(),
            bodies,
            frame: first.frame.of(&Pose::at(anchor)),
            kind,
            drives: [None; 6],
            collide: true,
            holds: false,
        });
        Ok(())
    }
}

fn too_many(element: &Element, found: usize) -> LoadError {
    element.wrong(Problem::TooMany {
        what: "elements and bodies after replication",
        found,
        most: BODIES_MAX as usize,
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rhumb_protocol::scene::{BodyKind, JointKind, Shape, ShapeId};
    use rhumb_reckoning::BodyId;

    use crate::assemble::LoadedScene;
    use crate::files::MemoryFiles;
    use crate::load::{load, load_text};
    use crate::model::LoadOptions;
    use crate::report::{Effect, LoadError};

    fn read(inside: &str) -> Result<LoadedScene, LoadError> {
        let text = format!("<mujoco model='m'>\n{inside}</mujoco>");
        load_text(
            &MemoryFiles::default(),
            "m.xml",
            &text,
            &LoadOptions::default(),
        )
    }

    fn mass(scene: &LoadedScene, body: usize) -> f32 {
        let desc = scene.bodies[body]
            .builder
            .desc(BodyId::new(0, 0), ShapeId(0));
        desc.mass.map_or(0.0, |mass| mass.mass)
    }

    #[test]
    fn classes_and_angles_reach_the_bodies() {
        let scene = read(
            "<compiler angle='radian' eulerseq='zyx'/><option gravity='0 0 -1' timestep='0.005'/>
            <default><geom density='500'/><default class='thin'><geom type='capsule' size='0.1 0.5'/></default></default>
            <worldbody><geom type='plane' size='1 1 1'/>
              <body name='b' pos='0 0 2' euler='1.5707963267948966 0 0' childclass='thin'><freejoint/><geom/></body>
            </worldbody>",
        )
        .expect("a world");
        assert_eq!(scene.config.gravity, Vec3::new(0.0, 0.0, -1.0));
        assert_eq!(scene.config.integrator.rate.ticks(), 200);
        assert_eq!(scene.bodies[0].builder.kind(), BodyKind::Fixed);
        assert!(matches!(
            scene.bodies[0].builder.shape(),
            Shape::HalfSpace { .. }
        ));
        assert!(
            (mass(&scene, 1) - 17.802_36).abs() < 1e-4,
            "{}",
            mass(&scene, 1)
        );
        let [x, y, z, qx, qy, qz, ..] = scene.bodies[1].builder.state().expect("sound").parts();
        assert_eq!([x, y, z, qx, qy], [0.0, 0.0, 2.0, 0.0, 0.0]);
        assert!((qz - 0.5_f32.sqrt()).abs() < 1e-6);
        assert!(scene.report.is_empty(), "{:?}", scene.report);
    }

    #[test]
    fn flags_of_the_options_hold() {
        let world = "<worldbody><geom size='1 1 1' type='box'/><body name='b'><freejoint/><geom size='1'/></body></worldbody>";
        let off = "<option><flag contact='disable' gravity='disable' energy='enable'/></option>";
        let scene = read(&format!("{world}{off}")).expect("a world");
        assert_eq!(scene.config.gravity, Vec3::ZERO);
        let solids = |shape: &Shape| match shape {
            Shape::Compound(compound) => compound.parts().len(),
            _ => 1,
        };
        let left = scene.bodies.iter();
        assert_eq!(left.map(|body| solids(body.builder.shape())).max(), Some(0));
        assert!(mass(&scene, scene.bodies.len() - 1) > 4_000.0);
        let subjects: Vec<_> = scene
            .report
            .notes()
            .iter()
            .map(|note| note.subject.as_str())
            .collect();
        assert_eq!(subjects, ["flag energy", "geom"]);
        let on =
            read(&format!("<option><flag contact='enable'/></option>{world}")).expect("a world");
        assert!(on.report.is_empty() && on.config.gravity.z < -9.0 && on.bodies.len() == 2);
    }

    #[test]
    fn a_passive_joint_pushes_no_more_than_its_spring_and_its_damping_can() {
        let body =
            |joint: &str| format!("<worldbody><body>{joint}<geom size='0.1'/></body></worldbody>");
        for (joint, most) in [
            (
                "<joint stiffness='3' damping='0.5' range='-90 60'/>",
                3.0 * std::f32::consts::FRAC_PI_2 + 5.0,
            ),
            (
                "<joint stiffness='3' springref='45' range='-90 60'/>",
                3.0 * std::f32::consts::FRAC_PI_4 * 3.0,
            ),
            ("<joint damping='0.5'/>", 5.0),
            ("<joint type='slide' stiffness='20' range='-0.5 2'/>", 40.0),
        ] {
            let scene = read(&body(joint)).expect("a world");
            let motors = scene.joints[0].joint.motors;
            let force = motors
                .iter()
                .flatten()
                .map(|motor| motor.force)
                .next()
                .expect("a motor");
            assert!(
                (force - most).abs() < 1e-3 * most,
                "{joint}: {force} N or N m, not {most}"
            );
        }
    }

    #[test]
    fn the_armature_of_a_joint_is_in_the_moments_of_the_body_that_it_turns() {
        let ball = 0.4 * 0.01;
        for (joint, moments, effect) in [
            (
                "<joint axis='0 1 0' armature='0.002'/>",
                [ball, ball + 0.002, ball],
                Some(Effect::Approximated),
            ),
            // No solid has a moment above the sum of the others.
            (
                "<joint axis='0 0 1' armature='1'/>",
                [0.5 + ball, 0.5 + ball, 1.0 + 2.0 * ball],
                Some(Effect::Approximated),
            ),
            (
                "<joint type='ball' armature='0.3'/>",
                [ball + 0.3; 3],
                Some(Effect::Approximated),
            ),
            (
                "<joint type='slide' armature='2'/>",
                [ball; 3],
                Some(Effect::Left),
            ),
            ("<joint armature='0'/>", [ball; 3], None),
        ] {
            let scene = read(&format!(
                "<worldbody><body>{joint}<geom size='0.1' mass='1'/></body></worldbody>"
            ));
            let scene = scene.expect("a world");
            let desc = scene.bodies[1].builder.desc(BodyId::new(0, 0), ShapeId(0));
            let own = desc.mass.and_then(|mass| mass.moments).expect("moments");
            let mut own = own.to_array().map(f64::from);
            own.sort_by(f64::total_cmp);
            let mut right = moments;
            right.sort_by(f64::total_cmp);
            for (own, right) in own.into_iter().zip(right) {
                assert!(
                    (own - right).abs() < 0.011 * right,
                    "{joint}: {own} {right}"
                );
            }
            let notes = scene.report.notes().iter();
            let note = notes.filter(|note| note.subject == "joint armature");
            let effects: Vec<_> = note.map(|note| note.effect).collect();
            assert_eq!(effects, Vec::from_iter(effect), "{joint}");
            assert!((desc.mass.expect("a mass").mass - 1.0).abs() < 1e-6);
            assert!(scene.joints[0].joint.motors.iter().all(Option::is_none));
        }
    }

    #[test]
    fn only_a_body_with_an_armature_has_its_moments_raised_and_says_so() {
        let inertial = "<inertial pos='0 0 0' mass='1' diaginertia='1 1 3'/>";
        for (armature, least, notes) in [("", 1.0, 0), ("armature='0.5'", 1.75, 1)] {
            let scene = read(&format!(
                "<compiler balanceinertia='false'/><worldbody><body>{inertial}<joint axis='0 0 1' {armature}/></body></worldbody>"
            ));
            let scene = scene.expect("a world");
            let desc = &scene.bodies.last().expect("a body").builder;
            let desc = desc.desc(BodyId::new(0, 0), ShapeId(0));
            let own = desc.mass.and_then(|mass| mass.moments).expect("moments");
            assert!(
                (own.min_element() - least).abs() < 1e-5,
                "{armature}: {own}"
            );
            let all = scene.report.notes().iter();
            let raised = all.filter(|note| note.subject == "moments with an armature");
            assert_eq!(raised.count(), notes, "{armature}");
        }
    }

    #[test]
    fn settings_of_a_joint_that_moves_freely_are_listed() {
        let scene = read(
            "<worldbody><body><joint type='free' armature='0.1' springdamper='1 1' damping='0' stiffness='2'/>\
             <geom size='0.1'/></body></worldbody>",
        );
        let scene = scene.expect("a world");
        let notes = scene.report.notes().iter();
        let left: Vec<_> = notes
            .map(|note| (note.subject.as_str(), note.effect))
            .collect();
        let all = ["armature", "springdamper", "stiffness"];
        let all = all.map(|name| format!("joint {name}"));
        let all: Vec<_> = all
            .iter()
            .map(|name| (name.as_str(), Effect::Left))
            .collect();
        assert_eq!(left, all);
    }

    #[test]
    fn a_fly_of_grams_and_small_steps_keeps_its_proportions() {
        let scene = read(
            "<option timestep='0.0001' gravity='0 0 -981'/><worldbody><body name='thorax'><freejoint/>\
             <geom size='0.1' mass='3e-4'/><body name='wing'><joint stiffness='0.5' damping='0.01' armature='1e-6'/>\
             <geom size='0.05' pos='0 0.1 0' mass='1e-6'/></body></body></worldbody>",
        );
        let scene = scene.expect("a world");
        let integrator = scene.config.integrator;
        assert_eq!(
            (integrator.rate.ticks(), integrator.substeps.get()),
            (1_000, 10)
        );
        assert!((mass(&scene, 0) - 0.3).abs() < 1e-6 && (mass(&scene, 1) - 1e-3).abs() < 1e-9);
        // A kilogram of the file has the same acceleration as before: of the wing and its rotor about the joint.
        let inertia = 1e-6 * (0.4 * 0.05 * 0.05 + 0.1 * 0.1) + 1e-6;
        let motor = scene.joints[0].joint.motors[3].expect("a spring");
        let right = 0.5 / inertia;
        let off = f64::from(motor.stiffness) / right - 1.0;
        assert!(off.abs() < 1e-3, "{motor:?} {right}");
        let subjects = scene
            .report
            .notes()
            .iter()
            .map(|note| note.subject.as_str());
        let subjects: Vec<_> = subjects.collect();
        assert!(
            subjects.contains(&"masses") && subjects.contains(&"step"),
            "{subjects:?}"
        );
    }

    #[test]
    fn a_mesh_as_thin_as_a_wing_is_a_box_and_a_thicker_one_a_hull() {
        for (thickness, is_box) in [(0.003, true), (0.01, false)] {
            let corner = |at: usize| {
                let [x, y, z] = [at & 1, at >> 1 & 1, at >> 2];
                format!("{x} {y} {} ", z as f64 * thickness)
            };
            let corners: String = (0..8).map(corner).collect();
            let scene = read(&format!(
                "<asset><mesh name='m' vertex='{corners}'/></asset>\
                 <worldbody><body><freejoint/><geom type='mesh' mesh='m'/></body></worldbody>"
            ));
            let scene = scene.expect("a world");
            let shape = match scene.bodies[0].builder.shape() {
                Shape::Compound(compound) => compound.parts()[0].shape.clone(),
                shape => shape.clone(),
            };
            assert_eq!(matches!(shape, Shape::Cuboid { .. }), is_box, "{shape:?}");
            assert_eq!(matches!(shape, Shape::Hull(_)), !is_box, "{shape:?}");
        }
    }

    #[test]
    fn a_spring_with_a_time_constant_has_it_whatever_the_body_weighs() {
        for size in ["0.1", "0.5"] {
            let scene = read(&format!(
                "<worldbody><body><joint springdamper='0.2 0.5' stiffness='7' range='-90 90'/>\
                 <geom size='{size}' pos='0 0.3 0'/></body></worldbody>"
            ));
            let scene = scene.expect("a world");
            let motor = scene.joints[0].joint.motors[3].expect("a spring");
            assert!((motor.stiffness - 100.0).abs() < 1e-2, "{motor:?}");
            assert!((motor.damping - 10.0).abs() < 1e-3, "{motor:?}");
            assert!(motor.force > 1.0, "{motor:?}");
        }
    }

    #[test]
    fn several_joints_of_a_body_are_one_or_a_chain_of_the_same_mass() {
        let body = |joints: &str| {
            format!("<worldbody><body>{joints}<geom size='0.1' mass='3'/></body></worldbody>")
        };
        let planar = "<joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 0 -1' range='0 2'/><joint axis='0 1 0'/>";
        let scene = read(&body(planar)).expect("a world");
        assert_eq!((scene.bodies.len(), scene.joints.len()), (2, 1));
        let JointKind::Generic(locked, limits) = scene.joints[0].joint.kind else {
            panic!("three free axes");
        };
        assert_eq!(locked.bits().count_ones(), 3);
        assert_eq!(limits.iter().flatten().count(), 1);
        let apart = "<joint axis='0 1 0'/><joint axis='1 0 0' pos='0 0 0.5'/>";
        let scene = read(&body(apart)).expect("a world");
        assert_eq!((scene.bodies.len(), scene.joints.len()), (3, 2));
        let sum = mass(&scene, 1) + mass(&scene, 2);
        assert!((sum - 3.0).abs() < 1e-6 && mass(&scene, 1) > 0.1);
        assert_eq!(scene.joints[1].bodies, [1, 2]);
    }

    #[test]
    fn an_included_robot_inside_a_body_is_not_lost_and_a_loop_is_named() {
        let mut files = MemoryFiles::default();
        files.insert("x/m.xml", "<mujoco><worldbody><body><joint/><geom size='1'/><include file='parts/arm.xml'/></body></worldbody></mujoco>");
        files.insert(
            "x/parts/arm.xml",
            "<mujocoinclude><body name='arm'><joint/><geom size='1'/></body></mujocoinclude>",
        );
        let scene = load(&files, "x/m.xml", &LoadOptions::default()).expect("a world");
        assert_eq!(scene.joints.len(), 2);
        assert_eq!(scene.bodies[2].name, "arm");
        files.insert(
            "x/parts/arm.xml",
            "<mujocoinclude>\n<include file='m.xml'/></mujocoinclude>",
        );
        let error = load(&files, "x/m.xml", &LoadOptions::default()).expect_err("a loop");
        assert_eq!(
            error.to_string(),
            "x/parts/arm.xml:2: x/m.xml includes itself"
        );
        files.insert(
            "x/parts/arm.xml",
            "<mujocoinclude><include file='arm.xml'/></mujocoinclude>",
        );
        let error = load(&files, "x/m.xml", &LoadOptions::default()).expect_err("a missing file");
        assert!(error.to_string().contains("includes itself"), "{error}");
    }

    #[test]
    fn ten_million_bodies_by_replication_are_refused_at_once() {
        let ball = "<body><freejoint/><geom size='0.1'/></body>";
        let inner = format!("<replicate count='3000' offset='1 0 0'>{ball}</replicate>");
        let nested = format!(
            "<worldbody>\n<replicate count='3400' offset='0 1 0'>{inner}</replicate></worldbody>"
        );
        for (text, line) in [
            (nested, 3),
            (
                format!(
                    "<worldbody><replicate count='1e8' offset='1 0 0'>{ball}</replicate></worldbody>"
                ),
                2,
            ),
        ] {
            let sentence = read(&text).expect_err("too many").to_string();
            assert!(
                sentence.starts_with(&format!("m.xml:{line}:")),
                "{sentence}"
            );
            assert!(sentence.contains("replication"), "{sentence}");
        }
        let few = format!(
            "<worldbody><replicate count='4' offset='1 0 0'>{ball}</replicate></worldbody>"
        );
        assert_eq!(read(&few).expect("four").bodies.len(), 4);
    }

    #[test]
    fn wrong_files_are_refused_where_they_are_wrong() {
        for (inside, word) in [
            (
                "<worldbody><geom size='nan'/></worldbody>",
                "must be a number",
            ),
            (
                "<worldbody><geom type='box' size='1 1'/></worldbody>",
                "must have 3",
            ),
            (
                "<worldbody><geom type='ball' size='1'/></worldbody>",
                "stands for nothing",
            ),
            (
                "<worldbody><geom class='x' size='1'/></worldbody>",
                "no default class \"x\"",
            ),
            (
                "<worldbody><geom type='mesh' mesh='x'/></worldbody>",
                "no mesh \"x\"",
            ),
            (
                "<worldbody><geom type='capsule' size='1' fromto='0 0 0 0 0 0'/></worldbody>",
                "two different",
            ),
            (
                "<worldbody><body quat='0 0 0 0'/></worldbody>",
                "no orientation",
            ),
            (
                "<worldbody/><contact><exclude body1='a' body2='b'/></contact>",
                "no body \"a\"",
            ),
            (
                "<asset><mesh name='m' vertex='0 0 0 1'/></asset>",
                "at least 12",
            ),
            (
                "<asset><mesh name='m' vertex='0 0 0 1 0 0 0 1 0 0 0 1' face='0 1 9'/></asset>",
                "face",
            ),
        ] {
            let sentence = read(inside).expect_err(inside).to_string();
            assert!(
                sentence.starts_with("m.xml:2:") && sentence.contains(word),
                "{sentence}"
            );
        }
        let deep = format!(
            "<worldbody>{}{}</worldbody>",
            "<body>".repeat(190),
            "</body>".repeat(190)
        );
        assert!(read(&deep).is_ok());
        let joints = "<body><joint type='free'/><geom size='1'/></body>";
        let scene = read(&format!(
            "<worldbody>{joints}</worldbody><tendon><spatial/></tendon>"
        ));
        assert_eq!(
            scene.expect("a world").report.notes()[0].subject,
            "tendon spatial"
        );
    }
}
