//! The body events of one tick.

use alloc::vec::Vec;

use rhumb_reckoning::Tick;

use crate::limits::EVENTS_PER_TICK_MAX;
use crate::scene::BodyEvent;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The events of bodies in the step to a tick.
#[derive(Clone, Debug, PartialEq)]
pub struct TickEvents {
    /// The tick.
    pub tick: Tick,
    /// Number of events that were not sent since the last message of this kind: a tick had too many of them, or the
    /// client read too slowly.
    pub missed: u64,
    /// The events, in the order of their kinds, and each kind in the order of ids.
    pub events: Vec<BodyEvent>,
}

impl Wire for TickEvents {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.tick.value());
        to.varint(self.missed);
        to.varint(self.events.len() as u64);
        for event in &self.events {
            event.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let tick = Tick::new(from.count()?);
        let missed = from.count()?;
        let count = from.varint_to(EVENTS_PER_TICK_MAX as u64)?;
        let mut events = Vec::new();
        for _ in 0..count {
            events.push(BodyEvent::decode(from)?);
        }
        Ok(Self {
            tick,
            missed,
            events,
        })
    }
}
