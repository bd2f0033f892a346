//! Who drives which bodies, from when on, until when, and what others may do.
//!
//! Proved in virtual time with `Walk`; that what is driven is where it should be is the affair of `upstream`.

use rhumb_protocol::message::{DriveError, StreamChoice};
use rhumb_protocol::scene::{Command, CommandError, Pace};
use rhumb_protocol::session::Misuse;
use rhumb_protocol::{Ending, Span};
use rhumb_reckoning::{BodyId, Divergence, Tick, Ticks, Tolerance};
use rhumb_tests::{Avatars, COMMANDER, TICK, Walk, drive, seed};
use rhumb_transport::{Direction, LinkTerms};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
/// As `Walk` drives.
const CLOSE: Tolerance = Tolerance::FINE;

fn put(id: BodyId) -> Command {
    Command::SetPose {
        id,
        position: glam::Vec3::new(0.0, 5.0, 0.0),
        rotation: glam::Quat::IDENTITY,
    }
}

#[test]
fn who_may_not_drive_is_told_why_and_drives_on_what_it_drove() {
    let mut walk = Walk::new(Pace::FreeRunning, 2, 2, 1);
    let (one, other) = (Avatars::id(0), Avatars::id(1));
    for (ids, why) in [
        (
            vec![one, Avatars::floor()],
            DriveError::NotKinematic(Avatars::floor()),
        ),
        (
            vec![Avatars::freight()],
            DriveError::NotKinematic(Avatars::freight()),
        ),
        (
            vec![BodyId::new(77, 0)],
            DriveError::UnknownBody(BodyId::new(77, 0)),
        ),
        (
            vec![BodyId::new(4, 1)],
            DriveError::UnknownBody(BodyId::new(4, 1)),
        ),
    ] {
        assert_eq!(walk.drive(&ids), Err(why));
    }
    walk.frame();
    let guest = walk.stage.enter(NORMAL);
    assert_eq!(
        drive(&mut walk.stage, guest, &[one]),
        Err(DriveError::NotYours(one))
    );
    // What is not granted to anybody any more may be driven by whoever comes first.
    walk.stage
        .arena
        .client_mut(COMMANDER)
        .leave()
        .expect("it is a member");
    walk.stage.run(TICK);
    assert_eq!(drive(&mut walk.stage, guest, &[one]), Ok(vec![one]));
    walk.stage.join(COMMANDER, NORMAL);
    let taken = walk.drive(&[one, other]);
    assert_eq!(taken, Err(DriveError::DrivenByAnother(one)));
    assert_eq!(walk.drive(&[other]), Ok(vec![other]));
    let session = walk.stage.arena.client_mut(COMMANDER);
    let tick = Tick::new(1_000);
    let foreign = session.publish(tick, &[(one, Avatars::walk(0, tick))]);
    assert_eq!(foreign, Err(Misuse::NotDriven(one)));
    let many: Vec<BodyId> = (0..257).map(|index| BodyId::new(index, 0)).collect();
    assert_eq!(session.drive(CLOSE, &many), Err(Misuse::TooManyDriven(257)));
}

#[test]
fn what_is_driven_takes_no_commands_and_what_is_no_longer_does() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    let guest = walk.stage.enter(NORMAL);
    let velocity = Command::SetVelocity {
        id,
        linear: glam::Vec3::X,
        angular: glam::Vec3::ZERO,
    };
    for command in [put(id), velocity] {
        walk.stage
            .arena
            .client_mut(guest)
            .command(command)
            .expect("a member may ask");
    }
    for _ in 0..100 {
        walk.frame();
    }
    let driven = Err(CommandError::Driven(id));
    let refused = &walk.stage.witnesses[guest].refused;
    assert_eq!(
        refused
            .iter()
            .map(|(_, error)| Err::<(), _>(*error))
            .collect::<Vec<_>>(),
        [driven; 2]
    );
    assert!(walk.judged > 50);
    assert_eq!(walk.drive(&[]), Ok(vec![]));
    let before = walk.at(id);
    walk.stage.run(Span::from_millis(500));
    let apart = Divergence::between(&before.pose(), &walk.at(id).pose());
    assert!(apart.position.metres() < 0.05, "it goes on by {apart:?}");
    walk.stage
        .arena
        .client_mut(guest)
        .command(put(id))
        .expect("a member may ask");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.stage.witnesses[guest].refused.len(), 2);
    assert!((walk.at(id).pose().position.y - 5.0).abs() < 1e-6);
}

#[test]
fn a_body_that_is_removed_is_driven_no_longer_and_its_index_may_come_again() {
    let mut walk = Walk::new(Pace::FreeRunning, 2, 2, 1);
    walk.over("rtt=80ms,loss=10%");
    let (gone, stays) = (Avatars::id(0), Avatars::id(1));
    for _ in 0..60 {
        walk.frame();
    }
    let guest = walk.stage.enter(NORMAL);
    let remove = Command::RemoveBody { id: gone };
    walk.stage
        .arena
        .client_mut(guest)
        .command(remove)
        .expect("a member may ask");
    for _ in 0..90 {
        let tick = walk.newest() + Ticks::new(6);
        let session = walk.stage.arena.client_mut(COMMANDER);
        let known: Vec<BodyId> = session.driven().collect();
        let motions = [(0, gone), (1, stays)];
        let motions = motions.into_iter().filter(|(_, id)| known.contains(id));
        let motions: Vec<_> = motions
            .map(|(place, id)| (id, Avatars::walk(place, tick)))
            .collect();
        session.publish(tick, &motions).expect("they are driven");
        walk.stage.run(TICK);
    }
    assert_eq!(
        walk.stage
            .arena
            .client(COMMANDER)
            .driven()
            .collect::<Vec<_>>(),
        [stays]
    );
    let drive = walk.statistics().expect("one is left");
    assert_eq!((drive.bodies, drive.heard.mismatches), (1, 0));
    let terms = walk.stage.copy(COMMANDER).body(stays).expect("it is there");
    let again = BodyId::new(gone.index(), 1);
    let terms = rhumb_protocol::scene::BodyTerms { id: again, ..terms };
    let motion = Avatars::walk(0, Tick::ZERO).stilled();
    walk.stage.command(&[Command::AddBody { terms, motion }]);
    walk.stage.run(Span::from_millis(300));
    assert_eq!(walk.drive(&[again, stays]), Ok(vec![again, stays]));
    walk.stage
        .arena
        .client_mut(guest)
        .delete()
        .expect("anybody may");
    walk.stage.run(Span::from_millis(500));
    assert_eq!(walk.stage.arena.client(COMMANDER).driven().count(), 0);
    assert_eq!(walk.stage.witnesses[COMMANDER].ended, None);
}

#[test]
fn a_silent_drivers_bodies_stand_still_and_go_on_when_it_is_heard_again() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    for _ in 0..60 {
        walk.frame();
    }
    let last = walk.newest();
    // Silent since a few ticks: it is trusted for a second and as many ticks.
    walk.stage.run(Span::from_millis(3_000));
    let stood = walk.at(Avatars::id(0));
    let way = f64::from(WALKED_METRES_IN_TWO_SECONDS);
    let from = Avatars::walk(0, last).motion().pose().position;
    assert!(stood.pose().position.distance(from) < way, "it flew on");
    assert!(stood.twist().linear.length() < 1e-3, "{stood:?}");
    walk.stage.run(Span::from_millis(3_000));
    assert_eq!(walk.at(Avatars::id(0)).pose(), stood.pose());
    let judged = walk.judged;
    for _ in 0..60 {
        walk.frame();
    }
    assert!(walk.judged > judged + 30);
}

/// At 1.4 m/s.
const WALKED_METRES_IN_TWO_SECONDS: f32 = 2.8;

#[test]
fn a_driver_that_paused_for_minutes_begins_anew_by_itself() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    for _ in 0..60 {
        walk.frame();
    }
    walk.stage.run(Span::from_millis(70_000));
    let judged = walk.judged;
    for _ in 0..120 {
        walk.frame();
    }
    assert!(walk.judged > judged + 60);
    assert_eq!(walk.stage.witnesses[COMMANDER].drives.len(), 2);
}

#[test]
fn who_leaves_or_breaks_off_drives_nothing_any_more() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    for _ in 0..60 {
        walk.frame();
    }
    walk.stage
        .arena
        .client_mut(COMMANDER)
        .leave()
        .expect("it is a member");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.statistics(), None);
    let stood = walk.at(id);
    walk.stage.run(Span::from_millis(1_000));
    assert_eq!(walk.at(id).pose(), stood.pose());
    walk.stage.join(COMMANDER, NORMAL);
    assert_eq!(walk.drive(&[id]), Ok(vec![id]));
    walk.said.clear();
    let judged = walk.judged;
    for _ in 0..60 {
        walk.frame();
    }
    assert!(walk.judged > judged + 30);
    walk.stage.arena.sever(COMMANDER, Ending::TimedOut);
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.statistics(), None);
}

#[test]
fn each_of_two_drivers_moves_its_own_and_sees_the_others() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 4, seed(23));
    let guest = walk.stage.enter(NORMAL);
    let granted = walk.stage.witnesses[guest].granted.expect("it is a member");
    let id = granted.id(0).expect("it was granted some");
    let mut terms = walk
        .stage
        .copy(guest)
        .body(Avatars::id(0))
        .expect("it is there");
    terms.id = id;
    // The same walk, from elsewhere and with other rests.
    let at = |tick| Avatars::walk(3, tick);
    let motion = at(Tick::ZERO).stilled();
    let add = Command::AddBody { terms, motion };
    walk.stage
        .arena
        .client_mut(guest)
        .command(add)
        .expect("it is a member");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(drive(&mut walk.stage, guest, &[id]), Ok(vec![id]));
    let links: LinkTerms = "rtt=50ms,loss=5%"
        .parse()
        .expect("the tests write links well");
    walk.stage.arena.set_terms(links);
    walk.stage
        .arena
        .set_terms_of(walk.watcher, Direction::Down, LinkTerms::PERFECT);
    let mut worst: f64 = 0.0;
    for frame in 0..400 {
        let tick = walk.newest() + Ticks::new(4);
        let session = walk.stage.arena.client_mut(guest);
        session.publish(tick, &[(id, at(tick))]).expect("it drives");
        walk.frame();
        if frame > 30 {
            let copy = walk.stage.copy(COMMANDER).stream();
            let seen = copy.believed(id, copy.complete()).expect("it is there");
            let said = at(copy.complete()).motion();
            worst = worst.max(seen.pose().position.distance(said.pose().position));
        }
    }
    // Two tolerances and what a lost packet may cost for a round trip or two.
    assert!(worst < 0.5, "off by {worst} m");
    assert!(walk.judged > 200, "{} were judged", walk.judged);
    let scene = "stage".parse().expect("a scene's name");
    assert_eq!(walk.stage.arena.server().drives(&scene).count(), 2);
}
