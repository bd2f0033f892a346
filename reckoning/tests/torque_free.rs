//! Torque-free rotation follows the laws of physics.
//!
//! Proof: against their integration in small steps; against the spin-keeping predictor, where moments are equal; by angular
//! momentum and energy. `rhumb-server` has the test that an engine takes the same steps.

use core::num::NonZeroU32;

use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;
use rhumb_reckoning::{
    Conditions, Damping, Divergence, Inertia, Integrator, Metres, Motion, Pose, Predictor, Rate,
    RotationCursor, StepCoefficientTable, TRACK_AGE_MAX, Ticks, Twist,
};

/// Ticks in five seconds.
const FIVE_SECONDS: u32 = 300;

fn table(substeps: u32, damping: Damping) -> StepCoefficientTable {
    let integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(substeps).expect("not zero"),
    };
    let mut table = StepCoefficientTable::new(integrator, damping);
    table.extend_to(TRACK_AGE_MAX);
    table
}

fn in_weightlessness<'a>(flow: &'a StepCoefficientTable, inertia: &'a Inertia) -> Conditions<'a> {
    Conditions {
        gravity: DVec3::ZERO,
        flow,
        inertia: Some(inertia),
    }
}

fn vector(limit: f64) -> impl Strategy<Value = DVec3> {
    (-limit..limit, -limit..limit, -limit..limit).prop_map(|(x, y, z)| DVec3::new(x, y, z))
}

fn rotation() -> impl Strategy<Value = DQuat> {
    proptest::array::uniform4(-1.0_f64..1.0)
        .prop_filter("too short to normalise", |q| {
            q.iter().map(|c| c * c).sum::<f64>() > 1e-3
        })
        .prop_map(|q| DQuat::from_array(q).normalize())
}

/// Moments that a solid can have: none exceeds the sum of the others.
fn solid() -> impl Strategy<Value = Inertia> {
    ([0.2_f32..3.0, 0.2_f32..3.0, 0.2_f32..3.0], rotation()).prop_map(|([a, b, c], frame)| {
        let frame = frame.to_array().map(|part| part as f32);
        Inertia::new([a + b, b + c, c + a], frame).expect("within bounds")
    })
}

fn spinning() -> impl Strategy<Value = Motion> {
    (rotation(), vector(8.0)).prop_map(|(rotation, angular)| moving(rotation, angular))
}

fn moving(rotation: DQuat, angular: DVec3) -> Motion {
    let pose = Pose {
        rotation,
        ..Pose::IDENTITY
    };
    let twist = Twist {
        linear: DVec3::ZERO,
        angular,
    };
    Motion::new(pose, twist).expect("a motion")
}

/// The inertia tensor of a body turned like this, world frame.
fn tensor(inertia: &Inertia, rotation: DQuat) -> DMat3 {
    let frame = DQuat::from_array(inertia.frame().map(f64::from)).normalize();
    let axes = DMat3::from_quat(rotation * frame);
    let moments = DVec3::from_array(inertia.moments().map(f64::from));
    axes * DMat3::from_diagonal(moments) * axes.transpose()
}

/// The laws of a body without torque, in small steps: its angular momentum stays in the world.
fn by_the_laws(start: &Motion, ticks: u32, inertia: &Inertia) -> Motion {
    let parts = 2_000;
    let h = 1.0 / 60.0 / f64::from(parts);
    let (mut q, w) = (start.pose().rotation, start.twist().angular);
    let momentum = tensor(inertia, q) * w;
    let spin = |q: DQuat| tensor(inertia, q).inverse() * momentum;
    for _ in 0..ticks * parts {
        let half = (DQuat::from_scaled_axis(spin(q) * (h * 0.5)) * q).normalize();
        q = (DQuat::from_scaled_axis(spin(half) * h) * q).normalize();
    }
    moving(q, spin(q))
}

fn apart(a: &Motion, b: &Motion) -> f64 {
    let turn = Divergence::between(&a.pose(), &b.pose()).surface_error(Metres::new(1.0));
    turn.metres() + (a.twist().angular - b.twist().angular).length()
}

proptest! {
    #[test]
    fn equal_moments_keep_the_spin(
        rotation in rotation(), frame in rotation(), angular in vector(2.5), moment in 0.01_f32..100.0,
        ticks in 0..FIVE_SECONDS, damping in 0.0_f32..0.5,
    ) {
        let flow = table(4, Damping { linear: 0.0, angular: damping });
        let ball = Inertia::new([moment; 3], frame.to_array().map(|part| part as f32)).unwrap();
        let conditions = in_weightlessness(&flow, &ball);
        let start = moving(rotation, angular);
        let ends = [Predictor::TorqueFree, Predictor::Uniform]
            .map(|predictor| predictor.predict(&start, Ticks::new(ticks), &conditions));
        prop_assert!(apart(&ends[0], &ends[1]) < 1e-9, "{}", apart(&ends[0], &ends[1]));
    }

    #[test]
    fn momentum_and_energy_stay_at_every_speed(
        start in spinning(), inertia in solid(), ticks in 1_u32..1_024, faster in 1.0_f64..6.0,
    ) {
        let start = moving(start.pose().rotation, start.twist().angular * faster);
        let flow = table(4, Damping::default());
        let end = Predictor::TorqueFree.predict(&start, Ticks::new(ticks), &in_weightlessness(&flow, &inertia));
        let momentum = |m: &Motion| tensor(&inertia, m.pose().rotation) * m.twist().angular;
        let (before, after) = (momentum(&start).length(), momentum(&end).length());
        prop_assert!((after / before - 1.0).abs() < 1e-9);
        let energy = |m: &Motion| 0.5 * m.twist().angular.dot(momentum(m));
        let change = (energy(&end) / energy(&start) - 1.0).abs();
        prop_assert!(change < 0.005, "{change} at {} rad/s", start.twist().angular.length());
    }

    #[test]
    fn the_angular_momentum_keeps_its_direction(start in spinning(), inertia in solid(), ticks in 1..FIVE_SECONDS) {
        let flow = table(4, Damping::default());
        let end = Predictor::TorqueFree.predict(&start, Ticks::new(ticks), &in_weightlessness(&flow, &inertia));
        let momentum = |m: &Motion| tensor(&inertia, m.pose().rotation) * m.twist().angular;
        let (before, after) = (momentum(&start), momentum(&end));
        let off = (after - before).length() / before.length();
        prop_assert!(off < 0.02, "{off} at {} rad/s", start.twist().angular.length());
    }

    #[test]
    fn a_prediction_continues_from_an_earlier_one(
        start in spinning(), inertia in solid(), first in 0_u32..200, then in 0_u32..200,
    ) {
        let flow = table(4, Damping::default());
        let conditions = in_weightlessness(&flow, &inertia);
        let tumbled = |from: &Motion, ticks| Predictor::TorqueFree.predict(from, Ticks::new(ticks), &conditions);
        let there = tumbled(&start, first + then);
        prop_assert!(apart(&tumbled(&tumbled(&start, first), then), &there) < 1e-7);
    }

    #[test]
    fn a_cursor_queried_back_and_forth_gives_the_same_bits(
        starts in [spinning(), spinning()], inertia in solid(),
        queries in proptest::collection::vec((any::<bool>(), 0_u32..400), 1..40),
    ) {
        let flow = table(4, Damping { linear: 0.1, angular: 0.1 });
        let conditions = in_weightlessness(&flow, &inertia);
        let mut cursor = RotationCursor::default();
        for (which, ticks) in queries {
            let (start, ticks) = (&starts[usize::from(which)], Ticks::new(ticks));
            let kept = Predictor::TorqueFree.predict_with(start, ticks, &conditions, &mut cursor);
            prop_assert_eq!(kept, Predictor::TorqueFree.predict(start, ticks, &conditions));
        }
    }
}

#[test]
fn without_known_moments_a_spin_is_kept_to_the_bit() {
    let flow = table(4, Damping::default());
    let start = moving(DQuat::from_rotation_y(0.3), DVec3::new(1.0, 2.0, 3.0));
    let unknown = Conditions {
        gravity: DVec3::NEG_Y,
        flow: &flow,
        inertia: None,
    };
    let end = |predictor: Predictor| predictor.predict(&start, Ticks::new(77), &unknown);
    assert_eq!(end(Predictor::TorqueFree), end(Predictor::Uniform));
    assert_eq!(
        end(Predictor::BallisticTorqueFree),
        end(Predictor::Ballistic)
    );
}

#[test]
fn a_spinning_rod_precesses_about_its_momentum() {
    let flow = table(4, Damping::default());
    let rod = Inertia::new([1.0, 0.1, 1.0], Inertia::OWN_AXES).unwrap();
    let start = moving(DQuat::IDENTITY, DVec3::new(1.0, 3.0, 0.0));
    let end =
        Predictor::TorqueFree.predict(&start, Ticks::new(60), &in_weightlessness(&flow, &rod));
    let kept = Predictor::Uniform.predict(&start, Ticks::new(60), &in_weightlessness(&flow, &rod));
    assert!(apart(&end, &kept) > 0.5, "{}", apart(&end, &kept));
}

#[test]
fn a_slow_body_rotates_by_the_laws() {
    let flow = table(4, Damping::default());
    let inertia = Inertia::new([1.0, 2.0, 2.5], Inertia::OWN_AXES).unwrap();
    let start = moving(DQuat::from_rotation_z(0.4), DVec3::new(0.9, -0.5, 0.7));
    let law = by_the_laws(&start, 120, &inertia);
    let conditions = in_weightlessness(&flow, &inertia);
    let end = Predictor::TorqueFree.predict(&start, Ticks::new(120), &conditions);
    assert!(apart(&end, &law) < 2e-4, "{}", apart(&end, &law));
}

/// Moments about the axes of a cuboid with these half extents.
fn cuboid(x: f32, y: f32, z: f32) -> Inertia {
    let moments = [y * y + z * z, z * z + x * x, x * x + y * y];
    Inertia::new(moments, Inertia::OWN_AXES).expect("a solid's moments")
}

#[test]
fn a_spin_about_the_axis_of_the_least_or_the_greatest_moment_stays_there() {
    let flow = table(4, Damping::default());
    for (name, inertia, spin, most) in [
        (
            "disc",
            cuboid(0.3, 0.01, 0.3),
            DVec3::new(0.0, 20.0, 0.5),
            3.0,
        ),
        (
            "rod",
            cuboid(0.05, 0.5, 0.05),
            DVec3::new(0.03, 30.0, 0.0),
            7.0,
        ),
        (
            "fast rod",
            cuboid(0.05, 0.5, 0.05),
            // An exact rotation tilts by 17 degrees. A tick turns the rod by 1.7 rad, and the direction of its momentum
            // swings.
            DVec3::new(0.3, 100.0, 0.0),
            35.0,
        ),
        (
            "book",
            cuboid(0.1, 0.02, 0.15),
            DVec3::new(0.3, 12.0, 0.3),
            6.0,
        ),
    ] {
        let start = moving(DQuat::IDENTITY, spin);
        let conditions = in_weightlessness(&flow, &inertia);
        let mut cursor = RotationCursor::default();
        for ticks in 0..TRACK_AGE_MAX.count() {
            let now = Predictor::TorqueFree.predict_with(
                &start,
                Ticks::new(ticks),
                &conditions,
                &mut cursor,
            );
            let tilt = (now.pose().rotation * DVec3::Y)
                .angle_between(DVec3::Y)
                .to_degrees();
            assert!(tilt < most, "{name}: {tilt} degrees at {ticks}");
        }
    }
}
