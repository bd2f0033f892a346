//! The golden vectors and tables in the specification match the code.
//!
//! The cases are in `accepted` and `refused`, their form in `document`. After an intended change, write both with
//! `UPDATE_VECTORS=1 cargo test -p rhumb-protocol --features raw --test vectors`.

mod accepted;
mod case;
mod document;
mod plain;
mod refused;

use std::path::Path;

fn same_as_in_spec(name: &str, computed: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../spec")
        .join(name);
    if std::env::var_os("UPDATE_VECTORS").is_some() {
        std::fs::write(&path, computed).expect("the specification can be written");
    }
    let golden = std::fs::read_to_string(path).expect("the specification is in the repository");
    for (number, (is, was)) in computed.lines().zip(golden.lines()).enumerate() {
        assert_eq!(is, was, "line {} of {name}", number + 1);
    }
    assert_eq!(computed.len(), golden.len());
}

#[test]
fn the_tables_match_the_code() {
    same_as_in_spec("tables/packets.json", &document::tables());
}

#[test]
fn the_golden_vectors_match_the_code() {
    let (accepted, refused) = (accepted::cases(), refused::cases());
    let text = document::vectors(&accepted, &refused, &accepted::covered());
    same_as_in_spec("vectors/packets.json", &text);
}
