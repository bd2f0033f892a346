//! Bodies that came or went, silent publishers, and tracks that held earlier.
//!
//! Knows no view: the caller passes the earliest tick that one shows. Invariant: a departed body is kept for a view alone
//! that may still show it, a delayed one or one of a lockstep scene's tick. The server predicts a body whose publisher is
//! silent, and then holds it: its stream describes that guess, not the publisher's body. Invariant: silent bodies are
//! sorted by id, each body once, at most one span for each.
//!
//! Earlier tracks hold before the present ones: usually at most one for each body, and only while a view may show ticks
//! before the present track. A delayed view keeps as many as its delay needs. They are few, so they are kept outside
//! the table. Invariant: `places` points into `kept`, each entry of `kept` back, and the tracks of a body are linked
//! from the newest to the oldest.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, DenseTrack, Tick, Track};

use crate::interner::{grow_to, push};
use crate::stream::tracks::Slot;

/// Bodies of one index that are kept, such as those that came and went while the scene stood still.
const DEPARTED_PER_INDEX_MAX: usize = 64;

/// First ticks and last tracks of bodies.
#[derive(Clone, Debug, Default)]
pub(super) struct Lifetimes {
    /// By index; none of them is empty.
    changed: BTreeMap<u32, IndexLifetimes>,
    /// Labels of bodies that are gone and not kept.
    released: Vec<u32>,
}

/// The bodies under one index.
#[derive(Clone, Debug, Default)]
struct IndexLifetimes {
    /// The present body, and the first tick of its present description.
    arrived: Option<(BodyId, Tick)>,
    /// Oldest first.
    departed: Vec<Departed>,
}

impl IndexLifetimes {
    const fn is_empty(&self) -> bool {
        self.arrived.is_none() && self.departed.is_empty()
    }
}

/// A body as it was until it was removed or changed.
#[derive(Clone, Debug)]
pub(super) struct Departed {
    pub(super) id: BodyId,
    pub(super) slot: Slot,
    pub(super) label: Option<u32>,
    /// Its tracks, newest first.
    pub(super) tracks: Vec<EarlierTrack>,
    /// Its first tick.
    pub(super) since: Tick,
    pub(super) end: DepartureTick,
    /// The last tick for which the bound is known.
    pub(super) sure_until: Tick,
}

/// The first tick of a scene without a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum DepartureTick {
    /// The last tick is known.
    At(Tick),
    /// No datagram that counts this scene event has arrived. A view shows the body until the tick, if there is one.
    After(u64, Option<Tick>),
}

impl Departed {
    fn is_at(&self, tick: Tick) -> bool {
        let is_gone = match self.end {
            DepartureTick::At(end) | DepartureTick::After(_, Some(end)) => tick >= end,
            DepartureTick::After(_, None) => false,
        };
        self.since <= tick && !is_gone
    }
}

impl Lifetimes {
    /// The first tick of the present body; zero if no view needs to know it.
    pub(super) fn since(&self, id: BodyId) -> Tick {
        // Almost always there is none.
        if self.changed.is_empty() {
            return Tick::ZERO;
        }
        match self.changed.get(&id.index()) {
            Some(IndexLifetimes {
                arrived: Some((arrived, since)),
                ..
            }) if *arrived == id => *since,
            _ => Tick::ZERO,
        }
    }

    /// The body that was under an index at a tick and has left since.
    pub(super) fn departed_at(&self, index: u32, tick: Tick) -> Option<&Departed> {
        let mut departed = self.changed.get(&index)?.departed.iter().rev();
        departed.find(|departed| departed.is_at(tick))
    }

    /// True if it is known that a description of a body ended at this tick or before it: the body went or was changed.
    pub(super) fn has_ended(&self, id: BodyId, tick: Tick) -> bool {
        let departed = self.changed.get(&id.index()).map(|of| &of.departed);
        let mut of_body = departed.into_iter().flatten().filter(|of| of.id == id);
        of_body.next_back().is_some_and(|of| match of.end {
            DepartureTick::At(end) => end <= tick,
            DepartureTick::After(..) => false,
        })
    }

    /// True if a body that is gone is kept.
    pub(super) fn has_departed(&self, id: BodyId) -> bool {
        let of_index = self.changed.get(&id.index());
        of_index.is_some_and(|of_index| of_index.departed.iter().any(|departed| departed.id == id))
    }

    /// True if no body came or went.
    pub(super) fn is_empty(&self) -> bool {
        self.changed.is_empty()
    }

    /// The indices of all bodies that came or went.
    pub(super) fn indices(&self, out: &mut Vec<u32>) {
        out.extend(self.changed.keys());
    }

    /// Notes the first tick of a body.
    pub(super) fn arrive(&mut self, id: BodyId, since: Tick) {
        self.changed.entry(id.index()).or_default().arrived = Some((id, since));
    }

    /// Keeps a body that goes.
    pub(super) fn depart(&mut self, departed: Departed, release: impl FnOnce(&Slot)) {
        let of_index = self.changed.entry(departed.id.index()).or_default();
        of_index.arrived = None;
        if of_index.departed.len() >= DEPARTED_PER_INDEX_MAX {
            // The oldest one is shown, and that before the newest may be.
            let between = of_index.departed.remove(1);
            release(&between.slot);
            self.released.extend(between.label);
        }
        of_index.departed.push(departed);
    }

    /// Notes the label of a body that is gone.
    pub(super) fn release_label(&mut self, label: Option<u32>) {
        self.released.extend(label);
    }

    /// Takes the labels of bodies that are gone.
    pub(super) fn take_released(&mut self) -> Vec<u32> {
        core::mem::take(&mut self.released)
    }

    /// Learns from a datagram that the first `scene_events` happened before a tick.
    pub(super) fn note_count(&mut self, scene_events: u64, tick: Tick) {
        let all = self.changed.values_mut();
        for departed in all.flat_map(|of_index| &mut of_index.departed) {
            if let DepartureTick::After(event, _) = departed.end
                && event <= scene_events
            {
                departed.end = DepartureTick::At(tick);
            }
        }
    }

    /// Drops what no tick from this one on needs. A body whose last tick is not known is shown for `news_after` ticks,
    /// within which a datagram tells it; `None`: until one does.
    pub(super) fn forget_before(
        &mut self,
        tick: Tick,
        news_after: Option<u64>,
        mut release: impl FnMut(&Slot),
    ) {
        let released = &mut self.released;
        self.changed.retain(|_, of_index| {
            of_index.arrived = of_index.arrived.filter(|(_, since)| *since > tick);
            of_index.departed.retain_mut(|departed| {
                let stays = match &mut departed.end {
                    DepartureTick::At(end) | DepartureTick::After(_, Some(end)) => *end > tick,
                    DepartureTick::After(_, end) => {
                        *end = news_after.map(|ticks| Tick::new(tick.value() + ticks));
                        true
                    }
                };
                if !stays {
                    release(&departed.slot);
                    released.extend(departed.label);
                }
                stays
            });
            !of_index.is_empty()
        });
    }

    /// Drops all departed bodies; `false` if there are none.
    pub(super) fn forget_departed(&mut self, mut release: impl FnMut(&Slot)) -> bool {
        let mut is_any = false;
        let released = &mut self.released;
        self.changed.retain(|_, of_index| {
            for departed in of_index.departed.drain(..) {
                is_any = true;
                release(&departed.slot);
                released.extend(departed.label);
            }
            !of_index.is_empty()
        });
        is_any
    }
}

/// The ticks at which poses of bodies are guesses.
#[derive(Clone, Debug, Default)]
pub(super) struct SilentPublishers {
    spans: Vec<GuessedSpan>,
}

#[derive(Clone, Copy, Debug)]
struct GuessedSpan {
    id: BodyId,
    since: Tick,
    /// The first tick that is no guess; `None` while the publisher is silent.
    until: Option<Tick>,
}

impl SilentPublishers {
    /// True if the pose of a body at a tick is a guess.
    pub(super) fn guesses(&self, id: BodyId, tick: Tick) -> bool {
        // Almost always there is none.
        if self.spans.is_empty() {
            return false;
        }
        let place = self.spans.binary_search_by_key(&id, |span| span.id);
        place.is_ok_and(|place| {
            let span = &self.spans[place];
            span.since <= tick && span.until.is_none_or(|until| tick < until)
        })
    }

    /// Notes that a body is not confirmed from a tick on. An earlier span of it that is still kept continues.
    pub(super) fn silence(&mut self, id: BodyId, since: Tick) {
        match self.spans.binary_search_by_key(&id, |span| span.id) {
            Ok(place) => {
                let span = &mut self.spans[place];
                span.since = span.since.min(since);
                span.until = None;
            }
            Err(place) => {
                let until = None;
                self.spans.insert(place, GuessedSpan { id, since, until });
            }
        }
    }

    /// Notes that a body is confirmed again from a tick on.
    pub(super) fn confirm(&mut self, id: BodyId, tick: Tick) {
        if let Ok(place) = self.spans.binary_search_by_key(&id, |span| span.id) {
            self.spans[place].until = Some(tick);
        }
    }

    /// Drops the span of a body that no view shows.
    pub(super) fn forget(&mut self, id: BodyId) {
        if let Ok(place) = self.spans.binary_search_by_key(&id, |span| span.id) {
            self.spans.remove(place);
        }
    }

    /// Drops spans that ended at this tick or before it, and those of bodies that are gone.
    pub(super) fn forget_before(&mut self, tick: Tick, is_known: impl Fn(BodyId) -> bool) {
        self.spans
            .retain(|span| span.until.is_none_or(|until| until > tick) && is_known(span.id));
    }
}

/// By body: the tracks before the present one.
#[derive(Clone, Debug, Default)]
pub(crate) struct EarlierTracks {
    /// By index: one more than the position in `kept`; 0 for none.
    places: Vec<u32>,
    /// The bodies that have such tracks.
    kept: Vec<Body>,
    /// A link to a node is one more than its place here; 0 for none.
    nodes: Vec<Node>,
    /// Link to a free node, from which the others are linked.
    free: u32,
}

#[derive(Clone, Copy, Debug)]
struct Body {
    index: u32,
    newest: u32,
    count: u32,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    track: DenseTrack,
    sure_until: Tick,
    older: u32,
}

/// A track that held before the present one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EarlierTrack {
    /// The track, in force from its origin to that of the next one.
    pub(crate) track: Track,
    /// After this tick another track may have been in force.
    pub(crate) sure_until: Tick,
}

/// Number of tracks kept for one body. A view with a longer delay shows a body of which each tick has an update at the
/// oldest kept one.
const EARLIER_TRACKS_MAX: u32 = 256;

impl EarlierTracks {
    /// The track of a body in force at a tick, if it is kept.
    pub(crate) fn at(&self, index: u32, tick: Tick) -> Option<EarlierTrack> {
        let mut nodes = self.nodes_of(index);
        nodes.find(|track| track.track.origin <= tick)
    }

    /// The origin of the newest kept track.
    #[cfg(test)]
    fn newest_origin(&self, index: u32) -> Option<Tick> {
        let newest = self.kept[self.place(index)?].newest;
        Some(self.node(newest)?.track.origin())
    }

    /// The tracks of a body, newest first.
    pub(crate) fn nodes_of(&self, index: u32) -> impl Iterator<Item = EarlierTrack> {
        let mut next = self.place(index).map_or(0, |place| self.kept[place].newest);
        core::iter::from_fn(move || {
            let node = self.node(next)?;
            next = node.older;
            Some(EarlierTrack {
                track: node.track.track(),
                sure_until: node.sure_until,
            })
        })
    }

    /// Keeps the track that an update of a body has just replaced. Of the older ones, those stay that were in force
    /// after `shown_from`.
    pub(crate) fn keep(&mut self, index: u32, track: DenseTrack, shown_from: Tick) {
        let place = match self.place(index) {
            Some(place) => place,
            None => {
                grow_to(&mut self.places, index as usize + 1, || 0);
                let body = Body {
                    index,
                    newest: 0,
                    count: 0,
                };
                push(&mut self.kept, body);
                self.places[index as usize] = self.kept.len() as u32;
                self.kept.len() - 1
            }
        };
        let older = self.kept[place].newest;
        if track.origin() <= shown_from && self.node(older).is_some() {
            return self.keep_only(place, track);
        }
        self.kept[place].newest = self.add(Node {
            track,
            sure_until: SURE,
            older,
        });
        self.kept[place].count += 1;
        self.drop_older(place, track.origin(), shown_from);
    }

    /// Keeps one track of a body in place of all that it has.
    fn keep_only(&mut self, place: usize, track: DenseTrack) {
        let Body { newest, count, .. } = &mut self.kept[place];
        *count = 1;
        let node = Node {
            track,
            sure_until: SURE,
            older: 0,
        };
        let before = core::mem::replace(&mut self.nodes[*newest as usize - 1], node);
        self.release(before.older);
    }

    /// Adds a track that was overtaken by the present one, where no track has its origin. Of the older ones, those stay
    /// that were in force after `shown_from`.
    pub(crate) fn insert(&mut self, index: u32, track: DenseTrack, shown_from: Tick) {
        let Some(place) = self.place(index) else {
            return;
        };
        if self.kept[place].count == EARLIER_TRACKS_MAX {
            return;
        }
        let (mut newer, mut next) = (None, self.kept[place].newest);
        while let Some(node) = self.node(next) {
            if node.track.origin() <= track.origin() {
                break;
            }
            (newer, next) = (Some(next), node.older);
        }
        if self
            .node(next)
            .is_some_and(|node| node.track.origin() == track.origin())
        {
            return;
        }
        let sure_until = self.node(next).map_or(SURE, |node| node.sure_until);
        let link = self.add(Node {
            track,
            sure_until,
            older: next,
        });
        self.kept[place].count += 1;
        match newer {
            Some(newer) => self.nodes[newer as usize - 1].older = link,
            None => self.kept[place].newest = link,
        }
        if let Some(origin) = self
            .node(self.kept[place].newest)
            .map(|node| node.track.origin())
        {
            self.drop_older(place, origin, shown_from);
        }
    }

    /// Notes that a body may have had other tracks after a tick.
    pub(crate) fn doubt_after(&mut self, index: u32, tick: Tick) {
        let mut next = self.place(index).map_or(0, |place| self.kept[place].newest);
        while let Some(node) = self.node(next).copied() {
            self.nodes[next as usize - 1].sure_until = node.sure_until.min(tick);
            next = node.older;
        }
    }

    /// Drops the tracks of a body.
    pub(crate) fn forget(&mut self, index: u32) {
        if let Some(place) = self.place(index) {
            self.take_out(place);
        }
    }

    /// Drops the tracks that no tick after `end` needs. `origin_of`: that of a body's present track, `None` for a body
    /// without one.
    pub(crate) fn forget_until(&mut self, end: Tick, origin_of: impl Fn(u32) -> Option<Tick>) {
        // From the last entry on, so that an entry that fills a removed place was tested already.
        for place in (0..self.kept.len()).rev() {
            match origin_of(self.kept[place].index) {
                Some(origin) if origin > end => {
                    let newest = self.kept[place].newest;
                    if let Some(node) = self.node(newest) {
                        let origin = node.track.origin();
                        self.drop_older(place, origin, end);
                    }
                }
                _ => self.take_out(place),
            }
        }
    }

    /// Drops all but the newest track of a body that were replaced by `end`. `origin`: that of the newest one.
    fn drop_older(&mut self, place: usize, origin: Tick, end: Tick) {
        let (mut newer, mut newer_origin, mut left) = (self.kept[place].newest, origin, 1);
        while let Some(link) = self.node(newer).map(|node| node.older) {
            let Some(older) = self.node(link).map(|older| older.track.origin()) else {
                break;
            };
            if newer_origin <= end || left == EARLIER_TRACKS_MAX {
                self.nodes[newer as usize - 1].older = 0;
                self.release(link);
                break;
            }
            newer_origin = older;
            newer = link;
            left += 1;
        }
        self.kept[place].count = left;
    }

    fn node(&self, link: u32) -> Option<&Node> {
        self.nodes.get((link as usize).checked_sub(1)?)
    }

    fn add(&mut self, node: Node) -> u32 {
        match self.node(self.free).map(|free| free.older) {
            Some(next) => {
                let link = core::mem::replace(&mut self.free, next);
                self.nodes[link as usize - 1] = node;
                link
            }
            None => {
                push(&mut self.nodes, node);
                self.nodes.len() as u32
            }
        }
    }

    /// Frees a node and all older ones.
    fn release(&mut self, mut link: u32) {
        while let Some(node) = self.node(link).copied() {
            self.nodes[link as usize - 1].older = self.free;
            self.free = link;
            link = node.older;
        }
    }

    fn place(&self, index: u32) -> Option<usize> {
        Some(self.places.get(index as usize)?.checked_sub(1)? as usize)
    }

    fn take_out(&mut self, place: usize) {
        let body = self.kept.swap_remove(place);
        self.release(body.newest);
        self.places[body.index as usize] = 0;
        if let Some(moved) = self.kept.get(place) {
            self.places[moved.index as usize] = place as u32 + 1;
        }
    }
}

/// No doubt at any tick.
const SURE: Tick = Tick::new(u64::MAX);

#[cfg(test)]
mod tests {
    use alloc::collections::{BTreeMap, BTreeSet};

    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyState, Predictor};

    use super::*;

    const BALL: BodyId = BodyId::new(3, 0);
    const OTHER: BodyId = BodyId::new(1, 0);

    #[test]
    fn a_body_is_guessed_from_the_silence_until_its_publisher_is_active() {
        let mut silent = SilentPublishers::default();
        silent.silence(BALL, Tick::new(10));
        silent.silence(OTHER, Tick::new(12));
        let guessed = |silent: &SilentPublishers, id, ticks: [u64; 4]| {
            ticks.map(|tick| silent.guesses(id, Tick::new(tick)))
        };
        assert_eq!(
            guessed(&silent, BALL, [9, 10, 11, 99]),
            [false, true, true, true]
        );
        assert_eq!(
            guessed(&silent, OTHER, [9, 11, 12, 99]),
            [false, false, true, true]
        );
        silent.confirm(BALL, Tick::new(20));
        assert_eq!(
            guessed(&silent, BALL, [9, 19, 20, 99]),
            [false, true, false, false]
        );
        silent.forget_before(Tick::new(19), |_| true);
        assert!(
            silent.guesses(BALL, Tick::new(19)),
            "a delayed view shows it"
        );
        // A second silence before a delayed view has passed the first one.
        silent.silence(BALL, Tick::new(25));
        assert!(silent.guesses(BALL, Tick::new(22)));
        silent.confirm(BALL, Tick::new(30));
        silent.forget_before(Tick::new(30), |id| id != OTHER);
        assert!(silent.spans.is_empty(), "one is over, one is gone");
    }

    #[derive(Clone, Copy, Debug)]
    enum Operation {
        /// The next track of a body, so many ticks later, while ticks after so many before it are shown.
        Keep(u32, u64, u64),
        Insert(u32, u64, u64),
        Forget(u32),
        ForgetUntil(u64),
    }

    fn operation() -> impl Strategy<Value = Operation> {
        let index = 0_u32..12;
        prop_oneof![
            4 => (index.clone(), 1_u64..5, 0_u64..30).prop_map(|(index, later, back)| Operation::Keep(index, later, back)),
            1 => (index.clone(), 0_u64..60, 0_u64..60).prop_map(|(index, tick, end)| Operation::Insert(index, tick, end)),
            1 => index.prop_map(Operation::Forget),
            1 => (0_u64..60).prop_map(Operation::ForgetUntil),
        ]
    }

    fn track(tick: u64) -> Track {
        let still = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        Track {
            origin: Tick::new(tick),
            predictor: Predictor::Rest,
            anchor: Anchor::Exact(still.unwrap()),
            parent: None,
        }
    }

    /// The origins of a body's tracks that are in force after a tick, and the newest one.
    fn trimmed(origins: &BTreeSet<u64>, end: u64) -> BTreeSet<u64> {
        let mut kept = BTreeSet::new();
        let mut replaced_at = u64::MAX;
        for origin in origins.iter().rev() {
            if replaced_at <= end {
                break;
            }
            kept.insert(*origin);
            replaced_at = *origin;
        }
        kept
    }

    proptest! {
        #[test]
        fn kept_tracks_are_found_by_body_and_tick(operations in proptest::collection::vec(operation(), 0..120)) {
            let mut before = EarlierTracks::default();
            let mut expected: BTreeMap<u32, BTreeSet<u64>> = BTreeMap::new();
            let mut newest: BTreeMap<u32, u64> = BTreeMap::new();
            for operation in operations {
                match operation {
                    Operation::Keep(index, later, back) => {
                        let tick = newest.get(&index).map_or(later, |tick| tick + later);
                        newest.insert(index, tick);
                        let end = tick.saturating_sub(back);
                        before.keep(index, DenseTrack::new(&track(tick)), Tick::new(end));
                        let origins = expected.entry(index).or_default();
                        origins.insert(tick);
                        *origins = trimmed(origins, end);
                    }
                    Operation::Insert(index, tick, end) => {
                        before.insert(index, DenseTrack::new(&track(tick)), Tick::new(end));
                        if let Some(origins) = expected.get_mut(&index) {
                            if origins.insert(tick) {
                                *origins = trimmed(origins, end);
                            }
                            let top = newest.entry(index).or_default();
                            *top = (*top).max(tick);
                        }
                    }
                    Operation::Forget(index) => {
                        before.forget(index);
                        expected.remove(&index);
                    }
                    Operation::ForgetUntil(end) => {
                        // The present track begins a tick after the newest kept one.
                        let origin = |index| newest.get(&index).map(|tick| Tick::new(tick + 1));
                        before.forget_until(Tick::new(end), origin);
                        expected.retain(|index, origins| {
                            *origins = trimmed(origins, end);
                            newest[index] + 1 > end
                        });
                    }
                }
                for index in 0..12 {
                    let origins = expected.get(&index);
                    let top = origins.and_then(|origins| origins.last());
                    prop_assert_eq!(before.newest_origin(index), top.map(|tick| Tick::new(*tick)));
                    for tick in 0..70 {
                        let found = origins.and_then(|origins| origins.range(..=tick).next_back());
                        let at = before.at(index, Tick::new(tick));
                        prop_assert_eq!(at.map(|at| at.track), found.map(|tick| track(*tick)));
                    }
                }
            }
            let linked: usize = (0..12).map(|index| before.nodes_of(index).count()).sum();
            let kept: usize = expected.values().map(BTreeSet::len).sum();
            prop_assert_eq!(linked, kept);
        }
    }

    #[test]
    fn the_tracks_of_a_body_are_bounded_and_their_memory_is_used_again() {
        let mut before = EarlierTracks::default();
        for tick in 0..5_000 {
            before.keep(3, DenseTrack::new(&track(tick)), Tick::ZERO);
        }
        let most = EARLIER_TRACKS_MAX as usize;
        assert_eq!(before.nodes_of(3).count(), most);
        assert!(before.nodes.len() <= most + 1);
    }

    #[test]
    fn a_doubt_is_about_the_ticks_after_it() {
        let mut before = EarlierTracks::default();
        before.keep(3, DenseTrack::new(&track(5)), Tick::ZERO);
        before.doubt_after(3, Tick::new(8));
        before.keep(3, DenseTrack::new(&track(12)), Tick::ZERO);
        let sure = |tick| before.at(3, Tick::new(tick)).map(|at| at.sure_until);
        assert_eq!(sure(6), Some(Tick::new(8)));
        assert_eq!(sure(12), Some(SURE));
    }
}
