//! The one place that decides what a client may do.
//!
//! Roles decide what kind of request; ownership, which bodies, shapes and joints; quotas, how much; then come the state of
//! the scene and the limits of the server. A client learns the first reason that holds, in the order of this file.
//! The numbers of a request are checked where it is carried out, and `member` bounds how fast requests may
//! come. Invariant: a refused request reserves nothing.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::Peer;
use rhumb_protocol::limits::{
    ADVANCE_TICKS_MAX, DAMPINGS_MAX, SHAPE_BYTES_PER_SCENE_MAX, SHAPES_MAX, STREAMS_PER_SCENE_MAX,
};
use rhumb_protocol::message::{AuthorityError, Denial, Role};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Cell, Command, CommandError, IdRange, Invalid, Quantity, SceneConfig,
    SceneName, Shape, Stepping,
};
use rhumb_reckoning::{BodyId, Tick};

use crate::bodies_by_cell::TAKEN_CELLS_MAX;
use crate::clients::AuthorityTable;
use crate::clients::Clients;
use crate::load::{self, SceneLoad, SceneSlot};
use crate::member::{Member, Subscribed};
use crate::permit;
use crate::permit::{Ownership, Permit};
use crate::scene::Scene;
use crate::settings::{Limits, SceneSettings};

/// Decides whether a client may create a scene.
pub(crate) fn create(permit: &Permit, config: &SceneConfig) -> Result<(), Denial> {
    Ok(check(
        permit,
        &Ownership::default(),
        Request::Create(config),
    )?)
}

/// Decides whether a client may delete a scene, which a client may own.
pub(crate) fn delete(peer: Peer, permit: &Permit, owner: Option<Peer>) -> Result<(), Denial> {
    check(permit, &Ownership::default(), Request::Delete)?;
    match owner {
        Some(owner) if owner != peer => Err(Denial::Owned),
        _ => Ok(()),
    }
}

/// Reserves a place and processor time for a scene, if the server admits it.
pub(crate) fn admit_scene(
    name: &SceneName,
    config: &SceneConfig,
    settings: &SceneSettings,
) -> Result<(SceneSlot, SceneLoad), Denial> {
    config.check().map_err(Denial::InvalidConfig)?;
    let ticks = load::ticks_in_second(config);
    if config.stepping == Stepping::FreeRunning && ticks > settings.limits.scene_ticks_per_second {
        let rate = Invalid::out_of_range(Quantity::Rate);
        return Err(Denial::InvalidConfig(rate));
    }
    let slot = settings.take_slot().ok_or(Denial::TooManyScenes)?;
    let load = settings.load_of(name, config);
    if !load.has_room() {
        let retry_seconds = load::RETRY_SECONDS;
        return Err(Denial::Overloaded { retry_seconds });
    }
    Ok((slot, load))
}

/// A client of a scene, and the state of the scene that decides what the client may do.
pub(crate) struct Rights<'a> {
    pub(crate) peer: Peer,
    pub(crate) permit: &'a Permit,
    pub(crate) scene: &'a Scene,
    pub(crate) is_faulted: bool,
    /// The client that owns the scene, if one does.
    pub(crate) owner: Option<Peer>,
    /// True if the owner feeds the scene: to ask for a tick steps nothing then.
    pub(crate) is_fed: bool,
    pub(crate) ownership: &'a Ownership,
    pub(crate) authority_table: &'a AuthorityTable,
    pub(crate) clients: &'a Clients,
    pub(crate) limits: &'a Limits,
}

impl Rights<'_> {
    /// Decides whether the client may become a member. `wanted`: the stream of its choice, `None` if that has yet to begin.
    /// `replaced`: the member whose session it takes up.
    pub(crate) fn join(
        &self,
        wanted: Option<StreamId>,
        replaced: Option<Peer>,
    ) -> Result<(), Denial> {
        let scene_members = self.limits.members_per_scene;
        self.check(Request::Join {
            members: self.members_of_client(replaced).count(),
            scene_members,
        })?;
        self.check_streams(wanted, replaced)?;
        if self.is_faulted {
            return Err(Denial::SceneFaulted);
        }
        let members = self.clients.members();
        let members = members.filter(|(peer, ..)| Some(*peer) != replaced);
        if members.count() as u64 >= scene_members {
            return Err(Denial::TooManyMembers);
        }
        Ok(())
    }

    /// Decides whether a member may subscribe to another stream; `None` for one that has yet to begin.
    pub(crate) fn subscribe(&self, wanted: Option<StreamId>) -> Result<(), Denial> {
        self.check_streams(wanted, None)?;
        match self.is_faulted {
            true => Err(Denial::SceneFaulted),
            false => Ok(()),
        }
    }

    /// Decides whether a member may take a cell by a stream; `None` for one that has yet to begin.
    pub(crate) fn take_cell(&self, cell: Cell, wanted: Option<StreamId>) -> Result<(), Denial> {
        if self.is_faulted {
            return Err(Denial::SceneFaulted);
        }
        if self.permit.client.is_none() {
            return Ok(());
        }
        let members = || self.members_of_client(None);
        let taken = || members().filter_map(|member| member.cells.as_ref());
        let of_cell = taken().filter_map(|cells| cells.get(&cell));
        let mut streams: BTreeSet<StreamId> = of_cell.flat_map(Subscribed::streams).collect();
        streams.extend(wanted);
        let streams = streams.len() + usize::from(wanted.is_none());
        let check = |cells| self.check(Request::TakeCell { cells, streams });
        // Those that several of its members take count once: they are counted only if it matters.
        let most = taken().map(BTreeMap::len).sum::<usize>() + 1;
        let allowed = check(most).or_else(|_| {
            let mut cells: BTreeSet<Cell> = taken().flat_map(BTreeMap::keys).copied().collect();
            cells.insert(cell);
            check(cells.len())
        });
        allowed.map_err(|_| Denial::TooManyStreams)
    }

    /// Decides whether a member may ask for more body indices. `IdRanges` decides how many there are for it.
    pub(crate) fn reserve(&self) -> Result<(), Denial> {
        Ok(self.check(Request::Reserve)?)
    }

    /// Decides whether a member may have the scene step up to a tick.
    pub(crate) fn advance(&self, to: Tick) -> Result<(), Denial> {
        let allowed = self.check(Request::Advance);
        allowed.map_err(|_| Denial::AdvanceNotAllowed)?;
        let too_far = to.value() > self.scene.tick().value() + ADVANCE_TICKS_MAX;
        match self.scene.config().stepping {
            Stepping::FreeRunning => Err(Denial::NotLockstep),
            Stepping::Lockstep
                if self.owner.is_some_and(|owner| owner != self.peer) && !self.is_fed =>
            {
                Err(Denial::Owned)
            }
            Stepping::Lockstep if self.is_faulted => Err(Denial::SceneFaulted),
            Stepping::Lockstep if too_far => Err(Denial::TooFarAhead),
            Stepping::Lockstep => Ok(()),
        }
    }

    /// Decides whether the client may give a command. [`admit`] decides whether the scene takes it.
    pub(crate) fn command(&self, command: &Command) -> Result<(), CommandError> {
        self.check(Request::Command(command, self.scene.config()))?;
        if let Command::AddShape { shape, .. } = command
            && !has_share_of_shapes(self.permit, self.ownership, self.scene, shape)
        {
            return Err(CommandError::OverQuota);
        }
        if self.is_faulted {
            return Err(CommandError::SceneFaulted);
        }
        match command {
            Command::AddBody { desc, .. } if !permit::has(self.ids(), desc.id) => {
                Err(CommandError::NotGranted(desc.id))
            }
            _ => Ok(()),
        }
    }

    /// Decides whether a member may take authority over bodies.
    pub(crate) fn take_authority(&self, bodies: &[BodyId]) -> Result<(), AuthorityError> {
        self.check(Request::TakeAuthority(bodies))?;
        if self.is_faulted {
            return Err(AuthorityError::SceneFaulted);
        }
        for id in bodies {
            self.check_authority(*id)?;
        }
        Ok(())
    }

    fn check_authority(&self, id: BodyId) -> Result<(), AuthorityError> {
        let desc = self.scene.body(id).ok_or(AuthorityError::UnknownBody(id))?;
        if desc.kind != BodyKind::Kinematic {
            return Err(AuthorityError::NotKinematic(id));
        }
        let members = self.clients.members();
        let others = members.filter(|(peer, ..)| *peer != self.peer);
        let mut of_others = others.map(|(.., member)| &member.ids);
        if of_others.any(|ids| permit::has(ids, id)) {
            return Err(AuthorityError::NotYours(id));
        }
        let authority = self.authority_table.authority_of(id);
        if authority.is_some_and(|peer| peer != self.peer) {
            return Err(AuthorityError::HeldByAnother(id));
        }
        Ok(())
    }

    fn check_streams(
        &self,
        wanted: Option<StreamId>,
        replaced: Option<Peer>,
    ) -> Result<(), Denial> {
        let members = self.members_of_client(replaced);
        let mut streams: BTreeSet<StreamId> = members.flat_map(Member::streams).collect();
        streams.extend(wanted);
        let streams = streams.len() + usize::from(wanted.is_none());
        let allowed = self.check(Request::Subscribe { streams });
        allowed.map_err(|_| Denial::TooManyStreams)
    }

    fn check(&self, request: Request<'_>) -> Result<(), Refused> {
        check(self.permit, self.ownership, request)
    }

    /// The memberships of the client, but for one.
    fn members_of_client(&self, but: Option<Peer>) -> impl Iterator<Item = &Member> {
        let members = self.clients.members();
        let members = members.filter(move |(peer, client, _)| {
            Some(*peer) != but && client.permit.client == self.permit.client
        });
        members.map(|(.., member)| member)
    }

    /// The body indices of the client.
    fn ids(&self) -> &[IdRange] {
        let member = self.clients.member(self.peer);
        member.map_or(&[], |member| &member.ids)
    }
}

/// Decides whether a scene takes a command, from a client or its own script, and reserves what the command costs.
pub(crate) fn admit(
    command: &Command,
    scene: &Scene,
    authority_table: &AuthorityTable,
    limits: &Limits,
    load: &mut SceneLoad,
) -> Result<(), CommandError> {
    match *command {
        // Only the member with authority over a body moves it.
        Command::SetPose { id, .. }
        | Command::SetVelocity { id, .. }
        | Command::SetLocomotion { id, .. }
        | Command::Jump { id, .. }
        | Command::ChangeBody {
            desc: BodyDesc { id, .. },
        } if authority_table.authority_of(id).is_some() => {
            return Err(CommandError::UnderAuthority(id));
        }
        _ => {}
    }
    let is_admitted = match command {
        Command::AddBody { .. } => {
            // Its numbers come before what the server admits.
            command.check().map_err(CommandError::Invalid)?;
            if scene.body_count() as u64 >= limits.bodies_per_scene {
                return Err(CommandError::TooManyBodies);
            }
            load.add_body()
        }
        Command::SetLocomotion { id, locomotion } => {
            command.check().map_err(CommandError::Invalid)?;
            let before = load::locomotion_steps(scene.locomotion(*id).into_iter());
            let others = load::locomotion_steps(scene.locomotions()) - before;
            let asked = load::locomotion_steps(std::iter::once(&**locomotion));
            load.set_locomotion(others + asked)
        }
        _ => true,
    };
    let retry_seconds = load::RETRY_SECONDS;
    is_admitted
        .then_some(())
        .ok_or(CommandError::Overloaded { retry_seconds })
}

/// True if the role, the ownership and the quotas of a client include a command.
pub(crate) fn includes(
    permit: &Permit,
    ownership: &Ownership,
    command: &Command,
    config: &SceneConfig,
) -> bool {
    check(permit, ownership, Request::Command(command, config)).is_ok()
}

/// True unless a client with another shape would have more than its share of the scene's shapes. An owner of the scene may
/// have all.
pub(crate) fn has_share_of_shapes(
    permit: &Permit,
    ownership: &Ownership,
    scene: &Scene,
    shape: &Shape,
) -> bool {
    let client = match &permit.client {
        Some(client) if permit.role < Role::Owner => client,
        _ => return true,
    };
    let (mut count, mut bytes) = (1, shape.bytes());
    for id in ownership.shapes_of(client) {
        count += 1;
        bytes += scene.shape(id).map_or(0, Shape::bytes);
    }
    count <= SHAPES_OF_CLIENT_MAX && bytes <= SHAPE_BYTES_OF_CLIENT_MAX
}

/// Streams of one client in a scene: half of all.
const STREAMS_OF_CLIENT_MAX: usize = STREAMS_PER_SCENE_MAX / 2;
/// Cells that one client takes in a scene: half of all.
const CELLS_OF_CLIENT_MAX: usize = TAKEN_CELLS_MAX / 2;
/// Different dampings that the bodies of one client ever had: a quarter of all, since a scene keeps them.
const DAMPINGS_OF_CLIENT_MAX: usize = DAMPINGS_MAX / 4;

/// Shapes of one controller in a scene, and their bytes: half of all.
const SHAPES_OF_CLIENT_MAX: usize = SHAPES_MAX as usize / 2;
const SHAPE_BYTES_OF_CLIENT_MAX: usize = SHAPE_BYTES_PER_SCENE_MAX / 2;

/// A request, as far as the permit of a client decides about it.
#[derive(Clone, Copy, Debug)]
enum Request<'a> {
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
    /// The cells that all members of the client would take, and their streams of one of them.
    TakeCell {
        cells: usize,
        streams: usize,
    },
    Reserve,
    Advance,
    Command(&'a Command, &'a SceneConfig),
    TakeAuthority(&'a [BodyId]),
}

/// Reason of a permit to refuse a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Refused {
    NotAllowed,
    OverQuota,
}

/// Decides by role, ownership and quotas.
fn check(permit: &Permit, ownership: &Ownership, request: Request<'_>) -> Result<(), Refused> {
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
        Request::Join { .. } | Request::Subscribe { .. } | Request::TakeCell { .. } => {
            Role::Observer
        }
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
        Request::Create(config) => {
            fits(quotas.load, load::body_steps(config)) && fits(quotas.scenes.map(u64::from), 1)
        }
        Request::Join {
            members,
            scene_members,
        } => {
            // Unless its token says otherwise, a client has half of the members.
            let half = client.map(|_| scene_members.div_ceil(2));
            fits(quotas.members.map(u64::from).or(half), members as u64 + 1)
        }
        Request::Subscribe { streams } => client.is_none() || streams <= STREAMS_OF_CLIENT_MAX,
        Request::TakeCell { cells, streams } => {
            client.is_none() || cells <= CELLS_OF_CLIENT_MAX && streams <= STREAMS_OF_CLIENT_MAX
        }
        Request::Command(Command::AddBody { desc, .. }, config) => {
            let bodies = client.map_or(0, |client| ownership.bodies_of(client));
            let bodies = u64::from(bodies) + 1;
            damping_fits(desc)
                && fits(quotas.bodies.map(u64::from), bodies)
                && fits(quotas.load, load::body_steps(config).saturating_mul(bodies))
        }
        Request::Command(Command::ChangeBody { desc }, _) => damping_fits(desc),
        _ => true,
    }
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

#[cfg(test)]
mod tests;
