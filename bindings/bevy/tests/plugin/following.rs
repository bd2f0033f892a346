//! Entities follow the bodies of a scene: they come, move, and go.

use bevy_ecs::prelude::*;
use bevy_math::{Quat, Vec3};
use bevy_transform::components::{GlobalTransform, Transform};
use rhumb_bevy::{RhumbBodyId, RhumbClient, RhumbErrorBound, RhumbState};
use rhumb_client::glam;
use rhumb_client::scene::{BodyBuilder, BodyDesc, Shape, Stepping};
use rhumb_client::{
    BodyId, Client, Event, JoinMode, JoinOptions, Metres, PipelineDepth, StreamChoice, Tolerance,
};

use crate::arena::{app, component, entity, messages, rhumb, run_until};
use crate::server::{Server, advance_beyond, show_tick};

/// The stream of the copies: within 5 cm.
const COPY: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// The same in metres.
const TOLERANCE: f64 = 0.05;

fn floor() -> BodyBuilder {
    BodyDesc::fixed(Shape::cuboid(20.0, 0.5, 20.0)).at(0.0, -0.5, 0.0)
}

fn ball(x: f32, y: f32) -> BodyBuilder {
    BodyDesc::dynamic(Shape::ball(0.5)).at(x, y, 0.1 * x)
}

fn position(app: &mut bevy_app::App, id: BodyId) -> Vec3 {
    component::<RhumbState>(app, id).position
}

/// The exact place and rotation of a body, in Bevy's types.
fn exact(truth: &Client, id: BodyId) -> (Vec3, Quat) {
    let view = truth.view();
    let (at, turned) = (view.position(id), view.rotation(id));
    let at: glam::Vec3 = at.expect("the truth has the body");
    let turned: glam::Quat = turned.expect("the truth has the body");
    (
        Vec3::from_array(at.to_array()),
        Quat::from_array(turned.to_array()),
    )
}

#[test]
fn each_tick_shows_each_body_within_the_tolerance_and_the_bound_of_the_truth() {
    let server = Server::start();
    let client = server.join("fall", Stepping::Lockstep, COPY);
    let mut truth = server.join("fall", Stepping::Lockstep, StreamChoice::Full);
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(client));
    rhumb(&mut app).add_body(floor()).unwrap();
    let balls: Vec<_> = (0..12_u8)
        .map(|i| ball(f32::from(i % 4) - 1.5, 2.0 + 1.1 * f32::from(i)))
        .map(|ball| rhumb(&mut app).add_body(ball).unwrap())
        .collect();
    let (mut bounded, mut farthest) = (0, 0.0_f64);
    for step in 1..=240 {
        app.update();
        if step == 1 {
            for id in &balls {
                let entity = entity(&mut app, *id).expect("placed in the first tick");
                app.world_mut()
                    .entity_mut(entity)
                    .insert(RhumbErrorBound::default());
            }
        }
        let tick = rhumb(&mut app).inner().view().time().expect("a view").tick;
        assert_eq!(tick.value(), step, "each fixed step is a tick");
        show_tick(&mut truth, tick);
        for id in &balls {
            let state = component::<RhumbState>(&mut app, *id);
            let (at, turned) = exact(&truth, *id);
            let off = f64::from(state.position.distance(at));
            farthest = farthest.max(off);
            assert!(off <= TOLERANCE, "{id:?} at {tick}: {off} m");
            assert!(state.rotation.dot(turned).abs() > 0.98, "{id:?} at {tick}");
            if let Some(bound) = component::<RhumbErrorBound>(&mut app, *id)
                .metres
                .filter(|_| step > 1)
            {
                assert!(
                    off <= bound,
                    "{id:?} at {tick}: {off} m off, bound {bound} m"
                );
                bounded += 1;
            }
        }
    }
    assert!(
        bounded > 12 * 200,
        "bounds are known without loss: {bounded}"
    );
    assert!(farthest > 0.0, "the copy is not the truth itself");
    for id in &balls {
        assert!(position(&mut app, *id).y < 14.0 * 0.5, "{id:?} fell");
        let drawn = component::<GlobalTransform>(&mut app, *id).translation();
        assert_eq!(drawn, component::<Transform>(&mut app, *id).translation);
    }
}

#[test]
fn balls_of_a_free_running_scene_fall_and_come_to_rest_where_the_truth_has_them() {
    let server = Server::start();
    let client = server.join("free", Stepping::FreeRunning, COPY);
    let mut truth = server.join("free", Stepping::FreeRunning, StreamChoice::Full);
    let mut app = app(PipelineDepth::PIPELINED);
    app.insert_resource(RhumbClient::new(client));
    rhumb(&mut app).add_body(floor()).unwrap();
    let ids: Vec<_> = (0..3_u8)
        .map(|i| ball(2.0 * f32::from(i), 3.0))
        .map(|ball| rhumb(&mut app).add_body(ball).unwrap())
        .collect();
    let mut seen_in_the_air = false;
    run_until(&mut app, "the balls lie still", |app| {
        if entity(app, ids[2]).is_none() {
            return false;
        }
        let lowest = ids
            .iter()
            .map(|id| position(app, *id).y)
            .fold(f32::MAX, f32::min);
        seen_in_the_air |= (0.7..2.9).contains(&lowest);
        let state = |id: &BodyId| component::<RhumbState>(app, *id);
        lowest < 0.6
            && ids
                .iter()
                .map(state)
                .all(|state| state.linear_velocity == Vec3::ZERO)
    });
    assert!(seen_in_the_air, "the fall is shown, not only its end");
    truth.idle(std::time::Duration::from_millis(100)).unwrap();
    truth.poll().unwrap();
    for id in ids {
        let bound = rhumb(&mut app).error_bound(id).expect("a body of the copy");
        let off = f64::from(position(&mut app, id).distance(exact(&truth, id).0));
        assert!(off <= TOLERANCE, "{off} m, {bound}");
        assert_eq!(
            component::<Transform>(&mut app, id).translation,
            position(&mut app, id)
        );
    }
}

#[test]
fn a_body_that_another_member_removes_takes_its_entity_with_it() {
    let server = Server::start();
    let mut other = server.join("gone", Stepping::Lockstep, COPY);
    let kept = other.add_body(ball(0.0, 5.0)).unwrap();
    let removed = other.add_body(ball(3.0, 5.0)).unwrap();
    other.advance(PipelineDepth::LOCKSTEP).unwrap();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "gone",
        Stepping::Lockstep,
        COPY,
    )));
    app.update();
    assert!(
        entity(&mut app, kept).is_some(),
        "bodies from before the client joined are shown"
    );
    let entity_of_removed = entity(&mut app, removed).expect("shown");
    other
        .command(rhumb_client::scene::Command::RemoveBody { id: removed })
        .unwrap();
    let shown = rhumb(&mut app).inner().view().time().expect("shown").tick;
    advance_beyond(&mut other, shown);
    app.update();
    assert!(
        app.world().get_entity(entity_of_removed).is_err(),
        "despawned"
    );
    assert_eq!(rhumb(&mut app).entity(removed), None);
    assert!(entity(&mut app, kept).is_some());
    let is_said = |event: &Event| matches!(event, Event::BodyRemoved { id, .. } if *id == removed);
    assert_eq!(
        messages(&app)
            .events
            .iter()
            .filter(|event| is_said(event))
            .count(),
        1
    );
}

#[test]
fn commands_from_an_app_move_and_remove_bodies() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "push",
        Stepping::Lockstep,
        COPY,
    )));
    let id = rhumb(&mut app)
        .add_body(ball(0.0, 5.0).gravity_scale(0.0))
        .unwrap();
    app.update();
    assert_eq!(rhumb(&mut app).shape(id), Some(&Shape::ball(0.5)));
    assert_eq!(position(&mut app, id), Vec3::new(0.0, 5.0, 0.0));
    // A ball of water with a radius of half a metre has 523.6 kg.
    rhumb(&mut app)
        .apply_impulse(id, Vec3::new(0.0, 0.0, -523.6))
        .unwrap();
    (0..60).for_each(|_| app.update());
    let state = component::<RhumbState>(&mut app, id);
    assert!(
        (state.linear_velocity - Vec3::NEG_Z).length() < 0.05,
        "{state:?}"
    );
    assert!(
        state.position.distance(Vec3::new(0.0, 5.0, -1.0)) < 0.1,
        "{state:?}"
    );
    let quarter = Quat::from_rotation_y(std::f32::consts::FRAC_PI_2);
    rhumb(&mut app)
        .set_pose(id, Vec3::new(7.0, 8.0, 9.0), quarter)
        .unwrap();
    rhumb(&mut app)
        .set_velocity(id, Vec3::ZERO, Vec3::Y)
        .unwrap();
    rhumb(&mut app)
        .apply_torque_impulse(id, Vec3::ZERO)
        .unwrap();
    app.update();
    let state = component::<RhumbState>(&mut app, id);
    let place = Vec3::new(7.0, 8.0, 9.0);
    assert!(state.position.distance(place) <= 0.05, "{state:?}");
    assert!(
        (state.rotation * Vec3::X).distance(Vec3::NEG_Z) < 0.1,
        "{state:?}"
    );
    // A copy promises poses. Its velocities follow within some ticks.
    (0..60).for_each(|_| app.update());
    let state = component::<RhumbState>(&mut app, id);
    assert!(state.position.distance(place) <= 0.05, "{state:?}");
    assert!(
        (state.angular_velocity - Vec3::Y).length() < 0.1,
        "{state:?}"
    );
    rhumb(&mut app).remove_body(id).unwrap();
    app.update();
    assert_eq!(entity(&mut app, id), None);
    let refused = |event: &Event| matches!(event, Event::Refused { .. });
    assert!(!messages(&app).events.iter().any(refused));
}

#[test]
fn an_entity_of_the_application_stands_for_a_body_and_may_be_despawned() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "own",
        Stepping::Lockstep,
        COPY,
    )));
    let own = app
        .world_mut()
        .spawn((Name::new("mine"), Transform::from_scale(Vec3::splat(3.0))))
        .id();
    let id = rhumb(&mut app).add_body_as(own, ball(0.0, 5.0)).unwrap();
    app.update();
    assert_eq!(entity(&mut app, id), Some(own));
    assert_eq!(app.world().get::<Name>(own).map(Name::as_str), Some("mine"));
    assert_eq!(component::<Transform>(&mut app, id).scale, Vec3::splat(3.0));
    let height = component::<Transform>(&mut app, id).translation.y;
    assert!((4.9..=5.0).contains(&height), "{height}");
    app.world_mut().entity_mut(own).despawn();
    (0..10).for_each(|_| app.update());
    assert_eq!(entity(&mut app, id), None, "it is not spawned again");
    let height = rhumb(&mut app)
        .inner()
        .view()
        .position(id)
        .expect("the body lives on")
        .y;
    assert!(height < 5.0);
    rhumb(&mut app).remove_body(id).unwrap();
    app.update();
    assert!(messages(&app).endings.is_empty());
}

#[test]
fn an_entity_that_is_despawned_before_its_body_comes_is_not_replaced() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "hidden",
        Stepping::Lockstep,
        COPY,
    )));
    let own = app.world_mut().spawn_empty().id();
    let id = rhumb(&mut app).add_body_as(own, ball(0.0, 5.0)).unwrap();
    app.world_mut().entity_mut(own).despawn();
    (0..10).for_each(|_| app.update());
    let place = rhumb(&mut app).inner().view().place(id);
    assert!(place.is_some(), "the body lives on");
    assert_eq!(entity(&mut app, id), None);
    rhumb(&mut app).remove_body(id).unwrap();
    app.update();
    assert!(messages(&app).endings.is_empty());
}

#[test]
fn an_entity_of_the_application_goes_with_a_body_that_is_never_shown() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(server.join(
        "never",
        Stepping::Lockstep,
        COPY,
    )));
    let [removed, refused, shown] = [(); 3].map(|()| app.world_mut().spawn_empty().id());
    let id = rhumb(&mut app)
        .add_body_as(removed, ball(0.0, 5.0))
        .unwrap();
    rhumb(&mut app).remove_body(id).unwrap();
    // The server sweeps 64 bodies of a scene, and only it counts them.
    for x in 1..=64_u8 {
        let swept = ball(10.0 * f32::from(x), 50.0).swept();
        rhumb(&mut app).add_body(swept).unwrap();
    }
    let one_more = ball(0.0, 50.0).swept();
    rhumb(&mut app).add_body_as(refused, one_more).unwrap();
    let kept = rhumb(&mut app).add_body_as(shown, ball(3.0, 5.0)).unwrap();
    run_until(&mut app, "two entities are despawned", |app| {
        let is_gone = |own: &Entity| app.world().get_entity(*own).is_err();
        is_gone(&removed) && is_gone(&refused)
    });
    assert_eq!(entity(&mut app, id), None);
    assert_eq!(entity(&mut app, kept), Some(shown));
    let is_refusal = |event: &&Event| matches!(event, Event::Refused { .. });
    let refusals = messages(&app).events.iter().filter(is_refusal);
    assert_eq!(refusals.count(), 1);
    assert!(messages(&app).endings.is_empty());
}

#[test]
fn a_scene_that_is_removed_or_replaced_takes_its_entities_with_it() {
    let server = Server::start();
    let mut app = app(PipelineDepth::LOCKSTEP);
    let count = |app: &mut bevy_app::App| {
        app.world_mut()
            .query::<&RhumbBodyId>()
            .iter(app.world())
            .count()
    };
    for name in ["first", "second"] {
        app.insert_resource(RhumbClient::new(server.join(
            name,
            Stepping::Lockstep,
            COPY,
        )));
        rhumb(&mut app).add_body(floor()).unwrap();
        let id = rhumb(&mut app).add_body(ball(0.0, 5.0)).unwrap();
        app.update();
        assert_eq!(count(&mut app), 2, "of the {name} scene alone");
        assert!(entity(&mut app, id).is_some());
    }
    app.world_mut().remove_resource::<RhumbClient>();
    app.update();
    assert_eq!(count(&mut app), 0);
    app.update();
    assert!(messages(&app).endings.is_empty(), "to leave is no failure");
}

#[test]
fn the_entities_of_a_member_by_cells_come_and_go_with_its_point() {
    let server = Server::start_with(&["--cells", "10"]);
    let mut owner = server.join("around", Stepping::Lockstep, COPY);
    let balls = [5.0, 95.0].map(|x| {
        let ball = BodyDesc::fixed(Shape::ball(0.5)).at(x, 5.0, 5.0);
        owner.add_body(ball).unwrap()
    });
    owner.advance(PipelineDepth::LOCKSTEP).unwrap();
    let options = JoinOptions {
        mode: JoinMode::Join,
        cells: true,
        ..JoinOptions::default()
    };
    let client = server.connect().join_with("around", options).unwrap();
    let mut app = app(PipelineDepth::LOCKSTEP);
    app.insert_resource(RhumbClient::new(client));
    for (x, here, elsewhere) in [(5.0, balls[0], balls[1]), (95.0, balls[1], balls[0])] {
        let bands = [(Metres::new(8.0), COPY)];
        let mut rhumb_client = rhumb(&mut app);
        let taken = rhumb_client
            .inner()
            .take_cells_around([x, 5.0, 5.0], &bands);
        taken.unwrap();
        run_until(&mut app, "the cells are shown", |app| {
            entity(app, here).is_some() && entity(app, elsewhere).is_none()
        });
        let shape = rhumb(&mut app).shape(here).cloned();
        assert_eq!(shape, Some(Shape::ball(0.5)));
        let bound = rhumb(&mut app).error_bound(here).expect("it is shown");
        assert!(bound.metres() <= TOLERANCE, "{bound}");
    }
}
