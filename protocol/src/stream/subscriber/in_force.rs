//! The tracks in force at a tick, and what is known by them.
//!
//! Reading changes nothing: a view asks for any tick in any order. Many bodies are predicted side by side.

use alloc::vec::Vec;

use rhumb_reckoning::{
    BodyId, Metres, Motion, PredictionX4, StartsX4, Tick, Ticks, Track, UnpackedStart,
    attached_motion,
};

use super::lifetimes::{Departed, DepartureTick};
use super::{ErrorBound, Subscriber};
use crate::packet::Low16;
use crate::scene::Stepping;
use crate::stream::subscriber::lifetimes::EarlierTrack;
use crate::stream::tracks::Slot;

/// The track of a body in force at a tick.
#[derive(Clone, Copy, Debug)]
struct InForce<'a> {
    slot: &'a Slot,
    track: Track,
    certainty: Certainty,
    origin: TrackSource,
}

/// The knowledge of a track in force at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Certainty {
    /// It was in force up to this tick at least.
    Until(Tick),
    /// Another one was in force: the nearest kept one is taken.
    None,
}

/// The place of a track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrackSource {
    /// It is the present track of the body.
    Present,
    /// It was replaced, or its body is gone.
    Past,
}

/// A track that a view shows at a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShownTrack {
    /// The track.
    pub track: Track,
    /// True if no later one is known.
    pub is_newest: bool,
}

/// A tick at which the track of a body gave way to a newer one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replacement {
    /// The first tick of the newer track.
    pub at: Tick,
    /// The motion at this tick by the older track.
    pub before: Motion,
    /// The motion at this tick by the newer track.
    pub after: Motion,
    /// Ticks since the older track was within its tolerance for certain: one, unless some are not published or missing.
    pub open: Ticks,
}

/// The newest track of a body that moves freely, unpacked for predictions at many ticks.
#[derive(Clone, Copy, Debug)]
pub struct FreeTrack {
    start: UnpackedStart,
    /// The number of its table of damping.
    flow: u16,
}

/// Up to four free tracks, which are predicted side by side.
#[derive(Clone, Debug, Default)]
pub struct FreeTracksX4 {
    starts: StartsX4,
    flows: [u16; PredictionX4::LANES],
}

impl FreeTracksX4 {
    /// The number of lanes.
    pub const LANES: usize = PredictionX4::LANES;

    /// Puts a track into a lane.
    pub fn put(&mut self, lane: usize, track: &FreeTrack) {
        self.starts.put(lane, &track.start);
        self.flows[lane % Self::LANES] = track.flow;
    }

    /// The track in a lane.
    #[must_use]
    pub fn get(&self, lane: usize) -> FreeTrack {
        FreeTrack {
            start: self.starts.get(lane),
            flow: self.flows[lane % Self::LANES],
        }
    }
}

impl Subscriber {
    /// The body with this index at a tick, as far as it is known: one that is removed later, or that has come by then.
    #[must_use]
    pub fn body_at(&self, index: u32, tick: Tick) -> Option<BodyId> {
        let present = self.body(index);
        let present = present.filter(|id| self.lifetimes.since(*id) <= tick);
        present.or_else(|| Some(self.lifetimes.departed_at(index, tick)?.id))
    }

    /// True if it is known that a body is gone at a tick, which a view may still show at the tick before. A body
    /// that was changed is still there.
    #[must_use]
    pub fn has_left(&self, id: BodyId, tick: Tick) -> bool {
        self.lifetimes.has_ended(id, tick) && self.body_at(id.index(), tick) != Some(id)
    }

    /// Appends the indices of the bodies that come or go at ticks that a view has not shown yet.
    pub fn coming_and_going(&self, out: &mut Vec<u32>) {
        self.lifetimes.indices(out);
    }

    /// True if a body comes, goes or changes at a tick that a view has not shown yet.
    #[must_use]
    pub fn is_changing(&self) -> bool {
        !self.lifetimes.is_empty()
    }

    /// The track by which a body is predicted at a tick; `None` for a body that does not exist then.
    #[must_use]
    pub fn track_at(&self, id: BodyId, tick: Tick) -> Option<ShownTrack> {
        let in_force = self.in_force(id, tick)?;
        Some(ShownTrack {
            track: in_force.track,
            is_newest: in_force.origin == TrackSource::Present,
        })
    }

    /// True if a body's newest track is in force at a tick, without a parent and not at rest. Costs less than
    /// [`Self::track_at`].
    #[must_use]
    pub fn moves_freely_at(&self, id: BodyId, tick: Tick) -> bool {
        let slot = self.present(id, tick);
        slot.is_some_and(|slot| {
            let is_newest = slot.origin() <= tick;
            is_newest && slot.parent().is_none() && !slot.dense().is_resting()
        })
    }

    /// The radius of the smallest sphere around a body's centre of mass that contains it at a tick.
    #[must_use]
    pub fn radius_at(&self, id: BodyId, tick: Tick) -> Option<Metres> {
        let in_force = self.in_force(id, tick)?;
        Some(self.tracks.radius(in_force.slot))
    }

    /// The label of a body at a tick.
    pub(crate) fn label_at(&self, id: BodyId, tick: Tick) -> Option<u32> {
        self.tracks.label(self.in_force(id, tick)?.slot)
    }

    /// Takes the labels of bodies that are gone.
    pub(crate) fn take_released_labels(&mut self) -> Vec<u32> {
        self.lifetimes.take_released()
    }

    /// True if the track by which a body is predicted at a tick is attached to a body that was removed: its motion in
    /// the world is then not known until the track of its next update.
    #[must_use]
    pub fn is_orphaned_at(&self, id: BodyId, tick: Tick) -> bool {
        let parent = self.in_force(id, tick).and_then(|of| of.track.parent);
        parent.is_some_and(|parent| self.in_force(parent, tick).is_none())
    }

    /// The predicted motion of a body at a tick, by the track in force then as far as it is kept. Of an orphaned body,
    /// it is relative to the parent that it had.
    #[must_use]
    pub fn predicted_motion(&self, id: BodyId, tick: Tick) -> Option<Motion> {
        self.motion_by(&self.in_force(id, tick)?, id, tick)
    }

    /// The newest track of a body if it is in force at a tick, without a parent, not at rest and predicted side by side
    /// with others. It stays the one in force at later ticks until [`Self::drain_changed`] names the body.
    #[must_use]
    pub fn free_track(&self, id: BodyId, tick: Tick) -> Option<FreeTrack> {
        let slot = self.present(id, tick)?;
        let is_free = slot.origin() <= tick && slot.parent().is_none();
        let (start, flow) = self.tracks.unpacked(slot).filter(|_| is_free)?;
        Some(FreeTrack { start, flow })
    }

    /// Passes the predicted motions of the first lanes to the callback with their numbers. The bits are those of
    /// [`Self::predicted_motion`].
    pub fn predict_free(
        &self,
        tracks: &FreeTracksX4,
        lanes: usize,
        tick: Tick,
        out: impl FnMut(usize, Motion),
    ) {
        let flows = tracks.flows.map(|flow| self.tracks.flow(flow));
        let lanes = lanes.min(flows.len());
        tracks.starts.predict(tick, &flows[..lanes], out);
    }

    /// Passes the predicted motion of each body to the callback with its key, in no defined order. The bits are those
    /// of [`Self::predicted_motion`]. A body that does not exist is skipped.
    pub fn predict_each(
        &self,
        requested: &[(u32, BodyId)],
        tick: Tick,
        mut out: impl FnMut(u32, Motion),
    ) {
        let mut batch = PredictionX4::default();
        for (key, id) in requested {
            // An attached body, or a tick before the track's origin, is predicted alone.
            let is_simple = |slot: &&Slot| slot.origin() <= tick && slot.parent().is_none();
            let slot = self.present(*id, tick).filter(is_simple);
            if slot.is_some_and(|slot| self.tracks.take(&mut batch, *key, slot, tick)) {
                if batch.is_full() {
                    batch.predict(&mut out);
                }
            } else if let Some(motion) = self.predicted_motion(*id, tick) {
                out(*key, motion);
            }
        }
        batch.predict(&mut out);
    }

    /// The newest replacement of a body's track up to a tick; `None` if the older track is not kept.
    #[must_use]
    pub fn replacement(&self, id: BodyId, tick: Tick) -> Option<Replacement> {
        let newer = self.in_force(id, tick)?;
        let at = newer.track.origin;
        let last = Tick::new(at.value().checked_sub(1)?);
        let older = self.in_force(id, last).filter(|_| at <= tick)?;
        if older.track.origin > last {
            return None;
        }
        let right = self.published_before(at).min(self.complete());
        Some(Replacement {
            at,
            before: self.motion_by(&older, id, at)?,
            after: self.motion_by(&newer, id, at)?,
            open: Ticks::new(u32::try_from(at.value() - right.value()).unwrap_or(u32::MAX)),
        })
    }

    fn motion_by(&self, in_force: &InForce<'_>, id: BodyId, tick: Tick) -> Option<Motion> {
        let motion = self.framed_motion(in_force, id.index(), tick);
        let parent = in_force.track.parent;
        let parent = parent.and_then(|parent| Some((parent.index(), self.in_force(parent, tick)?)));
        let Some((index, parent)) = parent else {
            return Some(motion);
        };
        let by = self.framed_motion(&parent, index, tick);
        Some(attached_motion(&by, &motion.pose()))
    }

    fn framed_motion(&self, in_force: &InForce<'_>, index: u32, tick: Tick) -> Motion {
        let (slot, track) = (in_force.slot, &in_force.track);
        match in_force.origin {
            TrackSource::Present => self.tracks.framed((index, slot), track, tick),
            // The cached rotation is that of the present track.
            TrackSource::Past => self.tracks.framed_fresh(slot, track, tick),
        }
    }

    /// The slot of a body that is there by a tick, as it is described then.
    fn present(&self, id: BodyId, tick: Tick) -> Option<&Slot> {
        let slot = self.tracks.slot(id.index());
        let slot = slot.filter(|slot| slot.id(id.index()) == id);
        slot.filter(|_| self.lifetimes.since(id) <= tick)
    }

    /// The track of a body in force at a tick, or the nearest kept one.
    fn in_force(&self, id: BodyId, tick: Tick) -> Option<InForce<'_>> {
        match self.present(id, tick) {
            Some(slot) if slot.origin() <= tick => Some(InForce {
                slot,
                track: slot.track(),
                certainty: Certainty::Until(FOR_EVER),
                origin: TrackSource::Present,
            }),
            Some(slot) => {
                let earlier = self.earlier_tracks.at(id.index(), tick);
                let nearest = || self.earlier_tracks.nodes_of(id.index()).last();
                Some(match (earlier, nearest()) {
                    (Some(earlier), _) => {
                        past(slot, earlier.track, Certainty::Until(earlier.sure_until))
                    }
                    (None, Some(nearest)) => past(slot, nearest.track, Certainty::None),
                    (None, None) => past(slot, slot.track(), Certainty::None),
                })
            }
            None => {
                let departed = self.lifetimes.departed_at(id.index(), tick)?;
                (departed.id == id)
                    .then(|| departed_track(departed, tick))
                    .flatten()
            }
        }
    }

    /// The error bound of a body at the tick of the watermark.
    #[must_use]
    pub fn bound(&self, id: BodyId) -> Option<ErrorBound> {
        self.bound_at(id, self.watermark_tick)
    }

    /// The error bound of a body at a tick; `None` for a body that does not exist then. Unknown after the watermark,
    /// before the tracks that are still kept, between two published ticks, and while the body's publisher is silent.
    #[must_use]
    pub fn bound_at(&self, id: BodyId, tick: Tick) -> Option<ErrorBound> {
        let in_force = self.in_force(id, tick)?;
        let complete = self.complete();
        let uncertain_before = self.gaps.unsure_before();
        let is_certain = |of: &InForce<'_>| match of.certainty {
            Certainty::Until(sure_until) => {
                let origin = of.track.origin;
                let has_no_gap = uncertain_before.is_none_or(|before| origin >= before);
                let is_complete = self.shown.is_some() && tick <= complete;
                tick <= sure_until && (is_complete || has_no_gap)
            }
            Certainty::None => false,
        };
        let is_known = is_certain(&in_force)
            && !self.silent_publishers.guesses(id, tick)
            && in_force.track.parent.is_none_or(|parent| {
                // An attached body is known no better than its parent.
                self.in_force(parent, tick)
                    .is_some_and(|parent| is_certain(&parent))
            });
        let unknown = Some(ErrorBound::Unknown {
            since: self.converged_at,
        });
        if tick > self.watermark_tick || !self.is_published(tick) || self.lost_sync || !is_known {
            return unknown;
        }
        let Some(error_scale) = self.error_scale_at(tick) else {
            return unknown;
        };
        let tolerance = self.tracks.tolerance_of(in_force.slot);
        let reach = tolerance.reach(self.tracks.radius(in_force.slot));
        Some(ErrorBound::Within(Metres::new(
            reach.metres() * error_scale,
        )))
    }

    /// The error bound of a body at any tick, for a view: see [`Self::bound_at`]. A tick between two published ones is
    /// known if the track in force then is in force at the next published tick, too (PROTOCOL 6.3-15).
    #[must_use]
    pub fn bound_between(&self, id: BodyId, tick: Tick) -> Option<ErrorBound> {
        if self.is_published(tick) {
            return self.bound_at(id, tick);
        }
        let unknown = ErrorBound::Unknown {
            since: self.converged_at,
        };
        let in_force = self.in_force(id, tick)?;
        let next = self.published_after(tick);
        let stays = |id, track: &Track| {
            let then = self.in_force(id, next);
            then.is_some_and(|then| then.track == *track)
                && !self.silent_publishers.guesses(id, tick)
        };
        let parent = in_force.track.parent;
        let parent_stays = parent.is_none_or(|parent| {
            self.in_force(parent, tick)
                .is_some_and(|of| stays(parent, &of.track))
        });
        let stays = in_force.certainty != Certainty::None && stays(id, &in_force.track);
        // The publisher of a stream with a budget compares at published ticks alone.
        if self.statements.is_some() || !stays || !parent_stays {
            return Some(unknown);
        }
        Some(self.bound_at(id, next).unwrap_or(unknown))
    }

    /// The tick from which on earlier tracks are kept when a newer one comes.
    pub(super) fn shown_from(&self) -> Tick {
        let Some(shown) = self.shown else {
            return FOR_EVER;
        };
        let behind = self.history.max(shown.behind) + super::HISTORY_SLACK;
        let kept = Tick::new(self.newest.value().saturating_sub(behind));
        shown.from.max(kept)
    }

    /// Notes the first tick of a body that a scene event has placed.
    pub(super) fn arrive_at(&mut self, id: BodyId, since: Tick) {
        let is_news = |shown: super::ShownPast| self.placed && since > shown.from;
        if self.shown.is_some_and(is_news) {
            self.lifetimes.arrive(id, since);
        }
    }

    /// Keeps the body of an index that is about to go, for a view of ticks before that: of earlier ones, or of the one at
    /// which a lockstep scene stands. `at`: the tick of its change; `None` for a removal. Returns `false` if there is none,
    /// or no such view.
    pub(super) fn depart(&mut self, index: u32, at: Option<Tick>) -> bool {
        let lookahead = u64::from(self.lookahead.count());
        let is_past_shown = self.shown.is_some_and(|shown| match self.stepping {
            Stepping::Lockstep => true,
            Stepping::FreeRunning => self.history.max(shown.behind) + lookahead > 0,
        });
        if !self.placed || !is_past_shown {
            return false;
        }
        let Some(slot) = self.tracks.retained(index) else {
            return false;
        };
        let id = slot.id(index);
        let mut tracks = Vec::new();
        tracks.push(EarlierTrack {
            track: slot.track(),
            sure_until: FOR_EVER,
        });
        tracks.extend(self.earlier_tracks.nodes_of(index));
        let departed = Departed {
            id,
            label: self.tracks.label(&slot),
            tracks,
            since: self.lifetimes.since(id),
            end: match at {
                Some(tick) => DepartureTick::At(tick),
                None => DepartureTick::After(self.scene_events + 1, None),
            },
            // Later datagrams, of a missing packet too, no longer concern this body.
            sure_until: self.complete(),
            slot,
        };
        let (lifetimes, tracks) = (&mut self.lifetimes, &mut self.tracks);
        lifetimes.depart(departed, |slot| tracks.release(slot));
        true
    }

    /// Drops departed bodies; `false` if there are none.
    pub(super) fn forget_departed(&mut self) -> bool {
        let (lifetimes, tracks) = (&mut self.lifetimes, &mut self.tracks);
        lifetimes.forget_departed(|slot| tracks.release(slot))
    }

    /// Learns when bodies went from the count of scene events of a datagram.
    pub(super) fn note_departures(&mut self, scene_events: Low16, tick: Tick) {
        let scene_events = scene_events.expand(self.scene_events);
        let reached = tick + self.lookahead;
        self.lifetimes.note_count(scene_events, reached);
        if tick >= self.newest {
            self.counted_events = self.counted_events.max(scene_events);
        }
    }

    /// The first tick of a view with a body that a scene event has placed at a tick.
    ///
    /// A lockstep scene stands still at a published tick, and its commands make the next one: all views of the tick
    /// have the same bodies, whatever has been read since. The views of a member that has just joined may differ: a snapshot
    /// does not tell which of its bodies came after the tick, so they are shown at once, until the next published tick.
    pub(super) fn first_shown(&self, placed: Tick) -> Tick {
        match self.stepping {
            Stepping::Lockstep => self.published_after(placed),
            Stepping::FreeRunning => placed,
        }
    }

    /// Sets how the scene steps.
    pub(crate) const fn set_stepping(&mut self, stepping: Stepping) {
        self.stepping = stepping;
    }

    /// Sets the scene's lookahead: a datagram describes a tick that is so much older than the scene.
    pub(crate) const fn set_lookahead(&mut self, lookahead: Ticks) {
        self.lookahead = lookahead;
    }
}

/// No last tick.
const FOR_EVER: Tick = Tick::new(u64::MAX);

const fn past(slot: &Slot, track: Track, certainty: Certainty) -> InForce<'_> {
    InForce {
        slot,
        track,
        certainty,
        origin: TrackSource::Past,
    }
}

/// The track of a departed body in force at a tick, or its oldest kept one.
fn departed_track(departed: &Departed, tick: Tick) -> Option<InForce<'_>> {
    let begun = departed.tracks.iter().find(|of| of.track.origin <= tick);
    let (of, certainty) = match begun {
        Some(of) => {
            let sure_until = of.sure_until.min(departed.sure_until);
            (of, Certainty::Until(sure_until))
        }
        None => (departed.tracks.last()?, Certainty::None),
    };
    Some(past(&departed.slot, of.track, certainty))
}
