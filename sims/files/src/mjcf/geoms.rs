//! Geoms of MJCF as solids, the meshes that they name, and what they touch.
//!
//! Says nothing of bodies. A mesh that no reader is there for is kept as none, so that its name is known.
//!
//! Two geoms touch there if a bit of the one's type is in the other's affinity, either way round; collision groups here need
//! both ways. So bodies that touch the same others get a bit of their own, and name the bits that they touch.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use glam::{DQuat, DVec3};
use rhumb_protocol::scene::CollisionGroups;

use super::classes::{Classes, Compiler, along_z};
use crate::files::{Files, folder_of, join};
use crate::inertia::Pose;
use crate::mesh::{Meshes, TriangleMesh};
use crate::model::{LoadOptions, Solid};
use crate::report::{Effect, LoadError, Place, Problem, Report};
use crate::xml::Element;

/// Meshes of a file, by name; `None` for one that is not read.
#[derive(Debug, Default)]
pub(crate) struct Assets(BTreeMap<String, Option<Rc<TriangleMesh>>>);

/// The settings by which assets are read.
pub(crate) struct Rules<'a> {
    pub(crate) classes: &'a Classes,
    pub(crate) compiler: &'a Compiler,
    /// The file that everything is relative to.
    pub(crate) main: &'a Place,
}

impl Assets {
    /// Reads all assets of a file.
    pub(crate) fn read(
        root: &Element,
        files: &dyn Files,
        options: &LoadOptions,
        rules: &Rules<'_>,
        report: &mut Report,
    ) -> Result<Self, LoadError> {
        let mut assets = Self::default();
        let mut meshes = Meshes::new(files, &options.packages);
        for element in root.each("asset").flat_map(|asset| &asset.children) {
            match element.name.as_str() {
                "mesh" => assets.mesh(element, &mut meshes, rules, report)?,
                "texture" | "material" => {
                    let why = "colours are about drawing alone";
                    report.again(&element.place(), element.name.clone(), Effect::Left, why);
                }
                name => {
                    let why = "this kind of asset is not read";
                    report.again(&element.place(), format!("asset {name}"), Effect::Left, why);
                }
            }
        }
        Ok(assets)
    }

    fn mesh(
        &mut self,
        element: &Element,
        meshes: &mut Meshes<'_>,
        rules: &Rules<'_>,
        report: &mut Report,
    ) -> Result<(), LoadError> {
        let element = rules.classes.apply(element, None)?;
        let scale = element.vector("scale")?.unwrap_or(DVec3::ONE);
        let file = element.text("file");
        let stem = file.map(|file| {
            let last = file.rsplit(['/', '\\']).next().unwrap_or(file);
            last.rsplit_once('.').map_or(last, |(stem, _)| stem)
        });
        let Some(name) = element.text("name").or(stem).map(str::to_owned) else {
            element.needs("file")?;
            return Ok(());
        };
        let mesh = match file {
            Some(file) => {
                let file = match rules.compiler.strip_path {
                    true => file.rsplit(['/', '\\']).next().unwrap_or(file),
                    false => file,
                };
                let folder = join(folder_of(&rules.main.file), &rules.compiler.mesh_folder);
                let path = join(&folder, file);
                meshes.get_at(&element, &path, scale, &element.title(), report)?
            }
            None => inline(&element)?.map(|mesh| Rc::new(mesh.scaled(scale))),
        };
        let moved = reference(&element)?;
        let mesh = match mesh.as_ref().zip(moved) {
            None => mesh,
            Some((mesh, pose)) => {
                let moved = meshes.moved(mesh, &pose);
                Some(moved.map_err(|problem| element.wrong(problem))?)
            }
        };
        self.0.insert(name, mesh);
        Ok(())
    }

    /// The solid of a geom and its pose in the body; `None` with a note for one that is not read.
    pub(crate) fn solid(
        &self,
        element: &Element,
        compiler: &Compiler,
        report: &mut Report,
    ) -> Result<Option<(Solid, Pose)>, LoadError> {
        let mut pose = compiler.pose(element)?;
        let kind = element.text("type").unwrap_or("sphere");
        let mut sizes = element.numbers("size")?.unwrap_or_default();
        if let Some((along, half)) = from_to(element)? {
            pose = along;
            let first = sizes.first().copied().unwrap_or(0.0);
            sizes = match kind {
                "capsule" | "cylinder" => vec![first, half],
                _ => vec![first, first, half],
            };
        }
        let size = |count: usize, expected| match sizes.len() >= count {
            true => Ok([0, 1, 2].map(|at| sizes.get(at).copied().unwrap_or(0.0))),
            false => Err(element.count("size", sizes.len(), expected)),
        };
        if element.text("mesh").is_some() || kind == "mesh" {
            if kind != "mesh" {
                let why = "a shape fitted to a mesh is the hull of the mesh";
                let place = element.place();
                report.again(&place, "geom mesh".to_owned(), Effect::Approximated, why);
            }
            let name = element.needs("mesh")?;
            let mesh = self.0.get(name).ok_or_else(|| {
                let (what, name) = ("mesh", name.to_owned());
                element.wrong(Problem::UnknownName { what, name })
            })?;
            return Ok(mesh.clone().map(|mesh| (Solid::Hull(mesh), pose)));
        }
        let solid = match kind {
            "sphere" => {
                let [radius, ..] = size(1, "1")?;
                Solid::Ball { radius }
            }
            "capsule" | "cylinder" => {
                let [radius, half, _] = size(2, "2")?;
                match kind {
                    "capsule" => Solid::Capsule { half, radius },
                    _ => Solid::Cylinder { half, radius },
                }
            }
            "box" | "ellipsoid" => {
                let half = DVec3::from_array(size(3, "3")?);
                match kind {
                    "box" => Solid::Cuboid { half },
                    _ => Solid::Ellipsoid { half },
                }
            }
            "plane" => Solid::Plane,
            "hfield" | "sdf" => {
                let why = "height fields and distance fields are not read";
                let place = element.place();
                report.again(&place, format!("geom {kind}"), Effect::Left, why);
                return Ok(None);
            }
            _ => return Err(element.unknown_word("type")),
        };
        Ok(Some((solid, pose)))
    }
}

/// The change that `refpos` and `refquat` make to a mesh.
fn reference(element: &Element) -> Result<Option<Pose>, LoadError> {
    let position = element.vector("refpos")?;
    let quat = element.array("refquat", "4")?;
    if position.is_none() && quat.is_none() {
        return Ok(None);
    }
    let [w, x, y, z] = quat.unwrap_or([1.0, 0.0, 0.0, 0.0]);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let rotation = if rotation.length() < 1e-9 {
        DQuat::IDENTITY
    } else {
        rotation.normalize()
    };
    Ok(Some(
        Pose::new(position.unwrap_or_default(), rotation).inverse(),
    ))
}

/// The pose between two points with z along them, and half their distance, metres; `None` without them.
fn from_to(element: &Element) -> Result<Option<(Pose, f64)>, LoadError> {
    let Some([a, b, c, d, e, f]) = element.array("fromto", "6")? else {
        return Ok(None);
    };
    let (from, to) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
    let along = from - to;
    let Some(direction) = along.try_normalize() else {
        let name = element.title();
        let rule = "fromto has two different points";
        return Err(element.wrong(Problem::Senseless { name, rule }));
    };
    let pose = Pose::new((from + to) * 0.5, along_z(direction));
    Ok(Some((pose, along.length() * 0.5)))
}

/// Notes settings of a geom that a shape has not.
pub(crate) fn note_settings(element: &Element, report: &mut Report) {
    let known = [
        "name",
        "class",
        "type",
        "pos",
        "quat",
        "axisangle",
        "xyaxes",
        "zaxis",
        "euler",
        "size",
        "fromto",
        "mass",
        "density",
        "contype",
        "conaffinity",
        "group",
        "friction",
        "mesh",
        "rgba",
        "material",
        "user",
        "hfield",
    ];
    for (name, _) in &element.attributes {
        if !known.contains(&name.as_str()) {
            let why = "a material has friction and restitution alone";
            report.again(&element.place(), format!("geom {name}"), Effect::Left, why);
        }
    }
    let several = element
        .text("friction")
        .is_some_and(|text| text.split_whitespace().count() > 1);
    if several {
        let why = "bodies have friction against sliding alone";
        let subject = "geom friction against turning and rolling".to_owned();
        report.again(&element.place(), subject, Effect::Left, why);
    }
}

/// A mesh of points, and triangles if given, that stand in the file.
fn inline(element: &Element) -> Result<Option<TriangleMesh>, LoadError> {
    let Some(numbers) = element.numbers("vertex")? else {
        return Err(element.wrong(Problem::Missing {
            element: element.title(),
            part: "file or vertex",
        }));
    };
    let (points, rest) = numbers.as_chunks::<3>();
    if !rest.is_empty() || points.len() < 4 {
        return Err(element.count("vertex", numbers.len(), "at least 12, three for each point"));
    }
    let faces = element.numbers("face")?.unwrap_or_default();
    let (triangles, rest) = faces.as_chunks::<3>();
    let is_point = |at: &f64| at.fract() == 0.0 && (0.0..points.len() as f64).contains(at);
    if !rest.is_empty() || !faces.iter().all(is_point) {
        return Err(element.count(
            "face",
            faces.len(),
            "three numbers of points for each triangle",
        ));
    }
    Ok(Some(TriangleMesh {
        points: points.iter().map(|at| DVec3::from_array(*at)).collect(),
        triangles: triangles
            .iter()
            .map(|at| at.map(|one| one as u32))
            .collect(),
    }))
}

/// Bits of a body's geoms together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Bits {
    pub(crate) contype: u32,
    pub(crate) conaffinity: u32,
}

impl Bits {
    fn touches(self, other: Self) -> bool {
        self.contype & other.conaffinity != 0 || other.contype & self.conaffinity != 0
    }
}

/// Groups of each body. `excluded`: pairs that do not touch, the lower place first.
pub(crate) fn groups(
    bodies: &[Bits],
    excluded: &BTreeSet<(usize, usize)>,
    place: &Place,
    report: &mut Report,
) -> Vec<CollisionGroups> {
    let alone: BTreeSet<_> = excluded.iter().flat_map(|(a, b)| [*a, *b]).collect();
    let all: Vec<_> = (0..bodies.len()).collect();
    let with = classes(&all, |body| {
        (bodies[body], alone.contains(&body).then_some(body))
    });
    if let Some(classes) = &with {
        let apart = |a: usize, b: usize| excluded.contains(&(a.min(b), a.max(b)));
        return from_classes(bodies, classes, apart);
    }
    let why = "there are 32 groups: of the parts in such pairs, none touches another";
    let subject = "excluded contacts".to_owned();
    report.add(
        place,
        subject,
        format!("{} pairs", excluded.len()),
        Effect::Approximated,
        why,
    );
    // Parts that lie in each other would be driven apart if they touched.
    let is_alone = |body: usize| alone.contains(&body);
    match classes(&all, |body| (bodies[body], is_alone(body))) {
        Some(classes) => from_classes(bodies, &classes, |a, b| is_alone(a) && is_alone(b)),
        None => vec![CollisionGroups::ALL; bodies.len()],
    }
}

/// The class of each body; `None` for more classes than there are bits.
fn classes<K: Ord>(bodies: &[usize], key: impl Fn(usize) -> K) -> Option<Vec<usize>> {
    let keys: BTreeSet<_> = bodies.iter().map(|body| key(*body)).collect();
    if keys.len() > 32 {
        return None;
    }
    let keys: Vec<_> = keys.into_iter().collect();
    let class = |body: &usize| keys.binary_search(&key(*body)).ok();
    bodies.iter().map(class).collect()
}

fn from_classes(
    bodies: &[Bits],
    classes: &[usize],
    apart: impl Fn(usize, usize) -> bool,
) -> Vec<CollisionGroups> {
    let count = classes.iter().max().map_or(0, |most| most + 1);
    let mut first = vec![0; count];
    for (body, class) in classes.iter().enumerate().rev() {
        first[*class] = body;
    }
    let row = |class: usize| {
        let (mine, mut touches) = (first[class], u32::MAX);
        for other in 0..count {
            if apart(mine, first[other]) || !bodies[mine].touches(bodies[first[other]]) {
                touches &= !(1 << other);
            }
        }
        touches
    };
    let rows: Vec<_> = (0..count).map(row).collect();
    let group = |class: &usize| CollisionGroups {
        members: 1 << class,
        touches: rows[*class],
    };
    classes.iter().map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_touch_exactly_where_bits_and_exclusions_say_so() {
        let bits = |contype, conaffinity| Bits {
            contype,
            conaffinity,
        };
        let bodies = [
            bits(1, 1),
            bits(1, 0),
            bits(0, 1),
            bits(2, 1),
            bits(1, 1),
            bits(1, 1),
        ];
        let excluded = BTreeSet::from([(0, 4)]);
        let mut report = Report::default();
        let groups = groups(&bodies, &excluded, &Place::of("a"), &mut report);
        assert!(report.is_empty());
        for a in 0..bodies.len() {
            for b in a + 1..bodies.len() {
                let expected = bodies[a].touches(bodies[b]) && !excluded.contains(&(a, b));
                let (x, y) = (groups[a], groups[b]);
                let touch = x.members & y.touches != 0 && y.members & x.touches != 0;
                assert_eq!(touch, expected, "{a} {b}");
            }
        }
        let other = CollisionGroups::ALL;
        let many: Vec<_> = (0..40).map(|_| bits(1, 1)).collect();
        let excluded = (0..38).map(|body| (body, body + 1)).collect();
        let few = super::groups(&many, &excluded, &Place::of("a"), &mut report);
        let touch = |a: usize, b: usize| few[a].members & few[b].touches != 0;
        assert!((0..38).all(|a| !touch(a, a + 1) && touch(a, 39) && touch(39, a)));
        assert_eq!(report.notes()[0].subject, "excluded contacts");
        assert!(
            groups
                .iter()
                .all(|own| own.touches & other.members != 0 && own.members != 0)
        );
    }
}
