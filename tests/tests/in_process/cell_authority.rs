//! Authority of a member by cells, over bodies in its cells and elsewhere.
//!
//! A member of the whole scene says where the bodies are. The scene runs free, and nothing is lost.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_protocol::message::{AuthorityError, RemovalCause, SessionKey};
use rhumb_protocol::scene::{BodyDesc, BodyKind, CellGrid, Command, Stepping};
use rhumb_protocol::session::{Event, Misuse};
use rhumb_reckoning::{Metres, Tolerance};
use rhumb_scene::engine::Engines;
use rhumb_tests::{FailingEngine, Fails, failing_body};

use super::cell_members::{AWAY, BALL, BESIDE, Divided, NORMAL, body, cells, still};

impl Divided {
    /// A free-running scene with a member that has authority over one body of its cells and one that has left them.
    fn with_authority() -> Self {
        let mut divided = Self::new(Stepping::FreeRunning, FailingEngine::engines());
        divided.enter(Some(SessionKey([7; 16])));
        divided.add_own(OWN[0], 5.0);
        let fails = failing_body(body(OWN[1]), BALL, Fails::Step(FAILS_AFTER));
        let kind = BodyKind::Kinematic;
        divided.add_described(BodyDesc { kind, ..fails }, 5.0);
        let member = divided.table.session(divided.member);
        let taken = member.take_authority(Tolerance::NORMAL, &OWN.map(body));
        taken.expect("a member");
        divided.step();
        divided.publish([6.0, AWAY]);
        assert_eq!(divided.bodies(), cells([0, 1, OWN[0]], [2]));
        divided
    }

    /// The member adds a body of its own.
    fn add_own(&mut self, index: u32, x: f32) {
        self.add_described(BodyDesc::plain(body(index), BodyKind::Kinematic, BALL), x);
    }

    fn add_described(&mut self, desc: BodyDesc, x: f32) {
        let motion = still(x);
        let member = self.table.session(self.member);
        member
            .command(Command::AddBody { desc, motion })
            .expect("a member");
        self.step();
    }

    /// Publishes the member's bodies at these places, and lets the ticks pass in which others learn of it.
    fn publish(&mut self, places: [f32; 2]) {
        let copy = self.table.session(self.owner).replica();
        let newest = copy.expect("a member").stream().complete();
        let states = [0, 1].map(|at| (body(OWN[at]), still(places[at])));
        let member = self.table.session(self.member);
        let published = member.publish(newest.next().next(), &states);
        assert_eq!(published, Ok(true), "at {newest}");
        self.steps(4);
    }

    fn steps(&mut self, count: usize) {
        for _ in 0..count {
            self.step();
        }
    }

    /// Publishes one of the bodies at a place.
    fn publish_one(&mut self, index: u32, x: f32) -> Result<bool, Misuse> {
        let copy = self.table.session(self.owner).replica();
        let newest = copy.expect("a member").stream().complete();
        let states = [(body(index), still(x))];
        let member = self.table.session(self.member);
        let published = member.publish(newest.next().next(), &states);
        self.steps(4);
        published
    }

    /// The member takes the cells of these places.
    fn take_cells(&mut self, places: &[f32]) {
        let grid = CellGrid::columns(Metres::new(10.0)).expect("a grid");
        let cell = |x: &f32| (grid.cell_of(Vec3::new(*x, 1.0, 5.0)), NORMAL);
        let wanted = places.iter().map(cell).collect();
        let member = self.table.session(self.member);
        member.take_cells(&wanted).expect("a member by cells");
    }

    fn take_authority(&mut self, indices: &[u32]) {
        let bodies: Vec<_> = indices.iter().map(|index| body(*index)).collect();
        let member = self.table.session(self.member);
        let taken = member.take_authority(Tolerance::NORMAL, &bodies);
        taken.expect("a member");
    }

    fn events(&mut self) -> Vec<Event> {
        let member = self.table.session(self.member);
        std::iter::from_fn(|| member.poll_event()).collect()
    }

    /// What the member learns about its authority and about removed bodies.
    fn news(&mut self) -> Vec<Event> {
        let mut news = self.events();
        news.retain(|event| {
            matches!(
                event,
                Event::AuthorityGrant(_) | Event::AuthorityDenied(_) | Event::BodyRemoved { .. }
            )
        });
        news
    }

    /// Where a member of the whole scene has the bodies.
    fn places(&mut self) -> [f32; 2] {
        OWN.map(|index| self.place(index))
    }

    fn place(&mut self, index: u32) -> f32 {
        let copy = self.table.session(self.owner).replica();
        let stream = copy.expect("a member").stream();
        let motion = stream.predicted_motion(body(index), stream.complete());
        motion.expect("it has the body").pose().position.x as f32
    }

    fn reconnect(&mut self) {
        self.member = self.table.reconnect(self.member);
    }
}

/// The bodies under the member's authority: the first ones of its range.
const OWN: [u32; 2] = [4_096, 4_097];
/// Steps after which the engine fails on the second one.
const FAILS_AFTER: u32 = 300;

fn granted(indices: &[u32]) -> Event {
    Event::AuthorityGrant(indices.iter().map(|index| body(*index)).collect())
}

fn removed(index: u32) -> Event {
    Event::BodyRemoved {
        id: body(index),
        cause: RemovalCause::Command,
    }
}

#[test]
fn a_resumed_session_moves_its_bodies_of_cells_again() {
    for is_paced in [false, true] {
        let mut divided = Divided::with_authority();
        divided.table.end_connection(divided.member);
        divided.step();
        divided.reconnect();
        if is_paced {
            // The next snapshots wait: the link says what it takes.
            divided.table.pace(divided.member);
        }
        for _ in 0..60 {
            divided.step();
        }
        let member = divided.table.session(divided.member);
        let own: Vec<_> = member.authority_bodies().collect();
        assert_eq!(own, OWN.map(body));
        divided.publish([7.0, AWAY + 1.0]);
        let moved = divided.places();
        let errors = [moved[0] - 7.0, moved[1] - AWAY - 1.0];
        assert!(errors.iter().all(|error| error.abs() < 0.02), "{moved:?}");
        let shown = divided.shown_by_member(OWN[0]);
        assert!((shown - 7.0).abs() < 0.03, "{shown}");
    }
}

#[test]
fn a_grant_waits_for_the_cells_that_were_asked_for_before() {
    let mut divided = Divided::new(Stepping::FreeRunning, Engines::default());
    divided.enter(None);
    divided.add_own(OWN[0], 15.0);
    divided.table.pace(divided.member);
    let wanted = BTreeMap::from([(BESIDE, NORMAL)]);
    let member = divided.table.session(divided.member);
    let none = BTreeMap::new();
    member.take_cells(&none).expect("a member by cells");
    member.take_cells(&wanted).expect("a member by cells");
    let taken = member.take_authority(Tolerance::NORMAL, &[body(OWN[0])]);
    taken.expect("a member");
    for _ in 0..120 {
        divided.step();
    }
    assert_eq!(divided.news(), [granted(&OWN[..1])]);
}

#[test]
fn a_grant_waits_for_a_cell_that_is_taken_later() {
    let mut divided = Divided::new(Stepping::FreeRunning, Engines::default());
    divided.enter(None);
    divided.add_own(OWN[0], AWAY);
    divided.take_authority(&OWN[..1]);
    divided.steps(150);
    assert_eq!(divided.publish_one(OWN[0], AWAY + 1.0), Ok(false));
    assert_eq!(divided.news(), []);
    divided.take_cells(&[5.0, AWAY]);
    divided.steps(2);
    assert_eq!(divided.news(), [granted(&OWN[..1])]);
    assert_eq!(divided.publish_one(OWN[0], AWAY + 1.0), Ok(true));
    let x = divided.place(OWN[0]);
    assert!((x - AWAY - 1.0).abs() < 0.02, "{x}");
    // Once it is known, it may leave the cells.
    divided.take_cells(&[5.0]);
    divided.steps(2);
    assert_eq!(divided.publish_one(OWN[0], AWAY + 2.0), Ok(true));
    let x = divided.place(OWN[0]);
    assert!((x - AWAY - 2.0).abs() < 0.02, "{x}");
    assert_eq!(divided.news(), []);
}

#[test]
fn bodies_of_a_grant_do_not_wait_for_the_cells_of_others() {
    let mut divided = Divided::new(Stepping::FreeRunning, Engines::default());
    divided.enter(None);
    divided.add_own(OWN[0], 5.0);
    divided.add_own(OWN[1], AWAY);
    divided.take_authority(&OWN);
    divided.step();
    assert_eq!(divided.news(), [granted(&OWN[..1])]);
    // For longer than between two checksums, which cover both.
    let mut x = 5.0;
    for step in 0..60 {
        x = [6.0, 5.0][step % 2];
        assert_eq!(divided.publish_one(OWN[0], x), Ok(true));
    }
    assert_eq!(divided.publish_one(OWN[1], AWAY), Ok(false));
    assert_eq!(divided.news(), []);
    let shown = divided.place(OWN[0]);
    assert!((shown - x).abs() < 0.02, "{shown}, not {x}");
    divided.take_cells(&[5.0, AWAY]);
    divided.steps(2);
    assert_eq!(divided.news(), [granted(&OWN)]);
    for step in 0..60 {
        x = [6.0, 5.0][step % 2];
        divided.publish([x, AWAY - x]);
    }
    assert_eq!(divided.news(), []);
    let places = divided.places();
    let errors = [places[0] - x, places[1] - AWAY + x];
    assert!(
        errors.iter().all(|error| error.abs() < 0.02),
        "{places:?}, not {x}"
    );
}

#[test]
fn a_publisher_learns_that_a_body_was_removed_out_of_its_cells() {
    let mut divided = Divided::with_authority();
    divided.events();
    divided.command(Command::RemoveBody { id: body(OWN[1]) });
    assert_eq!(divided.news(), [removed(OWN[1])]);
    let published = divided.publish_one(OWN[1], AWAY);
    assert_eq!(published, Err(Misuse::NoAuthority(body(OWN[1]))));
    assert_eq!(divided.publish_one(OWN[0], 7.0), Ok(true));
    let x = divided.place(OWN[0]);
    assert!((x - 7.0).abs() < 0.02, "{x}");
    // In a cell it says so once.
    divided.command(Command::RemoveBody { id: body(OWN[0]) });
    divided.step();
    assert_eq!(divided.news(), [removed(OWN[0])]);
    let published = divided.publish_one(OWN[0], 7.0);
    assert_eq!(published, Err(Misuse::NoAuthority(body(OWN[0]))));
}

#[test]
fn a_publisher_learns_of_bodies_that_are_removed_at_once() {
    for order in [[0, 1], [1, 0]] {
        let mut divided = Divided::with_authority();
        divided.events();
        for at in order {
            let owner = divided.table.session(divided.owner);
            let removal = Command::RemoveBody { id: body(OWN[at]) };
            owner.command(removal).expect("a member");
        }
        divided.steps(2);
        let news = divided.news();
        assert_eq!(news.len(), 2, "{news:?}");
        let is_removed = |index: &u32| news.contains(&removed(*index));
        assert!(OWN.iter().all(is_removed), "{news:?}");
        // A later denial is an answer.
        divided.take_authority(&OWN[..1]);
        divided.steps(2);
        let unknown = Event::AuthorityDenied(AuthorityError::UnknownBody(body(OWN[0])));
        assert_eq!(divided.news(), [unknown]);
    }
}

#[test]
fn a_publisher_learns_of_a_removal_while_it_leaves_the_cell() {
    let mut divided = Divided::with_authority();
    divided.events();
    let owner = divided.table.session(divided.owner);
    let removal = Command::RemoveBody { id: body(OWN[0]) };
    owner.command(removal).expect("a member");
    // The server has not read that it leaves.
    divided.take_cells(&[15.0]);
    divided.steps(2);
    assert_eq!(divided.bodies().keys().collect::<Vec<_>>(), [&BESIDE]);
    assert_eq!(divided.news(), [removed(OWN[0])]);
    let published = divided.publish_one(OWN[0], 7.0);
    assert_eq!(published, Err(Misuse::NoAuthority(body(OWN[0]))));
}

#[test]
fn a_request_that_is_under_way_at_a_removal_is_answered() {
    let mut divided = Divided::with_authority();
    divided.events();
    let owner = divided.table.session(divided.owner);
    let removal = Command::RemoveBody { id: body(OWN[1]) };
    owner.command(removal).expect("a member");
    divided.take_authority(&OWN);
    divided.steps(2);
    let unknown = Event::AuthorityDenied(AuthorityError::UnknownBody(body(OWN[1])));
    assert_eq!(divided.news(), [removed(OWN[1]), unknown]);
    assert_eq!(divided.publish_one(OWN[0], 7.0), Ok(true));
    divided.take_authority(&OWN[..1]);
    divided.steps(2);
    assert_eq!(divided.news(), [granted(&OWN[..1])]);
}

#[test]
fn a_publisher_learns_that_a_restored_scene_has_its_body_no_more() {
    let mut divided = Divided::with_authority();
    divided.steps(FAILS_AFTER as usize);
    let events = divided.events();
    let restored = |event: &Event| matches!(event, Event::SceneRestored(_));
    assert!(events.iter().any(restored), "{events:?}");
    for index in OWN {
        let removals = events.iter().filter(|event| **event == removed(index));
        assert_eq!(removals.count(), 1, "{events:?}");
        let published = divided.publish_one(index, AWAY);
        assert_eq!(published, Err(Misuse::NoAuthority(body(index))));
    }
}
