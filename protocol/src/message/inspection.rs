//! Inspection of a scene, for benchmarks and operators.

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;

/// Wall-clock time of each stage of the ticks so far, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Engine step, sum over all ticks.
    pub step_total: u64,
    /// The median step of the last ticks.
    pub step_median: u64,
    /// The 99th percentile of the last steps.
    pub step_p99: u64,
    /// Observing moved bodies, sum over all ticks.
    pub observe_total: u64,
    /// Choosing, encoding and handing over updates, sum over all ticks.
    pub publish_total: u64,
}

/// The state of a scene at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inspection {
    /// The tick.
    pub tick: Tick,
    /// Digest of all observations of the scene.
    pub truth: u64,
    /// Number of bodies.
    pub bodies: u32,
    /// Number of awake bodies.
    pub awake: u32,
    /// Updates sent so far in the stream of the requesting member.
    pub updates: u64,
    /// Packets of that stream.
    pub packets: u64,
    /// Their bytes.
    pub packet_bytes: u64,
    /// Snapshots that members of that stream requested because a checksum differed.
    pub mismatches: u64,
    /// Bodies over budget in that stream, counted at every tick.
    pub over_budget: u64,
    /// Time of the tick's stages.
    pub times: StageTimes,
}

impl Wire for Inspection {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.tick.value());
        to.raw(&self.truth.to_le_bytes());
        to.varint(u64::from(self.bodies));
        to.varint(u64::from(self.awake));
        let times = &self.times;
        for value in [
            self.updates,
            self.packets,
            self.packet_bytes,
            self.mismatches,
            self.over_budget,
            times.step_total,
            times.step_median,
            times.step_p99,
            times.observe_total,
            times.publish_total,
        ] {
            to.varint(value);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let tick = Tick::new(from.count()?);
        let mut truth = 0;
        for place in 0..8 {
            truth |= u64::from(from.u8()?) << (8 * place);
        }
        Ok(Self {
            tick,
            truth,
            bodies: from.varint32()?,
            awake: from.varint32()?,
            updates: from.varint()?,
            packets: from.varint()?,
            packet_bytes: from.varint()?,
            mismatches: from.varint()?,
            over_budget: from.varint()?,
            times: StageTimes {
                step_total: from.varint()?,
                step_median: from.varint()?,
                step_p99: from.varint()?,
                observe_total: from.varint()?,
                publish_total: from.varint()?,
            },
        })
    }
}
