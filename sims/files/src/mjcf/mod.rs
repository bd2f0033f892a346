//! MJCF: bodies inside each other, with geoms, joints, default classes.
//!
//! Bodies without joints become part of the one that holds them, or of the world. Geoms of the world are fixed bodies.
//! Parts of the format beyond bodies, joints, shapes and their contacts are noted.

mod classes;
mod contacts;
mod geoms;
mod joints;

use std::collections::BTreeSet;
use std::rc::Rc;

use glam::{DMat3, DVec3};
use rhumb_protocol::limits::BODIES_MAX;
use rhumb_protocol::scene::{CollisionGroups, JointKind};

use classes::{Classes, Compiler, InertiaFrom, expand, truth};
use classes::{CopyOf, Held, Names, Work};
use contacts::{Bits, Excluded, Parts, groups};
use geoms::{Assets, Rules, note_settings};
use joints::{Hinge, connect};

use crate::files::Files;
use crate::inertia::{Inertia, Pose};
use crate::model::{
    FileUp, LoadOptions, Model, ModelBody, ModelJoint, OwnContacts, Placed, Solid, add_armatures,
    bound_masses, scale_masses, settle_masses,
};
use crate::report::{Effect, LoadError, Place, Problem, Report};
use crate::xml::Element;

/// Bodies inside each other.
const DEPTH_MAX: usize = 200;

/// Why an attribute is left out that nothing here knows.
const UNREAD: &str = "the format has no such attribute, or it is not read";

/// Attributes of a pose.
const POSE: [&str; 6] = ["pos", "quat", "axisangle", "xyaxes", "zaxis", "euler"];

/// Settings of the compiler that are read, or that say nothing of physics.
const COMPILER: [&str; 19] = [
    "angle",
    "coordinate",
    "eulerseq",
    "autolimits",
    "strippath",
    "meshdir",
    "assetdir",
    "texturedir",
    "inertiafromgeom",
    "inertiagrouprange",
    "settotalmass",
    "boundmass",
    "boundinertia",
    "balanceinertia",
    "discardvisual",
    "convexhull",
    "fusestatic",
    "usethread",
    "saveinertial",
];

/// Reads a world.
pub(crate) fn read(
    root: Element,
    files: &dyn Files,
    options: &LoadOptions,
    report: &mut Report,
) -> Result<Model, LoadError> {
    let main = root.place();
    let mut work = Work::default();
    let root = expand(root, files, &main.file, &mut work)?;
    let mut reader = Reader::new(&root, report, work)?;
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
        let world = Inner {
            element,
            frame: Pose::IDENTITY,
            class: None,
            copy: Rc::default(),
        };
        reader.flatten(&world, &mut all)?;
        reader.part = 0;
        reader.parts(&all, None)?;
        reader.bodies(&all, None)?;
    }
    reader.note_pairs(&root);
    reader.settle(options);
    let excluded = reader.excluded(&root)?;
    reader.name_geoms();
    reader.equalities(&root)?;
    if options.own_contacts == OwnContacts::AsFile {
        let groups = groups(&reader.bits, &excluded, &main, reader.report);
        for (body, groups) in reader.model.bodies.iter_mut().zip(groups) {
            body.groups = groups;
        }
    }
    Ok(reader.model)
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
    names: Names,
    /// A body without shape to which joints of the world are made.
    anchor: Option<usize>,
    parts: Parts,
    /// The number of the file's body whose geoms are read.
    part: usize,
    work: Work,
    depth: usize,
}

/// An element of a body, with the frame and class that frames around it give.
struct Inner<'a> {
    element: &'a Element,
    frame: Pose,
    class: Option<&'a str>,
    copy: Rc<CopyOf>,
}

impl<'a> Reader<'a> {
    /// A reader of a world that has read nothing but its classes and the compiler's settings.
    fn new(root: &Element, report: &'a mut Report, mut work: Work) -> Result<Self, LoadError> {
        Ok(Self {
            compiler: Compiler::read(root)?,
            classes: Classes::read(root, &mut work)?,
            assets: Assets::default(),
            report,
            model: Model {
                name: root.text("model").unwrap_or("world").to_owned(),
                up: FileUp::Z,
                gravity: DVec3::new(0.0, 0.0, -9.81),
                step: Some(0.002),
                bodies: Vec::new(),
                joints: Vec::new(),
            },
            without_contacts: false,
            without_gravity: false,
            bits: Vec::new(),
            names: Names::default(),
            anchor: None,
            parts: Parts::default(),
            part: 0,
            work,
            depth: 0,
        })
    }
}

impl Reader<'_> {
    /// Options, and notes on sections that a scene has nothing for.
    fn sections(&mut self, root: &Element) -> Result<(), LoadError> {
        const EMPTY: [&str; 6] = [
            "actuator",
            "sensor",
            "tendon",
            "keyframe",
            "custom",
            "extension",
        ];
        for section in &root.children {
            match section.name.as_str() {
                "default" | "worldbody" | "asset" | "contact" | "equality" => {}
                "size" | "visual" | "statistic" => {}
                "compiler" => section.note_unread(&[&COMPILER], UNREAD, self.report),
                "option" => self.option(section)?,
                name if section.children.is_empty() && !EMPTY.contains(&name) => {
                    let why = "the format has no such section, or it is not read";
                    let place = section.place();
                    self.report
                        .again(&place, name.to_owned(), Effect::Left, why);
                }
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

    /// Masses and moments that every body can have.
    fn settle(&mut self, options: &LoadOptions) {
        let Model { bodies, joints, .. } = &mut self.model;
        settle_masses(bodies, joints, f64::from(options.density), self.report);
        bound_masses(bodies, self.compiler.bounds, self.compiler.total_mass);
        scale_masses(bodies, joints, self.report);
        add_armatures(bodies, joints, self.report);
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
        around: &Inner<'b>,
        out: &mut Vec<Inner<'b>>,
    ) -> Result<(), LoadError> {
        for element in &around.element.children {
            let class = element.text("childclass").or(around.class);
            let bytes = self.classes.bytes_of(element, around.class);
            self.work.add(element, bytes + around.copy.bytes())?;
            let (frame, copy) = (around.frame, around.copy.clone());
            match element.name.as_str() {
                "frame" => {
                    let known = [POSE.as_slice(), &["name", "childclass"]];
                    element.note_unread(&known, UNREAD, self.report);
                    let frame = frame.of(&self.compiler.pose(element)?);
                    let inner = Inner {
                        element,
                        frame,
                        class,
                        copy,
                    };
                    self.flatten(&inner, out)?;
                }
                "replicate" => self.replicate(element, around, out)?,
                _ => out.push(Inner {
                    element,
                    frame,
                    class: around.class,
                    copy,
                }),
            }
        }
        Ok(())
    }

    /// All elements of the copies that an element makes of those inside.
    fn replicate<'b>(
        &mut self,
        element: &'b Element,
        around: &Inner<'b>,
        out: &mut Vec<Inner<'b>>,
    ) -> Result<(), LoadError> {
        let count = element.needs_number("count")?.max(0.0) as usize;
        let offset = element.vector("offset")?.unwrap_or_default();
        let euler = element.vector("euler")?.unwrap_or_default();
        let mut turn = element.with(Vec::new());
        turn.attributes.retain(|(name, _)| name == "euler");
        let step = self.compiler.pose(&turn)?.rotation;
        let mut at = Pose::IDENTITY;
        for number in 0..count {
            let copy = around.copy.within(element, number, count);
            self.work.add(element, copy.bytes())?;
            let inner = Inner {
                element,
                frame: around.frame.of(&at),
                class: around.class,
                copy: Rc::new(copy),
            };
            self.flatten(&inner, out)?;
            // The offset is along the axes of the first copy, the turns add up.
            let rotation = (at.rotation * step).normalize();
            let position = match euler == DVec3::ZERO {
                true => at.position + offset,
                false => at.rotation * offset + at.position,
            };
            at = Pose::new(position, rotation);
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
    fn parts(&mut self, all: &[Inner<'_>], body: Option<usize>) -> Result<(), LoadError> {
        let from_geoms = match self.compiler.inertia {
            InertiaFrom::Geoms => true,
            InertiaFrom::Inertial => false,
            InertiaFrom::Either => all.iter().all(|inner| inner.element.name != "inertial"),
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
        let known = ["name", "childclass", "mocap", "gravcomp", "user"];
        element.note_unread(&[&POSE, &known], UNREAD, self.report);
        let class = element.text("childclass").or(inner.class);
        let frame = inner.frame.of(&self.compiler.pose(element)?);
        let mut all = Vec::new();
        let inside = Inner {
            element,
            frame,
            class,
            copy: inner.copy.clone(),
        };
        self.flatten(&inside, &mut all)?;
        let hinges = self.hinges(element, &all)?;
        let is_held = !hinges.is_empty() && !hinges.iter().any(Hinge::is_free);
        let holder = match (is_held, holding) {
            (false, _) => None,
            (true, Some(holder)) => Some(holder),
            (true, None) => Some(self.world_anchor(&element.place())?),
        };
        let own = match hinges.is_empty() {
            true => None,
            false => Some(self.push(element, &inner.copy, frame, false)?),
        };
        let part = self.parts.begin();
        self.part = part;
        let owner = own.or(holding);
        let before = owner.map_or(0.0, |body| self.model.bodies[body].inertia.mass);
        self.parts(&all, owner)?;
        if let Some(owner) = owner {
            self.lift(element, owner, before)?;
        }
        let now = match (holder, own) {
            (Some(holder), Some(own)) => Some(self.join(holder, own, &hinges, holding.is_none())),
            (_, own) => own,
        };
        let body = now.or(holding);
        if let Some(name) = element.text("name") {
            self.names
                .insert(name, &inner.copy, Held { body, part, frame });
        }
        self.bodies(&all, body)?;
        self.depth -= 1;
        Ok(())
    }

    /// Takes from the gravity of a body what the file compensates. `before`: its mass without the element's own, kg.
    fn lift(&mut self, element: &Element, body: usize, before: f64) -> Result<(), LoadError> {
        let own = 1.0 - element.number("gravcomp")?.unwrap_or_default();
        let body = &mut self.model.bodies[body];
        let mass = body.inertia.mass;
        if before <= 0.0 {
            body.gravity_scale = own;
        } else if own != body.gravity_scale && mass > before {
            let whole = before * body.gravity_scale + (mass - before) * own;
            body.gravity_scale = whole / mass;
            let why = "parts that nothing moves against each other are one body, which gravity pulls at its centre of mass";
            let subject = "body gravcomp".to_owned();
            self.report
                .again(&element.place(), subject, Effect::Approximated, why);
        }
        Ok(())
    }

    fn hinges(&mut self, element: &Element, all: &[Inner<'_>]) -> Result<Vec<Hinge>, LoadError> {
        if truth(element, "mocap")? == Some(true) {
            let why = "a body that a program moves is fixed here: a command can make it kinematic";
            let place = element.place();
            self.report
                .add(&place, element.title(), String::new(), Effect::Changed, why);
        }
        let mut hinges = Vec::new();
        let is_joint =
            |inner: &&Inner<'_>| matches!(inner.element.name.as_str(), "joint" | "freejoint");
        for inner in all.iter().filter(is_joint) {
            let joint = self.classes.apply(inner.element, inner.class)?;
            let joint = joint.named_by(|name| inner.copy.name(name));
            hinges.push(Hinge::read(
                joint,
                &self.compiler,
                &inner.frame,
                self.report,
            )?);
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
            self.parts.moved(self.part, own, now);
            if !collide {
                self.parts.add_chain(holder, now);
            }
        }
        now
    }

    /// A body of an element.
    fn push(
        &mut self,
        element: &Element,
        copy: &CopyOf,
        pose: Pose,
        fixed: bool,
    ) -> Result<usize, LoadError> {
        let place = self.model.bodies.len();
        if place >= BODIES_MAX as usize {
            return Err(too_many(element, place + 1));
        }
        let name = element.text("name").map_or_else(
            || format!("{} {place}", element.name),
            |name| copy.name(name),
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
            gravity_scale: 1.0,
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
        let anchor = self.push(&world, &CopyOf::default(), Pose::IDENTITY, true)?;
        self.anchor = Some(anchor);
        Ok(anchor)
    }

    fn inertial(&mut self, inner: &Inner<'_>) -> Result<Inertia, LoadError> {
        let element = inner.element;
        let known = ["mass", "diaginertia", "fullinertia"];
        element.note_unread(&[&POSE, &known], UNREAD, self.report);
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
            let density = if given.is_some() { 1.0 } else { density };
            let own = self.assets.inertia(&element, &solid, density);
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
            None => self.push(element, &inner.copy, pose, true)?,
        };
        self.parts.add(self.part, body);
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
        if own.friction.is_some_and(|other| other != friction) {
            let why = "a body has one friction: the greatest of its geoms";
            let subject = "geom friction of several geoms".to_owned();
            self.report
                .again(&element.place(), subject, Effect::Approximated, why);
        }
        own.friction = Some(own.friction.map_or(friction, |other| other.max(friction)));
        let pose = own.pose.inverse().of(&pose);
        own.solids.push(Placed { pose, solid, name });
        Ok(())
    }

    /// Notes that two frictions act otherwise here, once for a file that has two.
    fn note_pairs(&mut self, root: &Element) {
        let mut all = self.model.bodies.iter().filter_map(|body| body.friction);
        let first = all.next();
        if all.any(|friction| Some(friction) != first) {
            let why = "of two bodies that touch, the mean of both frictions acts, not the greater";
            let subject = "friction of pairs".to_owned();
            self.report
                .again(&root.place(), subject, Effect::Changed, why);
        }
    }

    /// Pairs of bodies that do not touch, the lower place first.
    fn excluded(&mut self, root: &Element) -> Result<BTreeSet<(usize, usize)>, LoadError> {
        let mut excluded = Vec::new();
        for element in root.each("contact").flat_map(|contact| &contact.children) {
            if element.name != "exclude" {
                let why = "bodies touch by groups, not by pairs";
                let subject = format!("contact {}", element.name);
                self.report
                    .again(&element.place(), subject, Effect::Left, why);
                continue;
            }
            element.needs("body2")?;
            element.note_unread(&[&["name", "body1", "body2"]], UNREAD, self.report);
            for ends in self.names.pairs(element, &mut self.work)? {
                let [one, other] = ends.map(|end| self.parts.bodies(end.part));
                for (one, other) in one.iter().flat_map(|one| other.iter().map(|b| (*one, *b))) {
                    self.work.add(element, 0)?;
                    excluded.push(Excluded::new(
                        [one, other],
                        ends.map(|end| end.part),
                        element,
                    ));
                }
            }
        }
        let joints = self.model.joints.iter().filter(|joint| !joint.collide);
        let joined = joints.map(|joint| joint.bodies.into()).collect();
        let parts = std::mem::take(&mut self.parts);
        Ok(parts.apart(&excluded, &joined, self.report))
    }

    /// Names the fixed bodies of geoms so that a body's name is the body's.
    fn name_geoms(&mut self) {
        let bodies = &mut self.model.bodies;
        let own = bodies.iter().filter(|body| !body.fixed);
        let taken: BTreeSet<_> = own.map(|body| body.name.clone()).collect();
        for body in bodies.iter_mut().filter(|body| body.fixed) {
            let subject = format!("geom \"{}\"", body.name);
            while taken.contains(&body.name) {
                body.name = format!("geom {}", body.name);
            }
            if subject != format!("geom \"{}\"", body.name) {
                let why = "a body has that name too, and keeps it";
                let value = format!("now \"{}\"", body.name);
                self.report
                    .add(&body.place, subject, value, Effect::Changed, why);
            }
        }
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
            for ends in self.names.pairs(element, &mut self.work)? {
                self.loop_joint(element, kind, ends)?;
            }
        }
        Ok(())
    }

    fn loop_joint(
        &mut self,
        element: &Element,
        kind: JointKind,
        ends: [Held; 2],
    ) -> Result<(), LoadError> {
        let known = [
            "name", "class", "active", "body1", "body2", "anchor", "relpose",
        ];
        element.note_unread(
            &[&known],
            "a joint that closes a loop has no such setting",
            self.report,
        );
        let mut bodies = [0; 2];
        for (place, end) in bodies.iter_mut().zip(ends) {
            *place = match end.body {
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
            frame: ends[0].frame.of(&Pose::at(anchor)),
            start: Pose::IDENTITY,
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
        what: "bodies after replication",
        found,
        most: BODIES_MAX as usize,
    })
}

#[cfg(test)]
mod body_tests;
#[cfg(test)]
mod tests;
