//! The publisher of a reckoned stream: encodes updates for its subscribers.
//!
//! Compares observations with its tracks and sends an update for each body out of tolerance. Knows no receivers: an
//! update is encoded once for all. Ties the scan of a tick, the checks of its bodies, the budget and the packer.
//! Invariant: after `publish`, every observed body is within the tolerance of its track, grid error included, or is
//! reported as over budget.

mod body_check;
mod packer;
mod scan;
mod update_queue;

use alloc::vec::Vec;

use body_check::{BodyCheck, ObservedParent, PublishedTracks};
use bytes::Bytes;
use glam::Vec3;
use packer::{Packer, PublishedTick, bits_of};
use rhumb_reckoning::{BodyId, Tick, Ticks, Tolerance, Track};
use scan::ObservationScan;
use update_queue::UpdateQueue;

use super::observation_history::{Observation, ObservationHistory, ObservedTicks};
use super::tracks::PredictionParameters;
use super::{Budget, Features, PublisherStatistics, Redundancy, StreamConfig, second};
use crate::interner::push;
use crate::packet::{ErrorScale, LargestPacket, LossReport, StreamId, Update};

pub use update_queue::OverBudget;

/// The publisher of one reckoned stream.
#[derive(Debug)]
pub struct Publisher {
    features: Features,
    /// The tick up to which everything is published.
    tick: Tick,
    published: PublishedTracks,
    scan: ObservationScan,
    /// None without a budget.
    queue: Option<UpdateQueue>,
    packer: Packer,
    /// The bodies that left their tracks at a tick since the last published one, in order.
    strayed: Vec<BodyId>,
    /// The updates of the present tick.
    updates: Vec<Update>,
    /// The number of observations compared with tracks.
    checked: u64,
}

impl Publisher {
    /// A publisher of a stream without bodies.
    #[must_use]
    pub fn new(stream: StreamId, config: &StreamConfig, tick: Tick) -> Self {
        Self {
            features: config.features,
            tick,
            published: PublishedTracks::new(config),
            scan: ObservationScan::new(config),
            queue: None,
            packer: Packer::new(stream, config.largest_packet, &config.features),
            strayed: Vec::new(),
            updates: Vec::new(),
            checked: 0,
        }
    }

    /// Holds the stream to a budget from now on.
    ///
    /// Attachment is switched off, so that each update is useful alone.
    pub fn limit(&mut self, budget: Budget) {
        self.features.attached = false;
        let rate = self.published.tracks().integrator().rate;
        self.queue = Some(UpdateQueue::new(budget, rate));
    }

    /// Places a body that came into the scene or was changed. A scene event carries its track to every receiver.
    ///
    /// Returns `false` if the table is full, which the scene's own limits prevent.
    #[must_use]
    pub fn place(&mut self, id: BodyId, parameters: &PredictionParameters, track: Track) -> bool {
        self.scan.forget(id.index());
        self.published.place(id, parameters, track)
    }

    /// Removes a body from the scene. Its children are updated at the next tick.
    pub fn remove(&mut self, id: BodyId) {
        self.published.remove(id);
        self.scan.forget(id.index());
    }

    /// Changes the gravity from this tick on.
    pub fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.published.change_gravity(since, gravity);
        self.scan.forget_all();
    }

    /// Lets published ticks pass in which nothing was observed.
    pub(super) const fn pass(&mut self, to: Tick) {
        self.tick = to;
    }

    /// Publishes the present tick and appends the datagrams to `out`: none if every track still holds, or if no tick is
    /// due.
    ///
    /// `scene_events`: the scene's number of events up to the newest observed tick.
    pub fn publish(
        &mut self,
        observation_history: &ObservationHistory,
        scene_events: u64,
        out: &mut Vec<Bytes>,
    ) {
        if self.update(observation_history) {
            self.pack(scene_events, out);
            self.published.end_tick();
        }
    }

    /// Chooses the updates of the present tick as [`Self::publish`] does, but encodes nothing; returns their number.
    ///
    /// For measurements: no subscriber can follow.
    #[doc(hidden)]
    pub fn choose(&mut self, observation_history: &ObservationHistory) -> usize {
        if !self.update(observation_history) {
            return 0;
        }
        self.published.end_tick();
        self.updates.len()
    }

    /// Replaces the tracks that no longer hold, and collects their updates; `false` if no tick is due.
    fn update(&mut self, observation_history: &ObservationHistory) -> bool {
        let Some(tick) = observation_history.due_after(self.tick) else {
            if let Some(tick) = observation_history.passing_after(self.tick) {
                self.note_strayed(tick, observation_history.at(tick).unwrap_or_default());
            }
            return false;
        };
        let passed = tick.since(self.tick).unwrap_or_default();
        self.tick = tick;
        let ticks = ObservedTicks::around(observation_history, tick);
        self.checked += ticks.present.len() as u64;
        self.updates.clear();
        self.published.begin_tick();
        if self.queue.is_some() {
            self.update_within_budget(ticks, passed);
        } else {
            self.update_all(ticks);
        }
        true
    }

    /// Notes the bodies that are out of tolerance at a tick that is not published: the next published one replaces their
    /// tracks, even if those hold again. So a track that is not replaced held at each tick.
    fn note_strayed(&mut self, tick: Tick, observations: &[Observation]) {
        if self.queue.is_some() {
            // The bounds of a stream with a budget are those of its published ticks.
            return;
        }
        let (published, scan) = (&self.published, &mut self.scan);
        scan.scan(published, tick, observations);
        self.checked += observations.len() as u64;
        let undecided = scan.undecided().map(|place| &observations[place]);
        let strayed = undecided.filter(|observation| published.has_strayed(tick, observation));
        self.strayed
            .extend(strayed.map(|observation| observation.id));
        self.strayed.sort_unstable();
        self.strayed.dedup();
    }

    /// Updates every body whose track no longer holds, or did not since the last published tick.
    fn update_all(&mut self, ticks: ObservedTicks<'_>) {
        let (published, scan) = (&mut self.published, &mut self.scan);
        let mut strayed = core::mem::take(&mut self.strayed);
        let check = BodyCheck::new(ticks, self.features).after_straying(&strayed);
        scan.scan(published, ticks.tick, ticks.present);
        let mut update = |published: &mut PublishedTracks, place: usize, parent| {
            let observed = (place, &ticks.present[place]);
            if let Some(update) = check.update(published, observed, parent) {
                push(&mut self.updates, update);
            }
        };
        scan.add(&strayed, ticks.present);
        scan.find_parent_candidates(published, (ticks.tick, ticks.present));
        // Possible parents are checked first, so that a child is compared with its parent's published track.
        for place in scan.parent_candidates().places() {
            update(published, place, None);
        }
        scan.collect_other_parents(published, ticks.present);
        for place in scan.other_parents() {
            update(published, place, None);
        }
        scan.parent_candidates_mut()
            .observe(published.tracks(), &ticks);
        for place in scan.others() {
            let parent_candidates = scan.parent_candidates();
            let parent: Option<&ObservedParent> =
                parent_candidates.parent_of(published.tracks(), &ticks.present[place]);
            update(published, place, parent);
        }
        scan.note_updated(published.tracks(), &ticks);
        // The buffer is used again.
        strayed.clear();
        self.strayed = strayed;
    }

    /// Updates the bodies that the budget allows, `passed` ticks after the last published one. The others wait.
    fn update_within_budget(&mut self, ticks: ObservedTicks<'_>, passed: Ticks) {
        let Some(queue) = &mut self.queue else {
            return;
        };
        let (tick, published) = (ticks.tick, &mut self.published);
        let check = BodyCheck::new(ticks, self.features);
        let due = queue.begin_tick(tick, passed, ticks.present, |observation| {
            check.need(published, observation)
        });
        let mut due = queue.spend(due, tick);
        let check = check.loosened(due.slack());
        while let Some(observation) = due.next() {
            let update = check.update(published, (0, &observation), None);
            let bits = update.as_ref().map_or(0, bits_of);
            self.updates.extend(update);
            // After an update under raised tolerances, the body may still exceed its own tolerance.
            let left = check.need(published, &observation);
            due.pass(bits, left.map_or(1.0, |need| need.share));
        }
        due.end();
    }

    /// Encodes the updates of the present tick into datagrams.
    fn pack(&mut self, scene_events: u64, out: &mut Vec<Bytes>) {
        let (at, first) = (self.at(scene_events), out.len());
        let aliases = self.published.aliases();
        self.packer.pack(&at, &mut self.updates, aliases, out);
        if let Some(queue) = &mut self.queue
            && !self.updates.is_empty()
        {
            queue.pay_packets(out[first..].iter().map(Bytes::len).sum());
        }
    }

    /// Encodes the repair symbols that are due after a published tick, silent or not, and appends them to `out`. A budget
    /// pays for them, and has none while it does not suffice for updates.
    pub fn encode_repair_symbols(&mut self, redundancy: Redundancy, out: &mut Vec<Bytes>) {
        let spares = self.queue.as_ref().is_none_or(UpdateQueue::spares);
        let redundancy = if spares { redundancy } else { Redundancy::Off };
        let first = out.len();
        self.packer.encode_repair_symbols(redundancy, out);
        self.pay(out[first..].iter().map(Bytes::len).sum());
    }

    /// Answers the only receiver of a stream, which is sent all repair symbols: see `answer_one`.
    pub fn answer(&mut self, loss_report: &LossReport, out: &mut Vec<Bytes>) -> Vec<u64> {
        self.answer_one(loss_report, Some(0), out)
    }

    /// Answers a receiver that lost packets. Appends repair symbols to `out` where they suffice, and returns the
    /// numbers of the packets that must be refreshed instead, each once.
    ///
    /// `sent_from`: the number of the next packet when this receiver was first sent the symbols of
    /// [`Self::encode_repair_symbols`]; `None` if it is sent none.
    pub(crate) fn answer_one(
        &mut self,
        loss_report: &LossReport,
        sent_from: Option<u64>,
        out: &mut Vec<Bytes>,
    ) -> Vec<u64> {
        self.packer.answer(loss_report, sent_from, out)
    }

    /// The datagrams with the present tracks of a lost packet's bodies; `None` for a packet that is too old.
    #[must_use]
    pub fn refresh(&self, number: u64, scene_events: u64) -> Option<Vec<Bytes>> {
        self.packer
            .refresh(number, &self.at(scene_events), |index| {
                self.published.refresh_record(index, self.tick)
            })
    }

    /// Spends bytes of the budget on datagrams other than packets.
    pub fn pay(&mut self, bytes: usize) {
        if let Some(queue) = &mut self.queue {
            queue.pay(bytes);
        }
    }

    /// The checksum over all tracks, by hashing only the tracks that changed since the last call.
    pub(super) fn settle_checksum(&mut self) -> u64 {
        self.published.settle_checksum()
    }

    /// The checksum over all tracks; a converged subscriber has the same.
    #[must_use]
    pub fn state_checksum(&self) -> u64 {
        self.published.tracks().state_checksum()
    }

    /// The datagram with the checksum over all tracks. `scene_events`: the scene's number of events so far.
    #[must_use]
    pub fn checksums(&self, scene_events: u64) -> Bytes {
        self.packer
            .checksums(&self.at(scene_events), self.state_checksum())
    }

    /// The watermark for the silence since the last packet.
    #[must_use]
    pub fn watermark(&self, scene_events: u64) -> Bytes {
        self.packer.watermark(&self.at(scene_events))
    }

    /// The id of the stream.
    #[must_use]
    pub const fn stream(&self) -> StreamId {
        self.packer.stream()
    }

    /// The largest packet that it makes.
    #[must_use]
    pub const fn largest_packet(&self) -> LargestPacket {
        self.packer.largest_packet()
    }

    /// The tolerance of a body with the usual scale.
    #[must_use]
    pub const fn tolerance(&self) -> Tolerance {
        self.published.tracks().tolerance()
    }

    /// Counters of everything published so far.
    #[must_use]
    pub fn statistics(&self) -> PublisherStatistics {
        PublisherStatistics {
            checked: self.checked,
            over_budget: self.queue.as_ref().map_or(0, UpdateQueue::over_budget),
            ..self.packer.statistics()
        }
    }

    /// The gravity and the first tick of each change that a track may refer to. A late receiver needs them before the
    /// tracks.
    pub fn gravity_changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        self.published.tracks().gravity_changes()
    }

    /// Every body's track, in order of index, for a late receiver.
    pub fn tracks(&self) -> impl Iterator<Item = (BodyId, Track)> {
        let slots = self.published.tracks().iter();
        slots.map(|(index, slot)| (slot.id(index), slot.track()))
    }

    /// The alias of a body, for a late receiver.
    #[must_use]
    pub fn alias(&self, id: BodyId) -> Option<u32> {
        self.published.aliases().of(id.index())
    }

    /// The number of the next packet.
    #[must_use]
    pub const fn next_number(&self) -> u64 {
        self.packer.next_number()
    }

    /// The tick up to which everything is published.
    #[must_use]
    pub const fn tick(&self) -> Tick {
        self.tick
    }

    /// Whole ticks in a second of the scene, at least one.
    #[must_use]
    pub fn second(&self) -> Ticks {
        second(self.published.tracks().integrator().rate)
    }

    /// The greatest factor by which tracks exceed their tolerances, at the ticks since the last packet. If a packet was
    /// sent at this tick, at the ticks that it covers: a watermark may arrive without the packet before it.
    #[must_use]
    pub fn error_scale(&self) -> ErrorScale {
        let queue = self.queue.as_ref();
        queue.map_or(ErrorScale::NONE, UpdateQueue::error_scale)
    }

    /// The number of bodies whose updates wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.queue.as_ref().map_or(0, UpdateQueue::len)
    }

    /// The bodies whose updates wait, in order of index.
    pub fn over_budget(&self) -> impl Iterator<Item = OverBudget> {
        self.queue.iter().flat_map(UpdateQueue::waiting)
    }

    /// The waiting body whose track uses the greatest share of its tolerance.
    #[must_use]
    pub fn worst_waiting(&self) -> Option<OverBudget> {
        let waiting = self.over_budget();
        waiting.max_by(|a, b| a.share.total_cmp(&b.share))
    }

    /// True if the stream has a budget.
    pub(super) const fn has_budget(&self) -> bool {
        self.queue.is_some()
    }

    /// True if checksums are sent.
    pub(super) const fn sends_checksums(&self) -> bool {
        self.features.checksums
    }

    /// The state that datagrams of the present tick refer to.
    fn at(&self, scene_events: u64) -> PublishedTick {
        PublishedTick {
            tick: self.tick,
            scene_events,
            error_scale: self.error_scale(),
        }
    }
}
