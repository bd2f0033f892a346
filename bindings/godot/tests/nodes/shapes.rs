//! Shapes of Godot become those of the scene, and back.

use rhumb_bindings::parse_packed_id;
use rhumb_client::glam::Vec3;
use rhumb_client::scene::{
    BodyDesc, Compound, Edges, Mesh, Part, Shape, Sleep, SleepThresholds, Stepping,
};
use rhumb_client::{Client, PipelineDepth, StreamChoice};

use crate::agent::Agent;
use crate::server::Server;

/// The shape of a body of the truth, and its place.
fn truth_of(truth: &Client, id: u64) -> (Shape, Vec3) {
    let body = parse_packed_id(id).expect("a body");
    let replica = truth.replica().expect("the truth is complete");
    let desc = replica.body(body).expect("the truth has the body");
    let shape = replica
        .shape(desc.shape)
        .expect("the truth has the shape")
        .clone();
    (shape, truth.view().position(body).expect("a pose"))
}

#[test]
fn resources_of_godot_are_shapes_of_the_scene() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "shapes", "lockstep", 0) else {
        return;
    };
    agent.join();
    let at = "Vector3(100, 200, 300)";
    let ball = agent.number("agent.add_ball(0, 0, 0)");
    let cuboid = agent.number("agent.add_box(0, Vector3(2, 4, 6), Vector3(0, 0, 50))");
    let capsule = agent.number("agent.add_capsule(Vector3(20, 0, 0))");
    let cylinder = agent.number("agent.add_cylinder(Vector3(40, 0, 0))");
    let hull = agent.number("agent.add_cube_of_points(Vector3(60, 0, 0))");
    let mesh = agent.number("agent.add_triangles(Vector3(80, 0, 0))");
    let heights = agent.number(&format!("agent.add_heights({at})"));
    // Its normal has the length 2, so that its points have y = -30.
    let boundary = agent.number("agent.add_boundary(Plane(Vector3(0, 2, 0), -60))");
    let round = agent.number("agent.add_round_capsule(Vector3(20, 20, 0))");
    agent.step();
    let mut truth = server.join("shapes", Stepping::Lockstep, StreamChoice::Full);
    truth.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    assert_eq!(truth_of(&truth, ball).0, Shape::ball(0.5));
    assert_eq!(truth_of(&truth, cuboid).0, Shape::cuboid(1.0, 2.0, 3.0));
    assert_eq!(truth_of(&truth, capsule).0, Shape::capsule(0.75, 0.25));
    assert_eq!(truth_of(&truth, round).0, Shape::ball(0.25));
    assert_eq!(truth_of(&truth, cylinder).0, Shape::cylinder(1.5, 0.5));
    let Shape::Hull(hull) = truth_of(&truth, hull).0 else {
        panic!("a hull");
    };
    assert_eq!(hull.points().len(), 8);
    let Shape::Mesh(mesh) = truth_of(&truth, mesh).0 else {
        panic!("a mesh");
    };
    assert_eq!(
        (mesh.points().len(), mesh.triangles().len()),
        (4, 2),
        "corners are shared"
    );
    // Godot's field stands around its middle; a post is where Godot has it.
    let (Shape::Heights(field), corner) = truth_of(&truth, heights) else {
        panic!("a height field");
    };
    let posts: Vec<Vec3> = field.posts().map(|post| corner + post.as_vec3()).collect();
    for (x, z, height) in [(0, 0, 0.0), (2, 0, 2.0), (0, 1, 10.0), (2, 1, 12.0)] {
        let post = Vec3::new(99.0 + x as f32, 200.0 + height, 299.5 + z as f32);
        assert!(
            posts.iter().any(|other| other.distance(post) < 1e-4),
            "{post}: {posts:?}"
        );
    }
    let (shape, origin) = truth_of(&truth, boundary);
    assert_eq!(shape, Shape::HalfSpace { normal: Vec3::Y });
    assert!(
        origin.distance(Vec3::new(0.0, -30.0, 0.0)) < 1e-4,
        "{origin}"
    );
    // The nodes stay where the project has put them.
    let shown = agent.step().body(heights).expect("the field has a node");
    assert!(
        shown.position.distance(Vec3::new(100.0, 200.0, 300.0)) < 1e-4,
        "{shown:?}"
    );
    assert_eq!(
        agent.errors().matches("ERROR").count(),
        0,
        "{}",
        agent.errors()
    );
}

#[test]
fn shapes_of_other_members_are_resources_of_godot() {
    let server = Server::start();
    let mut other = server.join("shown", Stepping::Lockstep, StreamChoice::Full);
    let corners = [Vec3::ZERO, Vec3::X, Vec3::Z].map(|corner| corner * 2.0);
    let mesh = Mesh::new(&corners, &[[0, 2, 1]]).expect("a mesh");
    let part = |shape, x: f32| Part {
        shape,
        position: Vec3::new(x, 0.0, 0.0),
        rotation: rhumb_client::glam::Quat::IDENTITY,
    };
    let two = Compound::new(vec![
        part(Shape::ball(0.5), -1.0),
        part(Shape::ball(0.5), 1.0),
    ]);
    let expected = [
        (Shape::ball(0.5), "SphereShape3D"),
        (Shape::cuboid(1.0, 2.0, 3.0), "BoxShape3D"),
        (Shape::capsule(0.75, 0.25), "CapsuleShape3D"),
        (Shape::cylinder(1.5, 0.5), "CylinderShape3D"),
        (Shape::Mesh(mesh), "ConcavePolygonShape3D"),
        (Shape::HalfSpace { normal: Vec3::Y }, "WorldBoundaryShape3D"),
        (Shape::cone(1.0, 0.5), "null"),
        (Shape::Compound(two.expect("a compound")), "null"),
    ];
    let mut ids = Vec::new();
    for (place, (shape, _)) in expected.iter().enumerate() {
        let body = BodyDesc::fixed(shape.clone()).at(10.0 * place as f32, 0.0, 0.0);
        ids.push(rhumb_bindings::packed_id(
            other.add_body(body).expect("a body"),
        ));
    }
    other.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    let Some(mut agent) = Agent::start(&server, "shown", "lockstep", 0) else {
        return;
    };
    agent.join();
    for (id, (shape, class)) in ids.iter().zip(&expected) {
        assert_eq!(
            agent.eval(&format!("agent.shape_class({id})")),
            *class,
            "{shape:?}"
        );
    }
    assert_eq!(
        agent.eval(&format!("agent.body({}).shape.height", ids[2])),
        "2.0"
    );
    assert_eq!(
        agent.eval(&format!("agent.body({}).shape.size", ids[1])),
        "(2.0, 4.0, 6.0)"
    );
}

#[test]
fn conditions_of_sleep_and_edges_are_settings_of_the_scene_and_its_bodies() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "settings", "lockstep", 0) else {
        return;
    };
    agent.frame();
    // Two is `Below`, three is `Never`, one is `Settled`; zero are plain edges.
    agent.eval("scene.set('sleep', 2)");
    agent.eval("scene.set('sleep_speed', 0.25)");
    agent.eval("scene.set('sleep_seconds', 2.0)");
    assert_eq!(agent.eval("scene.join()"), "0");
    agent.run_until("the scene is joined", |agent, _| agent.has_said("joined"));
    let plain = agent.number("agent.add_set({'edges': 0})");
    let smooth = agent.number("agent.add_set({'edges': 1})");
    let scenes = agent.number("agent.add_set({})");
    let never = agent.number("agent.add_set({'sleep': 3})");
    let settled = agent.number("agent.add_set({'sleep': 1})");
    let below =
        "{'sleep': 2, 'sleep_speed': 0.5, 'sleep_angular_speed': 0.75, 'sleep_seconds': 1.5}";
    let below = agent.number(&format!("agent.add_set({below})"));
    agent.step();
    let mut truth = server.join("settings", Stepping::Lockstep, StreamChoice::Full);
    truth.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    let thresholds = |speed, angular_speed, seconds| {
        Sleep::Below(SleepThresholds {
            speed,
            angular_speed,
            seconds,
        })
    };
    assert_eq!(truth.config().sleep, thresholds(0.25, 1.0, 2.0));
    let sleep = |id| {
        let body = truth.replica()?.body(parse_packed_id(id).ok()?)?;
        body.sleep
    };
    assert_eq!(sleep(scenes), None);
    assert_eq!(sleep(never), Some(Sleep::Never));
    assert_eq!(sleep(settled), Some(Sleep::Settled));
    assert_eq!(sleep(below), Some(thresholds(0.5, 0.75, 1.5)));
    for (id, edges) in [(plain, Edges::Plain), (smooth, Edges::Smooth)] {
        let Shape::Mesh(mesh) = truth_of(&truth, id).0 else {
            panic!("a mesh");
        };
        assert_eq!(mesh.edges(), edges);
    }
    // A second member's nodes have the same settings.
    let Some(mut other) = Agent::start(&server, "settings", "lockstep", 0) else {
        return;
    };
    other.join();
    let shown = format!(
        "[agent.body({below}).sleep, agent.body({below}).sleep_seconds, agent.body({never}).sleep, agent.body({plain}).edges]"
    );
    other.run_until("the bodies are shown", |_, frame| {
        frame.body(below).is_some()
    });
    assert_eq!(other.eval(&shown), "[2, 1.5, 3, 0]");
    // Numbers that no body can have are refused with their limit.
    assert_eq!(
        agent.number("agent.add_set({'sleep': 2, 'sleep_seconds': -1.0})"),
        0
    );
    assert!(agent.errors().contains("-1"), "{}", agent.errors());
}
