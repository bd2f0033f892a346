//! Meshes of each format: read, weighed, cut, and refused by name.

use super::*;
use crate::files::MemoryFiles;

/// A box of 1 × 2 × 3 m whose least corner is at (1, 0, 0), with faces of four corners.
const BOX: &str = "v 1 0 0\nv 2 0 0\nv 2 2 0\nv 1 2 0\nv 1 0 3\nv 2 0 3\nv 2 2 3\nv 1 2 3\n\
    f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

fn read_text(path: &str, bytes: &[u8]) -> Result<TriangleMesh, Problem> {
    let mut files = MemoryFiles::default();
    files.insert(path, bytes);
    read(&files, path)
}

fn binary(mesh: &TriangleMesh, head: &[u8]) -> Vec<u8> {
    let mut bytes = head.to_vec();
    bytes.resize(80, 0);
    bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
    for triangle in &mesh.triangles {
        bytes.extend([0; 12]);
        for at in triangle {
            let point = mesh.points[*at as usize].as_vec3().to_array();
            bytes.extend(point.into_iter().flat_map(f32::to_le_bytes));
        }
        bytes.extend([0; 2]);
    }
    bytes
}

/// A triangle as OBJ, under any name; counts how often it is read.
#[derive(Default)]
struct Counted(std::cell::Cell<u32>);

impl Files for Counted {
    fn read(&self, _: &str, _: usize) -> Result<Vec<u8>, FileError> {
        self.0.set(self.0.get() + 1);
        Ok(b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".to_vec())
    }
}

#[test]
fn a_mesh_in_many_sizes_is_read_once_and_bounded() {
    let files = Counted::default();
    let element = crate::xml::parse("a.urdf", "<mesh/>").expect("an element");
    let mut report = Report::default();
    let mut meshes = Meshes::new(&files, &[]);
    // Three points and a triangle as they are, twice, and twice in another size.
    meshes.most = 12;
    let mut sized = |size: f64| {
        let scale = DVec3::splat(size);
        let mesh = meshes.get_at(&element, "a.obj", scale, "mesh", &mut report);
        mesh.map(|mesh| mesh.expect("a file").points[1].x)
    };
    for size in [1.0, 2.0, 1.0, 3.0, 2.0] {
        assert_eq!(sized(size), Ok(size));
    }
    let refused = sized(4.0).expect_err("sixteen").to_string();
    let words = "a.obj: the number of points and triangles of all meshes in all sizes and places is 16 or more, and at most 12 are read";
    assert_eq!(refused, words);
    assert_eq!(files.0.get(), 1);
    let mesh = TriangleMesh::default();
    assert!(meshes.moved(&mesh, &Pose::IDENTITY).is_err(), "it is full");
}

#[test]
fn a_mesh_of_mujocos_own_form_is_read_and_its_cuts_are_refused() {
    let mut bytes: Vec<u8> = [4_u32, 4, 4, 4]
        .into_iter()
        .flat_map(u32::to_le_bytes)
        .collect();
    let corners = [
        [0.0_f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 2.0, 0.0],
        [0.0, 0.0, 3.0],
    ];
    let normals = [[0.0_f32, 0.0, 1.0]; 4];
    let places = [[0.5_f32, 0.5]; 4];
    let faces = [[0_u32, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
    let numbers = corners
        .iter()
        .chain(&normals)
        .flatten()
        .chain(places.iter().flatten());
    bytes.extend(numbers.flat_map(|number| number.to_le_bytes()));
    bytes.extend(
        faces
            .iter()
            .flatten()
            .flat_map(|corner| corner.to_le_bytes()),
    );
    let mut files = MemoryFiles::default();
    files.insert("m.msh", bytes.clone());
    let mesh = read(&files, "m.msh").expect("a tetrahedron");
    assert_eq!((mesh.points.len(), mesh.triangles.len()), (4, 4));
    assert_eq!(mesh.points[3], DVec3::new(0.0, 0.0, 3.0));
    assert_eq!(mesh.triangles[0], [0, 2, 1]);
    for cut in 0..bytes.len() {
        files.insert("m.msh", &bytes[..cut]);
        assert!(read(&files, "m.msh").is_err(), "{cut}");
    }
    // Counts beyond the file, and a corner beyond the points.
    for (at, with) in [(0, u32::MAX), (12, u32::MAX), (8, 3), (bytes.len() - 4, 4)] {
        let mut wrong = bytes.clone();
        wrong[at..at + 4].copy_from_slice(&with.to_le_bytes());
        files.insert("m.msh", wrong);
        assert!(read(&files, "m.msh").is_err(), "{at}");
    }
}

/// Two boxes, which make an L; masses, centres and moments are those of MuJoCo 4.0.0.
#[test]
fn a_mesh_that_is_not_convex_weighs_by_mujocos_rules() {
    let (mut points, mut triangles) = (Vec::new(), Vec::new());
    for (centre, half) in [
        (DVec3::ZERO, DVec3::new(1.0, 0.1, 0.1)),
        (DVec3::new(0.9, 0.0, 1.1), DVec3::new(0.1, 0.1, 1.0)),
    ] {
        let first = points.len() as u32;
        let sign = |at: u32, bit: u32| f64::from(at >> bit & 1) * 2.0 - 1.0;
        let corner = |at| centre + half * DVec3::new(sign(at, 2), sign(at, 1), sign(at, 0));
        points.extend((0..8).map(corner));
        for [a, b, c, d] in [
            [0, 1, 3, 2],
            [4, 6, 7, 5],
            [0, 4, 5, 1],
            [2, 3, 7, 6],
            [0, 2, 6, 4],
            [1, 5, 7, 3],
        ] {
            triangles.extend([[a, b, c], [a, c, d]].map(|own| own.map(|at: u32| at + first)));
        }
    }
    let mesh = TriangleMesh { points, triangles };
    let hull = mesh.with_hull().expect("it has volume");
    for (mesh, rule, mass, centre, moments) in [
        (
            &mesh,
            MeshInertia::Enclosed,
            160.0,
            [0.45, 0.55],
            [27.466_67, 108.266_67, 134.666_67],
        ),
        (
            &mesh,
            MeshInertia::Apart,
            383.333_33,
            [0.407_142_86, 0.544_642_86],
            [50.878_465, 185.659_48, 234.577_94],
        ),
        (
            &mesh,
            MeshInertia::Surface,
            3_360.0,
            [0.45, 0.55],
            [646.133_33, 2_342.933_33, 2_945.333_33],
        ),
        (
            &hull,
            MeshInertia::Enclosed,
            520.0,
            [0.276_923_08, 0.7],
            [76.384_81, 218.671_58, 291.589_72],
        ),
    ] {
        let own = mesh.inertia_by(rule, 1_000.0).expect("it has mass");
        assert!((own.mass / mass - 1.0).abs() < 1e-6, "{rule:?}: {own:?}");
        let off = own.centre - DVec3::new(centre[0], 0.0, centre[1]);
        assert!(off.length() < 1e-6, "{rule:?}: {own:?}");
        let mut found = own.principal().0.to_array();
        found.sort_by(f64::total_cmp);
        let off = DVec3::from_array(found) / DVec3::from_array(moments) - 1.0;
        assert!(off.abs().max_element() < 1e-6, "{rule:?}: {found:?}");
    }
}

#[test]
fn a_box_weighs_and_turns_as_a_box_in_either_format() {
    let mesh = read_text("a.OBJ", BOX.as_bytes()).expect("a box");
    let again = read_text("a.stl", &binary(&mesh, b"solid of a binary file")).expect("a box");
    for mesh in [mesh.clone(), again, mesh.scaled(DVec3::new(-1.0, 1.0, 1.0))] {
        let inertia = mesh.inertia(2.0).expect("it is closed");
        assert!((inertia.mass - 12.0).abs() < 1e-6);
        assert!((inertia.centre.abs() - DVec3::new(1.5, 1.0, 1.5)).length() < 1e-6);
        let (moments, _) = inertia.principal();
        assert!(
            (moments - DVec3::new(13.0, 10.0, 5.0)).length() < 1e-5,
            "{moments}"
        );
    }
}

#[test]
fn cut_and_senseless_meshes_are_refused_with_the_reason() {
    let mesh = read_text("a.obj", BOX.as_bytes()).expect("a box");
    let whole = binary(&mesh, b"");
    let mut nan = whole.clone();
    nan[96..100].copy_from_slice(&f32::NAN.to_le_bytes());
    let mut many = whole.clone();
    many[80..84].copy_from_slice(&u32::MAX.to_le_bytes());
    for bytes in [
        &whole[..whole.len() - 7],
        &whole[..50],
        &nan,
        &many,
        b"",
        b"solid",
    ] {
        let refused = read_text("a.stl", bytes);
        assert!(refused.is_err(), "{refused:?}");
    }
    for text in [
        "v 1 2\nf 1 2 3",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9",
        "v nan 0 0\n",
        "f 1 1 1",
    ] {
        let refused = read_text("a.obj", text.as_bytes());
        assert!(refused.is_err(), "{text}: {refused:?}");
    }
}

#[test]
fn a_ball_of_many_corners_becomes_a_hull_of_few_and_says_what_is_lost() {
    let points: Vec<_> = directions(3_000).collect();
    let (ball, lost) = hull(&points).expect("a ball");
    assert!(ball.points().len() <= HULL_POINTS_MAX && ball.points().len() > 200);
    assert!((0.001..0.05).contains(&lost), "{lost}");
    let (_, lost) = hull(&points[..200]).expect("a part of it");
    assert_eq!(lost, 0.0);
}

#[test]
fn continued_lines_and_colours_of_some_points_are_read() {
    for text in [
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 \\\n4\n",
        "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 4\n",
        "v 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nv 0 \\\n0 1\nf -4 -3 -2 -1\n",
    ] {
        let Surface { points, triangles } = obj(text.as_bytes()).expect(text);
        assert_eq!((points.len(), triangles.len()), (4, 2), "{text}");
        assert_eq!(points[3], DVec3::Z);
    }
}

#[test]
fn a_wrong_line_is_named() {
    for (text, words) in [
        (
            "v 0 0 0\n\nv 1 2\n",
            "line 3 \"v 1 2\": three numbers are missing",
        ),
        (
            "v 0 0 \\\nx\n",
            "line 1 \"v 0 0 x\": three numbers are missing",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
            "line 4 \"f 1 2 9\": there is no point 9, and there are 3",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n",
            "line 4 \"f 1 2 -9\": there is no point -9, and there are 3",
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 a 2\n",
            "line 4 \"f 1 a 2\": \"a\" is no number of a point",
        ),
    ] {
        assert_eq!(obj(text.as_bytes()), Err(Problem::Mesh(words.to_owned())));
    }
}
