//! Fuzzes the arithmetic of `reckoning`: fast paths, quantisers, corrections.
//!
//! Promises: the exact test accepts everything that the prefilter accepts. Four predictions at once equal four single
//! ones, bit for bit. A quantised value is its own nearest grid point, within half a step of the original. A rest
//! correction restores any pose bit for bit. All results are finite.

use std::num::NonZeroU32;

use glam::{DQuat, DVec3};
use rhumb_reckoning::{
    Anchor, BodyState, Conditions, Damping, DenseTrack, Divergence, ErrorPrefilter, FINE_STEPS,
    Grid, Inertia, Integrator, LengthBound, Metres, Motion, POSITION_LIMIT, PredictionX4,
    PrefilterBody, PrefilterInput, PrefilterTrack, QuantisedState, RESIDUAL_LIMIT, Radians, Rate,
    Residual, RestCorrection, RotationCursor, Seconds, StepCoefficientTable, TRACK_AGE_MAX,
    TURN_LIMIT, Tick, Ticks, Tolerance, Track, VELOCITY_LIMIT,
};

use super::payloads::{body_state, predictor, quantised};
use super::script::Script;
use super::subscriber::assert_is_motion;

/// Ten thousand times the coordinate limit of a body, in metres.
const FAR: f64 = 1e9;

/// A tolerance from one length, or from a length and an angle.
fn tolerance(script: &mut Script<'_>) -> Tolerance {
    let length = Metres::new(f64::from(script.sane(0.2).abs()));
    let turn = Radians::new(f64::from(script.sane(3.0).abs()));
    let length = if script.below(8) == 0 {
        Metres::new(f64::from(script.number(1.0)))
    } else {
        length
    };
    let tolerance = if script.any() {
        LengthBound::from_metres(length).map(Tolerance::Surface)
    } else {
        Tolerance::parts(length, turn)
    };
    tolerance.unwrap_or(Tolerance::NORMAL)
}

fn radius(script: &mut Script<'_>) -> Metres {
    let metres = match script.below(4) {
        0 => script.sane(200.0).abs(),
        1 => 1e-3,
        _ => script.sane(2.0).abs(),
    };
    Metres::new(f64::from(metres.max(1e-3)))
}

fn flow(script: &mut Script<'_>) -> (Integrator, StepCoefficientTable) {
    let rates = [
        Rate::HZ_60,
        Rate::new(10, 1).expect("a valid rate"),
        Rate::new(1_000, 1).expect("a rate"),
    ];
    let integrator = Integrator {
        rate: script.one_of(&rates),
        substeps: NonZeroU32::new(1 + script.below(8) as u32).expect("a positive number"),
    };
    let damping = Damping {
        linear: script.one_of(&[0.0, 0.5, 100.0]),
        angular: script.one_of(&[0.0, 0.1, 1e3]),
    };
    let mut flow = StepCoefficientTable::new(integrator, damping);
    flow.extend_to(TRACK_AGE_MAX);
    (integrator, flow)
}

fn track(script: &mut Script<'_>) -> Track {
    let predictor = predictor(script);
    let anchor = if script.any() || predictor.acceleration().is_some() {
        Anchor::Quantised(quantised(script))
    } else {
        Anchor::Exact(body_state(script))
    };
    Track {
        origin: Tick::new(5),
        predictor,
        anchor,
        parent: None,
    }
}

/// Four tracks and true states near them: compares prefilter with exact test, and batch with single prediction.
pub fn prefilter(data: &[u8]) {
    let mut script = Script::new(data);
    let tolerance = tolerance(&mut script);
    let (integrator, flow) = flow(&mut script);
    let gravity = script.sane_vector(1e3).as_dvec3();
    let inertia = Inertia::new([1.0, 2.0, 2.5], [0.0, 0.0, 0.0, 1.0]).expect("a valid inertia");
    let radius = radius(&mut script);
    let grid = Grid::new(tolerance, radius);
    let prefilter = ErrorPrefilter::new(tolerance, integrator);
    let mut batch = PredictionX4::default();
    let (mut predicted, mut cases) = (Vec::new(), Vec::new());
    for place in 0..4 {
        let track = track(&mut script);
        let tumbles = script.below(8) == 0;
        let conditions = Conditions {
            gravity: if track.predictor.falls() {
                gravity
            } else {
                DVec3::ZERO
            },
            flow: &flow,
            inertia: tumbles.then_some(&inertia),
        };
        let ages = [script.below(20), script.below(1_100)];
        let age = Ticks::new(script.one_of(&ages) as u32);
        let tick = track.origin + age;
        let predicted_motion = track.at(tick, &grid, &conditions);
        assert_is_motion(&predicted_motion);
        let mut cursor = RotationCursor::default();
        let by_cursor = track.at_with(tick, &grid, &conditions, &mut cursor);
        assert_eq!(
            bits(&by_cursor),
            bits(&predicted_motion),
            "the result with a cursor is bit-identical"
        );
        if batch.take(place, &DenseTrack::new(&track), tick, &grid, &conditions) {
            predicted.push((place, predicted_motion));
        }
        let truth = beside(&mut script, &predicted_motion, tolerance.reach(radius));
        let apart = Divergence::between(&truth.motion().pose(), &predicted_motion.pose());
        let body = PrefilterBody {
            tolerance,
            grid: &grid,
            radius,
            conditions: &conditions,
        };
        // Beyond this distance, which no body reaches, the rounding of f64 is coarser than the comparison.
        let is_near = predicted_motion.pose().position.abs().max_element() < FAR;
        let share = if is_near {
            tolerance.share(&apart, radius)
        } else {
            0.0
        };
        let track = prefilter.track(&DenseTrack::new(&track), &body);
        cases.push(PrefilterCase {
            truth,
            track,
            age,
            share,
        });
    }
    assert_prefilter(&prefilter, &cases, &flow);
    assert_batch(&mut batch, predicted);
}

/// A true state beside a track.
struct PrefilterCase {
    truth: BodyState,
    track: Option<PrefilterTrack>,
    age: Ticks,
    /// The share of the tolerance that lies between them.
    share: f64,
}

/// Asserts that only tracks within the tolerance pass.
fn assert_prefilter(
    prefilter: &ErrorPrefilter,
    cases: &[PrefilterCase],
    flow: &StepCoefficientTable,
) {
    let (mut undecided, mut late) = (Vec::new(), Vec::new());
    let mut batch = prefilter.batch();
    for (place, case) in (0..).zip(cases) {
        let at_once = case.track.as_ref().is_none_or(|track| {
            let input = PrefilterInput {
                truth: &case.truth,
                track,
                age: case.age,
                flow,
            };
            batch.test(place, &input, &mut late)
        });
        undecided.extend(at_once.then_some(place));
    }
    batch.finish(&mut late);
    undecided.extend(late);
    for (place, case) in (0..).zip(cases) {
        let passed = !undecided.contains(&place);
        assert!(
            !passed || case.share <= 1.0,
            "{place} passed with {}",
            case.share
        );
    }
}

/// Asserts that a batch predicts what single predictions gave, in the same order.
fn assert_batch(batch: &mut PredictionX4, predicted: Vec<(u32, Motion)>) {
    let mut rest = predicted.into_iter();
    batch.predict(|place, motion| {
        let (expected, exact) = rest.next().expect("one result per track");
        assert_eq!((place, bits(&motion)), (expected, bits(&exact)));
    });
    assert_eq!(rest.next(), None, "a result is missing");
}

/// A true state about one tolerance away from a prediction, rounded to f32.
fn beside(script: &mut Script<'_>, predicted_motion: &Motion, reach: Metres) -> BodyState {
    let pose = predicted_motion.pose();
    let scale = script.one_of(&[0.1, 0.9, 1.0, 1.1]);
    let off = script.sane_vector(1.0).as_dvec3() * reach.metres() * scale;
    let turn = DQuat::from_scaled_axis(script.sane_vector(0.1).as_dvec3() * scale);
    let position = (pose.position + off).as_vec3().to_array();
    let turned = if script.any() {
        turn * pose.rotation
    } else {
        pose.rotation
    };
    let length = script.one_of(&[1.0, 1.0, 0.9995, 1.0005]);
    let rotation = turned.as_quat().to_array().map(|part| part * length);
    BodyState::new(position, rotation, [0.0; 3], [0.0; 3]).unwrap_or_else(|_| body_state(script))
}

fn bits(motion: &Motion) -> Vec<u64> {
    let (pose, twist) = (motion.pose(), motion.twist());
    let vectors = [pose.position, twist.linear, twist.angular];
    let numbers = vectors.iter().flat_map(DVec3::to_array);
    numbers
        .chain(pose.rotation.to_array())
        .map(f64::to_bits)
        .collect()
}

/// A quantised motion, a correction of it, and a rest correction.
pub fn quantiser(data: &[u8]) {
    let mut script = Script::new(data);
    let tolerance = tolerance(&mut script);
    let grid = Grid::new(tolerance, radius(&mut script));
    let motion = body_state(&mut script).motion();
    let on_grid = QuantisedState::of(&motion, &grid);
    assert!(on_grid.is_within_limits());
    check_quantised(&motion, &on_grid, &grid);
    // A quantised value stays where it is.
    let sent = quantised(&mut script);
    let again = QuantisedState::of(&sent.motion(&grid), &grid);
    assert_eq!(
        (again.position, again.linear, again.angular),
        (sent.position, sent.linear, sent.angular)
    );
    assert_eq!(
        again.motion(&grid).pose().rotation,
        sent.motion(&grid).pose().rotation
    );
    check_residual(&mut script, &motion, &sent.motion(&grid), &grid);
    check_rest_correction(&body_state(&mut script), &motion);
}

fn check_quantised(motion: &Motion, quantised: &QuantisedState, grid: &Grid) {
    let value = quantised.motion(grid);
    assert_is_motion(&value);
    let near = |is: DVec3, was: DVec3, step: f64, limit: i32| {
        let limit = f64::from(limit) * step;
        for (is, was) in is.to_array().into_iter().zip(was.to_array()) {
            let off = (is - was.clamp(-limit, limit)).abs();
            let slack = was.abs().min(limit) * 1e-12;
            assert!(off <= step / 2.0 + slack, "{was} became {is} at {step}");
        }
    };
    let (pose, twist) = (motion.pose(), motion.twist());
    near(
        value.pose().position,
        pose.position,
        grid.fine(),
        POSITION_LIMIT,
    );
    near(
        value.twist().linear,
        twist.linear,
        grid.linear(),
        VELOCITY_LIMIT,
    );
    near(
        value.twist().angular,
        twist.angular,
        grid.angular(),
        VELOCITY_LIMIT,
    );
    let turned = value.pose().rotation.dot(pose.rotation).abs();
    assert!(turned > 1.0 - 1e-9, "the rotation differs: {turned}");
}

/// A correction of a prediction that a decoder may receive is on the grid.
fn check_residual(script: &mut Script<'_>, motion: &Motion, predicted: &Motion, grid: &Grid) {
    let wanted = Residual::wanted(&motion.pose(), &predicted.pose(), grid);
    let steps = |wanted: DVec3, limit: i32| {
        let limit = f64::from(limit);
        wanted
            .to_array()
            .map(|steps| steps.round().clamp(-limit, limit) as i32)
    };
    let residual = Residual {
        position: steps(wanted[0], RESIDUAL_LIMIT),
        turn: steps(wanted[1], TURN_LIMIT),
        velocity: None,
    };
    assert!(residual.is_within_limits());
    let over = Seconds::new(f64::from(1 + script.below(1_023) as u32) / 60.0);
    let corrected = residual.onto(predicted, over, grid);
    assert!(corrected.is_within_limits());
    assert_is_motion(&corrected.motion(grid));
    let from = QuantisedState::of(predicted, grid);
    for axis in 0..3 {
        let expected = from.position[axis].saturating_add(residual.position[axis] * FINE_STEPS);
        let expected = expected.clamp(-POSITION_LIMIT, POSITION_LIMIT);
        assert_eq!(corrected.position[axis], expected);
    }
    let velocity_exponent = script.below(13) as u32;
    let velocity = Residual::of_velocity(&motion.twist(), &corrected, grid, velocity_exponent);
    let residual = Residual {
        velocity: Some(velocity),
        ..residual
    };
    assert!(residual.is_within_limits());
    assert!(residual.onto(predicted, over, grid).is_within_limits());
}

/// A pose that can be encoded as a rest correction of a prediction is restored bit for bit.
fn check_rest_correction(truth: &BodyState, predicted: &Motion) {
    if let Some(rest_correction) = RestCorrection::of(truth, &predicted.pose()) {
        let back = rest_correction.onto(&predicted.pose());
        assert_eq!(back, Ok(truth.stilled()));
    }
}
