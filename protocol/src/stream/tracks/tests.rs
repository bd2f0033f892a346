//! The table of tracks: interned parameters, gravity, sizes.

use rhumb_reckoning::BodyState;

use super::*;
use crate::scene::{LockedAxes, ShapeId};

#[test]
fn a_damping_without_bodies_leaves_its_place_to_another() {
    let integrator = Integrator {
        rate: rhumb_reckoning::Rate::HZ_60,
        substeps: NonZeroU32::MIN,
    };
    let mut tracks = Tracks::new(Tolerance::NORMAL, integrator, NonZeroU32::MIN, Vec3::ZERO);
    let start = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0; 3]);
    let track = Track {
        predictor: Predictor::Uniform,
        anchor: rhumb_reckoning::Anchor::Exact(start.unwrap()),
        ..Track::resting(Tick::ZERO, start.unwrap())
    };
    let place = |tracks: &mut Tracks, index: usize, linear: f32| {
        let angular = 0.0;
        let parameters = PredictionParameters {
            damping: Damping { linear, angular },
            ..PredictionParameters::plain(Metres::new(0.5))
        };
        tracks.place(BodyId::new(index as u32, 0), &parameters, track, None)
    };
    for index in 0..DAMPINGS_MAX {
        assert!(place(&mut tracks, index, index as f32));
    }
    assert!(!place(&mut tracks, 100, 1_000.0));
    // The only body of a damping takes another one, or goes.
    assert!(place(&mut tracks, 7, 1_000.0));
    assert!(tracks.remove(BodyId::new(9, 0)));
    assert!(place(&mut tracks, 100, 500.0));
    assert!(!place(&mut tracks, 101, 7.0));
    for (index, slows) in [(7, true), (8, true), (100, true), (0, false)] {
        let slot = tracks.slot(index).unwrap();
        let moved = tracks
            .predicted_motion((index, slot), Tick::new(60))
            .pose()
            .position
            .x;
        assert_eq!(moved < 0.2, slows, "{index}: {moved}");
    }
}

#[test]
fn unknown_inertia_is_not_used() {
    let id = BodyId::new(0, 0);
    let plain = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
    let shape = Shape::Ball { radius: 0.5 };
    let inertia = Inertia::new([1.0, 2.0, 2.5], [0.0, 0.0, 0.0, 1.0]).unwrap();
    let (free, locked) = (LockedAxes::NONE, LockedAxes::ROTATIONS);
    for (gyroscopic, locked) in [(true, free), (true, locked), (false, free), (false, locked)] {
        let desc = BodyDesc {
            gyroscopic,
            locked,
            ..plain
        };
        let parameters = PredictionParameters::of(&desc, &shape, Damping::default(), Some(inertia));
        assert_eq!(parameters.inertia.is_some(), desc.can_tumble());
    }
}

#[test]
fn a_slot_stays_small() {
    assert!(size_of::<Option<Slot>>() <= 68, "{}", size_of::<Slot>());
}

fn interned(radius: f64, inertia: Option<Inertia>) -> InternedParameters {
    let radius = Metres::new(radius);
    InternedParameters {
        radius,
        gravity_scale: 1.0,
        inertia,
        flow: 0,
        tolerance_scale: ToleranceScale::USUAL,
        label: None,
        tolerance: Tolerance::NORMAL,
        grid: Grid::new(Tolerance::NORMAL, radius),
    }
}

#[test]
fn parameters_differing_in_one_bit_are_distinct() {
    let mut interned_parameters = InternedParameterTable::default();
    let slab = |last| Inertia::new([1.0, 2.0, last], Inertia::OWN_AXES).ok();
    let (thick, thin) = (slab(2.9), slab(2.9_f32.next_down()));
    let bodies = [
        (0.5, None),
        (0.5, thick),
        (0.5, None),
        (0.5, thin),
        (0.5_f64.next_up(), None),
    ];
    let numbers =
        bodies.map(|(radius, inertia)| interned_parameters.join(interned(radius, inertia)));
    assert_eq!(numbers, [0, 1, 0, 2, 3]);
}

#[test]
fn a_track_keeps_the_gravity_of_its_origin() {
    let mut gravity_history = GravityHistory::new(Vec3::NEG_Y);
    gravity_history.change(Tick::new(10), Vec3::X);
    gravity_history.change(Tick::new(10), Vec3::Z);
    assert_eq!(gravity_history.at(Tick::new(9)), DVec3::NEG_Y);
    assert_eq!(gravity_history.at(Tick::new(10)), DVec3::Z);
}

#[test]
fn replayed_changes_give_the_same_gravity() {
    let mut gravity_history = GravityHistory::new(Vec3::NEG_Y);
    for (tick, gravity) in [(100, Vec3::X), (200, Vec3::ZERO), (4_000, Vec3::Z)] {
        gravity_history.change(Tick::new(tick), gravity);
    }
    let mut replayed = GravityHistory::new(Vec3::Z);
    for (since, gravity) in gravity_history.changes() {
        replayed.change(since, gravity);
    }
    for tick in 0..5_000 {
        assert_eq!(
            replayed.at(Tick::new(tick)),
            gravity_history.at(Tick::new(tick))
        );
    }
}

#[test]
fn unreferenced_gravity_is_forgotten() {
    let mut gravity_history = GravityHistory::new(Vec3::NEG_Y);
    for tick in 0..10_000 {
        gravity_history.change(Tick::new(tick), Vec3::X);
    }
    assert!(gravity_history.changes.len() <= TRACK_AGE_MAX.count() as usize + 2);
}
