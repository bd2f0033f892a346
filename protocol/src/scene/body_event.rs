//! The events of bodies in a tick: contacts, sensors, sleep, ground.
//!
//! Only bodies for which a command turned events on report any; faults and characters' ground are always reported.
//! Nothing here depends on an engine.

use glam::Vec3;
use rhumb_reckoning::BodyId;

use super::checks::{Invalid, Quantity, scalar};
use crate::limits::FORCE_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// The events that a body reports. Of two bodies in contact it suffices that one reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ActiveEvents {
    /// True if it reports that contacts begin and end.
    pub contacts: bool,
    /// Newtons from which on it reports the force of a contact, at each tick.
    pub force: Option<f32>,
    /// True if it reports bodies that enter and leave a sensor: it is the sensor, or one of those bodies.
    pub sensors: bool,
    /// True if it reports that it falls asleep and wakes.
    pub sleep: bool,
}

impl ActiveEvents {
    /// No events.
    pub const NONE: Self = Self {
        contacts: false,
        force: None,
        sensors: false,
        sleep: false,
    };

    /// True if any are on.
    #[must_use]
    pub const fn any(&self) -> bool {
        self.contacts || self.force.is_some() || self.sensors || self.sleep
    }

    /// Checks the threshold of forces.
    ///
    /// # Errors
    ///
    /// [`Invalid`] for a threshold that is not finite or outside the limits.
    pub fn check(&self) -> Result<(), Invalid> {
        self.force.map_or(Ok(()), |newtons| {
            scalar(newtons, 0.0, FORCE_MAX, Quantity::Force)
                .map_err(|wrong| wrong.of("force from which contacts are reported", "N"))
        })
    }
}

/// Something that happened to a body in a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BodyEvent {
    /// Two bodies began to touch.
    ContactBegan {
        /// The body with the lesser id.
        body: BodyId,
        /// Its deepest contact with the other body.
        contact: Contact,
    },
    /// Two bodies ceased to touch, or one of them was removed.
    ContactEnded {
        /// The body with the lesser id.
        body: BodyId,
        /// The other body.
        with: BodyId,
    },
    /// The force of a contact reached the threshold of one of its bodies.
    ContactForce {
        /// The body with the lesser id.
        body: BodyId,
        /// Its deepest contact with the other body, with the force between the two.
        contact: Contact,
    },
    /// A body entered a sensor.
    SensorEntered {
        /// The sensor.
        sensor: BodyId,
        /// The body.
        body: BodyId,
    },
    /// A body left a sensor, or one of the two was removed.
    SensorLeft {
        /// The sensor.
        sensor: BodyId,
        /// The body.
        body: BodyId,
    },
    /// A body fell asleep.
    FellAsleep(BodyId),
    /// A body woke.
    Woke(BodyId),
    /// The state of a body was not finite, and the body was removed. Reported whether or not its events are on.
    Fault(BodyId),
    /// A character reached ground that carries it. Reported whether or not its events are on, as the next one.
    ReachedGround(BodyId),
    /// A character left the ground: it fell, slid or jumped.
    LeftGround(BodyId),
}

/// Bits of active events.
mod flag {
    pub(super) const CONTACTS: u8 = 1;
    pub(super) const FORCE: u8 = 1 << 1;
    pub(super) const SENSORS: u8 = 1 << 2;
    pub(super) const SLEEP: u8 = 1 << 3;
}

impl Wire for ActiveEvents {
    fn encode(&self, to: &mut Writer) {
        let mut flags = 0;
        for (set, bit) in [
            (self.contacts, flag::CONTACTS),
            (self.force.is_some(), flag::FORCE),
            (self.sensors, flag::SENSORS),
            (self.sleep, flag::SLEEP),
        ] {
            if set {
                flags |= bit;
            }
        }
        to.u8(flags);
        if let Some(newtons) = self.force {
            to.f32(newtons);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags >= flag::SLEEP << 1 {
            return Err(Malformed::UnknownCode);
        }
        Ok(Self {
            contacts: flags & flag::CONTACTS != 0,
            force: match flags & flag::FORCE {
                0 => None,
                _ => Some(from.f32()?),
            },
            sensors: flags & flag::SENSORS != 0,
            sleep: flags & flag::SLEEP != 0,
        })
    }
}

impl Wire for BodyEvent {
    fn encode(&self, to: &mut Writer) {
        let mut ids = |code, ids: &[BodyId]| {
            to.u8(code);
            for id in ids {
                id.encode(to);
            }
        };
        match self {
            Self::ContactBegan { body, contact } => {
                ids(0, &[*body]);
                contact.encode(to);
            }
            Self::ContactEnded { body, with } => ids(1, &[*body, *with]),
            Self::ContactForce { body, contact } => {
                ids(2, &[*body]);
                contact.encode(to);
            }
            Self::SensorEntered { sensor, body } => ids(3, &[*sensor, *body]),
            Self::SensorLeft { sensor, body } => ids(4, &[*sensor, *body]),
            Self::FellAsleep(body) => ids(5, &[*body]),
            Self::Woke(body) => ids(6, &[*body]),
            Self::Fault(body) => ids(7, &[*body]),
            Self::ReachedGround(body) => ids(8, &[*body]),
            Self::LeftGround(body) => ids(9, &[*body]),
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let code = from.u8()?;
        if code > 9 {
            return Err(Malformed::UnknownCode);
        }
        let body = BodyId::decode(from)?;
        Ok(match code {
            0 => Self::ContactBegan {
                body,
                contact: Contact::decode(from)?,
            },
            1 => Self::ContactEnded {
                body,
                with: BodyId::decode(from)?,
            },
            2 => Self::ContactForce {
                body,
                contact: Contact::decode(from)?,
            },
            3 => Self::SensorEntered {
                sensor: body,
                body: BodyId::decode(from)?,
            },
            4 => Self::SensorLeft {
                sensor: body,
                body: BodyId::decode(from)?,
            },
            5 => Self::FellAsleep(body),
            6 => Self::Woke(body),
            7 => Self::Fault(body),
            8 => Self::ReachedGround(body),
            _ => Self::LeftGround(body),
        })
    }
}

/// Contact of a body with another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// The other body.
    pub with: BodyId,
    /// Metres, world frame: on the first body.
    pub point: Vec3,
    /// From the other body towards the first one, unit, world frame.
    pub normal: Vec3,
    /// Metres; negative: they overlap.
    pub separation: f32,
    /// Newtons: sum of the sizes of all forces between the two bodies in the last step.
    pub force: f32,
}

impl Wire for Contact {
    fn encode(&self, to: &mut Writer) {
        self.with.encode(to);
        to.f32s(&self.point.to_array());
        to.f32s(&self.normal.to_array());
        to.f32s(&[self.separation, self.force]);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let with = BodyId::decode(from)?;
        let [point, normal] = [from.f32s()?, from.f32s()?].map(Vec3::from_array);
        let [separation, force] = from.f32s()?;
        let numbers = [separation, force];
        if !point.is_finite() || !normal.is_finite() || !numbers.iter().all(|n| n.is_finite()) {
            return Err(Malformed::NotFinite);
        }
        Ok(Self {
            with,
            point,
            normal,
            separation,
            force,
        })
    }
}
