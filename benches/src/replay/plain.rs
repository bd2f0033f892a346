//! What packets would take without their range coder.
//!
//! The coder is the wire's own, so that nothing can be sent without it; it can only be counted what plain codes would
//! take. FecEncoder, and what a budget allows, are those of the coded packets.

use rhumb_protocol::packet::{Head, PacketKind, SymbolCounts, UpdatePacket};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;

/// Bits that tell a form from all others.
const FORM_BITS: u64 = SymbolCounts::CODES[1].next_power_of_two().ilog2() as u64;

/// The forms and numbers of a datagram, if it is one of updates.
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

/// Bytes that a datagram would take if each form were said in as many bits as tell it from all others, and each number
/// in an Exp-Golomb code; signs, names and whole tracks are said in plain bits anyway.
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
    fn exp_golomb_codes_are_as_long_as_their_definition_says() {
        let lengths = [0, 1, 2, 3, 6, 7, u32::MAX].map(exp_golomb);
        assert_eq!(lengths, [1, 3, 3, 5, 5, 7, 65]);
    }

    #[test]
    fn what_is_no_packet_of_updates_is_as_long_as_it_is() {
        assert_eq!(plain_len(b"no packet at all"), 16);
        assert_eq!(plain_len(&[]), 0);
    }
}
