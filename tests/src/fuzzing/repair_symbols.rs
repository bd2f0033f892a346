//! A listener that loses packets and has them back from repair_symbols.
//!
//! Promises: a repair_symbol is the sum that the specification says, by arithmetic of its own here; and a listener that had back
//! what it lost believes what another believes that lost nothing.

use std::collections::BTreeMap;

use bytes::Bytes;
use rhumb_protocol::packet::{Head, Low16, PacketKind, RepairSymbol};
use rhumb_protocol::stream::{Redundancy, Subscriber};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Tolerance;

use super::script::Script;
use super::source::{BODIES, Source};

/// Ticks of one script, so that it ends soon.
const TICKS_MAX: u64 = 200;

/// x⁸ + x⁴ + x³ + x² + 1 without its highest power. Source: PROTOCOL 5.16.
const REDUCTION: u8 = 0x1d;

struct SubscriberPair {
    source: Source,
    whole: Subscriber,
    lossy: Subscriber,
    /// The packets of updates so far.
    packets: BTreeMap<u64, Bytes>,
}

/// A script of ticks, each packet and repair_symbol of which arrives or not.
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
        let (mut whole, mut lossy) = (Subscriber::new(&start), Subscriber::new(&start));
        whole.handle_snapshot_end();
        lossy.handle_snapshot_end();
        for index in 0..BODIES {
            let place = glam::Vec3::new(index as f32 * 3.0, 4.0 + index as f32, 0.0);
            let news = source.add(index, place).expect("there is none yet");
            news.tell(&mut whole);
            news.tell(&mut lossy);
        }
        Self {
            source,
            whole,
            lossy,
            packets: BTreeMap::new(),
        }
    }

    /// A tick; `lost`: bits of its datagrams that do not arrive.
    fn tick(&mut self, redundancy: Redundancy, lost: u8) {
        let sent = self.source.step();
        let next = self.source.publisher.next_number();
        for datagram in &sent {
            self.whole.handle_datagram(datagram);
            if let Some((number, _)) = column(datagram) {
                self.packets.insert(number.expand(next), datagram.clone());
            }
        }
        let mut repair_symbols = Vec::new();
        self.source
            .publisher
            .encode_repair_symbols(redundancy, &mut repair_symbols);
        self.hear(sent.iter().chain(&repair_symbols), lost);
    }

    /// The lossy one says what it lost, and hears repair_symbols and refreshes of it, or not.
    fn ask(&mut self, lost: u8) {
        let loss_report = self.lossy.loss_report();
        let mut answers = Vec::new();
        for number in self.source.publisher.answer(&loss_report, &mut answers) {
            let refresh = self
                .source
                .publisher
                .refresh(number, self.source.scene_events);
            answers.extend(refresh.expect("the history is long enough"));
        }
        answers.push(self.source.publisher.watermark(self.source.scene_events));
        self.hear(answers.iter(), lost);
    }

    fn hear<'a>(&mut self, sent: impl Iterator<Item = &'a Bytes>, lost: u8) {
        for (place, datagram) in sent.enumerate() {
            self.check_sum(datagram);
            if lost >> (place % 8) & 1 == 0 {
                self.lossy.handle_datagram(datagram);
            }
        }
    }

    /// That a repair_symbol is the sum of the columns that it names.
    fn check_sum(&self, datagram: &[u8]) {
        let mut reader = Reader::new(datagram);
        let head = Head::decode(&mut reader).expect("a publisher says datagrams");
        if head.kind != PacketKind::RepairSymbol {
            return;
        }
        let repair_symbol = RepairSymbol::decode(reader).expect("a publisher says repair_symbols");
        let last = repair_symbol
            .last
            .expand(self.source.publisher.next_number());
        let mut sums = Vec::new();
        for number in repair_symbol.numbers(last) {
            let packet = self.packets.get(&number).expect("it covers what was sent");
            let (_, column) = column(packet).expect("it covers packets of updates");
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
        let same_tick = self.lossy.watermark_tick() == self.whole.watermark_tick();
        if !same_tick || !self.lossy.is_converged() {
            return;
        }
        assert_eq!(self.lossy.state_checksum(), self.whole.state_checksum());
        for (id, track) in self.source.publisher.tracks() {
            assert_eq!(self.lossy.track(id), Some(track));
        }
    }
}

/// The number of a packet of updates, and what repair_symbols sum of it: whether it ends its tick, and what follows its number.
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

/// In the field of PROTOCOL 5.16, bit by bit.
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
