//! A limit holds its tolerance and never exceeds a publisher's needs.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use glam::{DQuat, DVec3, Vec3};
use rhumb_bench::limit::Limit;
use rhumb_bench::record::{Placed, Truth};
use rhumb_bench::recording::{Recording, Velocities, rhtrace};
use rhumb_bench::replay::{EnabledFeatures, ReplayConfig, run};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Shape, ShapeId};
use rhumb_protocol::stream::{Activity, Observation};
use rhumb_reckoning::{
    BodyId, BodyState, Damping, Integrator, Metres, Rate, Tick, Ticks, Tolerance,
};

use crate::bounce;

const TICKS: u64 = 300;

fn tolerance(metres: f64) -> Tolerance {
    Tolerance::from_metres(Metres::new(metres)).expect("within bounds")
}

fn limit(recording: &Recording, metres: f64) -> Limit {
    Limit::of(recording, tolerance(metres), NonZeroU32::MIN)
}

/// One box with a given pose at each tick; its velocities are recorded as zero.
fn recording(gravity: Vec3, pose: impl Fn(f64) -> (DVec3, DQuat)) -> Recording {
    let id = BodyId::new(0, 0);
    let at = |tick: u64| {
        let (position, rotation) = pose(tick as f64 / 60.0);
        let (p, q) = (position.as_vec3().to_array(), rotation.as_quat().to_array());
        Observation {
            id,
            motion: BodyState::new(p, q, [0.0; 3], [0.0; 3]).expect("finite"),
            activity: Activity::Awake,
        }
    };
    let shape = Shape::Cuboid {
        half_extents: Vec3::splat(0.2),
    };
    let placed = Placed {
        tick: Tick::ZERO,
        desc: BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0)),
        shape,
        observation: at(0),
        inertia: None,
    };
    Recording {
        name: "one".to_owned(),
        played: None,
        truth: Truth {
            placed: vec![placed],
            removed: Vec::new(),
            ticks: (1..=TICKS).map(|tick| vec![at(tick)]).collect(),
            digest: 0,
        },
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        },
        gravity,
        damping: Damping::default(),
        inertias: BTreeMap::new(),
        velocities: Velocities::Recorded,
        notes: Vec::new(),
    }
}

#[test]
fn a_straight_spinning_flight_needs_one_update() {
    let recording = recording(Vec3::ZERO, |time| {
        let turned = DQuat::from_scaled_axis(DVec3::new(1.0, -2.0, 0.5) * time);
        (DVec3::new(1.5, -0.5, 0.25) * time, turned)
    });
    let limit = limit(&recording, 0.01);
    assert_eq!(limit.fewest_updates.updates, 1, "{limit}");
    assert_eq!(limit.fewest_updates.by_predictor["uniform"], 1);
}

#[test]
fn a_ballistic_body_needs_one_update() {
    let gravity = Vec3::new(0.0, 0.0, -9.8);
    let recording = recording(gravity, |time| {
        let fallen =
            DVec3::new(2.0, 0.0, 30.0) * time - DVec3::Z * (4.9 * time * (time + 1.0 / 60.0));
        (fallen, DQuat::IDENTITY)
    });
    let limit = limit(&recording, 0.01);
    assert_eq!(limit.fewest_updates.updates, 1, "{limit}");
    assert_eq!(limit.fewest_updates.by_predictor["ballistic"], 1);
}

#[test]
fn a_constant_acceleration_needs_one_update_while_it_lasts() {
    let acceleration = DVec3::new(0.75, 0.0, -0.375);
    let recording = recording(Vec3::ZERO, |time| {
        (
            acceleration * (time * (time + 1.0 / 60.0) / 2.0),
            DQuat::IDENTITY,
        )
    });
    let limit = limit(&recording, 0.01);
    let cut = &limit.fewest_updates;
    // 300 ticks, and slightly more than 64 before the prediction leaves the tolerance.
    assert!((3..=4).contains(&cut.updates), "{limit}");
    assert_eq!(cut.by_predictor["constant-acceleration"], cut.updates);
}

#[test]
fn a_body_that_shakes_within_twice_the_tolerance_needs_one_update() {
    let recording = recording(Vec3::ZERO, |time| {
        let shaken = DVec3::X * (0.0095 * (1.0 - (time * 40.0).cos()));
        (shaken, DQuat::IDENTITY)
    });
    // The best rest pose is in the middle of the shaking, not at the start.
    let still = limit(&recording, 0.01);
    assert_eq!(still.fewest_updates.updates, 1, "{still}");
    assert_eq!(still.fewest_updates.by_predictor["rest"], 1);
    assert!(limit(&recording, 0.002).fewest_updates.updates > 20);
}

#[test]
fn a_limit_is_within_its_tolerance_and_below_a_publisher() {
    let recording = rhtrace::read("bounce", &bounce::packed()).expect("the recording is valid");
    for metres in [0.005, 0.02, 0.1] {
        let limit = limit(&recording, metres);
        let on_grid = &limit.fewest_updates_on_grid;
        assert!(limit.fewest_updates.updates <= on_grid.updates, "{limit}");
        for cut in [&limit.fewest_updates, &limit.fewest_bits, on_grid] {
            let errors = cut.surface_error_m.expect("boxes move");
            assert!(errors.max <= metres + 1e-9, "{limit}");
        }
        let config = ReplayConfig {
            tolerance: tolerance(metres),
            link: rhumb_netsim::LinkConfig::PERFECT,
            publish_interval: NonZeroU32::MIN,
            seed: 1,
            lookahead: Ticks::ZERO,
            budget: None,
            largest_packet: LargestPacket::DEFAULT,
            features: EnabledFeatures::ALL,
        };
        let run = run(&recording, &config, &mut |_| {}).expect("the replay succeeds");
        let updates: u64 = run.frames.iter().map(|frame| frame.updates).sum();
        assert!(
            limit.fewest_updates.updates < updates,
            "{metres}: {updates}"
        );
        assert!(limit.fewest_bits.kbps <= limit.fewest_updates.kbps);
    }
}

#[test]
fn one_recording_has_one_limit() {
    let recording = rhtrace::read("bounce", &bounce::packed()).expect("the recording is valid");
    assert_eq!(limit(&recording, 0.02), limit(&recording, 0.02));
}
