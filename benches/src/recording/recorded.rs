//! A recorded scene: bodies, ticks, paths, and the engine's parameters.
//!
//! It is read from a file, or made from the truth of a script that ran in this process. Then gravity and damping come
//! from the script, and inertias from an engine that gets the script's bodies and never steps. Later changes by a
//! controller or a command are not covered: gravity is the scene's initial one.
//!
//! A recording may have poses alone. A difference of neighbours would make noise of rounded poses, so a parabola is fitted
//! to the poses of up to two frames before and after. The engine's velocity is the one with which a step under gravity gives
//! the fitted path. A body is active where it has records.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::scene::{BodyKind, Command};
use rhumb_protocol::stream::{Activity, Observation, PredictionParameters};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Damping, Inertia, Integrator, Predictor, Tick, Track,
};
use rhumb_scene::{Digest, Scene};
use rhumb_sims::Script;
use rhumb_trace::SceneFacts;

use crate::record::{Change, Placed, Truth};
use crate::recording::error::RecordingError;

/// A recorded scene.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name: a scene, or the file name without its extension.
    pub name: String,
    /// Arguments of its script; none for a foreign recording.
    pub played: Option<ScriptOrigin>,
    /// Every body and every tick.
    pub truth: Truth,
    /// Integrator of the engine.
    pub integrator: Integrator,
    /// Gravity, m/s², world frame.
    pub gravity: Vec3,
    /// Damping of every body.
    pub damping: Damping,
    /// Inertia of bodies with free rotation, as far as known and not in their placements.
    pub inertias: BTreeMap<BodyId, Inertia>,
    /// The source of the velocities.
    pub velocities: Velocities,
    /// Sentences on what the file lacks, and on what was taken in its place.
    pub notes: Vec<String>,
}

/// The source of a recording's velocities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Velocities {
    /// The file, or the engine that ran.
    Recorded,
    /// The poses, to which they are fitted.
    Fitted,
}

/// Most frames of a recording: two days at 60 Hz. An empty frame takes two bytes and compresses to almost nothing.
pub(super) const FRAMES_MAX: u32 = 10_368_000;

/// Arguments that reproduce a script, besides its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScriptOrigin {
    /// Requested number of bodies.
    pub bodies: u32,
    /// Its seed.
    pub seed: u64,
}

impl Recording {
    /// Prediction parameters of a body.
    pub(crate) fn parameters(&self, placed: &Placed) -> PredictionParameters {
        let known = || self.inertias.get(&placed.desc.id).copied();
        let inertia = placed.inertia.or_else(known);
        PredictionParameters::of(&placed.desc, &placed.shape, self.damping, inertia)
    }

    /// Number of bodies requested from the script; for a foreign recording, its number of dynamic bodies.
    #[must_use]
    pub fn bodies(&self) -> u32 {
        if let Some(played) = self.played {
            return played.bodies;
        }
        let placed = self.truth.placed.iter();
        let dynamic = placed.filter(|placed| placed.desc.kind == BodyKind::Dynamic);
        dynamic.count() as u32
    }

    /// The settings of its engine that predictions need.
    #[must_use]
    pub const fn facts(&self) -> SceneFacts {
        SceneFacts {
            integrator: self.integrator,
            gravity: self.gravity,
            damping: self.damping,
        }
    }

    /// Ticks after the first state.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        self.truth.ticks.len() as u32
    }
}

impl Recording {
    /// Builds the recording; `script` must not have produced any tick yet.
    #[must_use]
    pub fn of_play(script: &mut dyn Script, truth: Truth) -> Self {
        let config = script.config();
        Self {
            name: script.name().to_owned(),
            played: None,
            inertias: inertias(script, truth.ticks.len() as u64),
            truth,
            integrator: config.integrator,
            gravity: config.gravity,
            damping: config.damping,
            velocities: Velocities::Recorded,
            notes: Vec::new(),
        }
    }
}

/// Inertia of each body with free rotation that a script adds within `ticks`.
fn inertias(script: &mut dyn Script, ticks: u64) -> BTreeMap<BodyId, Inertia> {
    let mut inertias = BTreeMap::new();
    let Ok(mut scene) = Scene::new(script.config()) else {
        return inertias;
    };
    let mut commands = Vec::new();
    for tick in 0..=ticks {
        script.commands(Tick::new(tick), &mut commands);
    }
    for command in commands {
        let creates = matches!(command, Command::AddShape { .. } | Command::AddBody { .. });
        // A command refused here has no body in the recording either.
        if creates
            && scene.apply(&command).is_ok()
            && let Command::AddBody { desc, .. } = command
            && let Some(inertia) = scene.inertia(desc.id)
        {
            inertias.insert(desc.id, inertia);
        }
    }
    inertias
}

/// The first track of a body, as a server's scene chooses it.
pub(crate) fn first_track(placed: &Placed, parameters: &PredictionParameters) -> Track {
    let is_torque_free = parameters.inertia.is_some();
    let predictor = match (placed.observation.activity, placed.desc.kind) {
        (Activity::Asleep, _) | (_, BodyKind::Fixed) => Predictor::Rest,
        (Activity::Awake, BodyKind::Dynamic) if is_torque_free => Predictor::BallisticTorqueFree,
        (Activity::Awake, BodyKind::Dynamic) => Predictor::Ballistic,
        (Activity::Awake, BodyKind::Kinematic) => Predictor::Uniform,
    };
    let motion = placed.observation.motion;
    let resting = predictor == Predictor::Rest;
    Track {
        origin: placed.tick,
        predictor,
        anchor: Anchor::Exact(if resting { motion.stilled() } else { motion }),
        parent: None,
    }
}

/// Frames on either side that a fit uses.
const REACH: usize = 2;

/// Sets the velocities of all bodies. A body whose pose does not change has none.
pub(super) fn derive(recording: &mut Recording) -> Result<(), RecordingError> {
    recording.velocities = Velocities::Fitted;
    let behind = behind(recording);
    let step_s = recording.integrator.rate.step().seconds();
    change_states(recording, |_, poses| fitted(poses, step_s, behind))
}

/// The velocity by which a body of semi-implicit steps is behind a parabola: half a substep's gravity.
pub(super) fn behind(recording: &Recording) -> DVec3 {
    let substeps = f64::from(recording.integrator.substeps.get());
    let step_s = recording.integrator.rate.step().seconds();
    recording.gravity.as_dvec3() * (step_s / substeps / 2.0)
}

/// States of these poses with fitted velocities; fewer, if one has a number that is none.
pub(super) fn fitted(poses: &[BodyState], step_s: f64, behind: DVec3) -> Vec<BodyState> {
    let all = (0..poses.len()).map(|frame| state(poses, frame, step_s, behind));
    all.map_while(|state| state).collect()
}

/// Puts those states in place of the recorded ones that `of` makes of a body's, frame by frame. A frame that has no record
/// gets none.
pub(super) fn change_states(
    recording: &mut Recording,
    of: impl Fn(BodyId, &[BodyState]) -> Vec<BodyState>,
) -> Result<(), RecordingError> {
    let mut records: BTreeMap<BodyId, Vec<(usize, usize)>> = BTreeMap::new();
    for (row, observed) in recording.truth.ticks.iter().enumerate() {
        for (place, observation) in observed.iter().enumerate() {
            records
                .entry(observation.id)
                .or_default()
                .push((row, place));
        }
    }
    let ticks = recording.truth.ticks.len();
    for (number, end) in recording.truth.ends().into_iter().enumerate() {
        let placed = &recording.truth.placed[number];
        let id = placed.desc.id;
        let path = Path {
            first: placed.tick.value() as usize,
            end: end.map_or(ticks, |tick| tick.value() as usize),
            records: records.get(&id).map_or(&[], Vec::as_slice),
        };
        let states = of(id, &path.poses(placed, &recording.truth.ticks));
        let state = |frame: usize| {
            let state = states.get(frame - path.first).copied();
            state.ok_or_else(|| RecordingError::Number {
                tick: Tick::new(frame as u64),
                index: id.index(),
            })
        };
        recording.truth.placed[number].observation.motion = state(path.first)?;
        for (row, place) in path.records {
            let frame = row + 1;
            if (path.first + 1..=path.end).contains(&frame) {
                recording.truth.ticks[*row][*place].motion = state(frame)?;
            }
        }
    }
    Ok(())
}

/// One body between its placement and its removal.
struct Path<'a> {
    first: usize,
    end: usize,
    /// Row and place of each of its records, of all generations.
    records: &'a [(usize, usize)],
}

impl Path<'_> {
    /// Its pose in each frame.
    fn poses(&self, placed: &Placed, ticks: &[Vec<Observation>]) -> Vec<BodyState> {
        let mut poses = vec![placed.observation.motion];
        let mut records = self.records.iter().peekable();
        for frame in self.first + 1..=self.end {
            while records.peek().is_some_and(|(row, _)| row + 1 < frame) {
                records.next();
            }
            let record = records.next_if(|(row, _)| row + 1 == frame);
            let last = poses[poses.len() - 1];
            poses.push(record.map_or(last, |(row, place)| ticks[*row][*place].motion));
        }
        poses
    }
}

/// The state of a body in a frame, with the fitted velocities.
fn state(poses: &[BodyState], frame: usize, step_s: f64, behind: DVec3) -> Option<BodyState> {
    let here = poses[frame];
    let from = frame.saturating_sub(REACH);
    let to = (frame + REACH).min(poses.len() - 1);
    let is_still = |other: &BodyState| {
        other.position() == here.position() && other.rotation() == here.rotation()
    };
    let near = &poses[frame.saturating_sub(1)..=(frame + 1).min(poses.len() - 1)];
    let (mut linear, mut angular) = (DVec3::ZERO, DVec3::ZERO);
    if !near.iter().all(is_still) {
        let offset = |other: usize| other as f64 - frame as f64;
        let moved = (from..=to).map(|other| (offset(other), shift(&here, &poses[other])));
        let turned = (from..=to).map(|other| (offset(other), turn(&here, &poses[other])));
        linear = slope(moved) / step_s - behind;
        angular = slope(turned) / step_s;
    }
    let (linear, angular) = (linear.as_vec3().to_array(), angular.as_vec3().to_array());
    BodyState::new(here.position(), here.rotation(), linear, angular).ok()
}

fn shift(from: &BodyState, to: &BodyState) -> DVec3 {
    let position = |state: &BodyState| DVec3::from_array(state.position().map(f64::from));
    position(to) - position(from)
}

/// The turn between two rotations as axis times angle, world frame.
fn turn(from: &BodyState, to: &BodyState) -> DVec3 {
    let rotation =
        |state: &BodyState| DQuat::from_array(state.rotation().map(f64::from)).normalize();
    let between = rotation(to) * rotation(from).conjugate();
    let between = if between.w < 0.0 { -between } else { between };
    let half_sine = between.xyz();
    let length = half_sine.length();
    if length < 1e-9 {
        return half_sine * 2.0;
    }
    half_sine * (2.0 * length.atan2(between.w) / length)
}

/// The slope at zero of the parabola that fits the values best; of the line where there are two.
fn slope(values: impl Iterator<Item = (f64, DVec3)>) -> DVec3 {
    // Sums of powers of the offsets, and of offsets times values.
    let (mut sums, mut products) = ([0.0; 5], [DVec3::ZERO; 3]);
    for (offset, value) in values {
        for (power, sum) in sums.iter_mut().enumerate() {
            *sum += offset.powi(power as i32);
        }
        for (power, product) in products.iter_mut().enumerate() {
            *product += value * offset.powi(power as i32);
        }
    }
    let [n, s1, s2, s3, s4] = sums;
    if n < 2.5 {
        let spread = n * s2 - s1 * s1;
        return if spread > 0.0 {
            (products[1] * n - products[0] * s1) / spread
        } else {
            DVec3::ZERO
        };
    }
    // Cramer's rule for the middle coefficient of the normal equations.
    let whole = n * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s2 * s3) + s2 * (s1 * s3 - s2 * s2);
    let [p0, p1, p2] = products;
    (p1 * (n * s4 - s2 * s2) - p0 * (s1 * s4 - s2 * s3) - p2 * (n * s3 - s1 * s2)) / whole
}

/// Derives activity from the records. A body with a record in the next frame moves, so it is awake; a body without one
/// has not changed, so it sleeps.
pub(super) fn activity_from_records(truth: &mut Truth) {
    for placed in &mut truth.placed {
        let next = truth.ticks.get(placed.tick.value() as usize);
        let moves = next.is_some_and(|row| has(row, &placed.observation));
        placed.observation.activity = of(moves);
    }
    for next in 1..truth.ticks.len() {
        let (before, after) = truth.ticks.split_at_mut(next);
        for observation in &mut before[next - 1] {
            observation.activity = of(has(&after[0], observation));
        }
    }
}

const fn of(moves: bool) -> Activity {
    if moves {
        Activity::Awake
    } else {
        Activity::Asleep
    }
}

/// True if a row, which is in the order of indices, has the body.
fn has(row: &[Observation], of: &Observation) -> bool {
    let found = row.binary_search_by_key(&of.id.index(), |observation| observation.id.index());
    found.is_ok()
}

/// Sets the digest over all observations.
pub(super) fn set_digest(truth: &mut Truth) {
    let mut digest = Digest::START;
    for (row, tick) in truth.ticks.iter().zip(1..) {
        digest.fold_tick(Tick::new(tick), row);
    }
    truth.digest = digest.value();
}

/// Least number of free frames of a body that says something.
pub(crate) const FREE_MIN: usize = 8;

/// One body in every frame of its stay.
pub(crate) struct BodyPath {
    pub(crate) id: BodyId,
    pub(crate) states: Vec<BodyState>,
    /// Bounding radius, metres.
    pub(crate) radius: f64,
}

/// The states of all bodies that can move, frame by frame.
///
/// A recording has a row for each frame, of the bodies that move in it. A path has a state for each frame of a body's stay.
pub(crate) struct Paths {
    pub(crate) bodies: Vec<BodyPath>,
    /// Frames from the first that were read.
    pub(crate) frames: usize,
}

/// Most states of all paths: a body that rests has no records and yet a state in each frame. More hardly change a fit.
const STATES_MAX: usize = 10_000_000;

/// The states of all bodies that can move, as long as there are not too many.
pub(crate) fn paths(recording: &Recording) -> Paths {
    paths_within(recording, STATES_MAX)
}

fn paths_within(recording: &Recording, most: usize) -> Paths {
    let truth = &recording.truth;
    let mut open: BTreeMap<BodyId, BodyPath> = BTreeMap::new();
    let mut done = Vec::new();
    let mut changes = truth.changes();
    let (mut states, mut frames) = (0, 0);
    for frame in 0..=truth.ticks.len() {
        states += open.len();
        if states > most {
            break;
        }
        frames += 1;
        for path in open.values_mut() {
            path.states.extend(path.states.last().copied());
        }
        let row = frame
            .checked_sub(1)
            .map_or(&[][..], |row| &truth.ticks[row]);
        for observation in row {
            if let Some(last) = open
                .get_mut(&observation.id)
                .and_then(|path| path.states.last_mut())
            {
                *last = observation.motion;
            }
        }
        while let Some(change) = changes.until(Tick::new(frame as u64)) {
            match change {
                Change::Placed(_, one) if one.desc.kind != BodyKind::Fixed => {
                    let path = BodyPath {
                        id: one.desc.id,
                        states: vec![one.observation.motion],
                        radius: one.shape.bounding_radius().metres(),
                    };
                    open.insert(one.desc.id, path);
                }
                Change::Placed(..) => {}
                Change::Removed(id) => done.extend(open.remove(&id)),
            }
        }
    }
    done.extend(open.into_values());
    Paths {
        bodies: done,
        frames,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::recording::{ReadOptions, read_bytes};

    /// A body that falls, and one that rests, for some frames.
    pub(in crate::recording) fn recording(frames: u32) -> Recording {
        let mut text = "time,body,x,y,z,qx,qy,qz,qw,vx,vy,vz,wx,wy,wz\n".to_owned();
        for frame in 0..frames {
            let y = f64::from(frame) * 0.1;
            let x = 0.01 * f64::from(frame % 2);
            text +=
                &format!("{y},a,{y},0,0,0,0,0,1,1,0,0,0,0,0\n{y},b,{x},5,0,0,0,0,1,0,0,0,0,0,0\n");
        }
        read_bytes("r", text.as_bytes(), &ReadOptions::default()).expect("sound")
    }

    #[test]
    fn the_states_of_paths_are_bounded_by_frames_from_the_first() {
        let recording = recording(100);
        let all = paths(&recording);
        assert_eq!((all.frames, all.bodies.len()), (100, 2));
        let few = paths_within(&recording, 60);
        assert_eq!((few.frames, few.bodies.len()), (31, 2));
        assert!(few.bodies.iter().all(|path| path.states.len() == 31));
    }

    #[test]
    fn a_parabola_s_slope_is_exact_at_its_ends_and_within() {
        let at = |t: f64| DVec3::new(3.0 * t, -2.0 * t * t + t, 5.0);
        for offsets in [
            vec![-2, -1, 0, 1, 2],
            vec![0, 1, 2],
            vec![-2, -1, 0],
            vec![-1, 0, 1, 2],
        ] {
            let values = offsets
                .iter()
                .map(|offset| (f64::from(*offset), at(f64::from(*offset))));
            let found = slope(values);
            assert!(
                (found - DVec3::new(3.0, 1.0, 0.0)).length() < 1e-12,
                "{offsets:?} {found}"
            );
        }
        assert_eq!(
            slope([(0.0, DVec3::ONE), (1.0, DVec3::ONE * 3.0)].into_iter()),
            DVec3::ONE * 2.0
        );
        assert_eq!(slope([(0.0, DVec3::ONE)].into_iter()), DVec3::ZERO);
    }

    #[test]
    fn a_steady_turn_has_its_angular_velocity_beyond_half_a_turn() {
        let pose = |angle: f64| {
            let q = DQuat::from_axis_angle(DVec3::Y, angle).as_quat().to_array();
            // Either sign is the same rotation.
            let q = if angle > 3.5 { q.map(|part| -part) } else { q };
            BodyState::new([0.0; 3], q, [0.0; 3], [0.0; 3]).unwrap()
        };
        let poses: Vec<_> = (0..9).map(|frame| pose(f64::from(frame) * 0.5)).collect();
        for frame in 0..9 {
            let state = state(&poses, frame, 0.1, DVec3::ZERO).unwrap();
            let [_, _, _, _, _, _, _, _, _, _, x, y, z] = state.parts();
            assert!(
                (y - 5.0).abs() < 1e-4 && x.abs() + z.abs() < 1e-4,
                "{frame}: {x} {y} {z}"
            );
        }
    }
}
