//! glTF: places, masses, physics, and files that are refused by name.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Shape};

use super::*;
use crate::assemble::LoadedScene;
use crate::files::MemoryFiles;
use crate::load::{load, load_text};
use crate::model::{Base, UpAxis};

mod joints;
mod unread;

/// Corners of a tetrahedron with a corner at the origin and edges of 1 m, and its four triangles.
const CORNERS: [[f32; 3]; 4] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
];
const FACES: [[u16; 3]; 4] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];

/// The bytes of the tetrahedron: 48 of corners, 24 of indices.
fn solid() -> Vec<u8> {
    let corners = CORNERS
        .iter()
        .flatten()
        .flat_map(|number| number.to_le_bytes());
    let faces = FACES
        .iter()
        .flatten()
        .flat_map(|number| number.to_le_bytes());
    corners.chain(faces).collect()
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for three in bytes.chunks(3) {
        let word = |at: usize| u32::from(three.get(at).copied().unwrap_or_default());
        let all = word(0) << 16 | word(1) << 8 | word(2);
        for place in 0..=three.len() {
            text.push(char::from(LETTERS[(all >> (18 - 6 * place) & 63) as usize]));
        }
    }
    text
}

/// A file with the tetrahedron as mesh 0, its buffer as said, and these nodes and other parts.
fn file_with(buffer: &str, nodes: &str, rest: &str) -> String {
    format!(
        r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{{buffer} "byteLength": 72}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 48}}, {{"buffer": 0, "byteOffset": 48, "byteLength": 24}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"}},
            {{"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}}],
        "meshes": [{{"name": "tetra", "primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 1}}]}}],
        "nodes": [{nodes}]{rest}}}"#
    )
}

fn file(nodes: &str, rest: &str) -> String {
    let uri = format!(
        r#""uri": "data:application/octet-stream;base64,{}","#,
        base64(&solid())
    );
    file_with(&uri, nodes, rest)
}

fn read_text(text: &str) -> Result<LoadedScene, LoadError> {
    load_text(
        &MemoryFiles::default(),
        "a.gltf",
        text,
        &LoadOptions::default(),
    )
}

fn plain(text: &str) -> LoadedScene {
    read_text(text).expect("a scene")
}

fn refused(text: &str) -> String {
    read_text(text).expect_err("no scene").to_string()
}

fn points(scene: &LoadedScene, body: usize) -> Vec<Vec3> {
    let desc = &scene.bodies[body].builder;
    let state = desc.state().expect("a state");
    let [x, y, z] = state.position();
    let turn = Quat::from_array(state.rotation());
    let points = match desc.shape() {
        Shape::Mesh(mesh) => mesh.points().to_vec(),
        other => panic!("{other:?} is no mesh"),
    };
    points
        .into_iter()
        .map(|point| Vec3::new(x, y, z) + turn * point)
        .collect()
}

#[test]
fn a_mesh_stands_where_its_nodes_put_it() {
    let nodes = r#"{"name": "above", "translation": [10, 0, 0], "rotation": [0, 0, 0.70710678, 0.70710678], "children": [1]},
        {"name": "rock", "translation": [1, 0, 0], "scale": [2, 3, -4], "mesh": 0}"#;
    let scene = plain(&file(nodes, ""));
    assert_eq!(scene.bodies.len(), 1);
    assert_eq!(
        (
            scene.bodies[0].name.as_str(),
            scene.bodies[0].builder.kind()
        ),
        ("rock", BodyKind::Fixed)
    );
    // A quarter turn about z: x becomes y, and y becomes -x.
    let expected = [
        [10.0, 1.0, 0.0],
        [10.0, 3.0, 0.0],
        [7.0, 1.0, 0.0],
        [10.0, 1.0, -4.0],
    ];
    for (point, expected) in points(&scene, 0).iter().zip(expected) {
        assert!(
            (*point - Vec3::from_array(expected)).length() < 1e-5,
            "{point} {expected:?}"
        );
    }
    // The mirrored solid keeps its outside outside.
    let Shape::Mesh(mesh) = scene.bodies[0].builder.shape() else {
        panic!("a mesh");
    };
    assert_eq!(mesh.triangles()[0], [0, 1, 2]);
    assert_eq!(scene.config.gravity, Vec3::new(0.0, -9.80665, 0.0));
    assert!(scene.report.is_empty(), "{:?}", scene.report);

    let matrix = r#"{"name": "rock", "matrix": [0, 2, 0, 0, -3, 0, 0, 0, 0, 0, -4, 0, 10, 1, 0, 1], "mesh": 0}"#;
    let same = plain(&file(matrix, ""));
    for (a, b) in points(&scene, 0).iter().zip(points(&same, 0)) {
        assert!((*a - b).length() < 1e-5, "{a} {b}");
    }
}

#[test]
fn up_is_y_whatever_the_scene_asks_for() {
    let text = file(r#"{"mesh": 0, "translation": [0, 5, 0]}"#, "");
    for (up, base) in [(UpAxis::AsFile, Base::AsFile), (UpAxis::Y, Base::Free)] {
        let options = LoadOptions {
            up,
            base,
            ..LoadOptions::default()
        };
        let scene = load_text(&MemoryFiles::default(), "a.gltf", &text, &options).expect("a scene");
        assert_eq!(points(&scene, 0)[0], Vec3::new(0.0, 5.0, 0.0));
        assert!(scene.config.gravity.y < -9.0);
    }
}

#[test]
fn the_mass_of_extras_makes_one_body_of_a_node_and_those_below() {
    let nodes = r#"{"name": "toy", "translation": [0, 3, 0], "extras": {"mass": 2.5, "colour": "red"}, "mesh": 0, "children": [1]},
        {"name": "hat", "translation": [0, 1, 0], "mesh": 0}"#;
    let scene = plain(&file(nodes, ""));
    assert_eq!(scene.bodies.len(), 1);
    let toy = &scene.bodies[0];
    assert_eq!(toy.builder.kind(), BodyKind::Dynamic);
    // The centre of a tetrahedron is a quarter of the way along each edge; of two, one a metre higher, between them.
    let centre = Vec3::from_array(toy.builder.state().expect("a state").position());
    assert!(
        (centre - Vec3::new(0.25, 3.75, 0.25)).length() < 1e-5,
        "{centre}"
    );
    assert!(
        matches!(toy.builder.shape(), Shape::Compound(compound) if compound.parts().len() == 2)
    );
    let notes: Vec<String> = scene
        .report
        .notes()
        .iter()
        .map(ToString::to_string)
        .collect();
    assert!(
        notes.len() == 1 && notes[0].contains("extras colour"),
        "{notes:?}"
    );
}

#[test]
fn a_binary_file_and_one_beside_its_buffer_are_the_same_scene() {
    let nodes = r#"{"name": "rock", "mesh": 0}"#;
    let inline = plain(&file(nodes, ""));
    let mut files = MemoryFiles::default();
    files.insert(
        "models/a.gltf",
        file_with(r#""uri": "my%20rock.bin","#, nodes, ""),
    );
    files.insert("models/my rock.bin", solid());
    files.insert("models/a.glb", binary(&file_with("", nodes, "")));
    for path in ["models/a.gltf", "models/a.glb"] {
        let scene = load(&files, path, &LoadOptions::default()).expect("a scene");
        assert_eq!(scene.bodies[0].builder, inline.bodies[0].builder, "{path}");
    }
}

#[test]
fn only_the_first_buffer_of_a_binary_file_has_its_bytes() {
    let text = file_with("", r#"{"mesh": 0}"#, "");
    let second = text
        .replacen(
            r#""byteLength": 72}]"#,
            r#""byteLength": 72}, {"byteLength": 72}]"#,
            1,
        )
        .replacen(
            r#""buffer": 0, "byteOffset""#,
            r#""buffer": 1, "byteOffset""#,
            1,
        );
    let mut files = MemoryFiles::default();
    files.insert("a.glb", binary(&second));
    let refused = load(&files, "a.glb", &LoadOptions::default()).expect_err("no bytes");
    let words = "accessor 1 is in buffer 1, which has no uri";
    assert!(refused.to_string().contains(words), "{refused}");
    let refused = read_text(&text).expect_err("no bytes").to_string();
    assert!(
        refused.contains("accessor 0 is in buffer 0, which has no uri"),
        "{refused}"
    );
}

#[test]
fn points_that_no_triangle_names_are_not_read() {
    // Seven tetrahedra in a row of points whose last one is none; each primitive names the first four.
    let mut bytes = Vec::new();
    (0..7).for_each(|_| bytes.extend_from_slice(&solid()[..48]));
    bytes[27 * 12..][..4].copy_from_slice(&f32::NAN.to_le_bytes());
    bytes.extend_from_slice(&solid()[48..]);
    let primitive = r#"{"attributes": {"POSITION": 0}, "indices": 1}"#;
    let text = file_with(r#""uri": "p.bin","#, r#"{"mesh": 0}"#, "")
        .replace(r#""byteLength": 48}"#, r#""byteLength": 336}"#)
        .replace(r#""byteOffset": 48"#, r#""byteOffset": 336"#)
        .replace(r#""byteLength": 72"#, r#""byteLength": 360"#)
        .replace(r#""count": 4"#, r#""count": 28"#)
        .replace(primitive, &[primitive; 3].join(","));
    let read = |text: &str, bytes: &[u8]| {
        let mut files = MemoryFiles::default();
        files.insert("p.bin", bytes);
        load_text(&files, "a.gltf", text, &LoadOptions::default())
    };
    let scene = read(&text, &bytes).expect("its points are finite");
    assert_eq!(scene.bodies.len(), 3);
    assert_eq!(points(&scene, 2).len(), 4);
    bytes[336] = 27;
    let refused = read(&text, &bytes).expect_err("not finite").to_string();
    assert!(
        refused.contains("tetra: point 27 is not finite"),
        "{refused}"
    );
    bytes[336] = 28;
    let refused = read(&text, &bytes).expect_err("beyond").to_string();
    assert!(
        refused.contains("tetra: triangle 0 names a point beyond the last"),
        "{refused}"
    );
}

#[test]
fn triangles_that_many_primitives_name_are_counted_before_they_are_read() {
    // A primitive of 600 points, whose last index is beyond them: reading it would be the error.
    let primitive = r#"{"attributes": {"POSITION": 0}, "mode": 5}"#;
    let first = r#"{"attributes": {"POSITION": 0}, "mode": 6, "indices": 1}"#;
    let bytes: Vec<u8> = (0..600_u16)
        .flat_map(|place| [f32::from(place), f32::from(place % 7), 0.0])
        .flat_map(f32::to_le_bytes)
        .collect();
    let all = [&[primitive; 3_400][..], &[first]].concat();
    let text = format!(
        r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"uri": "p.bin", "byteLength": 7200}}],
        "bufferViews": [{{"buffer": 0, "byteLength": 7200}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": 600, "type": "VEC3"}},
            {{"bufferView": 0, "componentType": 5125, "count": 600, "type": "SCALAR"}}],
        "meshes": [{{"primitives": [{}]}}], "nodes": [{{"mesh": 0}}]}}"#,
        all.join(",")
    );
    let mut files = MemoryFiles::default();
    files.insert("p.bin", bytes);
    let refused =
        load_text(&files, "a.gltf", &text, &LoadOptions::default()).expect_err("too many");
    let words =
        "the number of triangles of all meshes is 2000310 or more, and at most 2000000 are read";
    assert!(refused.to_string().contains(words), "{refused}");
}

/// A binary file of a text and the tetrahedron.
fn binary(text: &str) -> Vec<u8> {
    let mut text = text.as_bytes().to_vec();
    text.resize(text.len().next_multiple_of(4), b' ');
    let data = solid();
    let mut bytes = MAGIC.to_vec();
    let whole = 12 + 8 + text.len() + 8 + data.len();
    for word in [2, whole as u32, text.len() as u32, 0x4e4f_534a] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(text);
    for word in [data.len() as u32, 0x004e_4942] {
        bytes.extend(word.to_le_bytes());
    }
    bytes.extend(data);
    bytes
}

#[test]
fn strips_fans_and_meshes_without_indices_are_triangles() {
    let nodes = r#"{"mesh": 0}"#;
    let triangles = |from: &str, to: &str| {
        let scene = plain(&file(nodes, "").replace(from, to));
        let Some(Shape::Mesh(mesh)) = scene.bodies.first().map(|body| body.builder.shape()) else {
            return Vec::new();
        };
        mesh.triangles().to_vec()
    };
    assert_eq!(triangles(r#", "indices": 1}"#, "}"), [[0, 1, 2]]);
    assert_eq!(
        triangles(r#", "indices": 1}"#, r#", "mode": 5}"#),
        [[0, 1, 2], [2, 1, 3]]
    );
    assert_eq!(
        triangles(r#", "indices": 1}"#, r#", "mode": 6}"#),
        [[0, 1, 2], [0, 2, 3]]
    );
    assert_eq!(
        triangles(r#", "indices": 1}"#, r#", "mode": 1}"#),
        [[0; 3]; 0]
    );
}

#[test]
fn bodies_and_colliders_of_the_physics_extension_are_bodies() {
    let nodes = r#"
        {"name": "floor", "mesh": 0, "translation": [0, -1, 0], "extensions": {"KHR_physics_rigid_bodies": {"collider":
            {"geometry": {"shape": 0}, "physicsMaterial": 0}}}},
        {"name": "can", "translation": [0, 4, 0], "scale": [2, 2, 2], "children": [2], "extensions": {"KHR_physics_rigid_bodies":
            {"motion": {"mass": 3, "inertiaDiagonal": [1, 2, 1.5], "centerOfMass": [0, 0.5, 0], "linearVelocity": [1, 0, 0]}}}},
        {"name": "side", "extensions": {"KHR_physics_rigid_bodies": {"collider": {"geometry": {"shape": 1}}}}},
        {"name": "gem", "translation": [9, 0, 0], "extensions": {"KHR_physics_rigid_bodies": {"motion": {"mass": 1},
            "collider": {"geometry": {"mesh": 0, "convexHull": true}}}}}"#;
    let rest = r#", "extensionsUsed": ["KHR_physics_rigid_bodies", "KHR_implicit_shapes", "KHR_materials_unlit"], "extensions": {
        "KHR_physics_rigid_bodies": {"physicsMaterials": [{"dynamicFriction": 0.8, "restitution": 0.5}]},
        "KHR_implicit_shapes": {"shapes": [{"type": "box", "box": {"size": [20, 1, 20]}},
            {"type": "cylinder", "cylinder": {"height": 1, "radiusBottom": 0.2, "radiusTop": 0.2}}]}}"#;
    let scene = plain(&file(nodes, rest));
    let kinds: Vec<_> = scene
        .bodies
        .iter()
        .map(|body| (body.name.as_str(), body.builder.kind()))
        .collect();
    let (fixed, dynamic) = (BodyKind::Fixed, BodyKind::Dynamic);
    assert_eq!(
        kinds,
        [("floor", fixed), ("can", dynamic), ("gem", dynamic)]
    );
    let half_extents = Vec3::new(10.0, 0.5, 10.0);
    assert_eq!(
        *scene.bodies[0].builder.shape(),
        Shape::Cuboid { half_extents }
    );
    // Its centre is half a metre above its node, and its cylinder of twice the size lies along y.
    let can = &scene.bodies[1];
    assert_eq!(
        can.builder.state().expect("a state").position(),
        [0.0, 4.5, 0.0]
    );
    let Shape::Compound(compound) = can.builder.shape() else {
        panic!("a compound");
    };
    let part = &compound.parts()[0];
    assert_eq!(part.position, Vec3::new(0.0, -0.5, 0.0));
    assert_eq!(part.shape, Shape::cylinder(1.0, 0.4));
    let along = part.rotation * Vec3::Y;
    assert!(along.y.abs() > 0.999, "{along}");
    assert!(matches!(
        scene.bodies[2].builder.shape(),
        Shape::Hull(_) | Shape::Compound(_)
    ));
    let notes: String = scene
        .report
        .notes()
        .iter()
        .map(|note| format!("{note}\n"))
        .collect();
    for part in [
        "mesh left out",
        "velocity left out",
        "restitution left out",
        "extension KHR_materials_unlit",
    ] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
}

#[test]
fn what_a_scene_has_not_is_listed() {
    let nodes = r#"{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {}}}, {"mesh": 0}"#;
    let rest = r#", "animations": [{}, {}], "skins": [{}], "cameras": [{}], "materials": [{}],
        "extensionsRequired": ["KHR_draco_mesh_compression"], "scenes": [{"name": "one", "nodes": [0]}, {"nodes": [1]}]"#;
    let scene = plain(&file(nodes, rest));
    assert_eq!((scene.bodies.len(), scene.name.as_str()), (1, "one"));
    let notes: String = scene
        .report
        .notes()
        .iter()
        .map(|note| format!("{note}\n"))
        .collect();
    for part in [
        "a.gltf: animation left out and 1 more",
        "skin left out",
        "cameras, materials and pictures left out and 1 more",
        "extension KHR_draco_mesh_compression left out: the file requires it",
        "extension EXT_mesh_gpu_instancing left out",
        "scene left out",
    ] {
        assert!(notes.contains(part), "{part}: {notes}");
    }
    let packed = file(nodes, "").replace(
        r#"{"bufferView": 0, "componentType""#,
        r#"{"componentType""#,
    );
    let scene = plain(&packed);
    let mut notes = scene.report.notes().iter().map(ToString::to_string);
    assert!(notes.any(|note| note.contains("packed by an extension")));
}

/// Refuses each text by the words beside it.
fn refuse(cases: &[(String, &str)]) {
    for (text, words) in cases {
        let said = refused(text);
        assert!(said.contains(words), "{words}: {said}");
    }
}

#[test]
fn wrong_points_and_cut_texts_are_refused() {
    let whole = file(r#"{"name": "rock", "mesh": 0}"#, "");
    let nan = {
        let mut bytes = solid();
        bytes[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
        whole.replace(&base64(&solid()), &base64(&bytes))
    };
    let beyond = {
        let mut bytes = solid();
        bytes[48] = 9;
        whole.replace(&base64(&solid()), &base64(&bytes))
    };
    refuse(&[
        (
            nan,
            "a.gltf: the mesh cannot be read: tetra: point 1 is not finite",
        ),
        (beyond, "triangle 0 names a point beyond the last"),
        (
            whole[..whole.len() - 9].to_owned(),
            "the text is not well formed",
        ),
    ]);
}

#[test]
fn wrong_bytes_are_refused_by_the_name_of_their_buffer_or_accessor() {
    let whole = file(r#"{"name": "rock", "mesh": 0}"#, "");
    for (from, to, words) in [
        (
            r#""byteLength": 72"#,
            r#""byteLength": 73"#,
            "buffer 0 says 73 bytes and holds 72: it is cut",
        ),
        (
            r#""count": 12"#,
            r#""count": 13"#,
            "accessor 1 claims more elements than its view holds",
        ),
        (
            r#""count": 12"#,
            r#""count": 18446744073709551615"#,
            "accessor 1 claims more elements",
        ),
        (
            r#""count": 4"#,
            r#""count": 4, "byteOffset": 12"#,
            "accessor 0 claims more elements",
        ),
        (
            r#""byteLength": 24"#,
            r#""byteLength": 25"#,
            "accessor 1 has a view beyond its buffer",
        ),
        (
            r#""byteOffset": 48"#,
            r#""byteStride": 1"#,
            "accessor 1 has a stride below",
        ),
        (
            r#""bufferView": 1"#,
            r#""bufferView": 7"#,
            "accessor 1 names a view beyond the last",
        ),
        (
            r#""componentType": 5126"#,
            r#""componentType": 5125"#,
            "accessor 0 is VEC3 of component type 5125, and positions are VEC3 of 5126",
        ),
        (
            r#""componentType": 5123"#,
            r#""componentType": 5126"#,
            "accessor 1 has components of type 5126",
        ),
        (
            r#""indices": 1"#,
            r#""indices": 5"#,
            "it names accessor 5, and has 2",
        ),
        (
            "2.0",
            "1.0",
            "glTF of version \"1.0\" is no file that is read here",
        ),
        (
            r#""version": "2.0""#,
            r#""version": "2.5", "minVersion": "2.5""#,
            "glTF that needs version \"2.5\" is no file that is read here",
        ),
        (";base64", ";base63", "buffer 0: its data are no base64"),
    ] {
        refuse(&[(whole.replacen(from, to, 1), words)]);
    }
}

#[test]
fn wrong_nodes_are_refused_by_their_name() {
    let nodes = |nodes: &str| file(nodes, "");
    refuse(&[
        (
            nodes(r#"{"mesh": 3}"#),
            "a node names mesh 3, and there are 1",
        ),
        (
            file(
                r#"{"name": "a", "children": [1]}, {"children": [0]}"#,
                r#", "scenes": [{"nodes": [0]}]"#,
            ),
            "a: it hangs on two nodes, or on itself",
        ),
        (nodes(r#"{"children": [9]}"#), "it names node 9, and has 1"),
        (
            nodes(r#"{"name": "a", "rotation": [0, 0, 0, 0]}"#),
            "a: its rotation is no quaternion",
        ),
        (
            nodes(
                r#"{"name": "a", "translation": [1e300, 0, 0], "scale": [1e300, 1, 1], "mesh": 0}"#,
            ),
            "a.gltf",
        ),
        (
            nodes(r#"{"name": "a", "translation": ["x", 0, 0]}"#),
            "a.gltf:",
        ),
        (file("", r#", "scene": 2"#), "it names scene 2, and has 0"),
        (
            nodes(&vec!["{}"; 131_073].join(",")),
            "the number of nodes is 131073",
        ),
    ]);
    // Nodes in a ring hang on no root.
    refuse(&[(
        nodes(r#"{"mesh": 0}, {"name": "a", "children": [2]}, {"children": [1]}"#),
        "a: it hangs on two nodes, or on itself",
    )]);
}

/// The notes of a scene, one a line.
fn noted(scene: &LoadedScene) -> String {
    let notes = scene.report.notes().iter();
    notes.map(|note| format!("{note}\n")).collect()
}

/// A node with this collider, and one without a mesh.
fn with_collider(collider: &str) -> String {
    let nodes = format!(
        r#"{{"name": "a", "extensions": {{"KHR_physics_rigid_bodies": {{"collider": {collider}}}}}}}, {{"name": "b"}}"#
    );
    let rest = r#", "extensions": {"KHR_physics_rigid_bodies": {"physicsMaterials": [{"dynamicFriction": 0.5}]},
        "KHR_implicit_shapes": {"shapes": [{"type": "box"}]}}"#;
    file(&nodes, rest)
}

#[test]
fn a_collider_that_leads_nowhere_is_refused_or_noted() {
    refuse(&[
        (
            with_collider(r#"{"geometry": {"node": 99}}"#),
            "the collider of a names node 99, and there are 2",
        ),
        (
            with_collider(r#"{"geometry": {"mesh": 99}}"#),
            "a node names mesh 99, and there are 1",
        ),
        (
            with_collider(r#"{"geometry": {"shape": 99}}"#),
            "a names shape 99, and there are 1",
        ),
        (
            with_collider(r#"{"geometry": {"shape": 0}, "physicsMaterial": 99}"#),
            "the collider of a names physics material 99, and there are 1",
        ),
    ]);
    for (geometry, words) in [
        ("{}", "collider left out: it names no shape, mesh or node"),
        (
            r#"{"node": 1}"#,
            "collider left out: the node that it names has no mesh",
        ),
    ] {
        let scene = plain(&with_collider(&format!(r#"{{"geometry": {geometry}}}"#)));
        assert!(scene.bodies.is_empty());
        assert!(noted(&scene).contains(words), "{}", noted(&scene));
    }
}

#[test]
fn a_mass_that_is_none_is_noted() {
    for mass in ["-1", "0", "\"5\"", "true"] {
        let nodes = format!(r#"{{"mesh": 0, "extras": {{"mass": {mass}}}}}"#);
        let scene = plain(&file(&nodes, ""));
        assert_eq!(scene.bodies[0].builder.kind(), BodyKind::Fixed);
        let notes = noted(&scene);
        assert!(notes.contains("extras mass left out"), "{mass}: {notes}");
    }
    for (motion, words) in [
        (r#""mass": -1"#, "mass below zero left out"),
        (
            r#""mass": 1, "inertiaDiagonal": [1, -1, 1]"#,
            "moments of inertia below zero left out",
        ),
        (
            r#""mass": 1, "inertiaOrientation": [0, 0, 0, 0]"#,
            "inertia orientation left out",
        ),
    ] {
        let nodes = format!(
            r#"{{"extensions": {{"KHR_physics_rigid_bodies": {{"motion": {{{motion}}},
            "collider": {{"geometry": {{"mesh": 0}}}}}}}}}}"#
        );
        let notes = noted(&plain(&file(&nodes, "")));
        assert!(notes.contains(words), "{words}: {notes}");
    }
}

#[test]
fn a_kinematic_node_below_one_that_moves_is_no_part_of_it() {
    let nodes = r#"
        {"name": "cart", "children": [1], "extensions": {"KHR_physics_rigid_bodies": {"motion": {"mass": 1},
            "collider": {"geometry": {"shape": 0}}}}},
        {"name": "lift", "translation": [0, 5, 0], "children": [2], "extensions": {"KHR_physics_rigid_bodies":
            {"motion": {"isKinematic": true}, "collider": {"geometry": {"shape": 0}}}}},
        {"name": "rail", "translation": [0, 5, 0], "extensions": {"KHR_physics_rigid_bodies":
            {"collider": {"geometry": {"shape": 0}}}}}"#;
    let rest = r#", "extensions": {"KHR_implicit_shapes": {"shapes": [{"type": "box"}]}}"#;
    let scene = plain(&file(nodes, rest));
    let bodies = scene.bodies.iter().map(|body| {
        let place = body.builder.state().expect("a state").position();
        (body.name.as_str(), body.builder.kind(), place[1])
    });
    let bodies: Vec<_> = bodies.collect();
    let (moves, stays) = (BodyKind::Dynamic, BodyKind::Fixed);
    let expected = [
        ("cart", moves, 0.0),
        ("lift", stays, 5.0),
        ("rail", stays, 10.0),
    ];
    assert_eq!(bodies, expected);
}

#[test]
fn colliders_that_are_only_nearly_there_are_noted() {
    let rest = r#", "extensions": {"KHR_physics_rigid_bodies": {"physicsMaterials": [{"dynamicFriction": 0.1}, {"dynamicFriction": 0.9}]},
        "KHR_implicit_shapes": {"shapes": [{"type": "box"}]}}"#;
    let moved = |first: &str, second: &str| {
        let nodes = format!(
            r#"{{"children": [1], "extensions": {{"KHR_physics_rigid_bodies": {{"motion": {{"mass": 1}},
                "collider": {{"geometry": {{"shape": 0}}{first}}}}}}}}},
            {{"translation": [3, 0, 0], "extensions": {{"KHR_physics_rigid_bodies": {{"collider": {{"geometry": {{"shape": 0}}{second}}}}}}}}}"#
        );
        noted(&plain(&file(&nodes, rest))).contains("friction of several colliders approximated")
    };
    let [low, high] = [r#", "physicsMaterial": 0"#, r#", "physicsMaterial": 1"#];
    assert!(moved(low, high) && moved(low, "") && moved("", high));
    assert!(!moved(low, low) && !moved("", ""));

    let below = |scale: &str| {
        let nodes = format!(
            r#"{{"scale": {scale}, "children": [1]}}, {{"rotation": [0, 0, 0.38268343, 0.92387953],
                "extensions": {{"KHR_physics_rigid_bodies": {{"collider": {{"geometry": {{"shape": 0}}}}}}}}}}"#
        );
        noted(&plain(&file(&nodes, rest))).contains("sheared collider approximated")
    };
    assert!(below("[8, 1, 1]") && !below("[8, 8, 1]"));
}

#[test]
fn a_cut_binary_file_is_refused_and_no_byte_panics() {
    let whole = binary(&file_with("", r#"{"name": "rock", "mesh": 0}"#, ""));
    let mut files = MemoryFiles::default();
    for length in MAGIC.len()..whole.len() {
        files.insert("a.glb", &whole[..length]);
        let error = load(&files, "a.glb", &LoadOptions::default()).expect_err("it is cut");
        assert!(error.to_string().starts_with("a.glb"), "{length}: {error}");
    }
    for place in 0..whole.len() {
        let mut bytes = whole.clone();
        bytes[place] ^= 0x11;
        files.insert("a.glb", bytes);
        if let Err(error) = load(&files, "a.glb", &LoadOptions::default()) {
            assert!(error.to_string().starts_with("a.glb"), "{place}: {error}");
        }
    }
}

#[test]
fn a_mesh_with_more_triangles_than_a_body_has_is_several_bodies() {
    let count = 70_000_u32;
    let points: Vec<u8> = (0..count)
        .flat_map(|place| [place as f32 * 0.01, (place % 7) as f32, 0.0])
        .flat_map(f32::to_le_bytes)
        .collect();
    let text = format!(
        r#"{{"asset": {{"version": "2.0"}}, "buffers": [{{"uri": "p.bin", "byteLength": {length}}}],
        "bufferViews": [{{"buffer": 0, "byteLength": {length}}}],
        "accessors": [{{"bufferView": 0, "componentType": 5126, "count": {count}, "type": "VEC3"}}],
        "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "mode": 5}}]}}], "nodes": [{{"mesh": 0}}]}}"#,
        length = points.len()
    );
    let mut files = MemoryFiles::default();
    files.insert("p.bin", points);
    let scene = load_text(&files, "a.gltf", &text, &LoadOptions::default()).expect("a scene");
    let triangles = scene.bodies.iter().map(|body| match body.builder.shape() {
        Shape::Mesh(mesh) => mesh.triangles().len(),
        _ => 0,
    });
    let triangles: Vec<usize> = triangles.collect();
    assert_eq!(triangles.len(), 2);
    assert_eq!(triangles.iter().sum::<usize>(), 69_998);
    assert!(scene.report.is_empty());
}
