//! The form of vectors and tables: one case, or one row, a line of JSON.
//!
//! Each meaning is what the decoder makes of the bytes. f32s are their bits as eight hexadecimal digits.

use std::fmt::Write;

use rhumb_protocol::packet::{
    Course, Echo, Excess, Head, Kind, Parity, Repair, Saying, StatePacket, Tables, TrackSaying,
    Update, Vouch,
};
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{Anchor, Predictor};

use crate::plain;

/// What a case shows, and its datagram.
pub(crate) type Case = (String, Vec<u8>);

/// A parity with the packets that it covers, by number.
#[derive(Debug)]
pub(crate) struct Covered {
    pub(crate) parity: Vec<u8>,
    pub(crate) packets: Vec<(u64, Vec<u8>)>,
}

/// The file of vectors.
pub(crate) fn vectors(said: &[Case], refused: &[Case], covered: &[Covered]) -> String {
    let said = said.iter().map(|(name, bytes)| {
        let means = meaning(bytes).unwrap_or_else(|why| panic!("{name}: {why}"));
        format!(
            "{{\"name\": \"{name}\", \"bytes\": \"{}\", \"means\": {means}}}",
            hex(bytes)
        )
    });
    let refused = refused.iter().map(|(name, bytes)| {
        let why = meaning(bytes).expect_err(name);
        format!(
            "{{\"name\": \"{name}\", \"bytes\": \"{}\", \"refusal\": \"{why:?}\"}}",
            hex(bytes)
        )
    });
    let covered = covered.iter().map(|case| {
        let of = |(number, bytes): &(u64, Vec<u8>)| format!("[{number}, \"{}\"]", hex(bytes));
        let packets: Vec<_> = case.packets.iter().map(of).collect();
        format!(
            "{{\"parity\": \"{}\", \"packets\": {}}}",
            hex(&case.parity),
            list(&packets)
        )
    });
    format!(
        "{{\n\"format\": \"rhumb packet vectors 1\",\n\"said\": [\n{}\n],\n\"refused\": [\n{}\n],\n\"parities\": [\n{}\n]\n}}\n",
        lines(said),
        lines(refused),
        lines(covered)
    )
}

/// The file of tables.
pub(crate) fn tables() -> String {
    let Tables {
        expected,
        shapes,
        modes,
    } = Tables::ALL;
    format!(
        "{{\n\"format\": \"rhumb packet tables 1\",\n\"expected\": [\n{}\n],\n\"shapes\": [\n{}\n],\n\"modes\": [\n{}\n]\n}}\n",
        lines(
            expected
                .chunks(16)
                .map(|row| list(row).trim_matches(['[', ']']).to_owned())
        ),
        lines(shapes.iter().map(|row| list(row))),
        lines(modes.iter().map(|row| list(row))),
    )
}

fn lines(lines: impl Iterator<Item = String>) -> String {
    lines.collect::<Vec<_>>().join(",\n")
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").expect("a string takes text");
        text
    })
}

fn list<T: ToString>(values: &[T]) -> String {
    let values: Vec<_> = values.iter().map(ToString::to_string).collect();
    format!("[{}]", values.join(", "))
}

fn maybe<T: ToString>(value: Option<T>) -> String {
    value.map_or("null".to_owned(), |value| value.to_string())
}

/// What a datagram says, or why it is refused.
pub(crate) fn meaning(bytes: &[u8]) -> Result<String, Malformed> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader)?;
    let body = match head.kind {
        Kind::State => state("\"kind\": 0", StatePacket::decode(false, reader)?)?,
        Kind::StateEnd => state("\"kind\": 1", StatePacket::decode(true, reader)?)?,
        Kind::StateInArrears => {
            let packet = StatePacket::decode_in_arrears(reader)?;
            state(&format!("\"kind\": 11, {}", factor(packet.excess)), packet)?
        }
        Kind::Vouch => format!("\"kind\": 2, {}", vouch(&Vouch::decode(reader)?)),
        Kind::VouchInArrears => {
            let (said, excess) = Vouch::decode_in_arrears(reader)?;
            format!("\"kind\": 12, {}, {}", factor(excess), vouch(&said))
        }
        Kind::Repair => repair(&Repair::decode(reader)?),
        Kind::Echo => {
            let echo = Echo::decode(reader)?;
            let lost: Vec<_> = echo.lost.iter().map(|low| low.0).collect();
            format!(
                "\"kind\": 6, \"next\": {}, \"gone\": {}, \"parities\": {}, \"lost\": {}",
                echo.next.0,
                echo.gone.0,
                echo.parities,
                list(&lost)
            )
        }
        Kind::Parity => {
            let parity = Parity::decode(reader)?;
            format!(
                "\"kind\": 9, \"last\": {}, \"covered\": {}, \"row\": {}, \"sums\": \"{}\"",
                parity.last.0,
                parity.covered,
                parity.row,
                hex(&parity.sums)
            )
        }
        Kind::Full | Kind::FullEnd | Kind::Digest | Kind::Doubt => plain::meaning(head, reader)?,
    };
    Ok(format!("{{\"stream\": {}, {body}}}", head.stream.0))
}

/// A factor in eighths, which are whole.
fn factor(excess: Excess) -> String {
    let eighths = excess.factor().map(|factor| (factor * 8.0) as u64);
    format!("\"excess_eighths\": {}", maybe(eighths))
}

fn vouch(said: &Vouch) -> String {
    let (next, tick, notices) = (said.next.0, said.tick.0, said.notices.0);
    format!("\"next\": {next}, \"tick\": {tick}, \"notices\": {notices}")
}

fn state(kind: &str, packet: StatePacket<'_>) -> Result<String, Malformed> {
    let mut body = format!(
        "{kind}, \"number\": {}, \"tick\": {}, \"notices\": {}",
        packet.number.0, packet.tick.0, packet.notices.0
    );
    let mut updates = Vec::new();
    packet.updates(&mut updates)?;
    let updates: Vec<_> = updates.iter().map(update).collect();
    write!(body, ", \"updates\": {}", list(&updates)).expect("a string takes text");
    Ok(body)
}

fn update(update: &Update) -> String {
    let Update { seat, body, saying } = update;
    let said = match saying {
        Saying::Whole(track) => format!("\"whole\": {}", whole(track)),
        Saying::Settled { age, settling } => {
            let [x, y, z] = settling.position;
            let [a, b, c] = settling.others;
            format!(
                "\"age\": {}, \"negated\": {}, \"steps\": {}",
                age.count(),
                u32::from(settling.negated),
                list(&[x, y, z, a, b, c, settling.largest])
            )
        }
        Saying::Residual {
            course,
            age,
            residual,
        } => {
            let mut said = match *course {
                Course::Same => "\"course\": \"same\"".to_owned(),
                Course::World {
                    predictor,
                    carrier_age,
                } => format!(
                    "\"course\": \"world\", {}, \"carrier_age\": {}",
                    law(predictor),
                    maybe(carrier_age.map(rhumb_protocol::packet::Age::count))
                ),
                Course::Held {
                    carrier,
                    carrier_age,
                } => format!(
                    "\"course\": \"held\", \"carrier\": {carrier}, \"carrier_age\": {}",
                    carrier_age.count()
                ),
            };
            write!(
                said,
                ", \"age\": {}, \"position\": {}, \"turn\": {}",
                age.count(),
                list(&residual.position),
                list(&residual.turn)
            )
            .expect("a string takes text");
            if let Some(velocity) = residual.velocity {
                write!(
                    said,
                    ", \"coarseness\": {}, \"linear\": {}, \"angular\": {}",
                    velocity.coarseness,
                    list(&velocity.linear),
                    list(&velocity.angular)
                )
                .expect("a string takes text");
            }
            said
        }
    };
    format!("{{\"seat\": {seat}, \"body\": {}, {said}}}", maybe(*body))
}

fn repair(repair: &Repair) -> String {
    let records: Vec<_> = repair
        .records
        .iter()
        .map(|record| {
            format!(
                "{{\"index\": {}, \"seat\": {}, \"age\": {}, \"whole\": {}}}",
                record.index,
                maybe(record.seat),
                record.age.count(),
                whole(&record.whole)
            )
        })
        .collect();
    format!(
        "\"kind\": 3, \"lost\": {}, \"tick\": {}, \"notices\": {}, \"part\": {}, \"parts\": {}, \"records\": {}",
        repair.lost.0,
        repair.tick.0,
        repair.notices.0,
        repair.part,
        repair.parts,
        list(&records)
    )
}

fn whole(track: &TrackSaying) -> String {
    let carrier = track
        .carrier
        .map(|carrier| list(&[carrier.index(), u32::from(carrier.generation())]));
    let motion = match &track.anchor {
        Anchor::Verbatim(verbatim) => {
            let parts = verbatim.parts();
            let bits = parts.map(|part| format!("\"{:08x}\"", part.to_bits()));
            format!("\"verbatim\": {}", list(&bits))
        }
        Anchor::Snapped(snapped) => {
            let (largest, others) = snapped.rotation.parts();
            format!(
                "\"position\": {}, \"largest\": {largest}, \"others\": {}, \"linear\": {}, \"angular\": {}",
                list(&snapped.position),
                list(&others),
                list(&snapped.linear),
                list(&snapped.angular)
            )
        }
    };
    format!(
        "{{{}, \"carrier\": {}, {motion}}}",
        law(track.predictor),
        maybe(carrier)
    )
}

/// The code of a law, and its push if it has one.
fn law(predictor: Predictor) -> String {
    let code = match predictor {
        Predictor::Rest => 0,
        Predictor::Uniform => 1,
        Predictor::Ballistic => 2,
        Predictor::Tumbling => 3,
        Predictor::Thrown => 4,
        Predictor::Pushed(push) => {
            return format!(
                "\"law\": 5, \"push\": {{\"doublings\": {}, \"steps\": {}}}",
                push.doublings(),
                list(&push.steps())
            );
        }
    };
    format!("\"law\": {code}")
}
