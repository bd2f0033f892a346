//! The permit of a client, from its token, and the owners in a scene.
//!
//! Values, and their codec for snapshots and logs. Whether a request is allowed is decided in `rights`.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rhumb_protocol::message::Role;
use rhumb_protocol::scene::{BodyDesc, Command, JointId, ShapeId};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;

/// The name of a client in its tokens. It owns what it adds to a scene, over all its connections.
pub type ClientName = Arc<str>;

/// The rights of one connection.
#[derive(Clone, Debug, PartialEq)]
pub struct Permit {
    /// `None` without a token: then nothing in a scene belongs to the client.
    pub client: Option<ClientName>,
    /// The kind of requests that it may make.
    pub role: Role,
    /// Its part of the scene.
    pub quotas: Quotas,
    /// True if the scenes that it creates are its own: it alone steps and deletes them, they end when it leaves, and no
    /// store keeps them. Such clients are gateways of other protocols.
    pub owns: bool,
}

/// Limits of one client in one scene; `None` leaves the server's own limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Quotas {
    /// Bodies at one time.
    pub bodies: Option<u32>,
    /// Commands in a second, on average over a second. A faster client waits.
    pub commands: Option<u32>,
    /// Body steps in a second: ticks times substeps times the client's bodies.
    pub load: Option<u64>,
    /// Members at one time.
    pub members: Option<u32>,
    /// Scenes of the client's tenant at one time; in the permit of a connection, how many more there may be, its own among
    /// them.
    pub scenes: Option<u32>,
}

impl Permit {
    /// The rights of every client of an open server.
    pub const OPEN: Self = Self {
        client: None,
        role: Role::Owner,
        quotas: Quotas {
            bodies: None,
            commands: None,
            load: None,
            members: None,
            scenes: None,
        },
        owns: false,
    };

    /// The rights of a gateway, which owns the scenes that it creates.
    pub const GATEWAY: Self = Self {
        owns: true,
        ..Self::OPEN
    };
}

/// Owners in one scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ownership {
    bodies: BTreeMap<BodyId, ClientName>,
    shapes: BTreeMap<ShapeId, ClientName>,
    joints: BTreeMap<JointId, ClientName>,
    counts: BTreeMap<ClientName, u32>,
    /// Bits of the dampings that each client's bodies ever had: a scene keeps a table for each.
    dampings: BTreeMap<ClientName, BTreeSet<[u32; 2]>>,
}

impl Ownership {
    /// Notes the effect of a command that was applied.
    pub fn note(&mut self, client: Option<&ClientName>, command: &Command) {
        match (command, client) {
            (Command::AddBody { desc, .. }, Some(client)) => {
                self.bodies.insert(desc.id, client.clone());
                *self.counts.entry(client.clone()).or_default() += 1;
                self.note_damping(client, desc);
            }
            (Command::ChangeBody { desc }, Some(client)) => self.note_damping(client, desc),
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

    fn note_damping(&mut self, client: &ClientName, desc: &BodyDesc) {
        if let Some(damping) = damping_of(desc) {
            let dampings = self.dampings.entry(client.clone()).or_default();
            dampings.insert(damping);
        }
    }

    /// True if [`Self::note`] notes something of a command for its client.
    pub(crate) const fn concerns(command: &Command) -> bool {
        matches!(
            command,
            Command::AddBody { .. }
                | Command::AddShape { .. }
                | Command::AddJoint { .. }
                | Command::ChangeBody {
                    desc: BodyDesc {
                        damping: Some(_),
                        ..
                    }
                }
        )
    }

    /// Forgets a body that has left the scene.
    pub fn remove_body(&mut self, id: BodyId) {
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
    pub fn remove_joint(&mut self, id: JointId) {
        self.joints.remove(&id);
    }

    /// Shapes of a client.
    pub(crate) fn shapes_of(&self, client: &ClientName) -> impl Iterator<Item = ShapeId> {
        let shapes = self.shapes.iter();
        shapes.filter_map(move |(id, owner)| (owner == client).then_some(*id))
    }

    /// Bodies of a client.
    pub(crate) fn bodies_of(&self, client: &ClientName) -> u32 {
        self.counts.get(client).copied().unwrap_or(0)
    }

    /// Number of a client's dampings if it adds a body.
    pub(crate) fn dampings_with(&self, client: &ClientName, desc: &BodyDesc) -> usize {
        let dampings = self.dampings.get(client);
        let known = dampings.map_or(0, BTreeSet::len);
        let is_new = damping_of(desc)
            .is_some_and(|damping| !dampings.is_some_and(|known| known.contains(&damping)));
        known + usize::from(is_new)
    }

    pub(crate) fn owns_body(&self, client: Option<&ClientName>, id: BodyId) -> bool {
        owns(&self.bodies, client, id)
    }

    pub(crate) fn owns_shape(&self, client: Option<&ClientName>, id: ShapeId) -> bool {
        owns(&self.shapes, client, id)
    }

    pub(crate) fn owns_joint(&self, client: Option<&ClientName>, id: JointId) -> bool {
        owns(&self.joints, client, id)
    }
}

/// The bits of a body's own damping.
fn damping_of(desc: &BodyDesc) -> Option<[u32; 2]> {
    let damping = desc.damping?;
    Some([damping.linear.to_bits(), damping.angular.to_bits()])
}

impl Wire for Ownership {
    fn encode(&self, to: &mut Writer) {
        encode_owners(&self.bodies, to);
        encode_owners(&self.shapes, to);
        encode_owners(&self.joints, to);
        to.varint(self.dampings.len() as u64);
        for (client, dampings) in &self.dampings {
            to.sized(client.as_bytes());
            to.varint(dampings.len() as u64);
            let bits = dampings.iter().flatten();
            bits.for_each(|bits| to.raw(&bits.to_le_bytes()));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut ownership = Self {
            bodies: decode_owners(from)?,
            shapes: decode_owners(from)?,
            joints: decode_owners(from)?,
            ..Self::default()
        };
        for client in ownership.bodies.values() {
            *ownership.counts.entry(client.clone()).or_default() += 1;
        }
        for _ in 0..from.varint()? {
            let dampings = ownership.dampings.entry(decode_client(from)?).or_default();
            for _ in 0..from.varint()? {
                dampings.insert([decode_bits(from)?, decode_bits(from)?]);
            }
        }
        Ok(ownership)
    }
}

fn decode_bits(from: &mut Reader<'_>) -> Result<u32, Malformed> {
    let bytes = from.raw(4)?;
    let bytes = bytes.try_into().map_err(|_| Malformed::Truncated)?;
    Ok(u32::from_le_bytes(bytes))
}

fn encode_owners<Id: Wire>(owners: &BTreeMap<Id, ClientName>, to: &mut Writer) {
    to.varint(owners.len() as u64);
    for (id, client) in owners {
        id.encode(to);
        to.sized(client.as_bytes());
    }
}

fn decode_owners<Id: Wire + Ord>(
    from: &mut Reader<'_>,
) -> Result<BTreeMap<Id, ClientName>, Malformed> {
    let mut owners = BTreeMap::new();
    for _ in 0..from.varint()? {
        let id = Id::decode(from)?;
        owners.insert(id, decode_client(from)?);
    }
    Ok(owners)
}

/// A client's name, as its length and text.
pub(crate) fn decode_client(from: &mut Reader<'_>) -> Result<ClientName, Malformed> {
    let bytes = from.sized(from.rest().len())?;
    let text = std::str::from_utf8(bytes).map_err(|_| Malformed::Text)?;
    Ok(text.into())
}

/// A client's name, or none.
pub fn encode_client_of(client: Option<&ClientName>, to: &mut Writer) {
    to.u8(u8::from(client.is_some()));
    if let Some(client) = client {
        to.sized(client.as_bytes());
    }
}

/// A client's name, or none.
///
/// # Errors
///
/// [`Malformed`] for bytes that are neither.
pub fn decode_client_of(from: &mut Reader<'_>) -> Result<Option<ClientName>, Malformed> {
    match from.u8()? {
        0 => Ok(None),
        1 => decode_client(from).map(Some),
        _ => Err(Malformed::UnknownCode),
    }
}

fn owns<Id: Ord>(owners: &BTreeMap<Id, ClientName>, client: Option<&ClientName>, id: Id) -> bool {
    client.is_some_and(|client| owners.get(&id) == Some(client))
}
