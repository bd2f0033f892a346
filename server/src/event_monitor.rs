//! Events of bodies: compares the engine's reports of two steps.
//!
//! Only bodies whose events are on are looked at, and of the dynamic ones only those that the engine observed: no contact
//! of a body changes while it sleeps; what is in a sensor may. One whose events were just turned on is looked at once all
//! the same. Knows no members. Invariant: a tick has at most [`EVENTS_PER_TICK_MAX`] events; what exceeds that is counted,
//! but for forces, which take turns. A standing event has begun and not ended: those who missed the beginning get it.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::limits::EVENTS_PER_TICK_MAX;
use rhumb_protocol::scene::{ActiveEvents, BodyEvent, BodyKind, Contact};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{BodyId, Tick};

use crate::engine::Engine;
use crate::registry::Registry;

/// The bodies that report events, and their state after the last step.
#[derive(Clone, Debug, Default)]
pub(crate) struct EventMonitor {
    active: BTreeMap<BodyId, ActiveEvents>,
    /// The bodies that report contacts or their forces.
    touch_reporters: BTreeSet<BodyId>,
    /// The bodies that report sensors.
    sensor_reporters: BTreeSet<BodyId>,
    asleep: BTreeSet<BodyId>,
    /// Bodies whose events were turned on since the last step.
    turned_on: BTreeSet<BodyId>,
    /// Bodies that were removed since the last step.
    removed: Vec<BodyId>,
    /// Pairs in contact, the lesser id first, of which at least one reports contacts.
    touching: BTreeSet<(BodyId, BodyId)>,
    /// Sensors and bodies inside them, of which at least one reports it.
    inside: BTreeSet<(BodyId, BodyId)>,
}

impl Wire for EventMonitor {
    fn encode(&self, to: &mut Writer) {
        to.varint(self.active.len() as u64);
        for (id, active) in &self.active {
            id.encode(to);
            active.encode(to);
        }
        for bodies in [&self.asleep, &self.turned_on] {
            to.varint(bodies.len() as u64);
            bodies.iter().for_each(|id| id.encode(to));
        }
        for pairs in [&self.touching, &self.inside] {
            to.varint(pairs.len() as u64);
            for (first, second) in pairs {
                first.encode(to);
                second.encode(to);
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut monitor = Self::default();
        for _ in 0..from.varint()? {
            let id = BodyId::decode(from)?;
            monitor.report(id, ActiveEvents::decode(from)?);
        }
        for bodies in [&mut monitor.asleep, &mut monitor.turned_on] {
            for _ in 0..from.varint()? {
                bodies.insert(BodyId::decode(from)?);
            }
        }
        for pairs in [&mut monitor.touching, &mut monitor.inside] {
            for _ in 0..from.varint()? {
                pairs.insert((BodyId::decode(from)?, BodyId::decode(from)?));
            }
        }
        Ok(monitor)
    }
}

/// The events of one step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepEvents {
    /// All but the forces, in the order of their kinds, and each kind in the order of ids.
    pub events: Vec<BodyEvent>,
    /// The forces of contacts, in the order of ids. Each tells the same as the one before it, of another tick, so that those
    /// for which a tick has no room are not missed: the next ticks have their turn.
    pub forces: Vec<BodyEvent>,
    /// Number of further events, forces not counted.
    pub missed: u64,
}

impl StepEvents {
    pub(crate) fn push(&mut self, event: BodyEvent) {
        if self.events.len() < EVENTS_PER_TICK_MAX {
            self.events.push(event);
        } else {
            self.missed += 1;
        }
    }
}

impl StepEvents {
    /// Number of all events.
    pub(crate) fn count(&self) -> u64 {
        self.missed + self.events.len() as u64 + self.forces.len() as u64
    }

    /// The events of a tick that are sent, in the order of events.
    pub(crate) fn of_tick(&self, tick: Tick) -> Vec<BodyEvent> {
        let mut events = self.events.clone();
        self.add_forces(tick, &mut events);
        events
    }

    /// Adds as many forces as a tick has room for, in turn from one tick to the next.
    fn add_forces(&self, tick: Tick, events: &mut Vec<BodyEvent>) {
        let room = EVENTS_PER_TICK_MAX.saturating_sub(events.len());
        if room == 0 || self.forces.is_empty() {
            return;
        }
        let first = match self.forces.len() > room {
            true => (tick.value() as usize).wrapping_mul(room) % self.forces.len(),
            false => 0,
        };
        let turn = self.forces.iter().cycle().skip(first);
        events.extend(turn.take(room.min(self.forces.len())));
        events.sort_by_key(EventKey::of);
    }

    /// The events of a tick, and before them as many that stand as it has room for, in the order of events. `after`: the last
    /// one that was sent, which is returned anew; `None` if none is left.
    #[must_use]
    pub fn with_standing(
        &self,
        tick: Tick,
        standing: &[BodyEvent],
        after: EventKey,
    ) -> (Vec<BodyEvent>, Option<EventKey>) {
        let room = EVENTS_PER_TICK_MAX.saturating_sub(self.events.len());
        let untold = |event: &&BodyEvent| EventKey::of(event) > after;
        let mut left = standing.iter().filter(untold).copied().peekable();
        let mut events: Vec<_> = left.by_ref().take(room).collect();
        let last = events.last().map_or(after, EventKey::of);
        let due = left.peek().map(|_| last);
        // Contacts that began in this tick stand, too.
        events.extend(&self.events);
        events.sort_by_key(EventKey::of);
        events.dedup_by_key(|event| EventKey::of(event));
        self.add_forces(tick, &mut events);
        (events, due)
    }
}

/// The place of an event among those of a tick: its code and its bodies.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct EventKey(u8, BodyId, BodyId);

impl EventKey {
    /// Before every event: no body touches itself.
    pub const FIRST: Self = Self(0, BodyId::new(0, 0), BodyId::new(0, 0));

    fn of(event: &BodyEvent) -> Self {
        let none = BodyId::new(0, 0);
        match *event {
            BodyEvent::ContactBegan { body, contact } => Self(0, body, contact.with),
            BodyEvent::ContactEnded { body, with } => Self(1, body, with),
            BodyEvent::ContactForce { body, contact } => Self(2, body, contact.with),
            BodyEvent::SensorEntered { sensor, body } => Self(3, sensor, body),
            BodyEvent::SensorLeft { sensor, body } => Self(4, sensor, body),
            BodyEvent::FellAsleep(body) => Self(5, body, none),
            BodyEvent::Woke(body) => Self(6, body, none),
            BodyEvent::Fault(body) => Self(7, body, none),
            BodyEvent::ReachedGround(body) => Self(8, body, none),
            BodyEvent::LeftGround(body) => Self(9, body, none),
        }
    }
}

/// A pair in contact after a step.
struct Touch {
    /// From the body with the lesser id.
    contact: Contact,
    /// True if a body of the pair reports contacts.
    reported: bool,
    /// True if the force reaches the threshold of a body of the pair.
    forceful: bool,
}

/// The result of a step.
struct SteppedScene<'a> {
    engine: &'a dyn Engine,
    registry: &'a Registry,
    observations: &'a [Observation],
}

impl SteppedScene<'_> {
    fn exists(&self, id: BodyId) -> bool {
        self.registry.body(id).is_some()
    }

    fn activity(&self, id: BodyId) -> Option<Activity> {
        let place = self
            .observations
            .binary_search_by_key(&id, |observation| observation.id);
        place.ok().map(|place| self.observations[place].activity)
    }

    /// True if the body's contacts may differ from those of the step before.
    fn may_differ(&self, id: BodyId) -> bool {
        self.registry
            .body(id)
            .is_some_and(|desc| desc.kind != BodyKind::Dynamic || self.activity(id).is_some())
    }
}

impl EventMonitor {
    /// Turns the events of a body on or off.
    pub(crate) fn set(&mut self, id: BodyId, events: ActiveEvents, engine: &dyn Engine) {
        self.forget(id);
        if !events.any() {
            return;
        }
        self.report(id, events);
        self.turned_on.insert(id);
        let observation = engine.observe_one(id);
        if observation.is_some_and(|observation| observation.activity == Activity::Asleep) {
            self.asleep.insert(id);
        }
    }

    /// Notes a body that was removed: what it was part of ends with the next step.
    pub(crate) fn remove(&mut self, id: BodyId) {
        self.removed.push(id);
    }

    /// The pairs that touch and the bodies in sensors, as the events that began them with the present contacts, in the order
    /// of events.
    ///
    /// The pairs are those of the last step, less those of which a body is gone since, or none reports any more.
    pub(crate) fn standing(&self, engine: &dyn Engine, registry: &Registry) -> Vec<BodyEvent> {
        let exist = |pair: (BodyId, BodyId)| {
            [pair.0, pair.1]
                .iter()
                .all(|id| registry.body(*id).is_some())
        };
        let mut began = BTreeMap::new();
        let mut contacts = Vec::new();
        for id in (self.active.iter()).filter_map(|(id, events)| events.contacts.then_some(*id)) {
            contacts.clear();
            engine.contacts(id, &mut contacts);
            for contact in &contacts {
                let (body, contact) = from_lesser(id, *contact);
                let pair = (body, contact.with);
                if self.touching.contains(&pair) && exist(pair) {
                    began.insert(pair, contact);
                }
            }
        }
        let began = began.into_iter();
        let began = began.map(|((body, _), contact)| BodyEvent::ContactBegan { body, contact });
        let reports = |id: BodyId| self.active.get(&id).is_some_and(|events| events.sensors);
        let inside = self.inside.iter().copied();
        let entered = inside
            .filter(|pair| exist(*pair) && (reports(pair.0) || reports(pair.1)))
            .map(|(sensor, body)| BodyEvent::SensorEntered { sensor, body });
        began.chain(entered).collect()
    }

    /// The events of the last step.
    pub(crate) fn observe(
        &mut self,
        engine: &dyn Engine,
        registry: &Registry,
        observations: &[Observation],
    ) -> StepEvents {
        let mut events = StepEvents::default();
        let removed = std::mem::take(&mut self.removed);
        if self.active.is_empty() && self.touching.is_empty() && self.inside.is_empty() {
            self.turned_on.clear();
            return events;
        }
        let stepped = SteppedScene {
            engine,
            registry,
            observations,
        };
        self.compare_contacts(&stepped, &mut events);
        self.compare_sensors(&stepped, &mut events);
        self.compare_sleep(&stepped, &mut events);
        self.turned_on.clear();
        removed.into_iter().for_each(|id| self.forget(id));
        events
    }

    fn report(&mut self, id: BodyId, events: ActiveEvents) {
        self.active.insert(id, events);
        if events.contacts || events.force.is_some() {
            self.touch_reporters.insert(id);
        }
        if events.sensors {
            self.sensor_reporters.insert(id);
        }
    }

    fn forget(&mut self, id: BodyId) {
        self.active.remove(&id);
        self.touch_reporters.remove(&id);
        self.sensor_reporters.remove(&id);
        self.asleep.remove(&id);
    }

    fn compare_contacts(&mut self, stepped: &SteppedScene<'_>, events: &mut StepEvents) {
        let touches = self.touches(stepped);
        for (pair, touch) in &touches {
            if touch.reported && !self.touching.contains(pair) {
                let contact = touch.contact;
                let body = pair.0;
                events.push(BodyEvent::ContactBegan { body, contact });
            }
        }
        let reports = |events: &ActiveEvents| events.contacts;
        let over = |pair| touches.get(&pair).is_none_or(|touch| !touch.reported);
        let end = |(body, with)| BodyEvent::ContactEnded { body, with };
        let mut touching = std::mem::take(&mut self.touching);
        touching.retain(|pair| {
            let may_differ = |id| stepped.may_differ(id);
            let end = |pair| events.push(end(pair));
            self.note_continued((*pair, stepped), (reports, may_differ), over, end)
        });
        let reported = touches.iter().filter(|(_, touch)| touch.reported);
        touching.extend(reported.map(|(pair, _)| *pair));
        self.touching = touching;
        for ((body, _), touch) in touches.iter().filter(|(_, touch)| touch.forceful) {
            events.forces.push(BodyEvent::ContactForce {
                body: *body,
                contact: touch.contact,
            });
        }
    }

    /// All contacts of bodies that report contacts or forces and may have changed.
    fn touches(&self, stepped: &SteppedScene<'_>) -> BTreeMap<(BodyId, BodyId), Touch> {
        let mut touches: BTreeMap<_, Touch> = BTreeMap::new();
        let mut contacts = Vec::new();
        let events_of = |id| Some((id, self.active.get(id)?));
        for (id, events) in self.touch_reporters.iter().filter_map(events_of) {
            let differs = stepped.may_differ(*id);
            if !differs && !self.turned_on.contains(id) {
                continue;
            }
            contacts.clear();
            stepped.engine.contacts(*id, &mut contacts);
            for contact in &contacts {
                let (body, contact) = from_lesser(*id, *contact);
                let touch = touches.entry((body, contact.with)).or_insert(Touch {
                    contact,
                    reported: false,
                    forceful: false,
                });
                touch.reported |= events.contacts;
                touch.forceful |=
                    differs && events.force.is_some_and(|least| contact.force >= least);
            }
        }
        touches
    }

    fn compare_sensors(&mut self, stepped: &SteppedScene<'_>, events: &mut StepEvents) {
        let mut now = Vec::new();
        for id in &self.sensor_reporters {
            stepped.engine.sensed(*id, &mut now);
        }
        now.sort_unstable();
        now.dedup();
        for (sensor, body) in now.iter().copied() {
            if !self.inside.contains(&(sensor, body)) {
                events.push(BodyEvent::SensorEntered { sensor, body });
            }
        }
        let reports = |events: &ActiveEvents| events.sensors;
        let over = |pair| now.binary_search(&pair).is_err();
        let end = |(sensor, body)| BodyEvent::SensorLeft { sensor, body };
        let mut inside = std::mem::take(&mut self.inside);
        inside.retain(|pair| {
            // Others move while it sleeps: each of them is looked at.
            let may_differ = |_| true;
            let end = |pair| events.push(end(pair));
            self.note_continued((*pair, stepped), (reports, may_differ), over, end)
        });
        inside.extend(now.iter().copied());
        self.inside = inside;
    }

    /// True if a pair of the step before is still one; reports its end.
    fn note_continued(
        &self,
        (pair, stepped): ((BodyId, BodyId), &SteppedScene<'_>),
        (reports, may_differ): (impl Fn(&ActiveEvents) -> bool, impl Fn(BodyId) -> bool),
        over: impl Fn((BodyId, BodyId)) -> bool,
        mut end: impl FnMut((BodyId, BodyId)),
    ) -> bool {
        let both = [pair.0, pair.1];
        if !both.iter().all(|id| stepped.exists(*id)) {
            end(pair);
            return false;
        }
        let reporting = |id: &&BodyId| self.active.get(id).is_some_and(&reports);
        let mut reporting = both.iter().filter(reporting).peekable();
        if reporting.peek().is_none() {
            // Its events were turned off: nothing tells when it ends.
            end(pair);
            return false;
        }
        let ended = reporting.any(|id| may_differ(*id)) && over(pair);
        if ended {
            end(pair);
        }
        !ended
    }

    /// Looks at the observed bodies only: no other falls asleep or wakes.
    fn compare_sleep(&mut self, stepped: &SteppedScene<'_>, events: &mut StepEvents) {
        let mut woken = Vec::new();
        for Observation { id, activity, .. } in stepped.observations {
            if !self.active.get(id).is_some_and(|events| events.sleep) {
                continue;
            }
            match activity {
                Activity::Asleep if self.asleep.insert(*id) => {
                    events.push(BodyEvent::FellAsleep(*id));
                }
                Activity::Awake if self.asleep.remove(id) => woken.push(*id),
                _ => {}
            }
        }
        for id in woken {
            events.push(BodyEvent::Woke(id));
        }
    }
}

/// A contact from the body of the pair with the lesser id.
fn from_lesser(id: BodyId, contact: Contact) -> (BodyId, Contact) {
    if id <= contact.with {
        return (id, contact);
    }
    let flipped = Contact {
        with: id,
        point: contact.point - contact.normal * contact.separation,
        normal: -contact.normal,
        ..contact
    };
    (contact.with, flipped)
}
