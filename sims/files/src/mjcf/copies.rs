//! Copies of MJCF elements: their names, and what a world takes to read.
//!
//! Reads no numbers and makes no bodies. A copy has its element's name and a number for each replication around it, the
//! innermost first, as MuJoCo has it. A name without numbers stands for all copies; two of them stand for the pairs
//! that lie in one copy of whatever holds both. Invariant: no loop over copies runs without [`Work`].

use std::collections::{BTreeMap, BTreeSet};
use std::ptr;
use std::rc::Rc;

use crate::inertia::Pose;
use crate::report::{LoadError, Problem};
use crate::xml::Element;

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
