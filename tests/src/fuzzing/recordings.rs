//! Fuzzes the decoders of recordings with arbitrary bytes.
//!
//! Promises: an invalid recording is refused with a message, and memory stays proportional to its bytes. A valid
//! recording contains the numbers of its bytes.

use rhumb_bench::recording::{Recording, mcap, rhtrace};
use rhumb_reckoning::Tick;

use super::script::Script;

/// The first byte selects the form of the rest: packed foreign recording, unpacked foreign recording, or trace.
pub fn recordings(data: &[u8]) {
    let Some((form, bytes)) = data.split_first() else {
        return;
    };
    match form % 4 {
        0 => drop(reported(rhtrace::read("fuzz", bytes))),
        1 => foreign(bytes),
        2 => foreign(&boxes(&mut Script::new(bytes))),
        _ => drop(reported(mcap::read(bytes))),
    }
}

/// A valid recording; formats the error of an invalid one.
fn reported<E: std::error::Error>(read: Result<Recording, E>) -> Option<Recording> {
    if let Err(error) = &read {
        assert!(!error.to_string().is_empty());
    }
    read.ok()
}

/// A foreign recording before compression.
fn foreign(plain: &[u8]) {
    let packed = zstd::encode_all(plain, 1).expect("compressing bytes");
    if let Some(recording) = reported(rhtrace::read("fuzz", &packed)) {
        assert_eq!(
            written(&recording, plain),
            plain,
            "a recording has one encoding"
        );
    }
}

/// A foreign recording that is valid except for some numbers.
fn boxes(script: &mut Script<'_>) -> Vec<u8> {
    let bodies = 1 + script.below(3) as u16;
    let frames = 1 + script.below(5) as u32;
    let mut bytes = rhtrace::MAGIC.to_vec();
    bytes.extend(u32::from(bodies).to_le_bytes());
    bytes.extend(frames.to_le_bytes());
    let mut put = |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
    put(&[1.0 / 60.0, 0.0, script.number(10.0), 0.0]);
    for _ in 0..bodies {
        let half = script.sane_vector(1.0).abs() + 0.1;
        put(&half.to_array());
        put(&[half.as_dvec3().length() as f32]);
    }
    for frame in 0..frames {
        let row: Vec<u16> = (0..bodies).filter(|_| frame == 0 || script.any()).collect();
        bytes.extend((row.len() as u16).to_le_bytes());
        for body in row {
            bytes.extend(body.to_le_bytes());
            let mut put =
                |numbers: &[f32]| bytes.extend(numbers.iter().flat_map(|n| n.to_le_bytes()));
            put(&script.vector(10.0).to_array());
            put(&script.rotation().to_array());
            put(&script.vector(10.0).to_array());
            put(&script.vector(10.0).to_array());
            bytes.push(script.any());
        }
    }
    bytes
}

/// The bytes of a recording; its step and flags, which a recording does not keep, are copied from the original bytes.
fn written(recording: &Recording, from: &[u8]) -> Vec<u8> {
    let truth = &recording.truth;
    let mut to = rhtrace::MAGIC.to_vec();
    to.extend((truth.placed.len() as u32).to_le_bytes());
    to.extend((truth.ticks.len() as u32 + 1).to_le_bytes());
    to.extend_from_slice(&from[to.len()..to.len() + 4]);
    put(&mut to, &recording.gravity.to_array());
    for placed in &truth.placed {
        if let rhumb_protocol::scene::Shape::Cuboid { half_extents } = &placed.shape {
            put(&mut to, &half_extents.to_array());
        }
        to.extend_from_slice(&from[to.len()..to.len() + 4]);
        assert_eq!(placed.tick, Tick::ZERO);
    }
    let first: Vec<_> = truth
        .placed
        .iter()
        .map(|placed| placed.observation)
        .collect();
    for row in std::iter::once(&first).chain(&truth.ticks) {
        to.extend((row.len() as u16).to_le_bytes());
        for observation in row {
            to.extend((observation.id.index() as u16).to_le_bytes());
            put(&mut to, &observation.motion.parts());
            to.push(from[to.len()]);
        }
    }
    to
}

fn put(to: &mut Vec<u8>, numbers: &[f32]) {
    to.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
}
