//! The load of a server: scenes by number and cost, commands by their time.
//!
//! Only free-running scenes cost something. The prediction is ticks in a second, times substeps, times bodies; a tick
//! by itself costs [`STEPS_OF_TICK`], and each character and wheel in it. A scene reserves its part before it begins
//! and before a body is added, and gives it back when the body goes or the scene ends. All threads of a process share
//! both sums; the parts of other processes are as old as their last report.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};

use rhumb_protocol::scene::{Locomotion, SceneConfig, SceneName};
use rhumb_protocol::{Instant, Peer, Span};

/// The bounds that all scenes of a server share; all clones are one.
#[derive(Clone, Debug, Default)]
pub struct Admission {
    /// Their number.
    pub slots: SceneSlots,
    /// Their load.
    pub load: ServerLoad,
    /// The load of each tenant.
    pub tenants: TenantLoads,
}

/// The tenant of a scene: the first part of its name, up to a slash. A scene without one belongs to none.
#[must_use]
pub fn tenant_of(scene: &SceneName) -> Option<&str> {
    Some(scene.as_str().split_once('/')?.0)
}

/// The load of the scenes of each tenant, in this process; all clones are one. A tenant's scenes are in one process.
#[derive(Clone, Debug, Default)]
pub struct TenantLoads(Arc<Mutex<BTreeMap<String, Weak<AtomicU64>>>>);

impl TenantLoads {
    /// The sum of a tenant's scenes, which lives as long as they do.
    fn of(&self, tenant: &str) -> Arc<AtomicU64> {
        // An entry is added or removed in one piece.
        let mut sums = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        sums.retain(|_, sum| sum.strong_count() > 0);
        if let Some(sum) = sums.get(tenant).and_then(Weak::upgrade) {
            return sum;
        }
        let sum = Arc::new(AtomicU64::new(0));
        sums.insert(tenant.to_owned(), Arc::downgrade(&sum));
        sum
    }
}

/// The sum of the tenant's scenes to which a scene belongs, and its bound.
#[derive(Debug)]
struct TenantPart {
    sum: Arc<AtomicU64>,
    most: u64,
}

/// Counts the scenes of a server; all clones are one count.
#[derive(Clone, Debug, Default)]
pub struct SceneSlots(Arc<SlotCounts>);

#[derive(Debug, Default)]
struct SlotCounts {
    /// Scenes of this process.
    here: AtomicUsize,
    /// Scenes of the server's other processes.
    elsewhere: AtomicUsize,
}

/// The place of one scene; dropping it frees the place.
#[derive(Debug)]
pub(crate) struct SceneSlot(Arc<SlotCounts>);

impl SceneSlots {
    /// Scenes of this process.
    #[must_use]
    pub fn here(&self) -> usize {
        self.0.here.load(Ordering::Relaxed)
    }

    /// Sets the number of scenes of the server's other processes.
    pub fn set_elsewhere(&self, scenes: usize) {
        self.0.elsewhere.store(scenes, Ordering::Relaxed);
    }

    /// A place for another scene; `None` if the server has `most` already.
    pub(crate) fn take(&self, most: usize) -> Option<SceneSlot> {
        let most = most.saturating_sub(self.0.elsewhere.load(Ordering::Relaxed));
        let another = |count| (count < most).then_some(count + 1);
        let taken = (self.0.here).fetch_update(Ordering::Relaxed, Ordering::Relaxed, another);
        taken.ok().map(|_| SceneSlot(Arc::clone(&self.0)))
    }
}

impl Drop for SceneSlot {
    fn drop(&mut self) {
        self.0.here.fetch_sub(1, Ordering::Relaxed);
    }
}

/// When a client may try again that was refused for want of processor time.
pub(crate) const RETRY_SECONDS: u8 = 5;

/// Steps of bodies that a tick costs by itself: waking a thread, publishing, a datagram. An estimate: tens of
/// microseconds, where a resting body takes tens of nanoseconds.
const STEPS_OF_TICK: u64 = 500;

/// The sum over all scenes of a server; all clones are one.
#[derive(Clone, Debug, Default)]
pub struct ServerLoad(Arc<LoadSum>);

#[derive(Debug, Default)]
struct LoadSum {
    /// Reserved by scenes of this process.
    here: AtomicU64,
    /// Reserved by scenes of the server's other processes.
    elsewhere: AtomicU64,
}

impl LoadSum {
    fn reserved(&self) -> u64 {
        let elsewhere = self.elsewhere.load(Ordering::Relaxed);
        elsewhere.saturating_add(self.here.load(Ordering::Relaxed))
    }
}

/// The part of one scene; dropping it gives it back.
#[derive(Debug)]
pub(crate) struct SceneLoad {
    sum: Arc<LoadSum>,
    /// Ticks in a second.
    ticks: u64,
    /// Steps of one body in a second.
    per_body: u64,
    reserved: u64,
    /// The part of its characters and vehicles.
    locomotion: u64,
    tenant: Option<TenantPart>,
    scene_max: u64,
    server_max: u64,
}

/// Steps of bodies that a tick costs for a character: the casts of its shape.
const STEPS_OF_CHARACTER: u64 = 50;
/// The same for each wheel of a vehicle: a ray.
const STEPS_OF_WHEEL: u64 = 1;

/// Steps of bodies that a tick costs for the characters and vehicles of a scene.
pub(crate) fn locomotion_steps<'a>(locomotions: impl Iterator<Item = &'a Locomotion>) -> u64 {
    let steps = locomotions.map(|locomotion| match locomotion {
        Locomotion::None => 0,
        Locomotion::Character(_) => STEPS_OF_CHARACTER,
        Locomotion::Vehicle(vehicle) => STEPS_OF_WHEEL * vehicle.wheels.len() as u64,
    });
    steps.sum()
}

/// Steps of one body in a second, substeps counted.
pub(crate) fn body_steps(config: &SceneConfig) -> u64 {
    let integrator = &config.integrator;
    let ticks = u64::from(integrator.rate.ticks());
    (ticks * u64::from(integrator.substeps.get())).div_ceil(u64::from(integrator.rate.seconds()))
}

/// Ticks in a second, rounded up.
pub(crate) fn ticks_in_second(config: &SceneConfig) -> u64 {
    let rate = config.integrator.rate;
    u64::from(rate.ticks().div_ceil(rate.seconds()))
}

impl ServerLoad {
    /// Reserved body steps in a second.
    #[must_use]
    pub fn reserved(&self) -> u64 {
        self.0.reserved()
    }

    /// The part of the scenes of this process.
    #[must_use]
    pub fn here(&self) -> u64 {
        self.0.here.load(Ordering::Relaxed)
    }

    /// Sets the part of the server's other processes.
    pub fn set_elsewhere(&self, load: u64) {
        self.0.elsewhere.store(load, Ordering::Relaxed);
    }

    /// The part of a scene that has no bodies yet. `ticks`: in a second, and 0 for a scene that does not run by the clock;
    /// `substeps`: of a tick. It has the part of its ticks, even beyond the limits: see [`SceneLoad::has_room`].
    pub(crate) fn of_scene(
        &self,
        (ticks, substeps): (u64, u64),
        scene_max: u64,
        server_max: u64,
    ) -> SceneLoad {
        let reserved = ticks.saturating_mul(STEPS_OF_TICK);
        self.0.here.fetch_add(reserved, Ordering::Relaxed);
        SceneLoad {
            sum: Arc::clone(&self.0),
            ticks,
            per_body: ticks.saturating_mul(substeps),
            reserved,
            locomotion: 0,
            tenant: None,
            scene_max,
            server_max,
        }
    }
}

impl SceneLoad {
    /// Reserved body steps in a second.
    pub(crate) const fn reserved(&self) -> u64 {
        self.reserved
    }

    /// The same part, which counts for the tenant of a scene, too; `most`: of all of that tenant's scenes.
    pub(crate) fn of_tenant(mut self, scene: &SceneName, tenants: &TenantLoads, most: u64) -> Self {
        self.tenant = tenant_of(scene).map(|tenant| TenantPart {
            sum: tenants.of(tenant),
            most,
        });
        if let Some(tenant) = &self.tenant {
            tenant.sum.fetch_add(self.reserved, Ordering::Relaxed);
        }
        self
    }

    /// True if one body alone is within the scene's, the tenant's and the server's limits.
    pub(crate) fn has_room(&self) -> bool {
        let tenant_has = self.tenant.as_ref().is_none_or(|tenant| {
            let reserved = tenant.sum.load(Ordering::Relaxed);
            reserved.saturating_add(self.per_body) <= tenant.most
        });
        tenant_has
            && self.reserved.saturating_add(self.per_body) <= self.scene_max
            && self.sum.reserved().saturating_add(self.per_body) <= self.server_max
    }

    /// Reserves the steps of another body; false if that exceeds a limit.
    pub(crate) fn add_body(&mut self) -> bool {
        self.reserve(self.per_body)
    }

    /// Gives back the steps of a body.
    pub(crate) fn remove_body(&mut self) {
        self.give_back(self.per_body);
    }

    /// Reserves the steps of a scene's characters and vehicles in place of those before; false if more of them exceed
    /// a limit. `steps`: of bodies, in a tick.
    pub(crate) fn set_locomotion(&mut self, steps: u64) -> bool {
        let part = steps.saturating_mul(self.ticks);
        if part < self.locomotion {
            self.give_back(self.locomotion - part);
        } else if part > self.locomotion && !self.reserve(part - self.locomotion) {
            return false;
        }
        self.locomotion = part;
        true
    }

    fn reserve(&mut self, part: u64) -> bool {
        if self.reserved.saturating_add(part) > self.scene_max {
            return false;
        }
        if !self.reserve_of_tenant(part) {
            return false;
        }
        let elsewhere = self.sum.elsewhere.load(Ordering::Relaxed);
        let more = |here: u64| {
            let here = here.saturating_add(part);
            (here.saturating_add(elsewhere) <= self.server_max).then_some(here)
        };
        let reserved = (self.sum.here).fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
        match reserved {
            Ok(_) => self.reserved += part,
            Err(_) => self.give_back_to_tenant(part),
        }
        reserved.is_ok()
    }

    fn reserve_of_tenant(&self, part: u64) -> bool {
        let Some(TenantPart { sum, most }) = &self.tenant else {
            return true;
        };
        let more = |reserved: u64| {
            let reserved = reserved.saturating_add(part);
            (reserved <= *most).then_some(reserved)
        };
        sum.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more)
            .is_ok()
    }

    fn give_back_to_tenant(&self, part: u64) {
        if let Some(tenant) = &self.tenant {
            tenant.sum.fetch_sub(part, Ordering::Relaxed);
        }
    }

    fn give_back(&mut self, part: u64) {
        let part = part.min(self.reserved);
        self.reserved -= part;
        self.give_back_to_tenant(part);
        self.sum.here.fetch_sub(part, Ordering::Relaxed);
    }
}

impl Drop for SceneLoad {
    fn drop(&mut self) {
        self.give_back_to_tenant(self.reserved);
        self.sum.here.fetch_sub(self.reserved, Ordering::Relaxed);
    }
}

/// The commands that a free-running scene takes between two of its steps: those since the last step, and how many may follow.
///
/// Commands and steps share the thread of a scene. On a scene that is late, commands get as much time as its ticks: without
/// that, a scene that is filled takes one turn of commands for each tick, however long the tick is. A body makes the next
/// step longer by more than its command takes, the more so if many stand on one: so the bodies that are added between two
/// steps are bounded by how long the steps before were. A snapshot has the same time, since it leaves in pieces as its
/// link takes them; that slows a scene on time, too, if its ticks fill more than half of their time. Reads no clock. A
/// driver that does not report what links take, as in a simulated network, has no bound.
#[derive(Debug)]
pub(crate) struct CommandPace {
    commands: usize,
    /// True if a turn with commands took all of its time.
    is_full: bool,
    /// True if a snapshot was begun or continued.
    is_sending: bool,
    bodies: usize,
    /// The members that added them.
    adders: BTreeSet<Peer>,
    bodies_max: usize,
    /// Snapshots have this time, and commands if they are many.
    until: Instant,
}

/// Time for the messages of a scene that runs by the clock, between two calls for its ticks: however many come, a tick is no
/// later than that, and the one message that exceeds it.
pub(crate) const TURNS_TIME: Span = Span::from_millis(2);
/// Commands since a step from which on they are many: a turn of one connection.
const MANY: usize = 512;
/// Bodies that may always be added between two steps: some 0.4 s of a step if 80,000 stand on one.
const BODIES_LEAST: usize = 512;
/// Bodies that may be added between two steps at most: the record of a scene keeps their commands beside those before.
const BODIES_MOST: usize = 16_384;
/// A tick below this time lets twice as many bodies follow.
const SHORT: Span = Span::from_millis(250);
/// A tick beyond this time, half of the one after which a scene is stuck, lets half as many follow.
const LONG: Span = Span::from_millis(1_000);
/// Time of commands for one tick at most.
const SHARE_MAX: Span = Span::from_millis(250);

impl CommandPace {
    /// The pace of a scene that has not stepped.
    pub(crate) const fn new() -> Self {
        Self {
            commands: 0,
            is_full: false,
            is_sending: false,
            bodies: 0,
            adders: BTreeSet::new(),
            bodies_max: BODIES_LEAST,
            until: Instant::ZERO,
        }
    }

    /// Counts a command, whether it is applied or refused.
    pub(crate) const fn note_command(&mut self) {
        self.commands += 1;
    }

    /// Notes a turn that took all of its time. If the turn had commands, they count as many.
    pub(crate) const fn note_full_turn(&mut self) {
        self.is_full |= self.commands > 0;
    }

    /// The snapshot of a member begins, or its link took a piece of it.
    pub(crate) const fn note_snapshot(&mut self) {
        self.is_sending = true;
    }

    /// A member added a body.
    pub(crate) fn note_body(&mut self, peer: Peer) {
        self.bodies += 1;
        self.adders.insert(peer);
    }

    /// A tick that began at this moment took so long.
    pub(crate) fn note_tick(&mut self, now: Instant, took: Span) {
        let most = self.bodies_max;
        let was_needed = self.bodies >= most;
        self.bodies_max = match took {
            took if took > LONG || !was_needed => most / 2,
            took if took < SHORT => most * 2,
            _ => most,
        };
        self.bodies_max = self.bodies_max.clamp(BODIES_LEAST, BODIES_MOST);
        self.until = now + took + took.min(SHARE_MAX);
        (self.commands, self.bodies) = (0, 0);
        (self.is_full, self.is_sending) = (false, false);
        self.adders.clear();
    }

    /// The moment before which no step begins: that at which snapshots have had their time, and commands if they are many.
    pub(crate) const fn next_step(&self) -> Instant {
        match self.commands >= MANY || self.is_full || self.is_sending {
            true => self.until,
            false => Instant::ZERO,
        }
    }

    /// True if the messages of a member wait for the next step: it adds bodies, and so many were added as may be.
    pub(crate) fn holds_back(&self, peer: Peer) -> bool {
        self.bodies >= self.bodies_max && self.adders.contains(&peer)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use rhumb_protocol::scene::{Character, Vehicle, Wheel};

    use super::*;

    #[test]
    fn scenes_share_what_the_server_admits() {
        let server = ServerLoad::default();
        let mut first = server.of_scene((1, 960), 2_500, 4_000);
        let mut second = server.of_scene((1, 960), 2_500, 4_000);
        assert_eq!(server.reserved(), 1_000, "their ticks");
        assert!(first.add_body() && first.add_body());
        assert!(!first.add_body(), "a third body exceeds the scene's part");
        assert!(second.add_body());
        assert!(!second.add_body(), "the server admits no fourth body");
        assert!(!second.has_room());
        assert_eq!(server.reserved(), 3_880);
        first.remove_body();
        assert!(second.add_body());
        drop(first);
        drop(second);
        assert_eq!(server.reserved(), 0);
    }

    #[test]
    fn a_tenant_s_scenes_share_its_part_and_leave_the_rest_to_others() {
        let (server, tenants) = (ServerLoad::default(), TenantLoads::default());
        let scene = |name: &str| {
            let name: SceneName = name.parse().unwrap();
            let load = server.of_scene((1, 100), 10_000, 4_000);
            load.of_tenant(&name, &tenants, 1_250)
        };
        let (mut first, mut second) = (scene("a/1"), scene("a/2"));
        assert!(first.add_body() && second.add_body());
        assert!(
            !first.add_body() && !second.has_room(),
            "the tenant has its part"
        );
        let (mut other, mut none) = (scene("b/1"), scene("alone"));
        for _ in 0..5 {
            assert!(other.add_body() && none.add_body(), "others have theirs");
        }
        assert_eq!(server.reserved(), 2_000 + 1_200);
        drop(first);
        assert!(second.add_body() && second.add_body(), "it was given back");
        drop((second, other));
        assert!(scene("a/3").has_room());
        assert_eq!(server.reserved(), 500 + 500, "the scene without a tenant");
    }

    #[test]
    fn characters_and_vehicles_take_their_part() {
        let server = ServerLoad::default();
        let mut scene = server.of_scene((1, 4), 700, 10_000);
        let character = Locomotion::Character(Character::default());
        let wheels = vec![Wheel::at(Vec3::ZERO, 0.3); 4];
        let vehicle = Locomotion::Vehicle(Vehicle { wheels });
        let steps = locomotion_steps([&character, &vehicle].into_iter());
        assert_eq!(steps, 54);
        assert!(scene.set_locomotion(3 * steps));
        assert_eq!(server.reserved(), 500 + 162);
        assert!(
            !scene.set_locomotion(4 * steps),
            "a fourth exceeds the scene's part"
        );
        assert!(scene.set_locomotion(steps));
        assert_eq!(server.reserved(), 500 + 54);
    }

    #[test]
    fn scenes_of_other_processes_take_their_part() {
        let server = ServerLoad::default();
        let mut scene = server.of_scene((1, 960), 2_000, 3_500);
        server.set_elsewhere(2_500);
        assert!(!scene.has_room() && !scene.add_body());
        server.set_elsewhere(2_040);
        assert!(scene.add_body());
        assert_eq!((server.here(), server.reserved()), (1_460, 3_500));
    }

    #[test]
    fn a_scene_that_clients_advance_reserves_nothing() {
        let server = ServerLoad::default();
        let mut scene = server.of_scene((0, 4), 1, 1);
        assert!((0..100).all(|_| scene.add_body()));
        assert_eq!(server.reserved(), 0);
    }

    #[test]
    fn fast_scenes_without_bodies_are_bounded() {
        let server = ServerLoad::default();
        let begin = || server.of_scene((1_000, 16), 20_000_000, 40_000_000);
        let scenes: Vec<_> = std::iter::from_fn(|| Some(begin()).filter(SceneLoad::has_room))
            .take(256)
            .collect();
        assert_eq!(scenes.len(), 79);
        drop(scenes);
        assert_eq!(server.reserved(), 0);
    }

    #[test]
    fn a_place_is_free_again_when_its_scene_ends() {
        let slots = SceneSlots::default();
        let mut taken: Vec<_> = std::iter::from_fn(|| slots.clone().take(4)).collect();
        assert_eq!(taken.len(), 4);
        taken.pop();
        assert!(slots.take(4).is_some());
        slots.set_elsewhere(2);
        assert!(slots.take(5).is_none(), "three here, two elsewhere");
        assert_eq!(slots.here(), 3);
    }

    const ADDER: Peer = Peer(1);
    const OTHER: Peer = Peer(2);

    /// Bodies that one member may add before the next step.
    fn fill(pace: &mut CommandPace) -> usize {
        let mut bodies = 0;
        while !pace.holds_back(ADDER) {
            pace.note_body(ADDER);
            bodies += 1;
        }
        bodies
    }

    #[test]
    fn twice_as_many_bodies_follow_short_ticks_and_half_as_many_a_long_one() {
        let mut pace = CommandPace::new();
        let mut filled = Vec::new();
        for took in [1, 10, 200, 400, 1_100, 1_100, 1] {
            filled.push(fill(&mut pace));
            pace.note_tick(Instant::ZERO, Span::from_millis(took));
        }
        assert_eq!(filled, [512, 1_024, 2_048, 4_096, 4_096, 2_048, 1_024]);
    }

    #[test]
    fn what_was_not_used_is_lost_and_the_most_is_bounded() {
        let mut pace = CommandPace::new();
        for _ in 0..10 {
            fill(&mut pace);
            pace.note_tick(Instant::ZERO, Span::ZERO);
        }
        assert_eq!(fill(&mut pace), BODIES_MOST);
        for _ in 0..10 {
            pace.note_tick(Instant::ZERO, Span::ZERO);
        }
        assert_eq!(fill(&mut pace), BODIES_LEAST);
    }

    #[test]
    fn only_members_that_add_bodies_wait() {
        let mut pace = CommandPace::new();
        fill(&mut pace);
        assert!(pace.holds_back(ADDER) && !pace.holds_back(OTHER));
        pace.note_tick(Instant::ZERO, Span::ZERO);
        assert!(!pace.holds_back(ADDER));
    }

    #[test]
    fn many_commands_have_as_much_time_as_the_tick_and_no_more_than_their_share() {
        let at = |ms| Instant::ZERO + Span::from_millis(ms);
        let mut pace = CommandPace::new();
        pace.note_tick(at(100), Span::from_millis(40));
        assert_eq!(pace.next_step(), Instant::ZERO, "there are none");
        (0..MANY).for_each(|_| pace.note_command());
        assert_eq!(pace.next_step(), at(180));
        pace.note_tick(at(180), Span::from_millis(40));
        pace.note_snapshot();
        assert_eq!(pace.next_step(), at(260), "a snapshot has it, too");
        pace.note_tick(at(180), Span::from_millis(1_000));
        (0..MANY).for_each(|_| pace.note_command());
        assert_eq!(pace.next_step(), at(1_430));
    }
}
