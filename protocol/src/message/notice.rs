//! What every member of a scene must know: who came, who left, what pulls.
//!
//! A notice is encoded once for all members and counted by both ends; each state packet says how many it builds on.

use glam::Vec3;
use rhumb_reckoning::{Anchor, BodyId, Predictor, Tick, Track, Verbatim};

use crate::packet::TrackSaying;
use crate::scene::{BodyTerms, Shape, ShapeId};
use crate::wire::bits::{BitReader, BitWriter};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Why a body is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum RemovalCause {
    /// A member removed it.
    Command,
    /// It left the world's bounds.
    LeftWorld,
    /// Its state was no longer finite.
    NotFinite,
}

/// One change of a scene that all members hear of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Notice {
    /// A shape became known.
    ShapeAdded {
        /// Its number.
        id: ShapeId,
        /// What it is.
        shape: Shape,
    },
    /// A shape was forgotten.
    ShapeRemoved {
        /// Its number.
        id: ShapeId,
    },
    /// A body is in the scene.
    BodyPlaced {
        /// What it is.
        terms: BodyTerms,
        /// How it moves.
        track: Track,
    },
    /// A body is no longer in the scene.
    BodyRemoved {
        /// Which.
        id: BodyId,
        /// Why.
        cause: RemovalCause,
    },
    /// Another gravity pulls.
    GravityChanged {
        /// From this tick on.
        since: Tick,
        /// m/s², world frame.
        gravity: Vec3,
    },
    /// The engine failed; the scene stands still for good.
    SceneFaulted {
        /// The last tick that was whole.
        tick: Tick,
    },
}

impl Wire for Notice {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::ShapeAdded { id, shape } => {
                to.u8(0);
                id.encode(to);
                shape.encode(to);
            }
            Self::ShapeRemoved { id } => {
                to.u8(1);
                id.encode(to);
            }
            Self::BodyPlaced { terms, track } => {
                to.u8(2);
                terms.encode(to);
                track.encode(to);
            }
            Self::BodyRemoved { id, cause } => {
                to.u8(3);
                id.encode(to);
                to.u8(match cause {
                    RemovalCause::Command => 0,
                    RemovalCause::LeftWorld => 1,
                    RemovalCause::NotFinite => 2,
                });
            }
            Self::GravityChanged { since, gravity } => {
                to.u8(4);
                to.varint(since.value());
                to.f32s(&gravity.to_array());
            }
            Self::SceneFaulted { tick } => {
                to.u8(5);
                to.varint(tick.value());
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok(match from.u8()? {
            0 => {
                let id = ShapeId::decode(from)?;
                let shape = Shape::decode(from)?;
                shape.check().map_err(|_| Malformed::OutOfRange)?;
                Self::ShapeAdded { id, shape }
            }
            1 => Self::ShapeRemoved {
                id: ShapeId::decode(from)?,
            },
            2 => {
                let terms = BodyTerms::decode(from)?;
                terms.check().map_err(|_| Malformed::OutOfRange)?;
                let track = Track::decode(from)?;
                Self::BodyPlaced { terms, track }
            }
            3 => Self::BodyRemoved {
                id: BodyId::decode(from)?,
                cause: match from.u8()? {
                    0 => RemovalCause::Command,
                    1 => RemovalCause::LeftWorld,
                    2 => RemovalCause::NotFinite,
                    _ => return Err(Malformed::UnknownCode),
                },
            },
            4 => {
                let since = Tick::new(from.count()?);
                let gravity = Vec3::from_array(from.f32s()?);
                if !gravity.is_finite() {
                    return Err(Malformed::NotFinite);
                }
                Self::GravityChanged { since, gravity }
            }
            5 => Self::SceneFaulted {
                tick: Tick::new(from.count()?),
            },
            _ => return Err(Malformed::UnknownCode),
        })
    }
}

/// The bit of a track's first byte that says that its motion is verbatim; the law is in the bits below it.
const VERBATIM: u8 = 1 << 2;

impl Wire for Track {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.origin.value());
        match &self.anchor {
            Anchor::Verbatim(verbatim) => {
                let law = match self.predictor {
                    Predictor::Rest => 0,
                    Predictor::Uniform => 1,
                    Predictor::Ballistic => 2,
                };
                to.u8(law | VERBATIM);
                verbatim.encode(to);
            }
            Anchor::Snapped(_) => {
                to.u8(0);
                let mut bits = BitWriter::default();
                TrackSaying::of(self).encode(&mut bits);
                to.sized(&bits.into_bytes());
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let origin = Tick::new(from.count()?);
        let first = from.u8()?;
        if first & VERBATIM == 0 {
            return decode_snapped(origin, first, from);
        }
        let predictor = match first & !VERBATIM {
            0 => Predictor::Rest,
            1 => Predictor::Uniform,
            2 => Predictor::Ballistic,
            _ => return Err(Malformed::UnknownCode),
        };
        let verbatim = Verbatim::decode(from)?;
        if predictor == Predictor::Rest && verbatim != verbatim.stilled() {
            return Err(Malformed::NotCanonical);
        }
        Ok(Self {
            origin,
            predictor,
            anchor: Anchor::Verbatim(verbatim),
        })
    }
}

fn decode_snapped(origin: Tick, first: u8, from: &mut Reader<'_>) -> Result<Track, Malformed> {
    if first != 0 {
        return Err(Malformed::UnknownCode);
    }
    let bytes = from.sized(crate::packet::Saying::MAX_BITS / 8 + 1)?;
    let mut bits = BitReader::new(bytes);
    let saying = TrackSaying::decode(&mut bits)?;
    bits.finish()?;
    if matches!(saying.anchor, Anchor::Verbatim(_)) {
        return Err(Malformed::NotCanonical);
    }
    Ok(saying.track(origin))
}
