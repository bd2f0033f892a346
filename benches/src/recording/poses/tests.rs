//! Frames of a constant rate, made of poses by time.

use super::*;

/// Bodies with poses at these milliseconds, at x of as many millimetres.
fn poses(of_bodies: &[&[i64]]) -> TimedPoses {
    let mut poses = TimedPoses::default();
    for (body, times) in of_bodies.iter().enumerate() {
        let number = poses.body(&body.to_string(), None).expect("few");
        poses.poses.extend(times.iter().map(|time| TimedPose {
            at_ns: time * 1_000_000,
            body: number,
            position: DVec3::X * (*time as f64 * 1e-3),
            rotation: DQuat::IDENTITY,
            velocity: None,
            place: Place::Whole,
        }));
    }
    poses
}

/// The milliseconds of a body's poses after resampling.
fn resampled(times: &[i64], hertz: u32) -> Vec<i64> {
    let mut poses = poses(&[times]);
    let rate = Rate::new(hertz, 1).expect("a rate");
    poses.resample(rate).expect("few poses");
    let rows = poses.poses.iter();
    rows.map(|pose| (pose.at_ns as f64 / 1e6).round() as i64)
        .collect()
}

#[test]
fn no_frame_of_a_body_is_lost_at_its_ends_and_beside_its_gaps() {
    let kept = [0, 100, 200, 300, 1_000, 1_100, 1_200];
    assert_eq!(resampled(&kept, 10), kept);
    assert_eq!(resampled(&kept[..4], 20), [0, 50, 100, 150, 200, 250, 300]);
    // The last frame lies before the last pose.
    assert_eq!(resampled(&[0, 100, 200, 290], 10), [0, 100, 200]);
    // A pose between two gaps, and one at the end, stay at the nearest frames.
    let lone = [0, 100, 200, 1_010, 2_000, 2_100, 2_200, 3_590];
    let frames = [0, 100, 200, 1_000, 2_000, 2_100, 2_200, 3_600];
    assert_eq!(resampled(&lone, 10), frames);
    // A thirtieth of a second is no whole number of nanoseconds.
    let thirtieths: Vec<i64> = (0..90).map(|frame| (frame * 1_000 + 15) / 30).collect();
    assert_eq!(resampled(&thirtieths, 30).len(), 90);
    assert_eq!(resampled(&[5], 10), [5]);
    assert_eq!(resampled(&[5, 5, 5], 10), [5]);
}

#[test]
fn poses_between_far_moments_are_refused_before_they_are_made() {
    let far = i64::MAX / 1_000_000;
    for times in [&[0, far][..], &[-far, 0, far][..]] {
        let mut poses = poses(&[times]);
        let rate = Rate::new(1_000, 1).expect("a rate");
        let error = poses.resample(rate).expect_err("too many");
        assert!(matches!(error, RecordingError::Poses { most, .. } if most == 10_368_000));
        assert!(error.to_string().contains("a lower --resample"), "{error}");
    }
}

#[test]
fn a_parent_of_many_frames_does_not_multiply_them_by_its_children_without_bound() {
    let times: Vec<i64> = (0..2_000).map(|frame| frame * 10).collect();
    let mut poses = poses(&[&times]);
    for child in 0..10_000 {
        let body = poses
            .body(&format!("child {child}"), Some("0"))
            .expect("few");
        let first = poses.poses[0].clone();
        poses.poses.push(TimedPose { body, ..first });
    }
    let read = poses.recording("r", &ReadOptions::default());
    let error = read.expect_err("twenty million poses");
    assert!(matches!(error, RecordingError::Poses { .. }), "{error}");
}
#[test]
fn more_stays_than_an_id_can_say_are_refused_by_the_name_of_the_body() {
    let read = |stays: i64| {
        let times: Vec<i64> = (0..stays).map(|stay| stay * 50).collect();
        let options = ReadOptions {
            rate: Rate::new(100, 1),
            ..ReadOptions::default()
        };
        poses(&[&[0], &times]).recording("r", &options)
    };
    let most = read(65_536).expect("as many as an id can say");
    let last = most.truth.placed.last().expect("many");
    assert_eq!(last.desc.id, BodyId::new(1, u16::MAX));
    let error = read(65_537).expect_err("one more").to_string();
    assert!(
        error.contains("body 1 comes more than 65536 times"),
        "{error}"
    );
}
