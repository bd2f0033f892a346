//! The bodies under one member's authority, and their targets.
//!
//! The member publishes them, and each step puts them where its upstream has them. Which bodies a member may have is
//! decided in `rights`.

use std::collections::BTreeMap;

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
