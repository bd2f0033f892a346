//! Parts of a glTF that are not read are listed, and the rest is read.

use super::{file, plain};

#[test]
fn a_mesh_that_is_packed_otherwise_is_listed_and_the_one_beside_it_is_read() {
    let good = r#""accessors": [{"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"}, "#;
    let mesh = |position: u32, indices: u32| {
        format!(
            r#"{{"name": "m", "primitives": [{{"attributes": {{"POSITION": {position}}}, "indices": {indices}}}]}}"#
        )
    };
    let shorts = r#"{"bufferView": 0, "componentType": 5122, "count": 4, "type": "VEC3"}"#;
    let sparse = r#""count": 4, "type": "VEC3", "sparse": {"count": 1}}"#;
    let sparse = format!(r#"{{"bufferView": 0, "componentType": 5126, {sparse}"#);
    let indices =
        r#"{"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR", "sparse": {}}"#;
    for (accessor, position, index, why) in [
        (
            shorts,
            2,
            1,
            "positions of whole numbers (KHR_mesh_quantization) are not read",
        ),
        (sparse.as_str(), 2, 1, "sparse accessors are not read"),
        (indices, 0, 2, "sparse accessors are not read"),
    ] {
        let whole = file(r#"{"mesh": 0}, {"mesh": 1}"#, "");
        let (first, rest) = whole.split_once(r#""accessors": ["#).expect("accessors");
        let (_, rest) = rest.split_once("],").expect("their end");
        let (_, nodes) = rest.split_once(r#""nodes""#).expect("nodes");
        let meshes = format!("{}, {}", mesh(position, index), mesh(0, 1));
        let text = format!(r#"{first}{good}{accessor}], "meshes": [{meshes}], "nodes"{nodes}"#);
        let scene = plain(&text);
        assert_eq!(scene.bodies.len(), 1, "{accessor}");
        let [note] = scene.report.notes() else {
            panic!("one note: {:?}", scene.report);
        };
        assert_eq!((note.subject.as_str(), note.why), ("primitive of m", why));
    }
}

#[test]
fn nodes_that_are_in_no_scene_are_listed() {
    let scene = plain(&file(
        r#"{"mesh": 0}, {"mesh": 0}"#,
        r#", "scenes": [{"nodes": [1]}]"#,
    ));
    assert_eq!(scene.bodies.len(), 1);
    let notes = scene.report.notes().iter();
    assert_eq!(
        notes.map(|note| note.subject.as_str()).collect::<Vec<_>>(),
        ["node"]
    );
}
