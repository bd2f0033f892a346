//! Events of bodies over the wire, each with the state of its tick.

use std::collections::{BTreeMap, BTreeSet};

use glam::Vec3;
use rhumb_protocol::Peer;
use rhumb_protocol::limits::EVENTS_PER_TICK_MAX;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    ActiveEvents, BodyDesc, BodyEvent, BodyKind, Command, Contact, Material, SceneConfig, Shape,
    ShapeId, Sleep, SleepThresholds,
};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_tests::{DeliveryAction, LossFilter, Table};

const FLOOR: BodyId = BodyId::new(0, 0);
const BOX: BodyId = BodyId::new(1, 0);
const SECOND: BodyId = BodyId::new(2, 0);

const CONTACTS: ActiveEvents = ActiveEvents {
    contacts: true,
    ..ActiveEvents::NONE
};

fn state(at: Vec3) -> BodyState {
    let still = [0.0; 3];
    let state = BodyState::new(at.to_array(), [0.0, 0.0, 0.0, 1.0], still, still);
    state.expect("a finite state")
}

/// A lockstep scene with a floor, and one member.
struct Stage {
    table: Table,
    peer: Peer,
    tick: u64,
}

impl Stage {
    fn new() -> Self {
        let mut table = Table::default();
        let peer = table.connect("stage");
        let config = SceneConfig {
            sleep: Sleep::Below(SleepThresholds::by_speed(0.2, 0.2)),
            material: Material {
                friction: 0.5,
                restitution: 0.0,
                density: 1_000.0,
            },
            ..SceneConfig::default()
        };
        let session = table.session(peer);
        session.create(config).expect("in the lobby");
        session.join(StreamChoice::Full).expect("in the lobby");
        table.run_until_idle();
        let mut stage = Self {
            table,
            peer,
            tick: 0,
        };
        stage.command(Command::AddShape {
            id: ShapeId(0),
            shape: Shape::cuboid(50.0, 0.5, 50.0),
        });
        stage.command(Command::AddShape {
            id: ShapeId(1),
            shape: Shape::cuboid(0.5, 0.5, 0.5),
        });
        stage.add(FLOOR, BodyKind::Fixed, 0, Vec3::new(0.0, -0.5, 0.0));
        stage
    }

    fn command(&mut self, command: Command) {
        let session = self.table.session(self.peer);
        session.command(command).expect("a valid command");
    }

    fn add(&mut self, id: BodyId, kind: BodyKind, shape: u32, at: Vec3) {
        self.command(Command::AddBody {
            desc: BodyDesc::plain(id, kind, ShapeId(shape)),
            motion: state(at),
        });
    }

    fn report(&mut self, id: BodyId, events: ActiveEvents) {
        self.command(Command::SetEvents { id, events });
    }

    /// Steps so many times, and returns the events of bodies with their ticks.
    fn steps(&mut self, count: u64) -> Vec<(u64, BodyEvent)> {
        let mut happened = Vec::new();
        for _ in 0..count {
            self.tick += 1;
            let now = self.table.now();
            let session = self.table.session(self.peer);
            session
                .advance(now, Tick::new(self.tick))
                .expect("a member");
            self.table.run_until_idle();
            happened.extend(self.events());
        }
        happened
    }

    fn all_events(&mut self) -> Vec<Event> {
        let session = self.table.session(self.peer);
        std::iter::from_fn(|| session.poll_event()).collect()
    }

    fn complete(&mut self) -> Tick {
        let replica = self.table.session(self.peer).replica();
        replica.expect("a member").stream().complete()
    }

    /// The events of bodies that the session hands out now: none is ahead of the copy.
    fn events(&mut self) -> Vec<(u64, BodyEvent)> {
        let events = self.all_events();
        let complete = self.complete();
        let of_bodies = events.into_iter().filter_map(|event| match event {
            Event::Body { tick, event } => Some((tick, event)),
            _ => None,
        });
        of_bodies
            .inspect(|(tick, event)| assert!(*tick <= complete, "{event:?} is early"))
            .map(|(tick, event)| (tick.value(), event))
            .collect()
    }
}

#[test]
fn a_contact_begins_and_ends_once() {
    let mut stage = Stage::new();
    stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 1.0, 0.0));
    stage.report(BOX, CONTACTS);
    // It suffices that one of the two reports; if both do, each event still comes once.
    stage.report(FLOOR, CONTACTS);
    let landing = stage.steps(60);
    let [(began, BodyEvent::ContactBegan { body, contact })] = landing[..] else {
        panic!("{landing:?}");
    };
    assert_eq!((body, contact.with), (FLOOR, BOX));
    assert!(contact.normal.distance(Vec3::NEG_Y) < 1e-3, "{contact:?}");
    assert!(contact.point.y.abs() < 0.05, "{contact:?}");
    // It falls half a metre in √(2·0.5/9.8) s, which is 19.2 ticks.
    assert!((18..=21).contains(&began), "{began}");
    stage.command(Command::Impulse {
        id: BOX,
        impulse: Vec3::new(0.0, 3_000.0, 0.0),
    });
    let jump = stage.steps(10);
    let left = BodyEvent::ContactEnded {
        body: FLOOR,
        with: BOX,
    };
    assert!(
        matches!(jump[..], [(61..=63, event)] if event == left),
        "{jump:?}"
    );
}

#[test]
fn the_force_of_a_contact_is_reported_from_its_threshold_on() {
    let force = |newtons| ActiveEvents {
        force: Some(newtons),
        ..ActiveEvents::NONE
    };
    let mut stage = Stage::new();
    stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 0.5, 0.0));
    stage.steps(5);
    // A cubic metre of a ton weighs 9,807 N.
    stage.report(BOX, force(15_000.0));
    assert_eq!(stage.steps(5), []);
    stage.report(BOX, force(5_000.0));
    let resting = stage.steps(2);
    assert_eq!(resting.len(), 2);
    for (_, event) in resting {
        let BodyEvent::ContactForce { body, contact } = event else {
            panic!("{event:?}");
        };
        assert_eq!((body, contact.with), (FLOOR, BOX));
        assert!((contact.force - 9_806.65).abs() < 500.0, "{contact:?}");
    }
}

#[test]
fn a_removed_body_ends_its_contacts() {
    for removed in [BOX, FLOOR] {
        let mut stage = Stage::new();
        stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 0.5, 0.0));
        stage.report(BOX, CONTACTS);
        let landing = stage.steps(5);
        let began = |event: &(u64, BodyEvent)| matches!(event.1, BodyEvent::ContactBegan { .. });
        assert!(landing.len() == 1 && began(&landing[0]), "{landing:?}");
        stage.command(Command::RemoveBody { id: removed });
        let ended = BodyEvent::ContactEnded {
            body: FLOOR,
            with: BOX,
        };
        assert_eq!(stage.steps(3), [(6, ended)]);
    }
}

#[test]
fn a_body_reports_sleep_and_waking() {
    let mut stage = Stage::new();
    stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 0.5, 0.0));
    let sleep = ActiveEvents {
        sleep: true,
        ..ActiveEvents::NONE
    };
    stage.report(BOX, sleep);
    let still = stage.steps(60);
    assert!(
        matches!(still[..], [(_, BodyEvent::FellAsleep(BOX))]),
        "{still:?}"
    );
    stage.command(Command::Impulse {
        id: BOX,
        impulse: Vec3::new(500.0, 0.0, 0.0),
    });
    assert_eq!(stage.steps(1), [(61, BodyEvent::Woke(BOX))]);
    // Events that are off are not reported.
    stage.report(BOX, ActiveEvents::NONE);
    assert_eq!(stage.steps(60), []);
}

/// A static sensor finds what moves through it, whether the engine moves it or a client.
#[test]
fn a_sensor_reports_what_enters_and_leaves() {
    for kind in [BodyKind::Dynamic, BodyKind::Kinematic] {
        for reporting in [BOX, SECOND] {
            let mut stage = Stage::new();
            let at = |height| state(Vec3::new(0.0, height, 0.0));
            let sensor = BodyDesc {
                sensor: true,
                ..BodyDesc::plain(BOX, BodyKind::Fixed, ShapeId(1))
            };
            let motion = at(5.0);
            stage.command(Command::AddBody {
                desc: sensor,
                motion,
            });
            stage.add(SECOND, kind, 1, Vec3::new(0.0, 7.0, 0.0));
            let (linear, angular) = (Vec3::new(0.0, -6.0, 0.0), Vec3::ZERO);
            stage.command(Command::SetVelocity {
                id: SECOND,
                linear,
                angular,
            });
            let sensors = ActiveEvents {
                sensors: true,
                ..ActiveEvents::NONE
            };
            stage.report(reporting, sensors);
            let passage = stage.steps(45);
            let (sensor, body) = (BOX, SECOND);
            let events: Vec<_> = passage.iter().map(|(_, event)| *event).collect();
            let expected = [
                BodyEvent::SensorEntered { sensor, body },
                BodyEvent::SensorLeft { sensor, body },
            ];
            assert_eq!(events, expected, "{kind:?}");
            let inside = passage[1].0 - passage[0].0;
            assert!((12..=21).contains(&inside), "{inside} ticks for two metres");
        }
    }
}

/// Sleeping bodies keep their contacts: neither sleep nor waking ends one.
#[test]
fn a_contact_outlasts_sleep() {
    let mut stage = Stage::new();
    stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 0.5, 0.0));
    stage.add(SECOND, BodyKind::Dynamic, 1, Vec3::new(0.0, 1.5, 0.0));
    stage.report(BOX, CONTACTS);
    stage.report(SECOND, CONTACTS);
    let landing = stage.steps(90);
    assert_eq!(landing.len(), 2, "{landing:?}");
    stage.command(Command::Impulse {
        id: SECOND,
        impulse: Vec3::new(0.0, -10.0, 0.0),
    });
    assert_eq!(stage.steps(30), []);
}

/// The control stream may be faster than the datagrams: an event waits for the state of its tick.
#[test]
fn an_event_waits_for_the_state_of_its_tick() {
    let mut stage = Stage::new();
    stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 0.5, 0.0));
    stage.steps(1);
    stage.report(BOX, CONTACTS);
    let lost = LossFilter::new(|_| DeliveryAction::Lost);
    stage.table.filter_downlink(stage.peer, lost);
    assert_eq!(stage.steps(3), [], "no state has arrived");
    let arrives = LossFilter::new(|_| DeliveryAction::Arrives);
    stage.table.filter_downlink(stage.peer, arrives);
    let mut late = Vec::new();
    for _ in 0..20 {
        late.extend(stage.steps(1));
        stage.table.pass(rhumb_protocol::Span::from_millis(100));
        stage.table.run_until_idle();
        late.extend(stage.events());
    }
    let [(2, BodyEvent::ContactBegan { contact, .. })] = late[..] else {
        panic!("{late:?}");
    };
    assert_eq!(contact.with, BOX);
}

/// A tick with too many events says how many it left out.
#[test]
fn events_beyond_the_bound_are_counted() {
    const BOXES: u32 = EVENTS_PER_TICK_MAX as u32 + 76;
    let mut stage = Stage::new();
    for number in 0..BOXES {
        let (x, z) = (number % 34, number / 34);
        let at = Vec3::new(x as f32 * 1.4 - 24.0, 0.5, z as f32 * 1.4 - 24.0);
        stage.add(BodyId::new(1 + number, 0), BodyKind::Dynamic, 1, at);
    }
    stage.report(FLOOR, CONTACTS);
    let now = stage.table.now();
    let session = stage.table.session(stage.peer);
    session.advance(now, Tick::new(1)).expect("a member");
    stage.table.run_until_idle();
    let events = stage.all_events();
    let began = events.iter().filter(|event| {
        let begins = |contact: &Contact| contact.with.index() > 0;
        matches!(event, Event::Body { event: BodyEvent::ContactBegan { contact, .. }, .. } if begins(contact))
    });
    assert_eq!(began.count(), EVENTS_PER_TICK_MAX);
    let missed = Event::EventsMissed {
        tick: Tick::new(1),
        count: u64::from(BOXES) - EVENTS_PER_TICK_MAX as u64,
        untold: 0,
    };
    assert!(events.contains(&missed));
}

#[test]
fn forces_beyond_the_bound_take_turns_and_end_no_set_of_pairs() {
    const BOXES: u32 = EVENTS_PER_TICK_MAX as u32 + 76;
    let mut stage = Stage::new();
    for number in 0..BOXES {
        let (x, z) = (number % 34, number / 34);
        let at = Vec3::new(x as f32 * 1.4 - 24.0, 0.5, z as f32 * 1.4 - 24.0);
        stage.add(BodyId::new(1 + number, 0), BodyKind::Dynamic, 1, at);
    }
    let forces = ActiveEvents {
        force: Some(0.0),
        ..CONTACTS
    };
    stage.report(FLOOR, forces);
    let mut events = Vec::new();
    for tick in 1..=8 {
        let now = stage.table.now();
        let session = stage.table.session(stage.peer);
        session.advance(now, Tick::new(tick)).expect("a member");
        stage.table.run_until_idle();
        events.extend(stage.all_events());
    }
    let missed = events
        .iter()
        .filter(|event| matches!(event, Event::EventsMissed { .. }));
    assert_eq!(missed.count(), 1, "only the first tick has too many");
    assert_eq!(pairs(&events).len() as u32, BOXES);
    let latest: BTreeMap<_, _> = events
        .iter()
        .filter_map(|event| match event {
            Event::Body {
                tick,
                event: BodyEvent::ContactForce { body, contact },
            } => Some(([*body, contact.with], *tick)),
            _ => None,
        })
        .collect();
    assert_eq!(latest.len() as u32, BOXES);
    assert!(
        latest.values().all(|tick| *tick >= Tick::new(7)),
        "{latest:?}"
    );
}

/// A sensor that sleeps sees what comes, and a body that sleeps reports a sensor that comes.
#[test]
fn sleeping_bodies_and_sensors_report_what_enters_and_leaves() {
    let sensors = ActiveEvents {
        sensors: true,
        ..ActiveEvents::NONE
    };
    for sleeper_is_sensor in [true, false] {
        let mut stage = Stage::new();
        let desc = BodyDesc {
            sensor: sleeper_is_sensor,
            gravity_scale: 0.0,
            ..BodyDesc::plain(BOX, BodyKind::Dynamic, ShapeId(1))
        };
        let motion = state(Vec3::Y * 5.0);
        stage.command(Command::AddBody { desc, motion });
        let desc = BodyDesc {
            sensor: !sleeper_is_sensor,
            ..BodyDesc::plain(SECOND, BodyKind::Kinematic, ShapeId(1))
        };
        let motion = state(Vec3::new(-4.0, 5.0, 0.0));
        stage.command(Command::AddBody { desc, motion });
        stage.report(BOX, sensors);
        assert_eq!(stage.steps(150), []);
        let (linear, angular) = (Vec3::X * 6.0, Vec3::ZERO);
        stage.command(Command::SetVelocity {
            id: SECOND,
            linear,
            angular,
        });
        let passage = stage.steps(90);
        let (sensor, body) = match sleeper_is_sensor {
            true => (BOX, SECOND),
            false => (SECOND, BOX),
        };
        let events: Vec<_> = passage.iter().map(|(_, event)| *event).collect();
        let expected = [
            BodyEvent::SensorEntered { sensor, body },
            BodyEvent::SensorLeft { sensor, body },
        ];
        assert_eq!(events, expected, "{sleeper_is_sensor}");
    }
}

/// The pairs that touch by the events of a member.
fn pairs(events: &[Event]) -> BTreeSet<(BodyId, BodyId)> {
    let mut pairs = BTreeSet::new();
    for event in events {
        match *event {
            Event::EventsMissed { .. } => pairs.clear(),
            Event::Body { event, .. } => match event {
                BodyEvent::ContactBegan { body, contact } => {
                    pairs.insert((body, contact.with));
                }
                BodyEvent::ContactEnded { body, with } => {
                    pairs.remove(&(body, with));
                }
                _ => {}
            },
            _ => {}
        }
    }
    pairs
}

impl Stage {
    fn join_late(&mut self) -> Peer {
        let late = self.table.connect("stage");
        let session = self.table.session(late);
        session.join(StreamChoice::Full).expect("in the lobby");
        self.table.run_until_idle();
        late
    }

    fn events_of(&mut self, peer: Peer) -> Vec<Event> {
        let session = self.table.session(peer);
        std::iter::from_fn(|| session.poll_event()).collect()
    }
}

#[test]
fn a_member_that_joins_late_gets_what_touches_and_what_is_in_a_sensor() {
    let mut stage = Stage::new();
    stage.add(BOX, BodyKind::Dynamic, 1, Vec3::new(0.0, 0.5, 0.0));
    let sensor = BodyDesc {
        sensor: true,
        ..BodyDesc::plain(SECOND, BodyKind::Fixed, ShapeId(1))
    };
    stage.command(Command::AddBody {
        desc: sensor,
        motion: state(Vec3::new(0.0, 1.0, 0.0)),
    });
    stage.report(BOX, CONTACTS);
    let sensors = ActiveEvents {
        sensors: true,
        ..ActiveEvents::NONE
    };
    stage.report(SECOND, sensors);
    // Awake, then asleep.
    for steps in [5, 120] {
        stage.steps(steps);
        let late = stage.join_late();
        let events = stage.events_of(late);
        let happened = events.iter().filter_map(|event| match event {
            Event::Body { tick, event } => Some((tick.value(), *event)),
            _ => None,
        });
        let happened: Vec<_> = happened.collect();
        let [
            (tick, BodyEvent::ContactBegan { body, contact }),
            (_, entered),
        ] = happened[..]
        else {
            panic!("{events:?}");
        };
        assert_eq!((tick, body, contact.with), (stage.tick, FLOOR, BOX));
        let (sensor, body) = (SECOND, BOX);
        assert_eq!(entered, BodyEvent::SensorEntered { sensor, body });
        assert_eq!(stage.steps(1), [], "the others know it");
        assert_eq!(pairs(&stage.events_of(late)), BTreeSet::new());
    }
    // Once neither body reports the pair, it ends for all.
    stage.report(BOX, ActiveEvents::NONE);
    let ended = BodyEvent::ContactEnded {
        body: FLOOR,
        with: BOX,
    };
    let tick = stage.tick + 1;
    assert_eq!(stage.steps(1), [(tick, ended)]);
}

/// More touch than a tick tells: the next ticks tell the rest, to one that joins and to those that missed it.
#[test]
fn all_that_touch_come_in_the_end() {
    const BOXES: u32 = 2 * EVENTS_PER_TICK_MAX as u32 + 76;
    let mut stage = Stage::new();
    for number in 0..BOXES {
        let (x, z) = (number % 48, number / 48);
        let at = Vec3::new(x as f32 * 1.4 - 34.0, 0.5, z as f32 * 1.4 - 34.0);
        stage.add(BodyId::new(1 + number, 0), BodyKind::Dynamic, 1, at);
    }
    stage.report(FLOOR, CONTACTS);
    let mut first = Vec::new();
    for _ in 0..5 {
        stage.tick += 1;
        let now = stage.table.now();
        let to = Tick::new(stage.tick);
        let session = stage.table.session(stage.peer);
        session.advance(now, to).expect("a member");
        stage.table.run_until_idle();
        first.extend(stage.all_events());
    }
    let late = stage.join_late();
    let mut of_late = stage.events_of(late);
    for _ in 0..3 {
        stage.steps(1);
        of_late.extend(stage.events_of(late));
    }
    let touching: BTreeSet<_> = (1..=BOXES)
        .map(|index| (FLOOR, BodyId::new(index, 0)))
        .collect();
    assert_eq!(pairs(&first), touching);
    assert_eq!(pairs(&of_late), touching);
}
