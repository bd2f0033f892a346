//! Clients that break one promise each.

use std::collections::{BTreeSet, VecDeque};

use rhumb_protocol::message::{ClientMessage, Framed, Frames, ServerMessage, frame};
use rhumb_protocol::packet::{
    Age, FullPacket, Head, LossReport, Low16, PacketKind, RefreshWriter, UpdatePayload,
};
use rhumb_protocol::session::ClientSession;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_reckoning::Tick;

use super::packets::{updates_of, without_rests, written};
use crate::peer::datagram;
use crate::testee::Behaviour;

/// The promise that is broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ClientMutant {
    /// Accepts any version in `Welcome`.
    AnyVersion,
    /// Ignores an unknown critical message.
    CriticalPasses,
    /// Ends the connection at an unknown optional message.
    OptionalRefused,
    /// Closes with the code that follows the correct one.
    WrongCode,
    /// Never reports lost packets.
    NeverReportsLoss,
    /// Reports the packet after the lost one.
    OffByOne,
    /// Ignores refreshes.
    RefreshIgnored,
    /// Treats an old packet of a full stream as one of the newest tick.
    StaleTaken,
    /// Applies a correction regardless of its revision.
    RevisionIgnored,
    /// Ignores rest updates.
    RestLost,
    /// Computes repair symbols wrongly.
    RepairSymbolWrong,
    /// Processes datagrams regardless of their scene event count.
    SceneEventsIgnored,
    /// Treats NaN as zero.
    NanTaken,
    /// Never resynchronises, however far a stream jumps.
    NeverResyncs,
    /// Predicts with one wrong bit.
    LastBitWrong,
    /// Reports a tick as complete although data is missing.
    CompleteTooEarly,
    /// Never reports the switch to another stream.
    NeverSubscribed,
    /// Sends `Join` together with its hello, before the welcome.
    SendsBeforeWelcome,
    /// Treats everything that waits for a packet as received as soon as one late packet comes.
    LateIsAll,
    /// Requests one packet of all that are lost.
    AsksForOne,
    /// Publishes its bodies, but sends only every fourth packet.
    UpstreamBeyondTolerance,
    /// Sends a watermark for the first silence of its upstream, and none later.
    WatermarkOnce,
    /// Ignores that the server has withdrawn its authority.
    NeverRetakesAuthority,
    /// Ignores the removal of joints, also of those that it does not know.
    JointRemovalIgnored,
    /// Ignores the removal of shapes, also of those of an earlier copy.
    ShapeRemovalIgnored,
}

impl ClientMutant {
    /// The behaviour that breaks the promise.
    #[must_use]
    pub fn behaviour(self) -> Box<dyn Behaviour> {
        Box::new(MutantBehaviour {
            mutant: self,
            frames: Frames::new(),
            sent: Frames::new(),
            recent: VecDeque::new(),
            received: BTreeSet::new(),
            begun: false,
            packets: 0,
        })
    }
}

struct MutantBehaviour {
    mutant: ClientMutant,
    frames: Frames,
    sent: Frames,
    recent: VecDeque<Vec<u8>>,
    /// Low bits of the received packet numbers.
    received: BTreeSet<u16>,
    begun: bool,
    packets: u64,
}

impl MutantBehaviour {
    /// A received message as the mutant takes it; `None` to ignore it.
    fn take(&self, kind: u8, body: Vec<u8>) -> Option<(u8, Vec<u8>)> {
        let known = 1..=16;
        match self.mutant {
            ClientMutant::AnyVersion if kind == 1 => {
                let mut body = body;
                body[..2].copy_from_slice(&1_u16.to_le_bytes());
                Some((kind, body))
            }
            ClientMutant::CriticalPasses if kind < 0x80 && !known.contains(&kind) && kind != 0 => {
                None
            }
            // The code of a scene event follows the type.
            ClientMutant::JointRemovalIgnored if kind == 11 && body.first() == Some(&7) => None,
            ClientMutant::ShapeRemovalIgnored if kind == 11 && body.first() == Some(&1) => None,
            ClientMutant::OptionalRefused if kind >= 0x80 => Some((0x7f, body)),
            ClientMutant::NeverRetakesAuthority => {
                let framed = Framed { kind, body };
                let message = ServerMessage::decode(&framed).ok().flatten();
                let lost = matches!(message, Some(ServerMessage::AuthorityDenied(_)));
                (!lost).then_some((framed.kind, framed.body))
            }
            _ => Some((kind, body)),
        }
    }

    /// The received datagram, and refreshes without updates for all packets that are still missing.
    fn with_all_known(&mut self, session: &ClientSession, bytes: &[u8]) -> Vec<Vec<u8>> {
        let mut received = vec![bytes.to_vec()];
        let (Some((head, packet, _)), Some(copy)) = (updates_of(bytes), session.replica()) else {
            return received;
        };
        let (tick, scene_events) = (
            copy.stream().watermark_tick().value(),
            packet.scene_events.0,
        );
        for number in self.received.range(packet.number.0..) {
            let refresh = RefreshWriter::default();
            let number = u64::from(*number);
            received.extend(refresh.finish(head.stream, number, tick, scene_events.into()));
        }
        self.received.insert(packet.number.0);
        received
    }

    /// The sent bytes without part of the upstream: three of four packets, or all watermarks but the first.
    fn thin_out_upstream(&mut self, bytes: &[u8]) -> Vec<u8> {
        self.sent.push(bytes);
        let mut sent = Vec::new();
        while let Ok(Some(framed)) = self.sent.next_frame() {
            let message = ClientMessage::decode(&framed).ok().flatten();
            if let Some(ClientMessage::Upstream(packet)) = message {
                let counts = self.mutant == ClientMutant::UpstreamBeyondTolerance
                    || datagram::kind(&packet) == Some(PacketKind::Watermark);
                self.packets += u64::from(counts);
                let passes = match self.mutant {
                    ClientMutant::UpstreamBeyondTolerance => self.packets % 4 == 1,
                    _ => !counts || self.packets == 1,
                };
                if !passes {
                    continue;
                }
            }
            frame(framed.kind, &framed.body, &mut sent);
        }
        sent
    }
}

impl Behaviour for MutantBehaviour {
    fn receive_control(&mut self, bytes: &[u8]) -> Vec<u8> {
        let touches = matches!(
            self.mutant,
            ClientMutant::AnyVersion
                | ClientMutant::CriticalPasses
                | ClientMutant::OptionalRefused
                | ClientMutant::NeverRetakesAuthority
                | ClientMutant::JointRemovalIgnored
                | ClientMutant::ShapeRemovalIgnored
        );
        if !touches {
            return bytes.to_vec();
        }
        self.frames.push(bytes);
        let mut received = Vec::new();
        while let Ok(Some(framed)) = self.frames.next_frame() {
            if let Some((kind, body)) = self.take(framed.kind, framed.body) {
                frame(kind, &body, &mut received);
            }
        }
        received
    }

    fn receive_datagram(&mut self, session: &ClientSession, bytes: &[u8]) -> Vec<Vec<u8>> {
        let kind = datagram::kind(bytes);
        let is_full = matches!(kind, Some(PacketKind::Full | PacketKind::FullEnd));
        match self.mutant {
            ClientMutant::RefreshIgnored if kind == Some(PacketKind::Refresh) => Vec::new(),
            ClientMutant::LateIsAll => self.with_all_known(session, bytes),
            ClientMutant::StaleTaken => {
                let mut received = vec![bytes.to_vec()];
                if is_full {
                    self.recent.push_back(bytes.to_vec());
                    if self.recent.len() > 3 {
                        received
                            .extend(self.recent.pop_front().and_then(|old| renewed(&old, bytes)));
                    }
                }
                received
            }
            ClientMutant::RevisionIgnored => {
                vec![rebuilt_on(session, bytes).unwrap_or_else(|| bytes.to_vec())]
            }
            ClientMutant::RestLost => vec![without_rests(bytes).unwrap_or_else(|| bytes.to_vec())],
            ClientMutant::RepairSymbolWrong if kind == Some(PacketKind::RepairSymbol) => {
                let mut wrong = bytes.to_vec();
                if let Some(last) = wrong.last_mut() {
                    *last ^= 0x11;
                }
                vec![wrong]
            }
            ClientMutant::SceneEventsIgnored => vec![with_fewer_scene_events(bytes)],
            ClientMutant::NanTaken if is_full => vec![without_nans(bytes)],
            _ => vec![bytes.to_vec()],
        }
    }

    fn filter_datagram(&mut self, bytes: &[u8]) -> Option<Vec<u8>> {
        let mut reader = Reader::new(bytes);
        let kind = Head::decode(&mut reader)
            .ok()
            .map(|head| (head.kind, head.stream));
        match (self.mutant, kind) {
            (ClientMutant::NeverReportsLoss, Some((PacketKind::LossReport, _))) => None,
            (ClientMutant::OffByOne, Some((PacketKind::LossReport, stream))) => {
                let mut loss_report = LossReport::decode(reader).ok()?;
                loss_report
                    .lost
                    .iter_mut()
                    .for_each(|lost| lost.0 = lost.0.wrapping_add(1));
                Some(loss_report.encode(stream))
            }
            (ClientMutant::AsksForOne, Some((PacketKind::LossReport, stream))) => {
                let mut loss_report = LossReport::decode(reader).ok()?;
                loss_report.lost.truncate(1);
                Some(loss_report.encode(stream))
            }
            _ => Some(bytes.to_vec()),
        }
    }

    fn filter_control(&mut self, bytes: &[u8]) -> Vec<u8> {
        if matches!(
            self.mutant,
            ClientMutant::UpstreamBeyondTolerance | ClientMutant::WatermarkOnce
        ) {
            return self.thin_out_upstream(bytes);
        }
        let left_out = match self.mutant {
            ClientMutant::NeverResyncs => 9,
            ClientMutant::NeverSubscribed => 13,
            ClientMutant::SendsBeforeWelcome if !std::mem::replace(&mut self.begun, true) => {
                // The join goes into the same write.
                let mut sent = bytes.to_vec();
                frame(3, &[0, 0xd0, 0x86, 3], &mut sent);
                return sent;
            }
            _ => return bytes.to_vec(),
        };
        self.sent.push(bytes);
        let mut sent = Vec::new();
        while let Ok(Some(framed)) = self.sent.next_frame() {
            if framed.kind != left_out {
                frame(framed.kind, &framed.body, &mut sent);
            }
        }
        sent
    }

    fn close(&mut self, code: u32) -> Option<u32> {
        Some(match self.mutant {
            ClientMutant::WrongCode => code + 1,
            _ => code,
        })
    }

    fn write_line(&mut self, line: String) -> String {
        if self.mutant != ClientMutant::LastBitWrong {
            return line;
        }
        let wrong = line
            .char_indices()
            .rev()
            .find(|(_, c)| c.is_ascii_hexdigit());
        let Some((at, digit)) =
            wrong.filter(|_| line.contains("\":\"") && line.contains("\"moving\":{\""))
        else {
            return line;
        };
        let other = if digit == '0' { "1" } else { "0" };
        let mut line = line;
        line.replace_range(at..=at, other);
        line
    }

    fn reports_unconverged(&self) -> bool {
        self.mutant == ClientMutant::CompleteTooEarly
    }
}

/// The records of an old full packet under the head of a later one, with the next number.
fn renewed(old: &[u8], new: &[u8]) -> Option<Vec<u8>> {
    let read = |bytes| {
        let mut reader = Reader::new(bytes);
        let head = Head::decode(&mut reader).ok()?;
        Some((head, FullPacket::decode(true, reader).ok()?))
    };
    let ((_, old), (head, new)) = (read(old)?, read(new)?);
    // Its own number was received already. The next number is new; the real packet with it is dropped as a duplicate.
    let packet = FullPacket {
        number: Low16(new.number.0.wrapping_add(1)),
        tick: Low16(new.tick.0.wrapping_add(1)),
        ..old
    };
    Some(packet.encode(head.stream))
}

/// The same packet, with the revision of each correction replaced by that of the present track.
fn rebuilt_on(session: &ClientSession, bytes: &[u8]) -> Option<Vec<u8>> {
    let copy = session.replica()?.stream();
    let publish_interval = session.config()?.publish_schedule.publish_interval;
    let (head, packet, mut updates) = updates_of(bytes)?;
    let tick = Tick::new(packet.tick.expand(copy.watermark_tick().value()));
    let aliased: Vec<_> = updates.iter().filter_map(|update| update.body).collect();
    for update in &mut updates {
        // An update that names its body is known; otherwise only the session resolves the alias.
        let index = update
            .body
            .or_else(|| (!aliased.contains(&update.alias)).then_some(update.alias))?;
        let origin = copy
            .body(index)
            .and_then(|id| copy.track(id))
            .map(|track| track.origin);
        if let (
            UpdatePayload::Residual { age, .. } | UpdatePayload::Resting { age, .. },
            Some(origin),
        ) = (&mut update.payload, origin)
            && tick > origin
        {
            *age = Age::of(origin, tick, publish_interval)?;
        }
    }
    written(head, &packet, &updates)
}

/// The same datagram with the scene event count reduced by 200, at least zero: a count reached long ago.
fn with_fewer_scene_events(bytes: &[u8]) -> Vec<u8> {
    let mut reader = Reader::new(bytes);
    let mut bytes = bytes.to_vec();
    let Ok(head) = Head::decode(&mut reader) else {
        return bytes;
    };
    let mut start = Writer::new();
    head.encode(&mut start);
    let at = start.into_bytes().len() + 4;
    if matches!(
        head.kind,
        PacketKind::Updates | PacketKind::UpdatesEnd | PacketKind::Watermark | PacketKind::Refresh
    ) && bytes.len() >= at + 2
    {
        let fewer = u16::from_le_bytes([bytes[at], bytes[at + 1]]).saturating_sub(200);
        bytes[at..at + 2].copy_from_slice(&fewer.to_le_bytes());
    }
    bytes
}

/// The same full packet with NaN replaced by zero.
fn without_nans(bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let records = bytes.len() / 56 * 56;
    let start = bytes.len() - records;
    for number in bytes[start..].chunks_exact_mut(4) {
        let value = f32::from_le_bytes([number[0], number[1], number[2], number[3]]);
        if !value.is_finite() {
            number.copy_from_slice(&[0; 4]);
        }
    }
    bytes
}
