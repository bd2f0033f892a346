//! The one place that decides which request a client may make.
//!
//! Roles decide what kind of request; ownership, which bodies, shapes and joints; quotas, how much. All else that may
//! be wrong with a request is checked where it is carried out.

mod ownership;
mod permit;

use rhumb_protocol::limits::{DAMPINGS_MAX, STREAMS_PER_SCENE_MAX};
use rhumb_protocol::message::{AuthorityError, Denial, Role};
use rhumb_protocol::scene::{BodyDesc, Command, CommandError, SceneConfig};
use rhumb_reckoning::BodyId;

pub(crate) use self::ownership::decode_client;
pub use self::ownership::{Ownership, decode_client_of, encode_client_of};
pub use self::permit::{ClientName, Permit, Quotas};

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
