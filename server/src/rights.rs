//! The one place that decides which request a client may make.
//!
//! Roles decide what kind of request; ownership, which bodies, shapes and joints; quotas, how much. All else that may
//! be wrong with a request is checked where it is carried out.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use rhumb_protocol::limits::{DAMPINGS_MAX, STREAMS_PER_SCENE_MAX};
use rhumb_protocol::message::{AuthorityError, Denial, Role};
use rhumb_protocol::scene::{BodyDesc, Command, CommandError, JointId, SceneConfig, ShapeId};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::BodyId;

/// Streams of one client in a scene: half of all.
const STREAMS_OF_CLIENT_MAX: usize = STREAMS_PER_SCENE_MAX / 2;
/// Different dampings that the bodies of one client ever had: a quarter of all, since a scene keeps them.
const DAMPINGS_OF_CLIENT_MAX: usize = DAMPINGS_MAX / 4;

/// A request to decide about.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Request<'a> {
    Create(&'a SceneConfig),
    Delete,
    Join {
        /// Members of the same client already.
        members: usize,
        /// Members that the scene may have.
        scene_members: u64,
    },
    /// The streams that all members of the client would subscribe to.
    Subscribe {
        streams: usize,
    },
    Reserve,
    Advance,
    Command(&'a Command, &'a SceneConfig),
    TakeAuthority(&'a [BodyId]),
}

/// Reason of a refused request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Refused {
    NotAllowed,
    OverQuota,
}

/// Decides whether a client may make a request.
pub(crate) fn check(
    permit: &Permit,
    ownership: &Ownership,
    request: Request<'_>,
) -> Result<(), Refused> {
    let has_role = permit.role >= role_for(request);
    if !has_role || !owns_subjects(permit, ownership, request) {
        return Err(Refused::NotAllowed);
    }
    if !is_within_quotas(permit, ownership, request) {
        return Err(Refused::OverQuota);
    }
    Ok(())
}

/// The least role that a request needs. Commands that are not listed need the highest.
const fn role_for(request: Request<'_>) -> Role {
    match request {
        Request::Join { .. } | Request::Subscribe { .. } => Role::Observer,
        Request::Reserve | Request::Advance | Request::TakeAuthority(_) => Role::Controller,
        Request::Create(_) | Request::Delete => Role::Owner,
        Request::Command(command, _) => match command {
            Command::AddShape { .. }
            | Command::RemoveShape { .. }
            | Command::AddBody { .. }
            | Command::RemoveBody { .. }
            | Command::SetPose { .. }
            | Command::SetVelocity { .. }
            | Command::Force { .. }
            | Command::Torque { .. }
            | Command::Impulse { .. }
            | Command::TorqueImpulse { .. }
            | Command::AddJoint { .. }
            | Command::RemoveJoint { .. }
            | Command::ChangeBody { .. }
            | Command::ChangeJoint { .. }
            | Command::ForceAt { .. }
            | Command::ImpulseAt { .. }
            | Command::Sleep { .. }
            | Command::Wake { .. }
            | Command::SetEvents { .. }
            | Command::SetLocomotion { .. }
            | Command::Jump { .. }
            | Command::SetWheels { .. } => Role::Controller,
            _ => Role::Owner,
        },
    }
}

/// True if everything that a request would change belongs to the client, or the client is an owner of the scene.
fn owns_subjects(permit: &Permit, ownership: &Ownership, request: Request<'_>) -> bool {
    if permit.role == Role::Owner {
        return true;
    }
    let client = permit.client.as_ref();
    let owns = |id: BodyId| ownership.owns_body(client, id);
    match request {
        Request::TakeAuthority(bodies) => bodies.iter().all(|id| owns(*id)),
        Request::Command(command, _) => match *command {
            Command::RemoveBody { id }
            | Command::SetPose { id, .. }
            | Command::SetVelocity { id, .. }
            | Command::Force { id, .. }
            | Command::Torque { id, .. }
            | Command::Impulse { id, .. }
            | Command::TorqueImpulse { id, .. }
            | Command::ForceAt { id, .. }
            | Command::ImpulseAt { id, .. }
            | Command::Sleep { id }
            | Command::Wake { id }
            | Command::SetEvents { id, .. }
            | Command::SetLocomotion { id, .. }
            | Command::Jump { id, .. }
            | Command::SetWheels { id, .. } => owns(id),
            Command::ChangeBody { desc } => owns(desc.id),
            Command::ChangeJoint { id, ref joint } => {
                ownership.owns_joint(client, id) && joint.bodies.into_iter().all(owns)
            }
            Command::AddJoint { ref joint, .. } => joint.bodies.into_iter().all(owns),
            Command::RemoveShape { id } => ownership.owns_shape(client, id),
            Command::RemoveJoint { id } => ownership.owns_joint(client, id),
            _ => true,
        },
        _ => true,
    }
}

fn is_within_quotas(permit: &Permit, ownership: &Ownership, request: Request<'_>) -> bool {
    let (quotas, client) = (&permit.quotas, permit.client.as_ref());
    let fits = |quota: Option<u64>, asked: u64| quota.is_none_or(|most| asked <= most);
    let damping_fits = |desc: &BodyDesc| {
        let dampings = client.map_or(0, |client| ownership.dampings_with(client, desc));
        dampings <= DAMPINGS_OF_CLIENT_MAX
    };
    match request {
        Request::Create(config) => fits(quotas.load, body_steps(config)),
        Request::Join {
            members,
            scene_members,
        } => {
            // Unless its token says otherwise, a client has half of the members.
            let half = client.map(|_| scene_members.div_ceil(2));
            fits(quotas.members.map(u64::from).or(half), members as u64 + 1)
        }
        Request::Subscribe { streams } => client.is_none() || streams <= STREAMS_OF_CLIENT_MAX,
        Request::Command(Command::AddBody { desc, .. }, config) => {
            let bodies = client.map_or(0, |client| ownership.bodies_of(client));
            let bodies = u64::from(bodies) + 1;
            damping_fits(desc)
                && fits(quotas.bodies.map(u64::from), bodies)
                && fits(quotas.load, body_steps(config).saturating_mul(bodies))
        }
        Request::Command(Command::ChangeBody { desc }, _) => damping_fits(desc),
        _ => true,
    }
}

/// Steps of one body in a second, substeps counted.
pub(crate) fn body_steps(config: &SceneConfig) -> u64 {
    let integrator = &config.integrator;
    let ticks = u64::from(integrator.rate.ticks());
    (ticks * u64::from(integrator.substeps.get())).div_ceil(u64::from(integrator.rate.seconds()))
}

/// Ticks in a second, rounded up.
pub(crate) fn ticks_in_second(config: &SceneConfig) -> u64 {
    let rate = config.integrator.rate;
    u64::from(rate.ticks().div_ceil(rate.seconds()))
}

impl From<Refused> for Denial {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::NotAllowed => Self::NotAllowed,
            Refused::OverQuota => Self::OverQuota,
        }
    }
}

impl From<Refused> for CommandError {
    fn from(refused: Refused) -> Self {
        match refused {
            Refused::NotAllowed => Self::NotAllowed,
            Refused::OverQuota => Self::OverQuota,
        }
    }
}

impl From<Refused> for AuthorityError {
    fn from(_: Refused) -> Self {
        Self::NotAllowed
    }
}

/// The name of a client in its tokens. It owns what it adds to a scene, over all its connections.
pub type ClientName = Arc<str>;

/// The rights of one connection.
#[derive(Clone, Debug, PartialEq)]
pub struct Permit {
    /// `None` without a token: then nothing in a scene belongs to the client.
    pub client: Option<ClientName>,
    /// What kind of requests it may make.
    pub role: Role,
    /// How much of the scene it may take.
    pub quotas: Quotas,
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
        },
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

    /// True if a command adds something that belongs to a client.
    pub(crate) const fn concerns(command: &Command) -> bool {
        matches!(
            command,
            Command::AddBody { .. } | Command::AddShape { .. } | Command::AddJoint { .. }
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

    /// Bodies of a client.
    fn bodies_of(&self, client: &ClientName) -> u32 {
        self.counts.get(client).copied().unwrap_or(0)
    }

    /// Number of a client's dampings if it adds a body.
    fn dampings_with(&self, client: &ClientName, desc: &BodyDesc) -> usize {
        let dampings = self.dampings.get(client);
        let known = dampings.map_or(0, BTreeSet::len);
        let is_new = damping_of(desc)
            .is_some_and(|damping| !dampings.is_some_and(|known| known.contains(&damping)));
        known + usize::from(is_new)
    }

    fn owns_body(&self, client: Option<&ClientName>, id: BodyId) -> bool {
        owns(&self.bodies, client, id)
    }

    fn owns_shape(&self, client: Option<&ClientName>, id: ShapeId) -> bool {
        owns(&self.shapes, client, id)
    }

    fn owns_joint(&self, client: Option<&ClientName>, id: JointId) -> bool {
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

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Vec3;
    use rhumb_protocol::scene::{BodyKind, Joint, JointFrame, JointId, JointKind, Shape, ShapeId};
    use rhumb_reckoning::Damping;

    use super::*;

    fn permit(client: &str, role: Role) -> Permit {
        Permit {
            client: Some(Arc::from(client)),
            role,
            quotas: Quotas::default(),
        }
    }

    fn add_body(index: u32) -> Command {
        let body = BodyDesc::dynamic(Shape::ball(0.5));
        let id = BodyId::new(index, 0);
        Command::AddBody {
            desc: body.desc(id, ShapeId(0)),
            motion: body.state().unwrap(),
        }
    }

    fn push(index: u32) -> Command {
        Command::Impulse {
            id: BodyId::new(index, 0),
            impulse: Vec3::X,
        }
    }

    fn join(members: usize) -> Request<'static> {
        Request::Join {
            members,
            scene_members: 64,
        }
    }

    fn decide(permit: &Permit, ownership: &Ownership, command: &Command) -> Result<(), Refused> {
        let config = SceneConfig::default();
        check(permit, ownership, Request::Command(command, &config))
    }

    #[test]
    fn a_role_includes_those_before_it() {
        let scene = Ownership::default();
        let config = SceneConfig::default();
        let gravity = Command::SetGravity {
            gravity: Vec3::ZERO,
        };
        let requests = [
            (join(0), Role::Observer),
            (Request::Reserve, Role::Controller),
            (Request::Advance, Role::Controller),
            (Request::TakeAuthority(&[]), Role::Controller),
            (Request::Create(&config), Role::Owner),
            (Request::Delete, Role::Owner),
            (Request::Command(&gravity, &config), Role::Owner),
        ];
        for (request, least) in requests {
            for role in [Role::Observer, Role::Controller, Role::Owner] {
                let allowed = check(&permit("anna", role), &scene, request).is_ok();
                assert_eq!(allowed, role >= least, "{request:?} by {role:?}");
            }
        }
    }

    #[test]
    fn a_controller_commands_what_its_client_added() {
        let mut scene = Ownership::default();
        let (anna, bert) = (
            permit("anna", Role::Controller),
            permit("bert", Role::Controller),
        );
        let owner = permit("carl", Role::Owner);
        for (of, index) in [(&anna, 1), (&bert, 2)] {
            assert_eq!(decide(of, &scene, &add_body(index)), Ok(()));
            scene.note(of.client.as_ref(), &add_body(index));
        }
        assert_eq!(decide(&anna, &scene, &push(1)), Ok(()));
        assert_eq!(decide(&anna, &scene, &push(2)), Err(Refused::NotAllowed));
        assert_eq!(decide(&owner, &scene, &push(2)), Ok(()));
        assert_eq!(decide(&Permit::OPEN, &scene, &push(2)), Ok(()));
        let both = [BodyId::new(1, 0), BodyId::new(2, 0)];
        for bodies in [&both[1..], &both] {
            let authority = check(&anna, &scene, Request::TakeAuthority(bodies));
            assert_eq!(authority, Err(Refused::NotAllowed));
        }
        let joint = Command::AddJoint {
            id: JointId(0),
            joint: Joint::plain(JointKind::Fixed, both, [JointFrame::at(Vec3::ZERO); 2]).into(),
        };
        assert_eq!(decide(&anna, &scene, &joint), Err(Refused::NotAllowed));
        let change = |index| Command::ChangeBody {
            desc: BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, ShapeId(0)),
        };
        assert_eq!(decide(&anna, &scene, &change(1)), Ok(()));
        assert_eq!(decide(&anna, &scene, &change(2)), Err(Refused::NotAllowed));
        scene.remove_body(both[0]);
        assert_eq!(decide(&anna, &scene, &push(1)), Err(Refused::NotAllowed));
    }

    #[test]
    fn quotas_count_the_bodies_of_the_client() {
        let mut scene = Ownership::default();
        let mut anna = permit("anna", Role::Controller);
        anna.quotas.bodies = Some(2);
        for index in 0..2 {
            assert_eq!(decide(&anna, &scene, &add_body(index)), Ok(()));
            scene.note(anna.client.as_ref(), &add_body(index));
        }
        assert_eq!(decide(&anna, &scene, &add_body(2)), Err(Refused::OverQuota));
        scene.remove_body(BodyId::new(0, 0));
        assert_eq!(decide(&anna, &scene, &add_body(2)), Ok(()));
        // One body at 60 ticks a second: the second body would exceed the load.
        let steps = body_steps(&SceneConfig::default());
        anna.quotas.load = Some(2 * steps - 1);
        assert_eq!(decide(&anna, &scene, &add_body(2)), Err(Refused::OverQuota));
        anna.quotas.members = Some(1);
        for (members, allowed) in [(0, true), (1, false)] {
            let join = check(&anna, &scene, join(members));
            assert_eq!(join.is_ok(), allowed);
        }
    }

    #[test]
    fn one_client_cannot_take_all_slots_of_a_scene() {
        let mut scene = Ownership::default();
        let anna = permit("anna", Role::Controller);
        let damped = |index: u32| {
            let linear = index as f32;
            let damping = Damping {
                linear,
                angular: 0.0,
            };
            let body = BodyDesc::dynamic(Shape::ball(0.5)).damping(damping);
            Command::AddBody {
                desc: body.desc(BodyId::new(index, 0), ShapeId(0)),
                motion: body.state().unwrap(),
            }
        };
        for index in 0..16 {
            assert_eq!(decide(&anna, &scene, &damped(index)), Ok(()), "{index}");
            scene.note(anna.client.as_ref(), &damped(index));
        }
        assert_eq!(decide(&anna, &scene, &damped(16)), Err(Refused::OverQuota));
        assert_eq!(decide(&anna, &scene, &damped(3)), Ok(()));
        assert_eq!(decide(&Permit::OPEN, &scene, &damped(16)), Ok(()));
        for (request, allowed) in [
            (join(31), true),
            (join(32), false),
            (Request::Subscribe { streams: 4 }, true),
            (Request::Subscribe { streams: 5 }, false),
        ] {
            let decided = check(&anna, &scene, request);
            assert_eq!(decided.is_ok(), allowed, "{request:?}");
        }
    }
}
