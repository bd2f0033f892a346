//! Present and former shapes, bodies, joints and locomotions of a scene.
//!
//! No engine here. Checks the rules of names and numbers; a refused change changes nothing. Invariants: each body's
//! shape exists, each joint's bodies live; the generations of an index only grow.

use std::collections::BTreeMap;

use rhumb_protocol::limits::{
    BODIES_MAX, CHARACTERS_MAX, DAMPINGS_MAX, INDICES_MAX, JOINTS_BESIDE, JOINTS_MAX,
    JOINTS_PER_BODY, SHAPE_BYTES_PER_SCENE_MAX, SHAPES_MAX, SWEPT_BODIES_MAX, VEHICLES_MAX,
};
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, CommandError, Invalid, Joint, JointId, Joints, Locomotion, Quantity, Shape,
    ShapeId,
};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{BodyId, Damping};

/// The shapes, bodies and joints of one scene.
#[derive(Clone, Debug, Default)]
pub(crate) struct Registry {
    shapes: BTreeMap<ShapeId, ShapeEntry>,
    shape_bytes: usize,
    /// By index; `None` for an index that was never used.
    bodies: Vec<Option<BodyEntry>>,
    count: usize,
    joints: Joints,
    /// The dampings of living bodies with their numbers of bodies: both ends of a stream keep a table for each.
    dampings: Vec<(Damping, usize)>,
    locomotions: Locomotions,
    /// Number of bodies that are swept against moving ones.
    swept: usize,
}

#[derive(Clone, Debug)]
struct ShapeEntry {
    shape: Shape,
    /// Number of bodies with this shape.
    users: usize,
}

/// The last body of an index.
#[derive(Clone, Copy, Debug)]
struct BodyEntry {
    desc: BodyDesc,
    /// Its damping as in predictors.
    damping: Damping,
    lives: bool,
}

impl BodyEntry {
    fn new(desc: BodyDesc, damping: Damping) -> Self {
        // As in predictors: a body that no engine moves has no damping, whatever its description says.
        let damping = match desc.kind {
            BodyKind::Dynamic => damping,
            BodyKind::Fixed | BodyKind::Kinematic => Damping::default(),
        };
        Self {
            desc,
            damping,
            lives: true,
        }
    }
}

impl Registry {
    /// Checks that a shape finds a place under this id.
    pub(crate) fn check_shape(&self, id: ShapeId, shape: &Shape) -> Result<(), CommandError> {
        if id.0 >= SHAPES_MAX {
            return Err(CommandError::UnknownShape(id));
        }
        if self.shapes.contains_key(&id) {
            return Err(CommandError::ShapeIdTaken(id));
        }
        if self.shape_bytes + shape.bytes() > SHAPE_BYTES_PER_SCENE_MAX {
            return Err(CommandError::TooManyShapeBytes);
        }
        Ok(())
    }

    pub(crate) fn add_shape(&mut self, id: ShapeId, shape: Shape) -> Result<(), CommandError> {
        self.check_shape(id, &shape)?;
        self.shape_bytes += shape.bytes();
        self.shapes.insert(id, ShapeEntry { shape, users: 0 });
        Ok(())
    }

    pub(crate) fn remove_shape(&mut self, id: ShapeId) -> Result<(), CommandError> {
        let known = self.shapes.get(&id);
        if known.ok_or(CommandError::UnknownShape(id))?.users > 0 {
            return Err(CommandError::ShapeInUse(id));
        }
        if let Some(known) = self.shapes.remove(&id) {
            self.shape_bytes -= known.shape.bytes();
        }
        Ok(())
    }

    /// Adds a body. `damping`: its own or the scene's.
    pub(crate) fn add_body(
        &mut self,
        desc: BodyDesc,
        damping: Damping,
    ) -> Result<(), CommandError> {
        let id = desc.id;
        if id.index() >= INDICES_MAX {
            return Err(CommandError::NotGranted(id));
        }
        let last = self.bodies.get(id.index() as usize).copied().flatten();
        if last.is_some_and(|last| last.lives || last.desc.id.generation() >= id.generation()) {
            return Err(CommandError::BodyIdTaken(id));
        }
        if self.count >= BODIES_MAX as usize {
            return Err(CommandError::TooManyBodies);
        }
        let entry = BodyEntry::new(desc, damping);
        self.check_properties(&entry, None)?;
        self.count_properties(&entry);
        let index = id.index() as usize;
        if index >= self.bodies.len() {
            self.bodies.resize(index + 1, None);
        }
        self.bodies[index] = Some(entry);
        self.count += 1;
        Ok(())
    }

    /// Replaces the description of a body, and returns the one before. `damping`: its own or the scene's.
    pub(crate) fn change_body(
        &mut self,
        desc: BodyDesc,
        damping: Damping,
    ) -> Result<BodyDesc, CommandError> {
        let before = self.entry(desc.id);
        let before = *before.ok_or(CommandError::UnknownBody(desc.id))?;
        let entry = BodyEntry::new(desc, damping);
        self.check_properties(&entry, Some(&before))?;
        self.discount_properties(&before);
        self.count_properties(&entry);
        self.bodies[desc.id.index() as usize] = Some(entry);
        Ok(before.desc)
    }

    /// Checks the properties of a body that is new or replaces the one before.
    fn check_properties(
        &self,
        entry: &BodyEntry,
        before: Option<&BodyEntry>,
    ) -> Result<(), CommandError> {
        let alone = |before: &BodyEntry| {
            let mut users = self.dampings.iter();
            users.any(|(damping, users)| *damping == before.damping && *users == 1)
        };
        let freed = usize::from(before.is_some_and(alone));
        let known = self
            .dampings
            .iter()
            .any(|(damping, _)| *damping == entry.damping);
        if !known && self.dampings.len() - freed >= DAMPINGS_MAX {
            return Err(CommandError::TooManyDampings);
        }
        let id = entry.desc.shape;
        let shape = self.shape(id).ok_or(CommandError::UnknownShape(id))?;
        if entry.desc.kind == BodyKind::Dynamic && !shape.is_solid() {
            return Err(CommandError::NoInside(id));
        }
        let was_swept = before.is_some_and(|before| before.desc.swept);
        if entry.desc.swept && !was_swept && self.swept >= SWEPT_BODIES_MAX {
            return Err(CommandError::TooManySwept);
        }
        Ok(())
    }

    fn count_properties(&mut self, entry: &BodyEntry) {
        if let Some(known) = self.shapes.get_mut(&entry.desc.shape) {
            known.users += 1;
        }
        self.swept += usize::from(entry.desc.swept);
        let mut known = self.dampings.iter_mut();
        match known.find(|(damping, _)| *damping == entry.damping) {
            Some((_, users)) => *users += 1,
            None => self.dampings.push((entry.damping, 1)),
        }
    }

    fn discount_properties(&mut self, entry: &BodyEntry) {
        if let Some(known) = self.shapes.get_mut(&entry.desc.shape) {
            known.users -= 1;
        }
        self.swept -= usize::from(entry.desc.swept);
        self.dampings.retain_mut(|(damping, users)| {
            *users -= usize::from(*damping == entry.damping);
            *users > 0
        });
    }

    /// Removes a body, and returns the joints that go with it.
    pub(crate) fn remove_body(&mut self, id: BodyId) -> Result<Vec<JointId>, CommandError> {
        let entry = *self.entry(id).ok_or(CommandError::UnknownBody(id))?;
        if let Some(Some(known)) = self.bodies.get_mut(id.index() as usize) {
            known.lives = false;
        }
        self.discount_properties(&entry);
        self.count -= 1;
        self.locomotions.remove(id);
        Ok(self.joints.remove_body(id))
    }

    pub(crate) fn set_locomotion(
        &mut self,
        id: BodyId,
        locomotion: &Locomotion,
    ) -> Result<(), CommandError> {
        let desc = self.entry(id).ok_or(CommandError::UnknownBody(id))?.desc;
        let shape = (self.shapes.get(&desc.shape)).ok_or(CommandError::UnknownShape(desc.shape))?;
        self.locomotions.set((&desc, &shape.shape), locomotion)
    }

    /// Ends the locomotion of a body that was changed to one that cannot have it; returns whether it did.
    pub(crate) fn end_unfit_locomotion(&mut self, id: BodyId) -> bool {
        let Some(desc) = self.body(id).copied() else {
            return false;
        };
        let shape = self.shapes.get(&desc.shape).map(|known| &known.shape);
        self.locomotions.end_unfit(&desc, shape)
    }

    /// Refuses inputs of wheels that a body does not have.
    pub(crate) fn check_wheels(&self, id: BodyId, count: usize) -> Result<(), CommandError> {
        self.locomotions.check_wheels(id, count)
    }

    /// The locomotion of a body that has one.
    pub(crate) fn locomotion(&self, id: BodyId) -> Option<&Locomotion> {
        self.locomotions.get(id)
    }

    /// Every locomotion of a body, in the order of ids.
    pub(crate) fn locomotions(&self) -> impl Iterator<Item = &Locomotion> {
        self.locomotions.iter()
    }

    pub(crate) fn add_joint(&mut self, id: JointId, joint: Joint) -> Result<(), CommandError> {
        if id.0 >= JOINTS_MAX {
            return Err(CommandError::UnknownJoint(id));
        }
        self.check_joint(&joint)?;
        if self.joints.get(id).is_some() {
            return Err(CommandError::JointIdTaken(id));
        }
        if self.joints.len() >= JOINTS_BESIDE + JOINTS_PER_BODY * self.count {
            return Err(CommandError::TooManyJoints);
        }
        self.joints.insert(id, joint);
        Ok(())
    }

    pub(crate) fn change_joint(&mut self, id: JointId, joint: Joint) -> Result<(), CommandError> {
        self.joints.get(id).ok_or(CommandError::UnknownJoint(id))?;
        self.check_joint(&joint)?;
        self.joints.insert(id, joint);
        Ok(())
    }

    fn check_joint(&self, joint: &Joint) -> Result<(), CommandError> {
        let [first, second] = joint.bodies;
        for body in joint.bodies {
            self.body(body).ok_or(CommandError::UnknownBody(body))?;
        }
        if first == second {
            return Err(CommandError::JoinedToItself(first));
        }
        Ok(())
    }

    pub(crate) fn remove_joint(&mut self, id: JointId) -> Result<(), CommandError> {
        let joint = self.joints.remove(id);
        joint.map(drop).ok_or(CommandError::UnknownJoint(id))
    }

    pub(crate) const fn joints(&self) -> &Joints {
        &self.joints
    }

    pub(crate) fn body(&self, id: BodyId) -> Option<&BodyDesc> {
        self.entry(id).map(|known| &known.desc)
    }

    fn entry(&self, id: BodyId) -> Option<&BodyEntry> {
        let known = self.bodies.get(id.index() as usize)?.as_ref()?;
        (known.lives && known.desc.id == id).then_some(known)
    }

    /// In the order of ids.
    pub(crate) fn bodies(&self) -> impl Iterator<Item = &BodyDesc> {
        let known = self.bodies.iter().flatten();
        known.filter(|known| known.lives).map(|known| &known.desc)
    }

    /// Number of indices up to the last that was ever used.
    pub(crate) const fn indices(&self) -> u32 {
        self.bodies.len() as u32
    }

    pub(crate) const fn body_count(&self) -> usize {
        self.count
    }

    pub(crate) fn shape(&self, id: ShapeId) -> Option<&Shape> {
        self.shapes.get(&id).map(|known| &known.shape)
    }

    /// In the order of ids.
    pub(crate) fn shapes(&self) -> impl Iterator<Item = (ShapeId, &Shape)> {
        self.shapes.iter().map(|(id, known)| (*id, &known.shape))
    }

    /// The least generation that no body of an index has had; `None` while one lives there, or if none is left.
    pub(crate) fn vacancy(&self, index: u32) -> Option<u16> {
        match self.bodies.get(index as usize).and_then(Option::as_ref) {
            None => Some(0),
            Some(last) if last.lives => None,
            Some(last) => last.desc.id.generation().checked_add(1),
        }
    }
}

impl Wire for Registry {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.shapes.len() as u64);
        for (id, entry) in &self.shapes {
            id.encode(to);
            entry.shape.encode(to);
        }
        to.varint(self.bodies.iter().flatten().count() as u64);
        for entry in self.bodies.iter().flatten() {
            to.u8(u8::from(entry.lives));
            entry.desc.encode(to);
            entry.damping.encode(to);
        }
        to.varint(self.joints.iter().count() as u64);
        for (id, joint) in self.joints.iter() {
            id.encode(to);
            joint.encode(to);
        }
        self.locomotions.encode(to);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut registry = Self::default();
        for _ in 0..from.varint()? {
            let id = ShapeId::decode(from)?;
            let shape = Shape::decode(from)?;
            registry.shape_bytes += shape.bytes();
            registry.shapes.insert(id, ShapeEntry { shape, users: 0 });
        }
        for _ in 0..from.varint()? {
            let lives = from.u8()? != 0;
            let entry = BodyEntry {
                lives,
                desc: BodyDesc::decode(from)?,
                damping: Damping::decode(from)?,
            };
            registry.restore_body(entry)?;
        }
        for _ in 0..from.varint()? {
            let id = JointId::decode(from)?;
            let before = registry.joints.insert(id, Joint::decode(from)?);
            if before.is_some() {
                return Err(Malformed::NotCanonical);
            }
        }
        registry.locomotions = Locomotions::decode(from)?;
        Ok(registry)
    }
}

impl Registry {
    fn restore_body(&mut self, entry: BodyEntry) -> Result<(), Malformed> {
        if entry.lives {
            if !self.shapes.contains_key(&entry.desc.shape) {
                return Err(Malformed::OutOfRange);
            }
            self.count += 1;
            self.count_properties(&entry);
        }
        let index = entry.desc.id.index() as usize;
        if index >= self.bodies.len() {
            self.bodies.resize(index + 1, None);
        }
        self.bodies[index] = Some(entry);
        Ok(())
    }
}

/// Locomotion by body; never [`Locomotion::None`].
///
/// Invariants: a character's body is kinematic and convex, a vehicle's is dynamic; neither kind exceeds its limit.
#[derive(Clone, Debug, Default)]
struct Locomotions(BTreeMap<BodyId, Locomotion>);

impl Locomotions {
    /// Replaces the locomotion of a body.
    fn set(
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
    fn end_unfit(&mut self, desc: &BodyDesc, shape: Option<&Shape>) -> bool {
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

    fn remove(&mut self, id: BodyId) {
        self.0.remove(&id);
    }

    fn get(&self, id: BodyId) -> Option<&Locomotion> {
        self.0.get(&id)
    }

    /// In the order of ids.
    fn iter(&self) -> impl Iterator<Item = &Locomotion> {
        self.0.values()
    }

    /// Refuses inputs of wheels that a body does not have.
    fn check_wheels(&self, id: BodyId, count: usize) -> Result<(), CommandError> {
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
