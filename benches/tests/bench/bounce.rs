//! A recording of boxes that bounce lower and lower and then fall asleep.
//!
//! The format is that of a foreign engine.

use rhumb_bench::recording::rhtrace;

pub(crate) const BODIES: u32 = 12;
pub(crate) const FRAMES: u32 = 240;
const GRAVITY: f32 = -20.0;

/// Height of a box, which bounces unlike any predictor. Its velocity is recorded as zero, deliberately wrong.
fn height(body: u32, frame: u32) -> f32 {
    let time = frame as f32 / 60.0 + body as f32 * 0.01;
    let bounce = (time * 3.0).sin().abs() * (2.0 - time * 0.4).max(0.0);
    0.2 + bounce
}

/// The bytes of the recording before compression.
pub(crate) fn unpacked() -> Vec<u8> {
    let mut bytes = rhtrace::MAGIC.to_vec();
    let floats = |bytes: &mut Vec<u8>, values: &[f32]| {
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    };
    bytes.extend(BODIES.to_le_bytes());
    bytes.extend(FRAMES.to_le_bytes());
    floats(&mut bytes, &[1.0 / 60.0, 0.0, 0.0, GRAVITY]);
    for _ in 0..BODIES {
        floats(&mut bytes, &[0.2, 0.2, 0.2, 0.346_410_16]);
    }
    for frame in 0..FRAMES {
        let last = FRAMES - 20;
        let count = if frame <= last { BODIES } else { 0 };
        bytes.extend((count as u16).to_le_bytes());
        for body in 0..count {
            let z = height(body, frame);
            bytes.extend((body as u16).to_le_bytes());
            let place = [body as f32, 0.0, z];
            floats(&mut bytes, &place);
            floats(
                &mut bytes,
                &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            );
            bytes.push(u8::from(frame < last));
        }
    }
    bytes
}

/// The recording as a file holds it.
pub(crate) fn packed() -> Vec<u8> {
    zstd::encode_all(&*unpacked(), 1).expect("writing to memory succeeds")
}
