//! What a server tells of a scene when asked: for benchmarks and operators.

use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};
use rhumb_reckoning::Tick;

/// Host time that one stage of the tick took so far, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// In the engine's step, all ticks together.
    pub step_total: u64,
    /// The median step of the last ticks.
    pub step_median: u64,
    /// The step that one in a hundred of the last ticks exceeded.
    pub step_p99: u64,
    /// Observing what moved, all ticks together.
    pub observe_total: u64,
    /// StreamSelection, encoding and handing over what to say, all ticks together.
    pub publish_total: u64,
}

/// A scene at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Inspection {
    /// When.
    pub tick: Tick,
    /// Checksums of everything that was ever observed in it.
    pub truth: u64,
    /// Bodies in it.
    pub bodies: u32,
    /// Of these awake.
    pub awake: u32,
    /// Updates said so far in the asking member's stream.
    pub updates: u64,
    /// Packets of that stream.
    pub packets: u64,
    /// Their bytes.
    pub packet_bytes: u64,
    /// How often a member of that stream requested a new snapshot because a checksum differed.
    pub mismatches: u64,
    /// Bodies of which that stream over_budget that they were off, for want of budget, each counted at every tick.
    pub over_budget: u64,
    /// Where the tick's time went.
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
