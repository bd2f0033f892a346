//! Sizes of packets without their range coder.
//!
//! The range coder is part of the wire format, so nothing can be sent without it; the size in plain codes can only be
//! counted. FEC and budgets act on the coded packets.

use rhumb_protocol::packet::{Head, PacketKind, SymbolCounts, UpdatePacket};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;

/// Bits that distinguish all forms.
const FORM_BITS: u64 = SymbolCounts::CODES[1].next_power_of_two().ilog2() as u64;

/// Forms and numbers of a datagram, if it holds updates.
pub(crate) fn tally(datagram: &[u8]) -> Option<SymbolCounts> {
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader).ok()?;
    let packet = match head.kind {
        PacketKind::Updates => UpdatePacket::decode(false, reader),
        PacketKind::UpdatesEnd => UpdatePacket::decode(true, reader),
        PacketKind::UpdatesOverBudget => UpdatePacket::decode_over_budget(reader),
        _ => return None,
    };
    let packet = packet.ok()?;
    let mut updates = Vec::new();
    packet.updates(&mut updates).ok()?;
    Some(SymbolCounts::of(&updates))
}

/// Size of a datagram, bytes, if each form took a fixed-length code and each number an Exp-Golomb code. Signs, ids and
/// keyframes are plain bits in either case.
pub(super) fn plain_len(datagram: &[u8]) -> u64 {
    let length = datagram.len() as u64;
    let Some(tally) = tally(datagram) else {
        return length;
    };
    let numbers = tally.numbers.iter().map(|(_, number)| exp_golomb(*number));
    let plain = tally.codes.len() as u64 * FORM_BITS + numbers.sum::<u64>();
    (length * 8 + plain)
        .saturating_sub(tally.coded() / 256)
        .div_ceil(8)
}

/// Bits of a number's Exp-Golomb code of order 0.
fn exp_golomb(number: u32) -> u64 {
    u64::from(2 * (u64::from(number) + 1).ilog2() + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_golomb_codes_have_their_defined_length() {
        let lengths = [0, 1, 2, 3, 6, 7, u32::MAX].map(exp_golomb);
        assert_eq!(lengths, [1, 3, 3, 5, 5, 7, 65]);
    }

    #[test]
    fn other_datagrams_keep_their_length() {
        assert_eq!(plain_len(b"no packet at all"), 16);
        assert_eq!(plain_len(&[]), 0);
    }
}
