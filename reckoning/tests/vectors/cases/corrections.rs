//! Cases of residuals: over time, with and without velocities, at limits.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    FINE_STEPS, Motion, POSITION_LIMIT, Pose, Predictor, RESIDUAL_LIMIT, Rate, Residual, Seconds,
    TURN_LIMIT, Ticks, Twist, VELOCITY_EXPONENT_MAX, VELOCITY_LIMIT, VelocityResidual,
};

use super::flight::{INTEGRATORS, predictor_name};
use super::rng::{VectorRng, motion, thirteen};
use super::tolerances::{GRIDS, grid, quantised};
use crate::document::CaseJson;

/// The corrected prediction: its predictor, age, integrator and grid.
#[derive(Clone, Copy)]
struct Corrected {
    predictor: Predictor,
    age: u32,
    integrator: usize,
    grid: usize,
}

/// The edges of ages, and common ones.
const AGES: [u32; 8] = [1, 2, 3, 4, 7, 60, 1_022, 1_023];

impl Corrected {
    /// Every predictor with every age, numbered.
    fn nth(number: usize) -> Self {
        Self {
            predictor: Predictor::ALL[number % Predictor::ALL.len()],
            age: AGES[number % AGES.len()],
            integrator: number % INTEGRATORS.len(),
            grid: number % GRIDS.len(),
        }
    }

    fn over(&self) -> Seconds {
        let (ticks, seconds, ..) = INTEGRATORS[self.integrator];
        let rate = Rate::new(ticks, seconds).expect("no case has a zero");
        self.predictor.divergence_time(Ticks::new(self.age), rate)
    }

    fn case(&self, predicted: &Motion, residual: &Residual) -> CaseJson {
        let over = self.over();
        let case = CaseJson::new()
            .integer("grid", self.grid as i64)
            .text("predictor", predictor_name(self.predictor))
            .integer("age", self.age)
            .integer("integrator", self.integrator as i64)
            .doubles("interval", &[over.seconds()])
            .doubles("predicted", &thirteen(predicted))
            .integers("position_residual", &residual.position)
            .integers("turn_residual", &residual.turn);
        let case = match residual.velocity {
            Some(velocity) => case
                .integer("velocity_exponent", velocity.velocity_exponent)
                .integers("linear_residual", &velocity.linear)
                .integers("angular_residual", &velocity.angular),
            None => case
                .nothing("velocity_exponent")
                .nothing("linear_residual")
                .nothing("angular_residual"),
        };
        if residual.is_within_limits() {
            let grid = grid(self.grid);
            quantised(case, &residual.onto(predicted, over, &grid), &grid)
        } else {
            let results = [
                "position", "largest", "others", "linear", "angular", "means",
            ];
            results.into_iter().fold(case, CaseJson::nothing)
        }
    }
}

pub(super) fn residuals(rng: &mut VectorRng) -> Vec<CaseJson> {
    let mut cases = by_chance(rng);
    cases.extend(in_time(rng));
    cases.extend(near_halves(rng));
    cases.extend(at_limits(rng));
    cases.extend(saturated());
    cases.extend(refused(rng));
    cases.extend(unturned());
    cases
}

/// Rotations that are another step once they are normalised twice: without a turn the predicted one is packed as it is.
fn unturned() -> Vec<CaseJson> {
    const ROTATIONS: [[u64; 4]; 2] = [
        [
            0xbfc1_4448_0045_1120,
            0xbfbe_86a6_2f13_9d71,
            0xbfd9_7940_5bce_7687,
            0x3fec_c8f9_cf8d_e55e,
        ],
        [
            0xbfc5_3f18_0054_fc60,
            0x3fdd_72b8_f051_ca7c,
            0xbfd5_629b_a95a_d983,
            0x3fe9_c7eb_e3c0_f417,
        ],
    ];
    let residual = Residual {
        position: [1, 2, 3],
        ..Residual::default()
    };
    ROTATIONS
        .map(|bits| {
            let pose = Pose {
                position: DVec3::ZERO,
                rotation: DQuat::from_array(bits.map(f64::from_bits)),
            };
            Corrected::nth(1).case(&motion(pose, Twist::ZERO), &residual)
        })
        .into()
}

/// Small, middling and large residuals, each without velocities and with them.
fn by_chance(rng: &mut VectorRng) -> Vec<CaseJson> {
    let mut cases = Vec::new();
    for index in 0..GRIDS.len() {
        for (place, size) in [3, 40, TURN_LIMIT].into_iter().enumerate() {
            let corrected = Corrected {
                grid: index,
                ..Corrected::nth(index * 3 + place)
            };
            let mut steps = |limit| core::array::from_fn(|_| rng.steps(limit));
            let without = Residual {
                position: steps(size * 4),
                turn: steps(size),
                velocity: None,
            };
            let velocity = VelocityResidual {
                velocity_exponent: (index + place) as u32,
                linear: steps(size),
                angular: steps(size),
            };
            let with = Residual {
                velocity: Some(velocity),
                ..without
            };
            let predicted = rng.motion();
            cases.push(corrected.case(&predicted, &without));
            cases.push(corrected.case(&predicted, &with));
        }
    }
    cases
}

/// One correction under every predictor and age, of a body at rest.
fn in_time(rng: &mut VectorRng) -> Vec<CaseJson> {
    let residual = Residual {
        position: [5, -2, 1],
        turn: [-3, 0, 4],
        velocity: None,
    };
    let still = rng.motion().stilled();
    let each = |predictor| AGES.map(|age| (predictor, age));
    let all = Predictor::ALL.into_iter().flat_map(each);
    all.enumerate()
        .map(|(number, (predictor, age))| {
            let corrected = Corrected {
                predictor,
                age,
                ..Corrected::nth(number)
            };
            corrected.case(&still, &residual)
        })
        .collect()
}

/// Implied velocities so near half steps that another order of operations would round some of them elsewhere.
fn near_halves(rng: &mut VectorRng) -> Vec<CaseJson> {
    let mut cases = Vec::new();
    for number in 0..24 {
        let predictor = [Predictor::Uniform, Predictor::Rest][number % 2];
        let age = 1 + number as u32 * 5;
        let corrected = Corrected {
            predictor,
            age,
            ..Corrected::nth(number)
        };
        let mut steps = |limit| core::array::from_fn(|_| rng.steps(limit));
        let residual = Residual {
            position: steps(50),
            turn: steps(20),
            velocity: None,
        };
        let (halves, grid) = ([steps(3), steps(3)], grid(corrected.grid));
        let rate = 1.0 / corrected.over().seconds();
        let less = |halves: [i32; 3], step: f64, correction: [i32; 3], by: f64| {
            let one = |i: usize| {
                (f64::from(halves[i]) + 0.5) * step - f64::from(correction[i]) * by * rate
            };
            DVec3::new(one(0), one(1), one(2))
        };
        let twist = Twist {
            linear: less(halves[0], grid.linear(), residual.position, grid.position()),
            angular: less(halves[1], grid.angular(), residual.turn, grid.turn()),
        };
        let predicted = motion(rng.motion().pose(), twist);
        cases.push(corrected.case(&predicted, &residual));
    }
    cases
}

/// A zero residual; a zero velocity residual; no turn; the limits of each part.
fn at_limits(rng: &mut VectorRng) -> Vec<CaseJson> {
    let nothing = Residual::default();
    let zero_velocity = Residual {
        velocity: Some(VelocityResidual::default()),
        ..nothing
    };
    let sideways = Residual {
        position: [1, -1, 0],
        ..nothing
    };
    let mut cases = Vec::new();
    for (number, residual) in [nothing, zero_velocity, sideways].iter().enumerate() {
        for place in 0..4 {
            let corrected = Corrected::nth(number * 7 + place * 3);
            cases.push(corrected.case(&rng.motion(), residual));
        }
    }
    for sign in [1, -1] {
        let most = Residual {
            position: [sign * RESIDUAL_LIMIT; 3],
            turn: [sign * TURN_LIMIT; 3],
            velocity: None,
        };
        for (number, velocity_exponent) in [(0, 0), (6, 3), (13, VELOCITY_EXPONENT_MAX)] {
            let velocity = VelocityResidual {
                velocity_exponent,
                linear: [sign * (VELOCITY_LIMIT >> velocity_exponent); 3],
                angular: [sign * (VELOCITY_LIMIT >> velocity_exponent); 3],
            };
            let fastest = Residual {
                velocity: Some(velocity),
                ..most
            };
            cases.push(Corrected::nth(number).case(&rng.motion(), &most));
            cases.push(Corrected::nth(number).case(&rng.motion(), &fastest));
        }
    }
    cases
}

/// Motions at the edge of their grid and beyond it, corrected outward and inward.
fn saturated() -> Vec<CaseJson> {
    let mut cases = Vec::new();
    for (number, far) in [1.0, 1.5, 1.0e30].into_iter().enumerate() {
        let corrected = Corrected::nth(number * 5 + 1);
        let grid = grid(corrected.grid);
        let out = |step: f64, limit: i32| DVec3::splat(step * f64::from(limit) * far);
        let pose = Pose {
            position: out(grid.fine(), POSITION_LIMIT),
            ..Pose::IDENTITY
        };
        let twist = Twist {
            linear: -out(grid.linear(), VELOCITY_LIMIT),
            angular: out(grid.angular(), VELOCITY_LIMIT),
        };
        let predicted = motion(pose, twist);
        for sign in [1, -1] {
            let velocity = VelocityResidual {
                velocity_exponent: 0,
                linear: [sign * VELOCITY_LIMIT, -sign, 0],
                angular: [sign, -sign * VELOCITY_LIMIT, 0],
            };
            let residual = Residual {
                position: [sign, sign * RESIDUAL_LIMIT, -sign * FINE_STEPS],
                turn: [0, sign, 0],
                velocity: Some(velocity),
            };
            cases.push(corrected.case(&predicted, &residual));
            let implied = Residual {
                velocity: None,
                ..residual
            };
            cases.push(corrected.case(&predicted, &implied));
        }
    }
    cases
}

/// Each part one step beyond its limit.
fn refused(rng: &mut VectorRng) -> Vec<CaseJson> {
    let at = |place: usize, limit: i32| {
        let mut steps = [0; 3];
        steps[place] = limit;
        steps
    };
    let velocity = |velocity_exponent, linear, angular| Residual {
        velocity: Some(VelocityResidual {
            velocity_exponent,
            linear,
            angular,
        }),
        ..Residual::default()
    };
    let beyond = [
        Residual {
            position: at(0, RESIDUAL_LIMIT + 1),
            ..Residual::default()
        },
        Residual {
            turn: at(1, -TURN_LIMIT - 1),
            ..Residual::default()
        },
        velocity(0, at(2, VELOCITY_LIMIT + 1), [0; 3]),
        velocity(0, [0; 3], at(0, -VELOCITY_LIMIT - 1)),
        velocity(5, at(1, (VELOCITY_LIMIT >> 5) + 1), [0; 3]),
        velocity(VELOCITY_EXPONENT_MAX + 1, [0; 3], [0; 3]),
    ];
    let predicted = rng.motion();
    let cases = beyond.iter().enumerate();
    cases
        .map(|(number, residual)| Corrected::nth(number).case(&predicted, residual))
        .collect()
}
