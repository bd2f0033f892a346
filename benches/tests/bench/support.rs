//! A small experiment whose figures can be computed by hand.
//!
//! Four ticks of a tenth of a second: a static floor, a ball that falls throughout, a capsule that falls asleep at
//! tick 2, and a cylinder that is placed at tick 1 and removed at tick 3.

use bytes::Bytes;
use glam::Vec3;
use rhumb_bench::record::{
    Breach, CapturedPacket, Cause, CopiedPose, Experiment, Frame, JoinCost, Load, Mode,
    PacketDirection, Placed, Run, RunConfig, Truth,
};
use rhumb_protocol::scene::{BodyDesc, BodyKind, SceneConfig, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{BodyId, BodyState, Integrator, Rate, Tick};
use rhumb_trace::SceneFacts;

const FLOOR: BodyId = BodyId::new(0, 0);
const BALL: BodyId = BodyId::new(1, 0);
const CAPSULE: BodyId = BodyId::new(2, 3);
const CYLINDER: BodyId = BodyId::new(3, 0);
const TICKS: u32 = 4;
const STEP_S: f64 = 0.1;
const TOLERANCE_M: f64 = 0.05;

const UPRIGHT: [f32; 4] = [0.0, 0.0, 0.0, 1.0];

/// An upright body's state; its velocity must only round-trip.
fn observation(id: BodyId, position: [f32; 3], activity: Activity) -> Observation {
    let motion = BodyState::new(position, UPRIGHT, [0.0, -1.0, 0.0], [0.25, 0.0, -0.0]);
    Observation {
        id,
        motion: motion.expect("the motions of this experiment are finite"),
        activity,
    }
}

fn placed(tick: u64, id: BodyId, kind: BodyKind, shape: Shape, position: [f32; 3]) -> Placed {
    Placed {
        tick: Tick::new(tick),
        desc: BodyDesc::plain(id, kind, ShapeId(id.index())),
        shape,
        observation: observation(id, position, Activity::Awake),
        inertia: None,
    }
}

/// The engine's settings that predictions need, at the rate of the runs.
fn facts() -> SceneFacts {
    let usual = SceneConfig::default();
    SceneFacts {
        integrator: Integrator {
            rate: Rate::new(10, 1).expect("not zero"),
            ..usual.integrator
        },
        ..SceneFacts::of(&usual)
    }
}

/// Position of the ball after a tick.
fn ball_at(tick: u64) -> [f32; 3] {
    [0.0, 10.0 - tick as f32, 0.0]
}

fn truth() -> Truth {
    let floor = Shape::Cuboid {
        half_extents: Vec3::new(50.0, 0.5, 50.0),
    };
    let capsule = Shape::Capsule {
        half_height: 1.0,
        radius: 0.5,
    };
    let cylinder = Shape::Cylinder {
        half_height: 0.75,
        radius: 1.0,
    };
    let mut ticks: Vec<Vec<_>> = (1..=u64::from(TICKS))
        .map(|tick| vec![observation(BALL, ball_at(tick), Activity::Awake)])
        .collect();
    ticks[0].push(observation(CAPSULE, [5.0, 1.6, 0.0], Activity::Awake));
    ticks[1].push(observation(CAPSULE, [5.0, 1.5, 0.0], Activity::Asleep));
    ticks[1].push(observation(CYLINDER, [-5.0, 7.0, 0.0], Activity::Awake));
    ticks[2].push(observation(CYLINDER, [-5.0, 6.0, 0.0], Activity::Awake));
    Truth {
        placed: vec![
            placed(0, FLOOR, BodyKind::Fixed, floor, [0.0, -0.5, 0.0]),
            placed(
                0,
                BALL,
                BodyKind::Dynamic,
                Shape::Ball { radius: 0.5 },
                ball_at(0),
            ),
            placed(0, CAPSULE, BodyKind::Dynamic, capsule, [5.0, 2.0, 0.0]),
            placed(1, CYLINDER, BodyKind::Dynamic, cylinder, [-5.0, 8.0, 0.0]),
        ],
        removed: vec![(Tick::new(3), CYLINDER)],
        ticks,
        digest: 0x0123_4567_89ab_cdef,
    }
}

fn config(mode: Mode) -> RunConfig {
    RunConfig {
        scene: "fall".to_owned(),
        bodies: 3,
        mode,
        depth: 0,
        tolerance_m: (mode == Mode::Rhumb).then_some(TOLERANCE_M),
        budget_bytes_per_second: None,
        link: if mode == Mode::Integrated {
            "none"
        } else {
            "perfect"
        }
        .to_owned(),
        seed: 7,
        step_s: STEP_S,
        ticks: TICKS,
        subscription: None,
        replayed: None,
        limit: None,
    }
}

fn run(mode: Mode, frames: Vec<Frame>) -> Run {
    Run {
        config: config(mode),
        truth_checksum: 0x0123_4567_89ab_cdef,
        frames,
        captured: Vec::new(),
        join: JoinCost::default(),
        breaches: Vec::new(),
        recoveries: Vec::new(),
        step_ns_p50: 1_000_000,
        step_ns_p99: 3_000_000,
        step_ns_total: 4_000_000,
        publish_ns_total: 0,
        mismatches: 0,
    }
}

fn copied_pose(id: BodyId, position: [f32; 3], resting: bool) -> CopiedPose {
    CopiedPose {
        id,
        position,
        rotation: UPRIGHT,
        resting,
    }
}

/// Poses and removals of capsule and cylinder in both remote modes: equal to the truth.
fn bystanders(tick: u64) -> (Vec<CopiedPose>, Vec<BodyId>) {
    match tick {
        1 => (
            vec![copied_pose(CAPSULE, [5.0, 1.6, 0.0], false)],
            Vec::new(),
        ),
        2 => (
            vec![
                copied_pose(CAPSULE, [5.0, 1.5, 0.0], true),
                copied_pose(CYLINDER, [-5.0, 7.0, 0.0], false),
            ],
            Vec::new(),
        ),
        3 => (
            vec![copied_pose(CYLINDER, [-5.0, 6.0, 0.0], false)],
            Vec::new(),
        ),
        _ => (Vec::new(), vec![CYLINDER]),
    }
}

fn integrated() -> Run {
    let frame = |tick| Frame {
        tick: Tick::new(tick),
        frame_ns: tick * 1_000_000,
        ..Frame::default()
    };
    run(Mode::Integrated, (1..=4).map(frame).collect())
}

fn naive() -> Run {
    let frame = |tick| {
        let (mut changed, removed) = bystanders(tick);
        changed.push(copied_pose(BALL, ball_at(tick), false));
        Frame {
            tick: Tick::new(tick),
            frame_ns: 5_000_000,
            wire_bytes_down: 1_000,
            wire_datagrams_down: 1,
            wire_bytes_up: 50,
            wire_datagrams_up: 1,
            updates: 3,
            changed,
            removed,
            errors_m: Vec::new(),
            exact: if tick == 1 || tick == 4 { 2 } else { 3 },
            moving_errors_m: Vec::new(),
        }
    };
    let mut run = run(Mode::Naive, (1..=4).map(frame).collect());
    run.captured = (0..4)
        .map(|frame| {
            CapturedPacket::new(
                frame,
                PacketDirection::StateDown,
                Bytes::from(vec![frame as u8; 900]),
            )
        })
        .collect();
    run
}

/// Offset of the copied ball at each tick, metres.
const RHUMB_ERRORS: [f32; 4] = [0.0, 0.015625, 0.03125, 0.0625];

fn rhumb() -> Run {
    let frame = |tick: u64| {
        let error = RHUMB_ERRORS[tick as usize - 1];
        let [x, y, z] = ball_at(tick);
        let (mut changed, removed) = bystanders(tick);
        changed.push(copied_pose(BALL, [x + error, y, z], false));
        let bodies = if tick == 1 || tick == 4 { 2 } else { 3 };
        Frame {
            tick: Tick::new(tick),
            frame_ns: [2_000_000, 2_000_000, 4_000_000, 12_000_000][tick as usize - 1],
            wire_bytes_down: [300, 100, 0, 100][tick as usize - 1],
            wire_datagrams_down: [2, 1, 0, 1][tick as usize - 1],
            wire_bytes_up: 40,
            wire_datagrams_up: 1,
            updates: [3, 1, 0, 1][tick as usize - 1],
            changed,
            removed,
            errors_m: if error > 0.0 { vec![error] } else { Vec::new() },
            exact: if error > 0.0 { bodies - 1 } else { bodies },
            moving_errors_m: Vec::new(),
        }
    };
    let mut run = run(Mode::Rhumb, (1..=4).map(frame).collect());
    let captured = |frame, direction, length: usize| {
        CapturedPacket::new(frame, direction, Bytes::from(vec![0xa5; length]))
    };
    run.captured = vec![
        captured(0, PacketDirection::StateDown, 100),
        captured(0, PacketDirection::ControlDown, 30),
        captured(0, PacketDirection::ControlUp, 20),
        captured(1, PacketDirection::StateDown, 40),
        captured(3, PacketDirection::StateUp, 12),
        captured(3, PacketDirection::StateDown, 60),
    ];
    run.join = JoinCost {
        wire_bytes_down: 4_000,
        wire_datagrams_down: 5,
        wire_bytes_up: 2_000,
        wire_datagrams_up: 4,
    };
    run.breaches = vec![Breach {
        tick: Tick::new(4),
        id: BALL,
        error_m: 0.0625,
        tolerance_m: TOLERANCE_M,
        cause: Cause::Loss,
    }];
    run.publish_ns_total = 1_000_000;
    run
}

pub(crate) fn experiment() -> Experiment {
    Experiment {
        command: "rhumb-bench evaluate --scene <fall>".to_owned(),
        seed: 7,
        machine: "a machine, 2 cores".to_owned(),
        loads: vec![Load {
            truth: truth(),
            facts: facts(),
            runs: vec![integrated(), naive(), rhumb()],
            unfinished: Vec::new(),
        }],
    }
}
