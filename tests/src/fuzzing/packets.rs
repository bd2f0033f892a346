//! Datagrams, from any bytes and from anything that can be said.
//!
//! Promises: what is read is written again as it was, byte by byte, so that a value has one encoding; what is written is
//! read as it was said; and whatever the range coder is given, it reads or refuses.

use rhumb_protocol::limits::DATAGRAM_BYTES_MAX;
use rhumb_protocol::packet::{
    Digest, Doubt, Echo, Forge, FullPacket, Head, Kind, Low16, Parity, Repair, RepairRecord,
    RepairWriter, StatePacket, StateWriter, StreamId, Update, Vouch,
};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::Ticks;

use super::sayings::{updates, whole};
use super::script::Script;

const STREAM: StreamId = StreamId(3);

/// Whatever a datagram may be.
pub(super) const KINDS: [Kind; 12] = [
    Kind::State,
    Kind::StateEnd,
    Kind::Vouch,
    Kind::Repair,
    Kind::Full,
    Kind::FullEnd,
    Kind::Echo,
    Kind::Digest,
    Kind::Doubt,
    Kind::Parity,
    Kind::StateInArrears,
    Kind::VouchInArrears,
];

/// The head of a datagram, of which the rest is still to be said.
pub(super) fn begun(kind: Kind, stream: StreamId) -> Vec<u8> {
    let mut to = Writer::new();
    Head { kind, stream }.encode(&mut to);
    to.into_bytes()
}

/// Packets of updates: any bytes, whatever can be said with a bit turned, and numbers without meaning.
pub fn state_packets(data: &[u8]) {
    let mut script = Script::new(data);
    let datagram = match script.below(3) {
        0 => script.rest().to_vec(),
        1 => said(&mut script),
        _ => forged(&mut script),
    };
    let _ = written_again(&datagram);
}

/// Packets of every other kind: any bytes, and repairs with a bit turned.
pub fn side_packets(data: &[u8]) {
    let mut script = Script::new(data);
    let datagram = if script.any() {
        script.rest().to_vec()
    } else {
        let mut datagram = repair(&mut script);
        turn(&mut script, &mut datagram);
        datagram
    };
    let _ = written_again(&datagram);
}

/// Turns a bit, if the script goes on.
fn turn(script: &mut Script<'_>, datagram: &mut [u8]) {
    if script.goes_on() {
        let bit = script.below(datagram.len() * 8);
        datagram[bit / 8] ^= 1 << (bit % 8);
    }
}

/// What a publisher might say, once it was read as it was said.
fn said(script: &mut Script<'_>) -> Vec<u8> {
    let mut writer = StateWriter::new(STREAM, script.any(), script.any(), script.any());
    let mut all = updates(script, 12);
    let fits = all.iter().take_while(|update| writer.push(update)).count();
    all.truncate(fits);
    let mut datagram = writer.finish(script.any());
    assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
    assert_eq!(written_again(&datagram), Ok(()), "{all:?}");
    let mut reader = Reader::new(&datagram);
    let head = Head::decode(&mut reader).expect("what was just written");
    let mut read = Vec::new();
    StatePacket::decode(head.kind == Kind::StateEnd, reader)
        .and_then(|packet| packet.updates(&mut read))
        .expect("what was just written");
    assert_eq!(read, all, "read otherwise than it was said");
    turn(script, &mut datagram);
    datagram
}

/// Numbers in contexts of the range coder, as no publisher says them.
fn forged(script: &mut Script<'_>) -> Vec<u8> {
    let mut forge = Forge::default();
    while script.goes_on() {
        forge = match script.below(4) {
            0 => forge.code(script.below(2), script.below(18)),
            1 => {
                let bits = 1 + script.below(31) as u32;
                forge.raw(script.any::<u32>() & ((1 << bits) - 1), bits)
            }
            2 => forge.escape(script.below(4)),
            _ => {
                let small = script.any::<bool>();
                let number = script.any::<u32>();
                forge.number(script.below(8), if small { number & 0xff } else { number })
            }
        };
    }
    let mut datagram = begun(Kind::StateEnd, STREAM);
    datagram.extend_from_slice(&[0; 6]);
    datagram.extend(forge.into_bytes());
    datagram
}

/// Repairs with any tracks.
fn repair(script: &mut Script<'_>) -> Vec<u8> {
    let mut writer = RepairWriter::default();
    let mut index = 0;
    let mut records = Vec::new();
    for _ in 0..script.below(8) {
        let record = RepairRecord {
            index,
            seat: script.any::<bool>().then(|| script.below(300) as u32),
            age: Ticks::new(script.any::<u32>() % (1 << 30)),
            whole: whole(script),
        };
        writer.push(&record);
        records.push(record);
        index += 1 + script.below(300) as u32;
    }
    let (lost, tick) = (script.any::<u16>(), script.any::<u16>());
    let parts = writer.finish(STREAM, lost.into(), tick.into(), 0);
    let mut read = Vec::new();
    for part in &parts {
        assert_eq!(written_again(part), Ok(()));
        let mut reader = Reader::new(part);
        Head::decode(&mut reader).expect("what was just written");
        read.extend(
            Repair::decode(reader)
                .expect("what was just written")
                .records,
        );
    }
    assert_eq!(read, records, "read otherwise than it was said");
    parts.into_iter().next().expect("a repair has a part")
}

/// Reads a datagram and writes it again.
///
/// # Panics
///
/// When it is written otherwise than it was read.
pub(super) fn written_again(datagram: &[u8]) -> Result<(), Malformed> {
    let mut reader = Reader::new(datagram);
    let head = Head::decode(&mut reader)?;
    let stream = head.stream;
    let again = match head.kind {
        Kind::State | Kind::StateEnd | Kind::StateInArrears => state_again(head, reader)?,
        Kind::Vouch => Some(Vouch::decode(reader)?.encode(stream)),
        Kind::VouchInArrears => {
            let (vouch, excess) = Vouch::decode_in_arrears(reader)?;
            Some(vouch.encode_in_arrears(stream, excess))
        }
        Kind::Repair => repair_again(head, reader, datagram)?,
        Kind::Full | Kind::FullEnd => {
            let packet = FullPacket::decode(head.kind == Kind::FullEnd, reader)?;
            let fits = packet.records.len() <= FullPacket::RECORDS_MAX;
            fits.then(|| packet.encode(stream))
        }
        Kind::Echo => Some(Echo::decode(reader)?.encode(stream)),
        Kind::Digest => Some(Digest::decode(reader)?.encode(stream)),
        Kind::Doubt => Some(Doubt::decode(reader)?.encode(stream)),
        Kind::Parity => Some(Parity::decode(reader)?.encode(stream)),
    };
    if let Some(again) = again {
        assert_eq!(again, datagram, "one value, one encoding");
    }
    Ok(())
}

/// `None` where a writer would have begun another packet.
fn state_again(head: Head, reader: Reader<'_>) -> Result<Option<Vec<u8>>, Malformed> {
    let in_arrears = head.kind == Kind::StateInArrears;
    let packet = if in_arrears {
        StatePacket::decode_in_arrears(reader)?
    } else {
        StatePacket::decode(head.kind == Kind::StateEnd, reader)?
    };
    let number = |low: Low16| u64::from(low.0);
    let (ends_tick, excess) = (packet.ends_tick, packet.excess);
    let mut writer = StateWriter::new(
        head.stream,
        number(packet.number),
        number(packet.tick),
        number(packet.notices),
    );
    let mut all: Vec<Update> = Vec::new();
    packet.updates(&mut all)?;
    if !all.iter().all(|update| writer.push(update)) {
        return Ok(None);
    }
    Ok(Some(if in_arrears {
        writer.finish_in_arrears(excess)
    } else {
        writer.finish(ends_tick)
    }))
}

/// A writer says all parts of a repair; of the part at hand only its place among them cannot be told.
fn repair_again(
    head: Head,
    reader: Reader<'_>,
    datagram: &[u8],
) -> Result<Option<Vec<u8>>, Malformed> {
    let behind_head = datagram.len() - reader.rest().len();
    let repair = Repair::decode(reader)?;
    let mut writer = RepairWriter::default();
    for record in &repair.records {
        writer.push(record);
    }
    let low = |low: Low16| u64::from(low.0);
    let (lost, tick, notices) = (low(repair.lost), low(repair.tick), low(repair.notices));
    let mut parts = writer.finish(head.stream, lost, tick, notices);
    if parts.len() != 1 {
        return Ok(None);
    }
    let place = behind_head + 6;
    parts[0][place..place + 2].copy_from_slice(&[repair.part, repair.parts]);
    Ok(parts.pop())
}
