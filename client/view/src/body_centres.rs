//! Bodies whose shapes were given from elsewhere than their centres of mass.
//!
//! Sends nothing. A body's pose on the wire is that of its centre of mass. An application that has a shape from a file knows
//! the origin of the file instead: for bodies that it added so, poses are converted here in both directions. Other members
//! see the shape and the pose from the centre of mass.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyBuilder, Command, Locomotion};
use rhumb_reckoning::{BodyId, BodyState, InvalidMotion};

/// The centres of mass of bodies, in their own axes, metres from the origins that the application knows.
#[derive(Clone, Debug, Default)]
pub struct BodyCentres {
    centres: BTreeMap<BodyId, Vec3>,
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

    /// Forgets bodies that are gone.
    pub fn forget(&mut self, removed: &[BodyId]) {
        if !self.centres.is_empty() {
            self.centres.retain(|id, _| !removed.contains(id));
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
        origin + rotation * self.centre(id)
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
    use rhumb_protocol::scene::{BodyDesc, Hull, Joint, JointFrame, JointId, JointKind, Shape};

    use super::*;

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
        centres.forget(&[ID]);
        assert!(centres.is_empty());
        assert_eq!(centres.command_in(set(Vec3::ZERO)), set(Vec3::ZERO));
    }
}
