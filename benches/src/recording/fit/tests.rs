//! Tests of what poses and velocities say of an engine.
//!
//! Most are exact flights, whose velocities are known.

use super::*;
use crate::recording::recorded::paths;
use crate::recording::recorded::tests::recording;
use crate::recording::{ReadOptions, read_bytes};

const STEP: f64 = 1.0 / 60.0;
const GRAVITY: f64 = 9.81;
const MOMENTS: DVec3 = DVec3::new(1.0, 2.0, 2.4);

/// The velocities that a file has.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Has {
    None,
    Of(VelocityPoint),
}

/// Tumbling boxes in exact flight.
#[derive(Clone, Copy, Debug)]
struct Flights {
    bodies: u32,
    frames: u32,
    /// From the recorded place to the centre, body axes.
    centre: DVec3,
    has: Has,
    /// Of the velocities: seconds after the moment of their poses.
    late_s: f64,
}

impl Flights {
    fn of(centre: DVec3, has: Has) -> Self {
        Self {
            bodies: 20,
            frames: 120,
            centre,
            has,
            late_s: 0.0,
        }
    }

    /// The linear velocity with which a body begins.
    fn thrown(body: u32) -> DVec3 {
        let at = f64::from(body);
        DVec3::new(3.0 * (at * 1.7).sin(), 2.0 * (at * 2.3).cos(), at.sin())
    }

    /// The exact velocity in a frame.
    fn velocity(body: u32, frame: u32) -> DVec3 {
        Self::thrown(body) - DVec3::Y * (GRAVITY * STEP * f64::from(frame))
    }

    fn recording(&self) -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw".to_owned();
        text += match self.has {
            Has::None => "\n",
            Has::Of(_) => ",vx,vy,vz,wx,wy,wz\n",
        };
        let join = |of: &[f64]| of.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
        for body in 0..self.bodies {
            let side = f64::from(body);
            let mut q = DQuat::from_rotation_y(side);
            let mut own = DVec3::new(
                4.0 * side.cos(),
                3.0 - side / 10.0,
                4.0 * (side * 3.1).sin(),
            );
            for frame in 0..self.frames {
                let t = STEP * f64::from(frame);
                let at = DVec3::new(side, 60.0, 0.0) + Self::thrown(body) * t
                    - DVec3::Y * (GRAVITY * t * t / 2.0);
                let (arm, w) = (q * self.centre, q * own);
                text += &format!(
                    "{t},b{body},{},{}",
                    join(&(at - arm).to_array()),
                    join(&q.to_array())
                );
                if let Has::Of(point) = self.has {
                    let mut v = Self::velocity(body, frame) - DVec3::Y * (GRAVITY * self.late_s);
                    if point == VelocityPoint::Origin {
                        v -= w.cross(arm);
                    }
                    text += &format!(",{},{}", join(&v.to_array()), join(&w.to_array()));
                }
                text += "\n";
                (q, own) = turned(q, own);
            }
        }
        read_bytes("flights", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }
}

/// A rotation and a spin about the body's axes a frame later.
fn turned(mut q: DQuat, mut own: DVec3) -> (DQuat, DVec3) {
    let parts = 50;
    let time_s = STEP / f64::from(parts);
    let change = |own: DVec3| (MOMENTS * own).cross(own) / MOMENTS;
    for _ in 0..parts {
        let middle = own + change(own) * (time_s / 2.0);
        q = (q * DQuat::from_scaled_axis(middle * time_s)).normalize();
        own += change(middle) * time_s;
    }
    (q, own)
}

/// The greatest distance of a velocity from that with which a step of the recording's goes to the next exact place: v - g·t/2n.
fn off(recording: &Recording, frames: std::ops::Range<u32>) -> f64 {
    let substeps = f64::from(recording.integrator.substeps.get());
    let behind = DVec3::NEG_Y * (GRAVITY * STEP / substeps / 2.0);
    let mut most = 0.0_f64;
    for path in paths(recording).bodies {
        for frame in frames.clone() {
            let linear = path.states[frame as usize].motion().twist().linear;
            let exact = Flights::velocity(path.id.index(), frame) - behind;
            most = most.max((linear - exact).length());
        }
    }
    most
}

#[test]
fn velocities_become_those_of_a_step_whatever_point_they_belong_to() {
    let arm = DVec3::new(0.05, 0.02, -0.03);
    let all = [
        Has::None,
        Has::Of(VelocityPoint::Centre),
        Has::Of(VelocityPoint::Origin),
    ];
    for (centre, has) in [arm, DVec3::ZERO]
        .into_iter()
        .flat_map(|centre| all.map(|has| (centre, has)))
    {
        let mut recording = Flights::of(centre, has).recording();
        let found = find(&recording, &paths(&recording).bodies);
        let gravity = found.gravity.expect("they fall");
        assert!(
            (gravity + DVec3::Y * GRAVITY).length() < 0.01,
            "{has:?}: {gravity}"
        );
        assert!(found.instants.is_own(), "{has:?}: {:?}", found.instants);
        assert_eq!(
            found.centres.len(),
            if centre == arm { 20 } else { 0 },
            "{has:?}"
        );
        for found in found.centres.values() {
            assert!((*found - arm).length() < 1e-3, "{has:?}: {found}");
        }
        if let (true, Has::Of(point)) = (centre == arm, has) {
            assert_eq!(found.point, point);
        }
        apply(&mut recording, &found).expect("finite");
        assert_eq!(recording.integrator.substeps.get(), 1);
        let off = off(&recording, 0..120);
        assert!(off < 0.01, "{centre} {has:?}: {off} m/s");
        let again = find(&recording, &paths(&recording).bodies);
        assert!(again.centres.is_empty(), "{has:?}: {:?}", again.centres);
        let fall = again.fall.unwrap_or(1.0);
        assert!((fall - 1.0).abs() < 0.01, "{has:?}: {fall}");
    }
}

#[test]
fn velocities_of_other_moments_of_a_tick_are_shifted_and_those_of_substeps_are_not() {
    // Two substeps reach the place of a velocity of a quarter of a tick before, one that of half a tick before.
    for (late_s, substeps) in [
        (-STEP / 4.0, 2),
        (-STEP / 2.0, 1),
        (STEP / 2.0, 1),
        (STEP / 5.0, 1),
    ] {
        let flights = Flights {
            late_s,
            ..Flights::of(DVec3::ZERO, Has::Of(VelocityPoint::Centre))
        };
        let mut recording = flights.recording();
        let before = recording.truth.digest;
        let found = find(&recording, &paths(&recording).bodies);
        apply(&mut recording, &found).expect("finite");
        assert_eq!(
            recording.integrator.substeps.get(),
            substeps,
            "{late_s}: {:?}",
            found.fall
        );
        let is_shifted = late_s > 0.0;
        assert_eq!(recording.truth.digest != before, is_shifted, "{late_s}");
        let off = off(&recording, 0..120);
        assert!(off < 0.01, "{late_s}: {off} m/s");
    }
}

#[test]
fn what_lies_or_slides_keeps_its_velocity_where_those_of_flights_are_shifted() {
    let flights = Flights::of(DVec3::ZERO, Has::Of(VelocityPoint::Centre));
    let mut recording = flights.recording();
    let stops = 90;
    // From there on body 0 slides.
    let state = |frame: usize| {
        let x = (frame - stops) as f32 * STEP as f32;
        BodyState::new(
            [x, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0],
            [0.0; 3],
        )
        .expect("finite")
    };
    for (row, frame) in recording.truth.ticks.iter_mut().zip(1..) {
        for observation in row
            .iter_mut()
            .filter(|of| of.id.index() == 0 && frame >= stops)
        {
            observation.motion = state(frame);
        }
    }
    let found = find(&recording, &paths(&recording).bodies);
    assert!(found.driven.is_empty(), "{:?}", found.driven);
    apply(&mut recording, &found).expect("finite");
    let path = &paths(&recording).bodies[0];
    let linear = |frame: usize| path.states[frame].motion().twist().linear;
    assert_eq!(linear(stops + 5), DVec3::X);
    let exact = Flights::velocity(0, 20) + DVec3::Y * (GRAVITY * STEP / 2.0);
    assert!((linear(20) - exact).length() < 0.01);
}

/// When a substep damps a body.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Damps {
    /// Each substep, after gravity and before it moves.
    Before,
    /// The last one, after it moved, as this project's step does.
    After,
}

/// Bodies thrown in an engine of substeps.
fn damped(damps: Damps, damping: f64, substeps: u32) -> Recording {
    let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
    let step = STEP / f64::from(substeps);
    for body in 0..12 {
        let mut v = Flights::thrown(body) * 3.0;
        let mut p = DVec3::new(f64::from(body), 30.0, 0.0);
        for frame in 0..150 {
            let t = f64::from(frame) * STEP;
            text += &format!("{t},b{body},{},{},{},0,0,0,1,", p.x, p.y, p.z);
            text += &format!("{},{},{},0,0,0\n", v.x, v.y, v.z);
            for _ in 0..substeps {
                v -= DVec3::Y * (GRAVITY * step);
                if damps == Damps::Before {
                    v /= 1.0 + damping * step;
                }
                p += v * step;
            }
            if damps == Damps::After {
                v /= 1.0 + damping * STEP;
            }
        }
    }
    read_bytes("damped", text.as_bytes(), &ReadOptions::default()).expect("sound")
}

#[test]
fn substeps_and_gravity_of_damped_bodies_are_those_of_a_step_that_reaches_the_same_places() {
    let cases = [(0.3, 1), (0.3, 2), (0.3, 4), (1.0, 1), (0.1, 4), (0.5, 4)];
    for (damps, (damping, substeps)) in [Damps::Before, Damps::After]
        .into_iter()
        .flat_map(|damps| cases.map(|case| (damps, case)))
    {
        let mut recording = damped(damps, damping, substeps);
        let found = find(&recording, &paths(&recording).bodies);
        let case = format!("{damps:?} {damping} {substeps}: {:?}", found.fall);
        assert_eq!(
            found.fall.and_then(super::substeps),
            Some(substeps),
            "{case}"
        );
        let gravity = found.gravity.expect("they fall").y;
        let (first, engine) = match damps {
            Damps::Before => (First::Damped, gravity / found.kept_in_substep(STEP)),
            Damps::After => (First::Moved, gravity),
        };
        assert_eq!(found.instants.first, first, "{case}");
        assert!((engine + GRAVITY).abs() < 5e-3, "{case}: {engine}");
        apply(&mut recording, &found).expect("finite");
        let kept = 1.0 / (1.0 + f64::from(recording.damping.linear) * STEP);
        let step = STEP / f64::from(substeps);
        for path in paths(&recording).bodies {
            for pair in path.states.windows(2) {
                let [before, after] = [0, 1].map(|of| pair[of].motion());
                let (mut v, mut p) = (before.twist().linear, before.pose().position);
                for _ in 0..substeps {
                    v += DVec3::Y * (gravity * step);
                    p += v * step;
                }
                let off = [p - after.pose().position, v * kept - after.twist().linear];
                assert!(off[0].length() < 5e-5, "{case}: {} m", off[0]);
                assert!(off[1].length() < 5e-4, "{case}: {} m/s", off[1]);
            }
        }
    }
}

/// Bodies that spin about an axis of theirs as if nothing else were: about `axis`, with moments that are stated.
fn spinning(axis: DVec3) -> Recording {
    let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
    for body in 0..10 {
        let w = axis * (3.0 + 0.3 * f64::from(body));
        let (mut y, mut v) = (60.0, 0.0);
        for frame in 0..120 {
            let t = f64::from(frame) * STEP;
            let q = DQuat::from_scaled_axis(w * t);
            text += &format!(
                "{t},b{body},{body},{y},0,{},{},{},{},0,{v},0,{},{},{}\n",
                q.x, q.y, q.z, q.w, w.x, w.y, w.z
            );
            v -= GRAVITY * STEP;
            y += v * STEP;
        }
    }
    let mut recording =
        read_bytes("spins", text.as_bytes(), &ReadOptions::default()).expect("sound");
    let inertia = Inertia::new([1.0, 0.3, 1.1], Inertia::OWN_AXES).expect("sound");
    for placed in &mut recording.truth.placed {
        placed.inertia = Some(inertia);
    }
    recording
}

#[test]
fn a_stated_inertia_is_dropped_where_a_spin_contradicts_it_and_kept_where_it_cannot() {
    let aslant = DVec3::new(0.6, 0.8, 0.0);
    for (axis, ignore) in [(DVec3::Y, 0), (DVec3::Z, 0), (aslant, 10)] {
        let mut recording = spinning(axis);
        let found = find(&recording, &paths(&recording).bodies);
        assert_eq!(found.constant.len(), ignore, "{axis}");
        apply(&mut recording, &found).expect("finite");
        let kept = recording
            .truth
            .placed
            .iter()
            .filter(|placed| placed.inertia.is_some());
        assert_eq!(kept.count(), 10 - ignore, "{axis}");
    }
}

#[test]
fn what_no_scene_can_have_is_not_taken_and_said() {
    let before = recording(20);
    let id = before.truth.placed[0].desc.id;
    let wild = [
        Found {
            gravity: Some(DVec3::new(0.0, -2e3, 0.0)),
            ..Found::default()
        },
        Found {
            gravity: Some(DVec3::NAN),
            ..Found::default()
        },
        Found {
            kept: Some([1.0, 0.0]),
            ..Found::default()
        },
        Found {
            kept: Some([f64::NAN, 1.0]),
            ..Found::default()
        },
        Found {
            centres: BTreeMap::from([(id, DVec3::splat(1e300))]),
            ..Found::default()
        },
    ];
    for found in wild {
        let mut recording = before.clone();
        apply(&mut recording, &found).expect("finite");
        assert_eq!(recording.gravity, before.gravity, "{found:?}");
        assert_eq!(recording.damping, before.damping, "{found:?}");
        assert_eq!(recording.truth.digest, before.truth.digest, "{found:?}");
        let notes = recording.notes.len() - before.notes.len();
        assert_eq!(notes, 1, "{found:?}");
    }
}
