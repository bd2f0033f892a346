//! Members by cells: one view of all that they take, own ids, contacts.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_client::glam::Vec3;
use rhumb_client::scene::{
    ActiveEvents, BodyDesc, Cell, CellGrid, Command, SceneConfig, Shape, Stepping,
};
use rhumb_client::{
    BodyId, CellState, Client, ClientError, Denial, JoinMode, JoinOptions, LocalServer, Metres,
    Misuse, PipelineDepth, StreamChoice, Tick, Tolerance,
};
use rhumb_scene::{Instant, SceneRouter, SceneSettings};

const EDGE: f64 = 10.0;
const STEP: PipelineDepth = PipelineDepth::LOCKSTEP;

fn grid() -> CellGrid {
    CellGrid::columns(Metres::new(EDGE)).expect("an edge within the limits")
}

fn within(metres: f64) -> StreamChoice {
    StreamChoice::Within(Tolerance::from_metres(Metres::new(metres)).expect("within the limits"))
}

/// A server that divides its scenes, and the member that made one, who has the whole scene exactly.
fn divided() -> (LocalServer, Client) {
    let server = LocalServer::of(SceneRouter::new(SceneSettings {
        cells: Some(grid()),
        ..SceneSettings::new(|| Instant::ZERO)
    }));
    let options = JoinOptions {
        mode: JoinMode::Create(SceneConfig {
            stepping: Stepping::Lockstep,
            gravity: Vec3::ZERO,
            ..SceneConfig::default()
        }),
        stream: StreamChoice::Full,
        ..JoinOptions::default()
    };
    let owner = server.connect().join_with("world", options);
    (server, owner.expect("a new scene"))
}

fn walker(server: &LocalServer) -> Client {
    let options = JoinOptions {
        mode: JoinMode::Join,
        cells: true,
        ..JoinOptions::default()
    };
    let walker = server.connect().join_with("world", options);
    walker.expect("the scene of the owner")
}

fn ball(x: f32, z: f32) -> rhumb_client::scene::BodyBuilder {
    BodyDesc::dynamic(Shape::ball(0.5)).at(x, 5.0, z)
}

/// Lets ticks pass until no cell is awaited.
fn arrive(walker: &mut Client) {
    while walker.cells().any(|(_, state)| state == CellState::Awaited) {
        walker.advance(STEP).expect("a lockstep scene");
    }
}

fn ids(client: &Client) -> BTreeSet<BodyId> {
    client.view().ids().iter().copied().collect()
}

/// Checks what a member shows by what the owner has at the same tick; returns the bodies.
fn compare(walker: &Client, owner: &Client, before: &BTreeSet<BodyId>) -> BTreeSet<BodyId> {
    let time = walker.view().time();
    assert_eq!(owner.view().time(), time);
    let shown = ids(walker);
    assert_eq!(shown.len(), walker.view().ids().len(), "each once");
    let removed: BTreeSet<_> = walker.view().removed().iter().copied().collect();
    assert_eq!(removed, before - &shown, "at {time:?}");
    let changed: BTreeSet<_> = walker.view().changed().collect();
    for (place, id) in walker.view().ids().iter().enumerate() {
        let is_reported = before.contains(id) || changed.contains(&place);
        assert!(is_reported, "{id} is new");
        let truth = owner.view().position(*id).expect("it exists");
        let error = walker.view().positions()[place].distance(truth);
        let bound = walker.error_bound(*id).expect("it is shown").metres();
        assert!(f64::from(error) <= bound + 1e-5, "{id}: {error} of {bound}");
        assert!(bound <= 0.2 + 1e-5, "{id} at {time:?}: {bound}");
    }
    let states: BTreeMap<Cell, CellState> = walker.cells().collect();
    let is_inside = |along: f32| (0.1..0.9).contains(&(along / EDGE as f32).rem_euclid(1.0));
    for (at, id) in owner.view().positions().iter().zip(owner.view().ids()) {
        let state = states.get(&grid().cell_of(*at));
        if is_inside(at.x) && is_inside(at.z) && state == Some(&CellState::Shown) {
            assert!(shown.contains(id), "{id} at {time:?}");
        }
    }
    shown
}

#[test]
fn a_member_that_walks_has_each_body_of_its_cells_once_in_its_view() {
    let (server, mut owner) = divided();
    let floor = BodyDesc::fixed(Shape::cuboid(200.0, 0.5, 200.0)).at(0.0, -3.0, 0.0);
    let floor = owner.add_body(floor).expect("a floor");
    for at in 0..60_u16 {
        let (x, z) = (f32::from(at) * 2.0, f32::from(at % 5) * 3.0 - 6.0);
        let speed = f32::from(at % 7) - 3.0;
        let ball = ball(x, z).linear_velocity(Vec3::new(speed, 0.0, 0.4 * speed));
        owner.add_body(ball).expect("a ball");
    }
    owner.advance(STEP).expect("a lockstep scene");
    let mut walker = walker(&server);
    assert_eq!(walker.cell_grid(), Some(grid()));
    let bands = [
        (Metres::new(8.0), within(0.01)),
        (Metres::new(25.0), within(0.2)),
    ];
    let mut before = ids(&walker);
    let (mut compared, mut gone) = (0, 0);
    for step in 0..400_u16 {
        let at = Vec3::new(f32::from(step) * 0.3, 5.0, 0.0);
        if step % 10 == 0 {
            walker.take_cells_around(at, &bands).expect("few cells");
        }
        walker.advance(STEP).expect("a lockstep scene");
        owner.poll().expect("a member");
        before = compare(&walker, &owner, &before);
        assert!(before.contains(&floor), "what is large is in no cell");
        compared += before.len();
        gone += walker.view().removed().len();
    }
    assert!(
        compared > 4_000 && gone > 30,
        "{compared} poses, {gone} gone"
    );
    let bounds = walker.view().ids().iter();
    let each: Vec<_> = bounds
        .map(|id| walker.error_bound(*id).expect("shown"))
        .collect();
    assert_eq!(walker.error_bounds().collect::<Vec<_>>(), each);
}

#[test]
fn the_id_of_an_own_body_that_is_elsewhere_is_given_out_to_no_other() {
    let (server, _owner) = divided();
    let mut walker = walker(&server);
    let own = walker.add_body(ball(95.0, 5.0)).expect("a ball");
    walker.advance(STEP).expect("a lockstep scene");
    assert_eq!(walker.body(own), None, "its cell is not taken");
    // More than the server granted at first.
    let others = walker.new_ids(4_096).expect("enough indices");
    let same = others.iter().find(|id| id.index() == own.index());
    assert_eq!(same, None, "{own} lives");
    let cells = BTreeMap::from([(Cell([9, 0, 0]), within(0.05))]);
    walker.take_cells(&cells).expect("a cell");
    arrive(&mut walker);
    assert_eq!(walker.body(own).map(|desc| desc.id), Some(own));
    assert_eq!(ids(&walker), BTreeSet::from([own]));
    walker
        .command(Command::RemoveBody { id: own })
        .expect("a command");
    walker.advance(STEP).expect("a lockstep scene");
    walker.advance(STEP).expect("a lockstep scene");
    assert_eq!(walker.view().ids(), []);
}

#[test]
fn bodies_of_taken_cells_that_touch_are_among_the_contacts() {
    let (server, mut owner) = divided();
    let first = owner.add_body(ball(4.0, 5.0)).expect("a ball");
    let second = owner.add_body(ball(4.9, 5.0)).expect("a ball");
    owner.advance(STEP).expect("a lockstep scene");
    let mut walker = walker(&server);
    let cells = BTreeMap::from([(Cell::default(), within(0.05))]);
    walker.take_cells(&cells).expect("a cell");
    arrive(&mut walker);
    let events = ActiveEvents {
        contacts: true,
        ..ActiveEvents::NONE
    };
    let report = Command::SetEvents { id: first, events };
    walker.command(report).expect("a command");
    walker.advance(STEP).expect("a lockstep scene");
    walker.advance(STEP).expect("a lockstep scene");
    let touching: Vec<_> = walker
        .contacts(None)
        .map(|pair| (pair.body, pair.contact.with))
        .collect();
    assert_eq!(touching, [(first, second)]);
}

#[test]
fn a_cell_that_the_grid_has_not_is_denied_and_a_whole_scene_has_none() {
    let (server, mut owner) = divided();
    let mut walker = walker(&server);
    let (here, above) = (Cell::default(), Cell([0, 1, 0]));
    let cells = BTreeMap::from([(here, within(0.05)), (above, within(0.05))]);
    walker.take_cells(&cells).expect("two cells");
    arrive(&mut walker);
    let states: Vec<_> = walker.cells().collect();
    let denied = CellState::Denied(Denial::NoSuchScene);
    assert_eq!(states, [(here, CellState::Shown), (above, denied)]);
    let too_far = [(Metres::new(150.0), within(0.2))];
    let refused = walker.take_cells_around(Vec3::ZERO, &too_far);
    assert!(matches!(
        refused,
        Err(ClientError::Misuse(Misuse::TooManyCells))
    ));
    for (x, radius) in [(1e30, 5.0), (f32::NAN, 5.0), (0.0, -5.0)] {
        let bands = [(Metres::new(radius), within(0.2))];
        let refused = walker.take_cells_around(Vec3::new(x, 0.0, 0.0), &bands);
        let is_invalid = matches!(refused, Err(ClientError::Misuse(Misuse::Invalid(_))));
        assert!(is_invalid, "{x} {radius}: {refused:?}");
    }
    for place in [Cell::PLACE_MAX + 1, i32::MIN] {
        let outside = Cell([0, 0, place]);
        let refused = walker.take_cells(&BTreeMap::from([(outside, within(0.05))]));
        let expected = Misuse::CellPlace(outside);
        assert!(matches!(refused, Err(ClientError::Misuse(misuse)) if misuse == expected));
    }
    arrive(&mut walker);
    assert_eq!(walker.cells().count(), 2, "the session continues as it was");
    assert_eq!(owner.cell_grid(), None);
    let refused = owner.take_cells_around(Vec3::ZERO, &too_far);
    assert!(matches!(
        refused,
        Err(ClientError::Misuse(Misuse::NotDivided))
    ));
    assert_eq!(walker.tick_error_bound(BodyId::new(7, 0), Tick::ZERO), None);
}
