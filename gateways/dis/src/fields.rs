//! Fields of PDUs one after the other, big-endian: read and written.
//!
//! The caller has checked the number of bytes, and the room.

use glam::DVec3;

use crate::entity::{
    DeadReckoning, EntityId, EntityState, EntityStateUpdate, EntityType, Kinematics, Marking,
    PARAMETER_BYTES,
};

/// Reads fields one after the other from bytes whose number has been checked.
pub(crate) struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    /// All fields of these bytes.
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// The bytes that have not been read.
    pub(crate) const fn rest(&self) -> &'a [u8] {
        self.rest
    }

    pub(crate) fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (first, rest) = self
            .rest
            .split_first_chunk()
            .expect("the length was checked");
        self.rest = rest;
        *first
    }

    fn u8(&mut self) -> u8 {
        let [byte] = self.bytes();
        byte
    }

    fn u16(&mut self) -> u16 {
        u16::from_be_bytes(self.bytes())
    }

    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_be_bytes(self.bytes())
    }

    fn floats(&mut self) -> [f32; 3] {
        [(); 3].map(|()| f32::from_be_bytes(self.bytes()))
    }

    fn location(&mut self) -> DVec3 {
        DVec3::from([(); 3].map(|()| f64::from_be_bytes(self.bytes())))
    }

    pub(crate) fn entity_id(&mut self) -> EntityId {
        EntityId {
            site: self.u16(),
            application: self.u16(),
            entity: self.u16(),
        }
    }

    fn entity_type(&mut self) -> EntityType {
        EntityType {
            kind: self.u8(),
            domain: self.u8(),
            country: self.u16(),
            category: self.u8(),
            subcategory: self.u8(),
            specific: self.u8(),
            extra: self.u8(),
        }
    }

    fn kinematics(&mut self) -> Kinematics {
        Kinematics {
            velocity: self.floats(),
            location: self.location(),
            orientation: self.floats(),
            appearance: self.u32(),
        }
    }

    fn parameters(&self) -> &'a [[u8; PARAMETER_BYTES]] {
        self.rest.as_chunks().0
    }

    pub(crate) fn entity_state(&mut self) -> EntityState<'a> {
        let id = self.entity_id();
        let [force, _] = self.bytes();
        EntityState {
            id,
            force,
            entity_type: self.entity_type(),
            alternative_type: self.entity_type(),
            kinematics: self.kinematics(),
            dead_reckoning: DeadReckoning {
                model: self.u8(),
                other: self.bytes(),
                acceleration: self.floats(),
                spin: self.floats(),
            },
            marking: Marking {
                character_set: self.u8(),
                text: self.bytes(),
            },
            capabilities: self.u32(),
            parameters: self.parameters(),
        }
    }

    pub(crate) fn update(&mut self) -> EntityStateUpdate<'a> {
        let id = self.entity_id();
        let [padding, _] = self.bytes();
        let kinematics = self.kinematics();
        EntityStateUpdate {
            id,
            padding,
            kinematics,
            parameters: self.parameters(),
        }
    }
}

/// Writes fields one after the other into room whose size has been checked.
pub(crate) struct Writer<'a> {
    to: &'a mut [u8],
    at: usize,
}

impl<'a> Writer<'a> {
    /// Writes from the start of this room.
    pub(crate) const fn new(to: &'a mut [u8]) -> Self {
        Self { to, at: 0 }
    }

    /// Bytes so far.
    pub(crate) const fn written(&self) -> usize {
        self.at
    }

    pub(crate) fn put(&mut self, bytes: &[u8]) {
        self.to[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }

    fn floats(&mut self, floats: [f32; 3]) {
        floats
            .iter()
            .for_each(|float| self.put(&float.to_be_bytes()));
    }

    pub(crate) fn entity_id(&mut self, id: EntityId) {
        for number in [id.site, id.application, id.entity] {
            self.put(&number.to_be_bytes());
        }
    }

    fn entity_type(&mut self, is: EntityType) {
        self.put(&[is.kind, is.domain]);
        self.put(&is.country.to_be_bytes());
        self.put(&[is.category, is.subcategory, is.specific, is.extra]);
    }

    fn kinematics(&mut self, kinematics: &Kinematics) {
        self.floats(kinematics.velocity);
        for coordinate in kinematics.location.to_array() {
            self.put(&coordinate.to_be_bytes());
        }
        self.floats(kinematics.orientation);
        self.put(&kinematics.appearance.to_be_bytes());
    }

    pub(crate) fn entity_state(&mut self, state: &EntityState<'_>) {
        self.entity_id(state.id);
        self.put(&[state.force, state.parameters.len() as u8]);
        self.entity_type(state.entity_type);
        self.entity_type(state.alternative_type);
        self.kinematics(&state.kinematics);
        let DeadReckoning {
            model,
            other,
            acceleration,
            spin,
        } = state.dead_reckoning;
        self.put(&[model]);
        self.put(&other);
        self.floats(acceleration);
        self.floats(spin);
        self.put(&[state.marking.character_set]);
        self.put(&state.marking.text);
        self.put(&state.capabilities.to_be_bytes());
        self.put(state.parameters.as_flattened());
    }

    pub(crate) fn update(&mut self, update: &EntityStateUpdate<'_>) {
        self.entity_id(update.id);
        self.put(&[update.padding, update.parameters.len() as u8]);
        self.kinematics(&update.kinematics);
        self.put(update.parameters.as_flattened());
    }
}
