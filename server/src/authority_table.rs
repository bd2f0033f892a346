//! Who drives which bodies of a scene, and where these are put before a step.
//!
//! Knows no members but by name; whether one may drive a body is decided in `room`. Invariants: a body has one driver at
//! most, and a driver moves no body but its own.

use std::collections::BTreeMap;

use bytes::Bytes;
use glam::{Quat, Vec3};
use rhumb_protocol::packet::{Datagram, PacketKind, StreamId};
use rhumb_protocol::scene::Command;
use rhumb_protocol::session::UpstreamReceiver;
use rhumb_protocol::stream::SubscriberStatistics;
use rhumb_protocol::{Instant, Peer};
use rhumb_reckoning::{BodyId, Tick, Tolerance};

use crate::scene::Scene;

/// How the bodies are doing that one member drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpstreamStatistics {
    /// Who drives them.
    pub driver: Peer,
    /// How many they are.
    pub bodies: usize,
    /// How far they may be from where their driver says they are.
    pub tolerance: Tolerance,
    /// The newest tick up to which their driver said everything.
    pub watermark_tick: Tick,
    /// What was heard of it.
    pub heard: SubscriberStatistics,
    /// Steps for which they were put where their driver has them.
    pub steps: u64,
    /// Of these, steps to a tick of which something was heard too late: more of a lead helps.
    pub late_steps: u64,
    /// The newest step.
    pub tick: Tick,
    /// Whether it and those before it were late, from the lowest bit on.
    late: u128,
    /// How often a body was left where it was, since its driver had it where no body may be.
    pub refused: u64,
}

impl UpstreamStatistics {
    /// Whether all that was said of a tick was heard before the step to it, so that each body is there within the tolerance
    /// of where its driver had it. Never of ticks that are not watermark_tick for, nor of those long ago.
    #[must_use]
    pub fn was_complete_at(&self, tick: Tick) -> bool {
        let age = self
            .tick
            .since(tick)
            .map_or(u64::MAX, |age| u64::from(age.count()));
        tick <= self.watermark_tick && age < self.steps.min(LATE_KEPT) && self.late >> age & 1 == 0
    }
}

/// What one member drives.
#[derive(Debug)]
struct AuthorityGroup {
    driven: UpstreamReceiver,
    /// Where each body was put last, as the engine has numbers.
    put: BTreeMap<BodyId, (Vec3, Quat)>,
    steps: u64,
    late_steps: u64,
    /// Which of the last steps were late, the newest in the lowest bit.
    late: u128,
    refused: u64,
    /// Whether they stand still because their driver is silent.
    stale: bool,
}

/// Steps of which it is remembered whether they were late.
const LATE_KEPT: u64 = 128;

/// All that is driven in one scene.
#[derive(Debug, Default)]
pub(crate) struct AuthorityTable {
    groups: BTreeMap<Peer, AuthorityGroup>,
    holders: BTreeMap<BodyId, Peer>,
}

impl AuthorityTable {
    /// Who drives a body.
    pub(crate) fn driver(&self, id: BodyId) -> Option<Peer> {
        self.holders.get(&id).copied()
    }

    /// Whether somebody says on a stream of this name how bodies move.
    pub(crate) fn has(&self, stream: StreamId) -> bool {
        self.groups
            .values()
            .any(|group| group.driven.stream() == stream)
    }

    /// A member drives these bodies from now on, in place of what it drove before.
    pub(crate) fn begin(&mut self, peer: Peer, driven: UpstreamReceiver) {
        self.end(peer);
        self.holders.extend(driven.bodies().map(|id| (id, peer)));
        if driven.bodies().next().is_some() {
            let group = AuthorityGroup {
                driven,
                put: BTreeMap::new(),
                steps: 0,
                late_steps: 0,
                late: 0,
                refused: 0,
                stale: false,
            };
            self.groups.insert(peer, group);
        }
    }

    /// A member drives nothing any more; what it drove stands still.
    pub(crate) fn end(&mut self, peer: Peer) {
        let Some(group) = self.groups.remove(&peer) else {
            return;
        };
        self.holders.retain(|_, driver| *driver != peer);
        // Who begins and ends without a step between them fills no log.
        if group.steps == 0 {
            return;
        }
        tracing::info!(
            peer = peer.0,
            steps = group.steps,
            late_steps = group.late_steps,
            refused = group.refused,
            heard = ?group.driven.statistics(),
            "drives no longer"
        );
    }

    /// A body has left the scene.
    pub(crate) fn remove(&mut self, id: BodyId) {
        let Some(peer) = self.holders.remove(&id) else {
            return;
        };
        if let Some(group) = self.groups.get_mut(&peer) {
            group.driven.remove(id);
            if group.driven.bodies().next().is_none() {
                self.end(peer);
            }
        }
    }

    /// Takes in what a member says of its bodies; one of another stream is dropped. `false` when the stream can be followed
    /// no more.
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
        if head.stream == group.driven.stream() && is_from_publisher(head.kind) {
            let since = group.driven.handle_datagram(datagram);
            group.note_late(since, present);
        }
        !group.driven.has_lost_sync()
    }

    /// Has the bodies be where their holders have them after the next step.
    pub(crate) fn set_targets(&mut self, scene: &mut Scene) {
        let tick = scene.tick().next();
        for (peer, group) in &mut self.groups {
            group.put(scene, tick);
            group.steps += 1;
            let incomplete = !group.driven.is_complete_at(tick);
            group.late = group.late << 1 | u128::from(incomplete);
            group.late_steps += u64::from(incomplete);
            let stale = group.driven.is_stale(tick);
            if stale && !group.stale {
                let watermark_tick = group.driven.watermark_tick().value();
                tracing::warn!(
                    peer = peer.0,
                    watermark_tick,
                    "a silent driver's bodies stand still"
                );
            }
            group.stale = stale;
        }
    }

    /// Asks holders for what was lost, and those that are silent whether they are there.
    pub(crate) fn poll_requests(
        &mut self,
        now: Instant,
        tick: Tick,
        mut say: impl FnMut(Peer, Bytes),
    ) {
        let mut questions = Vec::new();
        for (peer, group) in &mut self.groups {
            group.driven.ask(now, tick, &mut questions);
            for question in questions.drain(..) {
                say(*peer, question);
            }
        }
    }

    /// How all are doing.
    pub(crate) fn statistics(&self, present: Tick) -> impl Iterator<Item = UpstreamStatistics> {
        self.groups
            .iter()
            .map(move |(peer, group)| UpstreamStatistics {
                driver: *peer,
                bodies: group.driven.bodies().count(),
                tolerance: group.driven.tolerance(),
                watermark_tick: group.driven.watermark_tick(),
                heard: group.driven.statistics(),
                steps: group.steps,
                late_steps: group.late_steps,
                tick: present,
                late: group.late,
                refused: group.refused,
            })
    }
}

impl AuthorityGroup {
    /// Has each body be where it belongs at a tick, after the step to it.
    ///
    /// One that is to be where it was put before is left alone, so that it and what lies on it may sleep. One that is to be
    /// where no body may be stays where it is.
    fn put(&mut self, scene: &mut Scene, tick: Tick) {
        for (id, motion) in self.driven.motions(tick) {
            let pose = motion.pose();
            let (position, rotation) = (pose.position.as_vec3(), pose.rotation.as_quat());
            if self.put.get(&id) == Some(&(position, rotation)) {
                continue;
            }
            let there = scene.apply(&Command::SetPose {
                id,
                position,
                rotation,
            });
            match there {
                Ok(()) => drop(self.put.insert(id, (position, rotation))),
                Err(_) => self.refused += 1,
            }
        }
    }

    /// More was heard of the ticks from `since` on than was known when the steps to them were taken.
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

/// Whether the source of a reckoned stream says such a thing.
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
