//! Cases of motion over time: flow, gravity, starts, predictions.

use core::num::NonZeroU32;

use glam::DVec3;
use rhumb_reckoning::{
    ACCELERATION_EXPONENT_MAX, ACCELERATION_LIMIT, BodyState, Conditions, ConstantAcceleration,
    Damping, Integrator, Pose, Predictor, Rate, StepCoefficientTable, TRACK_AGE_MAX, Ticks, Twist,
};

use super::rng::{motion, thirteen};
use crate::document::CaseJson;

/// Ticks, seconds, substeps, linear and angular damping.
pub(super) const INTEGRATORS: [(u32, u32, u32, f32, f32); 10] = [
    (60, 1, 4, 0.0, 0.0),
    (60, 1, 4, 0.1, 0.05),
    (60, 1, 1, 0.0, 0.5),
    (1133, 100, 4, 0.3, 0.0),
    (30, 1, 2, 2.5, 1.25),
    (120, 1, 8, 0.01, 0.02),
    (1000, 1, 3, 0.0, 0.1),
    (7, 3, 7, 1.0e6, 1.0e6),
    (75, 1, 5, 0.2, 0.7),
    (1, 1, 1, 0.0, 0.0),
];

pub(super) fn tables() -> Vec<StepCoefficientTable> {
    let table = |&(ticks, seconds, substeps, linear, angular): &(u32, u32, u32, f32, f32)| {
        let integrator = Integrator {
            rate: Rate::new(ticks, seconds).expect("no case has a zero"),
            substeps: NonZeroU32::new(substeps).expect("no case has a zero"),
        };
        let mut table = StepCoefficientTable::new(integrator, Damping { linear, angular });
        table.extend_to(TRACK_AGE_MAX);
        table
    };
    INTEGRATORS.iter().map(table).collect()
}

pub(super) fn integrators() -> Vec<CaseJson> {
    let case = |&(ticks, seconds, substeps, linear, angular)| {
        CaseJson::new()
            .integer("ticks", ticks)
            .integer("seconds", seconds)
            .integer("substeps", substeps)
            .singles("damping", &[linear, angular])
    };
    INTEGRATORS.iter().map(case).collect()
}

/// The coefficients, read off a body for which each one stands alone.
pub(super) fn flows() -> Vec<CaseJson> {
    let twist = Twist {
        linear: DVec3::X,
        angular: DVec3::Y,
    };
    let start = motion(Pose::IDENTITY, twist);
    let mut cases = Vec::new();
    for (index, table) in tables().iter().enumerate() {
        for elapsed in [0, 1, 2, 3, 60, 500, 1_023] {
            let conditions = Conditions {
                gravity: DVec3::Z,
                flow: table,
                inertia: None,
            };
            let end = Predictor::Ballistic.predict(&start, Ticks::new(elapsed), &conditions);
            let (p, v) = (end.pose().position, end.twist().linear);
            let row = [v.x, p.x, v.z, p.z, end.twist().angular.y];
            cases.push(
                CaseJson::new()
                    .integer("integrator", index as i64)
                    .integer("elapsed", elapsed)
                    .doubles("row", &row),
            );
        }
    }
    cases
}

/// A scene's gravity and a body's scale.
pub(super) const GRAVITIES: [([f32; 3], f32); 7] = [
    ([0.0, -9.81, 0.0], 1.0),
    ([0.0, -9.81, 0.0], 0.1),
    ([0.0, -9.81, 0.0], 0.0),
    ([0.3, -1.6, 0.7], -2.3),
    ([0.0, 0.0, 0.0], 1.0),
    ([1.0e-3, 123.4, -24.8], 3.0),
    ([f32::MAX, -f32::MAX, f32::MIN_POSITIVE], f32::MAX),
];

pub(super) fn gravity((scene, scale): ([f32; 3], f32)) -> DVec3 {
    DVec3::from_array(scene.map(|part| f64::from(part) * f64::from(scale)))
}

pub(super) fn gravities() -> Vec<CaseJson> {
    let case = |&given: &([f32; 3], f32)| {
        CaseJson::new()
            .singles("scene", &given.0)
            .singles("scale", &[given.1])
            .doubles("gravity", &gravity(given).to_array())
    };
    GRAVITIES.iter().map(case).collect()
}

/// Position, quaternion, linear and angular velocity as an engine might have them.
pub(super) fn given_starts() -> Vec<[f32; 13]> {
    let spun = |angular: [f32; 3]| {
        let [x, y, z] = angular;
        [
            1.5, -2.25, 0.1, 0.5, -0.5, 0.5, 0.5, 3.0, 0.2, -1.1, x, y, z,
        ]
    };
    let (tiny, huge) = (f32::MIN_POSITIVE / 4.0, f32::MAX);
    vec![
        // A zero state; signed zeros; a plain throw.
        [
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        ],
        [
            -0.0, 0.0, -0.0, -0.0, 0.0, -0.0, -1.0, -0.0, 0.0, -0.0, -0.0, 0.0, -0.0,
        ],
        [
            10.0, 2.0, -3.0, 0.0, 0.0, 0.0, 1.0, 4.0, 6.0, -1.0, 0.0, 0.0, 0.0,
        ],
        // A rotation a little off unit length, as products leave it, and one at the edge of the accepted range.
        [
            0.3, 0.7, 0.9, 0.182_57, 0.365_15, 0.547_72, 0.730_3, 0.0, 1.0, 0.0, 0.1, 0.2, 0.3,
        ],
        [
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.000_999, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
        ],
        // Rotations whose last bit changes when they are normalised twice.
        [
            0.1, 0.2, 0.3, -0.557, -0.124, -0.008, 0.8212, 0.0, 0.0, 0.0, 0.3, 0.2, 0.1,
        ],
        [
            0.1, 0.2, 0.3, 0.2, 0.3, -0.5, 0.7874, 0.0, 0.0, 0.0, -3.0, 0.2, 1.0,
        ],
        // Spins: a turn in every quadrant, beyond the range of the series, and beyond the angle's limit.
        spun([0.0, 0.0, 0.7]),
        spun([1.0, 0.0, 0.0]),
        spun([-2.0, 3.1, 0.4]),
        spun([12.0, -9.0, 5.0]),
        spun([100.0, 60.0, -80.0]),
        spun([0.0, -900.0, 10.0]),
        spun([11.0, 0.0, 0.0]),
        spun([0.0, 11.2, 0.0]),
        spun([4.0e3, 2.0e4, -1.0e4]),
        spun([tiny, 0.0, -tiny]),
        spun([huge, -huge, huge]),
        [
            huge, -huge, tiny, 0.0, 1.0, 0.0, 0.0, -huge, huge, huge, 0.0, 0.0, 1.0e-20,
        ],
        // Refused: too long, too short, not finite.
        [
            0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.002, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        ],
        [0.0; 13],
        [
            f32::INFINITY,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            1.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
        ],
    ]
}

pub(super) fn body_state(parts: &[f32; 13]) -> Option<BodyState> {
    let [px, py, pz, x, y, z, w, vx, vy, vz, ax, ay, az] = *parts;
    BodyState::new([px, py, pz], [x, y, z, w], [vx, vy, vz], [ax, ay, az]).ok()
}

pub(super) fn starts() -> Vec<CaseJson> {
    let case = |parts: &[f32; 13]| {
        let case = CaseJson::new().singles("body_state", parts);
        match body_state(parts) {
            Some(start) => case.doubles("motion", &thirteen(&start.motion())),
            None => case.nothing("motion"),
        }
    };
    let turned = |bits: [u32; 4]| {
        let [x, y, z, w] = bits.map(f32::from_bits);
        [0.0, 0.0, 0.0, x, y, z, w, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    };
    let edges = UNIT_EDGES.map(turned);
    given_starts().iter().chain(&edges).map(case).collect()
}

/// Rotations about the slack, which is no f32: barely not too long, too long, not too short, too short.
const UNIT_EDGES: [[u32; 4]; 4] = [
    [0x3f68_0944, 0x3ed9_4b0d, 0x3c96_ea33, 0x3a13_377a],
    [0x3f4c_1b67, 0x3f14_f4ee, 0x3e2a_9d5e, 0x3934_32dd],
    [0x3f71_089f, 0x3eaa_3389, 0x3d01_36c8, 0x3b25_c6bf],
    [0x3f67_5f3e, 0x3ed9_01ff, 0x3d1f_189f, 0x396b_a7ff],
];

pub(super) fn predictor_name(predictor: Predictor) -> &'static str {
    match predictor {
        Predictor::Rest => "rest",
        Predictor::Uniform => "uniform",
        Predictor::Ballistic => "ballistic",
        Predictor::TorqueFree => "torque_free",
        Predictor::BallisticTorqueFree => "ballistic_torque_free",
        Predictor::Accelerated(_) => "constant_acceleration",
    }
}

/// A predictor, and its acceleration if it has one.
pub(super) fn with_predictor(case: CaseJson, predictor: Predictor) -> CaseJson {
    let case = case.text("predictor", predictor_name(predictor));
    match predictor.acceleration() {
        Some(acceleration) => case
            .integers("acceleration", &acceleration.steps().map(i32::from))
            .integer("exponent", acceleration.exponent()),
        None => case,
    }
}

/// Accelerations of every size.
pub(super) fn accelerations() -> Vec<ConstantAcceleration> {
    let all = [
        ([40, -7, 0], 3),
        ([0, 0, 0], 0),
        ([-1, 1, 1], 0),
        (
            [ACCELERATION_LIMIT, -ACCELERATION_LIMIT, 512],
            ACCELERATION_EXPONENT_MAX,
        ),
        ([3, -1_000, 77], 5),
    ];
    let acceleration = |(steps, exponent)| {
        ConstantAcceleration::new(steps, exponent).expect("it is within the limits")
    };
    all.map(acceleration).to_vec()
}

/// Every start with every acceleration: during it, just before its end, and after.
fn accelerated(add: &mut impl FnMut(Predictor, usize, usize, usize, u32), starts: usize) {
    for start in 0..starts {
        for (place, acceleration) in accelerations().into_iter().enumerate() {
            let all = [0, 1, 2, 63, 64, 65, 66, 200, 1_023, 1_024];
            let elapsed = all[(start * 3 + place) % all.len()];
            let table = (start + 2 * place) % INTEGRATORS.len();
            add(
                Predictor::Accelerated(acceleration),
                table,
                start,
                place,
                elapsed,
            );
        }
    }
}

pub(super) fn predictions() -> Vec<CaseJson> {
    let tables = tables();
    let starts: Vec<_> = given_starts().iter().filter_map(body_state).collect();
    let mut cases = Vec::new();
    let mut add = |predictor: Predictor, table: usize, start: usize, pull: usize, elapsed: u32| {
        let end = predictor.predict(
            &starts[start].motion(),
            Ticks::new(elapsed),
            &Conditions {
                gravity: gravity(GRAVITIES[pull]),
                flow: &tables[table],
                inertia: None,
            },
        );
        cases.push(
            with_predictor(CaseJson::new(), predictor)
                .integer("integrator", table as i64)
                .integer("initial_state", start as i64)
                .integer("gravity", pull as i64)
                .integer("elapsed", elapsed)
                .doubles("end", &thirteen(&end)),
        );
    };
    for start in 0..starts.len() {
        add(Predictor::Rest, 1, start, 0, 17 * start as u32);
        // Every predictor over the edges of time: zero, one, the horizon, beyond it.
        for (place, elapsed) in [0, 1, 1_023, 1_024, u32::MAX].into_iter().enumerate() {
            let table = (start + place) % INTEGRATORS.len();
            let pull = (start * 3 + place) % GRAVITIES.len();
            let predictor = if (start + place) % 2 == 0 {
                Predictor::Ballistic
            } else {
                Predictor::Uniform
            };
            add(predictor, table, start, pull, elapsed);
        }
        add(Predictor::Ballistic, start % 10, start, 1, 0);
        // Common times, so that angles fall in every quadrant.
        for place in 0..6 {
            let elapsed = 2 + (start as u32 * 31 + place * place * 29) % 700;
            let predictor = if place % 3 == 0 {
                Predictor::Uniform
            } else {
                Predictor::Ballistic
            };
            add(
                predictor,
                place as usize % 7,
                start,
                place as usize % 6,
                elapsed,
            );
        }
    }
    accelerated(&mut add, starts.len());
    // Half angles just within the limit and just beyond it.
    add(Predictor::Uniform, 9, 13, 0, 1_023);
    add(Predictor::Uniform, 9, 14, 0, 1_023);
    // Spins so fast that the whole series counts, with damping.
    for table in [2, 4, 5, 8] {
        for (place, elapsed) in [2, 5, 37, 200, 700].into_iter().enumerate() {
            add(Predictor::Uniform, table, 11 + place % 2, 0, elapsed);
        }
    }
    cases
}
