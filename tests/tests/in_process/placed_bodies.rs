//! A body that a command places is shown at one of its places, at any time.
//!
//! Members with other delays look on over links of their own, some with loss: no frame shows a body on a way between its
//! places, nor beyond them, whether it moves or stands, and whatever else of it changes at the same tick.

use glam::{Quat, Vec3};
use rhumb_protocol::Span;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, ShapeId, Stepping};
use rhumb_reckoning::{BodyId, Divergence, Metres, Pose, Seconds, Tick, Twist};
use rhumb_tests::{COMMANDER, Dice, TICK, seed};
use rhumb_view::{RenderTime, ViewOptions};

use crate::shown_poses::{OPTIONS, Shown, Truth, Watcher, World, state};

#[test]
fn a_body_that_is_placed_elsewhere_is_shown_at_one_of_its_places_at_any_time() {
    for (smooth, seed) in [(true, seed(1)), (false, 2)] {
        let mut world = World::new(Stepping::FreeRunning, "rtt=40ms", seed);
        let kinds = [BodyKind::Dynamic, BodyKind::Kinematic];
        let bodies =
            kinds.map(|kind| BodyDesc::plain(world.ids.pop().expect("an id"), kind, ShapeId(0)));
        // The dynamic one lies on the floor.
        let place = |desc: &BodyDesc, x: f32| match desc.kind {
            BodyKind::Dynamic => Vec3::new(x, -0.1, 0.0),
            _ => Vec3::new(x, 9.0, 0.0),
        };
        let added = bodies.map(|desc| Command::AddBody {
            desc,
            motion: state(place(&desc, -20.0), Vec3::ZERO, Vec3::ZERO),
        });
        world.send(&added);
        world.stage.run(Span::from_millis(300));
        let options = ViewOptions {
            smooth,
            ..OPTIONS[0]
        };
        let mut watcher = Watcher::enter(&mut world.stage, options);
        world.stage.run(Span::from_millis(500));
        for (x, ticks) in [
            (20.0, 30),
            (-20.0, 30),
            (20.0, 6),
            (-20.0, 90),
            (20.0, 1),
            (-20.0, 30),
        ] {
            let moved = bodies.map(|desc| Command::SetPose {
                id: desc.id,
                position: place(&desc, x),
                rotation: Quat::IDENTITY,
            });
            world.send(&moved);
            for _ in 0..ticks * 5 {
                world
                    .stage
                    .run(Span::from_nanos(TICK.as_nanos() / 5 + 1_000));
                watcher.frame(&mut world.stage);
            }
        }
        let moves = |shown: &&Shown| bodies.iter().any(|desc| desc.id == shown.id);
        let shown: Vec<_> = watcher.shown.iter().filter(moves).collect();
        assert!(shown.iter().any(|shown| shown.position.x > 19.0));
        for shown in shown {
            let off = (shown.position.x.abs() - 20.0).abs();
            assert!(
                off <= 0.051,
                "smooth {smooth}: {} at {:?}",
                shown.position,
                shown.at
            );
        }
    }
}

/// A body that moves along x, and is placed aside along z.
struct Passing {
    desc: BodyDesc,
    speed: f32,
    /// Its row: the height, which it keeps.
    y: f32,
    z: f32,
}

/// Metres within which a body counts as at its place: the tolerance, and what an update may round.
const NEAR: f32 = 0.06;

/// Metres aside at which a body is placed.
const ASIDE: f32 = 0.8;

impl Passing {
    /// The command that places it aside where it is now.
    fn place(&mut self, world: &mut World, ahead: f64) -> Vec<Command> {
        self.z = ASIDE - self.z;
        let stream = world.stage.copy(COMMANDER).stream();
        let at = stream.predicted_motion(self.desc.id, stream.watermark_tick());
        let x = at.expect("a body").pose().position.x + f64::from(self.speed) * ahead / 60.0;
        vec![Command::SetPose {
            id: self.desc.id,
            position: Vec3::new(x as f32, self.y, self.z),
            rotation: Quat::IDENTITY,
        }]
    }

    /// The commands after which it moves as before, at times as another kind and shape: one of another kind, and a
    /// kinematic one, stands where it was placed.
    fn move_on(&mut self, world: &mut World) -> Vec<Command> {
        let mut commands = Vec::new();
        if world.dice.below(3) == 0 {
            self.desc.kind = [BodyKind::Dynamic, BodyKind::Kinematic][world.dice.below(2)];
            self.desc.shape = ShapeId(world.dice.below(3) as u32);
            commands.push(Command::ChangeBody { desc: self.desc });
        }
        commands.push(Command::SetVelocity {
            id: self.desc.id,
            linear: Vec3::X * self.speed,
            angular: Vec3::ZERO,
        });
        commands
    }
}

/// Checks that a watcher saw no body between its places, and none farther beyond them than `most` metres.
fn check_places(watcher: &Watcher, bodies: &[Passing], most: f32, what: &str) {
    let (mut between, mut shown) = (0_u32, 0_u32);
    let mut beyond: f32 = 0.0;
    for body in bodies {
        let of_body = |shown: &&Shown| shown.id == body.desc.id;
        for pose in watcher.shown.iter().filter(of_body) {
            let z = pose.position.z;
            shown += 1;
            between += u32::from((NEAR..ASIDE - NEAR).contains(&z));
            beyond = beyond.max(-z).max(z - ASIDE);
        }
    }
    assert!(shown > 10_000);
    assert_eq!(between, 0, "{what}: of {shown}");
    assert!(beyond < most, "{what}: {beyond} m beyond");
}

#[test]
fn a_moving_body_that_is_placed_aside_is_shown_at_one_of_its_places_at_any_time() {
    for (links, seed) in [
        ("rtt=2ms", 2),
        ("rtt=40ms", seed(1)),
        ("rtt=80ms,jitter=10ms,loss=5%", 3),
    ] {
        let mut world = World::new(Stepping::FreeRunning, links, seed);
        let mut bodies = Vec::new();
        for (row, speed) in (0_u8..).zip([0.0, 3.0, 10.0, 40.0, 0.0, 3.0, 10.0, 40.0]) {
            let kind = [BodyKind::Dynamic, BodyKind::Kinematic][usize::from(row / 4)];
            let mut desc = BodyDesc::plain(world.ids.pop().expect("an id"), kind, ShapeId(0));
            desc.gravity_scale = 0.0;
            let y = 9.0 + 4.0 * f32::from(row);
            let motion = state(Vec3::Y * y, Vec3::X * speed, Vec3::ZERO);
            world.send(&[Command::AddBody { desc, motion }]);
            bodies.push(Passing {
                desc,
                speed,
                y,
                z: 0.0,
            });
        }
        world.stage.run(Span::from_millis(300));
        let mut watchers: Vec<_> = OPTIONS
            .into_iter()
            .map(|options| Watcher::enter(&mut world.stage, options))
            .collect();
        world.stage.run(Span::from_millis(500));
        for _ in 0..25 {
            let ahead = world.dice.below(5) as f64;
            for body in &mut bodies {
                let commands = body.place(&mut world, ahead);
                world.send(&commands);
            }
            // Commands that a loss has delayed come close together, but never without a velocity between two poses.
            let ticks = 17 + world.dice.below(9);
            for tick in 0..ticks {
                if tick == 4 {
                    for body in &mut bodies {
                        let commands = body.move_on(&mut world);
                        world.send(&commands);
                    }
                }
                for _ in 0..3 {
                    world
                        .stage
                        .run(Span::from_nanos(TICK.as_nanos() / 3 + 1_000));
                    for watcher in &mut watchers {
                        watcher.frame(&mut world.stage);
                    }
                }
            }
        }
        for (watcher, options) in watchers.iter().zip(OPTIONS) {
            let what = format!("{links}, seed {seed}, {options:?}");
            // Without a delay, a body is led on by an update whose successor is lost or not here yet.
            let leads = links.contains("loss") && options.delay_ticks == 0.0;
            let most = if leads { 0.25 } else { 0.05 };
            check_places(watcher, &bodies, most, &what);
        }
    }
}

/// A body that commands place far away, and how it moves from there.
struct Jumping {
    id: BodyId,
    kind: BodyKind,
    order: Order,
    place: Vec3,
    angle: f32,
    linear: Vec3,
    angular: Vec3,
    legs: Vec<Leg>,
}

/// The commands beside a pose.
#[derive(Clone, Copy, Debug)]
enum Order {
    PoseAlone,
    PoseThenVelocity,
    VelocityThenPose,
}

/// A motion that begins where a command placed the body.
struct Leg {
    begin: Pose,
    twist: Twist,
}

const ORDERS: [Order; 3] = [
    Order::PoseAlone,
    Order::PoseThenVelocity,
    Order::VelocityThenPose,
];

/// Ticks for which news of a jump may be on its way, with its repair.
const LATEST: f64 = 60.0;

/// The radius of the bodies, metres.
const RADIUS: f64 = 0.4;

impl Jumping {
    fn new(id: BodyId, kind: BodyKind, order: Order) -> Self {
        Self {
            id,
            kind,
            order,
            place: Vec3::ZERO,
            angle: 0.0,
            linear: Vec3::X * 6.0,
            angular: Vec3::ZERO,
            legs: Vec::new(),
        }
    }

    /// The commands of its next jump, by 20 m and more, or by a third of a turn.
    fn jump(&mut self, dice: &mut Dice, row: f32) -> Vec<Command> {
        let mut number = |most: f32| (dice.below(2_001) as f32 / 1_000.0 - 1.0) * most;
        let x = (30.0 + number(10.0)) * -self.place.x.signum();
        self.angle += 2.5 + number(0.4);
        let position = Vec3::new(x, row, number(3.0));
        // No two places are equal, so that each is found in the truth.
        self.place = position;
        let rotation = Quat::from_rotation_y(self.angle);
        let (linear, angular) = (Vec3::new(number(12.0), 0.0, 6.0), Vec3::Y * number(8.0));
        let pose = Command::SetPose {
            id: self.id,
            position,
            rotation,
        };
        let velocity = Command::SetVelocity {
            id: self.id,
            linear,
            angular,
        };
        let stands = self.kind == BodyKind::Kinematic;
        (self.linear, self.angular) = match self.order {
            Order::PoseThenVelocity => (linear, angular),
            _ if stands => (Vec3::ZERO, Vec3::ZERO),
            Order::VelocityThenPose => (linear, angular),
            Order::PoseAlone => (self.linear, self.angular),
        };
        let pose_f64 = Pose {
            position: position.as_dvec3(),
            rotation: rotation.as_dquat(),
        };
        self.legs.push(Leg {
            begin: pose_f64,
            twist: Twist {
                linear: self.linear.as_dvec3(),
                angular: self.angular.as_dvec3(),
            },
        });
        match self.order {
            Order::PoseAlone => vec![pose],
            Order::PoseThenVelocity => vec![pose, velocity],
            Order::VelocityThenPose => vec![velocity, pose],
        }
    }

    /// Its legs and the ticks at which they are first seen. Of two commands that came before one tick the truth has the later
    /// one.
    fn begun(&self, truth: &Truth) -> Vec<(f64, &Leg)> {
        let lead = self.lead();
        let (mut from, mut begun) = (0, Vec::new());
        for leg in &self.legs {
            let there = leg.at(lead);
            let ticks = from..truth.ticks();
            let poses = ticks.filter_map(|tick| Some((tick, truth.at(tick, self.id)?.0)));
            let mut poses = poses.skip_while(|(_, pose)| off(&there, pose) > 0.01);
            if let Some((tick, _)) = poses.next() {
                begun.push((tick as f64, leg));
                from = tick;
            }
        }
        begun
    }

    /// Ticks that it has moved by the first one at which it is seen.
    fn lead(&self) -> f64 {
        f64::from(u8::from(self.kind == BodyKind::Dynamic))
    }
}

impl Leg {
    fn at(&self, ticks: f64) -> Pose {
        let seconds = ticks / 60.0;
        Pose {
            position: self.begin.position + self.twist.linear * seconds,
            rotation: self.twist.turn_over(Seconds::new(seconds)) * self.begin.rotation,
        }
    }
}

fn off(one: &Pose, other: &Pose) -> f64 {
    let apart = Divergence::between(one, other);
    apart.surface_error(Metres::new(RADIUS)).metres()
}

/// The farthest that a body was shown from all motions that it had by its moment, back to `window` ticks before.
fn farthest(watcher: &Watcher, truth: &Truth, body: &Jumping, window: f64) -> (f64, RenderTime) {
    let begun = body.begun(truth);
    assert!(begun.len() > 25, "{} legs", begun.len());
    let ends = || begun.iter().skip(1).map(|(begin, _)| *begin);
    let of_body = |shown: &&Shown| shown.id == body.id;
    let mut worst = (0.0, RenderTime::at(Tick::ZERO));
    for shown in watcher.shown.iter().filter(of_body) {
        let at = shown.at.ticks();
        // Its motion before the first leg is none of these.
        if at <= begun[0].0 + LATEST {
            continue;
        }
        let seen = Pose {
            position: shown.position.as_dvec3(),
            rotation: shown.rotation.as_dquat(),
        };
        let legs = begun.iter().zip(ends().chain([f64::INFINITY]));
        let near = legs
            .filter(|((begin, _), end)| *begin <= at && *end > at - window)
            .map(|((begin, leg), end)| {
                let off_at = |at: f64| off(&leg.at(at - begin + body.lead()), &seen);
                // In the tick of a jump a body stands where the tick began.
                let stood = if end > at.ceil() {
                    f64::INFINITY
                } else {
                    off_at(at.floor())
                };
                off_at(at).min(stood)
            })
            .fold(f64::INFINITY, f64::min);
        if near > worst.0 {
            worst = (near, shown.at);
        }
    }
    worst
}

#[test]
fn a_body_that_jumps_with_another_velocity_is_shown_in_one_of_its_motions() {
    let late = OPTIONS.map(|options| ViewOptions {
        smooth: !options.smooth,
        ..options
    });
    let options: Vec<_> = OPTIONS.into_iter().chain(late).collect();
    for (links, seed) in [
        ("rtt=2ms", 2),
        ("rtt=40ms", seed(1)),
        ("rtt=100ms,jitter=10ms", 4),
        ("rtt=80ms,jitter=10ms,loss=5%", 3),
    ] {
        let mut world = World::new(Stepping::FreeRunning, links, seed);
        let mut bodies = Vec::new();
        for kind in [BodyKind::Kinematic, BodyKind::Dynamic] {
            for order in ORDERS {
                let mut desc = BodyDesc::plain(world.ids.pop().expect("an id"), kind, ShapeId(0));
                desc.gravity_scale = 0.0;
                let row = Vec3::Y * (9.0 + 4.0 * bodies.len() as f32);
                let body = Jumping::new(desc.id, kind, order);
                let motion = state(row, body.linear, body.angular);
                world.send(&[Command::AddBody { desc, motion }]);
                bodies.push(body);
            }
        }
        world.stage.run(Span::from_millis(300));
        let mut watchers: Vec<_> = (options.iter())
            .map(|options| Watcher::enter(&mut world.stage, *options))
            .collect();
        world.stage.run(Span::from_millis(500));
        for _ in 0..25 {
            // Several in neighbouring ticks, or one.
            for _ in 0..1 + world.dice.below(4) / 2 {
                for (row, body) in (0_u8..).zip(&mut bodies) {
                    let commands = body.jump(&mut world.dice, 9.0 + 4.0 * f32::from(row));
                    world.send(&commands);
                }
                watch(&mut world, &mut watchers, 1);
            }
            let ticks = 17 + world.dice.below(20);
            watch(&mut world, &mut watchers, ticks);
        }
        world.stage.run(Span::from_millis(1_000));
        let truth = Truth::of(&mut world);
        for (watcher, options) in watchers.iter().zip(&options) {
            for body in &bodies {
                let is_late = options.delay_ticks >= 9.0 && !links.contains("loss");
                let window = if is_late { 0.0 } else { LATEST };
                let (most, at) = farthest(watcher, &truth, body, window);
                let (kind, order) = (body.kind, body.order);
                assert!(
                    most < 2.0 * f64::from(NEAR),
                    "{links}, seed {seed}, {options:?}, {kind:?}, {order:?}: {most} m off at {at:?}"
                );
            }
        }
    }
}

/// Lets the watchers show so many ticks, three frames each.
fn watch(world: &mut World, watchers: &mut [Watcher], ticks: usize) {
    for _ in 0..ticks * 3 {
        world
            .stage
            .run(Span::from_nanos(TICK.as_nanos() / 3 + 1_000));
        for watcher in &mut *watchers {
            watcher.frame(&mut world.stage);
        }
    }
}
