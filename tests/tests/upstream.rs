//! What a simulator drives, the server has where the simulator says it is.
//!
//! Proved in virtual time: a member drives avatars over pretended links, and one that hears every state of every tick
//! tells where the server had them. At each tick of which the server knew all, they were within the tolerance.

use std::collections::VecDeque;

use rhumb_protocol::message::{DriveError, StreamChoice};
use rhumb_protocol::scene::{Command, CommandError, Pace};
use rhumb_protocol::session::Misuse;
use rhumb_protocol::{Ending, Span};
use rhumb_reckoning::{BodyId, Divergence, Metres, Motion, Tick, Ticks, Tolerance, Verbatim};
use rhumb_server::DriveStatistics;
use rhumb_tests::{Avatars, COMMANDER, Stage, TICK, seed};
use rhumb_transport::{Direction, Lane, LinkTerms};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
/// How closely the server is to know where avatars are.
const CLOSE: Tolerance = Tolerance::FINE;
/// The bounding radius of an avatar.
const RADIUS: Metres = Metres::new(0.8);
/// What rounding to the engine's f32 may add to a tolerance, as a share of it.
const ROUNDING: f64 = 0.001;

/// A scene in which the commander drives avatars, and somebody sees every state of every tick.
struct Walk {
    stage: Stage,
    avatars: u32,
    watcher: usize,
    lead: u64,
    /// What was said of each tick that the session took.
    said: Vec<(Tick, Vec<(BodyId, Verbatim)>)>,
    /// Where the server had the avatars, of ticks that are not vouched for yet.
    seen: VecDeque<(Tick, Vec<Motion>)>,
    noted: Tick,
    /// How many body-ticks were judged, and the greatest share of the tolerance.
    judged: u64,
    worst: f64,
}

impl Walk {
    fn new(pace: Pace, avatars: u32, lead: u64, seed: u64) -> Self {
        let script = Box::new(Avatars(avatars));
        let mut stage = Stage::new(script, pace, NORMAL, LinkTerms::PERFECT, seed);
        let watcher = stage.enter(StreamChoice::Full);
        stage.command(&[]);
        stage.run(TICK);
        let mut walk = Self {
            stage,
            avatars,
            watcher,
            lead,
            said: Vec::new(),
            seen: VecDeque::new(),
            noted: Tick::ZERO,
            judged: 0,
            worst: 0.0,
        };
        let ids = walk.ids();
        assert_eq!(walk.drive(&ids), Ok(ids));
        walk
    }

    fn ids(&self) -> Vec<BodyId> {
        (0..self.avatars).map(Avatars::id).collect()
    }

    /// The commander asks to drive, and waits for the answer.
    fn drive(&mut self, ids: &[BodyId]) -> Result<Vec<BodyId>, DriveError> {
        drive(&mut self.stage, COMMANDER, ids)
    }

    /// Terms of the commander's link alone.
    fn over(&mut self, terms: &str) {
        let terms: LinkTerms = terms.parse().expect("the tests write links well");
        for direction in [Direction::Up, Direction::Down] {
            self.stage.arena.set_terms_of(COMMANDER, direction, terms);
        }
    }

    fn newest(&self) -> Tick {
        self.stage.copy(self.watcher).stream().complete()
    }

    fn statistics(&self) -> Option<DriveStatistics> {
        let scene = "stage".parse().expect("a scene's name");
        let mut drives = self.stage.arena.server().drives(&scene);
        drives.find(|drive| drive.driver == rhumb_protocol::Peer(0))
    }

    /// The simulator's frame: says where the avatars are at a tick.
    fn say(&mut self, tick: Tick) {
        let motions: Vec<(BodyId, Verbatim)> = (0..self.avatars)
            .map(|place| (Avatars::id(place), Avatars::walk(place, tick)))
            .collect();
        let session = self.stage.arena.client_mut(COMMANDER);
        if session
            .publish(tick, &motions)
            .expect("the commander drives")
        {
            self.said.push((tick, motions));
        }
    }

    /// A frame of a free-running scene, and a tick's time.
    fn frame(&mut self) {
        let present = self.newest() + Ticks::new(self.lead as u32);
        self.say(present);
        for _ in 0..4 {
            self.stage.run(Span::from_nanos(TICK.as_nanos() / 4));
            self.judge();
        }
    }

    /// Where the server had a body at the newest tick.
    fn at(&self, id: BodyId) -> Motion {
        let stream = self.stage.copy(self.watcher).stream();
        stream
            .believed(id, stream.complete())
            .expect("a body of the scene")
    }

    /// Notes where the avatars are, and holds what was noted against what was said once it is known what was.
    fn judge(&mut self) {
        let (newest, avatars) = (self.newest(), self.ids());
        if newest > self.noted {
            self.noted = newest;
            let motions = avatars.iter().map(|id| self.at(*id)).collect();
            self.seen.push_back((newest, motions));
        }
        let Some(drive) = self.statistics() else {
            return;
        };
        while let Some((tick, motions)) = self.seen.pop_front_if(|(tick, _)| *tick <= drive.vouched)
        {
            let said = self.said.iter().rev().find(|(of, _)| *of == tick);
            if let Some((_, said)) = said.filter(|_| drive.knew(tick)) {
                for ((id, said), had) in said.clone().iter().zip(&motions) {
                    self.hold(*id, tick, said, had);
                }
            }
        }
    }

    fn hold(&mut self, id: BodyId, tick: Tick, said: &Verbatim, had: &Motion) {
        let apart = Divergence::between(&said.motion().pose(), &had.pose());
        let share = CLOSE.share(&apart, RADIUS);
        assert!(
            share <= 1.0 + ROUNDING,
            "{id} is off by {share} tolerances at {tick}"
        );
        self.judged += 1;
        self.worst = self.worst.max(share);
    }

    fn bytes_up(&self) -> u64 {
        let lanes = [Lane::Control, Lane::State];
        let count = |lane| {
            self.stage
                .arena
                .counts(COMMANDER, Direction::Up, lane)
                .pushed
                .bytes
        };
        lanes.into_iter().map(count).sum()
    }
}

/// A member asks to drive, and waits for the answer.
fn drive(stage: &mut Stage, member: usize, ids: &[BodyId]) -> Result<Vec<BodyId>, DriveError> {
    let answers = stage.witnesses[member].drives.len();
    let session = stage.arena.client_mut(member);
    session.drive(CLOSE, ids).expect("a member may ask");
    stage.run_until_or(Span::from_millis(60_000), |stage| {
        stage.witnesses[member].drives.len() > answers
    });
    stage.witnesses[member].drives[answers].clone()
}

fn put(id: BodyId) -> Command {
    Command::SetPose {
        id,
        position: glam::Vec3::new(0.0, 5.0, 0.0),
        rotation: glam::Quat::IDENTITY,
    }
}

/// Over links that spoil what they can: what the server knew in time was right, and little came late.
fn survives(terms: &str, lead: u64, late: f64, seed: u64) {
    let mut walk = Walk::new(Pace::FreeRunning, 3, lead, seed);
    walk.over(terms);
    for _ in 0..900 {
        walk.frame();
    }
    let drive = walk.statistics().expect("the commander drives");
    let share = drive.late_steps as f64 / drive.steps as f64;
    assert!(
        share <= late,
        "{terms}, seed {seed}: {share} of the steps were late"
    );
    assert!(walk.judged > 1_000, "{terms}: {} were judged", walk.judged);
    assert!(walk.worst > 0.3, "{terms}: nothing was reckoned");
    assert_eq!((drive.heard.malformed, drive.refused), (0, 0));
    assert_eq!(drive.heard.mismatches, 0);
    walk.over("");
    for _ in 0..120 {
        walk.frame();
    }
    let (before, judged) = (walk.statistics().expect("it still drives"), walk.judged);
    for _ in 0..60 {
        walk.frame();
    }
    let after = walk.statistics().expect("it still drives");
    assert_eq!(after.late_steps, before.late_steps, "{terms}, seed {seed}");
    assert!(walk.judged > judged + 100);
}

#[test]
fn what_the_server_knows_of_an_avatar_is_within_the_tolerance_over_any_link() {
    for (terms, lead, known) in [
        ("", 1, 0.0),
        ("rtt=60ms", 3, 0.02),
        ("rtt=60ms,jitter=30ms", 6, 0.1),
        ("rtt=100ms,loss=5%", 14, 0.2),
        ("rtt=40ms,loss=20%,jitter=10ms,reorder=10%,dup=10%", 14, 0.9),
        ("rtt=100ms,loss=5%,burst=6,jitter=20ms", 16, 0.4),
    ] {
        survives(terms, lead, known, seed(21));
    }
}

#[test]
fn without_a_lead_the_server_predicts_over_the_way() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 0, 1);
    walk.over("rtt=100ms");
    let mut worst: f64 = 0.0;
    for frame in 0..200 {
        walk.frame();
        // Walks from its second 4 to 6 are interrupted by a rest; until then the course is even.
        if frame > 30 && walk.newest() < Tick::new(230) {
            let truth = Avatars::walk(0, walk.newest()).motion().pose();
            let apart = Divergence::between(&truth, &walk.at(Avatars::id(0)).pose());
            worst = worst.max(apart.position.metres());
        }
    }
    assert!(worst > 0.0 && worst < 0.1, "off by {worst} m");
    let drive = walk.statistics().expect("it drives");
    assert!(drive.late_steps > 10, "{drive:?}");
}

#[test]
fn a_still_avatar_costs_nothing_but_vouching() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    let stands = Avatars::walk(0, Tick::ZERO).stilled();
    let stand = |walk: &mut Walk, frames| {
        let before = walk.bytes_up();
        for _ in 0..frames {
            let tick = walk.newest() + Ticks::new(2);
            let session = walk.stage.arena.client_mut(COMMANDER);
            session
                .publish(tick, &[(id, stands)])
                .expect("the commander drives");
            walk.stage.run(TICK);
        }
        walk.bytes_up() - before
    };
    stand(&mut walk, 600);
    let upstream = walk
        .stage
        .arena
        .client(COMMANDER)
        .upstream()
        .expect("it drives");
    let bytes = stand(&mut walk, 3_000);
    let after = walk
        .stage
        .arena
        .client(COMMANDER)
        .upstream()
        .expect("it drives");
    assert_eq!(after, upstream, "something was said of a body that stands");
    // Twenty vouches of eight bytes or so in fifty seconds, and what looks at the clock.
    assert!(bytes < 400, "{bytes} bytes in fifty seconds");
}

#[test]
fn a_walking_avatar_costs_a_fraction_of_what_commands_cost() {
    let frames = 1_200;
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    let before = walk.bytes_up();
    for _ in 0..frames {
        walk.frame();
    }
    let driven = walk.bytes_up() - before;
    let id = Avatars::id(0);
    assert_eq!(walk.drive(&[]), Ok(vec![]));
    let before = walk.bytes_up();
    for _ in 0..frames {
        let pose = Avatars::walk(0, walk.newest()).motion().pose();
        let command = Command::SetPose {
            id,
            position: pose.position.as_vec3(),
            rotation: pose.rotation.as_quat(),
        };
        walk.stage.command(&[command]);
        walk.stage.run(TICK);
    }
    let commanded = walk.bytes_up() - before;
    println!("{frames} frames of a walk: {driven} bytes driven, {commanded} commanded");
    assert!(driven * 10 < commanded, "{driven} and {commanded} bytes");
}

#[test]
fn in_lockstep_every_step_knows_what_was_said_for_it() {
    let digest = |terms: &str, seed| {
        let mut walk = Walk::new(Pace::Lockstep, 2, 0, seed);
        walk.over(terms);
        for _ in 0..400 {
            let tick = walk.newest().next();
            walk.say(tick);
            walk.stage.advance(COMMANDER);
            walk.stage.run_until_or(Span::from_millis(1_000), |stage| {
                stage.copy(walk.watcher).stream().complete() >= tick
            });
            for (id, said) in walk.said.last().expect("it was said").1.clone() {
                walk.hold(id, tick, &said, &walk.at(id));
            }
        }
        let statistics = walk.statistics().expect("the commander drives");
        assert_eq!((statistics.late_steps, statistics.steps), (0, 400));
        let session = walk.stage.arena.client_mut(COMMANDER);
        session.inspect().expect("a member may ask");
        walk.stage.run(Span::from_millis(2_000));
        walk.stage.witnesses[COMMANDER].inspections[0].truth
    };
    let truth = digest("", 1);
    assert_eq!(digest("", 2), truth);
    assert_eq!(digest("rtt=30ms,loss=20%,dup=10%,reorder=10%", 3), truth);
}

#[test]
fn who_may_not_drive_is_told_why_and_drives_on_what_it_drove() {
    let mut walk = Walk::new(Pace::FreeRunning, 2, 2, 1);
    let (one, other) = (Avatars::id(0), Avatars::id(1));
    for (ids, why) in [
        (
            vec![one, Avatars::floor()],
            DriveError::NotKinematic(Avatars::floor()),
        ),
        (
            vec![Avatars::freight()],
            DriveError::NotKinematic(Avatars::freight()),
        ),
        (
            vec![BodyId::new(77, 0)],
            DriveError::UnknownBody(BodyId::new(77, 0)),
        ),
        (
            vec![BodyId::new(4, 1)],
            DriveError::UnknownBody(BodyId::new(4, 1)),
        ),
    ] {
        assert_eq!(walk.drive(&ids), Err(why));
    }
    walk.frame();
    let guest = walk.stage.enter(NORMAL);
    assert_eq!(
        drive(&mut walk.stage, guest, &[one]),
        Err(DriveError::NotYours(one))
    );
    // What is not granted to anybody any more may be driven by whoever comes first.
    walk.stage
        .arena
        .client_mut(COMMANDER)
        .leave()
        .expect("it is a member");
    walk.stage.run(TICK);
    assert_eq!(drive(&mut walk.stage, guest, &[one]), Ok(vec![one]));
    walk.stage.join(COMMANDER, NORMAL);
    let taken = walk.drive(&[one, other]);
    assert_eq!(taken, Err(DriveError::DrivenByAnother(one)));
    assert_eq!(walk.drive(&[other]), Ok(vec![other]));
    let session = walk.stage.arena.client_mut(COMMANDER);
    let tick = Tick::new(1_000);
    let foreign = session.publish(tick, &[(one, Avatars::walk(0, tick))]);
    assert_eq!(foreign, Err(Misuse::NotDriven(one)));
    let many: Vec<BodyId> = (0..257).map(|index| BodyId::new(index, 0)).collect();
    assert_eq!(session.drive(CLOSE, &many), Err(Misuse::TooManyDriven(257)));
}

#[test]
fn what_is_driven_takes_no_commands_and_what_is_no_longer_does() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    let guest = walk.stage.enter(NORMAL);
    let velocity = Command::SetVelocity {
        id,
        linear: glam::Vec3::X,
        angular: glam::Vec3::ZERO,
    };
    for command in [put(id), velocity] {
        walk.stage
            .arena
            .client_mut(guest)
            .command(command)
            .expect("a member may ask");
    }
    for _ in 0..100 {
        walk.frame();
    }
    let driven = Err(CommandError::Driven(id));
    let refused = &walk.stage.witnesses[guest].refused;
    assert_eq!(
        refused
            .iter()
            .map(|(_, error)| Err::<(), _>(*error))
            .collect::<Vec<_>>(),
        [driven; 2]
    );
    assert!(walk.judged > 50);
    assert_eq!(walk.drive(&[]), Ok(vec![]));
    let before = walk.at(id);
    walk.stage.run(Span::from_millis(500));
    let apart = Divergence::between(&before.pose(), &walk.at(id).pose());
    assert!(apart.position.metres() < 0.05, "it goes on by {apart:?}");
    walk.stage
        .arena
        .client_mut(guest)
        .command(put(id))
        .expect("a member may ask");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.stage.witnesses[guest].refused.len(), 2);
    assert!((walk.at(id).pose().position.y - 5.0).abs() < 1e-6);
}

#[test]
fn a_body_that_is_removed_is_driven_no_longer_and_its_index_may_come_again() {
    let mut walk = Walk::new(Pace::FreeRunning, 2, 2, 1);
    walk.over("rtt=80ms,loss=10%");
    let (gone, stays) = (Avatars::id(0), Avatars::id(1));
    for _ in 0..60 {
        walk.frame();
    }
    let guest = walk.stage.enter(NORMAL);
    let remove = Command::RemoveBody { id: gone };
    walk.stage
        .arena
        .client_mut(guest)
        .command(remove)
        .expect("a member may ask");
    for _ in 0..90 {
        let tick = walk.newest() + Ticks::new(6);
        let session = walk.stage.arena.client_mut(COMMANDER);
        let known: Vec<BodyId> = session.driven().collect();
        let motions = [(0, gone), (1, stays)];
        let motions = motions.into_iter().filter(|(_, id)| known.contains(id));
        let motions: Vec<_> = motions
            .map(|(place, id)| (id, Avatars::walk(place, tick)))
            .collect();
        session.publish(tick, &motions).expect("they are driven");
        walk.stage.run(TICK);
    }
    assert_eq!(
        walk.stage
            .arena
            .client(COMMANDER)
            .driven()
            .collect::<Vec<_>>(),
        [stays]
    );
    let drive = walk.statistics().expect("one is left");
    assert_eq!((drive.bodies, drive.heard.mismatches), (1, 0));
    let terms = *walk.stage.copy(COMMANDER).body(stays).expect("it is there");
    let again = BodyId::new(gone.index(), 1);
    let terms = rhumb_protocol::scene::BodyTerms { id: again, ..terms };
    let motion = Avatars::walk(0, Tick::ZERO).stilled();
    walk.stage.command(&[Command::AddBody { terms, motion }]);
    walk.stage.run(Span::from_millis(300));
    assert_eq!(walk.drive(&[again, stays]), Ok(vec![again, stays]));
    walk.stage
        .arena
        .client_mut(guest)
        .delete()
        .expect("anybody may");
    walk.stage.run(Span::from_millis(500));
    assert_eq!(walk.stage.arena.client(COMMANDER).driven().count(), 0);
    assert_eq!(walk.stage.witnesses[COMMANDER].ended, None);
}

#[test]
fn a_silent_drivers_bodies_stand_still_and_go_on_when_it_is_heard_again() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    for _ in 0..60 {
        walk.frame();
    }
    let last = walk.newest();
    // Silent since a few ticks: it is trusted for a second and as many ticks.
    walk.stage.run(Span::from_millis(3_000));
    let stood = walk.at(Avatars::id(0));
    let way = f64::from(WALKED_METRES_IN_TWO_SECONDS);
    let from = Avatars::walk(0, last).motion().pose().position;
    assert!(stood.pose().position.distance(from) < way, "it flew on");
    assert!(stood.twist().linear.length() < 1e-3, "{stood:?}");
    walk.stage.run(Span::from_millis(3_000));
    assert_eq!(walk.at(Avatars::id(0)).pose(), stood.pose());
    let judged = walk.judged;
    for _ in 0..60 {
        walk.frame();
    }
    assert!(walk.judged > judged + 30);
}

/// At 1.4 m/s.
const WALKED_METRES_IN_TWO_SECONDS: f32 = 2.8;

#[test]
fn a_driver_that_paused_for_minutes_begins_anew_by_itself() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    for _ in 0..60 {
        walk.frame();
    }
    walk.stage.run(Span::from_millis(70_000));
    let judged = walk.judged;
    for _ in 0..120 {
        walk.frame();
    }
    assert!(walk.judged > judged + 60);
    assert_eq!(walk.stage.witnesses[COMMANDER].drives.len(), 2);
}

#[test]
fn who_leaves_or_breaks_off_drives_nothing_any_more() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 2, 1);
    let id = Avatars::id(0);
    for _ in 0..60 {
        walk.frame();
    }
    walk.stage
        .arena
        .client_mut(COMMANDER)
        .leave()
        .expect("it is a member");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.statistics(), None);
    let stood = walk.at(id);
    walk.stage.run(Span::from_millis(1_000));
    assert_eq!(walk.at(id).pose(), stood.pose());
    walk.stage.join(COMMANDER, NORMAL);
    assert_eq!(walk.drive(&[id]), Ok(vec![id]));
    walk.said.clear();
    let judged = walk.judged;
    for _ in 0..60 {
        walk.frame();
    }
    assert!(walk.judged > judged + 30);
    walk.stage.arena.sever(COMMANDER, Ending::TimedOut);
    walk.stage.run(Span::from_millis(100));
    assert_eq!(walk.statistics(), None);
}

#[test]
fn what_lies_on_a_driven_platform_is_carried_and_sleeps_when_that_stands() {
    let mut walk = Walk::new(Pace::Lockstep, 0, 0, 1);
    let (platform, freight) = (Avatars::platform(), Avatars::freight());
    assert_eq!(walk.drive(&[platform]), Ok(vec![platform]));
    let start = Avatars::berth().position();
    let way = |tick: u64| {
        let moved = tick.clamp(60, 180) - 60;
        let speed = if (60..180).contains(&tick) { 0.5 } else { 0.0 };
        let position = [start[0] + moved as f32 / 120.0, start[1], start[2]];
        Verbatim::new(position, [0.0, 0.0, 0.0, 1.0], [speed, 0.0, 0.0], [0.0; 3]).expect("a place")
    };
    for tick in 1..=400 {
        let session = walk.stage.arena.client_mut(COMMANDER);
        session
            .publish(Tick::new(tick), &[(platform, way(tick))])
            .expect("it drives");
        walk.stage.advance(COMMANDER);
    }
    let carried = walk.at(freight).pose().position;
    assert!((carried.x - 1.0).abs() < 0.1, "the freight is at {carried}");
    let moved = walk.at(platform).pose().position;
    // What stands for a second is there to the bit, as far as the engine has it.
    assert!((moved.x - 1.0).abs() < 1e-6, "the platform is at {moved}");
    let session = walk.stage.arena.client_mut(COMMANDER);
    session.inspect().expect("a member may ask");
    walk.stage.run(TICK);
    let inspection = walk.stage.witnesses[COMMANDER].inspections[0];
    // All but the one that turns.
    assert_eq!(inspection.awake, 1);
}

#[test]
fn a_driver_goes_on_while_its_own_copy_changes_streams() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 8, seed(22));
    walk.over("rtt=80ms,loss=3%");
    for choice in [
        StreamChoice::Within(Tolerance::EXACT),
        StreamChoice::Full,
        NORMAL,
    ] {
        let session = walk.stage.arena.client_mut(COMMANDER);
        session
            .follow(choice)
            .expect("no other change is asked for");
        for _ in 0..120 {
            walk.frame();
        }
        assert_eq!(walk.stage.copy(COMMANDER).choice(), choice);
    }
    assert!(walk.judged > 200, "{} were judged", walk.judged);
    assert_eq!(walk.stage.witnesses[COMMANDER].drives.len(), 1);
}

#[test]
fn each_of_two_drivers_moves_its_own_and_sees_the_others() {
    let mut walk = Walk::new(Pace::FreeRunning, 1, 4, seed(23));
    let guest = walk.stage.enter(NORMAL);
    let granted = walk.stage.witnesses[guest].granted.expect("it is a member");
    let id = granted.id(0).expect("it was granted some");
    let mut terms = *walk
        .stage
        .copy(guest)
        .body(Avatars::id(0))
        .expect("it is there");
    terms.id = id;
    // The same walk, from elsewhere and with other rests.
    let at = |tick| Avatars::walk(3, tick);
    let motion = at(Tick::ZERO).stilled();
    let add = Command::AddBody { terms, motion };
    walk.stage
        .arena
        .client_mut(guest)
        .command(add)
        .expect("it is a member");
    walk.stage.run(Span::from_millis(100));
    assert_eq!(drive(&mut walk.stage, guest, &[id]), Ok(vec![id]));
    let links: LinkTerms = "rtt=50ms,loss=5%"
        .parse()
        .expect("the tests write links well");
    walk.stage.arena.set_terms(links);
    walk.stage
        .arena
        .set_terms_of(walk.watcher, Direction::Down, LinkTerms::PERFECT);
    let mut worst: f64 = 0.0;
    for frame in 0..400 {
        let tick = walk.newest() + Ticks::new(4);
        let session = walk.stage.arena.client_mut(guest);
        session.publish(tick, &[(id, at(tick))]).expect("it drives");
        walk.frame();
        if frame > 30 {
            let copy = walk.stage.copy(COMMANDER).stream();
            let seen = copy.believed(id, copy.complete()).expect("it is there");
            let said = at(copy.complete()).motion();
            worst = worst.max(seen.pose().position.distance(said.pose().position));
        }
    }
    // Two tolerances and what a lost packet may cost for a round trip or two.
    assert!(worst < 0.5, "off by {worst} m");
    assert!(walk.judged > 200, "{} were judged", walk.judged);
    let scene = "stage".parse().expect("a scene's name");
    assert_eq!(walk.stage.arena.server().drives(&scene).count(), 2);
}
