//! The states of each body of a recording, frame by frame.
//!
//! A recording has a row for each frame, of the bodies that move in it. A path has a state for each frame of a body's stay.

use std::collections::BTreeMap;

use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{BodyId, BodyState};

use super::recorded::Recording;

/// One body in every frame of its stay.
pub(crate) struct BodyPath {
    pub(crate) id: BodyId,
    pub(crate) states: Vec<BodyState>,
    /// Bounding radius, metres.
    pub(crate) radius: f64,
}

/// The states of all bodies that can move, frame by frame.
pub(crate) struct Paths {
    pub(crate) bodies: Vec<BodyPath>,
    /// Frames from the first that were read.
    pub(crate) frames: usize,
}

/// Most states of all paths: a body that rests has no records and yet a state in each frame. More hardly change a fit.
const STATES_MAX: usize = 10_000_000;

/// The states of all bodies that can move, as long as there are not too many.
pub(crate) fn paths(recording: &Recording) -> Paths {
    paths_within(recording, STATES_MAX)
}

fn paths_within(recording: &Recording, most: usize) -> Paths {
    let truth = &recording.truth;
    let mut open: BTreeMap<BodyId, BodyPath> = BTreeMap::new();
    let mut done = Vec::new();
    let (mut placed, mut removed) = (0, 0);
    let (mut states, mut frames) = (0, 0);
    for frame in 0..=truth.ticks.len() {
        states += open.len();
        if states > most {
            break;
        }
        frames += 1;
        for path in open.values_mut() {
            path.states.extend(path.states.last().copied());
        }
        let row = frame
            .checked_sub(1)
            .map_or(&[][..], |row| &truth.ticks[row]);
        for observation in row {
            if let Some(last) = open
                .get_mut(&observation.id)
                .and_then(|path| path.states.last_mut())
            {
                *last = observation.motion;
            }
        }
        while let Some(one) = truth
            .placed
            .get(placed)
            .filter(|one| one.tick.value() <= frame as u64)
        {
            placed += 1;
            if one.desc.kind != BodyKind::Fixed {
                let path = BodyPath {
                    id: one.desc.id,
                    states: vec![one.observation.motion],
                    radius: one.shape.bounding_radius().metres(),
                };
                open.insert(one.desc.id, path);
            }
        }
        while let Some((_, id)) = truth
            .removed
            .get(removed)
            .filter(|(tick, _)| tick.value() <= frame as u64)
        {
            removed += 1;
            done.extend(open.remove(id));
        }
    }
    done.extend(open.into_values());
    Paths {
        bodies: done,
        frames,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::recording::{ReadOptions, read_bytes};

    /// A body that falls, and one that rests, for some frames.
    pub(in crate::recording) fn recording(frames: u32) -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
        for frame in 0..frames {
            let y = f64::from(frame) * 0.1;
            let x = 0.01 * f64::from(frame % 2);
            text +=
                &format!("{y},a,{y},0,0,0,0,0,1,1,0,0,0,0,0\n{y},b,{x},5,0,0,0,0,1,0,0,0,0,0,0\n");
        }
        read_bytes("r", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn the_states_of_paths_are_bounded_by_frames_from_the_first() {
        let recording = recording(100);
        let all = paths(&recording);
        assert_eq!((all.frames, all.bodies.len()), (100, 2));
        let few = paths_within(&recording, 60);
        assert_eq!((few.frames, few.bodies.len()), (31, 2));
        assert!(few.bodies.iter().all(|path| path.states.len() == 31));
    }
}
