//! Triangle meshes from STL, OBJ and MSH: files, mass, hulls.
//!
//! Texts and bytes are read by `stl_io` and `tobj`; bytes and triangles are counted before either sees a file. What `tobj` does
//! not read and the format allows is written plainly and tried again; what is wrong is named with its line. Invariant:
//! every coordinate is finite, every triangle names points that exist.
//!
//! File names with `package://` are searched in given folders, then in the folders above the scene's file. A mesh is read
//! once.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Cursor;
use std::rc::Rc;

use glam::{DMat3, DVec3, Vec3};
use rhumb_protocol::limits::{HULL_POINTS_MAX, MESH_POINTS_MAX, TRIANGLES_MAX};
use rhumb_protocol::scene::{Hull, Invalid};

use crate::files::{FileError, Files, folder_of, join};
use crate::inertia::{Inertia, Pose};
use crate::report::{Effect, LoadError, Place, Problem, Report};
use crate::xml::Element;

/// Bytes of a mesh file.
pub(crate) const MESH_BYTES_MAX: usize = 128 << 20;
/// Triangles of a mesh file.
pub(crate) const MESH_TRIANGLES_MAX: usize = 2_000_000;
/// A mesh with more points is thinned out before its corners are searched.
const SEARCHED_POINTS_MAX: usize = 5_000;

/// Points and triangles, metres after scaling.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct TriangleMesh {
    pub(crate) points: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// Ending of a file's name, in small letters.
pub(crate) fn ending(path: &str) -> String {
    let end = path.rsplit_once('.').map_or("", |(_, end)| end);
    end.to_ascii_lowercase()
}

/// True if a reader for such a mesh exists.
fn is_read(path: &str) -> bool {
    matches!(ending(path).as_str(), "stl" | "obj" | "msh")
}

/// Reads a mesh file.
pub(crate) fn read(files: &dyn Files, path: &str) -> Result<TriangleMesh, Problem> {
    let bytes = files.read(path, MESH_BYTES_MAX).map_err(Problem::File)?;
    let mesh = match ending(path).as_str() {
        "stl" => stl(bytes)?,
        "obj" => {
            count_triangles(&bytes)?;
            let Surface { points, triangles } = obj(&bytes)?;
            TriangleMesh { points, triangles }
        }
        "msh" => msh(&bytes)?,
        _ => return Err(Problem::UnknownFormat(path.to_owned())),
    };
    check(mesh)
}

/// Checks what every mesh must keep.
pub(crate) fn check(mesh: TriangleMesh) -> Result<TriangleMesh, Problem> {
    let wrong = |cause: &str| Err(Problem::Mesh(cause.to_owned()));
    if mesh.triangles.is_empty() || mesh.points.len() < 3 {
        return wrong("it has no triangle");
    }
    if mesh.triangles.len() > MESH_TRIANGLES_MAX {
        return Err(Problem::TooMany {
            what: "triangles of a mesh",
            found: mesh.triangles.len(),
            most: MESH_TRIANGLES_MAX,
        });
    }
    if let Some(place) = mesh.points.iter().position(|point| !point.is_finite()) {
        return wrong(&format!("point {place} is not finite"));
    }
    let count = mesh.points.len() as u32;
    match mesh
        .triangles
        .iter()
        .position(|triangle| triangle.iter().any(|at| *at >= count))
    {
        Some(place) => wrong(&format!("triangle {place} names a point beyond the last")),
        None => Ok(mesh),
    }
}

fn stl(mut bytes: Vec<u8>) -> Result<TriangleMesh, Problem> {
    let count = bytes.get(80..84).map(|four| {
        let four = [four[0], four[1], four[2], four[3]];
        u32::from_le_bytes(four) as usize
    });
    let binary = count.filter(|count| bytes.len() >= 84 && bytes.len() - 84 == count * 50);
    if binary.is_some() {
        // Some binary files begin with the word of the text form.
        bytes[..5].fill(b' ');
        Problem::bound(
            "triangles of a mesh",
            (bytes.len() - 84) / 50,
            MESH_TRIANGLES_MAX,
        )?;
    } else if bytes.trim_ascii_start().starts_with(b"solid") {
        count_triangles(&bytes)?;
    } else {
        let said = count.unwrap_or_default();
        let held = bytes.len().saturating_sub(84) / 50;
        if held < said || bytes.len() < 84 {
            return Err(Problem::Mesh(format!(
                "it says {said} triangles and holds {held}: it is cut, or no STL file"
            )));
        }
    }
    let read = stl_io::read_stl(&mut Cursor::new(bytes));
    let read = read.map_err(|error| Problem::Mesh(error.to_string()))?;
    let point = |at: &stl_io::Vertex| DVec3::from_array(at.0.map(f64::from));
    Ok(TriangleMesh {
        points: read.vertices.iter().map(point).collect(),
        triangles: (read.faces.iter())
            .map(|face| {
                face.vertices
                    .map(|at| u32::try_from(at).unwrap_or(u32::MAX))
            })
            .collect(),
    })
}

/// Bounds the triangles of a text: faces of OBJ, facets of STL.
fn count_triangles(bytes: &[u8]) -> Result<(), Problem> {
    let mut found = 0;
    for line in bytes.split(|byte| matches!(byte, b'\n' | b'\r')) {
        let mut words = line
            .split(u8::is_ascii_whitespace)
            .filter(|word| !word.is_empty());
        found += match words.next() {
            Some(b"f") => words.count().saturating_sub(2),
            Some(b"facet") => 1,
            _ => 0,
        };
        Problem::bound("triangles of a mesh", found, MESH_TRIANGLES_MAX)?;
    }
    Ok(())
}

/// MuJoCo's own form: counts of points, normals, texture places and triangles, then these, each number of 32 bits.
fn msh(bytes: &[u8]) -> Result<TriangleMesh, Problem> {
    let (words, rest) = bytes.as_chunks::<4>();
    let counts = words.first_chunk::<4>().filter(|_| rest.is_empty());
    let counts = counts.map(|counts| counts.map(|count| u64::from(u32::from_le_bytes(count))));
    // None of the products overflows.
    let needed = |[points, normals, places, triangles]: [u64; 4]| {
        4 + 3 * (points + normals + triangles) + 2 * places
    };
    let counts = counts.filter(|counts| needed(*counts) == words.len() as u64);
    let Some([points, normals, places, _]) = counts else {
        let cause =
            "its length is not that of the counts at its beginning: it is cut, or no MSH file";
        return Err(Problem::Mesh(cause.to_owned()));
    };
    let body = &words[4..];
    let (points, body) = body.split_at(3 * points as usize);
    let triangles = &body[(3 * normals + 2 * places) as usize..];
    let number = |word: &[u8; 4]| f64::from(f32::from_le_bytes(*word));
    let (points, _) = points.as_chunks::<3>();
    let (triangles, _) = triangles.as_chunks::<3>();
    Ok(TriangleMesh {
        points: (points.iter())
            .map(|[x, y, z]| DVec3::new(number(x), number(y), number(z)))
            .collect(),
        triangles: (triangles.iter())
            .map(|corners| corners.map(u32::from_le_bytes))
            .collect(),
    })
}

/// All parts of a file.
#[derive(Debug, Default, PartialEq)]
struct Surface {
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
}

/// Reads a mesh.
fn obj(bytes: &[u8]) -> Result<Surface, Problem> {
    parsed_obj(bytes).or_else(|_| {
        let text = plain_obj(&String::from_utf8_lossy(bytes));
        parsed_obj(text.as_bytes())
            .map_err(|cause| Problem::Mesh(wrong_line(&text).unwrap_or(cause)))
    })
}

fn parsed_obj(bytes: &[u8]) -> Result<Surface, String> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    // Materials are about drawing alone.
    let none = |_: &std::path::Path| Err(tobj::LoadError::OpenFileFailed);
    let read = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, none);
    let (models, _) = read.map_err(|error| error.to_string())?;
    let mut all = Surface::default();
    for model in &models {
        let first = all.points.len() as u32;
        let (points, _) = model.mesh.positions.as_chunks::<3>();
        let points = points.iter();
        all.points
            .extend(points.map(|at| DVec3::from_array(at.map(f64::from))));
        let (corners, _) = model.mesh.indices.as_chunks::<3>();
        let corners = corners.iter();
        all.triangles
            .extend(corners.map(|at| at.map(|one| one.saturating_add(first))));
    }
    Ok(all)
}

/// A text with continued lines in one, and points without colours; lines keep their numbers.
fn plain_obj(text: &str) -> String {
    let mut whole = String::with_capacity(text.len());
    let mut held = String::new();
    let mut continued = 0;
    for line in text.lines() {
        if let Some(part) = line.trim_end().strip_suffix('\\') {
            held.push_str(part);
            held.push(' ');
            continued += 1;
            continue;
        }
        held.push_str(line);
        let mut words = held.split_whitespace();
        if words.next() == Some("v") {
            whole.push('v');
            for word in words.take(3) {
                whole.push(' ');
                whole.push_str(word);
            }
        } else {
            whole.push_str(&held);
        }
        held.clear();
        whole.extend(std::iter::repeat_n('\n', continued + 1));
        continued = 0;
    }
    whole.push_str(&held);
    whole
}

/// The first line that is wrong, and why.
fn wrong_line(text: &str) -> Option<String> {
    let is_point = |line: &&str| line.split_whitespace().next() == Some("v");
    let count = text.lines().filter(is_point).count() as i64;
    let mut seen = 0;
    for (at, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let kind = words.next();
        seen += i64::from(kind == Some("v"));
        let wrong = match kind {
            Some("v" | "vn") => {
                let numbers = words.by_ref().map(str::parse::<f32>);
                let numbers: Vec<_> = numbers.take(3).collect();
                let is_right = numbers.len() == 3 && numbers.iter().all(Result::is_ok);
                (!is_right).then(|| "three numbers are missing".to_owned())
            }
            Some("f") => words.find_map(|word| wrong_corner(word, seen, count)),
            _ => None,
        };
        if let Some(wrong) = wrong {
            let line: String = line.trim().chars().take(40).collect();
            return Some(format!("line {} \"{line}\": {wrong}", at + 1));
        }
    }
    None
}

fn wrong_corner(word: &str, seen: i64, count: i64) -> Option<String> {
    let number = word.split('/').next().unwrap_or_default();
    match number.parse::<i64>() {
        Ok(number) if (1..=count).contains(&number) || (-seen..0).contains(&number) => None,
        Ok(number) => Some(format!("there is no point {number}, and there are {count}")),
        Err(_) => Some(format!("\"{number}\" is no number of a point")),
    }
}

impl TriangleMesh {
    /// The mesh stretched along its axes; a mirrored one keeps its outside outside.
    pub(crate) fn scaled(mut self, scale: DVec3) -> Self {
        for point in &mut self.points {
            *point *= scale;
        }
        match scale.element_product() < 0.0 {
            true => self.mirrored(),
            false => self,
        }
    }

    /// The same points with the outside of each triangle inside.
    pub(crate) fn mirrored(mut self) -> Self {
        for [_, second, third] in &mut self.triangles {
            std::mem::swap(second, third);
        }
        self
    }

    /// Triangles with the points that they name, of more. `point`: one of `count` points.
    ///
    /// Time and memory are those of the triangles: files have many small meshes of the same points.
    pub(crate) fn of_some(
        triangles: &[[u32; 3]],
        count: usize,
        point: impl Fn(usize) -> DVec3,
    ) -> Result<Self, Problem> {
        let wrong = |cause: String| Err(Problem::Mesh(cause));
        if triangles.is_empty() {
            return wrong("it has no triangle".to_owned());
        }
        let mut part = Part::default();
        for (place, corners) in triangles.iter().enumerate() {
            if corners.iter().any(|corner| *corner as usize >= count) {
                return wrong(format!("triangle {place} names a point beyond the last"));
            }
            let mut points = corners.iter();
            if let Some(corner) = points.find(|corner| !point(**corner as usize).is_finite()) {
                return wrong(format!("point {corner} is not finite"));
            }
            part.add(&point, *corners);
        }
        Ok(part.mesh)
    }

    /// The mesh in parts that a fixed body can have.
    pub(crate) fn parts(self) -> Vec<Self> {
        if self.triangles.len() <= TRIANGLES_MAX && self.points.len() <= MESH_POINTS_MAX {
            return vec![self];
        }
        let mut parts = vec![Part::default()];
        for corners in &self.triangles {
            let last = &parts[parts.len() - 1].mesh;
            if last.triangles.len() == TRIANGLES_MAX || last.points.len() + 3 > MESH_POINTS_MAX {
                parts.push(Part::default());
            }
            let last = parts.len() - 1;
            parts[last].add(&|at| self.points[at], *corners);
        }
        parts.into_iter().map(|part| part.mesh).collect()
    }

    /// The same points with the triangles of their hull; `None` for points in a plane.
    pub(crate) fn with_hull(&self) -> Option<Self> {
        let (least, most) = self.bounds();
        let middle = (least + most) * 0.5;
        let near = self.points.iter().map(|at| (*at - middle).as_vec3());
        let near: Vec<_> = near.collect();
        let places: Vec<_> = match near.len() > SEARCHED_POINTS_MAX {
            true => farthest(&near).into_iter().collect(),
            false => (0..near.len()).collect(),
        };
        let kept: Vec<_> = places.iter().map(|place| near[*place]).collect();
        let triangles = Hull::triangles_of(&kept)?.into_iter();
        let triangles = triangles.map(|corners| corners.map(|at| places[at] as u32));
        Some(Self {
            points: self.points.clone(),
            triangles: triangles.collect(),
        })
    }

    /// Mass by one of MuJoCo's rules, at a density; `None` for one that encloses nothing.
    pub(crate) fn inertia_by(&self, rule: MeshInertia, density: f64) -> Option<Inertia> {
        match rule {
            MeshInertia::Enclosed => self.inertia(density),
            MeshInertia::Surface => {
                let centre = self.surface_centre()?;
                let (mut area, mut second) = (0.0, DMat3::ZERO);
                for [a, b, c] in self.corners_from(centre) {
                    let own = (b - a).cross(c - a).length() * 0.5;
                    let squares = outer(a + b + c) + outer(a) + outer(b) + outer(c);
                    second += squares * (own / 12.0);
                    area += own;
                }
                Some(inertia_of(second * density, area * density, centre))
            }
            MeshInertia::Apart => {
                let around = self.surface_centre()?;
                let (mut volume, mut moment) = (0.0, DVec3::ZERO);
                for [a, b, c] in self.corners_from(around) {
                    let own = a.dot(b.cross(c)).abs() / 6.0;
                    volume += own;
                    moment += (a + b + c) * (own / 4.0);
                }
                self.is_solid(volume).then_some(())?;
                let centre = around + moment / volume;
                let (mut volume, mut second) = (0.0, DMat3::ZERO);
                for [a, b, c] in self.corners_from(centre) {
                    let own = a.dot(b.cross(c)).abs() / 6.0;
                    let squares = outer(a + b + c) + outer(a) + outer(b) + outer(c);
                    second += squares * (own / 20.0);
                    volume += own;
                }
                Some(inertia_of(second * density, volume * density, centre))
            }
        }
    }

    /// The corners of each triangle, from a point.
    fn corners_from(&self, point: DVec3) -> impl Iterator<Item = [DVec3; 3]> {
        let corners =
            move |triangle: &[u32; 3]| triangle.map(|at| self.points[at as usize] - point);
        self.triangles.iter().map(corners)
    }

    /// The centre of the triangles by their areas; `None` for a mesh without area.
    fn surface_centre(&self) -> Option<DVec3> {
        let (mut area, mut moment) = (0.0, DVec3::ZERO);
        for [a, b, c] in self.corners_from(DVec3::ZERO) {
            let own = (b - a).cross(c - a).length();
            area += own;
            moment += (a + b + c) * (own / 3.0);
        }
        (area > 0.0).then(|| moment / area)
    }

    /// True if a volume, m³, is more than rounding of this mesh.
    fn is_solid(&self, volume: f64) -> bool {
        let (least, most) = self.bounds();
        volume > (most - least).element_product() * 1e-6 && volume > 1e-15
    }

    /// Mass of what it encloses, at a density; `None` for one that encloses nothing.
    pub(crate) fn inertia(&self, density: f64) -> Option<Inertia> {
        let (least, most) = self.bounds();
        let middle = (least + most) * 0.5;
        let (mut volume, mut moment, mut second) = (0.0, DVec3::ZERO, DMat3::ZERO);
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|at| self.points[at as usize] - middle);
            let six = a.dot(b.cross(c));
            let sum = a + b + c;
            volume += six / 6.0;
            moment += sum * (six / 24.0);
            let squares = outer(sum) + outer(a) + outer(b) + outer(c);
            second += squares * (six / 120.0);
        }
        self.is_solid(volume.abs()).then_some(())?;
        // A mesh turned inside out weighs as its mirror image.
        let density = density * volume.signum();
        let mass = volume * density;
        let centre = moment / volume;
        let second = second * density - outer(centre) * mass;
        Some(inertia_of(second, mass, centre + middle))
    }

    /// The corners of the least box around it.
    pub(crate) fn bounds(&self) -> (DVec3, DVec3) {
        let first = self.points.first().copied().unwrap_or_default();
        let points = self.points.iter();
        points.fold((first, first), |(least, most), at| {
            (least.min(*at), most.max(*at))
        })
    }
}

/// Some triangles of a mesh, with the points that they name.
#[derive(Default)]
struct Part {
    mesh: TriangleMesh,
    /// The places of the points in the whole mesh, and here.
    places: BTreeMap<u32, u32>,
}

impl Part {
    fn add(&mut self, point: &impl Fn(usize) -> DVec3, corners: [u32; 3]) {
        let own = corners.map(|corner| {
            let next = self.mesh.points.len() as u32;
            *self.places.entry(corner).or_insert_with(|| {
                self.mesh.points.push(point(corner as usize));
                next
            })
        });
        self.mesh.triangles.push(own);
    }
}

/// The mass of a mesh, as MuJoCo has it. Of its hull, too: by the hull's triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum MeshInertia {
    /// That of what it encloses.
    #[default]
    Enclosed,
    /// That of the solids between each triangle and the centre, all counted: more where a mesh is not convex.
    Apart,
    /// That of its triangles, kg/m² for each unit of density.
    Surface,
}

/// Inertia of second moments about the centre.
fn inertia_of(second: DMat3, mass: f64, centre: DVec3) -> Inertia {
    let trace = second.x_axis.x + second.y_axis.y + second.z_axis.z;
    Inertia {
        mass,
        centre,
        tensor: DMat3::from_diagonal(DVec3::splat(trace)) - second,
    }
}

fn outer(arm: DVec3) -> DMat3 {
    DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z)
}

/// A hull of points, and how far a point lies outside of it at most, metres: zero where all corners could be kept.
pub(crate) fn hull(points: &[Vec3]) -> Result<(Hull, f32), Invalid> {
    let mut distinct = points.to_vec();
    distinct.sort_by(|a, b| {
        let orders = a.to_array().into_iter().zip(b.to_array());
        let orders = orders.map(|(a, b)| a.total_cmp(&b));
        orders.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
    });
    distinct.dedup();
    if distinct.len() <= SEARCHED_POINTS_MAX {
        match Hull::new(&distinct) {
            Ok(hull) => return Ok((hull, 0.0)),
            Err(wrong) if distinct.len() <= HULL_POINTS_MAX => return Err(wrong),
            Err(_) => {}
        }
    }
    let kept = farthest(&distinct).into_iter();
    let kept: Vec<_> = kept.map(|place| distinct[place]).collect();
    let hull = Hull::new(&kept)?;
    let loss = |direction: Vec3| support(&distinct, direction) - support(&kept, direction);
    let lost = directions(501).map(loss).fold(0.0, f32::max);
    Ok((hull, lost))
}

/// Places of points that are the farthest in some direction, as many as a hull may have.
fn farthest(points: &[Vec3]) -> BTreeSet<usize> {
    let mut places = BTreeSet::new();
    for count in [96, 255, 677] {
        for direction in directions(count) {
            let far = |a: &usize, b: &usize| {
                points[*a]
                    .dot(direction)
                    .total_cmp(&points[*b].dot(direction))
            };
            if places.len() == HULL_POINTS_MAX {
                break;
            }
            places.extend((0..points.len()).max_by(far));
        }
    }
    places
}

fn support(points: &[Vec3], direction: Vec3) -> f32 {
    points
        .iter()
        .map(|at| at.dot(direction))
        .fold(f32::MIN, f32::max)
}

/// So many unit vectors, spread evenly: a spiral on the sphere.
pub(crate) fn directions(count: u32) -> impl Iterator<Item = Vec3> {
    // The golden angle, radians.
    const TURN: f64 = 2.399_963_229_728_653;
    (0..count).map(move |place| {
        let z = 1.0 - (2.0 * f64::from(place) + 1.0) / f64::from(count);
        let radius = libm::sqrt(1.0 - z * z);
        let angle = TURN * f64::from(place);
        DVec3::new(radius * libm::cos(angle), radius * libm::sin(angle), z).as_vec3()
    })
}

/// Folders above a file that are searched for packages.
const FOLDERS_ABOVE: usize = 12;

/// Points and triangles of all mesh files of a scene together, each size and place of a mesh counted.
const SCENE_ELEMENTS_MAX: usize = 16_000_000;

/// Mesh files of one scene.
///
/// Invariant: a file is read once, and memory is bounded, in however many sizes its mesh is asked for.
pub(crate) struct Meshes<'a> {
    files: &'a dyn Files,
    packages: &'a [String],
    /// Meshes as they are in their files, by paths.
    read: BTreeMap<String, Rc<TriangleMesh>>,
    /// Stretched ones, by names and scales.
    scaled: BTreeMap<String, Rc<TriangleMesh>>,
    /// Their points and triangles, and the most.
    elements: usize,
    most: usize,
}

impl<'a> Meshes<'a> {
    pub(crate) const fn new(files: &'a dyn Files, packages: &'a [String]) -> Self {
        let read = BTreeMap::new();
        let scaled = BTreeMap::new();
        Self {
            files,
            packages,
            read,
            scaled,
            elements: 0,
            most: SCENE_ELEMENTS_MAX,
        }
    }

    /// The mesh that an element names; `None` with a note for one that no file or no reader is there for.
    pub(crate) fn get(
        &mut self,
        element: &Element,
        name: &str,
        scale: DVec3,
        subject: &str,
        report: &mut Report,
    ) -> Result<Option<Rc<TriangleMesh>>, LoadError> {
        let places = self.places(element, name);
        self.first(element, (name, places), scale, subject, report)
    }

    /// The mesh at a path.
    pub(crate) fn get_at(
        &mut self,
        element: &Element,
        path: &str,
        scale: DVec3,
        subject: &str,
        report: &mut Report,
    ) -> Result<Option<Rc<TriangleMesh>>, LoadError> {
        self.first(
            element,
            (path, vec![path.to_owned()]),
            scale,
            subject,
            report,
        )
    }

    /// The mesh at the first of these places that has one.
    fn first(
        &mut self,
        element: &Element,
        (name, places): (&str, Vec<String>),
        scale: DVec3,
        subject: &str,
        report: &mut Report,
    ) -> Result<Option<Rc<TriangleMesh>>, LoadError> {
        let key = format!("{name} {scale}");
        if let Some(mesh) = self.scaled.get(&key) {
            return Ok(Some(mesh.clone()));
        }
        if !is_read(name) {
            let why = "meshes are read from STL, OBJ and MSH files";
            report.add(
                &element.place(),
                subject.to_owned(),
                name.to_owned(),
                Effect::Left,
                why,
            );
            return Ok(None);
        }
        for path in places {
            let read = match self.of_file(&path) {
                Err(Problem::File(FileError::NotFound | FileError::IsFolder)) => continue,
                read => read,
            };
            let mesh = read.and_then(|mesh| self.stretched(&mesh, scale));
            let mesh = mesh.map_err(|problem| LoadError {
                place: Place::of(&path),
                problem,
            })?;
            self.scaled.insert(key, mesh.clone());
            return Ok(Some(mesh));
        }
        let why = "there is no such file; folders of packages can be given";
        report.add(
            &element.place(),
            subject.to_owned(),
            name.to_owned(),
            Effect::Left,
            why,
        );
        Ok(None)
    }

    fn of_file(&mut self, path: &str) -> Result<Rc<TriangleMesh>, Problem> {
        if let Some(known) = self.read.get(path) {
            return Ok(known.clone());
        }
        let mesh = Rc::new(read(self.files, path)?);
        self.claim(&mesh)?;
        self.read.insert(path.to_owned(), mesh.clone());
        Ok(mesh)
    }

    fn stretched(
        &mut self,
        mesh: &Rc<TriangleMesh>,
        scale: DVec3,
    ) -> Result<Rc<TriangleMesh>, Problem> {
        if scale == DVec3::ONE {
            return Ok(mesh.clone());
        }
        self.claim(mesh)?;
        Ok(Rc::new(TriangleMesh::clone(mesh).scaled(scale)))
    }

    /// A mesh in another place.
    pub(crate) fn moved(
        &mut self,
        mesh: &TriangleMesh,
        pose: &Pose,
    ) -> Result<Rc<TriangleMesh>, Problem> {
        self.claim(mesh)?;
        let points = mesh.points.iter();
        Ok(Rc::new(TriangleMesh {
            points: points.map(|point| pose.point(*point)).collect(),
            triangles: mesh.triangles.clone(),
        }))
    }

    /// Counts a mesh before memory is taken for another size or place of it.
    fn claim(&mut self, mesh: &TriangleMesh) -> Result<(), Problem> {
        self.elements += mesh.points.len() + mesh.triangles.len();
        let what = "points and triangles of all meshes in all sizes and places";
        Problem::bound(what, self.elements, self.most)
    }

    /// The paths that a file of this name may have, the likeliest first.
    fn places(&self, element: &Element, name: &str) -> Vec<String> {
        let file = element.place().file;
        let folder = folder_of(&file);
        if let Some(path) = name.strip_prefix("file://") {
            return vec![join(folder, path)];
        }
        let package = ["package://", "model://", "$(find "];
        let Some(rest) = package.iter().find_map(|begin| name.strip_prefix(begin)) else {
            return vec![join(folder, name)];
        };
        let rest = rest.replacen(')', "", 1);
        let inner = rest.split_once('/').map_or("", |(_, inner)| inner);
        let mut above = folder.to_owned();
        let mut roots = self.packages.to_vec();
        for _ in 0..FOLDERS_ABOVE {
            roots.push(above.clone());
            let next = join(&above, "..");
            if next == above {
                break;
            }
            above = next;
        }
        let both = |root: &String| [join(root, &rest), join(root, inner)];
        roots.iter().flat_map(both).collect()
    }
}

#[cfg(test)]
mod tests;
