//! Nodes follow the bodies of a scene: they come, move, and go.

use rhumb_bindings::parse_packed_id;
use rhumb_client::scene::{BodyDesc, Command, Shape, Stepping};
use rhumb_client::{Client, PipelineDepth, StreamChoice, Tick, Tolerance};

use crate::agent::{Agent, Frame};
use crate::server::{Server, advance_beyond, show_tick};

/// Metres.
const TOLERANCE: f64 = 0.05;

/// Compares each node with the truth; returns how many bounds were known, and the greatest distance.
fn compare(frame: &Frame, truth: &Client, ids: &[u64]) -> (u32, f64) {
    let (mut bounded, mut farthest) = (0, 0.0_f64);
    for id in ids {
        let shown = frame.body(*id).expect("the body has a node");
        let body = parse_packed_id(*id).expect("a body");
        let exact = truth.view().position(body).expect("the truth has the body");
        let turned = truth.view().rotation(body).expect("the truth has the body");
        let off = f64::from(shown.position.distance(exact));
        farthest = farthest.max(off);
        assert!(off <= TOLERANCE, "{body} at {}: {off} m", frame.tick);
        assert!(
            shown.rotation.dot(turned).abs() > 0.98,
            "{body} at {}",
            frame.tick
        );
        if shown.bound.is_finite() {
            // Godot prints nine decimals.
            assert!(
                off <= shown.bound + 1e-6,
                "{body}: {off} m off, bound {}",
                shown.bound
            );
            bounded += 1;
        }
    }
    (bounded, farthest)
}

#[test]
fn each_tick_shows_each_body_within_the_tolerance_and_the_bound_of_the_truth() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "fall", "lockstep", 0) else {
        return;
    };
    agent.join();
    let mut truth = server.join("fall", Stepping::Lockstep, StreamChoice::Full);
    agent.number("agent.add_box(0, Vector3(40, 1, 40), Vector3(0, -0.5, 0))");
    let balls: Vec<u64> = (0..12)
        .map(|i| {
            let x = f64::from(i % 4) - 1.5;
            agent.number(&format!(
                "agent.add_ball({x}, {}, {})",
                2.0 + 1.1 * f64::from(i),
                0.1 * x
            ))
        })
        .collect();
    let (mut bounded, mut farthest) = (0, 0.0_f64);
    let mut last = None;
    for _ in 0..240 {
        let frame = agent.step();
        let tick = frame.tick as u64;
        assert!(
            last.is_none_or(|last| tick == last + 1),
            "each physics frame is a tick"
        );
        last = Some(tick);
        show_tick(&mut truth, Tick::new(tick));
        let (known, far) = compare(&frame, &truth, &balls);
        bounded += known;
        farthest = farthest.max(far);
    }
    assert!(
        bounded > 12 * 200,
        "bounds are known without loss: {bounded}"
    );
    assert!(farthest > 0.0, "the copy is not the truth itself");
    assert_eq!(agent.eval("scene.get_late_steps()"), "0");
    assert_eq!(
        agent.eval("agent.appeared"),
        "[]",
        "all bodies are of the project's nodes"
    );
}

#[test]
fn balls_of_a_free_running_scene_fall_and_come_to_rest_where_the_truth_has_them() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "free", "free", 0) else {
        return;
    };
    agent.join();
    agent.number("agent.add_box(0, Vector3(40, 1, 40), Vector3(0, -0.5, 0))");
    let balls = [0, 2, 4].map(|x| agent.number(&format!("agent.add_ball({x}, 3, 0)")));
    let mut seen_in_the_air = false;
    let at_rest = agent.run_until("the balls lie still", |_, frame| {
        let bodies: Option<Vec<_>> = balls.iter().map(|id| frame.body(*id)).collect();
        let Some(bodies) = bodies else { return false };
        seen_in_the_air |= bodies
            .iter()
            .all(|body| (0.7..2.9).contains(&body.position.y));
        (bodies.iter()).all(|body| body.position.y < 0.6 && body.rising == 0.0)
    });
    assert!(seen_in_the_air, "the fall is shown, not only its end");
    let mut truth = server.join("free", Stepping::FreeRunning, StreamChoice::Full);
    truth
        .idle(std::time::Duration::from_millis(100))
        .expect("the server continues");
    truth.poll().expect("the server continues");
    compare(&at_rest, &truth, &balls);
    assert_eq!(
        agent.eval(&format!("agent.body({}).is_resting()", balls[0])),
        "true"
    );
}

#[test]
fn bodies_of_another_member_become_nodes_and_go_with_them() {
    let server = Server::start();
    let mut other = server.join(
        "others",
        Stepping::Lockstep,
        StreamChoice::Within(Tolerance::NORMAL),
    );
    let ball = |x: f32| BodyDesc::dynamic(Shape::ball(0.5)).at(x, 5.0, 0.0);
    let kept = other.add_body(ball(0.0)).expect("a body");
    let removed = other.add_body(ball(3.0)).expect("a body");
    other.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    let Some(mut agent) = Agent::start(&server, "others", "lockstep", 0) else {
        return;
    };
    let frame = agent.join();
    let [kept, gone] = [kept, removed].map(rhumb_bindings::packed_id);
    assert_eq!(frame.bodies.len(), 2, "bodies from before it joined");
    assert_eq!(agent.eval("agent.appeared.size()"), "2");
    other
        .command(Command::RemoveBody { id: removed })
        .expect("a command");
    advance_beyond(&mut other, frame.shown());
    let after = agent.step();
    assert!(after.body(gone).is_none());
    assert!(after.body(kept).is_some());
    assert_eq!(agent.eval("agent.removed"), format!("[{gone}]"));
    assert_eq!(agent.eval("agent.counted.get('body removed', 0)"), "1");
    agent.step();
    // The other node is freed, and the scene's child with it.
    assert_eq!(agent.eval("scene.get_child_count()"), "1");
}

#[test]
fn a_node_that_the_project_frees_hides_its_body_alone() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "hidden", "lockstep", 0) else {
        return;
    };
    agent.join();
    let [id, early, other] =
        [0, 3, 6].map(|x| agent.number(&format!("agent.add_ball({x}, 50, 0)")));
    // One is freed before its body is shown, one after that.
    agent.eval(&format!("agent.free_late({early})"));
    agent.step();
    agent.eval(&format!("agent.free_node({id})"));
    agent.step();
    let before = agent.step();
    let after = (0..10)
        .fold(None, |_, _| Some(agent.step()))
        .expect("ten frames");
    for hidden in [id, early] {
        assert!(after.body(hidden).is_none(), "{hidden}");
        assert_eq!(agent.eval(&format!("scene.get_body({hidden})")), "<null>");
    }
    let height = |frame: &Frame| frame.body(other).expect("the third continues").position.y;
    assert!(height(&after) < height(&before));
    assert_eq!(agent.eval("agent.appeared"), "[]");
    assert_eq!(
        agent.errors().matches("ERROR").count(),
        0,
        "{}",
        agent.errors()
    );
    let mut truth = server.join("hidden", Stepping::Lockstep, StreamChoice::Full);
    truth.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    for hidden in [id, early] {
        let body = parse_packed_id(hidden).expect("a body");
        let height = truth.view().position(body).expect("the body lives on").y;
        assert!(height < 50.0, "{height}");
    }
}
