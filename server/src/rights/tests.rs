//! Tests of the rights of clients.

use std::sync::Arc;

use glam::Vec3;
use rhumb_protocol::Instant;
use rhumb_protocol::message::{Grease, StreamChoice};
use rhumb_protocol::scene::{Joint, JointFrame, JointId, JointKind, Material, Shape, ShapeId};
use rhumb_reckoning::Damping;

use super::*;
use crate::permit::Quotas;

fn permit(client: &str, role: Role) -> Permit {
    Permit {
        client: Some(Arc::from(client)),
        role,
        quotas: Quotas::default(),
        owns: false,
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
    let steps = load::body_steps(&SceneConfig::default());
    anna.quotas.load = Some(2 * steps - 1);
    assert_eq!(decide(&anna, &scene, &add_body(2)), Err(Refused::OverQuota));
    anna.quotas.members = Some(1);
    for (members, allowed) in [(0, true), (1, false)] {
        let join = check(&anna, &scene, join(members));
        assert_eq!(join.is_ok(), allowed);
    }
}

const ANNA: Peer = Peer(1);

/// A scene, its owners and its only member.
struct Setup {
    scene: Scene,
    ownership: Ownership,
    authority_table: AuthorityTable,
    clients: Clients,
    limits: Limits,
    load: SceneLoad,
}

impl Setup {
    fn new(config: SceneConfig, limits: Limits) -> Self {
        let settings = SceneSettings {
            limits,
            ..SceneSettings::new(|| Instant::ZERO)
        };
        let mut clients = Clients::new(limits);
        clients.open(ANNA, Grease::new(0));
        let ids = IdRange::new(0, 8, 0).into_iter().collect();
        let stream = (StreamId(0), StreamChoice::Full);
        if let Some(client) = clients.get_mut(ANNA) {
            client.member = Some(Member::new(stream, (None, ids), 0));
        }
        Self {
            scene: Scene::new(config).unwrap(),
            ownership: Ownership::default(),
            authority_table: AuthorityTable::default(),
            clients,
            limits,
            load: settings.load_of(&"pit".parse().unwrap(), &config),
        }
    }

    fn rights<'a>(&'a self, permit: &'a Permit, is_faulted: bool) -> Rights<'a> {
        Rights {
            peer: ANNA,
            permit,
            scene: &self.scene,
            is_faulted,
            owner: None,
            is_fed: false,
            ownership: &self.ownership,
            authority_table: &self.authority_table,
            clients: &self.clients,
            limits: &self.limits,
        }
    }
}

impl Setup {
    /// Decides about a command; one that is refused reserves nothing.
    fn decide(
        mut self,
        permit: &Permit,
        is_faulted: bool,
        command: &Command,
    ) -> Result<(), CommandError> {
        let reserved = self.load.reserved();
        self.rights(permit, is_faulted).command(command)?;
        let (scene, table) = (&self.scene, &self.authority_table);
        let admitted = admit(command, scene, table, &self.limits, &mut self.load);
        assert!(admitted.is_ok() || self.load.reserved() == reserved);
        admitted
    }
}

#[test]
fn a_command_is_refused_for_the_first_of_its_reasons() {
    let limits = |bodies_per_scene, scene_load| Limits {
        bodies_per_scene,
        scene_load,
        ..Limits::default()
    };
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..SceneConfig::default()
    };
    let Command::AddBody { mut desc, motion } = add_body(9) else {
        panic!("no body");
    };
    desc.material = Some(Material {
        friction: -1.0,
        ..config.material
    });
    let foreign = Command::AddBody { desc, motion };
    desc.id = BodyId::new(1, 0);
    let wrong = Command::AddBody { desc, motion };
    let right = add_body(1);
    let full = limits(0, 0);
    let observer = permit("anna", Role::Observer);
    let controller = permit("anna", Role::Controller);
    let mut poor = controller.clone();
    poor.quotas.bodies = Some(0);
    let overloaded = CommandError::Overloaded {
        retry_seconds: load::RETRY_SECONDS,
    };
    let reasons = [
        (&observer, true, &foreign, full, CommandError::NotAllowed),
        (&poor, true, &foreign, full, CommandError::OverQuota),
        (
            &controller,
            true,
            &foreign,
            full,
            CommandError::SceneFaulted,
        ),
        (
            &controller,
            false,
            &foreign,
            full,
            CommandError::NotGranted(BodyId::new(9, 0)),
        ),
        (
            &controller,
            false,
            &wrong,
            full,
            CommandError::Invalid(wrong.check().unwrap_err()),
        ),
        (
            &controller,
            false,
            &right,
            full,
            CommandError::TooManyBodies,
        ),
        (&controller, false, &right, limits(1, 0), overloaded),
    ];
    for (permit, is_faulted, command, limits, reason) in reasons {
        let setup = Setup::new(config, limits);
        assert_eq!(setup.decide(permit, is_faulted, command), Err(reason));
    }
}

#[test]
fn an_advance_is_refused_for_the_first_of_its_reasons() {
    let config = |stepping| SceneConfig {
        stepping,
        ..SceneConfig::default()
    };
    let lockstep = Setup::new(config(Stepping::Lockstep), Limits::default());
    let free = Setup::new(config(Stepping::FreeRunning), Limits::default());
    let observer = permit("anna", Role::Observer);
    let (far, near) = (
        Tick::new(ADVANCE_TICKS_MAX + 1),
        Tick::new(ADVANCE_TICKS_MAX),
    );
    for (setup, permit, is_faulted, to, decided) in [
        (&free, &observer, true, far, Err(Denial::AdvanceNotAllowed)),
        (&free, &Permit::OPEN, true, far, Err(Denial::NotLockstep)),
        (
            &lockstep,
            &Permit::OPEN,
            true,
            far,
            Err(Denial::SceneFaulted),
        ),
        (
            &lockstep,
            &Permit::OPEN,
            false,
            far,
            Err(Denial::TooFarAhead),
        ),
        (&lockstep, &Permit::OPEN, false, near, Ok(())),
    ] {
        assert_eq!(setup.rights(permit, is_faulted).advance(to), decided);
    }
}

#[test]
fn a_missing_right_is_named_before_the_fault_of_a_scene() {
    let setup = Setup::new(SceneConfig::default(), Limits::default());
    let mut barred = permit("anna", Role::Observer);
    barred.quotas.members = Some(0);
    let observer = permit("anna", Role::Observer);
    let bodies = [BodyId::new(1, 0)];
    let rights = setup.rights(&barred, true);
    assert_eq!(rights.join(None, None), Err(Denial::OverQuota));
    assert_eq!(rights.reserve(), Err(Denial::NotAllowed));
    let rights = setup.rights(&observer, true);
    assert_eq!(rights.join(None, None), Err(Denial::SceneFaulted));
    assert_eq!(rights.subscribe(None), Err(Denial::SceneFaulted));
    let refused = rights.take_authority(&bodies);
    assert_eq!(refused, Err(AuthorityError::NotAllowed));
    let refused = setup.rights(&Permit::OPEN, true).take_authority(&bodies);
    assert_eq!(refused, Err(AuthorityError::SceneFaulted));
}

#[test]
fn a_scene_with_wrong_settings_is_refused_for_them_by_a_full_server_too() {
    let settings = |scenes| SceneSettings {
        limits: Limits {
            scenes,
            ..Limits::default()
        },
        ..SceneSettings::new(|| Instant::ZERO)
    };
    let wrong = SceneConfig {
        gravity: Vec3::splat(f32::NAN),
        ..SceneConfig::default()
    };
    for scenes in [0, 1] {
        let name = "pit".parse().unwrap();
        let refused = admit_scene(&name, &wrong, &settings(scenes)).map(|_| ());
        assert!(
            matches!(refused, Err(Denial::InvalidConfig(_))),
            "{refused:?}"
        );
    }
    let (name, config) = ("pit".parse().unwrap(), SceneConfig::default());
    let refused = admit_scene(&name, &config, &settings(0)).map(|_| ());
    assert_eq!(refused, Err(Denial::TooManyScenes));
}

#[test]
fn a_client_that_takes_its_session_up_needs_no_second_place() {
    let limits = Limits {
        members_per_scene: 1,
        ..Limits::default()
    };
    let setup = Setup::new(SceneConfig::default(), limits);
    let again = Permit::OPEN;
    let rights = setup.rights(&again, false);
    assert_eq!(rights.join(None, Some(ANNA)), Ok(()));
    assert_eq!(rights.join(None, None), Err(Denial::TooManyMembers));
}

#[test]
fn one_controller_takes_half_of_a_scene_s_shapes() {
    let mut setup = Setup::new(SceneConfig::default(), Limits::default());
    let anna = permit("anna", Role::Controller);
    let shape = |id: u32| Command::AddShape {
        id: ShapeId(id),
        shape: Shape::ball(0.5),
    };
    for id in 0..SHAPES_MAX / 2 {
        setup.scene.apply(&shape(id)).unwrap();
        setup.ownership.note(anna.client.as_ref(), &shape(id));
    }
    let one_more = shape(SHAPES_MAX - 1);
    let refused = setup.rights(&anna, false).command(&one_more);
    assert_eq!(refused, Err(CommandError::OverQuota));
    for other in [
        permit("bert", Role::Controller),
        permit("anna", Role::Owner),
        Permit::OPEN,
    ] {
        assert_eq!(setup.rights(&other, false).command(&one_more), Ok(()));
    }
    let removed = Command::RemoveShape { id: ShapeId(0) };
    setup.ownership.note(anna.client.as_ref(), &removed);
    assert_eq!(setup.rights(&anna, false).command(&one_more), Ok(()));
}

#[test]
fn a_tenant_without_a_place_creates_no_scene() {
    let mut anna = permit("anna", Role::Owner);
    let config = SceneConfig::default();
    for (scenes, created) in [
        (None, Ok(())),
        (Some(1), Ok(())),
        (Some(0), Err(Denial::OverQuota)),
    ] {
        anna.quotas.scenes = scenes;
        assert_eq!(create(&anna, &config), created);
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
