//! The JSON form of vectors and tables: one case or one row a line.
//!
//! The meaning of a case is the decoder's result. A 32-bit float is written as its bits in eight hexadecimal digits.

use std::fmt::Write;

use rhumb_protocol::packet::{
    ErrorScale, Head, Keyframe, LossReport, PacketKind, PredictionMode, Refresh, RepairSymbol,
    Tables, Update, UpdatePacket, UpdatePayload, Watermark,
};
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{Anchor, Predictor};

use crate::case::NamedPacket;
use crate::plain;

/// A repair symbol with the packets that it covers, by number.
#[derive(Debug)]
pub(crate) struct CoveredPackets {
    pub(crate) repair_symbol: Vec<u8>,
    pub(crate) packets: Vec<(u64, Vec<u8>)>,
}

/// The text of the vectors file.
pub(crate) fn vectors(
    accepted: &[NamedPacket],
    refused: &[NamedPacket],
    covered: &[CoveredPackets],
) -> String {
    let accepted = accepted.iter().map(|(name, bytes)| {
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
            "{{\"repair_symbol\": \"{}\", \"packets\": {}}}",
            hex(&case.repair_symbol),
            list(&packets)
        )
    });
    format!(
        "{{\n\"format\": \"rhumb packet vectors 1\",\n\"accepted\": [\n{}\n],\n\"refused\": [\n{}\n],\n\"repair_symbols\": [\n{}\n]\n}}\n",
        lines(accepted),
        lines(refused),
        lines(covered)
    )
}

/// The text of the tables file.
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
        write!(text, "{byte:02x}").expect("writing to a string does not fail");
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

/// The JSON object of a decoded datagram, or the error of a refused one.
pub(crate) fn meaning(bytes: &[u8]) -> Result<String, Malformed> {
    let mut reader = Reader::new(bytes);
    let head = Head::decode(&mut reader)?;
    let body = match head.kind {
        PacketKind::Updates => state("\"kind\": 0", UpdatePacket::decode(false, reader)?)?,
        PacketKind::UpdatesEnd => state("\"kind\": 1", UpdatePacket::decode(true, reader)?)?,
        PacketKind::UpdatesOverBudget => {
            let packet = UpdatePacket::decode_over_budget(reader)?;
            state(
                &format!("\"kind\": 11, {}", factor(packet.error_scale)),
                packet,
            )?
        }
        PacketKind::Watermark => format!("\"kind\": 2, {}", watermark(&Watermark::decode(reader)?)),
        PacketKind::WatermarkOverBudget => {
            let (accepted, error_scale) = Watermark::decode_over_budget(reader)?;
            format!(
                "\"kind\": 12, {}, {}",
                factor(error_scale),
                watermark(&accepted)
            )
        }
        PacketKind::Refresh => refresh(&Refresh::decode(reader)?),
        PacketKind::LossReport => {
            let loss_report = LossReport::decode(reader)?;
            let lost: Vec<_> = loss_report.lost.iter().map(|low| low.0).collect();
            format!(
                "\"kind\": 6, \"next\": {}, \"abandoned\": {}, \"repair_symbols\": {}, \"lost\": {}",
                loss_report.next.0,
                loss_report.abandoned.0,
                loss_report.repair_symbols,
                list(&lost)
            )
        }
        PacketKind::RepairSymbol => {
            let repair_symbol = RepairSymbol::decode(reader)?;
            format!(
                "\"kind\": 9, \"last\": {}, \"covered\": {}, \"row\": {}, \"symbol\": \"{}\"",
                repair_symbol.last.0,
                repair_symbol.covered,
                repair_symbol.row,
                hex(&repair_symbol.sums)
            )
        }
        PacketKind::Full | PacketKind::FullEnd | PacketKind::Checksums => {
            plain::meaning(head, reader)?
        }
    };
    Ok(format!("{{\"stream\": {}, {body}}}", head.stream.0))
}

/// An error scale in eighths, which are whole numbers.
fn factor(error_scale: ErrorScale) -> String {
    let eighths = error_scale.factor().map(|factor| (factor * 8.0) as u64);
    format!("\"error_scale_eighths\": {}", maybe(eighths))
}

fn watermark(accepted: &Watermark) -> String {
    let (next, tick, scene_events) = (accepted.next.0, accepted.tick.0, accepted.scene_events.0);
    format!("\"next\": {next}, \"tick\": {tick}, \"events\": {scene_events}")
}

fn state(kind: &str, packet: UpdatePacket<'_>) -> Result<String, Malformed> {
    let mut body = format!(
        "{kind}, \"number\": {}, \"tick\": {}, \"events\": {}",
        packet.number.0, packet.tick.0, packet.scene_events.0
    );
    let mut updates = Vec::new();
    packet.updates(&mut updates)?;
    let updates: Vec<_> = updates.iter().map(update).collect();
    write!(body, ", \"updates\": {}", list(&updates)).expect("writing to a string does not fail");
    Ok(body)
}

fn update(update: &Update) -> String {
    let Update {
        alias,
        body,
        payload,
    } = update;
    let accepted = match payload {
        UpdatePayload::Keyframe(track) => format!("\"keyframe\": {}", keyframe(track)),
        UpdatePayload::Resting {
            age,
            rest_correction,
        } => {
            let [x, y, z] = rest_correction.position;
            let [a, b, c] = rest_correction.others;
            format!(
                "\"age\": {}, \"negated\": {}, \"steps\": {}",
                age.count(),
                u32::from(rest_correction.negated),
                list(&[x, y, z, a, b, c, rest_correction.largest])
            )
        }
        UpdatePayload::Residual {
            mode,
            age,
            residual,
        } => {
            let mut accepted = match *mode {
                PredictionMode::Same => "\"mode\": \"same\"".to_owned(),
                PredictionMode::World {
                    predictor,
                    parent_age,
                } => format!(
                    "\"mode\": \"world\", {}, \"parent_age\": {}",
                    predictor_fields(predictor),
                    maybe(parent_age.map(rhumb_protocol::packet::Age::count))
                ),
                PredictionMode::Attached { parent, parent_age } => format!(
                    "\"mode\": \"attached\", \"parent\": {parent}, \"parent_age\": {}",
                    parent_age.count()
                ),
            };
            write!(
                accepted,
                ", \"age\": {}, \"position\": {}, \"turn\": {}",
                age.count(),
                list(&residual.position),
                list(&residual.turn)
            )
            .expect("writing to a string does not fail");
            if let Some(velocity) = residual.velocity {
                write!(
                    accepted,
                    ", \"velocity_exponent\": {}, \"linear\": {}, \"angular\": {}",
                    velocity.velocity_exponent,
                    list(&velocity.linear),
                    list(&velocity.angular)
                )
                .expect("writing to a string does not fail");
            }
            accepted
        }
    };
    format!(
        "{{\"alias\": {alias}, \"body\": {}, {accepted}}}",
        maybe(*body)
    )
}

fn refresh(refresh: &Refresh) -> String {
    let records: Vec<_> = refresh
        .records
        .iter()
        .map(|record| {
            format!(
                "{{\"index\": {}, \"alias\": {}, \"age\": {}, \"keyframe\": {}}}",
                record.index,
                maybe(record.alias),
                record.age.count(),
                keyframe(&record.keyframe)
            )
        })
        .collect();
    format!(
        "\"kind\": 3, \"lost\": {}, \"tick\": {}, \"events\": {}, \"part\": {}, \"parts\": {}, \"records\": {}",
        refresh.lost.0,
        refresh.tick.0,
        refresh.scene_events.0,
        refresh.part,
        refresh.parts,
        list(&records)
    )
}

fn keyframe(track: &Keyframe) -> String {
    let parent = track
        .parent
        .map(|parent| list(&[parent.index(), u32::from(parent.generation())]));
    let motion = match &track.anchor {
        Anchor::Exact(body_state) => {
            let parts = body_state.parts();
            let bits = parts.map(|part| format!("\"{:08x}\"", part.to_bits()));
            format!("\"body_state\": {}", list(&bits))
        }
        Anchor::Quantised(quantised) => {
            let (largest, others) = quantised.rotation.parts();
            format!(
                "\"position\": {}, \"largest\": {largest}, \"others\": {}, \"linear\": {}, \"angular\": {}",
                list(&quantised.position),
                list(&others),
                list(&quantised.linear),
                list(&quantised.angular)
            )
        }
    };
    format!(
        "{{{}, \"parent\": {}, {motion}}}",
        predictor_fields(track.predictor),
        maybe(parent)
    )
}

/// The code of a predictor, and its acceleration if it has one.
fn predictor_fields(predictor: Predictor) -> String {
    let code = match predictor {
        Predictor::Rest => 0,
        Predictor::Uniform => 1,
        Predictor::Ballistic => 2,
        Predictor::TorqueFree => 3,
        Predictor::BallisticTorqueFree => 4,
        Predictor::Accelerated(push) => {
            return format!(
                "\"predictor\": 5, \"acceleration\": {{\"exponent\": {}, \"steps\": {}}}",
                push.exponent(),
                list(&push.steps())
            );
        }
    };
    format!("\"predictor\": {code}")
}
