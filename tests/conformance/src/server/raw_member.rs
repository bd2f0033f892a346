//! A raw member of a scene of balls that decodes the datagrams of its stream.
//!
//! It keeps no copy; it knows only where its stream begins.

use glam::Vec3;
use rhumb_protocol::message::{ClientMessage, Joined, StreamChoice};
use rhumb_protocol::packet::{Head, LossReport, Low16, PacketKind, Watermark};
use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Tick;

use super::scenery::{ball, ball_shape, body, lockstep};
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{RawClient, datagram};
use crate::trial::Trial;

/// A raw member, and its knowledge of its stream.
pub(super) struct RawMember {
    pub(super) client: RawClient,
    pub(super) joined: Joined,
    /// Number of scene events outside of snapshots.
    pub(super) scene_events: u64,
    /// Number of its balls, which have the first ids of its range.
    pub(super) balls: u32,
}

impl RawMember {
    /// A scene with this number of balls that fall side by side.
    pub(super) fn begin(
        trial: &mut Trial<'_>,
        choice: StreamChoice,
        balls: u32,
    ) -> Result<Self, Stop> {
        let mut client = trial.client()?;
        let joined = client.enter(lockstep(), choice)?;
        client.must(ball_shape())?;
        for place in 0..balls {
            let at = Vec3::new((3 * place) as f32, 100.0, 0.0);
            let id = body(client.granted, place)?;
            client.must(ball(id, at, Vec3::new(0.0, place as f32 / 7.0, 1.0)))?;
        }
        let scene_events = joined.start.scene_events + u64::from(balls) + 1;
        Ok(Self {
            client,
            joined,
            scene_events,
            balls,
        })
    }

    pub(super) fn loss_report(
        &mut self,
        next: u64,
        repair_symbols: u8,
        lost: &[u64],
    ) -> CaseResult {
        let loss_report = LossReport {
            next: Low16::of(next),
            abandoned: Low16::of(lost.len() as u64),
            repair_symbols,
            lost: lost.iter().map(|number| Low16::of(*number)).collect(),
        };
        self.client
            .send_datagram(&loss_report.encode(self.joined.start.stream))
    }

    /// The next datagram: its kind and its bytes.
    pub(super) fn next(&mut self) -> Result<(PacketKind, Vec<u8>), Stop> {
        let datagram = self.client.next_datagram()?;
        let datagram = datagram.ok_or_else(|| Stop::Fail("no datagram arrives".into()))?;
        let head = Head::decode(&mut Reader::new(&datagram));
        let head = head.map_err(|why| Stop::Fail(format!("a datagram is malformed: {why:?}")))?;
        ensure(
            head.stream == self.joined.start.stream,
            "it belongs to the member's stream",
        )?;
        Ok((head.kind, datagram.to_vec()))
    }

    pub(super) fn watermark(&mut self) -> Result<Watermark, Stop> {
        loop {
            let (kind, bytes) = self.next()?;
            if kind == PacketKind::Watermark {
                return datagram::body(&bytes, Watermark::decode);
            }
        }
    }

    /// Pushes each ball differently, so that each needs an update of its own.
    pub(super) fn push_balls(&mut self) -> CaseResult {
        for place in 0..self.balls {
            let direction = Vec3::new(place as f32 / 7.0 - 1.0, 1.0, 1.0);
            let impulse = direction
                * if self.client.commands.is_multiple_of(2) {
                    300.0
                } else {
                    -200.0
                };
            let id = body(self.client.granted, place)?;
            self.client
                .send(&ClientMessage::Command(Command::Impulse { id, impulse }));
        }
        Ok(())
    }

    /// Steps to a tick and returns all datagrams up to its end, each with its kind.
    pub(super) fn step(&mut self, to: u64) -> Result<Vec<(PacketKind, Vec<u8>)>, Stop> {
        self.client
            .send(&ClientMessage::Advance { to: Tick::new(to) });
        let mut all = Vec::new();
        loop {
            let (kind, bytes) = self.next()?;
            let ended = datagram::completed_tick(kind, &bytes)?;
            all.push((kind, bytes));
            if ended == Some(Low16::of(to)) {
                return Ok(all);
            }
        }
    }

    /// Numbers of the state packets up to a tick.
    pub(super) fn numbers_to(&mut self, tick: u64) -> Result<Vec<u64>, Stop> {
        let packets = self.packets_to(tick)?;
        Ok(packets.into_iter().map(|(number, _)| number).collect())
    }

    /// State packets up to a tick, with their numbers.
    pub(super) fn packets_to(&mut self, tick: u64) -> Result<Vec<(u64, Vec<u8>)>, Stop> {
        let mut expected = self.joined.start.next;
        let mut packets = Vec::new();
        for to in 1..=tick {
            self.push_balls()?;
            for (kind, bytes) in self.step(to)? {
                if let Some(packet) = datagram::state_packet(kind, &bytes)? {
                    expected = packet.number.expand(expected);
                    packets.push((expected, bytes));
                }
            }
        }
        Ok(packets)
    }
}
