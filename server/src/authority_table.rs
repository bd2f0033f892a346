//! Authority of members over bodies of a scene, and the bodies' targets.
//!
//! Knows members only by peer; `scene_runner` decides whether a member may take authority. Invariants: at most one
//! member has authority over a body, and a member moves no other bodies.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::packet::{Datagram, PacketKind, StreamId};
use rhumb_protocol::scene::{Command, Locomotion};
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::stream::SubscriberStatistics;
use rhumb_protocol::{Instant, Peer};
use rhumb_reckoning::{BodyId, Tick, Tolerance};

use crate::scene::Scene;

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
struct AuthorityGroup {
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

/// Authority of all members over bodies of one scene.
#[derive(Debug, Default)]
pub(crate) struct AuthorityTable {
    groups: BTreeMap<Peer, AuthorityGroup>,
    authorities: BTreeMap<BodyId, Peer>,
    /// Bodies of silent members whose authority has ended since the last step.
    released: BTreeSet<BodyId>,
}

impl AuthorityTable {
    /// The member with authority over a body.
    pub(crate) fn authority_of(&self, id: BodyId) -> Option<Peer> {
        self.authorities.get(&id).copied()
    }

    /// True if an upstream has this name.
    pub(crate) fn has(&self, stream: StreamId) -> bool {
        self.groups
            .values()
            .any(|group| group.receiver.stream() == stream)
    }

    /// Gives a member authority over these bodies, in place of its former ones.
    pub(crate) fn begin(&mut self, peer: Peer, receiver: UpstreamReceiver) {
        self.end(peer);
        self.authorities
            .extend(receiver.bodies().map(|id| (id, peer)));
        if receiver.bodies().next().is_some() {
            let group = AuthorityGroup {
                receiver,
                put: BTreeMap::new(),
                steps: 0,
                late_steps: 0,
                late: 0,
                refused: 0,
                silence: None,
            };
            self.groups.insert(peer, group);
        }
    }

    /// Ends a member's authority; its bodies stand still.
    pub(crate) fn end(&mut self, peer: Peer) {
        let Some(group) = self.groups.remove(&peer) else {
            return;
        };
        self.authorities.retain(|_, authority| *authority != peer);
        if group.silence.is_some() {
            self.released.extend(group.receiver.bodies());
        }
        // A member that begins and ends without a step between is not logged.
        if group.steps == 0 {
            return;
        }
        tracing::info!(
            peer = peer.0,
            steps = group.steps,
            late_steps = group.late_steps,
            refused = group.refused,
            received = ?group.receiver.statistics(),
            "authority ended"
        );
    }

    /// Removes a body that has left the scene.
    pub(crate) fn remove(&mut self, id: BodyId) {
        let Some(peer) = self.authorities.remove(&id) else {
            return;
        };
        if let Some(group) = self.groups.get_mut(&peer) {
            group.receiver.remove(id);
            if group.receiver.bodies().next().is_none() {
                self.end(peer);
            }
        }
    }

    /// Handles an upstream packet of a member; drops one of another stream. Returns `false` when the upstream has lost
    /// sync.
    #[must_use]
    pub(crate) fn handle_datagram(
        &mut self,
        peer: Peer,
        datagram: &Datagram<'_>,
        present: Tick,
    ) -> bool {
        let Some(group) = self.groups.get_mut(&peer) else {
            return true;
        };
        let head = datagram.head();
        if head.stream == group.receiver.stream() && is_from_publisher(head.kind) {
            let since = group.receiver.handle_datagram(datagram);
            group.note_late(since, present);
        }
        !group.receiver.has_lost_sync()
    }

    /// Sets the targets of all bodies for the next step. Returns the scene events of members that became silent or are
    /// active again.
    pub(crate) fn set_targets(&mut self, scene: &mut Scene) -> Vec<SceneEvent> {
        let tick = scene.tick().next();
        let mut scene_events = Vec::new();
        let bodies: Vec<_> = std::mem::take(&mut self.released)
            .into_iter()
            .filter(|id| scene.body(*id).is_some())
            .collect();
        if !bodies.is_empty() {
            scene_events.push(SceneEvent::PublisherActive { tick, bodies });
        }
        for (peer, group) in &mut self.groups {
            group.put(scene, tick);
            group.steps += 1;
            let incomplete = !group.receiver.is_complete_at(tick);
            group.late = group.late << 1 | u128::from(incomplete);
            group.late_steps += u64::from(incomplete);
            scene_events.extend(group.note_silence(*peer, tick));
        }
        scene_events
    }

    /// The scene events of all silent members, for a snapshot.
    pub(crate) fn silences(&self) -> impl Iterator<Item = SceneEvent> {
        self.groups.values().filter_map(|group| {
            Some(SceneEvent::PublisherSilent {
                since: group.silence?.since,
                bodies: group.receiver.bodies().collect(),
            })
        })
    }

    /// Sends NACKs for lost packets, and probes to silent members.
    pub(crate) fn poll_requests(
        &mut self,
        now: Instant,
        tick: Tick,
        mut send: impl FnMut(Peer, Bytes),
    ) {
        let mut reports = Vec::new();
        for (peer, group) in &mut self.groups {
            group.receiver.poll_reports(now, tick, &mut reports);
            for report in reports.drain(..) {
                send(*peer, report);
            }
        }
    }

    /// Statistics of all upstreams.
    pub(crate) fn statistics(&self, present: Tick) -> impl Iterator<Item = UpstreamStatistics> {
        self.groups
            .iter()
            .map(move |(peer, group)| UpstreamStatistics {
                member: *peer,
                bodies: group.receiver.bodies().count(),
                tolerance: group.receiver.tolerance(),
                watermark_tick: group.receiver.watermark_tick(),
                received: group.receiver.statistics(),
                steps: group.steps,
                late_steps: group.late_steps,
                tick: present,
                late: group.late,
                refused: group.refused,
            })
    }
}

impl AuthorityGroup {
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
