//! The golden vectors and the document agree with the code.
//!
//! Proof: the vectors are computed anew and compared. The cases are in `cases`, their form in `document`. After an
//! intended change, write them with `UPDATE_VECTORS=1 cargo test -p rhumb-reckoning --test vectors`.

mod cases;
mod document;

use std::path::{Path, PathBuf};

use rhumb_reckoning::{
    FINE_STEPS, Grid, Inertia, Metres, POSITION_LIMIT, PackedRotation, RESIDUAL_LIMIT,
    REST_DIVERGENCE_TICKS, TRACK_AGE_MAX, TURN_LIMIT, Tolerance, UNIT_LENGTH_SLACK, VELOCITY_LIMIT,
};

fn path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../spec")
        .join(name)
}

fn spec(name: &str) -> String {
    std::fs::read_to_string(path(name)).expect("the specification lies beside the crates")
}

#[test]
fn the_golden_vectors_equal_the_code() {
    let (computed, name) = (cases::document(), "vectors/reckoning.json");
    if std::env::var_os("UPDATE_VECTORS").is_some() {
        std::fs::write(path(name), &computed).expect("the specification can be written");
    }
    let golden = spec(name);
    for (number, (is, was)) in computed.lines().zip(golden.lines()).enumerate() {
        assert_eq!(is, was, "line {} of the vectors", number + 1);
    }
    assert_eq!(computed.len(), golden.len());
}

#[test]
fn the_document_states_the_constants_of_the_code() {
    let text = spec("RECKONING.md");
    // A tolerance of a metre and a radius of a power of two, so that the shares are read back exactly.
    let metre = Tolerance::from_micrometres(1_000_000).unwrap();
    let wide = Grid::new(metre, Metres::new(1_024.0));
    let narrow = Grid::new(metre, Metres::new(1e-6));
    let shares = [
        ("position share", wide.position()),
        ("turn share", wide.turn() * 1_024.0),
        ("velocity share", wide.linear()),
        ("coarsest turn step", narrow.turn()),
        ("coarsest angular step", narrow.angular()),
        ("unit length slack", UNIT_LENGTH_SLACK),
        ("greatest ratio of moments", Inertia::RATIO_MAX),
        (
            "greatest difference of equal moments, as a share",
            Inertia::EQUAL,
        ),
    ];
    for (name, value) in shares {
        let row = format!("| {name} | {value:?} | `{:016x}` |", value.to_bits());
        assert!(text.contains(&row), "RECKONING.md lacks {row}");
    }
    let limits = [
        ("TRACK_AGE_MAX", TRACK_AGE_MAX.count() as i32),
        (
            "ticks of divergence from rest",
            REST_DIVERGENCE_TICKS.count() as i32,
        ),
        ("fine steps in a step", FINE_STEPS),
        ("position limit", POSITION_LIMIT),
        ("residual limit", RESIDUAL_LIMIT),
        ("velocity limit", VELOCITY_LIMIT),
        ("turn limit", TURN_LIMIT),
        ("packed limit", PackedRotation::LIMIT),
    ];
    for (name, value) in limits {
        let row = format!("| {name} | {value} |");
        assert!(text.contains(&row), "RECKONING.md lacks {row}");
    }
}
