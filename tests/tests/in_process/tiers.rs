//! Members change streams, or correct tracks, while a scene runs.
//!
//! As in `simulated_network`, the claims of members are checked against the truth, whichever stream they are from.

use glam::{Quat, Vec3};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::message::{
    ClientMessage, Denial, ServerMessage, StreamChoice, TierChangeCause,
};
use rhumb_protocol::packet::{Low16, StreamId, Watermark};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Stepping};
use rhumb_protocol::session::Event;
use rhumb_protocol::stream::PredictionParameters;
use rhumb_protocol::{Endpoint, Instant, Span};
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance, Track};
use rhumb_sims::by_name;
use rhumb_tests::{COMMANDER, ScriptedSession, Stage, TICK, assert_same_copy, seed};

const EXACT: StreamChoice = StreamChoice::Within(Tolerance::EXACT);
const FINE: StreamChoice = StreamChoice::Within(Tolerance::FINE);
const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
const COARSE: StreamChoice = StreamChoice::Within(Tolerance::COARSE);

fn stage(stepping: Stepping, links: &str, seed: u64) -> Stage {
    let script = by_name("zoo", 60, 1).expect("an existing script");
    let links: LinkConfig = links.parse().expect("a valid link configuration");
    Stage::new(script, stepping, NORMAL, links, seed)
}

#[test]
fn a_member_changes_its_tier_in_lockstep_and_misses_no_tick() {
    let mut stage = stage(Stepping::Lockstep, "", 1);
    let other = stage.enter(NORMAL);
    let choices = [EXACT, COARSE, FINE, StreamChoice::Full, NORMAL];
    for (place, choice) in choices.into_iter().enumerate() {
        // A choice that is already pending is not sent twice.
        stage.network.client_mut(other).subscribe(choice).unwrap();
        stage.network.client_mut(other).subscribe(choice).unwrap();
        for _ in 0..40 {
            let tick = stage.tick();
            assert_eq!(stage.copy(other).stream().complete(), tick, "to {choice:?}");
        }
        assert_eq!(stage.copy(other).choice(), choice);
        assert_eq!(stage.histories[other].following.len(), place + 1);
    }
    assert_same_copy(stage.copy(COMMANDER), stage.copy(other));
    let truth = stage.truth();
    stage.histories[other].judge(&truth, "the member that changes its tier");
}

#[test]
fn no_claim_breaks_and_no_tick_is_taken_back_while_streams_are_changed_over_bad_links() {
    for links in [
        "rtt=200ms,loss=10%,jitter=20ms",
        "rtt=60ms,loss=20%,burst=8,dup=5%,reorder=10%",
    ] {
        let seed = seed(21);
        let what = format!("{links}, seed {seed}");
        let mut stage = stage(Stepping::FreeRunning, links, seed);
        let other = stage.enter(NORMAL);
        let mut complete = Tick::ZERO;
        // At such loss the full stream is hardly ever complete, so the display waits for the next choice.
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
            // Some choices are made before the last one is answered, and most before it is displayed.
            let choice = choices[turn % choices.len()];
            let asked = stage.network.client_mut(other).subscribe(choice);
            assert_eq!(asked, Ok(()), "{what}");
            stage.run_script(Span::from_millis([100, 300, 900][turn % 3]));
            let now = stage.copy(other).stream().complete();
            assert!(now >= complete, "{what}: back from {complete} to {now}");
            complete = now;
        }
        assert_eq!(stage.histories[other].denied, [], "{what}");
        stage.network.set_config(LinkConfig::PERFECT);
        stage.run(Span::from_millis(40_000));
        assert!(stage.copy(other).stream().is_converged(), "{what}");
        // During heavy loss a change may be delayed; now it must succeed.
        assert!(!stage.histories[other].following.is_empty(), "{what}");
        assert_eq!(
            stage.network.client_mut(other).subscribe(COARSE),
            Ok(()),
            "{what}"
        );
        stage.run(Span::from_millis(1_000));
        assert_eq!(stage.copy(other).choice(), COARSE, "{what}");
        let truth = stage.truth();
        stage.histories[other].judge(&truth, &what);
        stage.histories[COMMANDER].judge(&truth, &what);
    }
}

#[test]
fn another_stream_can_be_chosen_before_the_last_choice_is_complete() {
    let seed = seed(23);
    let mut stage = stage(Stepping::FreeRunning, "rtt=60ms,loss=20%,burst=8", seed);
    let other = stage.enter(NORMAL);
    let follow = |stage: &mut Stage, choice| {
        let asked = stage.network.client_mut(other).subscribe(choice);
        assert_eq!(asked, Ok(()), "seed {seed}");
    };
    follow(&mut stage, StreamChoice::Full);
    stage.run_script(Span::from_millis(3_000));
    // A member that changes its choice at every tick does not receive a stream for each; the last choice counts.
    for turn in 0..30 {
        follow(&mut stage, [EXACT, COARSE, StreamChoice::Full][turn % 3]);
        stage.run_script(TICK);
    }
    follow(&mut stage, FINE);
    stage.run_script(Span::from_millis(10_000));
    assert_eq!(stage.copy(other).choice(), FINE, "seed {seed}");
    let followed = &stage.histories[other].following;
    assert_eq!(followed.last(), Some(&FINE), "seed {seed}");
    assert_eq!(stage.histories[other].denied, [], "seed {seed}");
}

/// Replaces a track in a member's copy by a wrong one.
fn spoil(stage: &mut Stage, member: usize) {
    let copy = stage.copy(member);
    let moving = |desc: &BodyDesc| desc.kind == BodyKind::Dynamic;
    let desc = copy
        .bodies()
        .filter(moving)
        .last()
        .unwrap_or_else(|| panic!("none of {} bodies moves", copy.bodies().count()));
    let shape = copy.shape(desc.shape).expect("a body has a shape").clone();
    let parameters = PredictionParameters::of(&desc, &shape, stage.config().damping, None);
    let elsewhere =
        BodyState::new([9.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("a finite state");
    let track = Track::resting(copy.stream().watermark_tick(), elsewhere);
    let copy = stage
        .network
        .client_mut(member)
        .replica_mut()
        .expect("a member has a copy");
    assert!(copy.stream_mut().place(desc.id, &parameters, track));
}

#[test]
fn a_checksum_mismatch_brings_a_new_snapshot_and_is_counted_by_server_and_client() {
    for links in ["", "rtt=80ms,loss=5%"] {
        let script = by_name("ball-pit", 60, 1).expect("an existing script");
        let links: LinkConfig = links.parse().unwrap();
        let mut stage = Stage::new(script, Stepping::FreeRunning, NORMAL, links, seed(22));
        let other = stage.enter(NORMAL);
        stage.run_script(Span::from_millis(2_000));
        stage.run_until_or(Span::from_millis(60_000), |stage| {
            stage
                .copy(other)
                .bodies()
                .any(|desc| desc.kind == BodyKind::Dynamic)
        });
        // A track that happens to be updated is right again: then another one is altered.
        let mut spoiled = 0;
        while stage.histories[other].mismatches == 0 {
            assert!(spoiled < 100, "no mismatch was found");
            spoil(&mut stage, other);
            spoiled += 1;
            stage.run_script(Span::from_millis(2_000));
        }
        stage.run(Span::from_millis(2_000));
        assert!(stage.copy(other).stream().statistics().mismatches >= 1);
        stage.network.set_config(LinkConfig::PERFECT);
        stage.network.client_mut(other).inspect().unwrap();
        stage.run(Span::from_millis(8_000));
        let inspected = stage.histories[other].inspections.last().unwrap();
        assert!(inspected.mismatches >= 1);
        assert_same_copy(stage.copy(COMMANDER), stage.copy(other));
        assert_eq!(stage.histories[COMMANDER].mismatches, 0);
    }
}

#[test]
fn a_stream_that_begins_just_after_a_teleport_has_the_earlier_states() {
    let mut stage = stage(Stepping::Lockstep, "", 1);
    let other = stage.enter(NORMAL);
    stage.tick();
    for choice in [COARSE, EXACT, StreamChoice::Full, FINE] {
        let dynamic = |desc: &BodyDesc| desc.kind == BodyKind::Dynamic;
        let bodies = stage.copy(other).bodies().filter(dynamic);
        let ids: Vec<BodyId> = bodies.skip(3).take(4).map(|desc| desc.id).collect();
        let elsewhere = |id: BodyId| Command::SetPose {
            id,
            position: Vec3::new(id.index() as f32 * 3.0, 20.0, 20.0),
            rotation: Quat::IDENTITY,
        };
        let commands: Vec<Command> = ids.into_iter().map(elsewhere).collect();
        stage.command(&commands);
        // The scene has not stepped since the teleport when the stream begins.
        stage.network.client_mut(other).subscribe(choice).unwrap();
        stage.run(Span::from_millis(50));
        assert_eq!(stage.copy(other).choice(), choice);
        let client = stage.network.client(other);
        stage.histories[other].store_all_claims(client);
        for _ in 0..20 {
            stage.tick();
        }
    }
    let truth = stage.truth();
    stage.histories[other].judge(&truth, "the member that changes its tier");
}

#[test]
fn a_stream_without_subscribers_ends_so_that_others_can_begin() {
    let mut stage = stage(Stepping::Lockstep, "", 1);
    let other = stage.enter(NORMAL);
    // More choices than a scene may have streams at a time.
    for millimetres in 1..40 {
        let choice =
            StreamChoice::Within(Tolerance::from_micrometres(millimetres * 1_000).unwrap());
        stage.network.client_mut(other).subscribe(choice).unwrap();
        stage.tick();
        assert_eq!(stage.copy(other).choice(), choice);
    }
    assert_eq!(stage.histories[other].denied, []);
}

#[test]
fn a_change_that_is_denied_changes_nothing() {
    let mut stage = stage(Stepping::Lockstep, "", 1);
    let tolerance = |millimetres: u32| {
        StreamChoice::Within(Tolerance::from_micrometres(millimetres * 1_000).unwrap())
    };
    for millimetres in 1..=7 {
        stage.enter(tolerance(millimetres));
    }
    stage.tick();
    stage
        .network
        .client_mut(COMMANDER)
        .subscribe(tolerance(100))
        .unwrap();
    stage.tick();
    assert_eq!(stage.histories[COMMANDER].denied, [Denial::TooManyStreams]);
    assert_eq!(stage.copy(COMMANDER).choice(), NORMAL);
    // A change to an existing stream still succeeds.
    stage
        .network
        .client_mut(COMMANDER)
        .subscribe(tolerance(3))
        .unwrap();
    let tick = stage.tick();
    assert_eq!(stage.copy(COMMANDER).choice(), tolerance(3));
    assert_eq!(stage.copy(COMMANDER).stream().complete(), tick);
}

#[test]
fn each_tier_is_encoded_once_for_all_subscribers() {
    let sent = |members: usize| {
        let mut stage = stage(Stepping::Lockstep, "", 1);
        let others: Vec<usize> = [EXACT, FINE, NORMAL, COARSE]
            .into_iter()
            .flat_map(|tier| vec![tier; members])
            .map(|tier| stage.enter(tier))
            .collect();
        for _ in 0..120 {
            stage.tick();
        }
        let inspected = others.iter().step_by(members).map(|member| {
            let session = stage.network.client_mut(*member);
            session.inspect().expect("a member");
            stage.run(Span::from_millis(50));
            let inspection = stage.histories[*member].inspections[0];
            (
                inspection.updates,
                inspection.packets,
                inspection.packet_bytes,
            )
        });
        inspected.collect::<Vec<_>>()
    };
    let alone = sent(1);
    assert!(alone.iter().all(|(updates, ..)| *updates > 0));
    assert!(
        alone[0].0 > alone[3].0,
        "a finer tier needs more bytes: {alone:?}"
    );
    assert_eq!(sent(6), alone);
}

/// A member that subscribes to a stream of an empty scene at a tick.
fn reported(choice: StreamChoice, stream: u32, tick: u64) -> ScriptedSession {
    let mut reported = ScriptedSession::welcomed(choice);
    send_snapshot(&mut reported, choice, stream, tick);
    while reported.session.poll_event().is_some() {}
    sent(&mut reported);
    reported
}

/// Delivers the snapshot of an empty scene at a tick.
fn send_snapshot(reported: &mut ScriptedSession, choice: StreamChoice, stream: u32, tick: u64) {
    let config = by_name("zoo", 1, 1).expect("an existing script").config();
    reported.send_snapshot(&config, choice, (StreamId(stream), Tick::new(tick)), &[]);
}

/// The messages about streams that it sent since the last call.
fn sent(reported: &mut ScriptedSession) -> Vec<ClientMessage> {
    let mut sent = reported.sent();
    sent.retain(|message| {
        matches!(
            message,
            ClientMessage::Subscribe(_) | ClientMessage::Subscribed(_)
        )
    });
    sent
}

fn shown(reported: &ScriptedSession) -> StreamChoice {
    let copy = reported.session.replica();
    copy.expect("a member has a copy").choice()
}

#[test]
fn a_tier_change_before_the_choice_is_shown_leaves_the_member_free_to_choose_again() {
    let mut reported = reported(FINE, 0, 10);
    let (follow, followed) = (ClientMessage::Subscribe, |stream| {
        ClientMessage::Subscribed(StreamId(stream))
    });
    reported.session.subscribe(EXACT).unwrap();
    assert_eq!(sent(&mut reported), [follow(EXACT)]);
    // The new stream is not displayed while it is behind the displayed one.
    send_snapshot(&mut reported, EXACT, 1, 5);
    let (to, cause) = (FINE, TierChangeCause::LinkCongested);
    reported.deliver(&[ServerMessage::TierChanged { to, cause }]);
    send_snapshot(&mut reported, FINE, 2, 6);
    assert_eq!((shown(&reported), sent(&mut reported)), (FINE, vec![]));
    assert_eq!(
        reported.session.poll_event(),
        Some(Event::TierChanged { to, cause })
    );
    reported.session.subscribe(EXACT).unwrap();
    assert_eq!(sent(&mut reported), [follow(EXACT)]);
    // Pending choices are replaced: only the last of two is sent.
    reported.session.subscribe(COARSE).unwrap();
    reported.session.subscribe(NORMAL).unwrap();
    assert_eq!(sent(&mut reported), []);
    send_snapshot(&mut reported, EXACT, 3, 8);
    assert_eq!(sent(&mut reported), [follow(NORMAL)]);
    send_snapshot(&mut reported, NORMAL, 4, 11);
    assert_eq!(
        (shown(&reported), sent(&mut reported)),
        (NORMAL, vec![followed(4)])
    );
    assert_eq!(
        reported.session.poll_event(),
        Some(Event::SubscriptionChanged(NORMAL))
    );
    // A change to the stream that it already follows is confirmed like any other.
    let (to, cause) = (NORMAL, TierChangeCause::LinkRecovered);
    reported.deliver(&[ServerMessage::TierChanged { to, cause }]);
    send_snapshot(&mut reported, NORMAL, 5, 12);
    assert_eq!(sent(&mut reported), [followed(5)]);
    assert_eq!(
        reported.session.poll_event(),
        Some(Event::TierChanged { to, cause })
    );
    assert_eq!(
        reported.session.poll_event(),
        Some(Event::SubscriptionChanged(NORMAL))
    );
}

#[test]
fn a_member_that_changes_streams_keeps_the_copy_that_the_server_still_publishes() {
    let mut reported = reported(FINE, 0, 10);
    reported.session.subscribe(EXACT).unwrap();
    send_snapshot(&mut reported, EXACT, 1, 5);
    reported.session.subscribe(NORMAL).unwrap();
    sent(&mut reported);
    // The intermediate stream could be displayed now, but it ended with the new request.
    let watermark = Watermark {
        next: Low16(0),
        tick: Low16(20),
        scene_events: Low16(0),
    };
    let datagram = watermark.encode(StreamId(1));
    reported
        .session
        .handle_datagram(Instant::ZERO, ScriptedSession::SERVER, &datagram);
    assert_eq!((shown(&reported), sent(&mut reported)), (FINE, vec![]));
    // When the request is denied, the intermediate stream continues.
    reported.deliver(&[ServerMessage::Denied(Denial::TooManyStreams)]);
    let followed = ClientMessage::Subscribed(StreamId(1));
    assert_eq!(
        (shown(&reported), sent(&mut reported)),
        (EXACT, vec![followed])
    );
}
