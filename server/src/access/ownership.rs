//! Which client owns what in one scene.
//!
//! A client owns the bodies, shapes and joints that it added, for as long as they exist, connected or not. What was
//! added without a token belongs to no client.

use std::collections::BTreeMap;

use rhumb_protocol::scene::{Command, JointId, ShapeId};
use rhumb_reckoning::BodyId;

use super::permit::{ClientName, Permit};

/// Owners in one scene.
#[derive(Debug, Default)]
pub(crate) struct Ownership {
    bodies: BTreeMap<BodyId, ClientName>,
    shapes: BTreeMap<ShapeId, ClientName>,
    joints: BTreeMap<JointId, ClientName>,
    counts: BTreeMap<ClientName, u32>,
}

impl Ownership {
    /// Notes the effect of a command that was applied.
    pub(crate) fn note(&mut self, permit: &Permit, command: &Command) {
        match (command, &permit.client) {
            (Command::AddBody { desc, .. }, Some(client)) => {
                self.bodies.insert(desc.id, client.clone());
                *self.counts.entry(client.clone()).or_default() += 1;
            }
            (Command::AddShape { id, .. }, Some(client)) => {
                self.shapes.insert(*id, client.clone());
            }
            (Command::AddJoint { id, .. }, Some(client)) => {
                self.joints.insert(*id, client.clone());
            }
            (Command::RemoveShape { id }, _) => {
                self.shapes.remove(id);
            }
            (Command::RemoveJoint { id }, _) => self.remove_joint(*id),
            _ => {}
        }
    }

    /// Forgets a body that has left the scene.
    pub(crate) fn remove_body(&mut self, id: BodyId) {
        let Some(client) = self.bodies.remove(&id) else {
            return;
        };
        if let Some(count) = self.counts.get_mut(&client) {
            *count -= 1;
            if *count == 0 {
                self.counts.remove(&client);
            }
        }
    }

    /// Forgets a joint that has left the scene.
    pub(crate) fn remove_joint(&mut self, id: JointId) {
        self.joints.remove(&id);
    }

    /// Bodies of a client.
    pub(super) fn bodies_of(&self, client: &ClientName) -> u32 {
        self.counts.get(client).copied().unwrap_or(0)
    }

    pub(super) fn owns_body(&self, client: Option<&ClientName>, id: BodyId) -> bool {
        owns(&self.bodies, client, id)
    }

    pub(super) fn owns_shape(&self, client: Option<&ClientName>, id: ShapeId) -> bool {
        owns(&self.shapes, client, id)
    }

    pub(super) fn owns_joint(&self, client: Option<&ClientName>, id: JointId) -> bool {
        owns(&self.joints, client, id)
    }
}

fn owns<Id: Ord>(owners: &BTreeMap<Id, ClientName>, client: Option<&ClientName>, id: Id) -> bool {
    client.is_some_and(|client| owners.get(&id) == Some(client))
}
