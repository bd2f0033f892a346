//! One member of a scene: its state, and the bodies under its authority.
//!
//! Its streams and pending requests. Streams are known by name only; the running scene starts and ends them.
//!
//! The member publishes them, and each step puts them where its upstream has them. Which bodies a member may have is
//! decided in `rights`.

use std::collections::VecDeque;
use std::collections::btree_map::{BTreeMap, Entry};

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_protocol::limits::{CELLS_PER_MEMBER_MAX, QUERY_COST_MAX};
use rhumb_protocol::message::{Denial, SceneEvent, StreamChoice};
use rhumb_protocol::packet::{Datagram, PacketKind, StreamId};
use rhumb_protocol::scene::{Cell, Command, IdRange, Locomotion};
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::stream::SubscriberStatistics;
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::{BodyId, Tick, Tolerance};

use crate::event_monitor::EventKey;
use crate::permit::Quotas;
use crate::record::SessionNumber;
use crate::scene::Scene;
use crate::tier_controller::TierController;

/// A client that is a member.
#[derive(Debug)]
pub(crate) struct Member {
    subscription: Subscribed,
    /// The cells that it takes; `None` for one that takes the whole scene.
    pub(crate) cells: Option<BTreeMap<Cell, Subscribed>>,
    /// When its next command would be within its quota.
    next_command: Instant,
    /// When its next request about a cell would be within the rate of those.
    next_cell_request: Instant,
    /// Commands of this membership, or of its session, that were applied or refused.
    commands: u64,
    /// Number of the last of them, while it is not answered.
    pub(crate) unanswered: Option<u64>,
    /// The snapshot to send once all its input of one read is handled; the last request counts.
    pub(crate) snapshot_request: Option<SnapshotRequest>,
    /// The same of cells.
    pub(crate) cell_requests: BTreeMap<Cell, SnapshotRequest>,
    /// Controls the tier of its stream by the state of its link.
    pub(crate) link: TierController,
    /// Weight of its messages that wait for the steps of an advance.
    pub(crate) pending_bytes: usize,
    /// Bytes of the scene events that its commands caused, less [`ADDED_PER_SECOND`] since.
    pub(crate) added_bytes: usize,
    added_at: Instant,
    /// Its body indices, never none.
    pub(crate) ids: Vec<IdRange>,
    /// The bodies under its authority, if there are any.
    pub(crate) authority: Option<AuthorityGroup>,
    /// Its session, if it has one.
    pub(crate) session: Option<SessionNumber>,
    /// True if commands are numbered that the log has not got yet.
    undurable: bool,
    /// Its commands that the log has and that are not durable.
    pub(crate) awaited: Acknowledgements,
    /// Messages of queries of this membership that were answered.
    queries: u64,
    pub(crate) query_budget: QueryBudget,
    /// Events of bodies that it was not sent because it reads too slowly.
    pub(crate) missed_events: u64,
    /// The last event that it got of those that stand; `None` once it knows them all.
    pub(crate) standing_after: Option<EventKey>,
}

/// Bytes of scene events that a member may cause at once while others are behind.
const ADDED_AT_ONCE: usize = 64 << 10;
/// The same in a second: less than thin links carry, so that a member that reads slower falls behind and is closed.
const ADDED_PER_SECOND: u64 = 256 << 10;

const NANOS_PER_SECOND: u64 = 1_000_000_000;
/// The time of a request about a cell: all 256 of a member are taken, changed and given up more than twice a second.
const CELL_REQUEST_INTERVAL: Span = Span::from_nanos(NANOS_PER_SECOND / 2_048);

/// The snapshot that a member waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SnapshotRequest {
    /// A snapshot of its present stream.
    Again,
    /// A snapshot of another stream.
    Other(StreamChoice),
}

impl Member {
    /// A new member that subscribes to a stream.
    /// `commands`: those of its session before.
    pub(crate) fn new(
        (stream, choice): (StreamId, StreamChoice),
        (session, ids): (Option<SessionNumber>, Vec<IdRange>),
        commands: u64,
    ) -> Self {
        Self {
            subscription: Subscribed::to(stream),
            cells: None,
            next_command: Instant::ZERO,
            next_cell_request: Instant::ZERO,
            commands,
            unanswered: None,
            snapshot_request: None,
            cell_requests: BTreeMap::new(),
            link: TierController::new(choice),
            pending_bytes: 0,
            added_bytes: 0,
            added_at: Instant::ZERO,
            ids,
            authority: None,
            session,
            undurable: false,
            awaited: Acknowledgements::default(),
            queries: 0,
            query_budget: QueryBudget::new(),
            missed_events: 0,
            standing_after: None,
        }
    }

    /// Counts events that it is not sent. Later it gets what stands.
    pub(crate) const fn miss_events(&mut self, count: u64) {
        self.missed_events += count;
        if count > 0 {
            self.standing_after = Some(EventKey::FIRST);
        }
    }

    /// True if its commands caused more scene events than they may while others are behind.
    pub(crate) fn adds_too_much(&mut self, now: Instant) -> bool {
        if self.added_bytes <= ADDED_AT_ONCE {
            return false;
        }
        let allowed = now.since(self.added_at).as_nanos() / 1_000 * ADDED_PER_SECOND / 1_000_000;
        if allowed > 0 {
            self.added_at = now;
        }
        self.added_bytes = self.added_bytes.saturating_sub(allowed as usize);
        self.added_bytes > ADDED_AT_ONCE
    }

    /// Charges a command to the quota of commands in a second.
    pub(crate) fn charge_command(&mut self, quotas: &Quotas, now: Instant) {
        if let Some(commands) = quotas.commands {
            let interval = Span::from_nanos(NANOS_PER_SECOND / u64::from(commands.max(1)));
            self.next_command = self.next_command.max(now) + interval;
        }
    }

    /// Charges a request about a cell.
    pub(crate) fn charge_cell_request(&mut self, now: Instant) {
        self.next_cell_request = self.next_cell_request.max(now) + CELL_REQUEST_INTERVAL;
    }

    /// True if its commands are a second ahead of its quota, or its requests about cells half a second ahead of their rate:
    /// then it waits.
    pub(crate) fn is_over_rate(&self, now: Instant) -> bool {
        self.next_command.since(now).as_nanos() > NANOS_PER_SECOND
            || self.next_cell_request.since(now).as_nanos() > NANOS_PER_SECOND / 2
    }

    /// The number of the command that is applied or refused now.
    pub(crate) const fn number_command(&mut self) -> u64 {
        let number = self.commands;
        self.commands += 1;
        self.unanswered = Some(number);
        self.undurable = self.session.is_some();
        number
    }

    /// The log got all commands so far with this batch.
    pub(crate) fn note_logged(&mut self, batch: u64, tick: Tick) {
        if std::mem::take(&mut self.undurable) {
            let count = self.commands;
            self.awaited.push(batch, SessionCommands { count, tick });
        }
    }

    /// The number of the message of queries that is answered now.
    pub(crate) const fn number_query(&mut self) -> u64 {
        let number = self.queries;
        self.queries += 1;
        number
    }

    /// The same that takes the scene by cells.
    pub(crate) fn by_cells(self) -> Self {
        Self {
            cells: Some(BTreeMap::new()),
            ..self
        }
    }

    /// The part of the scene that it takes.
    pub(crate) const fn extent(&self) -> Extent {
        match self.cells {
            Some(_) => Extent::Cells,
            None => Extent::Whole,
        }
    }

    /// The present stream.
    pub(crate) const fn stream(&self) -> StreamId {
        self.subscription.present
    }

    /// The streams of the scene whose datagrams it gets, each once.
    pub(crate) fn streams(&self) -> impl Iterator<Item = StreamId> + use<> {
        self.subscription.streams()
    }

    /// The streams of cells whose datagrams it gets, each once.
    pub(crate) fn cell_streams(&self) -> impl Iterator<Item = (Cell, StreamId)> {
        let cells = self.cells.iter().flatten();
        cells.flat_map(|(cell, subscribed)| subscribed.streams().map(|stream| (*cell, stream)))
    }

    /// The member's subscription to a cell.
    pub(crate) fn subscribed(&self, cell: Cell) -> Option<&Subscribed> {
        self.cells.as_ref()?.get(&cell)
    }

    /// See [`Self::subscribed`].
    pub(crate) fn subscribed_mut(&mut self, cell: Cell) -> Option<&mut Subscribed> {
        self.cells.as_mut()?.get_mut(&cell)
    }

    /// Asks for the snapshot of a stream of a cell. The last request that is not answered counts.
    pub(crate) fn request_cell(&mut self, cell: Cell, choice: StreamChoice) -> Result<(), Denial> {
        self.cells.as_ref().ok_or(Denial::NoSuchScene)?;
        let others = self.cell_requests.len();
        if others >= CELLS_PER_MEMBER_MAX && !self.cell_requests.contains_key(&cell) {
            return Err(Denial::TooManyStreams);
        }
        let request = SnapshotRequest::Other(choice);
        self.cell_requests.insert(cell, request);
        Ok(())
    }

    /// Asks for a new snapshot of a cell; returns its stream unless one was asked for already.
    pub(crate) fn request_cell_again(&mut self, cell: Cell) -> Option<StreamId> {
        let stream = self.cells.as_ref()?.get(&cell)?.present();
        match self.cell_requests.entry(cell) {
            Entry::Vacant(entry) => {
                entry.insert(SnapshotRequest::Again);
                Some(stream)
            }
            Entry::Occupied(_) => None,
        }
    }

    /// Gives a cell up; returns what it received of it.
    pub(crate) fn leave_cell(&mut self, cell: Cell) -> Option<Subscribed> {
        self.cell_requests.remove(&cell);
        self.cells.as_mut()?.remove(&cell)
    }

    /// True if it waits for a snapshot.
    pub(crate) fn awaits_snapshot(&self) -> bool {
        self.snapshot_request.is_some() || !self.cell_requests.is_empty()
    }

    /// See [`Subscribed::change`].
    pub(crate) fn change(&mut self, to: StreamId) -> Option<StreamId> {
        self.subscription.change(to)
    }

    /// See [`Subscribed::caught_up`].
    pub(crate) fn caught_up(&mut self, with: StreamId) -> Option<StreamId> {
        self.subscription.caught_up(with)
    }

    /// The cell of a stream whose datagrams it gets; none for a stream of the scene.
    pub(crate) fn receives(&self, stream: StreamId) -> Option<Option<Cell>> {
        if self.streams().any(|subscribed| subscribed == stream) {
            return Some(None);
        }
        let mut of_cells = self.cell_streams();
        of_cells.find_map(|(cell, subscribed)| (subscribed == stream).then_some(Some(cell)))
    }
}

/// The part of a scene that a member takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Extent {
    /// All of it.
    Whole,
    /// Cells, as it asks for them, if the scene is divided.
    Cells,
}

/// A member's stream, of a scene or of a cell, and the one before it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subscribed {
    present: StreamId,
    /// The former stream, until the member has caught up with the present one.
    previous: Option<StreamId>,
}

impl Subscribed {
    /// A subscription to a first stream.
    pub(crate) const fn to(stream: StreamId) -> Self {
        Self {
            present: stream,
            previous: None,
        }
    }

    /// The present stream.
    pub(crate) const fn present(&self) -> StreamId {
        self.present
    }

    /// Both streams, each once.
    pub(crate) fn streams(&self) -> impl Iterator<Item = StreamId> + use<> {
        [Some(self.present), self.previous].into_iter().flatten()
    }

    /// Changes to another stream than the present one; returns the stream to unsubscribe, if any. The member stays
    /// subscribed to the stream of its complete copy.
    pub(crate) fn change(&mut self, to: StreamId) -> Option<StreamId> {
        let before = std::mem::replace(&mut self.present, to);
        match self.previous {
            None => {
                self.previous = Some(before);
                None
            }
            Some(previous) => {
                self.previous = (previous != to).then_some(previous);
                Some(before)
            }
        }
    }

    /// The member has caught up with a stream; returns the stream to unsubscribe, if any.
    pub(crate) fn caught_up(&mut self, with: StreamId) -> Option<StreamId> {
        if with != self.present {
            return None;
        }
        self.previous.take()
    }
}

/// Commands of a member's session that are done and not yet reported as durable, by the batches of the log.
///
/// Bounded, however long the disk takes. Invariants: no command is acknowledged before its batch is durable, and none is put
/// off for ever by those that follow it.
#[derive(Debug, Default)]
pub(crate) struct Acknowledgements(VecDeque<(u64, SessionCommands)>);

/// Commands of a member's session that are done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SessionCommands {
    /// Their number, from the first one of the session on.
    pub(crate) count: u64,
    /// The tick before the step in which the last of them acts, or a later one.
    pub(crate) tick: Tick,
}

/// Batches at most. The newest one stands for those beyond it: their commands are acknowledged with the last of them.
const BATCHES_MAX: usize = 256;

impl Acknowledgements {
    /// Adds commands that wait for a batch, the newest one.
    pub(crate) fn push(&mut self, batch: u64, commands: SessionCommands) {
        if self.0.len() >= BATCHES_MAX {
            self.0.pop_back();
        }
        self.0.push_back((batch, commands));
    }

    /// The commands of the oldest batch, if batches are durable up to it.
    pub(crate) fn pop_durable(&mut self, durable: u64) -> Option<SessionCommands> {
        let (batch, commands) = *self.0.front()?;
        (batch <= durable).then(|| self.0.pop_front())?;
        Some(commands)
    }
}

/// Cost of all queries of a scene in a second: about a fifth of a core.
const COST_PER_SECOND: u64 = 100_000;
/// Cost that a member may have answered at once: two of the largest messages.
const BURST: u64 = 2 * QUERY_COST_MAX as u64;
/// Parts of a unit of cost, so that short times earn something.
const PARTS: u64 = 1_000_000;

/// The rest of a member's share of query time.
///
/// Costs are those of the protocol: one is a body that a ray finds, some 2 µs in a scene of 10,000 bodies.
#[derive(Debug)]
pub(crate) struct QueryBudget {
    left: u64,
    earned_at: Instant,
}

impl QueryBudget {
    /// A full budget.
    pub(crate) const fn new() -> Self {
        Self {
            left: BURST * PARTS,
            earned_at: Instant::ZERO,
        }
    }

    /// Takes the cost of a message, unless too little is left. The members of a scene share its time equally.
    pub(crate) fn spend(&mut self, now: Instant, cost: u32, members: usize) -> bool {
        let micros = now.since(self.earned_at).as_nanos() / 1_000;
        let earned = micros.saturating_mul(COST_PER_SECOND) / members.max(1) as u64;
        if earned > 0 {
            self.earned_at = now;
            self.left = self.left.saturating_add(earned).min(BURST * PARTS);
        }
        let rest = self.left.checked_sub(u64::from(cost) * PARTS);
        self.left = rest.unwrap_or(self.left);
        rest.is_some()
    }
}

/// State of the bodies under one member's authority.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpstreamStatistics {
    /// The member with authority.
    pub member: Peer,
    /// Number of bodies.
    pub bodies: usize,
    /// Tolerance of the upstream.
    pub tolerance: Tolerance,
    /// Newest tick up to which the upstream is complete at its sender.
    pub watermark_tick: Tick,
    /// Counters of the received upstream.
    pub received: SubscriberStatistics,
    /// Steps for which the bodies got targets from the upstream.
    pub steps: u64,
    /// Steps for which an update came too late: a larger lead helps.
    pub late_steps: u64,
    /// The newest step.
    pub tick: Tick,
    /// One bit for each of the newest steps, set if it was late; the newest in the lowest bit.
    late: u128,
    /// The number of targets refused, since no body may be there.
    pub refused: u64,
}

impl UpstreamStatistics {
    /// True if every update for a tick arrived before the step to it: each body is then within the tolerance of its
    /// sender's. False for ticks beyond the watermark, and for those long ago.
    #[must_use]
    pub fn was_complete_at(&self, tick: Tick) -> bool {
        let age = self
            .tick
            .since(tick)
            .map_or(u64::MAX, |age| u64::from(age.count()));
        tick <= self.watermark_tick && age < self.steps.min(LATE_KEPT) && self.late >> age & 1 == 0
    }
}

/// Bodies under one member's authority.
#[derive(Debug)]
pub(crate) struct AuthorityGroup {
    receiver: UpstreamReceiver,
    /// Last target of each body, in the engine's numbers.
    put: BTreeMap<BodyId, (Vec3, Quat)>,
    steps: u64,
    late_steps: u64,
    /// One bit for each of the newest steps, set if it was late; the newest in the lowest bit.
    late: u128,
    refused: u64,
    silence: Option<UpstreamSilence>,
}

/// The silence of a member.
#[derive(Clone, Copy, Debug)]
struct UpstreamSilence {
    /// The first tick that the member has not confirmed.
    since: Tick,
    /// The tick of the step before which it was noted.
    noted: Tick,
}

/// Steps whose lateness is kept.
const LATE_KEPT: u64 = 128;

impl AuthorityGroup {
    /// Bodies that stand where their upstream has them.
    pub(crate) const fn new(receiver: UpstreamReceiver) -> Self {
        Self {
            receiver,
            put: BTreeMap::new(),
            steps: 0,
            late_steps: 0,
            late: 0,
            refused: 0,
            silence: None,
        }
    }

    /// The bodies.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = BodyId> {
        self.receiver.bodies()
    }

    /// The name of the upstream.
    pub(crate) const fn stream(&self) -> StreamId {
        self.receiver.stream()
    }

    /// True while nothing arrives.
    pub(crate) const fn is_silent(&self) -> bool {
        self.silence.is_some()
    }

    /// Removes a body that has left the scene.
    pub(crate) fn remove(&mut self, id: BodyId) {
        self.receiver.remove(id);
    }

    /// Handles a packet; drops one of another stream. Returns `false` when the upstream has lost sync.
    #[must_use]
    pub(crate) fn handle_datagram(&mut self, datagram: &Datagram<'_>, present: Tick) -> bool {
        let head = datagram.head();
        if head.stream == self.receiver.stream() && is_from_publisher(head.kind) {
            let since = self.receiver.handle_datagram(datagram);
            self.note_late(since, present);
        }
        !self.receiver.has_lost_sync()
    }

    /// Sets the targets of all bodies for the next step. Returns the scene event of a member that became silent or is
    /// active again.
    pub(crate) fn set_targets(&mut self, peer: Peer, scene: &mut Scene) -> Option<SceneEvent> {
        let tick = scene.tick().next();
        self.put(scene, tick);
        self.steps += 1;
        let incomplete = !self.receiver.is_complete_at(tick);
        self.late = self.late << 1 | u128::from(incomplete);
        self.late_steps += u64::from(incomplete);
        self.note_silence(peer, tick)
    }

    /// The scene event of a silent member, for a snapshot.
    pub(crate) fn silence(&self) -> Option<SceneEvent> {
        Some(SceneEvent::PublisherSilent {
            since: self.silence?.since,
            bodies: self.receiver.bodies().collect(),
        })
    }

    /// NACKs for lost packets, and a probe to a silent member.
    pub(crate) fn poll_reports(&mut self, now: Instant, tick: Tick) -> Vec<Bytes> {
        let mut reports = Vec::new();
        self.receiver.poll_reports(now, tick, &mut reports);
        reports
    }

    /// Its statistics.
    pub(crate) fn statistics(&self, member: Peer, present: Tick) -> UpstreamStatistics {
        UpstreamStatistics {
            member,
            bodies: self.receiver.bodies().count(),
            tolerance: self.receiver.tolerance(),
            watermark_tick: self.receiver.watermark_tick(),
            received: self.receiver.statistics(),
            steps: self.steps,
            late_steps: self.late_steps,
            tick: present,
            late: self.late,
            refused: self.refused,
        }
    }

    /// Logs how it went; one that begins and ends without a step between is not logged.
    pub(crate) fn log_end(&self, peer: Peer) {
        if self.steps == 0 {
            return;
        }
        tracing::info!(
            peer = peer.0,
            steps = self.steps,
            late_steps = self.late_steps,
            refused = self.refused,
            received = ?self.receiver.statistics(),
            "authority ended"
        );
    }

    /// Sets the target of each body for a tick, before the step to it.
    ///
    /// A body whose target is unchanged is left alone, so that it and the bodies on it may sleep; a character is not,
    /// for it would fall. A body whose target is not allowed stays where it is.
    fn put(&mut self, scene: &mut Scene, tick: Tick) {
        for (id, motion) in self.receiver.motions(tick) {
            let pose = motion.pose();
            let (position, rotation) = (pose.position.as_vec3(), pose.rotation.as_quat());
            let walks = matches!(scene.locomotion(id), Some(Locomotion::Character(_)));
            if !walks && self.put.get(&id) == Some(&(position, rotation)) {
                continue;
            }
            let there = scene.apply(&Command::SetPose {
                id,
                position,
                rotation,
            });
            // A velocity after a pose has the body there in this step, however many passed since the last pose.
            let there = there.and_then(|()| {
                scene.apply(&Command::SetVelocity {
                    id,
                    linear: Vec3::ZERO,
                    angular: Vec3::ZERO,
                })
            });
            match there {
                Ok(()) => drop(self.put.insert(id, (position, rotation))),
                Err(_) => self.refused += 1,
            }
        }
    }

    /// The scene event of a member that became silent, or is active again, before the step to a tick. A member is active
    /// again when it has confirmed a tick after the silence was noted: to answer that nothing is new is not enough.
    fn note_silence(&mut self, peer: Peer, tick: Tick) -> Option<SceneEvent> {
        let watermark_tick = self.receiver.watermark_tick();
        let bodies = || self.receiver.bodies().collect();
        match (self.silence, self.receiver.silent_since(tick)) {
            (None, Some(since)) => {
                tracing::warn!(
                    peer = peer.0,
                    watermark_tick = watermark_tick.value(),
                    "nothing arrives from an upstream: its bodies are predicted, and soon stand still"
                );
                let bodies = bodies();
                self.silence = Some(UpstreamSilence { since, noted: tick });
                Some(SceneEvent::PublisherSilent { since, bodies })
            }
            (Some(silence), None) if watermark_tick >= silence.noted => {
                let bodies = bodies();
                self.silence = None;
                Some(SceneEvent::PublisherActive { tick, bodies })
            }
            _ => None,
        }
    }

    /// Notes an update for ticks from `since` on that came after the steps to them.
    fn note_late(&mut self, since: Option<Tick>, present: Tick) {
        let Some(late) = since.and_then(|since| present.since(since)) else {
            return;
        };
        let steps = (u64::from(late.count()) + 1).min(self.steps).min(LATE_KEPT);
        let mask = 1_u128
            .checked_shl(steps as u32)
            .unwrap_or_default()
            .wrapping_sub(1);
        self.late_steps += u64::from((mask & !self.late).count_ones());
        self.late |= mask;
    }
}

/// True if the publisher of a stream sends this kind of packet.
const fn is_from_publisher(kind: PacketKind) -> bool {
    matches!(
        kind,
        PacketKind::Updates
            | PacketKind::UpdatesEnd
            | PacketKind::Watermark
            | PacketKind::Refresh
            | PacketKind::Checksums
            | PacketKind::RepairSymbol
    )
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::Span;

    use super::*;

    const A: StreamId = StreamId(1);
    const B: StreamId = StreamId(2);
    const C: StreamId = StreamId(3);

    fn member() -> Member {
        Member::new((A, StreamChoice::Full), (None, Vec::new()), 0)
    }

    fn subscribed(member: &Member) -> Vec<StreamId> {
        member.streams().collect()
    }

    #[test]
    fn the_former_stream_stays_until_the_new_one_has_caught_up() {
        let mut member = member();
        assert_eq!(member.change(B), None);
        assert_eq!(subscribed(&member), [B, A]);
        assert_eq!(member.caught_up(A), None);
        assert_eq!(member.caught_up(B), Some(A));
        assert_eq!(subscribed(&member), [B]);
    }

    #[test]
    fn a_second_change_keeps_the_complete_replica_s_stream() {
        let mut member = member();
        assert_eq!(member.change(B), None);
        assert_eq!(member.change(C), Some(B));
        assert_eq!(subscribed(&member), [C, A]);
        assert_eq!(member.caught_up(C), Some(A));
    }

    #[test]
    fn changing_back_subscribes_once() {
        let mut member = member();
        assert_eq!(member.change(B), None);
        assert_eq!(member.change(A), Some(B));
        assert_eq!(subscribed(&member), [A]);
    }

    #[test]
    fn members_share_the_time_of_a_scene() {
        for members in [1, 4] {
            let mut budgets: Vec<_> = (0..members).map(|_| QueryBudget::new()).collect();
            let mut answered = 0_u64;
            for millis in 0..10_000 {
                let now = Instant::ZERO + Span::from_millis(millis);
                for budget in &mut budgets {
                    answered += u64::from(budget.spend(now, 1_000, members)) * 1_000;
                }
            }
            let most = 10 * COST_PER_SECOND + members as u64 * BURST;
            assert!((most - 10_000..=most).contains(&answered), "{answered}");
        }
    }

    fn commands(count: u64) -> SessionCommands {
        let tick = Tick::new(count / 2);
        SessionCommands { count, tick }
    }

    /// The counts that a member learns when batches are durable up to a number.
    fn learned(waiting: &mut Acknowledgements, durable: u64) -> Vec<u64> {
        let commands = std::iter::from_fn(|| waiting.pop_durable(durable));
        commands.map(|commands| commands.count).collect()
    }

    #[test]
    fn commands_are_acknowledged_with_their_batch_and_not_before() {
        let mut waiting = Acknowledgements::default();
        waiting.push(3, commands(7));
        waiting.push(5, commands(9));
        assert_eq!(waiting.pop_durable(2), None);
        assert_eq!(waiting.pop_durable(4), Some(commands(7)));
        assert_eq!(waiting.pop_durable(4), None);
        assert_eq!(waiting.pop_durable(5), Some(commands(9)));
        assert_eq!(waiting.pop_durable(9), None);
    }

    #[test]
    fn what_waits_is_bounded_and_every_command_is_acknowledged() {
        let mut waiting = Acknowledgements::default();
        for number in 1..=10_000 {
            waiting.push(number, commands(number));
        }
        assert_eq!(waiting.0.len(), BATCHES_MAX);
        let learned_early = learned(&mut waiting, 9_999);
        assert_eq!(learned_early.last(), Some(&(BATCHES_MAX as u64 - 1)));
        assert_eq!(waiting.pop_durable(10_000), Some(commands(10_000)));
    }

    #[test]
    fn commands_that_follow_put_no_acknowledgement_off_for_ever() {
        const BEHIND: u64 = 1_000;
        let mut waiting = Acknowledgements::default();
        let mut acknowledged = 0;
        for number in 1..=20_000_u64 {
            waiting.push(number, commands(number));
            let durable = number.saturating_sub(BEHIND);
            let counts = learned(&mut waiting, durable);
            acknowledged = counts.last().copied().unwrap_or(acknowledged);
            assert!(acknowledged <= durable, "batch {number}");
            assert!(durable - acknowledged <= 2 * BEHIND, "batch {number}");
        }
    }
}
