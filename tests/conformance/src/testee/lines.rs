//! The state of a copy, as text.
//!
//! The checksum over its tracks, and the exact motion of each body that does not rest.

use rhumb_protocol::session::Replica;
use rhumb_reckoning::{Motion, Tick};

use crate::grammar::hex;

/// The state of a copy at a tick, as one line of JSON.
#[must_use]
pub fn copy_line(copy: &Replica, tick: Tick) -> String {
    let (moving, sum) = (moving(copy, tick), copy.stream().state_checksum());
    let tick = tick.value();
    format!(
        "{{\"is\":\"tick\",\"tick\":{tick},\"checksum\":\"{sum:016x}\",\"moving\":{{{moving}}}}}"
    )
}

/// The motion of each body that does not rest, at a tick.
fn moving(copy: &Replica, tick: Tick) -> String {
    let stream = copy.stream();
    let moving = copy.bodies().filter_map(|desc| {
        let track = stream.track(desc.id)?;
        let motion = stream.predicted_motion(desc.id, tick)?;
        let (index, generation) = (desc.id.index(), desc.id.generation());
        let text = || format!("\"{index}:{generation}\":\"{}\"", bits(&motion));
        (!track.is_exact_rest()).then(text)
    });
    let moving: Vec<_> = moving.collect();
    moving.join(",")
}

/// The thirteen doubles of a motion, as hexadecimal digits.
#[must_use]
pub fn bits(motion: &Motion) -> String {
    let numbers = motion.parts().into_iter();
    let bytes: Vec<_> = numbers
        .flat_map(|number| number.to_bits().to_be_bytes())
        .collect();
    hex(&bytes)
}
