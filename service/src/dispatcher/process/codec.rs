//! Settings of a worker process, and bytes of its messages.
//!
//! Both ends are one program, so that there are no versions. Payloads are shared: a packet for many members is written
//! once in a frame. Invariant: reading never panics, since a process that a scene has broken may send anything.

use std::collections::BTreeMap;
use std::num::NonZeroU32;
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use rhumb_protocol::message::Role;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_protocol::{Ending, LinkReport, Peer, Span, Transmit};
use rhumb_scene::engine::EngineKind;
use rhumb_scene::{Limits, Permit, Quotas, decode_client_of, encode_client_of};
use serde::{Deserialize, Serialize};
use tracing::level_filters::LevelFilter;

use super::super::message::{
    FromProcess, FromWorker, ToProcess, Vitals, WorkerId, WorkerInput, WorkerOutput,
};
use crate::directory::ServerPlace;
use crate::durable::{Generation, LogTail};
use crate::metrics::{SCENE_VALUES, SceneValues};

/// Bytes from which on the rest of an output goes into another frame.
const SPLIT_BYTES: usize = 1 << 20;

mod to {
    pub(super) const BEGIN: u8 = 0;
    pub(super) const ELSEWHERE: u8 = 1;
    pub(super) const OPENED: u8 = 2;
    pub(super) const CONTROL: u8 = 3;
    pub(super) const CONTROL_TAKEN: u8 = 4;
    pub(super) const DATAGRAM: u8 = 5;
    pub(super) const LINK: u8 = 6;
    pub(super) const ENDED: u8 = 7;
    pub(super) const RESTORE: u8 = 8;
    pub(super) const WAKE: u8 = 9;
    pub(super) const END: u8 = 10;
    pub(super) const FOLLOW: u8 = 11;
    pub(super) const MOVE: u8 = 12;
}

mod from {
    pub(super) const OUTPUT: u8 = 0;
    pub(super) const OVER: u8 = 1;
    pub(super) const ALIVE: u8 = 2;
    pub(super) const FIGURES: u8 = 3;
    pub(super) const FLIGHT: u8 = 4;
    pub(super) const WRITE_FLIGHT: u8 = 5;
}

mod transmit {
    pub(super) const CONTROL: u8 = 0;
    pub(super) const STATE: u8 = 1;
    pub(super) const CLOSE: u8 = 2;
    pub(super) const END: u8 = 3;
}

/// The frame of a message to a process.
pub(super) fn encode_to(message: &ToProcess) -> Vec<u8> {
    let mut to = Writer::new();
    match message {
        ToProcess::Begin(id, scene) => {
            to.u8(to::BEGIN);
            to.varint(u64::from(id.0));
            scene.encode(&mut to);
        }
        ToProcess::Elsewhere { scenes, load } => {
            to.u8(to::ELSEWHERE);
            to.varint(*scenes);
            to.varint(*load);
        }
        ToProcess::Input(id, input) => encode_input(*id, input, &mut to),
    }
    to.into_bytes()
}

fn encode_input(id: WorkerId, input: &WorkerInput, to: &mut Writer) {
    let mut begin = |kind, peer: Option<&Peer>| {
        to.u8(kind);
        to.varint(u64::from(id.0));
        if let Some(peer) = peer {
            to.varint(peer.0);
        }
    };
    match input {
        WorkerInput::Opened(peer, permit) => {
            begin(to::OPENED, Some(peer));
            encode_permit(permit, to);
        }
        WorkerInput::Control(peer, bytes) => {
            begin(to::CONTROL, Some(peer));
            to.sized(bytes);
        }
        WorkerInput::ControlTaken(peer, bytes) => {
            begin(to::CONTROL_TAKEN, Some(peer));
            to.varint(*bytes as u64);
        }
        WorkerInput::Datagram(peer, bytes) => {
            begin(to::DATAGRAM, Some(peer));
            to.sized(bytes);
        }
        WorkerInput::Link(peer, report) => {
            begin(to::LINK, Some(peer));
            to.varint(report.waiting_bytes);
            to.varint(report.sent_bytes);
            to.varint(report.over.as_nanos());
            to.varint(report.round_trip.as_nanos());
        }
        WorkerInput::Ended(peer, ending) => {
            begin(to::ENDED, Some(peer));
            let (kind, code) = match ending {
                Ending::Closed(code) => (0, *code),
                Ending::TimedOut => (1, 0),
                Ending::Broken => (2, 0),
            };
            to.u8(kind);
            to.varint(u64::from(code));
        }
        WorkerInput::Restore(tail, generation) => {
            begin(to::RESTORE, None);
            to.u8(u8::from(*tail == LogTail::LeftOut));
            encode_optional(generation.map(|generation| generation.0), to);
        }
        WorkerInput::Follow => begin(to::FOLLOW, None),
        WorkerInput::Move(place) => {
            begin(to::MOVE, None);
            to.sized(place.0.as_bytes());
        }
        WorkerInput::Wake => begin(to::WAKE, None),
        WorkerInput::End => begin(to::END, None),
    }
}

/// A message to a process from its frame.
pub(super) fn decode_to(frame: &Bytes) -> Result<ToProcess, Malformed> {
    let mut reader = Reader::new(frame);
    let message = decode_to_in(frame, &mut reader)?;
    reader.finish()?;
    Ok(message)
}

fn decode_to_in(frame: &Bytes, from: &mut Reader<'_>) -> Result<ToProcess, Malformed> {
    let kind = from.u8()?;
    if kind == to::ELSEWHERE {
        let (scenes, load) = (from.varint()?, from.varint()?);
        return Ok(ToProcess::Elsewhere { scenes, load });
    }
    let id = WorkerId(from.varint32()?);
    let input = match kind {
        to::BEGIN => return Ok(ToProcess::Begin(id, SceneName::decode(from)?)),
        to::OPENED => WorkerInput::Opened(peer(from)?, Arc::new(decode_permit(from)?)),
        to::CONTROL => WorkerInput::Control(peer(from)?, payload(frame, from)?),
        to::CONTROL_TAKEN => WorkerInput::ControlTaken(peer(from)?, size(from)?),
        to::DATAGRAM => WorkerInput::Datagram(peer(from)?, payload(frame, from)?),
        to::LINK => {
            let peer = peer(from)?;
            let report = LinkReport {
                waiting_bytes: from.varint()?,
                sent_bytes: from.varint()?,
                over: Span::from_nanos(from.varint()?),
                round_trip: Span::from_nanos(from.varint()?),
            };
            WorkerInput::Link(peer, report)
        }
        to::ENDED => {
            let peer = peer(from)?;
            let ending = match (from.u8()?, from.varint32()?) {
                (0, code) => Ending::Closed(code),
                (1, 0) => Ending::TimedOut,
                (2, 0) => Ending::Broken,
                _ => return Err(Malformed::UnknownCode),
            };
            WorkerInput::Ended(peer, ending)
        }
        to::RESTORE => {
            let tail = match flag(from)? {
                false => LogTail::Kept,
                true => LogTail::LeftOut,
            };
            WorkerInput::Restore(tail, decode_optional(from)?.map(Generation))
        }
        to::FOLLOW => WorkerInput::Follow,
        to::MOVE => {
            let place = String::from_utf8(from.sized(from.rest().len())?.to_vec());
            WorkerInput::Move(ServerPlace(place.map_err(|_| Malformed::Text)?))
        }
        to::WAKE => WorkerInput::Wake,
        to::END => WorkerInput::End,
        _ => return Err(Malformed::UnknownCode),
    };
    Ok(ToProcess::Input(id, input))
}

fn encode_permit(permit: &Permit, to: &mut Writer) {
    encode_client_of(permit.client.as_ref(), to);
    to.u8(permit.role.code());
    let Quotas {
        bodies,
        commands,
        load,
        members,
        scenes,
    } = permit.quotas;
    for quota in [bodies, commands, members, scenes] {
        encode_optional(quota.map(u64::from), to);
    }
    encode_optional(load, to);
    to.u8(u8::from(permit.owns));
}

fn encode_optional(number: Option<u64>, to: &mut Writer) {
    to.u8(u8::from(number.is_some()));
    number.into_iter().for_each(|number| to.varint(number));
}

fn decode_permit(from: &mut Reader<'_>) -> Result<Permit, Malformed> {
    let client = decode_client_of(from)?;
    let role = Role::from_code(from.u8()?).ok_or(Malformed::UnknownCode)?;
    let small = |from: &mut Reader<'_>| {
        let quota = decode_optional(from)?.map(u32::try_from).transpose();
        quota.map_err(|_| Malformed::OutOfRange)
    };
    let [bodies, commands, members, scenes] =
        [small(from)?, small(from)?, small(from)?, small(from)?];
    let quotas = Quotas {
        bodies,
        commands,
        members,
        scenes,
        load: decode_optional(from)?,
    };
    let owns = flag(from)?;
    Ok(Permit {
        client,
        role,
        quotas,
        owns,
    })
}

fn decode_optional(from: &mut Reader<'_>) -> Result<Option<u64>, Malformed> {
    flag(from)?.then(|| from.varint()).transpose()
}

/// The frames of a message of a process, each given to `send`, which says if more can be sent. A long output is divided.
pub(super) fn encode_from(message: &FromProcess, send: &mut dyn FnMut(&[u8]) -> bool) -> bool {
    let mut to = Writer::new();
    match message {
        FromProcess::Worker(id, FromWorker::Output(output)) => {
            return encode_output(*id, output, send);
        }
        FromProcess::Worker(id, FromWorker::Over) => {
            to.u8(from::OVER);
            to.varint(u64::from(id.0));
        }
        FromProcess::Alive(vitals) => {
            to.u8(from::ALIVE);
            to.varint(vitals.scenes);
            to.varint(vitals.load);
            to.u8(u8::from(vitals.busiest.is_some()));
            if let Some((id, busy)) = vitals.busiest {
                to.varint(u64::from(id.0));
                to.varint(busy.as_nanos());
            }
        }
        FromProcess::Metrics(scenes) => {
            to.u8(from::FIGURES);
            to.varint(scenes.len() as u64);
            for (name, values) in scenes {
                name.encode(&mut to);
                values.0.iter().for_each(|value| to.varint(*value));
            }
        }
        FromProcess::Flight(scene, entries) => {
            to.u8(from::FLIGHT);
            scene.encode(&mut to);
            to.sized(entries);
        }
        FromProcess::WriteFlight(scene, cause) => {
            to.u8(from::WRITE_FLIGHT);
            scene.encode(&mut to);
            // A cause without data has a number.
            to.raw(&postcard::to_allocvec(cause).unwrap_or_default());
        }
    }
    send(&to.into_bytes())
}

/// The frames of an output, each with the payloads that its transmissions share.
fn encode_output(id: WorkerId, output: &WorkerOutput, send: &mut dyn FnMut(&[u8]) -> bool) -> bool {
    let mut transmits = output.transmits.iter().peekable();
    loop {
        let mut to = Writer::new();
        to.u8(from::OUTPUT);
        to.varint(u64::from(id.0));
        to.varint(output.inputs);
        to.u8(u8::from(output.has_scene));
        to.u8(u8::from(output.is_ready));
        let mut shared = SharedPayloads::default();
        while to.len() < SPLIT_BYTES
            && let Some(transmit) = transmits.next()
        {
            encode_transmit(transmit, &mut shared, &mut to);
        }
        to.u8(transmit::END);
        let is_last = transmits.peek().is_none();
        let handled = if is_last { &output.handled[..] } else { &[] };
        to.varint(handled.len() as u64);
        for (peer, bytes) in handled {
            to.varint(peer.0);
            to.varint(*bytes as u64);
        }
        if !send(&to.into_bytes()) {
            return false;
        }
        if is_last {
            return true;
        }
    }
}

/// Numbers of the payloads of a frame, by their places in memory.
#[derive(Default)]
struct SharedPayloads(BTreeMap<(usize, usize), u64>);

impl SharedPayloads {
    /// Writes a payload, or the number of an earlier one in the same place.
    fn encode(&mut self, payload: &Bytes, to: &mut Writer) {
        let next = self.0.len() as u64;
        let place = (payload.as_ptr() as usize, payload.len());
        let number = *self.0.entry(place).or_insert(next);
        to.varint(number);
        if number == next {
            to.sized(payload);
        }
    }
}

fn encode_transmit(transmit: &Transmit, shared: &mut SharedPayloads, to: &mut Writer) {
    match transmit {
        Transmit::Control { to: peer, bytes } => {
            to.u8(transmit::CONTROL);
            to.varint(peer.0);
            shared.encode(bytes, to);
        }
        Transmit::State { to: peer, bytes } => {
            to.u8(transmit::STATE);
            to.varint(peer.0);
            shared.encode(bytes, to);
        }
        Transmit::Close { to: peer, code } => {
            to.u8(transmit::CLOSE);
            to.varint(peer.0);
            to.varint(u64::from(*code));
        }
    }
}

/// A message of a process from its frame.
pub(super) fn decode_from(frame: &Bytes) -> Result<FromProcess, Malformed> {
    let mut reader = Reader::new(frame);
    let from = &mut reader;
    let message = match from.u8()? {
        from::OUTPUT => decode_output(frame, from)?,
        from::OVER => FromProcess::Worker(WorkerId(from.varint32()?), FromWorker::Over),
        from::ALIVE => {
            let (scenes, load) = (from.varint()?, from.varint()?);
            let busiest = match flag(from)? {
                false => None,
                true => Some((WorkerId(from.varint32()?), Span::from_nanos(from.varint()?))),
            };
            FromProcess::Alive(Vitals {
                busiest,
                scenes,
                load,
            })
        }
        from::FIGURES => {
            let mut scenes = Vec::new();
            for _ in 0..from.varint()? {
                let name = SceneName::decode(from)?;
                let mut values = [0; SCENE_VALUES];
                for value in &mut values {
                    *value = from.varint()?;
                }
                scenes.push((name, SceneValues(values)));
            }
            FromProcess::Metrics(scenes)
        }
        from::FLIGHT => FromProcess::Flight(SceneName::decode(from)?, payload(frame, from)?),
        from::WRITE_FLIGHT => {
            let scene = SceneName::decode(from)?;
            let cause = from.raw(from.rest().len())?;
            let cause = postcard::from_bytes(cause).map_err(|_| Malformed::UnknownCode)?;
            FromProcess::WriteFlight(scene, cause)
        }
        _ => return Err(Malformed::UnknownCode),
    };
    reader.finish()?;
    Ok(message)
}

fn decode_output(frame: &Bytes, from: &mut Reader<'_>) -> Result<FromProcess, Malformed> {
    let id = WorkerId(from.varint32()?);
    let (inputs, has_scene, is_ready) = (from.varint()?, flag(from)?, flag(from)?);
    let (mut transmits, mut payloads) = (Vec::new(), Vec::new());
    loop {
        let kind = from.u8()?;
        if kind == transmit::END {
            break;
        }
        let to = peer(from)?;
        if kind == transmit::CLOSE {
            let code = from.varint32()?;
            transmits.push(Transmit::Close { to, code });
            continue;
        }
        let number = size(from)?;
        if number == payloads.len() {
            payloads.push(payload(frame, from)?);
        }
        let bytes: Bytes = payloads.get(number).ok_or(Malformed::OutOfRange)?.clone();
        transmits.push(match kind {
            transmit::CONTROL => Transmit::Control { to, bytes },
            transmit::STATE => Transmit::State { to, bytes },
            _ => return Err(Malformed::UnknownCode),
        });
    }
    let mut handled = Vec::new();
    for _ in 0..from.varint()? {
        handled.push((peer(from)?, size(from)?));
    }
    let output = WorkerOutput {
        transmits,
        handled,
        inputs,
        has_scene,
        is_ready,
    };
    Ok(FromProcess::Worker(id, FromWorker::Output(output)))
}

fn peer(from: &mut Reader<'_>) -> Result<Peer, Malformed> {
    from.varint().map(Peer)
}

fn size(from: &mut Reader<'_>) -> Result<usize, Malformed> {
    usize::try_from(from.varint()?).map_err(|_| Malformed::OutOfRange)
}

fn flag(from: &mut Reader<'_>) -> Result<bool, Malformed> {
    match from.u8()? {
        0 => Ok(false),
        1 => Ok(true),
        _ => Err(Malformed::UnknownCode),
    }
}

/// The next bytes with their length, as a part of the frame.
fn payload(frame: &Bytes, from: &mut Reader<'_>) -> Result<Bytes, Malformed> {
    let bytes = from.sized(frame.len())?;
    Ok(frame.slice_ref(bytes))
}

/// The start of worker processes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ProcessOptions {
    /// True if all scenes without a tenant share a process.
    pub(crate) share: bool,
    pub(crate) log: LevelFilter,
    /// Threads that step and publish, in each process.
    pub(crate) threads: NonZeroU32,
    /// Directory in which each process records its scenes.
    pub(crate) record: Option<PathBuf>,
}

/// The settings of a worker process.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct WorkerSetup {
    /// The process id of the dispatcher.
    pub(super) dispatcher: u32,
    /// The dispatcher's clock at the start of the process, nanoseconds.
    pub(super) now_ns: u64,
    pub(super) limits: Limits,
    /// Bytes of the largest packet of a stream.
    pub(super) largest_packet: u32,
    /// The edges of the grid that divides scenes.
    pub(super) cells: Option<[f32; 3]>,
    pub(super) engine: EngineKind,
    /// Threads that step and publish.
    pub(super) threads: NonZeroU32,
    /// The data directory, whose lock the process has inherited.
    pub(super) data: Option<PathBuf>,
    /// The log level, as text.
    pub(super) log: String,
    /// True if the dispatcher keeps flight recorders.
    pub(super) records_flights: bool,
    /// The directory for recordings of its scenes.
    pub(super) record: Option<PathBuf>,
}
