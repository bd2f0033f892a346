//! The client's examples run against a server process.
//!
//! Proved by what they print and how they end. The falling ball's path is known: it starts at 10 m and rests at 0.5 m.

use rhumb_tests::{Ended, Programme};

use crate::SERVER;

const DROP: Programme = Programme(env!("CARGO_BIN_EXE_example-drop"));
const AVATAR: Programme = Programme(env!("CARGO_BIN_EXE_example-avatar"));

fn run(example: Programme) -> Ended {
    let server = SERVER.serve("127.0.0.1:0");
    let (address, fingerprint) = (server.address.to_string(), server.fingerprint.to_string());
    let ended = example.run(&[&address, &fingerprint]);
    assert_eq!(ended.code, Some(0), "{}", ended.log);
    ended
}

#[test]
fn the_ball_of_the_first_example_falls_and_rests_on_the_floor() {
    let ended = run(DROP);
    let lines: Vec<&str> = ended.out.lines().collect();
    assert_eq!(lines.len(), 180, "{}", ended.out);
    let height = |line: &str| -> f32 {
        let numbers = line.split_once("Vec3(").expect("the ball is in view").1;
        let height = numbers
            .split(", ")
            .nth(1)
            .expect("a vector has three parts");
        height.parse().expect("a height is a number")
    };
    let (first, last) = (height(lines[0]), height(lines[179]));
    assert!((9.9..10.1).contains(&first), "{first}");
    assert!((0.4..0.6).contains(&last), "{last}");
    assert!(
        lines.iter().all(|line| line.contains("Within")),
        "{}",
        ended.out
    );
}

#[test]
fn the_avatar_of_the_second_example_pushes_boxes() {
    let ended = run(AVATAR);
    assert!(ended.out.contains("is pushed to"), "{}", ended.out);
    assert!(ended.out.contains("published the walk in"), "{}", ended.out);
}

#[test]
fn an_example_names_the_argument_that_is_missing() {
    let ended = DROP.run(&[]);
    assert_eq!(ended.code, Some(1));
    assert!(ended.log.contains("host:port"), "{}", ended.log);
}
