//! The bodies of a scene with locomotion: characters and vehicles.
//!
//! Invariants: a character's body is kinematic and convex, a vehicle's is dynamic; neither kind exceeds its limit.

use std::collections::BTreeMap;

use rhumb_protocol::limits::{CHARACTERS_MAX, VEHICLES_MAX};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CommandError, Invalid, Locomotion, Quantity, Shape,
};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;

/// Locomotion by body; never [`Locomotion::None`].
#[derive(Clone, Debug, Default)]
pub(super) struct Locomotions(BTreeMap<BodyId, Locomotion>);

impl Locomotions {
    /// Replaces the locomotion of a body.
    pub(super) fn set(
        &mut self,
        (desc, shape): (&BodyDesc, &Shape),
        locomotion: &Locomotion,
    ) -> Result<(), CommandError> {
        let (characters, vehicles) = self.counts_without(desc.id);
        match locomotion {
            Locomotion::None => {
                self.0.remove(&desc.id);
                return Ok(());
            }
            Locomotion::Character(_) if desc.kind != BodyKind::Kinematic => {
                return Err(CommandError::NotKinematic(desc.id));
            }
            Locomotion::Character(_) if !shape.is_convex() => {
                return Err(CommandError::NotConvex(desc.shape));
            }
            Locomotion::Character(_) if characters >= CHARACTERS_MAX => {
                return Err(CommandError::TooManyCharacters);
            }
            Locomotion::Vehicle(_) if desc.kind != BodyKind::Dynamic => {
                return Err(CommandError::NotPushable(desc.id));
            }
            Locomotion::Vehicle(_) if vehicles >= VEHICLES_MAX => {
                return Err(CommandError::TooManyVehicles);
            }
            Locomotion::Character(_) | Locomotion::Vehicle(_) => {}
        }
        self.0.insert(desc.id, locomotion.clone());
        Ok(())
    }

    /// Numbers of characters and vehicles beside a body.
    fn counts_without(&self, id: BodyId) -> (usize, usize) {
        let others = self.0.iter().filter(|(other, _)| **other != id);
        let characters = others
            .clone()
            .filter(|(_, locomotion)| matches!(locomotion, Locomotion::Character(_)))
            .count();
        (characters, others.count() - characters)
    }

    /// Ends the locomotion of a body that is changed to one that cannot have it; returns whether it did.
    pub(super) fn end_unfit(&mut self, desc: &BodyDesc, shape: Option<&Shape>) -> bool {
        let fits = match self.0.get(&desc.id) {
            None => return false,
            Some(Locomotion::Vehicle(_)) => desc.kind == BodyKind::Dynamic,
            Some(_) => desc.kind == BodyKind::Kinematic && shape.is_some_and(Shape::is_convex),
        };
        if !fits {
            self.0.remove(&desc.id);
        }
        !fits
    }

    pub(super) fn remove(&mut self, id: BodyId) {
        self.0.remove(&id);
    }

    pub(super) fn get(&self, id: BodyId) -> Option<&Locomotion> {
        self.0.get(&id)
    }

    /// In the order of ids.
    pub(super) fn iter(&self) -> impl Iterator<Item = &Locomotion> {
        self.0.values()
    }

    /// Refuses inputs of wheels that a body does not have.
    pub(super) fn check_wheels(&self, id: BodyId, count: usize) -> Result<(), CommandError> {
        match self.0.get(&id) {
            Some(Locomotion::Vehicle(vehicle)) if vehicle.wheels.len() == count => Ok(()),
            Some(Locomotion::Vehicle(_)) => Err(CommandError::Invalid(Invalid::out_of_range(
                Quantity::Wheels,
            ))),
            _ => Err(CommandError::NotVehicle(id)),
        }
    }
}

impl Wire for Locomotions {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.0.len() as u64);
        for (id, locomotion) in &self.0 {
            id.encode(to);
            locomotion.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut locomotions = Self::default();
        for _ in 0..from.varint()? {
            let id = BodyId::decode(from)?;
            let before = locomotions.0.insert(id, Locomotion::decode(from)?);
            if before.is_some() {
                return Err(Malformed::NotCanonical);
            }
        }
        Ok(locomotions)
    }
}
