//! Measures decoding per update and rendering per view.

use std::hint::black_box;
use std::time::Duration;

use rhumb_reckoning::{Anchor, Grid, Metres, QuantisedState, Tolerance, Track};
use serde::{Deserialize, Serialize};

use super::median::median;
use crate::processor::time_of;
use crate::setup::decoding::{DecodeLoad, RenderLoad, TICKS, config, impulse_state, track};
use crate::setup::lanes::Lanes;

/// Cost of decoding and rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decoding {
    /// Bodies of the stream.
    pub bodies: u32,
    /// First update of a body, nanoseconds.
    pub first_ns: f64,
    /// Update in mid-run, nanoseconds.
    pub update_ns: f64,
    /// View of all bodies, milliseconds.
    pub view_ms: f64,
    /// Lower bound: prediction and correction of one body alone, nanoseconds.
    pub correcting_ns: f64,
    /// Lower bound: prediction of all bodies alone, milliseconds.
    pub predicting_ms: f64,
}

/// Measures decoding; each figure is the median of `repeats`.
pub(super) fn measure_decoding(bodies: u32, repeats: u32) -> Decoding {
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let often = repeats * TICKS as u32;
    let lanes =
        |track: &dyn Fn(u32) -> Track| Lanes::of((0..bodies).map(track), config().integrator, grid);
    // Anchors in mid-run lie on the grid; anchors of a snapshot do not.
    let quantised_track = |index| Track {
        anchor: Anchor::Quantised(QuantisedState::of(&impulse_state(index, 0).motion(), &grid)),
        ..track(index)
    };
    let (moving, quantised) = (lanes(&track), lanes(&quantised_track));
    let correcting = median_of(often, || quantised.correct());
    let mut render = RenderLoad::new(bodies);
    Decoding {
        bodies,
        first_ns: update_ns(&DecodeLoad::new(bodies), repeats),
        update_ns: update_ns(&DecodeLoad::in_mid_run(bodies), repeats),
        view_ms: ms(median_of(often, || render.refresh())),
        correcting_ns: correcting.as_nanos() as f64 / f64::from(bodies),
        predicting_ms: ms(median_of(often, || moving.predict())),
    }
}

/// Time to decode an update, nanoseconds.
fn update_ns(load: &DecodeLoad, repeats: u32) -> f64 {
    let once = || {
        let mut subscriber = load.subscriber.clone();
        let (took, ()) = time_of(|| load.decode(&mut subscriber));
        black_box(subscriber);
        took
    };
    let took = median((0..repeats).map(|_| once()));
    took.as_nanos() as f64 / load.updates.max(1) as f64
}

fn median_of(repeats: u32, mut work: impl FnMut()) -> Duration {
    median((0..repeats).map(|_| time_of(&mut work).0))
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}
