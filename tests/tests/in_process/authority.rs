//! Authority over bodies: grants, their end, and their effect on others.
//!
//! The tests run in virtual time with `Walk`; the accuracy of published bodies is tested in `upstream`.

use rhumb_netsim::{Direction, LinkConfig};
use rhumb_protocol::message::{AuthorityError, StreamChoice};
use rhumb_protocol::scene::{Command, CommandError, Stepping};
use rhumb_protocol::session::Misuse;
use rhumb_protocol::stream::ErrorBound;
use rhumb_protocol::{Ending, Span};
use rhumb_reckoning::{BodyId, Divergence, Tick, Ticks, Tolerance};
use rhumb_tests::{Avatars, COMMANDER, TICK, Walk, seed, take_authority};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
/// The tolerance that `Walk` uses.
const CLOSE: Tolerance = Tolerance::FINE;

fn put(id: BodyId) -> Command {
    Command::SetPose {
        id,
        position: glam::Vec3::new(0.0, 5.0, 0.0),
        rotation: glam::Quat::IDENTITY,
    }
}

#[test]
fn a_refused_authority_request_names_its_reason_and_keeps_earlier_grants() {
    let mut walk = Walk::new(Stepping::FreeRunning, 2, 2, 1);
    let (one, other) = (Avatars::id(0), Avatars::id(1));
    for (ids, why) in [
        (
            vec![one, Avatars::floor()],
            AuthorityError::NotKinematic(Avatars::floor()),
        ),
        (
            vec![Avatars::freight()],
            AuthorityError::NotKinematic(Avatars::freight()),
        ),
        (
            vec![BodyId::new(77, 0)],
            AuthorityError::UnknownBody(BodyId::new(77, 0)),
        ),
        (
            vec![BodyId::new(4, 1)],
            AuthorityError::UnknownBody(BodyId::new(4, 1)),
        ),
    ] {
        assert_eq!(walk.take_authority(&ids), Err(why));
    }
    walk.frame();
    let second = walk.stage.enter(NORMAL);
    assert_eq!(
        take_authority(&mut walk.stage, second, &[one]),
        Err(AuthorityError::NotYours(one))
    );
    // A body whose range was given up may be taken by any client.
    walk.stage
        .network
        .client_mut(COMMANDER)
        .leave()
        .expect("a member");
    walk.stage.run(TICK);
    assert_eq!(
        take_authority(&mut walk.stage, second, &[one]),
        Ok(vec![one])
    );
    walk.stage.join(COMMANDER, NORMAL);
    let taken = walk.take_authority(&[one, other]);
    assert_eq!(taken, Err(AuthorityError::HeldByAnother(one)));
    assert_eq!(walk.take_authority(&[other]), Ok(vec![other]));
    let session = walk.stage.network.client_mut(COMMANDER);
    let tick = Tick::new(1_000);
    let foreign = session.publish(tick, &[(one, Avatars::walk(0, tick))]);
    assert_eq!(foreign, Err(Misuse::NoAuthority(one)));
    let many: Vec<BodyId> = (0..257).map(|index| BodyId::new(index, 0)).collect();
    assert_eq!(
        session.take_authority(CLOSE, &many),
        Err(Misuse::TooManyAuthorityBodies(257))
    );
}

#[test]
fn a_body_under_client_authority_refuses_commands_until_it_is_released() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    let second = walk.stage.enter(NORMAL);
    let velocity = Command::SetVelocity {
        id,
        linear: glam::Vec3::X,
        angular: glam::Vec3::ZERO,
    };
    for command in [put(id), velocity] {
        walk.stage
            .network
            .client_mut(second)
            .command(command)
            .expect("a member may send commands");
    }
    for _ in 0..100 {
        walk.frame();
    }
    let under_authority = Err(CommandError::UnderAuthority(id));
    let refused = &walk.stage.histories[second].refused;
    assert_eq!(
        refused
            .iter()
            .map(|(_, error)| Err::<(), _>(*error))
            .collect::<Vec<_>>(),
        [under_authority; 2]
    );
    assert!(walk.judged > 50);
    assert_eq!(walk.take_authority(&[]), Ok(vec![]));
    let before = walk.at(id);
    walk.stage.run(Span::from_millis(500));
    let apart = Divergence::between(&before.pose(), &walk.at(id).pose());
    assert!(
        apart.position.metres() < 0.05,
        "its trajectory continues, {apart:?} apart"
    );
    walk.stage
        .network
        .client_mut(second)
        .command(put(id))
        .expect("a member may send commands");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.stage.histories[second].refused.len(), 2);
    assert!((walk.at(id).pose().position.y - 5.0).abs() < 1e-6);
}

#[test]
fn a_removed_body_ends_its_authority_and_its_index_can_be_reused() {
    let mut walk = Walk::new(Stepping::FreeRunning, 2, 2, 1);
    walk.set_link("rtt=80ms,loss=10%");
    let (removed, stays) = (Avatars::id(0), Avatars::id(1));
    for _ in 0..60 {
        walk.frame();
    }
    let second = walk.stage.enter(NORMAL);
    let remove = Command::RemoveBody { id: removed };
    walk.stage
        .network
        .client_mut(second)
        .command(remove)
        .expect("a member may send commands");
    for _ in 0..90 {
        let tick = walk.newest() + Ticks::new(6);
        let session = walk.stage.network.client_mut(COMMANDER);
        let known: Vec<BodyId> = session.authority_bodies().collect();
        let motions = [(0, removed), (1, stays)];
        let motions = motions.into_iter().filter(|(_, id)| known.contains(id));
        let motions: Vec<_> = motions
            .map(|(place, id)| (id, Avatars::walk(place, tick)))
            .collect();
        session
            .publish(tick, &motions)
            .expect("bodies under authority");
        walk.stage.run(TICK);
    }
    assert_eq!(
        walk.stage
            .network
            .client(COMMANDER)
            .authority_bodies()
            .collect::<Vec<_>>(),
        [stays]
    );
    let status = walk.statistics().expect("one body is left");
    assert_eq!((status.bodies, status.received.mismatches), (1, 0));
    let desc = walk
        .stage
        .copy(COMMANDER)
        .body(stays)
        .expect("an existing body");
    let again = BodyId::new(removed.index(), 1);
    let desc = rhumb_protocol::scene::BodyDesc { id: again, ..desc };
    let motion = Avatars::walk(0, Tick::ZERO).stilled();
    walk.stage.command(&[Command::AddBody { desc, motion }]);
    walk.stage.run(Span::from_millis(300));
    assert_eq!(walk.take_authority(&[again, stays]), Ok(vec![again, stays]));
    walk.stage
        .network
        .client_mut(second)
        .delete()
        .expect("any member may");
    walk.stage.run(Span::from_millis(500));
    assert_eq!(
        walk.stage
            .network
            .client(COMMANDER)
            .authority_bodies()
            .count(),
        0
    );
    assert_eq!(walk.stage.histories[COMMANDER].ended, None);
}

#[test]
fn bodies_of_a_silent_client_stop_and_resume_with_its_upstream() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    for _ in 0..60 {
        walk.frame();
    }
    let last = walk.newest();
    // The client has been silent for a few ticks. The server predicts its bodies for one second more.
    walk.stage.run(Span::from_millis(3_000));
    let stood = walk.at(Avatars::id(0));
    let way = f64::from(WALKED_METRES_IN_TWO_SECONDS);
    let from = Avatars::walk(0, last).motion().pose().position;
    assert!(
        stood.pose().position.distance(from) < way,
        "it moved on by prediction"
    );
    assert!(stood.twist().linear.length() < 1e-3, "{stood:?}");
    walk.stage.run(Span::from_millis(3_000));
    assert_eq!(walk.at(Avatars::id(0)).pose(), stood.pose());
    let judged = walk.judged;
    for _ in 0..60 {
        walk.frame();
    }
    assert!(walk.judged > judged + 30);
}

#[test]
fn followers_learn_of_a_silent_publisher_and_have_no_bound_until_it_is_active() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    walk.set_link("rtt=60ms");
    let id = Avatars::id(0);
    let follower = walk.stage.enter(NORMAL);
    let bound = |walk: &Walk, client| {
        let stream = walk.stage.copy(client).stream();
        stream.bound(id).expect("an existing body")
    };
    for _ in 0..60 {
        walk.frame();
    }
    assert!(matches!(bound(&walk, follower), ErrorBound::Within(_)));
    walk.stage.run(Span::from_millis(1_000));
    let [(silent, since)] = walk.stage.histories[follower].silent[..] else {
        panic!("one body of one publisher is silent");
    };
    assert_eq!(silent, id);
    assert!(since <= walk.stage.copy(follower).stream().complete());
    // One that joins meanwhile learns it from the snapshot.
    let later = walk.stage.enter(NORMAL);
    walk.stage.run(Span::from_millis(200));
    for client in [follower, later] {
        assert!(matches!(bound(&walk, client), ErrorBound::Unknown { .. }));
    }
    for _ in 0..60 {
        walk.frame();
    }
    let [(active, tick)] = walk.stage.histories[follower].active[..] else {
        panic!("one body is active again");
    };
    assert_eq!(active, id);
    assert!(tick > since);
    for client in [follower, later] {
        assert!(matches!(bound(&walk, client), ErrorBound::Within(_)));
    }
    // A connection that breaks off gives its bodies back: what stands still then is the truth.
    walk.stage.run(Span::from_millis(1_000));
    assert!(matches!(bound(&walk, follower), ErrorBound::Unknown { .. }));
    walk.stage.network.sever(COMMANDER, Ending::TimedOut);
    walk.stage.run(Span::from_millis(300));
    assert!(matches!(bound(&walk, follower), ErrorBound::Within(_)));
    assert_eq!(walk.stage.histories[follower].active.len(), 2);
}

/// Path in two seconds at 1.4 m/s.
const WALKED_METRES_IN_TWO_SECONDS: f32 = 2.8;

#[test]
fn a_client_that_paused_for_minutes_retakes_authority_by_itself() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    for _ in 0..60 {
        walk.frame();
    }
    walk.stage.run(Span::from_millis(70_000));
    let judged = walk.judged;
    for _ in 0..120 {
        walk.frame();
    }
    assert!(walk.judged > judged + 60);
    assert_eq!(walk.stage.histories[COMMANDER].authority_answers.len(), 2);
}

#[test]
fn a_client_that_leaves_or_disconnects_loses_its_authority() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    for _ in 0..60 {
        walk.frame();
    }
    walk.stage
        .network
        .client_mut(COMMANDER)
        .leave()
        .expect("a member");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.statistics(), None);
    let stood = walk.at(id);
    walk.stage.run(Span::from_millis(1_000));
    assert_eq!(walk.at(id).pose(), stood.pose());
    walk.stage.join(COMMANDER, NORMAL);
    assert_eq!(walk.take_authority(&[id]), Ok(vec![id]));
    walk.published.clear();
    let judged = walk.judged;
    for _ in 0..60 {
        walk.frame();
    }
    assert!(walk.judged > judged + 30);
    walk.stage.network.sever(COMMANDER, Ending::TimedOut);
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.statistics(), None);
}

#[test]
fn two_clients_with_authority_move_their_own_bodies_and_see_the_others() {
    let mut walk = Walk::new(Stepping::FreeRunning, 1, 4, seed(23));
    let second = walk.stage.enter(NORMAL);
    let granted = walk.stage.histories[second]
        .granted
        .expect("a member has a range");
    let id = granted.id(0).expect("a granted index");
    let mut desc = walk
        .stage
        .copy(second)
        .body(Avatars::id(0))
        .expect("an existing body");
    desc.id = id;
    // The same trajectory, shifted in space and time.
    let at = |tick| Avatars::walk(3, tick);
    let motion = at(Tick::ZERO).stilled();
    let add = Command::AddBody { desc, motion };
    walk.stage
        .network
        .client_mut(second)
        .command(add)
        .expect("a member");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(take_authority(&mut walk.stage, second, &[id]), Ok(vec![id]));
    let links: LinkConfig = "rtt=50ms,loss=5%"
        .parse()
        .expect("a valid link configuration");
    walk.stage.network.set_config(links);
    walk.stage
        .network
        .set_config_of(walk.watcher, Direction::Down, LinkConfig::PERFECT);
    let mut worst: f64 = 0.0;
    for frame in 0..400 {
        let tick = walk.newest() + Ticks::new(4);
        let session = walk.stage.network.client_mut(second);
        session
            .publish(tick, &[(id, at(tick))])
            .expect("a body under authority");
        walk.frame();
        if frame > 30 {
            let copy = walk.stage.copy(COMMANDER).stream();
            let displayed = copy
                .predicted_motion(id, copy.complete())
                .expect("an existing body");
            let published = at(copy.complete()).motion();
            worst = worst.max(
                displayed
                    .pose()
                    .position
                    .distance(published.pose().position),
            );
        }
    }
    // Two tolerances, and the prediction error while a packet is lost for a round trip or two.
    assert!(worst < 0.5, "the error is {worst} m");
    assert!(
        walk.judged > 200,
        "only {} states were checked",
        walk.judged
    );
    let scene = "stage".parse().expect("a valid scene name");
    assert_eq!(walk.stage.network.server().upstreams(&scene).count(), 2);
}
