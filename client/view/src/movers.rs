//! The bodies of a view that move freely, with their tracks side by side.
//!
//! A track is unpacked once, when it comes into force; each refresh then predicts four bodies at a time. Invariants: a
//! body that is kept has its newest track, in force since the last refresh or before; lanes have no gap.

use std::num::NonZeroU32;

use rhumb_protocol::stream::{FreeTrack, FreeTracksX4, Subscriber};
use rhumb_reckoning::{Motion, Ticks};

use crate::moment::{RenderTime, between};

/// Freely moving bodies, by lane.
#[derive(Debug, Default)]
pub(crate) struct Movers {
    tracks: Vec<FreeTracksX4>,
    /// By lane: the place of the body in the view.
    places: Vec<u32>,
    /// By place: the lane plus one.
    lanes: Vec<Option<NonZeroU32>>,
}

impl Movers {
    /// Forgets all bodies.
    pub(crate) fn clear(&mut self) {
        self.tracks.clear();
        self.places.clear();
        self.lanes.clear();
    }

    /// True if the body of a place is kept.
    #[inline]
    pub(crate) fn has(&self, place: usize) -> bool {
        self.lanes.get(place).is_some_and(Option::is_some)
    }

    /// Keeps the body of a place, which is not kept yet.
    pub(crate) fn add(&mut self, place: usize, track: &FreeTrack) {
        let lane = self.places.len();
        if lane.is_multiple_of(FreeTracksX4::LANES) {
            reserve(&mut self.tracks, 1);
            self.tracks.push(FreeTracksX4::default());
        }
        self.put(lane, track);
        reserve(&mut self.places, 1);
        self.places.push(place as u32);
        if place >= self.lanes.len() {
            let missing = place + 1 - self.lanes.len();
            reserve(&mut self.lanes, missing);
            self.lanes.resize(place + 1, None);
        }
        self.lanes[place] = NonZeroU32::new(lane as u32 + 1);
    }

    /// Forgets the body of a place: the last lane moves to its lane.
    pub(crate) fn forget(&mut self, place: usize) {
        let Some(lane) = self.lanes.get_mut(place).and_then(Option::take) else {
            return;
        };
        let (lane, last) = (lane.get() as usize - 1, self.places.len() - 1);
        let track = self.tracks[last / FreeTracksX4::LANES].get(last);
        self.put(lane, &track);
        self.places.swap_remove(lane);
        self.tracks.truncate(last.div_ceil(FreeTracksX4::LANES));
        if let Some(moved) = self.places.get(lane) {
            self.lanes[*moved as usize] = NonZeroU32::new(lane as u32 + 1);
        }
    }

    /// Forgets the body of a place, to which the body of the last place moves.
    pub(crate) fn swap_remove(&mut self, place: usize, last: usize) {
        self.forget(place);
        let lane = self.lanes.get_mut(last).and_then(Option::take);
        if let Some(lane) = lane {
            self.places[lane.get() as usize - 1] = place as u32;
            // The last place had a lane, so that this one is in the list.
            self.lanes[place] = Some(lane);
        }
    }

    fn put(&mut self, lane: usize, track: &FreeTrack) {
        self.tracks[lane / FreeTracksX4::LANES].put(lane, track);
    }

    /// Passes the motions of all bodies at a moment to the callback, with their places.
    pub(crate) fn predict(
        &self,
        stream: &Subscriber,
        at: RenderTime,
        mut out: impl FnMut(usize, Motion),
    ) {
        let places = self.places.chunks(FreeTracksX4::LANES);
        for (tracks, places) in self.tracks.iter().zip(places) {
            let lanes = places.len();
            if at.fraction == 0.0 {
                stream.predict_free(tracks, lanes, at.tick, |lane, motion| {
                    out(places[lane] as usize, motion);
                });
                continue;
            }
            // No newer track comes into force at the next tick, so that no body jumps there.
            let mut first = [Motion::IDENTITY; FreeTracksX4::LANES];
            stream.predict_free(tracks, lanes, at.tick, |lane, motion| first[lane] = motion);
            stream.predict_free(tracks, lanes, at.tick + Ticks::new(1), |lane, second| {
                if let Some(motion) = between(&first[lane], &second, at.fraction) {
                    out(places[lane] as usize, motion);
                }
            });
        }
    }
}

/// Makes room for more. The capacity grows by an eighth, since doubling leaves half of it empty.
fn reserve<T>(list: &mut Vec<T>, more: usize) {
    if list.len() + more > list.capacity() {
        list.reserve_exact(more.max(list.len() / 8).max(LEAST_GROWTH));
    }
}

/// Least growth of a list.
const LEAST_GROWTH: usize = 16;
