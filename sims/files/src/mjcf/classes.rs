//! MJCF made plain: includes, default classes, orientations, copies.
//!
//! Knows elements and attributes, no bodies. Invariant: after [`expand`] no include is left, and none includes itself.
//!
//! A copy has its element's name and a number for each replication around it, the innermost first, as MuJoCo has it. A name
//! without numbers stands for all copies; two of them stand for the pairs that lie in one copy of whatever holds both.
//! Invariant: no loop over copies runs without [`Work`].

use std::collections::{BTreeMap, BTreeSet};
use std::ptr;
use std::rc::Rc;

use glam::{DMat3, DQuat, DVec3};

use crate::files::{FileError, Files, folder_of, join};
use crate::inertia::Pose;
use crate::report::{LoadError, Problem};
use crate::xml::{self, Element};

/// Files inside each other.
const INCLUDES_DEEP: usize = 16;
/// Elements inside each other, over all files.
const DEPTH_MAX: usize = 300;
/// Files in all.
const INCLUDES_MAX: usize = 1_000;
/// Attributes of an element's class.
const ATTRIBUTES_MAX: usize = 1_000;

/// Replaces includes by what they include. `main`: the file that everything is relative to.
pub(crate) fn expand(
    root: Element,
    files: &dyn Files,
    main: &str,
    work: &mut Work,
) -> Result<Element, LoadError> {
    let mut expander = Expander {
        files,
        main,
        work,
        open: vec![main.to_owned()],
        count: 0,
        depth: 0,
    };
    expander.expand(root)
}

struct Expander<'a> {
    files: &'a dyn Files,
    main: &'a str,
    work: &'a mut Work,
    open: Vec<String>,
    count: usize,
    depth: usize,
}

impl Expander<'_> {
    fn expand(&mut self, mut element: Element) -> Result<Element, LoadError> {
        self.work.add(&element, element.attribute_bytes())?;
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return Err(element.wrong(Problem::TooMany {
                what: "elements inside each other",
                found: self.depth,
                most: DEPTH_MAX,
            }));
        }
        let mut children = Vec::with_capacity(element.children.len());
        for child in std::mem::take(&mut element.children) {
            if child.name == "include" {
                children.extend(self.include(&child)?);
            } else {
                children.push(self.expand(child)?);
            }
        }
        element.children = children;
        self.depth -= 1;
        Ok(element)
    }

    fn include(&mut self, element: &Element) -> Result<Vec<Element>, LoadError> {
        let file = element.needs("file")?;
        self.count += 1;
        let (found, deep) = (self.count, self.open.len());
        if found > INCLUDES_MAX || deep > INCLUDES_DEEP {
            let (what, most) = match deep > INCLUDES_DEEP {
                true => ("files that include each other", INCLUDES_DEEP),
                false => ("included files", INCLUDES_MAX),
            };
            let found = found.max(deep);
            return Err(element.wrong(Problem::TooMany { what, found, most }));
        }
        // Relative to the main file, or else to the one that includes.
        let own = element.place().file;
        let mut places = vec![
            join(folder_of(self.main), file),
            join(folder_of(&own), file),
        ];
        places.dedup();
        for path in places {
            if self.open.contains(&path) {
                return Err(element.wrong(Problem::IncludeLoop(path)));
            }
            match xml::read(self.files, &path) {
                Ok((root, bytes)) => {
                    self.work.add(element, bytes)?;
                    self.open.push(path);
                    let whole = self.expand(root)?;
                    self.open.pop();
                    return Ok(whole.children);
                }
                Err(LoadError {
                    problem: Problem::File(FileError::NotFound),
                    ..
                }) => {}
                Err(error) => return Err(error),
            }
        }
        let (what, name) = ("file to include", file.to_owned());
        Err(element.wrong(Problem::UnknownName { what, name }))
    }
}

/// Attributes of an element's name.
#[derive(Clone, Debug, Default)]
struct Class(BTreeMap<String, BTreeMap<String, String>>);

/// Default classes of a file.
#[derive(Debug, Default)]
pub(crate) struct Classes(BTreeMap<String, Class>);

fn bytes(attributes: &BTreeMap<String, String>) -> usize {
    let each = attributes.iter();
    each.map(|(name, value)| name.len() + value.len()).sum()
}

/// The class of elements that have none.
const MAIN: &str = "main";

impl Classes {
    /// Reads all classes of a file.
    pub(crate) fn read(root: &Element, work: &mut Work) -> Result<Self, LoadError> {
        let mut classes = Self::default();
        classes.0.insert(MAIN.to_owned(), Class::default());
        for element in root.each("default") {
            let name = element.text("class").unwrap_or(MAIN).to_owned();
            let from = classes.0.get(MAIN).cloned().unwrap_or_default();
            classes.add(element, name, from, work)?;
        }
        Ok(classes)
    }

    fn add(
        &mut self,
        element: &Element,
        name: String,
        from: Class,
        work: &mut Work,
    ) -> Result<(), LoadError> {
        let mut class = from;
        for child in element
            .children
            .iter()
            .filter(|child| child.name != "default")
        {
            let own = class.0.entry(child.name.clone()).or_default();
            own.extend(child.attributes.iter().cloned());
            let what = "attributes of a default class";
            let problem = Problem::bound(what, own.len(), ATTRIBUTES_MAX);
            problem.map_err(|problem| child.wrong(problem))?;
        }
        // Each class has a copy of all that it inherits.
        work.add(element, class.0.values().map(bytes).sum())?;
        self.0.insert(name, class.clone());
        for child in element.each("default") {
            let name = child.needs("class")?.to_owned();
            self.add(child, name, class.clone(), work)?;
        }
        Ok(())
    }

    /// Bytes of an element with the attributes of its class.
    pub(crate) fn bytes_of(&self, element: &Element, outer: Option<&str>) -> usize {
        let name = element.text("class").or(outer).unwrap_or(MAIN);
        let class = self
            .0
            .get(name)
            .and_then(|class| class.0.get(&element.name));
        element.attribute_bytes() + class.map_or(0, bytes)
    }

    /// An element with the attributes of its class. `outer`: the class of its body, for one that names none.
    pub(crate) fn apply(
        &self,
        element: &Element,
        outer: Option<&str>,
    ) -> Result<Element, LoadError> {
        let name = element.text("class").or(outer).unwrap_or(MAIN);
        let class = self.0.get(name).ok_or_else(|| {
            let (what, name) = ("default class", name.to_owned());
            element.wrong(Problem::UnknownName { what, name })
        })?;
        let mut whole = element.with(Vec::new());
        for (name, value) in class.0.get(&element.name).into_iter().flatten() {
            if whole.text(name).is_none() {
                whole.attributes.push((name.clone(), value.clone()));
            }
        }
        Ok(whole)
    }
}

/// The compiler's settings.
#[derive(Clone, Debug)]
pub(crate) struct Compiler {
    /// Radians of the file's unit of angles.
    pub(crate) angle: f64,
    pub(crate) euler: [char; 3],
    pub(crate) autolimits: bool,
    pub(crate) mesh_folder: String,
    pub(crate) strip_path: bool,
    pub(crate) inertia: InertiaFrom,
    pub(crate) total_mass: Option<f64>,
    /// Least mass and least moment of a body that moves.
    pub(crate) bounds: [f64; 2],
    pub(crate) groups: [f64; 2],
}

/// The source of a body's inertia.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum InertiaFrom {
    Geoms,
    Inertial,
    Either,
}

impl Compiler {
    /// The settings of all `compiler` elements of a file; later ones win.
    pub(crate) fn read(root: &Element) -> Result<Self, LoadError> {
        let mut all = Self {
            angle: 1.0_f64.to_radians(),
            euler: ['x', 'y', 'z'],
            autolimits: true,
            mesh_folder: String::new(),
            strip_path: false,
            inertia: InertiaFrom::Either,
            total_mass: None,
            bounds: [0.0, 0.0],
            groups: [0.0, 5.0],
        };
        for element in root.each("compiler") {
            all.apply(element)?;
        }
        Ok(all)
    }

    fn apply(&mut self, element: &Element) -> Result<(), LoadError> {
        match element.text("angle") {
            None => {}
            Some("degree") => self.angle = 1.0_f64.to_radians(),
            Some("radian") => self.angle = 1.0,
            Some(_) => return Err(element.unknown_word("angle")),
        }
        if element.text("coordinate") == Some("global") {
            return Err(element.wrong(Problem::Unsupported("coordinate=\"global\"")));
        }
        if let Some(text) = element.text("eulerseq") {
            let letters: Vec<_> = text.chars().collect();
            let known = |letter: &char| "xyzXYZ".contains(*letter);
            let three = <[char; 3]>::try_from(letters).ok();
            let sequence = three.filter(|three| three.iter().all(known));
            self.euler = sequence.ok_or_else(|| element.unknown_word("eulerseq"))?;
        }
        if let Some(is_on) = truth(element, "autolimits")? {
            self.autolimits = is_on;
        }
        if let Some(is_on) = truth(element, "strippath")? {
            self.strip_path = is_on;
        }
        if let Some(folder) = element.text("meshdir").or(element.text("assetdir")) {
            self.mesh_folder = folder.to_owned();
        }
        self.inertia = match element.text("inertiafromgeom") {
            None => self.inertia,
            Some("true") => InertiaFrom::Geoms,
            Some("false") => InertiaFrom::Inertial,
            Some("auto") => InertiaFrom::Either,
            Some(_) => return Err(element.unknown_word("inertiafromgeom")),
        };
        let total = element.number("settotalmass")?;
        self.total_mass = total.filter(|mass| *mass > 0.0).or(self.total_mass);
        for (name, bound) in ["boundmass", "boundinertia"]
            .into_iter()
            .zip(&mut self.bounds)
        {
            *bound = element.number(name)?.unwrap_or(*bound);
        }
        if let Some(range) = element.array("inertiagrouprange", "2")? {
            self.groups = range;
        }
        Ok(())
    }

    /// The pose of an element: `pos` and one of five orientations.
    pub(crate) fn pose(&self, element: &Element) -> Result<Pose, LoadError> {
        let position = element.vector("pos")?.unwrap_or_default();
        Ok(Pose::new(position, self.orientation(element)?))
    }

    fn orientation(&self, element: &Element) -> Result<DQuat, LoadError> {
        let senseless = |rule| {
            let name = element.title();
            element.wrong(Problem::Senseless { name, rule })
        };
        let unit = |axis: DVec3| {
            let direction = axis.try_normalize();
            direction.ok_or_else(|| senseless("a direction of no length has no orientation"))
        };
        if let Some([w, x, y, z]) = element.array("quat", "4")? {
            let quat = DQuat::from_xyzw(x, y, z, w);
            if quat.length() < 1e-9 {
                return Err(senseless("a quaternion of no length has no orientation"));
            }
            return Ok(quat.normalize());
        }
        if let Some([x, y, z, angle]) = element.array("axisangle", "4")? {
            let axis = unit(DVec3::new(x, y, z))?;
            return Ok(DQuat::from_axis_angle(axis, angle * self.angle));
        }
        if let Some([a, b, c, d, e, f]) = element.array("xyaxes", "6")? {
            let x = unit(DVec3::new(a, b, c))?;
            let y = DVec3::new(d, e, f);
            let y = unit(y - x * x.dot(y))?;
            return Ok(DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize());
        }
        if let Some(axis) = element.vector("zaxis")? {
            return Ok(along_z(unit(axis)?));
        }
        let angles = element.vector("euler")?.unwrap_or_default() * self.angle;
        let mut whole = DQuat::IDENTITY;
        for (letter, angle) in self.euler.into_iter().zip(angles.to_array()) {
            let turn = match letter.to_ascii_lowercase() {
                'x' => DQuat::from_rotation_x(angle),
                'y' => DQuat::from_rotation_y(angle),
                _ => DQuat::from_rotation_z(angle),
            };
            // Small letters turn about the axes that turned along, large ones about those that stay.
            whole = match letter.is_ascii_lowercase() {
                true => whole * turn,
                false => turn * whole,
            };
        }
        Ok(whole.normalize())
    }
}

/// A rotation that turns z to a direction of unit length.
pub(crate) fn along_z(along: DVec3) -> DQuat {
    match along.z < -0.999_999_9 {
        true => DQuat::from_rotation_x(std::f64::consts::PI),
        false => DQuat::from_rotation_arc(DVec3::Z, along).normalize(),
    }
}

/// An attribute that is true or false; `None` where it is not given, or `auto`.
pub(crate) fn truth(element: &Element, attribute: &str) -> Result<Option<bool>, LoadError> {
    match element.text(attribute) {
        None | Some("auto") => Ok(None),
        Some("true") => Ok(Some(true)),
        Some("false") => Ok(Some(false)),
        Some(_) => Err(element.unknown_word(attribute)),
    }
}

/// Elements of all files, and of all copies. A scene of the most bodies, each with a joint and a geom, has fewer.
const ELEMENTS_MAX: usize = 1_000_000;
/// Bytes of all files and of the copies of their attributes.
const BYTES_MAX: usize = 128 << 20;

/// The elements and bytes that were read or copied.
#[derive(Debug, Default)]
pub(crate) struct Work {
    elements: usize,
    bytes: usize,
}

impl Work {
    /// Counts an element of a file or a copy, and bytes of it.
    pub(crate) fn add(&mut self, element: &Element, bytes: usize) -> Result<(), LoadError> {
        self.elements += 1;
        self.bytes = self.bytes.saturating_add(bytes);
        let (what, found, most) = match self.bytes > BYTES_MAX {
            true => ("bytes of all files and copies", self.bytes, BYTES_MAX),
            false => (
                "elements of all files and copies",
                self.elements,
                ELEMENTS_MAX,
            ),
        };
        Problem::bound(what, found, most).map_err(|problem| element.wrong(problem))
    }
}

/// The copy to which an element belongs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct CopyOf {
    /// Each replication around it, by its address, and the number of the copy in it; the outermost first.
    numbers: Vec<(usize, usize)>,
    /// The end of its names.
    suffix: String,
}

impl CopyOf {
    /// The copy of this number in a replication of so many.
    pub(crate) fn within(&self, replication: &Element, number: usize, count: usize) -> Self {
        let mut numbers = self.numbers.clone();
        numbers.push((ptr::from_ref(replication).addr(), number));
        let separator = replication.text("sep").unwrap_or_default();
        let digits = count.to_string().len();
        let suffix = format!("{separator}{number:0digits$}{}", self.suffix);
        Self { numbers, suffix }
    }

    /// Bytes of what it adds to each element.
    pub(crate) fn bytes(&self) -> usize {
        self.suffix.len() + size_of_val(self.numbers.as_slice())
    }

    /// The name of the copy of an element.
    pub(crate) fn name(&self, name: &str) -> String {
        format!("{name}{}", self.suffix)
    }

    /// Its numbers in some of the replications.
    fn in_those(&self, replications: &BTreeSet<usize>) -> Vec<usize> {
        let own = self.numbers.iter();
        let own = own.filter(|(replication, _)| replications.contains(replication));
        own.map(|(_, number)| *number).collect()
    }

    fn replications(&self) -> BTreeSet<usize> {
        self.numbers.iter().map(|(own, _)| *own).collect()
    }
}

/// The body that holds what is read, and the frame of the element around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Held {
    /// `None`: the world.
    pub(crate) body: Option<usize>,
    /// The file's body, which may be one here with others; zero: the world.
    pub(crate) part: usize,
    /// In the file's world.
    pub(crate) frame: Pose,
}

/// A body of a name, and the copy that it is.
#[derive(Clone, Debug)]
struct Named {
    copy: Rc<CopyOf>,
    held: Held,
}

/// Names of bodies.
#[derive(Debug, Default)]
pub(crate) struct Names(BTreeMap<String, Vec<Named>>);

impl Names {
    /// Adds a body under its element's name, and under that of its copy.
    pub(crate) fn insert(&mut self, name: &str, copy: &Rc<CopyOf>, held: Held) {
        let mut add = |name: String, copy: Rc<CopyOf>| {
            let named = Named { copy, held };
            self.0.entry(name).or_default().push(named);
        };
        if !copy.suffix.is_empty() {
            add(copy.name(name), Rc::default());
        }
        add(name.to_owned(), copy.clone());
    }

    /// The pairs of bodies that two attributes of an element name; the world for a second one that is not given.
    pub(crate) fn pairs(
        &self,
        element: &Element,
        work: &mut Work,
    ) -> Result<Vec<[Held; 2]>, LoadError> {
        let first = self.find(element, "body1", work)?;
        let second = match element.text("body2") {
            Some(_) => self.find(element, "body2", work)?,
            None => vec![world()],
        };
        let both = match (first.first(), second.first()) {
            (Some(one), Some(other)) => &one.copy.replications() & &other.copy.replications(),
            _ => BTreeSet::new(),
        };
        let mut by_copy: BTreeMap<Vec<usize>, Vec<Held>> = BTreeMap::new();
        for named in &second {
            let place = by_copy.entry(named.copy.in_those(&both)).or_default();
            place.push(named.held);
        }
        let mut pairs = Vec::new();
        for named in &first {
            for other in by_copy
                .get(&named.copy.in_those(&both))
                .into_iter()
                .flatten()
            {
                work.add(element, 0)?;
                pairs.push([named.held, *other]);
            }
        }
        Ok(pairs)
    }

    /// All copies of the body that an attribute names.
    fn find(
        &self,
        element: &Element,
        attribute: &'static str,
        work: &mut Work,
    ) -> Result<Vec<Named>, LoadError> {
        let name = element.needs(attribute)?;
        if name == "world" {
            return Ok(vec![world()]);
        }
        let all = self.0.get(name).ok_or_else(|| {
            let (what, name) = ("body", name.to_owned());
            element.wrong(Problem::UnknownName { what, name })
        })?;
        let mut seen = BTreeSet::new();
        for named in all {
            work.add(element, 0)?;
            if !seen.insert(&named.copy.numbers) {
                let (what, name) = ("body", name.to_owned());
                return Err(element.wrong(Problem::Twice { what, name }));
            }
        }
        Ok(all.clone())
    }
}

fn world() -> Named {
    let held = Held {
        body: None,
        part: 0,
        frame: Pose::IDENTITY,
    };
    Named {
        copy: Rc::default(),
        held,
    }
}
