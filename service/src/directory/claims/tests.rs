//! Servers, a directory and a network between them, by seed.
//!
//! Messages are late, lost, done twice and out of order; servers are cut off, frozen and killed; clocks differ as far as they
//! may. After each event the check: no scene has two servers that would publish it. In the end the faults stop, and each
//! scene has a server again. `SEEDS=n` runs more cases, `SEED=n` runs one.

use std::collections::BTreeMap;

use rhumb_protocol::scene::SceneName;
use rhumb_protocol::{Instant, Span};

use super::{
    ANSWER, ClaimEvent, DirectoryAnswer, DirectoryRequest, Epoch, InvalidLease, LeaseId,
    LeaseSeconds, MARGIN, RETRY, RequestId, SceneClaims, ServerPlace, until,
};

const SERVERS: usize = 3;
const SCENES: usize = 3;
const MS: u64 = 1_000_000;
/// Time with faults, and after them.
const FAULTS_NS: u64 = 40_000 * MS;
const CALM_NS: u64 = 20_000 * MS;

/// SplitMix64.
struct SimChance(u64);

impl SimChance {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % end
    }

    fn percent(&mut self, share: u64) -> bool {
        self.below(100) < share
    }
}

enum SimEvent {
    /// A request reaches the directory.
    Asked(usize, u64, RequestId, DirectoryRequest),
    /// An answer, or the end of its time, reaches a server of this life.
    Answered(usize, u64, RequestId, DirectoryAnswer),
    /// A server looks at its clock.
    Look(usize, u64),
    /// A client names a scene at a server.
    Named(usize, usize),
    /// A server gives a scene up.
    GivenUp(usize, usize),
    CutOff(usize, u64),
    Frozen(usize, u64),
    Killed(usize),
}

/// The directory: leases, and who has which scene.
#[derive(Default)]
struct Directory {
    revision: u64,
    /// The end of each lease by the directory's clock, and its server.
    leases: BTreeMap<u64, (u64, usize)>,
    scenes: BTreeMap<SceneName, (u64, u64)>,
}

impl Directory {
    /// `now_ns`: by its own clock.
    fn answer(&mut self, now_ns: u64, from: usize, request: DirectoryRequest) -> DirectoryAnswer {
        let ended: Vec<u64> = (self.leases.iter())
            .filter(|(_, (until, _))| *until <= now_ns)
            .map(|(lease, _)| *lease)
            .collect();
        ended.into_iter().for_each(|lease| self.end(lease));
        self.revision += 1;
        match request {
            DirectoryRequest::Grant { seconds } => {
                let until = now_ns + seconds * 1_000 * MS;
                self.leases.insert(self.revision, (until, from));
                DirectoryAnswer::Granted(LeaseId(self.revision), seconds)
            }
            DirectoryRequest::Renew(LeaseId(lease)) => match self.leases.get_mut(&lease) {
                None => DirectoryAnswer::NoLease,
                Some((until, _)) => {
                    *until = now_ns + 5_000 * MS;
                    DirectoryAnswer::Renewed(5)
                }
            },
            DirectoryRequest::Revoke(LeaseId(lease)) => {
                self.end(lease);
                DirectoryAnswer::Revoked
            }
            DirectoryRequest::Claim(LeaseId(lease), scene) => {
                if !self.leases.contains_key(&lease) {
                    return DirectoryAnswer::NoLease;
                }
                let claim = (lease, self.revision);
                let (lease, epoch) = *self.scenes.entry(scene).or_insert(claim);
                DirectoryAnswer::Owner {
                    lease: LeaseId(lease),
                    epoch: Epoch(epoch),
                    place: place(self.leases[&lease].1),
                }
            }
            DirectoryRequest::Release(Epoch(epoch), scene) => {
                if self.scenes.get(&scene).is_some_and(|(_, of)| *of == epoch) {
                    self.scenes.remove(&scene);
                }
                DirectoryAnswer::Released
            }
        }
    }

    fn end(&mut self, lease: u64) {
        self.leases.remove(&lease);
        self.scenes.retain(|_, (of, _)| *of != lease);
    }
}

struct SimServer {
    claims: SceneClaims,
    owned: BTreeMap<SceneName, Epoch>,
    /// The number of this life.
    life: u64,
    /// The rate of its clock, in parts of a thousand.
    rate: u64,
    cut_off_until: u64,
    frozen_until: u64,
    look_at: Option<u64>,
}

impl SimServer {
    /// Its clock at a true moment.
    fn clock(&self, at: u64) -> Instant {
        Instant::from_nanos(at / 1_000 * self.rate)
    }

    fn publishes(&self, at: u64, scene: &SceneName) -> Option<Epoch> {
        let epoch = self.owned.get(scene)?;
        (self.clock(at) < self.claims.publishes_until()).then_some(*epoch)
    }
}

struct SimWorld {
    chance: SimChance,
    now: u64,
    directory: Directory,
    directory_rate: u64,
    servers: Vec<SimServer>,
    queue: BTreeMap<(u64, u64), SimEvent>,
    numbers: u64,
    scenes: Vec<SceneName>,
    newest: BTreeMap<SceneName, Epoch>,
    owners: u64,
}

fn place(server: usize) -> ServerPlace {
    ServerPlace(format!("rhumb://server-{server}:4433"))
}

impl SimWorld {
    /// `slowest` and `fastest`: rates of clocks, in parts of a thousand.
    fn new(seed: u64, (slowest, fastest): (u64, u64)) -> Self {
        let mut chance = SimChance(seed);
        let mut rate = || slowest + chance.below(fastest - slowest + 1);
        let directory_rate = rate();
        let servers = (0..SERVERS).map(|server| SimServer {
            claims: SceneClaims::new(Instant::ZERO, place(server), LeaseSeconds::default()),
            owned: BTreeMap::new(),
            life: 0,
            rate: rate(),
            cut_off_until: 0,
            frozen_until: 0,
            look_at: None,
        });
        let servers = servers.collect();
        let scenes = (0..SCENES).map(|n| format!("scene-{n}").parse().unwrap());
        let mut world = Self {
            chance,
            now: 0,
            directory: Directory::default(),
            directory_rate,
            servers,
            queue: BTreeMap::new(),
            numbers: 0,
            scenes: scenes.collect(),
            newest: BTreeMap::new(),
            owners: 0,
        };
        (0..SERVERS).for_each(|server| world.drain(server));
        world.plan();
        world
    }

    /// Plans what clients and faults do.
    fn plan(&mut self) {
        for _ in 0..60 {
            let at = self.chance.below(FAULTS_NS);
            let server = self.chance.below(SERVERS as u64) as usize;
            let scene = self.chance.below(SCENES as u64) as usize;
            let event = match self.chance.below(100) {
                0..60 => SimEvent::Named(server, scene),
                60..80 => SimEvent::GivenUp(server, scene),
                80..90 => SimEvent::CutOff(server, self.chance.below(12_000) * MS),
                90..96 => SimEvent::Frozen(server, self.chance.below(12_000) * MS),
                _ => SimEvent::Killed(server),
            };
            self.put(at, event);
        }
        for n in 0..10 {
            for scene in 0..SCENES {
                let server = self.chance.below(SERVERS as u64) as usize;
                let at = FAULTS_NS + n * CALM_NS / 10;
                self.put(at, SimEvent::Named(server, scene));
            }
        }
    }

    fn put(&mut self, at: u64, event: SimEvent) {
        self.numbers += 1;
        self.queue.insert((at, self.numbers), event);
    }

    fn is_calm(&self) -> bool {
        self.now >= FAULTS_NS
    }

    /// The time that a message takes; `None` if it is lost.
    fn transit(&mut self, server: usize) -> Option<u64> {
        if self.is_calm() {
            return Some(5 * MS);
        }
        if self.servers[server].cut_off_until > self.now || self.chance.percent(3) {
            return None;
        }
        Some(match self.chance.below(20) {
            0 => self.chance.below(8_000) * MS,
            _ => self.chance.below(40) * MS,
        })
    }

    /// Takes what the claims of a server put out.
    fn drain(&mut self, server: usize) {
        while let Some((id, request)) = self.servers[server].claims.poll_request() {
            let life = self.servers[server].life;
            let late = self.now + ANSWER.as_nanos();
            self.put(
                late,
                SimEvent::Answered(server, life, id, DirectoryAnswer::Failed),
            );
            let copies = if self.chance.percent(2) { 2 } else { 1 };
            for _ in 0..copies {
                if let Some(transit) = self.transit(server) {
                    let asked = SimEvent::Asked(server, life, id, request.clone());
                    self.put(self.now + transit, asked);
                }
            }
        }
        while let Some(said) = self.servers[server].claims.poll_event() {
            match said {
                ClaimEvent::Owned(scene, epoch) => self.own(server, scene, epoch),
                ClaimEvent::Lost => self.servers[server].owned.clear(),
                ClaimEvent::Elsewhere(scene, at) => self.follow(server, &scene, &at),
                ClaimEvent::Unknown(_) => {}
            }
        }
        let of = &self.servers[server];
        let look = of.claims.poll_timeout().map(|at| {
            let at = at.since(Instant::ZERO).as_nanos() / of.rate * 1_000 + 1_000_000;
            at.max(self.now + 1)
        });
        if let Some(at) = look.filter(|at| of.look_at.is_none_or(|planned| *at < planned)) {
            let life = of.life;
            self.servers[server].look_at = Some(at);
            self.put(at, SimEvent::Look(server, life));
        }
    }

    /// The client goes to the server that is named.
    fn follow(&mut self, server: usize, scene: &SceneName, at: &ServerPlace) {
        let other = (0..SERVERS).position(|other| place(other) == *at);
        let other = other.expect("it is one of the servers");
        assert_ne!(other, server, "a server sends a client to itself");
        let scene = self.scenes.iter().position(|one| one == scene);
        let named = SimEvent::Named(other, scene.expect("it is one of the scenes"));
        self.put(self.now + 10 * MS, named);
    }

    fn own(&mut self, server: usize, scene: SceneName, epoch: Epoch) {
        let newest = self.newest.entry(scene.clone()).or_insert(epoch);
        assert!(epoch >= *newest, "an older epoch owns {scene}");
        *newest = epoch;
        self.owners += 1;
        self.servers[server].owned.insert(scene, epoch);
    }

    /// Does what is next; false if nothing is.
    fn step(&mut self) -> bool {
        let Some(((at, _), event)) = self.queue.pop_first() else {
            return false;
        };
        self.now = at;
        if at > FAULTS_NS + CALM_NS {
            return false;
        }
        if let Some((server, frozen_until)) = self.frozen(&event) {
            if let SimEvent::Look(..) = event {
                self.servers[server].look_at = Some(frozen_until);
            }
            self.put(frozen_until, event);
            return true;
        }
        self.handle(event);
        true
    }

    /// The server that does not see an event before it resumes, and the moment at which it does.
    fn frozen(&self, event: &SimEvent) -> Option<(usize, u64)> {
        let (SimEvent::Answered(server, ..)
        | SimEvent::Look(server, _)
        | SimEvent::Named(server, _)
        | SimEvent::GivenUp(server, _)) = event
        else {
            return None;
        };
        let until = self.servers[*server].frozen_until.min(FAULTS_NS);
        (until > self.now).then_some((*server, until))
    }

    fn handle(&mut self, event: SimEvent) {
        let now = self.now;
        match event {
            SimEvent::Asked(server, life, id, request) => {
                let clock = now / 1_000 * self.directory_rate;
                let answer = self.directory.answer(clock, server, request);
                if let Some(transit) = self.transit(server) {
                    let answered = SimEvent::Answered(server, life, id, answer);
                    self.put(now + transit, answered);
                }
            }
            SimEvent::Answered(server, life, id, answer) if self.servers[server].life == life => {
                let of = &mut self.servers[server];
                let clock = of.clock(now);
                of.claims.handle_answer(clock, id, answer);
                self.drain(server);
            }
            SimEvent::Look(server, life) if self.servers[server].life == life => {
                let of = &mut self.servers[server];
                of.look_at = None;
                let clock = of.clock(now);
                of.claims.handle_timeout(clock);
                self.drain(server);
            }
            SimEvent::Named(server, scene) => {
                let of = &mut self.servers[server];
                let clock = of.clock(now);
                of.claims.claim(clock, &self.scenes[scene]);
                self.drain(server);
            }
            SimEvent::GivenUp(server, scene) => {
                let of = &mut self.servers[server];
                let clock = of.clock(now);
                if of.owned.remove(&self.scenes[scene]).is_some() {
                    of.claims.release(clock, &self.scenes[scene]);
                }
                self.drain(server);
            }
            SimEvent::CutOff(server, time) => self.servers[server].cut_off_until = now + time,
            SimEvent::Frozen(server, time) => self.servers[server].frozen_until = now + time,
            SimEvent::Killed(server) => {
                let of = &mut self.servers[server];
                of.life += 1;
                of.owned.clear();
                of.look_at = None;
                of.claims = SceneClaims::new(of.clock(now), place(server), LeaseSeconds::default());
                self.drain(server);
            }
            SimEvent::Answered(..) | SimEvent::Look(..) => {}
        }
    }

    /// A scene that two servers would publish now.
    fn doubled(&self) -> Option<&SceneName> {
        self.scenes.iter().find(|scene| {
            let servers = self.servers.iter();
            let publishing = servers.filter(|of| of.publishes(self.now, scene).is_some());
            publishing.count() > 1
        })
    }
}

/// The numbers of owners in a case, unless two publish one scene.
fn run(seed: u64, rates: (u64, u64)) -> Result<u64, String> {
    let mut world = SimWorld::new(seed, rates);
    while world.step() {
        if let Some(scene) = world.doubled() {
            return Err(format!("SEED={seed}: two servers publish {scene}"));
        }
    }
    for scene in &world.scenes {
        let servers = world.servers.iter();
        let own = servers.filter(|of| of.publishes(world.now, scene).is_some());
        if own.count() != 1 {
            return Err(format!(
                "SEED={seed}: after the faults no server has {scene}"
            ));
        }
    }
    Ok(world.owners)
}

#[test]
fn no_scene_ever_has_two_servers_and_after_the_faults_each_has_one() {
    let alone = std::env::var("SEED")
        .ok()
        .and_then(|seed| seed.parse().ok());
    let many = (std::env::var("SEEDS").ok()).and_then(|seeds| seeds.parse().ok());
    let seeds = alone.map_or(0..many.unwrap_or(500), |seed: u64| seed..seed + 1);
    let cases = seeds.end - seeds.start;
    let owners: u64 = seeds.map(|seed| run(seed, (990, 1_010)).unwrap()).sum();
    assert!(alone.is_some() || owners > 10 * cases, "{owners}");
}

#[test]
fn clocks_that_differ_by_far_more_than_they_may_are_found_out() {
    let doubled = |seed| run(seed, (600, 1_400)).is_err_and(|error| error.contains("two servers"));
    assert!((0..2_000).any(doubled));
}

#[test]
fn a_claim_waits_a_moment_for_the_first_lease() {
    let (mut claims, now) = (
        SceneClaims::new(Instant::ZERO, place(0), LeaseSeconds::default()),
        Instant::ZERO,
    );
    let scene: SceneName = "pit".parse().unwrap();
    claims.claim(now, &scene);
    claims.handle_timeout(now + Span::from_millis(10));
    assert_eq!((claims.poll_event(), claims.publishes_until()), (None, now));
    claims.handle_timeout(now + ANSWER);
    assert_eq!(
        claims.poll_event(),
        Some(ClaimEvent::Unknown(scene.clone()))
    );
    // With a lease it is asked for.
    claims.claim(now + ANSWER, &scene);
    let (id, request) = claims.poll_request().unwrap();
    assert_eq!(request, DirectoryRequest::Grant { seconds: 5 });
    let granted = DirectoryAnswer::Granted(LeaseId(7), 5);
    claims.handle_answer(now + ANSWER, id, granted);
    let asked = claims.poll_request().map(|(_, request)| request);
    assert_eq!(asked, Some(DirectoryRequest::Claim(LeaseId(7), scene)));
}

/// Claims with a lease of 5 s.
fn leased() -> (SceneClaims, LeaseId) {
    let (mut claims, now) = (
        SceneClaims::new(Instant::ZERO, place(0), LeaseSeconds::default()),
        Instant::ZERO,
    );
    claims.handle_timeout(now);
    let (id, _) = claims.poll_request().unwrap();
    claims.handle_answer(now, id, DirectoryAnswer::Granted(LeaseId(7), 5));
    (claims, LeaseId(7))
}

/// The requests of claims.
fn requests(claims: &mut SceneClaims) -> Vec<(RequestId, DirectoryRequest)> {
    std::iter::from_fn(|| claims.poll_request()).collect()
}

#[test]
fn a_lease_that_is_over_is_ended_a_margin_later_and_its_scenes_come_back_then() {
    let (mut claims, old) = leased();
    let scene: SceneName = "pit".parse().unwrap();
    let over = claims.publishes_until();
    claims.handle_timeout(over);
    assert_eq!(claims.poll_event(), Some(ClaimEvent::Lost));
    let (grant, _) = requests(&mut claims).pop().unwrap();
    claims.handle_answer(over, grant, DirectoryAnswer::Granted(LeaseId(8), 5));
    claims.claim(over, &scene);
    let (claim, asked) = requests(&mut claims).pop().unwrap();
    assert_eq!(asked, DirectoryRequest::Claim(LeaseId(8), scene.clone()));
    let owner = |lease| DirectoryAnswer::Owner {
        lease,
        epoch: Epoch(lease.0),
        place: place(0),
    };
    claims.handle_answer(over, claim, owner(old));
    assert_eq!(claims.poll_event(), None, "its clients wait");
    claims.handle_timeout(over + Span::from_nanos(MARGIN.as_nanos() - 1));
    let revoke = DirectoryRequest::Revoke(old);
    let early = requests(&mut claims);
    assert!(early.iter().all(|(_, request)| *request != revoke));
    claims.handle_timeout(over + MARGIN);
    let ended = requests(&mut claims);
    let (id, _) = ended
        .iter()
        .find(|(_, request)| *request == revoke)
        .unwrap();
    claims.handle_answer(over + MARGIN, early[0].0, owner(old));
    claims.handle_answer(over + MARGIN, *id, DirectoryAnswer::Revoked);
    claims.handle_timeout(over + MARGIN + RETRY);
    let again = requests(&mut claims).into_iter();
    let mut again = again.filter(|(_, request)| *request == asked);
    let (id, _) = again.next().expect("the scene is claimed again");
    claims.handle_answer(over + MARGIN + RETRY, id, owner(LeaseId(8)));
    assert_eq!(
        claims.poll_event(),
        Some(ClaimEvent::Owned(scene, Epoch(8)))
    );
}

#[test]
fn the_time_of_a_lease_has_limits() {
    let renewal = |text: &str| text.parse().map(|lease: LeaseSeconds| lease.renewal());
    assert_eq!(renewal("5"), Ok(Span::from_millis(1_300)));
    for wrong in ["2", "31", "", "5.5", "-5"] {
        assert_eq!(renewal(wrong), Err(InvalidLease), "{wrong}");
    }
    // One renewal that gets no answer, and one that does.
    let shortest = renewal("3").unwrap();
    let again = Instant::ZERO + shortest + ANSWER + RETRY;
    assert!(again < until(Instant::ZERO, 3));
}

#[test]
fn a_claim_that_is_answered_by_no_lease_ends_the_lease_at_once() {
    let (mut claims, lease) = leased();
    let scene: SceneName = "pit".parse().unwrap();
    claims.claim(Instant::ZERO, &scene);
    let (id, request) = claims.poll_request().unwrap();
    assert_eq!(request, DirectoryRequest::Claim(lease, scene.clone()));
    claims.handle_answer(Instant::ZERO, id, DirectoryAnswer::NoLease);
    assert_eq!(claims.publishes_until(), Instant::ZERO);
    let events = std::iter::from_fn(|| claims.poll_event());
    let lost = [ClaimEvent::Unknown(scene), ClaimEvent::Lost];
    assert_eq!(events.collect::<Vec<_>>(), lost);
}
