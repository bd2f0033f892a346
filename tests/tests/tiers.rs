//! Members change streams, or have tracks made right, in a scene that goes on.
//!
//! Proved as in `pretend_network`: what a member claims is held against the truth, whichever stream it has it from.

use glam::{Quat, Vec3};
use rhumb_protocol::message::{ClientMessage, Denial, MoveCause, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{Low16, StreamId, Vouch};
use rhumb_protocol::scene::{BodyKind, BodyTerms, Command, Pace};
use rhumb_protocol::session::Event;
use rhumb_protocol::stream::Manner;
use rhumb_protocol::{Endpoint, Instant, Span};
use rhumb_reckoning::{BodyId, Tick, Tolerance, Track, Verbatim};
use rhumb_sims::by_name;
use rhumb_tests::{COMMANDER, Stage, TICK, Told, assert_same_copy, seed};
use rhumb_transport::LinkTerms;

const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
const FINE: StreamChoice = StreamChoice::Within(Tolerance::FINE);
const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
const COARSE: StreamChoice = StreamChoice::Within(Tolerance::COARSE);

fn stage(pace: Pace, links: &str, seed: u64) -> Stage {
    let script = by_name("zoo", 60, 1).expect("the scene is known by name");
    let links: LinkTerms = links.parse().expect("the tests write possible terms");
    Stage::new(script, pace, NORMAL, links, seed)
}

#[test]
fn a_member_changes_its_tier_in_lockstep_and_misses_no_tick() {
    let mut stage = stage(Pace::Lockstep, "", 1);
    let other = stage.enter(NORMAL);
    let choices = [EXACT, COARSE, FINE, StreamChoice::Full, NORMAL];
    for (place, choice) in choices.into_iter().enumerate() {
        // What is asked for already is not asked for twice.
        stage.arena.client_mut(other).follow(choice).unwrap();
        stage.arena.client_mut(other).follow(choice).unwrap();
        for _ in 0..40 {
            let tick = stage.tick();
            assert_eq!(stage.copy(other).stream().complete(), tick, "to {choice:?}");
        }
        assert_eq!(stage.copy(other).choice(), choice);
        assert_eq!(stage.witnesses[other].following.len(), place + 1);
    }
    assert_same_copy(stage.copy(COMMANDER), stage.copy(other));
    let truth = stage.truth();
    stage.witnesses[other].judge(&truth, "who changes its tier");
}

#[test]
fn no_claim_breaks_and_no_tick_is_taken_back_while_streams_are_changed_over_bad_links() {
    for links in [
        "rtt=200ms,loss=10%,jitter=20ms",
        "rtt=60ms,loss=20%,burst=8,dup=5%,reorder=10%",
    ] {
        let seed = seed(21);
        let what = format!("{links}, seed {seed}");
        let mut stage = stage(Pace::FreeRunning, links, seed);
        let other = stage.enter(NORMAL);
        let mut complete = Tick::ZERO;
        // At such loss the full one is hardly ever complete: what is shown waits for the next choice then.
        let choices = [
            COARSE,
            EXACT,
            NORMAL,
            StreamChoice::Full,
            FINE,
            FINE,
            NORMAL,
        ];
        for turn in 0..28 {
            // Some are wanted before the last one is answered, and most before it is shown.
            let choice = choices[turn % choices.len()];
            let asked = stage.arena.client_mut(other).follow(choice);
            assert_eq!(asked, Ok(()), "{what}");
            stage.drive(Span::from_millis([100, 300, 900][turn % 3]));
            let now = stage.copy(other).stream().complete();
            assert!(now >= complete, "{what}: back from {complete} to {now}");
            complete = now;
        }
        assert_eq!(stage.witnesses[other].denied, [], "{what}");
        stage.arena.set_terms(LinkTerms::PERFECT);
        stage.run(Span::from_millis(40_000));
        assert!(stage.copy(other).stream().is_settled(), "{what}");
        // While much is lost a change may have to wait; now none does.
        assert!(!stage.witnesses[other].following.is_empty(), "{what}");
        assert_eq!(
            stage.arena.client_mut(other).follow(COARSE),
            Ok(()),
            "{what}"
        );
        stage.run(Span::from_millis(1_000));
        assert_eq!(stage.copy(other).choice(), COARSE, "{what}");
        let truth = stage.truth();
        stage.witnesses[other].judge(&truth, &what);
        stage.witnesses[COMMANDER].judge(&truth, &what);
    }
}

#[test]
fn whatever_is_not_complete_yet_another_stream_can_be_chosen_and_is_followed() {
    let seed = seed(23);
    let mut stage = stage(Pace::FreeRunning, "rtt=60ms,loss=20%,burst=8", seed);
    let other = stage.enter(NORMAL);
    let follow = |stage: &mut Stage, choice| {
        let asked = stage.arena.client_mut(other).follow(choice);
        assert_eq!(asked, Ok(()), "seed {seed}");
    };
    follow(&mut stage, StreamChoice::Full);
    stage.drive(Span::from_millis(3_000));
    // A member that changes its mind at every tick is not told a stream each time, and the last one counts.
    for turn in 0..30 {
        follow(&mut stage, [EXACT, COARSE, StreamChoice::Full][turn % 3]);
        stage.drive(TICK);
    }
    follow(&mut stage, FINE);
    stage.drive(Span::from_millis(10_000));
    assert_eq!(stage.copy(other).choice(), FINE, "seed {seed}");
    let followed = &stage.witnesses[other].following;
    assert_eq!(followed.last(), Some(&FINE), "seed {seed}");
    assert_eq!(stage.witnesses[other].denied, [], "seed {seed}");
}

/// Gives a member's copy of a body a track that nobody said; returns the body.
fn spoil(stage: &mut Stage, member: usize) -> BodyId {
    let copy = stage.copy(member);
    let moving = |terms: &BodyTerms| terms.kind == BodyKind::Dynamic;
    let terms = copy
        .bodies()
        .filter(moving)
        .last()
        .unwrap_or_else(|| panic!("nothing moves of {}", copy.bodies().count()));
    let shape = copy.shape(terms.shape).expect("a body has a shape").clone();
    let manner = Manner::of(&terms, &shape, stage.terms().damping, None);
    let elsewhere = Verbatim::new([9.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
        .expect("a place is finite");
    let track = Track::resting(copy.stream().vouched(), elsewhere);
    let copy = stage
        .arena
        .client_mut(member)
        .replica_mut()
        .expect("a member has a copy");
    assert!(copy.stream_mut().place(terms.id, &manner, track));
    terms.id
}

#[test]
fn a_track_that_is_not_what_was_said_is_named_and_made_right_at_both_ends() {
    for links in ["", "rtt=80ms,loss=5%"] {
        let script = by_name("ball-pit", 60, 1).expect("the scene is known by name");
        let links: LinkTerms = links.parse().unwrap();
        let mut stage = Stage::new(script, Pace::FreeRunning, NORMAL, links, seed(22));
        let other = stage.enter(NORMAL);
        stage.drive(Span::from_millis(2_000));
        stage.run_until_or(Span::from_millis(60_000), |stage| {
            stage
                .copy(other)
                .bodies()
                .any(|terms| terms.kind == BodyKind::Dynamic)
        });
        // One that is said anew by chance needs no repair: another is spoiled then.
        let mut spoiled = Vec::new();
        while stage.witnesses[other].amended.is_empty() {
            assert!(spoiled.len() < 100, "no track was made right");
            spoiled.push(spoil(&mut stage, other));
            stage.drive(Span::from_millis(2_000));
        }
        assert!(spoiled.contains(&stage.witnesses[other].amended[0]));
        let heard = stage.copy(other).stream().statistics();
        assert!(heard.mismatches >= 1 && heard.amended >= 1);
        stage.arena.set_terms(LinkTerms::PERFECT);
        stage.arena.client_mut(other).inspect().unwrap();
        stage.run(Span::from_millis(8_000));
        let inspected = stage.witnesses[other].inspections.last().unwrap();
        assert!(inspected.amended >= 1);
        assert_same_copy(stage.copy(COMMANDER), stage.copy(other));
        assert_eq!(stage.witnesses[COMMANDER].amended, []);
    }
}

#[test]
fn a_stream_that_begins_when_bodies_were_just_put_elsewhere_tells_where_they_were() {
    let mut stage = stage(Pace::Lockstep, "", 1);
    let other = stage.enter(NORMAL);
    stage.tick();
    for choice in [COARSE, EXACT, StreamChoice::Full, FINE] {
        let dynamic = |terms: &BodyTerms| terms.kind == BodyKind::Dynamic;
        let bodies = stage.copy(other).bodies().filter(dynamic);
        let ids: Vec<BodyId> = bodies.skip(3).take(4).map(|terms| terms.id).collect();
        let elsewhere = |id: BodyId| Command::SetPose {
            id,
            position: Vec3::new(id.index() as f32 * 3.0, 20.0, 20.0),
            rotation: Quat::IDENTITY,
        };
        let commands: Vec<Command> = ids.into_iter().map(elsewhere).collect();
        stage.command(&commands);
        // The scene has not stepped when the stream begins.
        stage.arena.client_mut(other).follow(choice).unwrap();
        stage.run(Span::from_millis(50));
        assert_eq!(stage.copy(other).choice(), choice);
        let client = stage.arena.client(other);
        stage.witnesses[other].look_at_all(client);
        for _ in 0..20 {
            stage.tick();
        }
    }
    let truth = stage.truth();
    stage.witnesses[other].judge(&truth, "who changes its tier");
}

#[test]
fn a_stream_that_nobody_follows_ends_so_that_others_can_begin() {
    let mut stage = stage(Pace::Lockstep, "", 1);
    let other = stage.enter(NORMAL);
    // More choices than a scene may have streams at one time.
    for millimetres in 1..40 {
        let choice =
            StreamChoice::Within(Tolerance::from_micrometres(millimetres * 1_000).unwrap());
        stage.arena.client_mut(other).follow(choice).unwrap();
        stage.tick();
        assert_eq!(stage.copy(other).choice(), choice);
    }
    assert_eq!(stage.witnesses[other].denied, []);
}

#[test]
fn a_change_that_is_denied_changes_nothing() {
    let mut stage = stage(Pace::Lockstep, "", 1);
    let tolerance = |millimetres: u32| {
        StreamChoice::Within(Tolerance::from_micrometres(millimetres * 1_000).unwrap())
    };
    for millimetres in 1..=7 {
        stage.enter(tolerance(millimetres));
    }
    stage.tick();
    stage
        .arena
        .client_mut(COMMANDER)
        .follow(tolerance(100))
        .unwrap();
    stage.tick();
    assert_eq!(stage.witnesses[COMMANDER].denied, [Denial::TooManyStreams]);
    assert_eq!(stage.copy(COMMANDER).choice(), NORMAL);
    // One that exists can be followed.
    stage
        .arena
        .client_mut(COMMANDER)
        .follow(tolerance(3))
        .unwrap();
    let tick = stage.tick();
    assert_eq!(stage.copy(COMMANDER).choice(), tolerance(3));
    assert_eq!(stage.copy(COMMANDER).stream().complete(), tick);
}

#[test]
fn each_tier_is_encoded_once_whoever_listens() {
    let said = |listeners: usize| {
        let mut stage = stage(Pace::Lockstep, "", 1);
        let others: Vec<usize> = [EXACT, FINE, NORMAL, COARSE]
            .into_iter()
            .flat_map(|tier| vec![tier; listeners])
            .map(|tier| stage.enter(tier))
            .collect();
        for _ in 0..120 {
            stage.tick();
        }
        let inspected = others.iter().step_by(listeners).map(|member| {
            let session = stage.arena.client_mut(*member);
            session.inspect().expect("it is a member");
            stage.run(Span::from_millis(50));
            let inspection = stage.witnesses[*member].inspections[0];
            (
                inspection.updates,
                inspection.packets,
                inspection.packet_bytes,
            )
        });
        inspected.collect::<Vec<_>>()
    };
    let alone = said(1);
    assert!(alone.iter().all(|(updates, ..)| *updates > 0));
    assert!(alone[0].0 > alone[3].0, "a finer tier says more: {alone:?}");
    assert_eq!(said(6), alone);
}

/// A member that follows a stream of an empty scene at a tick.
fn told(choice: StreamChoice, stream: u32, tick: u64) -> Told {
    let mut told = Told::welcomed(choice);
    tell_snapshot(&mut told, choice, stream, tick);
    while told.session.poll_event().is_some() {}
    said(&mut told);
    told
}

/// The whole of an empty scene at a tick.
fn tell_snapshot(told: &mut Told, choice: StreamChoice, stream: u32, tick: u64) {
    let terms = by_name("zoo", 1, 1)
        .expect("the scene is known by name")
        .terms();
    told.tell_snapshot(&terms, choice, (StreamId(stream), Tick::new(tick)), &[]);
}

/// What it said since the last look, of streams.
fn said(told: &mut Told) -> Vec<ClientMessage> {
    let mut said = told.said();
    said.retain(|message| {
        matches!(
            message,
            ClientMessage::Follow(_) | ClientMessage::Followed(_)
        )
    });
    said
}

fn shown(told: &Told) -> StreamChoice {
    let copy = told.session.replica();
    copy.expect("a member has a copy").choice()
}

#[test]
fn who_is_moved_before_its_choice_is_shown_can_choose_again_and_is_told_what_it_follows() {
    let mut told = told(FINE, 0, 10);
    let (follow, followed) = (ClientMessage::Follow, |stream| {
        ClientMessage::Followed(StreamId(stream))
    });
    told.session.follow(EXACT).unwrap();
    assert_eq!(said(&mut told), [follow(EXACT)]);
    // As long as it is not as far as what is shown, it is not shown.
    tell_snapshot(&mut told, EXACT, 1, 5);
    let (to, cause) = (FINE, MoveCause::Thin);
    told.tell(&[ServerMessage::Moved { to, cause }]);
    tell_snapshot(&mut told, FINE, 2, 6);
    assert_eq!((shown(&told), said(&mut told)), (FINE, vec![]));
    assert_eq!(told.session.poll_event(), Some(Event::Moved { to, cause }));
    told.session.follow(EXACT).unwrap();
    assert_eq!(said(&mut told), [follow(EXACT)]);
    // One that comes meanwhile is left out, and of two that are wanted meanwhile the first.
    told.session.follow(COARSE).unwrap();
    told.session.follow(NORMAL).unwrap();
    assert_eq!(said(&mut told), []);
    tell_snapshot(&mut told, EXACT, 3, 8);
    assert_eq!(said(&mut told), [follow(NORMAL)]);
    tell_snapshot(&mut told, NORMAL, 4, 11);
    assert_eq!((shown(&told), said(&mut told)), (NORMAL, vec![followed(4)]));
    assert_eq!(told.session.poll_event(), Some(Event::Following(NORMAL)));
    // A move to what it follows already is told as any.
    let (to, cause) = (NORMAL, MoveCause::Eased);
    told.tell(&[ServerMessage::Moved { to, cause }]);
    tell_snapshot(&mut told, NORMAL, 5, 12);
    assert_eq!(said(&mut told), [followed(5)]);
    assert_eq!(told.session.poll_event(), Some(Event::Moved { to, cause }));
    assert_eq!(told.session.poll_event(), Some(Event::Following(NORMAL)));
}

#[test]
fn who_asks_for_another_stream_keeps_the_copy_that_the_server_still_says() {
    let mut told = told(FINE, 0, 10);
    told.session.follow(EXACT).unwrap();
    tell_snapshot(&mut told, EXACT, 1, 5);
    told.session.follow(NORMAL).unwrap();
    said(&mut told);
    // The one between could be shown now, but ended with the question.
    let vouch = Vouch {
        next: Low16(0),
        tick: Low16(20),
        notices: Low16(0),
    };
    let datagram = vouch.encode(StreamId(1));
    told.session
        .handle_datagram(Instant::ZERO, Told::SERVER, &datagram);
    assert_eq!((shown(&told), said(&mut told)), (FINE, vec![]));
    // When it is denied, the one between goes on.
    told.tell(&[ServerMessage::Denied(Denial::TooManyStreams)]);
    let followed = ClientMessage::Followed(StreamId(1));
    assert_eq!((shown(&told), said(&mut told)), (EXACT, vec![followed]));
}
