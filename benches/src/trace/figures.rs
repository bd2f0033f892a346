//! Messages of a trace about frames, breaches and packets.

use bytes::Bytes;
use rhumb_reckoning::Tick;
use rhumb_trace::{BreachMessage, Packet, TickStats};

use crate::quantile::rank;
use crate::record::{Breach, CapturedPacket, Cause, Frame, PacketDirection};

/// The figures of a frame.
pub(super) fn stats_message(number: u32, frame: &Frame, payload_bytes_down: u64) -> TickStats {
    let exact = frame.exact as usize;
    let count = exact + frame.errors_m.len();
    let error = |percent| {
        let place = rank(percent, count)?.checked_sub(exact)?;
        frame.errors_m.get(place).copied().map(f64::from)
    };
    TickStats {
        tick: frame.tick.value(),
        frame: number,
        frame_ns: frame.frame_ns,
        wire_bytes_down: frame.wire_bytes_down,
        wire_bytes_up: frame.wire_bytes_up,
        wire_datagrams_down: frame.wire_datagrams_down,
        wire_datagrams_up: frame.wire_datagrams_up,
        payload_bytes_down,
        updates: frame.updates,
        body_ticks: count as u64,
        error_m_p50: error(50).unwrap_or(0.0),
        error_m_p99: error(99).unwrap_or(0.0),
        error_m_max: error(100).unwrap_or(0.0),
    }
}

pub(super) fn breach_message(breach: &Breach) -> BreachMessage {
    BreachMessage {
        tick: breach.tick.value(),
        index: breach.id.index(),
        generation: u32::from(breach.id.generation()),
        error_m: breach.error_m,
        tolerance_m: breach.tolerance_m,
        cause: match breach.cause {
            Cause::Loss => 1,
            Cause::Late => 2,
            Cause::Fault => 3,
            Cause::Budget => 4,
        },
    }
}

/// A packet with its bytes, or with their number alone.
pub(super) fn packet_message(tick: Tick, captured: &CapturedPacket, keeps_bytes: bool) -> Packet {
    Packet {
        tick: tick.value(),
        frame: captured.frame,
        direction: match captured.direction {
            PacketDirection::StateDown => 1,
            PacketDirection::StateUp => 2,
            PacketDirection::ControlDown => 3,
            PacketDirection::ControlUp => 4,
        },
        data: if keeps_bytes {
            captured.bytes.clone()
        } else {
            Bytes::new()
        },
        length: captured.bytes.len() as u32,
    }
}
