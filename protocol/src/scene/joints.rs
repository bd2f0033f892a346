//! The joints of a scene, by id and by body.
//!
//! Server and client keep the same table. Invariant: a joint is found under its id and under both of its bodies, or
//! not at all.

use alloc::collections::{BTreeMap, BTreeSet};
use alloc::vec::Vec;

use rhumb_reckoning::BodyId;

use super::joint::{Joint, JointId};

/// All joints of one scene.
#[derive(Clone, Debug, Default)]
pub struct Joints {
    by_id: BTreeMap<JointId, Joint>,
    by_body: BTreeSet<(BodyId, JointId)>,
}

impl Joints {
    /// Sets the joint of an id; returns the one that had it before.
    pub fn insert(&mut self, id: JointId, joint: Joint) -> Option<Joint> {
        let before = self.remove(id);
        self.by_id.insert(id, joint);
        self.by_body.extend(joint.bodies.map(|body| (body, id)));
        before
    }

    /// Removes a joint.
    pub fn remove(&mut self, id: JointId) -> Option<Joint> {
        let joint = self.by_id.remove(&id)?;
        for body in joint.bodies {
            self.by_body.remove(&(body, id));
        }
        Some(joint)
    }

    /// Removes all joints of a removed body; returns their ids in order.
    pub fn remove_body(&mut self, body: BodyId) -> Vec<JointId> {
        let removed: Vec<_> = self.of_body(body).map(|(id, _)| id).collect();
        for id in &removed {
            self.remove(*id);
        }
        removed
    }

    /// The joint of an id.
    #[must_use]
    pub fn get(&self, id: JointId) -> Option<&Joint> {
        self.by_id.get(&id)
    }

    /// The joints of a body, in the order of ids.
    pub fn of_body(&self, body: BodyId) -> impl Iterator<Item = (JointId, &Joint)> {
        let all = (body, JointId(0))..=(body, JointId(u32::MAX));
        let ids = self.by_body.range(all).map(|(_, id)| *id);
        ids.filter_map(|id| Some((id, self.by_id.get(&id)?)))
    }

    /// Number of joints.
    #[must_use]
    pub fn len(&self) -> usize {
        self.by_id.len()
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.by_id.is_empty()
    }

    /// All joints, in the order of ids.
    pub fn iter(&self) -> impl Iterator<Item = (JointId, &Joint)> {
        self.by_id.iter().map(|(id, joint)| (*id, joint))
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::joint::{JointFrame, JointKind};
    use super::*;

    #[test]
    fn a_joint_goes_with_either_of_its_bodies() {
        let body = |index| BodyId::new(index, 0);
        let frames = [JointFrame::at(Vec3::ZERO); 2];
        let between = |bodies| Joint::plain(JointKind::Fixed, bodies, frames);
        let mut joints = Joints::default();
        for first in 0..3 {
            let joint = between([body(first), body(first + 1)]);
            let id = JointId(first);
            assert_eq!(joints.insert(id, between([body(8), body(9)])), None);
            assert_eq!(
                joints.insert(id, joint).map(|joint| joint.bodies),
                Some([body(8), body(9)])
            );
        }
        assert_eq!(joints.remove_body(body(1)), [JointId(0), JointId(1)]);
        assert_eq!(joints.remove_body(body(1)), []);
        assert_eq!(joints.iter().count(), 1);
        assert_eq!(joints.remove_body(body(3)), [JointId(2)]);
        assert_eq!(joints.remove(JointId(2)), None);
        assert!(joints.by_body.is_empty());
    }
}
