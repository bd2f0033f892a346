//! L3.6: queries find bodies, and bodies report events.
//!
//! The scene is a ball that lies on a floor. Tolerances allow for any engine.

use glam::Vec3;
use rhumb_protocol::limits::QUERY_COST_MAX;
use rhumb_protocol::message::{
    ClientMessage, QueryError, QueryResult, ServerMessage, StreamChoice, TickEvents,
};
use rhumb_protocol::scene::{
    ActiveEvents, Answer, BodyEvent, Command, CommandError, Hit, Invalid, Quantity, Query,
};
use rhumb_protocol::session::CloseCode;
use rhumb_reckoning::{BodyId, Tick};

use super::scenery::{RADIUS, ball, ball_shape, body, floor, floor_shape, lockstep};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::RawClient;
use crate::trial::Trial;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a ray finds the nearest bodies, nearest first and each once",
        "PROTOCOL 4.14-1, 4.14-6, 4.14-7, 4.14-8, 4.14-9",
        finds_along_a_ray,
    ),
    (
        2,
        "an answer names the newest tick, in its place among commands",
        "PROTOCOL 4.14-4, 4.14-5",
        names_the_tick,
    ),
    (
        3,
        "queries with a number that is not allowed are refused together",
        "PROTOCOL 4.14-6",
        refuses_numbers,
    ),
    (
        4,
        "queries above the greatest cost end the connection with code 1",
        "PROTOCOL 4.14-3",
        refuses_cost,
    ),
    (
        5,
        "a contact begins in the tick that tells so, and ends with the body",
        "PROTOCOL 4.15-1, 4.15-3, 4.15-4, 4.15-5",
        reports_a_contact,
    ),
    (
        6,
        "a body reports no events unless a command turned them on",
        "PROTOCOL 4.15-2",
        reports_nothing,
    ),
    (
        7,
        "events of a body that does not exist are refused",
        "PROTOCOL 4.15-1",
        refuses_an_unknown_body,
    ),
    (
        8,
        "contacts of a body are those of the step, from its own side",
        "PROTOCOL 4.14-1, 4.14-7, 4.14-9",
        finds_contacts,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L3.7", &[Feature::Lockstep], CASES).collect()
}

/// A floor, and a ball that touches it.
struct Lying {
    client: RawClient,
    floor: BodyId,
    ball: BodyId,
}

impl Lying {
    fn begin(trial: &mut Trial<'_>) -> Result<Self, Stop> {
        let mut client = trial.client()?;
        client.enter(lockstep(), StreamChoice::Full)?;
        let (ground, round) = (body(client.granted, 0)?, body(client.granted, 1)?);
        client.must(floor_shape())?;
        client.must(ball_shape())?;
        client.must(floor(ground))?;
        client.must(ball(round, Vec3::new(0.0, RADIUS, 0.0), Vec3::ZERO))?;
        Ok(Self {
            client,
            floor: ground,
            ball: round,
        })
    }

    fn advance(&mut self, to: u64) {
        let to = Tick::new(to);
        self.client.send(&ClientMessage::Advance { to });
    }

    fn result(&mut self) -> Result<QueryResult, Stop> {
        self.client
            .await_message("answer to queries", |message| match message {
                ServerMessage::QueryResult(result) => Some(result),
                _ => None,
            })
    }

    fn ask(&mut self, queries: Vec<Query>) -> Result<QueryResult, Stop> {
        self.client.send(&ClientMessage::Query(queries));
        self.result()
    }

    fn events(&mut self) -> Result<TickEvents, Stop> {
        self.client
            .await_message("events of bodies", |message| match message {
                ServerMessage::TickEvents(events) => Some(events),
                _ => None,
            })
    }
}

fn down() -> Query {
    Query::ray(Vec3::new(0.0, 10.0, 0.0), Vec3::new(0.0, -20.0, 0.0))
}

fn finds_along_a_ray(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    lying.advance(1);
    let result = lying.ask(vec![down().finding(64), down()])?;
    let answers = result.answers.unwrap_or_default();
    let [Answer::Hits(all), Answer::Hits(nearest)] = &answers[..] else {
        return Stop::fail(format!("two answers with hits, not {answers:?}"));
    };
    let found: Vec<_> = all.iter().map(|hit| hit.body).collect();
    ensure(
        found == [lying.ball, lying.floor],
        format!("the ball, then the floor, not {found:?}"),
    )?;
    let hit = all[0];
    let top = 10.0 - 2.0 * RADIUS;
    ensure(
        (hit.distance - top).abs() < 0.02 && hit.normal.distance(Vec3::Y) < 0.02,
        format!("the top of the ball is {top} m below, and level: {hit:?}"),
    )?;
    ensure(
        nearest.len() == 1 && nearest[0].body == lying.ball,
        format!("the ball alone is nearest, not {nearest:?}"),
    )
}

fn finds_contacts(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    let gone = BodyId::new(lying.ball.index(), lying.ball.generation() + 1);
    lying.advance(1);
    let asked = [lying.ball, lying.floor, gone];
    let result = lying.ask(asked.map(Query::contacts).to_vec())?;
    let answers = result.answers.unwrap_or_default();
    let [
        Answer::Hits(of_ball),
        Answer::Hits(of_floor),
        Answer::Hits(of_gone),
    ] = &answers[..]
    else {
        return Stop::fail(format!("three answers with hits, not {answers:?}"));
    };
    ensure(
        of_gone.is_empty(),
        format!("a body that is not there touches nothing, not {of_gone:?}"),
    )?;
    let from = |hits: &[Hit], other, normal: Vec3| match hits {
        [hit] => {
            hit.body == other
                && hit.distance.abs() < 0.02
                && hit.point.length() < 0.02
                && hit.normal.distance(normal) < 0.02
        }
        _ => false,
    };
    ensure(
        from(of_ball, lying.floor, Vec3::Y) && from(of_floor, lying.ball, Vec3::NEG_Y),
        format!("one contact at the origin, seen from both sides: {of_ball:?}, {of_floor:?}"),
    )
}

fn names_the_tick(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    let id = lying.ball;
    lying.client.send_together(&[
        ClientMessage::Advance { to: Tick::new(3) },
        ClientMessage::Query(vec![down()]),
        ClientMessage::Command(Command::RemoveBody { id }),
        ClientMessage::Query(vec![down()]),
    ]);
    for (number, nearest) in [(0, lying.ball), (1, lying.floor)] {
        let result = lying.result()?;
        ensure(
            (result.number, result.tick) == (number, Tick::new(3)),
            format!("answer {number} of tick 3, not {result:?}"),
        )?;
        let found = match result.answers.as_deref() {
            Ok([Answer::Hits(hits)]) => hits.first().map(|hit| hit.body),
            _ => None,
        };
        ensure(
            found == Some(nearest),
            format!("{nearest} is nearest, not {found:?}"),
        )?;
    }
    Ok(())
}

fn refuses_numbers(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    for (origin, invalid) in [
        (f32::NAN, Invalid::not_finite(Quantity::Position)),
        (1e6, Invalid::out_of_range(Quantity::Position)),
    ] {
        let bad = Query::ray(Vec3::splat(origin), Vec3::X);
        let answers = lying.ask(vec![down(), bad])?.answers;
        ensure(
            answers == Err(QueryError::Invalid(invalid)),
            format!("{invalid:?}, not {answers:?}"),
        )?;
    }
    Ok(())
}

fn refuses_cost(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    let most = vec![down(); QUERY_COST_MAX as usize];
    let answers = lying.ask(most)?.answers;
    let count = answers.as_ref().map_or(0, Vec::len);
    ensure(
        count == QUERY_COST_MAX as usize,
        format!("an answer for each query, not {count}"),
    )?;
    let more = vec![down(); QUERY_COST_MAX as usize + 1];
    lying.client.send(&ClientMessage::Query(more));
    lying.client.must_be_closed(CloseCode::MALFORMED)
}

fn reports_a_contact(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    let events = ActiveEvents {
        contacts: true,
        ..ActiveEvents::NONE
    };
    let id = lying.ball;
    lying.client.must(Command::SetEvents { id, events })?;
    lying.advance(10);
    let began = lying.events()?;
    let [BodyEvent::ContactBegan { body, contact }] = began.events[..] else {
        return Stop::fail(format!("one contact begins, not {began:?}"));
    };
    ensure(
        (body, contact.with) == (lying.floor, lying.ball) && (1..=10).contains(&began.tick.value()),
        format!("the floor touches the ball within ten ticks: {began:?}"),
    )?;
    ensure(
        contact.normal.distance(Vec3::NEG_Y) < 0.02,
        format!("the normal points from the ball to the floor: {contact:?}"),
    )?;
    lying.client.must(Command::RemoveBody { id })?;
    lying.advance(11);
    let ended = lying.events()?;
    let expected = BodyEvent::ContactEnded {
        body: lying.floor,
        with: lying.ball,
    };
    ensure(
        ended.tick == Tick::new(11) && ended.events == [expected],
        format!("the contact ends at tick 11, not {ended:?}"),
    )
}

fn reports_nothing(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    lying.advance(10);
    // The answer comes after ten steps, and so would the events.
    lying.ask(vec![down()])?;
    lying.advance(20);
    lying.client.send(&ClientMessage::Query(vec![down()]));
    let before = lying
        .client
        .await_message("answer or events", |message| match message {
            ServerMessage::QueryResult(_) => Some(None),
            ServerMessage::TickEvents(events) => Some(Some(events)),
            _ => None,
        })?;
    ensure(before.is_none(), format!("no events, not {before:?}"))
}

fn refuses_an_unknown_body(trial: &mut Trial<'_>) -> CaseResult {
    let mut lying = Lying::begin(trial)?;
    let id = body(lying.client.granted, 9)?;
    let events = ActiveEvents {
        sleep: true,
        ..ActiveEvents::NONE
    };
    let outcome = lying.client.command(Command::SetEvents { id, events })?;
    ensure(
        outcome == Err(CommandError::UnknownBody(id)),
        format!("it is unknown, not {outcome:?}"),
    )
}
