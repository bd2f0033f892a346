//! Fuzzes a subscriber that loses packets and restores them by repair symbols.
//!
//! Promises: a repair symbol equals the specified sum, computed by independent arithmetic here. A subscriber that
//! restores lost packets has the same tracks as one that lost nothing.

use std::collections::BTreeMap;

use bytes::Bytes;
use rhumb_protocol::packet::{Head, Low16, PacketKind, RepairSymbol};
use rhumb_protocol::stream::{Redundancy, Subscriber};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Tolerance;

use super::script::Script;
use super::source::{BODIES, Source};

/// Number of ticks of one script, so that it ends soon.
const TICKS_MAX: u64 = 200;

/// x⁸ + x⁴ + x³ + x² + 1 without its highest power. Source: PROTOCOL 5.16.
const REDUCTION: u8 = 0x1d;

struct SubscriberPair {
    source: Source,
    lossless: Subscriber,
    lossy: Subscriber,
    /// The state packets so far.
    packets: BTreeMap<u64, Bytes>,
}

/// A script of ticks; each packet and repair symbol arrives or is lost.
pub fn repair_symbols(data: &[u8]) {
    let mut script = Script::new(data);
    let mut subscribers = SubscriberPair::new();
    while script.goes_on() && subscribers.source.tick.value() < TICKS_MAX {
        match script.below(8) {
            0..4 => {
                let redundancy = script.one_of(&[
                    Redundancy::Thick,
                    Redundancy::Plain,
                    Redundancy::Thin,
                    Redundancy::Off,
                ]);
                subscribers.tick(redundancy, script.any());
            }
            4 => subscribers.ask(script.any()),
            _ => subscribers.source.strike(&mut script),
        }
        subscribers.check();
    }
}

impl SubscriberPair {
    fn new() -> Self {
        let mut source = Source::new(Tolerance::EXACT, None);
        let start = source.start();
        let (mut lossless, mut lossy) = (Subscriber::new(&start), Subscriber::new(&start));
        lossless.handle_snapshot_end();
        lossy.handle_snapshot_end();
        for index in 0..BODIES {
            let place = glam::Vec3::new(index as f32 * 3.0, 4.0 + index as f32, 0.0);
            let changes = source.add(index, place).expect("a free index");
            changes.apply_to(&mut lossless);
            changes.apply_to(&mut lossy);
        }
        Self {
            source,
            lossless,
            lossy,
            packets: BTreeMap::new(),
        }
    }

    /// One tick; `lost`: one bit for each datagram that does not arrive.
    fn tick(&mut self, redundancy: Redundancy, lost: u8) {
        let sent = self.source.step();
        let next = self.source.publisher.next_number();
        for datagram in &sent {
            self.lossless.handle_datagram(datagram);
            if let Some((number, _)) = column(datagram) {
                self.packets.insert(number.expand(next), datagram.clone());
            }
        }
        let mut repair_symbols = Vec::new();
        self.source
            .publisher
            .encode_repair_symbols(redundancy, &mut repair_symbols);
        self.receive(sent.iter().chain(&repair_symbols), lost);
    }

    /// The lossy subscriber reports its losses; the answers arrive or are lost.
    fn ask(&mut self, lost: u8) {
        let loss_report = self.lossy.loss_report();
        let mut answers = Vec::new();
        for number in self.source.publisher.answer(&loss_report, &mut answers) {
            let refresh = self
                .source
                .publisher
                .refresh(number, self.source.scene_events);
            answers.extend(refresh.expect("the publisher keeps a long enough history"));
        }
        answers.push(self.source.publisher.watermark(self.source.scene_events));
        self.receive(answers.iter(), lost);
    }

    fn receive<'a>(&mut self, sent: impl Iterator<Item = &'a Bytes>, lost: u8) {
        for (place, datagram) in sent.enumerate() {
            self.check_sum(datagram);
            if lost >> (place % 8) & 1 == 0 {
                self.lossy.handle_datagram(datagram);
            }
        }
    }

    /// Checks that a repair symbol is the sum of the source symbols that it names.
    fn check_sum(&self, datagram: &[u8]) {
        let mut reader = Reader::new(datagram);
        let head = Head::decode(&mut reader).expect("a publisher sends valid packets");
        if head.kind != PacketKind::RepairSymbol {
            return;
        }
        let repair_symbol =
            RepairSymbol::decode(reader).expect("a publisher sends valid repair symbols");
        let last = repair_symbol
            .last
            .expand(self.source.publisher.next_number());
        let mut sums = Vec::new();
        for number in repair_symbol.numbers(last) {
            let packet = self.packets.get(&number).expect("it covers sent packets");
            let (_, column) = column(packet).expect("it covers state packets");
            let factor = RepairSymbol::factor(repair_symbol.row, number);
            if sums.len() < column.len() {
                sums.resize(column.len(), 0);
            }
            for (sum, byte) in sums.iter_mut().zip(column) {
                *sum ^= product(factor, byte);
            }
        }
        while sums.last() == Some(&0) {
            sums.pop();
        }
        assert_eq!(repair_symbol.sums, sums, "PROTOCOL 5.16");
    }

    fn check(&self) {
        let received = self.lossy.statistics();
        assert_eq!((received.malformed, received.mismatches), (0, 0));
        let same_tick = self.lossy.watermark_tick() == self.lossless.watermark_tick();
        if !same_tick || !self.lossy.is_converged() {
            return;
        }
        assert_eq!(self.lossy.state_checksum(), self.lossless.state_checksum());
        for (id, track) in self.source.publisher.tracks() {
            assert_eq!(self.lossy.track(id), Some(track));
        }
    }
}

/// The number of a state packet, and its source symbol: whether it ends its tick, and the bytes after its number.
fn column(datagram: &[u8]) -> Option<(Low16, Vec<u8>)> {
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader).ok()?;
    let ends = match head.kind {
        PacketKind::Updates => 0,
        PacketKind::UpdatesEnd => 1,
        _ => return None,
    };
    let number = Low16::decode(&mut reader).ok()?;
    Some((number, [&[ends], reader.rest()].concat()))
}

/// Product in the field of PROTOCOL 5.16, computed bit by bit.
fn product(mut a: u8, mut b: u8) -> u8 {
    let mut product = 0;
    while b != 0 {
        if b & 1 == 1 {
            product ^= a;
        }
        let carry = a & 0x80 != 0;
        a <<= 1;
        if carry {
            a ^= REDUCTION;
        }
        b >>= 1;
    }
    product
}
