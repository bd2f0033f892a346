//! The golden vectors and tables in the specification match the code.
//!
//! After an intended change, write both with
//! `cargo run -p rhumb-protocol --features raw --example packet_vectors -- --write`.

#[path = "../examples/packet_vectors/accepted.rs"]
mod accepted;
#[path = "../examples/packet_vectors/document.rs"]
mod document;
#[path = "../examples/packet_vectors/named_packet.rs"]
mod named_packet;
#[path = "../examples/packet_vectors/plain.rs"]
mod plain;
#[path = "../examples/packet_vectors/refused.rs"]
mod refused;
#[path = "../examples/packet_vectors/rng.rs"]
mod rng;

use std::path::Path;

fn same_as_in_spec(name: &str, computed: &str) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../spec")
        .join(name);
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
