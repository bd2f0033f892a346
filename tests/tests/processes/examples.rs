//! The client's examples run against a server process.
//!
//! Proved by what they print and how they end. The falling ball's path is known: it starts at 10 m and rests at 0.5 m.

use rhumb_tests::{Ended, Programme};

use crate::SERVER;

const DROP: Programme = Programme(env!("CARGO_BIN_EXE_example-drop"));
const AVATAR: Programme = Programme(env!("CARGO_BIN_EXE_example-avatar"));
const CROWD: Programme = Programme(env!("CARGO_BIN_EXE_example-crowd"));
const TOWER: Programme = Programme(env!("CARGO_BIN_EXE_example-tower"));

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

/// The numbers of a line, as they are written.
fn numbers(line: &str) -> Vec<f32> {
    let words = line.split(|c: char| !c.is_ascii_digit() && c != '.');
    words.filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn the_avatar_of_the_third_example_pushes_a_crowd_aside() {
    let ended = run(CROWD);
    // It is drawn further to the right in each picture, until it has left the last one.
    let pictures: Vec<&str> = ended.out.split("tick ").collect();
    let column = |picture: &&str| picture.lines().find_map(|line| line.find('@'));
    let columns: Vec<usize> = pictures.iter().filter_map(column).collect();
    assert!(columns.len() == 3 && columns.is_sorted(), "{columns:?}");
    let last = ended.out.lines().last().expect("a last line");
    let [pushed, of, updates, bytes] = numbers(last)[..] else {
        panic!("{last}");
    };
    assert_eq!(of, 144.0);
    // At least a person of each row that it walked through, and not everyone.
    assert!((12.0..140.0).contains(&pushed), "{last}");
    // A straight walk is predicted.
    assert!(updates <= 20.0 && bytes < 2_000.0, "{last}");
}

#[test]
fn the_tower_of_the_fourth_example_stands_falls_and_is_drawn() {
    let ended = run(TOWER);
    let pictures: Vec<&str> = ended.out.split("tick ").collect();
    let first = pictures[0];
    // Each of the ten boxes is two rows of four characters.
    for letter in 'A'..='J' {
        assert_eq!(first.matches(letter).count(), 8, "{letter} in\n{first}");
    }
    assert!(first.contains('o'), "{first}");
    let rows = |picture: &str| {
        picture
            .lines()
            .filter(|line| line.contains(|c| ('A'..='J').contains(&c)))
            .count()
    };
    assert_eq!(rows(first), 20, "{first}");
    let fallen = pictures[pictures.len() - 2];
    assert!(rows(fallen) <= 12, "{fallen}");
    let last = ended.out.lines().last().expect("a last line");
    assert!(last.starts_with("the highest of 10 boxes is at "), "{last}");
}

#[test]
fn an_example_names_the_argument_that_is_missing() {
    let ended = DROP.run(&[]);
    assert_eq!(ended.code, Some(1));
    assert!(ended.log.contains("host:port"), "{}", ended.log);
}
