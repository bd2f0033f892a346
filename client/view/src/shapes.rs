//! Shape numbers, chosen so that equal shapes of a scene share one number.
//!
//! Sends nothing. The number is a hash of the shape's bytes. Two clients that add equal shapes at once choose the same
//! number, so that the refusal of the second command is harmless.
//!
//! Two clients may give one number to two shapes at once. The server refuses the second shape, and places the bodies
//! behind it with the first one. This file finds those bodies, and `client_ids` mends them: it changes their shapes, or
//! removes bodies that cannot be changed.
//!
//! A body's pose on the wire is that of its centre of mass. An application that has a shape from a file knows the origin of
//! the file instead: for bodies that it added so, poses are converted here in both directions. Other members see the shape
//! and the pose from the centre of mass.

use std::collections::{BTreeMap, VecDeque};

use glam::{Quat, Vec3};
use rhumb_protocol::limits::SHAPES_MAX;
use rhumb_protocol::scene::{
    BodyBuilder, BodyDesc, CellGrid, Command, CommandError, Locomotion, Shape, ShapeId,
};
use rhumb_protocol::session::Event;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Writer;
use rhumb_reckoning::{BodyId, BodyState, InvalidMotion};

use crate::unanswered::Unanswered;
use crate::view::View;

/// The shapes that this client added, and what the server has not answered yet.
#[derive(Debug, Default)]
pub(crate) struct ShapeNumbers {
    unanswered: BTreeMap<ShapeId, UnansweredShape>,
    /// Shapes that came with bodies of this client.
    of_bodies: Vec<ShapeId>,
    /// Numbers of unanswered commands that remove a shape unless a body has it.
    removals: Vec<(u64, ShapeId)>,
}

#[derive(Debug)]
struct UnansweredShape {
    shape: Shape,
    /// Number of the command that adds it.
    command: u64,
    /// True if it came with a body of this client.
    of_body: bool,
}

/// Meaning of the refusal of a command.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ShapeRefusal {
    /// The caller is to know of it.
    Reported,
    /// The command adds a shape that the scene already has under the same number, or removes one that has come into use
    /// or is gone.
    Harmless,
    /// The number of a shape that came with a body is taken, perhaps by an equal shape.
    Taken(ShapeId, Shape),
}

/// Number of a shape, and whether the shape must be added under it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ShapeSlot {
    /// The scene has an equal shape under this number, or an unanswered command adds one.
    Known(ShapeId),
    /// No shape has this number yet.
    Free(ShapeId),
}

impl ShapeNumbers {
    /// Finds a shape's number; `None` when all numbers are taken. `known`: the shapes of the scene.
    pub(crate) fn find<'a>(
        &self,
        shape: &Shape,
        known: impl Fn(ShapeId) -> Option<&'a Shape>,
    ) -> Option<ShapeSlot> {
        let first = hash(shape);
        for step in 0..SHAPES_MAX {
            let id = ShapeId((first + step) % SHAPES_MAX);
            let unanswered = self.unanswered.get(&id).map(|added| &added.shape);
            // A removal that is under way may be refused, so the number is free for an equal shape alone.
            match unanswered.or_else(|| known(id)) {
                None => return Some(ShapeSlot::Free(id)),
                Some(other) if other != shape => {}
                Some(_) if unanswered.is_none() && self.leaves(id) => {
                    return Some(ShapeSlot::Free(id));
                }
                Some(_) => return Some(ShapeSlot::Known(id)),
            }
        }
        None
    }

    /// Stores the shape of a queued command.
    pub(crate) fn add(&mut self, id: ShapeId, shape: Shape, command: u64) {
        let added = UnansweredShape {
            shape,
            command,
            of_body: false,
        };
        self.unanswered.insert(id, added);
    }

    /// Stores that a shape comes with a body: the one that was stored last under this number.
    pub(crate) fn add_of_body(&mut self, id: ShapeId) {
        if let Some(added) = self.unanswered.get_mut(&id) {
            added.of_body = true;
        }
        if !self.of_bodies.contains(&id) {
            self.of_bodies.push(id);
        }
    }

    /// Shapes that came with bodies of this client, that the scene has, and that no body uses.
    pub(crate) fn unused<'a>(
        &self,
        is_used: impl Fn(ShapeId) -> bool,
        known: impl Fn(ShapeId) -> Option<&'a Shape>,
    ) -> Vec<ShapeId> {
        let is_unused = |id: &ShapeId| !is_used(*id) && known(*id).is_some() && !self.leaves(*id);
        self.of_bodies.iter().copied().filter(is_unused).collect()
    }

    fn leaves(&self, id: ShapeId) -> bool {
        self.removals.iter().any(|(_, removed)| *removed == id)
    }

    /// Stores a queued command that removes a shape.
    pub(crate) fn remove(&mut self, id: ShapeId, command: u64) {
        self.of_bodies.retain(|of_body| *of_body != id);
        self.removals.push((command, id));
    }

    /// Forgets the shapes of commands up to this number, which the server has answered.
    pub(crate) fn handle_applied(&mut self, through: u64) {
        self.unanswered.retain(|_, added| added.command > through);
        self.removals.retain(|(command, _)| *command > through);
    }

    /// Handles a refusal.
    pub(crate) fn handle_refused<'a>(
        &mut self,
        number: u64,
        error: CommandError,
        known: impl Fn(ShapeId) -> Option<&'a Shape>,
    ) -> ShapeRefusal {
        if let Some((_, id)) = self.removals.iter().find(|(command, _)| *command == number) {
            let id = *id;
            return match error {
                CommandError::ShapeInUse(_) => {
                    self.add_of_body(id);
                    ShapeRefusal::Harmless
                }
                CommandError::UnknownShape(_) => ShapeRefusal::Harmless,
                _ => ShapeRefusal::Reported,
            };
        }
        let mut unanswered = self.unanswered.iter();
        let Some((id, added)) = unanswered.find(|(_, added)| added.command == number) else {
            return ShapeRefusal::Reported;
        };
        let id = *id;
        let is_taken = matches!(error, CommandError::ShapeIdTaken(_));
        let refusal = match known(id) {
            Some(shape) if is_taken && *shape == added.shape => ShapeRefusal::Harmless,
            _ if is_taken && added.of_body => ShapeRefusal::Taken(id, added.shape.clone()),
            _ => ShapeRefusal::Reported,
        };
        // The scene's shape with this number did not come with a body of this client.
        if added.of_body {
            self.of_bodies.retain(|of_body| *of_body != id);
        }
        refusal
    }
}

/// A number below [`SHAPES_MAX`] from a shape's bytes on the wire: FNV-1a.
fn hash(shape: &Shape) -> u32 {
    let mut bytes = Writer::new();
    shape.encode(&mut bytes);
    let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    let hash = bytes
        .into_bytes()
        .into_iter()
        .fold(0xcbf2_9ce4_8422_2325, mix);
    (hash % u64::from(SHAPES_MAX)) as u32
}

/// Unanswered commands that rely on the number of a shape.
#[derive(Debug, Default)]
pub(crate) struct ShapeClashes {
    /// Bodies with a shape number of this client's choice.
    bodies: Unanswered<BodyDesc>,
    /// Shapes that were refused because their numbers are taken.
    refused: Unanswered<(ShapeId, Shape)>,
    /// Bodies to mend.
    wrong: VecDeque<WrongBody>,
    /// Commands that mend bodies.
    mends: Unanswered<Mend>,
}

/// A body that has another client's shape.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct WrongBody {
    pub(crate) desc: BodyDesc,
    /// The shape that it is to have; `None` if it is to be removed.
    pub(crate) shape: Option<Shape>,
}

/// A command that mends a body.
#[derive(Clone, Copy, Debug)]
enum Mend {
    Changes(BodyDesc),
    Removes,
}

impl ShapeClashes {
    /// Stores a queued command that adds a body.
    pub(crate) fn add(&mut self, desc: BodyDesc, command: u64) {
        self.bodies.insert(command, desc);
    }

    /// Stores a queued command that gives a body its shape after a clash.
    pub(crate) fn add_change(&mut self, desc: BodyDesc, command: u64) {
        self.bodies.insert(command, desc);
        self.mends.insert(command, Mend::Changes(desc));
    }

    /// Stores a queued command that removes a body after a clash.
    pub(crate) fn add_removal(&mut self, command: u64) {
        self.mends.insert(command, Mend::Removes);
    }

    /// Handles a queued change of a body, or its removal: a later mend keeps what the change sets.
    pub(crate) fn note_changed(&mut self, id: BodyId, desc: Option<BodyDesc>) {
        self.bodies.retain_mut(|of_body| {
            if of_body.id != id {
                return true;
            }
            // Of another shape, it is not behind the one that is refused.
            let kept = desc.filter(|desc| desc.shape == of_body.shape);
            *of_body = kept.unwrap_or(*of_body);
            kept.is_some()
        });
    }

    /// Handles the refusal of a shape whose number is taken, perhaps by an equal shape.
    pub(crate) fn handle_taken(&mut self, command: u64, id: ShapeId, shape: Shape) {
        self.refused.insert(command, (id, shape));
    }

    /// Handles the refusal of any command; true if it was to mend a body.
    pub(crate) fn handle_refused(&mut self, command: u64, error: CommandError) -> bool {
        self.bodies.remove(command);
        let mend = self.mends.remove(command);
        if let Some(Mend::Changes(desc)) = mend
            && !matches!(error, CommandError::UnknownBody(_))
        {
            let shape = None;
            self.wrong.push_back(WrongBody { desc, shape });
        }
        mend.is_some()
    }

    /// Handles the answer to all commands up to this number. `known`: the shapes of the scene, with the effects of these
    /// commands.
    pub(crate) fn handle_applied<'a>(
        &mut self,
        through: u64,
        known: impl Fn(ShapeId) -> Option<&'a Shape>,
    ) {
        for (command, (id, shape)) in self.refused.take_through(through) {
            if known(id) == Some(&shape) {
                continue;
            }
            // Also bodies that are still under way: they were queued before the number was known to be taken.
            let behind = self.bodies.from(command).iter().map(|(_, desc)| *desc);
            let wrong = behind.filter(|desc| desc.shape == id);
            self.wrong.extend(wrong.map(|desc| WrongBody {
                desc,
                shape: Some(shape.clone()),
            }));
        }
        self.bodies.take_through(through);
        self.mends.take_through(through);
    }

    /// A body to mend.
    pub(crate) fn next_wrong(&self) -> Option<WrongBody> {
        self.wrong.front().cloned()
    }

    /// Forgets the body that [`Self::next_wrong`] returned.
    pub(crate) fn end_wrong(&mut self) {
        self.wrong.pop_front();
    }
}

/// The centres of mass of bodies, in their own axes, metres from the origins that the application knows.
#[derive(Clone, Debug, Default)]
pub struct BodyCentres {
    centres: BTreeMap<BodyId, Vec3>,
    /// Those of them that were removed, until no view shows them.
    removed: Vec<BodyId>,
}

impl BodyCentres {
    /// The bodies with their shapes moved to their centres of mass, and the centres: see [`BodyBuilder::centred`].
    #[must_use]
    pub fn centred(bodies: impl IntoIterator<Item = BodyBuilder>) -> (Vec<BodyBuilder>, Vec<Vec3>) {
        bodies.into_iter().map(BodyBuilder::centred).unzip()
    }

    /// Keeps the centres of bodies that were added.
    pub fn keep(&mut self, ids: &[BodyId], centres: &[Vec3]) {
        let off = ids
            .iter()
            .zip(centres)
            .filter(|(_, centre)| **centre != Vec3::ZERO);
        self.centres.extend(off.map(|(id, centre)| (*id, *centre)));
    }

    /// Learns of removed bodies from the events of the session.
    pub fn note(&mut self, event: &Event) {
        if let Event::BodyRemoved { id, .. } = event
            && self.centres.contains_key(id)
        {
            self.removed.push(*id);
        }
    }

    /// Forgets bodies that a view has no more. `grid`: of a member by cells, to which a body comes back that has only left its
    /// cells.
    pub fn forget(&mut self, view: &View, grid: Option<CellGrid>) {
        if self.centres.is_empty() {
            return;
        }
        let mut gone = std::mem::take(&mut self.removed);
        self.removed = (gone.extract_if(.., |id| view.place(*id).is_some())).collect();
        if grid.is_none() {
            gone.extend_from_slice(view.removed());
        }
        for id in gone {
            self.centres.remove(&id);
        }
    }

    /// True if no body has another origin than its centre of mass.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.centres.is_empty()
    }

    /// The centre of a body in its own axes, metres from its origin; zero for a body that is not known.
    #[must_use]
    pub fn centre(&self, id: BodyId) -> Vec3 {
        self.centres.get(&id).copied().unwrap_or_default()
    }

    /// The centre of mass of a body whose origin is here, metres.
    #[must_use]
    pub fn position_in(&self, id: BodyId, origin: Vec3, rotation: Quat) -> Vec3 {
        // A rotation that is not finite is refused under its own name.
        match rotation.is_finite() {
            true => origin + rotation * self.centre(id),
            false => origin,
        }
    }

    /// The origin of a body whose centre of mass is here, metres.
    #[must_use]
    pub fn position_out(&self, id: BodyId, centre: Vec3, rotation: Quat) -> Vec3 {
        centre - rotation * self.centre(id)
    }

    /// A state whose position is that of the centre of mass. Velocities are those of the centre of mass already.
    ///
    /// # Errors
    ///
    /// [`InvalidMotion`] for a position that is not finite any more.
    pub fn state_in(&self, id: BodyId, state: BodyState) -> Result<BodyState, InvalidMotion> {
        let [px, py, pz, x, y, z, w, vx, vy, vz, wx, wy, wz] = state.parts();
        let rotation = Quat::from_xyzw(x, y, z, w);
        let position = self.position_in(id, Vec3::new(px, py, pz), rotation);
        let rotation = rotation.to_array();
        BodyState::new(position.to_array(), rotation, [vx, vy, vz], [wx, wy, wz])
    }

    /// A command with poses, anchors and mounts from the centres of mass.
    #[must_use]
    pub fn command_in(&self, mut command: Command) -> Command {
        match &mut command {
            Command::SetPose {
                id,
                position,
                rotation,
            } => *position = self.position_in(*id, *position, *rotation),
            Command::AddJoint { joint, .. } | Command::ChangeJoint { joint, .. } => {
                for (id, frame) in joint.bodies.iter().zip(&mut joint.frames) {
                    frame.anchor -= self.centre(*id);
                }
            }
            Command::SetLocomotion { id, locomotion } => {
                if let Locomotion::Vehicle(vehicle) = locomotion.as_mut() {
                    for wheel in &mut vehicle.wheels {
                        wheel.position -= self.centre(*id);
                    }
                }
            }
            _ => {}
        }
        command
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::message::RemovalCause;
    use rhumb_protocol::scene::{
        BodyDesc, BodyKind, Hull, Joint, JointFrame, JointId, JointKind, Shape,
    };

    use super::*;

    #[test]
    fn equal_shapes_have_one_number_before_and_after_the_answer() {
        let mut numbers = ShapeNumbers::default();
        let ball = Shape::ball(0.5);
        let Some(ShapeSlot::Free(id)) = numbers.find(&ball, |_| None) else {
            panic!("no shape is known");
        };
        numbers.add(id, ball.clone(), 7);
        assert_eq!(numbers.find(&ball, |_| None), Some(ShapeSlot::Known(id)));
        numbers.handle_applied(7);
        let known = |other| (other == id).then_some(&ball);
        assert_eq!(numbers.find(&ball, known), Some(ShapeSlot::Known(id)));
        assert_eq!(numbers.find(&ball, |_| None), Some(ShapeSlot::Free(id)));
    }

    #[test]
    fn a_shape_does_not_take_the_number_of_another() {
        let numbers = ShapeNumbers::default();
        let (ball, other) = (Shape::ball(0.5), Shape::cuboid(1.0, 2.0, 3.0));
        let taken = ShapeId(hash(&ball));
        let known = |id| (id == taken).then_some(&other);
        let next = ShapeId((taken.0 + 1) % SHAPES_MAX);
        assert_eq!(numbers.find(&ball, known), Some(ShapeSlot::Free(next)));
        assert_eq!(numbers.find(&ball, |_| Some(&other)), None);
    }

    #[test]
    fn a_shape_that_is_being_removed_is_added_anew_under_its_number() {
        let mut numbers = ShapeNumbers::default();
        let (ball, other) = (Shape::ball(0.5), Shape::ball(0.25));
        let id = ShapeId(hash(&ball));
        numbers.add_of_body(id);
        let known = |at| (at == id).then_some(&ball);
        assert_eq!(numbers.unused(|_| true, known), []);
        assert_eq!(numbers.unused(|_| false, |_| None), []);
        assert_eq!(numbers.unused(|_| false, known), [id]);
        numbers.remove(id, 8);
        assert_eq!(numbers.unused(|_| false, known), []);
        assert_eq!(numbers.find(&ball, known), Some(ShapeSlot::Free(id)));
        let refusal = numbers.handle_refused(8, CommandError::NotAllowed, known);
        assert_eq!(
            (refusal, &numbers.of_bodies[..]),
            (ShapeRefusal::Reported, &[][..])
        );
        let in_use = CommandError::ShapeInUse(id);
        let refusal = numbers.handle_refused(8, in_use, known);
        assert_eq!(refusal, ShapeRefusal::Harmless);
        // The number stays that of the shape until the removal is answered.
        let taken = |at| (at == id).then_some(&other);
        let next = ShapeId((id.0 + 1) % SHAPES_MAX);
        assert_eq!(numbers.find(&ball, taken), Some(ShapeSlot::Free(next)));
        numbers.add(id, ball.clone(), 9);
        assert_eq!(numbers.find(&ball, known), Some(ShapeSlot::Known(id)));
        numbers.handle_applied(9);
        assert_eq!(numbers.find(&ball, known), Some(ShapeSlot::Known(id)));
        assert_eq!(numbers.unused(|_| false, known), [id]);
        let refusal = numbers.handle_refused(8, in_use, known);
        assert_eq!(refusal, ShapeRefusal::Reported);
    }

    #[test]
    fn the_refusal_of_a_shape_that_the_application_named_itself_is_reported() {
        let mut numbers = ShapeNumbers::default();
        let (ball, id) = (Shape::ball(0.5), ShapeId(3));
        numbers.add(id, ball.clone(), 7);
        numbers.add_of_body(id);
        numbers.handle_applied(7);
        numbers.add(id, Shape::ball(0.25), 8);
        let taken = CommandError::ShapeIdTaken(id);
        let refusal = numbers.handle_refused(8, taken, |_| Some(&ball));
        assert_eq!(refusal, ShapeRefusal::Reported);
        assert_eq!(numbers.of_bodies, [id], "the shape of the body stays known");
    }

    #[test]
    fn only_the_refusal_of_an_equal_shape_is_harmless() {
        let mut numbers = ShapeNumbers::default();
        let (ball, id) = (Shape::ball(0.5), ShapeId(3));
        let (other, taken) = (Shape::ball(0.25), CommandError::ShapeIdTaken(id));
        numbers.add(id, ball.clone(), 7);
        let of_caller = numbers.handle_refused(7, taken, |_| Some(&other));
        assert_eq!(of_caller, ShapeRefusal::Reported);
        let mut refusal = |number, error, known: Option<&Shape>| {
            numbers.add_of_body(id);
            let refusal = numbers.handle_refused(number, error, |_| known);
            // Another client's shape stays.
            assert_eq!(numbers.of_bodies.is_empty(), number == 7);
            refusal
        };
        assert_eq!(refusal(7, taken, Some(&ball)), ShapeRefusal::Harmless);
        assert_eq!(refusal(8, taken, Some(&ball)), ShapeRefusal::Reported);
        let unfit = CommandError::ShapeUnfit(id);
        assert_eq!(refusal(7, unfit, Some(&ball)), ShapeRefusal::Reported);
        for known in [None, Some(&other)] {
            let expected = ShapeRefusal::Taken(id, ball.clone());
            assert_eq!(refusal(7, taken, known), expected);
        }
    }

    #[test]
    fn a_later_change_by_the_application_is_kept_or_ends_the_mending() {
        let mut clashes = ShapeClashes::default();
        let [kept, reshaped, removed] = [0, 1, 2].map(|index| {
            let id = BodyId::new(index, 0);
            BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(3))
        });
        for (desc, command) in [kept, reshaped, removed].into_iter().zip(2..) {
            clashes.add(desc, command);
        }
        clashes.handle_taken(1, ShapeId(3), Shape::ball(0.5));
        let kind = BodyKind::Fixed;
        let kept = BodyDesc { kind, ..kept };
        let shape = ShapeId(4);
        clashes.note_changed(kept.id, Some(kept));
        clashes.note_changed(reshaped.id, Some(BodyDesc { shape, ..reshaped }));
        clashes.note_changed(removed.id, None);
        clashes.handle_applied(9, |_| None);
        assert_eq!(clashes.next_wrong().map(|wrong| wrong.desc), Some(kept));
        clashes.end_wrong();
        assert_eq!(clashes.next_wrong(), None);
    }

    const ID: BodyId = BodyId::new(3, 1);

    fn cube() -> BodyBuilder {
        let corner = |place: usize| [place & 1, place >> 1 & 1, place >> 2].map(|bit| bit as f32);
        let corners: Vec<_> = (0..8)
            .map(|place| Vec3::from_array(corner(place)))
            .collect();
        BodyDesc::dynamic(Shape::Hull(Hull::new(&corners).expect("a cube")))
    }

    fn centres() -> BodyCentres {
        let mut centres = BodyCentres::default();
        let (_, found) = BodyCentres::centred([cube(), BodyDesc::dynamic(Shape::ball(0.5))]);
        centres.keep(&[ID, BodyId::new(4, 0)], &found);
        centres
    }

    #[test]
    fn a_cube_from_a_corner_lies_where_its_points_say() {
        let turn = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
        let (bodies, found) = BodyCentres::centred([cube().at(0.0, 2.0, 0.0).rotation(turn)]);
        assert_eq!(found, [Vec3::splat(0.5)]);
        let state = bodies[0].state().expect("a pose");
        let position = Vec3::from_array(state.position());
        assert!(
            (position - Vec3::new(0.5, 2.5, -0.5)).length() < 1e-6,
            "{position}"
        );
        assert_eq!(bodies[0].shape().centre(), None);
    }

    #[test]
    fn poses_go_in_and_out_unchanged_and_others_are_left_alone() {
        let (centres, turn) = (centres(), Quat::from_rotation_x(0.7));
        let origin = Vec3::new(1.0, -2.0, 3.0);
        let there = centres.position_in(ID, origin, turn);
        assert!((there - origin - turn * Vec3::splat(0.5)).length() < 1e-6);
        assert!((centres.position_out(ID, there, turn) - origin).length() < 1e-6);
        let ball = BodyId::new(4, 0);
        assert_eq!(centres.position_in(ball, origin, turn), origin);
        let state = BodyState::new(origin.to_array(), turn.to_array(), [1.0; 3], [2.0; 3]);
        let moved = centres
            .state_in(ID, state.expect("a pose"))
            .expect("a pose");
        assert_eq!(Vec3::from_array(moved.position()), there);
    }

    #[test]
    fn commands_name_the_centre_and_a_body_that_is_gone_is_forgotten() {
        let mut centres = centres();
        let set = |position| Command::SetPose {
            id: ID,
            position,
            rotation: Quat::IDENTITY,
        };
        assert_eq!(centres.command_in(set(Vec3::ZERO)), set(Vec3::splat(0.5)));
        let join = |anchor| Command::AddJoint {
            id: JointId(0),
            joint: Box::new(Joint::plain(
                JointKind::Fixed,
                [ID, BodyId::new(4, 0)],
                [JointFrame::at(anchor), JointFrame::at(Vec3::X)],
            )),
        };
        assert_eq!(centres.command_in(join(Vec3::ONE)), join(Vec3::splat(0.5)));
        let grid = CellGrid::columns(rhumb_reckoning::Metres::new(10.0));
        centres.forget(&View::default(), grid);
        assert!(!centres.is_empty(), "it has left the cells");
        let (id, cause) = (ID, RemovalCause::Command);
        centres.note(&Event::BodyRemoved { id, cause });
        centres.forget(&View::default(), grid);
        assert!(centres.is_empty());
        assert_eq!(centres.command_in(set(Vec3::ZERO)), set(Vec3::ZERO));
    }
}
