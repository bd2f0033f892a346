//! Servers that go away, and what is wrong: a sentence, never a crash.

use crate::agent::Agent;
use crate::server::Server;

#[test]
fn a_server_that_dies_ends_the_scene_by_a_signal() {
    for stepping in ["lockstep", "free"] {
        let mut server = Server::start();
        let Some(mut agent) = Agent::start(&server, "killed", stepping, 1) else {
            return;
        };
        agent.join();
        let id = agent.number("agent.add_ball(0, 500, 0)");
        agent.run_until("the ball falls", |_, frame| {
            frame.body(id).is_some_and(|body| body.rising < -0.5)
        });
        server.kill();
        let last = agent.run_until("the end is noticed", |agent, _| {
            agent.has_said("ended: the connection ")
        });
        let at = last.body(id).expect("the node stays").position;
        let later = agent.step().body(id).expect("the node stays");
        assert_eq!(later.position, at, "{stepping}");
        assert_eq!(agent.eval("scene.is_joined()"), "false");
        assert_ne!(agent.eval(&format!("agent.body({id}).remove()")), "0");
        assert!(agent.errors().contains("remove: "), "{}", agent.errors());
        let ends = agent.said.iter().filter(|said| said.starts_with("ended"));
        assert_eq!(ends.count(), 1, "{:?}", agent.said);
        // The node can join again, and learns that there is no server.
        assert_ne!(agent.eval("scene.join()"), "0", "it has a scene still");
        agent.eval("scene.leave()");
        assert_eq!(agent.eval("scene.join()"), "0");
        agent.run_until("the join fails", |agent, _| agent.has_said("join failed: "));
    }
}

#[test]
fn a_scene_that_cannot_be_joined_says_why() {
    let server = Server::start();
    let wrong = "00".repeat(32);
    let cases = [
        (
            server.address.as_str(),
            server.fingerprint.as_str(),
            "a name with blanks",
            "cannot name a scene",
        ),
        (
            "no port here",
            server.fingerprint.as_str(),
            "x",
            "no port here",
        ),
        (server.address.as_str(), "ab", "x", "fingerprint"),
        (server.address.as_str(), "", "x", "trust must be given"),
        (server.address.as_str(), wrong.as_str(), "x", "certificate"),
    ];
    for (address, fingerprint, scene, needle) in cases {
        let Some(mut agent) = Agent::start_with(address, fingerprint, scene, "free", 0) else {
            return;
        };
        agent.frame();
        assert_eq!(agent.eval("scene.join()"), "0");
        agent.run_until("the join fails", |agent, _| agent.has_said("join failed: "));
        let said = agent.said.last().expect("a sentence");
        assert!(said.contains(needle), "{needle}: {said}");
    }
}

#[test]
fn wrong_calls_are_errors_with_a_sentence() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "wrong", "lockstep", 0) else {
        return;
    };
    agent.frame();
    let before_joining = [
        ("scene.cast_ray(Vector3(0, 0, 0), Vector3(0, 1, 0))", "-1"),
        ("scene.delete() != 0", "true"),
        ("scene.get_body(5)", "<null>"),
        ("scene.get_body(-1)", "<null>"),
        ("scene.join()", "0"),
        ("scene.join() != 0", "true"),
    ];
    for (expression, value) in before_joining {
        assert_eq!(agent.eval(expression), value, "{expression}");
    }
    agent.run_until("the scene is joined", |agent, _| !agent.said.is_empty());
    let bodies = [
        "agent.add_wrong(scene)",
        "agent.add_wrong(agent)",
        "agent.add_box(1, Vector3(1e9, 1, 1), Vector3(0, 0, 0))",
        "agent.add_box(1, Vector3(1, 1, 1), Vector3(NAN, 0, 0))",
    ];
    for expression in bodies {
        assert_eq!(agent.eval(expression), "0", "{expression}");
    }
    let id = agent.number("agent.add_ball(0, 5, 0)");
    agent.step();
    let numbers = [
        format!("agent.body({id}).apply_impulse(Vector3(NAN, 0, 0)) != 0"),
        format!("agent.body({id}).teleport(Transform3D(Basis(), Vector3(INF, 0, 0))) != 0"),
        "scene.cast_ray(Vector3(NAN, 0, 0), Vector3(0, 1, 0)) < 0".to_owned(),
    ];
    for expression in numbers {
        assert_eq!(agent.eval(&expression), "true", "{expression}");
    }
    let sentences = [
        "it has no shape",
        "the parent of a RhumbBody must be a RhumbScene",
        "apply_impulse: ",
        "teleport: ",
        "cast_ray: ",
        "call leave() first",
    ];
    for needle in sentences {
        let errors = agent.errors();
        assert!(errors.contains(needle), "{needle}: {errors}");
    }
    let frame = agent.step();
    assert_eq!(frame.bodies.len(), 1, "the good one continues: {frame:?}");
    assert_eq!(agent.eval("scene.delete()"), "0");
    agent.run_until("the end is noticed", |agent, _| agent.has_said("ended: "));
}

#[test]
fn a_wrong_child_keeps_no_other_child_out() {
    let server = Server::start();
    let Some(mut agent) = Agent::start(&server, "children", "lockstep", 0) else {
        return;
    };
    agent.frame();
    for x in ["0", "NAN", "5"] {
        assert_eq!(
            agent.eval(&format!("agent.add_ball({x}, 5, 0)")),
            "0",
            "not joined yet"
        );
    }
    agent.eval("scene.join()");
    let joined = agent.run_until("the scene is joined", |_, frame| frame.bodies.len() == 2);
    assert!(
        joined.bodies.iter().all(|body| body.position.y > 4.0),
        "{joined:?}"
    );
    assert!(agent.errors().contains("ERROR"), "the third is named");
}
