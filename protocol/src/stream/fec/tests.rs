//! Repair symbols: packets that they cover, and packets that they recover.

use alloc::vec;

use proptest::collection::vec;
use proptest::prelude::*;

use super::*;
use crate::limits::FEC_ROWS;
use crate::packet::{Head, PacketKind};
use crate::wire::Wire;
use crate::wire::bytes::Reader;

const STREAM: StreamId = StreamId(3);

/// A state packet of this many bytes.
fn packet(number: u64, bytes: usize) -> Vec<u8> {
    let mut packet = vec![1, 3];
    packet.extend_from_slice(&(number as u16).to_le_bytes());
    packet.resize(bytes, 7);
    packet
}

/// A request of a receiver with a report up to `received_below`, for `wanted` symbols besides all that were sent
/// since.
const fn request(received_below: u64, wanted: usize) -> SymbolRequest {
    SymbolRequest {
        received_below,
        wanted,
        sent_from: 0,
    }
}

fn covered(datagram: &[u8]) -> Vec<u64> {
    let mut reader = Reader::new(datagram);
    assert_eq!(
        Head::decode(&mut reader).map(|head| head.kind),
        Ok(PacketKind::RepairSymbol)
    );
    let repair_symbol = RepairSymbol::decode(reader).expect("a repair symbol was sent");
    let mut numbers: Vec<u64> = repair_symbol
        .numbers(repair_symbol.last.expand(0))
        .collect();
    numbers.reverse();
    numbers
}

/// Ten packets, one in each tick, and the packets that the sent repair symbols cover.
fn ten(redundancy: Redundancy) -> (FecEncoder, Vec<Vec<u64>>) {
    let mut repair_symbols = FecEncoder::default();
    let mut sent = Vec::new();
    for number in 0..10 {
        repair_symbols.record(number, &packet(number, 40));
        repair_symbols.end_tick(STREAM, redundancy, &mut sent);
    }
    (
        repair_symbols,
        sent.iter().map(|datagram| covered(datagram)).collect(),
    )
}

#[test]
fn each_packet_is_covered_soon_and_again_later() {
    let (_, sent) = ten(Redundancy::Plain);
    let ends: Vec<_> = sent
        .iter()
        .map(|numbers| numbers[numbers.len() - 1])
        .collect();
    assert_eq!(ends, [1, 3, 5, 7, 9]);
    assert_eq!(sent[4], (0..10).collect::<Vec<_>>());
    assert_eq!(ten(Redundancy::Off).1, [[0; 0]; 0]);
}

#[test]
fn a_packet_is_covered_twice_unless_it_is_much_longer_than_later_ones() {
    for (bytes, times) in [(50, 2), (90, 1)] {
        let mut repair_symbols = FecEncoder::default();
        let mut sent = Vec::new();
        for number in 0..8 {
            let bytes = if number == 3 { bytes } else { 40 };
            repair_symbols.record(number, &packet(number, bytes));
            repair_symbols.end_tick(STREAM, Redundancy::Plain, &mut sent);
        }
        let sent: Vec<_> = sent.iter().map(|datagram| covered(datagram)).collect();
        let of_the_long_one = sent.iter().filter(|numbers| numbers.contains(&3));
        assert_eq!(of_the_long_one.count(), times);
        assert_eq!(sent[3], [0, 1, 2, 4, 5, 6, 7]);
    }
}

#[test]
fn a_tick_in_halves_has_a_repair_symbol_of_its_own() {
    let mut repair_symbols = FecEncoder::default();
    let mut sent = Vec::new();
    for tick in 0..6 {
        for half in 0..2 {
            repair_symbols.record(2 * tick + half, &packet(2 * tick + half, 100));
        }
        repair_symbols.halve();
        repair_symbols.end_tick(STREAM, Redundancy::Plain, &mut sent);
    }
    let sent: Vec<_> = sent.iter().map(|datagram| covered(datagram)).collect();
    assert_eq!(sent.len(), 6);
    assert!(
        sent.iter()
            .zip(1..)
            .all(|(numbers, ticks)| numbers.ends_with(&[2 * ticks - 2, 2 * ticks - 1]))
    );
}

#[test]
fn answers_omit_repair_symbols_in_flight() {
    let (mut repair_symbols, _) = ten(Redundancy::Plain);
    let mut out = Vec::new();
    // The repair symbols of packets 7 and 9 are in flight to a receiver whose report covers the packets below 6.
    let old = repair_symbols.answer(STREAM, [3, 4, 5].into_iter(), request(6, 3), &mut out);
    assert!(old.is_empty());
    let sent: Vec<_> = out.iter().map(|datagram| covered(datagram)).collect();
    // One symbol would do if none were lost. With two symbols, too few arrive in one of seventy cases.
    assert_eq!(sent, [[3, 4, 5], [3, 4, 5], [3, 4, 5]]);
}

#[test]
fn in_flight_symbols_are_per_receiver() {
    let (repair_symbols, _) = ten(Redundancy::Plain);
    // Repair symbols were sent with packets 7 and 9; the receiver was sent none, one, or both of them.
    for (sent_from, answers) in [(u64::MAX, 2), (10, 2), (8, 1), (6, 0), (0, 0)] {
        let mut out = Vec::new();
        let request = SymbolRequest {
            sent_from,
            ..request(6, 1)
        };
        let old = repair_symbols
            .clone()
            .answer(STREAM, [5].into_iter(), request, &mut out);
        assert!(old.is_empty());
        assert_eq!(out.len(), answers, "{sent_from}");
    }
}

#[test]
fn one_repair_symbol_serves_all_requests_of_a_tick() {
    let (mut repair_symbols, _) = ten(Redundancy::Off);
    let mut out = Vec::new();
    for lost in [2, 3, 5] {
        assert!(
            repair_symbols
                .answer(STREAM, [lost].into_iter(), request(10, 1), &mut out)
                .is_empty()
        );
    }
    // The same two symbols each time, because one of them may be lost.
    assert_eq!(out.len(), 6);
    assert!(out.chunks(2).all(|sent| sent == &out[..2]));
    assert_ne!(out[0], out[1]);
    assert_eq!(covered(&out[0]), (2..10).collect::<Vec<_>>());
}

#[test]
fn forgotten_packets_are_refreshed() {
    let mut repair_symbols = FecEncoder::default();
    for number in 0..100 {
        repair_symbols.record(number, &packet(number, 40));
    }
    let mut out = Vec::new();
    assert_eq!(
        repair_symbols.answer(STREAM, [3, 99].into_iter(), request(100, 1), &mut out),
        [3]
    );
    assert_eq!(out.len(), 2);
    assert_eq!(
        repair_symbols.answer(STREAM, [3, 99].into_iter(), request(100, 0), &mut out),
        [3, 99]
    );
    assert_eq!(out.len(), 2);
    assert_eq!(repair_symbols.source_symbols.len(), FEC_SPAN as usize);
}

#[test]
fn repeated_request_gets_another_repair_symbol() {
    let (mut repair_symbols, _) = ten(Redundancy::Off);
    let mut sent = Vec::new();
    for _ in 0..50 {
        // Two receivers in turn, within one tick.
        for lost in [3, 4] {
            repair_symbols.answer(STREAM, [lost].into_iter(), request(10, 1), &mut sent);
        }
    }
    assert_eq!(sent.len(), 200);
    for datagram in &sent {
        let given = sent.iter().filter(|other| *other == datagram).count();
        assert!(given <= SYMBOL_REUSE_MAX as usize, "{given}");
    }
    assert!(repair_symbols.requested.len() <= REPAIR_SYMBOLS_KEPT);
}

/// A repair symbol of this row over source symbols with rising numbers.
fn repair_symbol(row: u8, source_symbols: &[(u64, Vec<u8>)]) -> (u64, RepairSymbol) {
    let (last, _) = source_symbols[source_symbols.len() - 1];
    let mut repair_symbol = RepairSymbol::begin(row, last);
    for (number, source_symbol) in source_symbols {
        repair_symbol.add(*number, last - number, source_symbol);
    }
    (last, repair_symbol)
}

fn padded(source_symbol: &[u8], bytes: usize) -> Vec<u8> {
    let mut source_symbol = source_symbol.to_vec();
    source_symbol.resize(bytes.max(source_symbol.len()), 0);
    source_symbol
}

#[test]
fn too_many_losses_request_no_repair_symbols() {
    let lacking = |received: u64| {
        let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
        (0..received).for_each(|number| fec_decoder.add_known(number, &[1]));
        // All packets but the last were refreshed.
        fec_decoder.wanted(core::iter::once(31), 32)
    };
    assert_eq!(lacking(32 - REPAIR_SYMBOLS_KEPT as u64), 1);
    assert_eq!(lacking(31 - REPAIR_SYMBOLS_KEPT as u64), 0);
}

#[test]
fn repair_symbols_after_a_loss_reduce_the_request() {
    let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
    let source_symbols: Vec<_> = (0..9).map(|number| (number, vec![number as u8])).collect();
    let received = [0, 1, 3, 4, 6, 7, 8];
    received
        .iter()
        .for_each(|number| fec_decoder.add_known(*number, &[*number as u8]));
    // Packet 5 was refreshed before packet 2 was known to be lost.
    assert_eq!(fec_decoder.wanted([2].into_iter(), 9), 0);
    assert_eq!(fec_decoder.wanted([5].into_iter(), 9), 1);
    assert_eq!(fec_decoder.wanted([2, 5].into_iter(), 9), 2);
    let (last, of_both) = repair_symbol(0, &source_symbols[2..]);
    fec_decoder.add(last, of_both);
    assert_eq!(fec_decoder.wanted([2].into_iter(), 9), 1);
}

proptest! {
    #[test]
    fn each_repair_symbol_recovers_one_lost_packet(
        first in 0_u64..1_000, source_symbols in vec(vec(any::<u8>(), 1..60), 1..FEC_SPAN as usize),
        lost in vec(any::<prop::sample::Index>(), 1..REPAIR_SYMBOLS_KEPT), row in 0..FEC_ROWS - 16, late in any::<bool>(),
    ) {
        let source_symbols: Vec<_> = source_symbols.into_iter().enumerate().map(|(n, source_symbol)| (first + n as u64, source_symbol)).collect();
        let mut lost: Vec<usize> = lost.iter().map(|index| index.index(source_symbols.len())).collect();
        lost.sort_unstable();
        lost.dedup();
        let mut fec_decoder = FecDecoder::new(first, LargestPacket::DEFAULT);
        let received = |fec_decoder: &mut FecDecoder| {
            for (place, (number, source_symbol)) in source_symbols.iter().enumerate() {
                if !lost.contains(&place) {
                    fec_decoder.add_known(*number, source_symbol);
                }
            }
        };
        if !late {
            received(&mut fec_decoder);
        }
        for place in 0..lost.len() {
            prop_assert!(fec_decoder.rebuild().is_empty());
            let (last, repair_symbol) = repair_symbol(row + place as u8, &source_symbols);
            fec_decoder.add(last, repair_symbol);
        }
        if late {
            received(&mut fec_decoder);
        }
        let rebuilt = fec_decoder.rebuild();
        prop_assert_eq!(rebuilt.len(), lost.len());
        for (number, source_symbol) in &rebuilt {
            fec_decoder.add_known(*number, source_symbol);
        }
        for ((number, source_symbol), place) in rebuilt.iter().zip(&lost) {
            let (expected, original) = &source_symbols[*place];
            prop_assert_eq!(number, expected);
            let bytes = source_symbol.len().max(original.len());
            prop_assert_eq!(padded(source_symbol, bytes), padded(original, bytes));
        }
        prop_assert_eq!(fec_decoder.wanted(lost.iter().map(|place| first + *place as u64), first + source_symbols.len() as u64), 0);
        prop_assert!(fec_decoder.sums.is_empty());
    }

    #[test]
    fn decoder_memory_is_bounded(
        received in vec((any::<u16>(), any::<u32>(), 0..FEC_ROWS, vec(any::<u8>(), 0..20), any::<bool>()), 0..200),
    ) {
        let mut fec_decoder = FecDecoder::default();
        for (number, covered, row, bytes, is_repair_symbol) in received {
            let number = u64::from(number % 300);
            if is_repair_symbol {
                let repair_symbol = RepairSymbol { last: crate::packet::Low16::of(number), covered: covered >> 1, row, sums: bytes };
                fec_decoder.add(number, repair_symbol);
            } else {
                fec_decoder.add_known(number, &bytes);
            }
            let rebuilt = fec_decoder.rebuild();
            prop_assert!(rebuilt.len() <= REPAIR_SYMBOLS_KEPT);
            for (number, source_symbol) in rebuilt {
                fec_decoder.add_known(number, &source_symbol);
            }
            prop_assert!(fec_decoder.sums.len() <= REPAIR_SYMBOLS_KEPT);
            prop_assert!(fec_decoder.wanted(0..300, 300) <= FEC_SPAN as u8);
        }
    }
}

#[test]
fn repair_symbols_over_different_packets_combine() {
    let source_symbols: Vec<_> = (0..8_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
    let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
    for place in [0, 3, 4, 7] {
        fec_decoder.add_known(source_symbols[place].0, &source_symbols[place].1);
    }
    for (row, covered) in [(0, 0..3), (1, 1..6), (2, 2..7), (3, 5..8)] {
        let (last, repair_symbol) = repair_symbol(row, &source_symbols[covered]);
        fec_decoder.add(last, repair_symbol);
    }
    let rebuilt = fec_decoder.rebuild();
    let numbers: Vec<u64> = rebuilt.iter().map(|(number, _)| *number).collect();
    assert_eq!(numbers, [1, 2, 5, 6]);
    assert!(
        rebuilt
            .iter()
            .all(|(number, source_symbol)| *source_symbol == source_symbols[*number as usize].1)
    );
}

#[test]
fn a_repair_symbol_with_another_unknown_packet_does_not_reduce_the_request() {
    let source_symbols: Vec<_> = (0..8_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
    let mut fec_decoder = FecDecoder::new(0, LargestPacket::DEFAULT);
    for place in [0, 1, 2, 4, 5] {
        fec_decoder.add_known(source_symbols[place].0, &source_symbols[place].1);
    }
    // Packet 6 is not known to be lost, because no later packet was received.
    let (last, sums) = repair_symbol(0, &source_symbols[..7]);
    fec_decoder.add(last, sums);
    assert_eq!(fec_decoder.wanted([3].into_iter(), 6), 1);
    assert_eq!(fec_decoder.wanted([3, 6].into_iter(), 7), 1);
    let (last, sums) = repair_symbol(1, &source_symbols[..6]);
    fec_decoder.add(last, sums);
    let rebuilt = fec_decoder.rebuild();
    assert_eq!(
        rebuilt
            .iter()
            .map(|(number, _)| *number)
            .collect::<Vec<_>>(),
        [3, 6]
    );
}

#[test]
fn packets_before_the_start_are_ignored() {
    let source_symbols: Vec<_> = (0..4_u8).map(|n| (u64::from(n), vec![n + 1; 9])).collect();
    let mut fec_decoder = FecDecoder::new(2, LargestPacket::DEFAULT);
    fec_decoder.add_known(2, &source_symbols[2].1);
    let (last, repair_symbol) = repair_symbol(0, &source_symbols);
    fec_decoder.add(last, repair_symbol);
    assert!(fec_decoder.rebuild().is_empty() && fec_decoder.sums.is_empty());
    assert_eq!(fec_decoder.wanted([3].into_iter(), 4), 1);
}

#[test]
fn a_source_symbol_is_kept_until_it_is_dropped_or_replaced() {
    let span = u64::from(FEC_SPAN);
    let mut source_symbols = SourceSymbols::default();
    assert_eq!(source_symbols.get(7), None);
    source_symbols.keep(7, &[1, 2, 3]);
    source_symbols.keep(8, &[4]);
    assert_eq!(source_symbols.get(7), Some(&[1, 2, 3][..]));
    assert_eq!(source_symbols.get(7 + span), None);
    source_symbols.keep(7 + span, &[5]);
    assert_eq!(
        (source_symbols.get(7), source_symbols.get(7 + span)),
        (None, Some(&[5][..]))
    );
    source_symbols.forget(7);
    assert_eq!(source_symbols.get(7 + span), Some(&[5][..]));
    source_symbols.forget_below(9);
    assert_eq!(
        (source_symbols.get(8), source_symbols.get(7 + span)),
        (None, Some(&[5][..]))
    );
    source_symbols.forget(7 + span);
    assert_eq!(source_symbols.get(7 + span), None);
}
