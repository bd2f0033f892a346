//! Golden streams: data received over a bad link, and the resulting states.
//!
//! They are recorded from a real server by `UPDATE_VECTORS=1 cargo test -p rhumb-tests --test in_process vectors`. The
//! tests replay the received data to a session. So a change of the engine does not invalidate them, but a change of the wire
//! format does.
use rhumb_conformance::grammar::hex;
use rhumb_conformance::seed::Dice;
use rhumb_conformance::vectors::{deliver, greeted, known};
use rhumb_protocol::Span;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, Compound, Heights, LockedAxes, Part, PublishSchedule, Shape,
    ShapeId, Stepping,
};
use rhumb_protocol::stream::Budget;
use rhumb_reckoning::{BodyId, BodyState, Metres, Radians, Tick, Ticks, Tolerance, ToleranceScale};
use rhumb_sims::by_name;
use serde_json::{Value, json};

use crate::table::{Delivered, DeliveryAction, LossFilter, Table};

/// The parameters of a recording.
#[derive(Clone, Copy, Debug)]
struct Recording {
    name: &'static str,
    scene: &'static str,
    bodies: u32,
    stepping: Stepping,
    publish_schedule: Option<(u32, u32)>,
    choice: StreamChoice,
    /// Of a hundred datagrams, how many are lost, delayed or duplicated.
    bad: usize,
    ticks: u64,
    /// True if bodies have different tolerance scales, and a height field and a compound are added.
    diverse: bool,
}

/// The server's name in each session.
/// Ticks without faults at the end.
const CALM: u64 = 60;

impl Recording {
    const fn of(name: &'static str, scene: &'static str, choice: StreamChoice) -> Self {
        Self {
            name,
            scene,
            bodies: 12,
            stepping: Stepping::Lockstep,
            publish_schedule: None,
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

fn recordings() -> Vec<Recording> {
    let parts = Tolerance::parts(Metres::new(0.01), Radians::new(0.002));
    let parts = StreamChoice::Within(parts.expect("within range"));
    let normal = StreamChoice::Within(Tolerance::NORMAL);
    let exact = StreamChoice::Within(Tolerance::EXACT);
    let capped = StreamChoice::Capped {
        tolerance: Tolerance::EXACT,
        budget: Budget::new(1_500, 1_150).expect("within range"),
    };
    let full = Recording::of("the full stream of a zoo", "zoo", StreamChoice::Full);
    let rare = "a free-running zoo, every second tick, with lookahead";
    let free = |name, choice, publish_schedule| Recording {
        stepping: Stepping::FreeRunning,
        publish_schedule,
        ..Recording::of(name, "zoo", choice)
    };
    vec![
        Recording::of("a zoo without loss", "zoo", normal).with(12, 0),
        Recording::of("a zoo over a bad link", "zoo", exact),
        Recording::of("balls that fall into a pit", "ball-pit", exact).with(8, 30),
        Recording::of("cubes within parts", "cubes", parts).with(20, 25),
        Recording::of("rocks that tumble", "asteroids", exact).with(6, 25),
        Recording::of("bodies in a drum", "tumbler", normal).with(10, 25),
        Recording::of("ragdolls", "ragdolls", normal),
        Recording { ticks: 80, ..full },
        free(rare, normal, Some((2, 2))),
        free("a free-running zoo", exact, None),
        Recording {
            publish_schedule: Some((3, 0)),
            diverse: true,
            ..Recording::of(
                "a zoo with tolerance scales in lockstep, every third tick",
                "zoo",
                parts,
            )
        },
        Recording {
            diverse: true,
            ..Recording::of(
                "a drum with tolerance scales within a budget",
                "tumbler",
                capped,
            )
            .with(24, 20)
        },
    ]
}

fn received(sent: &Delivered) -> Value {
    match sent {
        Delivered::Control(bytes) => json!(["control", hex(bytes)]),
        Delivered::State(bytes) => json!(["datagram", hex(bytes)]),
    }
}

/// Makes a recording: the received data, with the member's state after each tick.
fn record(recording: &Recording, seed: u64) -> Vec<Value> {
    let mut script = by_name(recording.scene, recording.bodies, 1).expect("an existing script");
    let mut config = script.config();
    config.stepping = recording.stepping;
    config.publish_schedule = recording.publish_schedule.map_or(
        PublishSchedule::EACH_TICK,
        |(publish_interval, lookahead)| PublishSchedule {
            publish_interval: publish_interval.try_into().expect("not zero"),
            lookahead: Ticks::new(lookahead),
        },
    );
    let mut table = Table::default();
    let peer = table.connect("golden");
    let now = table.now();
    table
        .session(peer)
        .create(config)
        .expect("a valid configuration");
    table.run_until_idle();
    table
        .session(peer)
        .join(recording.choice)
        .expect("a scene to join");
    table.run_until_idle();
    let mut events: Vec<Value> = table.take_received(peer).iter().map(received).collect();
    let mut dice = Dice::new(seed);
    let (bad, frame) = (recording.bad, Span::from_nanos(16_666_667));
    for tick in 0..recording.ticks {
        if tick == recording.ticks - CALM {
            table.filter_downlink(peer, LossFilter::new(|_| DeliveryAction::Arrives));
            table.filter_uplink(peer, LossFilter::new(|_| DeliveryAction::Arrives));
        } else if tick == 1 {
            let (mut there, mut back) = (dice.clone(), dice.clone());
            table.filter_downlink(peer, LossFilter::new(move |_| fate(&mut there, bad)));
            // Loss reports are lost more often, so that gaps stay open for some ticks.
            let loss_of_reports = 3 * bad;
            table.filter_uplink(
                peer,
                LossFilter::new(move |_| fate(&mut back, loss_of_reports)),
            );
        }
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        commands.extend(disturbance(recording, tick, &mut dice));
        if recording.diverse {
            commands.iter_mut().for_each(classify);
        }
        let at = now + Span::from_nanos(frame.as_nanos() * tick);
        for command in commands {
            table
                .session(peer)
                .command(command)
                .expect("scripts send valid commands");
        }
        if recording.stepping == Stepping::Lockstep {
            let to = Tick::new(tick + 1);
            table
                .session(peer)
                .advance(at, to)
                .expect("a member advances");
        }
        table.run_until_idle();
        table.pass(frame);
        events.extend(table.take_received(peer).iter().map(received));
        events.push(json!(["known", null]));
    }
    with_knowledge(events)
}

/// Inserts the session's state after each tick, and after each datagram that leaves it unconverged.
fn with_knowledge(events: Vec<Value>) -> Vec<Value> {
    let mut session = greeted();
    let mut reported = Vec::new();
    for event in events {
        let is_tick = event[0] == "known";
        deliver(&mut session, &event);
        if !is_tick {
            reported.push(event);
        }
        let Some(replica) = session.replica() else {
            continue;
        };
        if is_tick || !replica.stream().is_converged() {
            reported.push(json!(["known", known(replica)]));
        }
    }
    reported
}

fn fate(dice: &mut Dice, bad: usize) -> DeliveryAction {
    match dice.below(100) {
        roll if roll >= bad => DeliveryAction::Arrives,
        roll => match roll % 4 {
            0 => DeliveryAction::Twice,
            1 => DeliveryAction::Late,
            _ => DeliveryAction::Lost,
        },
    }
}

/// Commands that the script does not contain: a change of gravity, the removal of a body.
fn disturbance(recording: &Recording, tick: u64, dice: &mut Dice) -> Vec<Command> {
    let mut commands = Vec::new();
    if recording.scene == "zoo" && tick % 40 == 25 {
        let y = -(dice.below(20) as f32);
        let gravity = glam::Vec3::new(0.5, y, 0.0);
        commands.push(Command::SetGravity { gravity });
    }
    if recording.scene == "zoo" && tick == 70 {
        commands.push(Command::RemoveBody {
            id: BodyId::new(2, 0),
        });
    }
    if recording.diverse && tick == 5 {
        commands.extend(new_bodies());
    }
    commands
}

/// Sets the tolerance scale of an added body: each in turn.
fn classify(command: &mut Command) {
    if let Command::AddBody { desc, .. } = command {
        let turn = (desc.id.index() % 7) as i8;
        desc.tolerance_scale =
            ToleranceScale::new(turn - 3).expect("one of seven tolerance scales");
    }
}

/// A height field that is too long for one message, and a dumbbell that falls on it without rotation.
fn new_bodies() -> Vec<Command> {
    let heights: Vec<f32> = (0..4_480).map(|post| (post % 3) as f32 * 0.25).collect();
    let ground = Heights::new(70, 0.25, 0.125, &heights).expect("a valid height field");
    let end = |x| Part {
        position: glam::Vec3::new(x, 0.0, 0.0),
        rotation: glam::Quat::IDENTITY,
        shape: Shape::Ball { radius: 0.25 },
    };
    let dumbbell = Compound::new(vec![end(-0.5), end(0.5)]).expect("a valid compound");
    let mut commands = Vec::new();
    for (place, (shape, kind, at)) in [
        (Shape::Heights(ground), BodyKind::Fixed, [20.0, 0.0, 20.0]),
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
        let mut desc = BodyDesc::plain(BodyId::new(4_000 + place as u32, 0), kind, id);
        if kind != BodyKind::Fixed {
            desc.locked = LockedAxes::ROTATIONS;
        }
        let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let motion = motion.expect("a finite state");
        commands.push(Command::AddBody { desc, motion });
    }
    commands
}

/// The content of `streams.json`.
#[must_use]
pub fn streams() -> String {
    let recordings = recordings()
        .into_iter()
        .enumerate()
        .map(|(place, recording)| {
            let events = record(&recording, place as u64 + 1);
            let lines: Vec<_> = events.iter().map(Value::to_string).collect();
            let name = recording.name;
            format!(
                "{{\"name\": \"{name}\", \"events\": [\n{}\n]}}",
                lines.join(",\n")
            )
        });
    let recordings = recordings.collect::<Vec<_>>().join(",\n");
    format!("{{\n\"format\": \"rhumb stream vectors 1\",\n\"streams\": [\n{recordings}\n]\n}}\n")
}
