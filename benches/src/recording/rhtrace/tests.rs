//! Foreign recordings: read, written, and refused by name.

use super::*;
use crate::recording::{ReadOptions, read_bytes};

fn recording() -> Recording {
    let text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n\
                0,a,0,0,0,0,0,0,1,1,0,0,0,0,2\n0,b,5,0,0,0,0,0,1,0,0,0,0,0,0\n\
                0.02,a,0.02,0,0,0,0,0.02,0.9998,1,0,0,0,0,2\n0.04,a,0.04,0,0,0,0,0.04,0.9992,1,0,0,0,0,2\n";
    let options = ReadOptions {
        shapes: vec!["cuboid:1,2,3".parse().expect("a shape")],
        gravity: Some(Vec3::new(0.0, -1.5, 0.0)),
        ..ReadOptions::default()
    };
    let mut recording = read_bytes("r", text.as_bytes(), &options).expect("sound");
    let inertia = Inertia::new([1.0, 2.0, 2.5], Inertia::OWN_AXES).expect("sound");
    recording.truth.placed[0].inertia = Some(inertia);
    recording.damping.linear = 0.5;
    recording
}

#[test]
fn what_is_written_is_read_as_it_was() {
    let recording = recording();
    let bytes = write(&recording).expect("few bodies");
    let again = read_bytes("r", &bytes, &ReadOptions::default()).expect("sound");
    assert_eq!(again.truth.digest, recording.truth.digest);
    assert_eq!(again.truth.removed, recording.truth.removed);
    assert_eq!(again.integrator, recording.integrator);
    assert_eq!(again.gravity, recording.gravity);
    let placed = &again.truth.placed[0];
    assert_eq!(placed.inertia, recording.truth.placed[0].inertia);
    assert_eq!(placed.shape, recording.truth.placed[0].shape);
    assert_eq!(placed.desc.damping.map(|damping| damping.linear), Some(0.5));
    assert_eq!(again.truth.placed[1].desc.kind, BodyKind::Fixed);
    assert_eq!(write(&again).expect("few bodies"), bytes);
}

#[test]
fn a_body_that_rests_when_it_goes_is_gone_and_its_index_is_another_s_at_once() {
    let mut recording = recording();
    let first = recording.truth.placed[0].clone();
    let id = first.desc.id;
    // The other body has no record after its first.
    let still = recording.truth.placed[1].desc.id;
    let other = BodyId::new(id.index(), 1);
    let mut second = first;
    second.tick = Tick::new(2);
    second.desc.id = other;
    second.observation.id = other;
    recording.truth.placed.push(second);
    recording.truth.ticks[1].clear();
    recording.truth.removed = vec![(Tick::new(1), still), (Tick::new(2), id)];
    activity_from_records(&mut recording.truth);
    set_digest(&mut recording.truth);
    let bytes = write(&recording).expect("few bodies");
    let again = read_bytes("r", &bytes, &ReadOptions::default()).expect("sound");
    // The last frame of a body whose index begins anew in that of its removal is the one before.
    let removed = [(Tick::new(1), id), (Tick::new(1), still)];
    assert_eq!(again.truth.removed, removed);
    assert_eq!(again.truth.digest, recording.truth.digest);
    let ids = again.truth.placed.iter().map(|placed| placed.desc.id);
    assert_eq!(ids.collect::<Vec<_>>(), [id, still, other]);
    assert_eq!(write(&again).expect("few bodies"), bytes);
}

#[test]
fn flags_that_stand_for_nothing_are_refused() {
    let whole = write(&recording()).expect("few bodies");
    let sound = read_bytes("r", &whole, &ReadOptions::default()).is_ok();
    assert!(sound);
    // The last byte is the flags of the last record, of a body that is there.
    let last = whole.len() - 1;
    let with = |at: usize, flags: u8| {
        let mut bytes = whole.clone();
        bytes[at] = flags;
        read_bytes("r", &bytes, &ReadOptions::default()).map_err(|error| error.to_string())
    };
    for flags in [AWAKE, GONE, AWAKE | GONE, GONE | UNCHANGED] {
        assert!(with(last, flags).is_ok(), "{flags}");
    }
    for flags in [UNCHANGED, AWAKE | UNCHANGED, 8, 0x80 | AWAKE, 255] {
        let error = with(last, flags).expect_err("no such flags");
        assert!(error.contains(&format!("has the flags {flags}")), "{error}");
    }
    // A first record places its body: two frames of one record follow the one of two.
    let record = 4 + 13 * 4 + 1;
    let second = whole.len() - 2 * (4 + record) - 1;
    assert_eq!(with(second, AWAKE).map(|_| ()), Ok(()));
    for flags in [UNCHANGED, GONE | UNCHANGED] {
        let error = with(second, flags).expect_err("it was not there");
        assert!(error.contains("body 1 at"), "{error}");
    }
}

#[test]
fn substeps_and_gravity_beyond_a_scene_s_are_refused() {
    let whole = write(&recording()).expect("few bodies");
    for (at, with, part) in [
        (24, 17_u32.to_le_bytes(), "number of substeps (1 to 16)"),
        (24, u32::MAX.to_le_bytes(), "number of substeps (1 to 16)"),
        (28, 2e3_f32.to_le_bytes(), "the gravity"),
    ] {
        let mut bytes = whole.clone();
        bytes[at..at + 4].copy_from_slice(&with);
        let read = read_bytes("r", &bytes, &ReadOptions::default());
        let error = read.expect_err(part).to_string();
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn every_cut_and_claim_is_refused_with_its_place() {
    let bytes = write(&recording()).expect("few bodies");
    for cut in 0..bytes.len() {
        let read = read_bytes("r", &bytes[..cut], &ReadOptions::default());
        assert!(read.is_err(), "{cut}");
    }
    let error = |at: usize, with: &[u8]| {
        let mut bytes = bytes.clone();
        bytes[at..at + with.len()].copy_from_slice(with);
        let read = read_bytes("r", &bytes, &ReadOptions::default());
        read.expect_err("it is wrong").to_string()
    };
    let many = error(8, &10_000_000_u32.to_le_bytes());
    assert_eq!(
        many,
        "the file claims 10000000 bodies, and a scene has 131072 at most"
    );
    let nan = f32::NAN.to_le_bytes();
    assert!(error(28, &nan).contains("the gravity"));
    assert!(error(40, &[9]).contains("damping formula"));
    // The first body's gravity factor and centre.
    assert!(error(52, &nan).contains("body 0 of frame 0: the gravity factor"));
    assert!(error(56, &nan).contains("body 0 of frame 0: the centre of mass"));
}

#[test]
fn poses_of_an_origin_become_those_of_the_centre() {
    let mut bytes = write(&recording()).expect("few bodies");
    bytes[41] = 1;
    // A metre along the body's x.
    bytes[56..60].copy_from_slice(&1.0_f32.to_le_bytes());
    let read = read_bytes("r", &bytes, &ReadOptions::default()).expect("sound");
    let motion = read.truth.placed[0].observation.motion;
    assert_eq!(motion.position(), [1.0, 0.0, 0.0]);
    let velocity = motion.motion().twist().linear;
    // The spin of 2 rad/s about z moves it.
    assert!(
        (velocity - glam::DVec3::new(1.0, 2.0, 0.0)).length() < 1e-6,
        "{velocity}"
    );
}

#[test]
fn each_damping_formula_takes_as_much_in_a_tick_as_ours() {
    let step = 0.01;
    for (number, d, kept) in [
        (0, 0.5_f32, 1.0 / 1.005),
        (1, 0.5, (-0.005_f64).exp()),
        (2, 0.5, 0.995),
        (3, 0.5, 0.5_f64.powf(0.01)),
    ] {
        let ours = DampingFormula::of(number).and_then(|formula| formula.ours(d, step));
        let ours = f64::from(ours.expect("in range"));
        assert!((1.0 / (1.0 + ours * step) - kept).abs() < 1e-8, "{number}");
    }
    assert_eq!(DampingFormula::Share.ours(1.0, step), None);
    assert_eq!(DampingFormula::Implicit.ours(f32::NAN, step), None);
}
/// A body of two stays and another one, whose second stay is of another kind.
fn of_two_kinds() -> Recording {
    let mut text = "time,body,x,y,z,qx,qy,qz,qw\n".to_owned();
    for frame in 0..30 {
        let t = f64::from(frame) * 0.01;
        text += &format!("{t},a,{t},0,0,0,0,0,1\n");
        if !(10..20).contains(&frame) {
            text += &format!("{t},b,0,{t},0,0,0,0,1\n");
        }
    }
    let mut recording = read_bytes("r", text.as_bytes(), &ReadOptions::default()).expect("sound");
    let again = &mut recording.truth.placed[2];
    assert_eq!(again.desc.id, BodyId::new(1, 1));
    again.shape = Shape::Cuboid {
        half_extents: Vec3::new(1.0, 2.0, 3.0),
    };
    let inertia = Inertia::new([1.0, 2.0, 2.5], Inertia::OWN_AXES).expect("sound");
    again.inertia = Some(inertia);
    again.desc.gyroscopic = true;
    again.desc.damping = Some(Damping {
        linear: 0.5,
        angular: 0.25,
    });
    recording
}

/// Each stay of a file: its ticks, its damping, its shape.
fn described(recording: &Recording) -> Vec<(u64, Option<u64>, Damping, String)> {
    let ends = recording.truth.ends();
    let of = |(placed, end): (&Placed, &Option<Tick>)| {
        let damping = placed.desc.damping.unwrap_or(recording.damping);
        let kind = (placed.desc.kind, placed.desc.gyroscopic);
        let rest = format!("{kind:?} {:?} {:?}", placed.shape, placed.inertia);
        (placed.tick.value(), end.map(Tick::value), damping, rest)
    };
    recording.truth.placed.iter().zip(&ends).map(of).collect()
}

#[test]
fn stays_that_differ_keep_their_shape_inertia_and_damping() {
    let recording = of_two_kinds();
    let bytes = write(&recording).expect("few bodies");
    let again = read_bytes("r", &bytes, &ReadOptions::default()).expect("sound");
    assert_eq!(described(&again), described(&recording));
    // The same with an exchange in one tick, of one id.
    let mut recording = of_two_kinds();
    let truth = &mut recording.truth;
    truth.removed[0].0 = Tick::new(15);
    let mut last = truth.placed.pop().expect("three");
    (last.tick, last.desc.id) = (Tick::new(15), BodyId::new(1, 0));
    last.observation.id = last.desc.id;
    truth.placed.push(last);
    for observation in truth.ticks.iter_mut().flatten() {
        if observation.id.index() == 1 {
            observation.id = BodyId::new(1, 0);
        }
    }
    let bytes = write(&recording).expect("few bodies");
    let again = read_bytes("r", &bytes, &ReadOptions::default()).expect("sound");
    assert_eq!(described(&again), described(&recording));
}

#[test]
fn more_stays_than_an_id_can_say_are_refused() {
    let mut recording = recording();
    let placed = recording.truth.placed[1].clone();
    let id = placed.desc.id;
    let count = 65_537;
    let truth = &mut recording.truth;
    truth.placed = (0..count)
        .map(|tick| Placed {
            tick: Tick::new(tick),
            ..placed.clone()
        })
        .collect();
    truth.removed = (0..count).map(|tick| (Tick::new(tick), id)).collect();
    truth.ticks = vec![Vec::new(); count as usize];
    let bytes = write(&recording).expect("few bodies");
    let error = read_bytes("r", &bytes, &ReadOptions::default()).expect_err("one too many");
    assert!(
        error
            .to_string()
            .contains("body 0 comes more than 65536 times"),
        "{error}"
    );
}
