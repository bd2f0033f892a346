//! Golden streams: what a member heard over a bad link, and what it then knew.
//!
//! Recorded from a real host by `cargo run -p rhumb-tests --example control_vectors -- --write`, and held by replaying what was
//! heard to a session: so an engine that moves bodies otherwise does not change what is golden here, but the wire does.

use bytes::Bytes;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyKind, BodyTerms, Cadence, Command, Compound, Heights, Pace, Part, Shape, ShapeId,
};
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::stream::Budget;
use rhumb_protocol::{Endpoint, Instant, Peer, Span};
use rhumb_reckoning::{BodyId, Class, Metres, Radians, Tick, Ticks, Tolerance, Verbatim};
use rhumb_sims::by_name;
use serde_json::{Value, json};

use crate::fnv::Fnv;
use crate::grammar::{hex, unhex};
use crate::seed::Dice;
use crate::table::{Fate, Said, Sieve, Table};

/// One recording to be made.
#[derive(Clone, Copy, Debug)]
struct Take {
    name: &'static str,
    scene: &'static str,
    bodies: u32,
    pace: Pace,
    cadence: Option<(u32, u32)>,
    choice: StreamChoice,
    /// Of a hundred datagrams, how many are lost, come late or come twice.
    bad: usize,
    ticks: u64,
    /// Whether bodies are of classes, and such that have ground and parts come too.
    diverse: bool,
}

/// The host, as each session names it.
const HOST: Peer = Peer(0);
/// Ticks at the end without faults.
const CALM: u64 = 60;

impl Take {
    const fn of(name: &'static str, scene: &'static str, choice: StreamChoice) -> Self {
        Self {
            name,
            scene,
            bodies: 12,
            pace: Pace::Lockstep,
            cadence: None,
            choice,
            bad: 25,
            ticks: 150,
            diverse: false,
        }
    }

    const fn with(self, bodies: u32, bad: usize) -> Self {
        Self {
            bodies,
            bad,
            ..self
        }
    }
}

fn takes() -> Vec<Take> {
    let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002));
    let parts = StreamChoice::Within(parts.expect("within range"));
    let normal = StreamChoice::Within(Tolerance::NORMAL);
    let exact = StreamChoice::Within(Tolerance::EXACT);
    let capped = StreamChoice::Capped {
        tolerance: Tolerance::EXACT,
        budget: Budget::new(1_500, 1_150).expect("within range"),
    };
    let full = Take::of("everything of a zoo", "zoo", StreamChoice::Full);
    let rare = "a zoo that runs free, each other tick, with hindsight";
    let free = |name, choice, cadence| Take {
        pace: Pace::FreeRunning,
        cadence,
        ..Take::of(name, "zoo", choice)
    };
    vec![
        Take::of("a zoo, nothing lost", "zoo", normal).with(12, 0),
        Take::of("a zoo over a bad link", "zoo", exact),
        Take::of("balls that fall into a pit", "ball-pit", exact).with(8, 30),
        Take::of("cubes within parts", "cubes", parts).with(20, 25),
        Take::of("rocks that tumble", "asteroids", exact).with(6, 25),
        Take::of("bodies in a drum", "tumbler", normal).with(10, 25),
        Take::of("ragdolls", "ragdolls", normal),
        Take { ticks: 80, ..full },
        free(rare, normal, Some((2, 2))),
        free("a zoo that runs free", exact, None),
        Take {
            cadence: Some((3, 0)),
            diverse: true,
            ..Take::of(
                "a zoo of classes in lockstep, each third tick",
                "zoo",
                parts,
            )
        },
        Take {
            diverse: true,
            ..Take::of("a drum of classes within a budget", "tumbler", capped).with(24, 20)
        },
    ]
}

/// What a member knows, as the vectors have it.
#[must_use]
pub fn known(replica: &Replica) -> Value {
    let stream = replica.stream();
    let mut known = json!({
        "vouched": stream.vouched().value(),
        "complete": stream.complete().value(),
        "settled": stream.is_settled(),
        "next": stream.echo().next.0,
        "missing": stream.missing(),
        "sum": format!("{:016x}", stream.agreement()),
        "poses": format!("{:016x}", poses(replica)),
    });
    if matches!(replica.choice(), StreamChoice::Capped { .. }) {
        // Factors are whole when counted in eighths.
        let excess = stream.excess_at(stream.vouched());
        known["excess_eighths"] = json!(excess.map(|factor| (factor * 8.0) as u64));
    }
    known
}

/// FNV-1a over the bits of each body's believed motion at the vouched tick, in order of index.
fn poses(replica: &Replica) -> u64 {
    let stream = replica.stream();
    let mut digest = Fnv::START;
    for terms in replica.bodies() {
        if let Some(motion) = stream.believed(terms.id, stream.vouched()) {
            digest.fold_motion(&motion);
        }
    }
    digest.value()
}

fn heard(said: &Said) -> Value {
    match said {
        Said::Control(bytes) => json!(["control", hex(bytes)]),
        Said::State(bytes) => json!(["datagram", hex(bytes)]),
    }
}

/// Records a take: what was heard, with what was known after each tick.
fn record(take: &Take, seed: u64) -> Vec<Value> {
    let mut script = by_name(take.scene, take.bodies, 1).expect("a scene that has a script");
    let mut terms = script.terms();
    terms.pace = take.pace;
    terms.cadence = take
        .cadence
        .map_or(Cadence::EACH_TICK, |(every, hindsight)| Cadence {
            every: every.try_into().expect("not zero"),
            hindsight: Ticks::new(hindsight),
        });
    let mut table = Table::default();
    let peer = table.seat("golden");
    let now = table.now();
    table.guest(peer).create(terms).expect("terms of a script");
    table.settle();
    table
        .guest(peer)
        .join(take.choice)
        .expect("a scene to join");
    table.settle();
    let mut events: Vec<Value> = table.take_heard(peer).iter().map(heard).collect();
    let mut dice = Dice::new(seed);
    let (bad, frame) = (take.bad, Span::from_nanos(16_666_667));
    for tick in 0..take.ticks {
        if tick == take.ticks - CALM {
            table.sift(peer, Sieve::new(|_| Fate::Arrives));
            table.sift_spoken(peer, Sieve::new(|_| Fate::Arrives));
        } else if tick == 1 {
            let (mut there, mut back) = (dice.clone(), dice.clone());
            table.sift(peer, Sieve::new(move |_| fate(&mut there, bad)));
            // Echoes are lost more often, so that what is missing stays missing for some ticks.
            let deaf = 3 * bad;
            table.sift_spoken(peer, Sieve::new(move |_| fate(&mut back, deaf)));
        }
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        commands.extend(disturbance(take, tick, &mut dice));
        if take.diverse {
            commands.iter_mut().for_each(classify);
        }
        let at = now + Span::from_nanos(frame.as_nanos() * tick);
        for command in commands {
            table
                .guest(peer)
                .command(command)
                .expect("scripts command what may be");
        }
        if take.pace == Pace::Lockstep {
            let to = Tick::new(tick + 1);
            table
                .guest(peer)
                .advance(at, to)
                .expect("a member advances");
        }
        table.settle();
        table.pass(frame);
        events.extend(table.take_heard(peer).iter().map(heard));
        events.push(json!(["known", null]));
    }
    with_knowledge(events)
}

/// Puts what a session knows behind each tick, and behind each datagram that leaves it unsettled.
fn with_knowledge(events: Vec<Value>) -> Vec<Value> {
    let mut session = greeted();
    let mut told = Vec::new();
    for event in events {
        let is_tick = event[0] == "known";
        hear(&mut session, &event);
        if !is_tick {
            told.push(event);
        }
        let Some(replica) = session.replica() else {
            continue;
        };
        if is_tick || !replica.stream().is_settled() {
            told.push(json!(["known", known(replica)]));
        }
    }
    told
}

/// A session that waits for what its server says.
///
/// # Panics
///
/// Never: its scene has a name.
#[must_use]
pub fn greeted() -> ClientSession {
    let mut session = ClientSession::new("golden".parse().expect("a good name"));
    session.handle_opened(Instant::ZERO, HOST);
    session
}

/// Says an event of a stream to a session.
///
/// # Panics
///
/// When it is none.
pub fn hear(session: &mut ClientSession, event: &Value) {
    let bytes = || Bytes::from(unhex(event[1].as_str().expect("digits")));
    match event[0].as_str() {
        Some("control") => session.handle_control(Instant::ZERO, HOST, &bytes()),
        Some("datagram") => session.handle_datagram(Instant::ZERO, HOST, &bytes()),
        _ => {}
    }
}

fn fate(dice: &mut Dice, bad: usize) -> Fate {
    match dice.below(100) {
        roll if roll >= bad => Fate::Arrives,
        roll => match roll % 4 {
            0 => Fate::Twice,
            1 => Fate::Late,
            _ => Fate::Lost,
        },
    }
}

/// What the script would not do: other gravity, a body that goes.
fn disturbance(take: &Take, tick: u64, dice: &mut Dice) -> Vec<Command> {
    let mut commands = Vec::new();
    if take.scene == "zoo" && tick % 40 == 25 {
        let y = -(dice.below(20) as f32);
        let gravity = glam::Vec3::new(0.5, y, 0.0);
        commands.push(Command::SetGravity { gravity });
    }
    if take.scene == "zoo" && tick == 70 {
        commands.push(Command::RemoveBody {
            id: BodyId::new(2, 0),
        });
    }
    if take.diverse && tick == 5 {
        commands.extend(newcomers());
    }
    commands
}

/// Gives a body that comes a class: each in turn.
fn classify(command: &mut Command) {
    if let Command::AddBody { terms, .. } = command {
        let turn = (terms.id.index() % 7) as i8;
        terms.class = Class::new(turn - 3).expect("one of seven");
    }
}

/// Ground that is too long for one message, and a dumbbell that falls on it without being turned.
fn newcomers() -> Vec<Command> {
    let heights: Vec<f32> = (0..4_480).map(|post| (post % 3) as f32 * 0.25).collect();
    let ground = Heights::new(70, 0.25, 0.125, &heights).expect("a field");
    let end = |x| Part {
        position: glam::Vec3::new(x, 0.0, 0.0),
        rotation: glam::Quat::IDENTITY,
        shape: Shape::Ball { radius: 0.25 },
    };
    let dumbbell = Compound::new(vec![end(-0.5), end(0.5)]).expect("two balls");
    let mut commands = Vec::new();
    for (place, (shape, kind, at)) in [
        (Shape::Heights(ground), BodyKind::Static, [20.0, 0.0, 20.0]),
        (
            Shape::Compound(dumbbell),
            BodyKind::Dynamic,
            [23.0, 3.0, 23.0],
        ),
    ]
    .into_iter()
    .enumerate()
    {
        let id = ShapeId(8_000 + place as u32);
        commands.push(Command::AddShape { id, shape });
        let mut terms = BodyTerms::plain(BodyId::new(4_000 + place as u32, 0), kind, id);
        terms.turns = kind == BodyKind::Static;
        let motion = Verbatim::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let motion = motion.expect("a place is finite");
        commands.push(Command::AddBody { terms, motion });
    }
    commands
}

/// The file.
#[must_use]
pub fn streams() -> String {
    let takes = takes().into_iter().enumerate().map(|(place, take)| {
        let events = record(&take, place as u64 + 1);
        let lines: Vec<_> = events.iter().map(Value::to_string).collect();
        let name = take.name;
        format!(
            "{{\"name\": \"{name}\", \"events\": [\n{}\n]}}",
            lines.join(",\n")
        )
    });
    let takes = takes.collect::<Vec<_>>().join(",\n");
    format!("{{\n\"format\": \"rhumb stream vectors 1\",\n\"streams\": [\n{takes}\n]\n}}\n")
}

/// Says to a session what a stream's member heard; for each known state, its place, what it should be and what it is.
///
/// # Panics
///
/// When an event is none.
#[must_use]
pub fn replayed(events: &[Value]) -> Vec<(usize, Value, Value)> {
    let mut session = greeted();
    let mut states = Vec::new();
    for (place, event) in events.iter().enumerate() {
        hear(&mut session, event);
        if event[0] == "known" {
            let replica = session.replica().expect("a member");
            states.push((place, event[1].clone(), known(replica)));
        }
    }
    states
}
