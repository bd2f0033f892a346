//! Cases of residuals: in time, with velocities or none, at limits and beyond.

use glam::DVec3;
use rhumb_reckoning::{
    COARSENESS_LIMIT, FINE_STEPS, Motion, POSITION_LIMIT, Pose, Predictor, RESIDUAL_LIMIT, Rate,
    Residual, Seconds, TURN_LIMIT, Ticks, Twist, VELOCITY_LIMIT, VelocityResidual,
};

use super::chance::{Chance, motion, thirteen};
use super::flight::{INTEGRATORS, law_name};
use super::said::{GRIDS, grid, snapped};
use crate::document::Case;

/// What is corrected: a law that went astray for some ticks, of an integrator, on a grid.
#[derive(Clone, Copy)]
struct Corrected {
    law: Predictor,
    age: u32,
    integrator: usize,
    grid: usize,
}

/// The edges of ages, and everyday ones.
const AGES: [u32; 8] = [1, 2, 3, 4, 7, 60, 1_022, 1_023];

impl Corrected {
    /// Every law with every age, by a number.
    fn nth(number: usize) -> Self {
        Self {
            law: Predictor::ALL[number % Predictor::ALL.len()],
            age: AGES[number % AGES.len()],
            integrator: number % INTEGRATORS.len(),
            grid: number % GRIDS.len(),
        }
    }

    fn over(&self) -> Seconds {
        let (ticks, seconds, ..) = INTEGRATORS[self.integrator];
        let rate = Rate::new(ticks, seconds).expect("no case has a zero");
        self.law.astray(Ticks::new(self.age), rate)
    }

    fn case(&self, predicted: &Motion, residual: &Residual) -> Case {
        let over = self.over();
        let case = Case::new()
            .integer("grid", self.grid as i64)
            .text("law", law_name(self.law))
            .integer("age", self.age)
            .integer("integrator", self.integrator as i64)
            .doubles("over", &[over.seconds()])
            .doubles("predicted", &thirteen(predicted))
            .integers("position_residual", &residual.position)
            .integers("turn_residual", &residual.turn);
        let case = match residual.velocity {
            Some(velocity) => case
                .integer("coarseness", velocity.coarseness)
                .integers("linear_residual", &velocity.linear)
                .integers("angular_residual", &velocity.angular),
            None => case
                .nothing("coarseness")
                .nothing("linear_residual")
                .nothing("angular_residual"),
        };
        if residual.is_within_limits() {
            let grid = grid(self.grid);
            snapped(case, &residual.onto(predicted, over, &grid), &grid)
        } else {
            let results = [
                "position", "largest", "others", "linear", "angular", "means",
            ];
            results.into_iter().fold(case, Case::nothing)
        }
    }
}

pub(super) fn residuals(chance: &mut Chance) -> Vec<Case> {
    let mut cases = by_chance(chance);
    cases.extend(in_time(chance));
    cases.extend(near_halves(chance));
    cases.extend(at_limits(chance));
    cases.extend(saturated());
    cases.extend(refused(chance));
    cases
}

/// Small, middling and large ones, each without velocities and with them.
fn by_chance(chance: &mut Chance) -> Vec<Case> {
    let mut cases = Vec::new();
    for index in 0..GRIDS.len() {
        for (place, size) in [3, 40, TURN_LIMIT].into_iter().enumerate() {
            let corrected = Corrected {
                grid: index,
                ..Corrected::nth(index * 3 + place)
            };
            let mut steps = |limit| core::array::from_fn(|_| chance.steps(limit));
            let without = Residual {
                position: steps(size * 4),
                turn: steps(size),
                velocity: None,
            };
            let velocity = VelocityResidual {
                coarseness: (index + place) as u32,
                linear: steps(size),
                angular: steps(size),
            };
            let with = Residual {
                velocity: Some(velocity),
                ..without
            };
            let predicted = chance.motion();
            cases.push(corrected.case(&predicted, &without));
            cases.push(corrected.case(&predicted, &with));
        }
    }
    cases
}

/// One correction under every law and age, from a body that does not move.
fn in_time(chance: &mut Chance) -> Vec<Case> {
    let residual = Residual {
        position: [5, -2, 1],
        turn: [-3, 0, 4],
        velocity: None,
    };
    let still = chance.motion().stilled();
    let each = |law| AGES.map(|age| (law, age));
    let all = Predictor::ALL.into_iter().flat_map(each);
    all.enumerate()
        .map(|(number, (law, age))| {
            let corrected = Corrected {
                law,
                age,
                ..Corrected::nth(number)
            };
            corrected.case(&still, &residual)
        })
        .collect()
}

/// Implied velocities so near to half steps that another order of operations would snap some of them elsewhere.
fn near_halves(chance: &mut Chance) -> Vec<Case> {
    let mut cases = Vec::new();
    for number in 0..24 {
        let law = [Predictor::Uniform, Predictor::Rest][number % 2];
        let age = 1 + number as u32 * 5;
        let corrected = Corrected {
            law,
            age,
            ..Corrected::nth(number)
        };
        let mut steps = |limit| core::array::from_fn(|_| chance.steps(limit));
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
        let predicted = motion(chance.motion().pose(), twist);
        cases.push(corrected.case(&predicted, &residual));
    }
    cases
}

/// Nothing; nothing but a velocity of nothing; no turn; the limits of each part.
fn at_limits(chance: &mut Chance) -> Vec<Case> {
    let nothing = Residual::default();
    let said_nothing = Residual {
        velocity: Some(VelocityResidual::default()),
        ..nothing
    };
    let sideways = Residual {
        position: [1, -1, 0],
        ..nothing
    };
    let mut cases = Vec::new();
    for (number, residual) in [nothing, said_nothing, sideways].iter().enumerate() {
        for place in 0..4 {
            let corrected = Corrected::nth(number * 7 + place * 3);
            cases.push(corrected.case(&chance.motion(), residual));
        }
    }
    for sign in [1, -1] {
        let most = Residual {
            position: [sign * RESIDUAL_LIMIT; 3],
            turn: [sign * TURN_LIMIT; 3],
            velocity: None,
        };
        for (number, coarseness) in [(0, 0), (6, 3), (13, COARSENESS_LIMIT)] {
            let velocity = VelocityResidual {
                coarseness,
                linear: [sign * (VELOCITY_LIMIT >> coarseness); 3],
                angular: [sign * (VELOCITY_LIMIT >> coarseness); 3],
            };
            let fastest = Residual {
                velocity: Some(velocity),
                ..most
            };
            cases.push(Corrected::nth(number).case(&chance.motion(), &most));
            cases.push(Corrected::nth(number).case(&chance.motion(), &fastest));
        }
    }
    cases
}

/// From motions at the edge of their grid and beyond it, further out and back in again.
fn saturated() -> Vec<Case> {
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
                coarseness: 0,
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

/// Each part by one step beyond its limit.
fn refused(chance: &mut Chance) -> Vec<Case> {
    let at = |place: usize, limit: i32| {
        let mut steps = [0; 3];
        steps[place] = limit;
        steps
    };
    let velocity = |coarseness, linear, angular| Residual {
        velocity: Some(VelocityResidual {
            coarseness,
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
        velocity(COARSENESS_LIMIT + 1, [0; 3], [0; 3]),
    ];
    let predicted = chance.motion();
    let cases = beyond.iter().enumerate();
    cases
        .map(|(number, residual)| Corrected::nth(number).case(&predicted, residual))
        .collect()
}
