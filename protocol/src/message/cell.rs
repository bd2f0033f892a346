//! Messages about one cell of a scene: requests of a member, and news.
//!
//! A cell is sent as a scene is, with a stream, a snapshot and a count of scene events of its own. Its stream names bodies
//! by ids of the cell, so that tables of a cell are as long as it has bodies; `Placed` tells which body of the scene one is.

use glam::Vec3;
use rhumb_reckoning::{BodyId, Tick};

use super::request::{Denial, ResyncCause, StreamChoice};
use super::scene_event::{BODY_PLACED, SceneEvent};
use crate::packet::{LargestPacket, StreamId};
use crate::scene::SceneConfig;
use crate::stream::StreamStart;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A member's request about one cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellRequest {
    /// Takes the cell, or another stream of it; answered by `Joined` and a snapshot, or by `Denied`.
    Subscribe(StreamChoice),
    /// Confirms that the client has caught up with its new stream of the cell.
    Subscribed(StreamId),
    /// Requests a new snapshot.
    Resync(ResyncCause),
    /// Gives the cell up.
    Leave,
}

impl Wire for CellRequest {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Subscribe(choice) => {
                to.u8(0);
                choice.encode(to);
            }
            Self::Subscribed(stream) => {
                to.u8(1);
                stream.encode(to);
            }
            Self::Resync(cause) => {
                to.u8(2);
                cause.encode(to);
            }
            Self::Leave => to.u8(3),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Subscribe(StreamChoice::decode(from)?)),
            1 => Ok(Self::Subscribed(StreamId::decode(from)?)),
            2 => Ok(Self::Resync(ResyncCause::decode(from)?)),
            3 => Ok(Self::Leave),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

/// News of one cell that a member takes. Ids of bodies are the cell's.
#[derive(Clone, Debug, PartialEq)]
pub enum CellNews {
    /// The stream begins; the cell's bodies follow, up to `SnapshotEnd`.
    Joined(CellStart),
    /// The snapshot is complete.
    SnapshotEnd,
    /// The request for the cell is denied.
    Denied(Denial),
    /// A body is new in the cell, or changed. A scene event of the cell.
    Placed {
        /// Its id in the scene.
        id: BodyId,
        /// A [`SceneEvent::BodyPlaced`].
        placed: SceneEvent,
    },
    /// A body has crossed from another cell, and is here from the origin of its track on. A scene event of the cell.
    Arrived {
        /// Its id in the scene.
        id: BodyId,
        /// A [`SceneEvent::BodyPlaced`].
        placed: SceneEvent,
    },
    /// A body has crossed into another cell. A scene event of the cell.
    Departed {
        /// The body.
        id: BodyId,
        /// The first tick without it.
        tick: Tick,
    },
    /// Another scene event of the cell.
    SceneEvent(SceneEvent),
}

/// The start of a cell's stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellStart {
    /// The stream.
    pub choice: StreamChoice,
    /// Its id.
    pub stream: StreamId,
    /// The largest packet that its publisher makes.
    pub largest_packet: LargestPacket,
    /// The present gravity, m/s², world frame.
    pub gravity: Vec3,
    /// The tick of the snapshot.
    pub tick: Tick,
    /// Number of the first packet after the snapshot.
    pub next: u64,
    /// Scene events of the cell that the snapshot includes.
    pub scene_events: u64,
}

impl CellStart {
    /// The start of the stream in a scene of this config.
    #[must_use]
    pub fn start(&self, config: &SceneConfig) -> StreamStart {
        StreamStart {
            stream: self.stream,
            largest_packet: self.largest_packet,
            tolerance: self.choice.tolerance(),
            integrator: config.integrator,
            publish_interval: config.publish_schedule.publish_interval,
            gravity: self.gravity,
            tick: self.tick,
            next: self.next,
            scene_events: self.scene_events,
        }
    }
}

impl Wire for CellStart {
    fn encode(&self, to: &mut Writer) {
        self.choice.encode(to);
        self.stream.encode(to);
        self.largest_packet.encode(to);
        to.f32s(&self.gravity.to_array());
        to.varint(self.tick.value());
        to.varint(self.next);
        to.varint(self.scene_events);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let choice = StreamChoice::decode(from)?;
        let stream = StreamId::decode(from)?;
        let largest_packet = LargestPacket::decode(from)?;
        let gravity = Vec3::from_array(from.f32s()?);
        if !gravity.is_finite() {
            return Err(Malformed::NotFinite);
        }
        Ok(Self {
            choice,
            stream,
            largest_packet,
            gravity,
            tick: Tick::new(from.count()?),
            next: from.count()?,
            scene_events: from.count()?,
        })
    }
}

impl Wire for CellNews {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Joined(start) => {
                to.u8(0);
                start.encode(to);
            }
            Self::SnapshotEnd => to.u8(1),
            Self::Denied(denial) => {
                to.u8(2);
                denial.encode(to);
            }
            Self::Placed { id, placed } => {
                to.u8(3);
                id.encode(to);
                placed.encode(to);
            }
            Self::Arrived { id, placed } => {
                to.u8(4);
                id.encode(to);
                placed.encode(to);
            }
            Self::Departed { id, tick } => {
                to.u8(5);
                id.encode(to);
                to.varint(tick.value());
            }
            Self::SceneEvent(scene_event) => {
                to.u8(6);
                scene_event.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        match from.u8()? {
            0 => Ok(Self::Joined(CellStart::decode(from)?)),
            1 => Ok(Self::SnapshotEnd),
            2 => Ok(Self::Denied(Denial::decode(from)?)),
            3 => Ok(Self::Placed {
                id: BodyId::decode(from)?,
                placed: decode_placed(from)?,
            }),
            4 => Ok(Self::Arrived {
                id: BodyId::decode(from)?,
                placed: decode_placed(from)?,
            }),
            5 => Ok(Self::Departed {
                id: BodyId::decode(from)?,
                tick: Tick::new(from.count()?),
            }),
            6 if !is_placed(from)? => Ok(Self::SceneEvent(SceneEvent::decode(from)?)),
            _ => Err(Malformed::UnknownCode),
        }
    }
}

/// Decodes the scene event of a body that is placed.
fn decode_placed(from: &mut Reader<'_>) -> Result<SceneEvent, Malformed> {
    match is_placed(from)? {
        true => SceneEvent::decode(from),
        false => Err(Malformed::UnknownCode),
    }
}

/// True if the next scene event is that of a body that is placed.
fn is_placed(from: &Reader<'_>) -> Result<bool, Malformed> {
    Ok(from.clone().u8()? == BODY_PLACED)
}

#[cfg(test)]
mod tests {
    use rhumb_reckoning::Tolerance;

    use super::*;
    use crate::message::RemovalCause;
    use crate::message::tests::round_trips;

    #[test]
    fn requests_round_trip() {
        let normal = StreamChoice::Within(Tolerance::NORMAL);
        round_trips(&CellRequest::Subscribe(normal), &[0, 0, 0xd0, 0x86, 3]);
        round_trips(&CellRequest::Subscribed(StreamId(300)), &[1, 0xac, 2]);
        round_trips(&CellRequest::Resync(ResyncCause::LostSync), &[2, 0]);
        round_trips(&CellRequest::Leave, &[3]);
        let unknown = CellRequest::decode(&mut Reader::new(&[4]));
        assert_eq!(unknown, Err(Malformed::UnknownCode));
    }

    #[test]
    fn news_round_trip() {
        let start = CellStart {
            choice: StreamChoice::Full,
            stream: StreamId(7),
            largest_packet: LargestPacket::DEFAULT,
            gravity: Vec3::ZERO,
            tick: Tick::new(300),
            next: 5,
            scene_events: 9,
        };
        let bytes = [
            0, 1, 7, 0xcc, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xac, 2, 5, 9,
        ];
        round_trips(&CellNews::Joined(start), &bytes);
        round_trips(&CellNews::SnapshotEnd, &[1]);
        round_trips(&CellNews::Denied(Denial::TooManyStreams), &[2, 6]);
        let departed = CellNews::Departed {
            id: BodyId::new(3, 2),
            tick: Tick::new(300),
        };
        round_trips(&departed, &[5, 3, 2, 0xac, 2]);
        let removed = SceneEvent::BodyRemoved {
            id: BodyId::new(3, 2),
            cause: RemovalCause::Command,
        };
        round_trips(&CellNews::SceneEvent(removed), &[6, 3, 3, 2, 0]);
        // Only a body is placed.
        for code in [3, 4] {
            let other = CellNews::decode(&mut Reader::new(&[code, 3, 2, 3, 3, 2, 0]));
            assert_eq!(other, Err(Malformed::UnknownCode));
        }
    }
}
