//! Motions, tracks and sayings of a script: all that is said of a body.

use rhumb_protocol::limits::INDICES_MAX;
use rhumb_protocol::packet::{Age, Course, Saying, TrackSaying, Update};
use rhumb_reckoning::{
    Anchor, BodyId, COARSENESS_LIMIT, DOUBLINGS_LIMIT, HORIZON, PUSH_LIMIT, PackedRotation,
    Predictor, Push, RESIDUAL_LIMIT, Residual, Settling, Snapped, TURN_LIMIT, VELOCITY_LIMIT,
    VelocityResidual, Verbatim,
};

use super::script::Script;

/// Steps within a limit: few, mostly.
fn steps(script: &mut Script<'_>, limit: i32) -> [i32; 3] {
    let mut all = [0; 3];
    let small = script.any::<u8>();
    for (place, steps) in all.iter_mut().enumerate() {
        *steps = match small >> (2 * place) & 3 {
            0 => 0,
            1 => i32::from(script.any::<i8>()).clamp(-limit, limit),
            2 => i32::from(script.any::<i16>()).clamp(-limit, limit),
            _ => script.any::<i32>().clamp(-limit, limit),
        };
    }
    all
}

/// A motion to the bit.
pub(super) fn verbatim(script: &mut Script<'_>) -> Verbatim {
    let position = script.vector(1e3).to_array();
    let rotation = script.rotation().to_array();
    let (linear, angular) = (script.vector(30.0), script.vector(30.0));
    Verbatim::new(position, rotation, linear.to_array(), angular.to_array()).unwrap_or_else(|_| {
        Verbatim::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3])
            .expect("nothing moves at the origin")
    })
}

/// A motion on a grid.
pub(super) fn snapped(script: &mut Script<'_>) -> Snapped {
    let position = steps(script, rhumb_reckoning::POSITION_LIMIT);
    let largest = script.any::<u8>() % 4;
    let others = steps(script, 1 << 18);
    let rotation = PackedRotation::from_parts(largest, others)
        .or_else(|| PackedRotation::from_parts(3, [0; 3]))
        .expect("no turn is a rotation");
    Snapped {
        position,
        rotation,
        linear: steps(script, VELOCITY_LIMIT),
        angular: steps(script, VELOCITY_LIMIT),
    }
}

/// A law, with any push.
pub(super) fn law(script: &mut Script<'_>) -> Predictor {
    match script.one_of(&Predictor::ALL) {
        Predictor::Pushed(_) => {
            let [x, y, z] = steps(script, i32::from(PUSH_LIMIT));
            let doublings = script.below(usize::from(DOUBLINGS_LIMIT) + 1) as u8;
            let push = Push::new([x as i16, y as i16, z as i16], doublings);
            Predictor::Pushed(push.expect("it is within the limits"))
        }
        law => law,
    }
}

/// A whole track.
pub(super) fn whole(script: &mut Script<'_>) -> TrackSaying {
    let predictor = law(script);
    let exact = script.any::<bool>() && predictor.push().is_none();
    let moving = predictor != Predictor::Rest;
    let anchor = match (exact, moving) {
        (true, true) => Anchor::Verbatim(verbatim(script)),
        (true, false) => Anchor::Verbatim(verbatim(script).stilled()),
        (false, true) => Anchor::Snapped(snapped(script)),
        (false, false) => Anchor::Snapped(snapped(script).stilled()),
    };
    let held = !exact && !moving && script.any();
    let carrier = held.then(|| BodyId::new(script.below(12) as u32, 0));
    TrackSaying {
        predictor,
        anchor,
        carrier,
    }
}

/// How many ticks were spoken of since something was said.
fn age(script: &mut Script<'_>, most: u32) -> Age {
    let age = match script.below(4) {
        0 => script.any::<u32>() % (most + 1),
        1 => script.below(300) as u32,
        _ => script.below(8) as u32,
    };
    Age::new(age.clamp(1, most))
}

fn course(script: &mut Script<'_>) -> Course {
    match script.below(6) {
        0..3 => Course::Same,
        3 => Course::Held {
            carrier: script.below(12) as u32,
            carrier_age: age(script, 2_000),
        },
        world => Course::World {
            predictor: law(script),
            carrier_age: (world == 4).then(|| age(script, 2_000)),
        },
    }
}

fn velocity(script: &mut Script<'_>) -> VelocityResidual {
    let coarseness = script.below(COARSENESS_LIMIT as usize + 1) as u32;
    VelocityResidual {
        coarseness,
        linear: steps(script, VELOCITY_LIMIT >> coarseness),
        angular: steps(script, VELOCITY_LIMIT >> coarseness),
    }
}

/// What an update says of a body.
pub(super) fn saying(script: &mut Script<'_>) -> Saying {
    match script.below(6) {
        0 => Saying::Whole(whole(script)),
        1 => Saying::Settled {
            age: age(script, 1 << 30),
            settling: Settling {
                negated: script.any(),
                position: steps(script, i32::MAX),
                others: steps(script, i32::MAX),
                largest: steps(script, i32::MAX)[0],
            },
        },
        _ => {
            let course = course(script);
            let still = matches!(
                course,
                Course::Held { .. }
                    | Course::World {
                        predictor: Predictor::Rest,
                        ..
                    }
            );
            let (age, moved) = (age(script, HORIZON.count()), script.any::<bool>());
            Saying::Residual {
                course,
                age,
                residual: Residual {
                    position: steps(script, RESIDUAL_LIMIT),
                    turn: steps(script, TURN_LIMIT),
                    velocity: (moved && !still).then(|| velocity(script)),
                },
            }
        }
    }
}

/// Updates of one packet, in rising order of seat.
pub(super) fn updates(script: &mut Script<'_>, most: usize) -> Vec<Update> {
    let mut next_seat = 0;
    let mut all = Vec::new();
    for _ in 0..script.below(most + 1) {
        let gap = match script.below(8) {
            0 => script.any::<u32>() % INDICES_MAX,
            _ => script.below(4) as u32,
        };
        let seat = next_seat + gap;
        if seat >= INDICES_MAX {
            break;
        }
        let saying = saying(script);
        let named = script.any::<bool>() || matches!(saying, Saying::Whole(_));
        all.push(Update {
            seat,
            body: named.then(|| script.below(12) as u32),
            saying,
        });
        next_seat = seat + 1;
    }
    all
}
