//! Geoms of MJCF as solids, and the meshes that they name.
//!
//! Says nothing of bodies. A mesh that no reader is there for is kept as none, so that its name is known.

use std::collections::BTreeMap;
use std::rc::Rc;

use glam::{DQuat, DVec3};

use super::classes::{Classes, Compiler, along_z};
use crate::files::{Files, folder_of, join};
use crate::inertia::{Inertia, Pose};
use crate::mesh::{MeshInertia, Meshes, TriangleMesh};
use crate::model::{LoadOptions, Solid};
use crate::report::{Effect, LoadError, Place, Problem, Report};
use crate::xml::Element;

/// Meshes of a file, by name, and how they weigh; `None` for one that is not read.
#[derive(Debug, Default)]
pub(crate) struct Assets(BTreeMap<String, (Option<Rc<TriangleMesh>>, MeshInertia)>);

/// The settings by which assets are read.
pub(crate) struct Rules<'a> {
    pub(crate) classes: &'a Classes,
    pub(crate) compiler: &'a Compiler,
    /// The file that everything is relative to.
    pub(crate) main: &'a Place,
}

/// Settings of a mesh that are read, or that are about drawing alone.
const OF_MESHES: [&str; 14] = [
    "name",
    "class",
    "file",
    "scale",
    "vertex",
    "face",
    "refpos",
    "refquat",
    "normal",
    "texcoord",
    "smoothnormal",
    "material",
    "content_type",
    "inertia",
];

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
        element.note_unread(&[&OF_MESHES], "meshes have no such setting here", report);
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
        let (rule, by_hull) = match element.text("inertia") {
            None | Some("legacy") => (MeshInertia::Apart, false),
            Some("exact") => (MeshInertia::Enclosed, false),
            Some("convex") => (MeshInertia::Enclosed, true),
            Some("shell") => (MeshInertia::Surface, false),
            Some(_) => return Err(element.unknown_word("inertia")),
        };
        // Points without triangles are a hull there, too.
        let mesh = mesh.map(|mesh| {
            let needs = by_hull || mesh.triangles.is_empty();
            let hull = needs.then(|| mesh.with_hull()).flatten();
            hull.map_or(mesh, Rc::new)
        });
        self.0.insert(name, (mesh, rule));
        Ok(())
    }

    /// The mass of a geom's solid at a density; `None` for one without an inside.
    pub(crate) fn inertia(
        &self,
        element: &Element,
        solid: &Solid,
        density: f64,
    ) -> Option<Inertia> {
        let asset = element.text("mesh").and_then(|name| self.0.get(name));
        match (solid, asset) {
            (Solid::Hull(mesh), Some((_, rule))) => mesh.inertia_by(*rule, density),
            _ => solid.inertia(density),
        }
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
            let (mesh, _) = self.0.get(name).ok_or_else(|| {
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
