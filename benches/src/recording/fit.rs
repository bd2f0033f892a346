//! Parameters of the engine that recorded poses, as the poses tell them.
//!
//! Gravity, centre of mass, inertia, damping, substeps.
//!
//! A body is taken as free where its centre accelerates evenly. A fit of least squares to each body's second differences
//! finds its acceleration and the place that moves so; poses that fit badly are left out, and the fit is repeated. Then the
//! momentum of free bodies tells their moments, and the change of velocities gravity, damping and substeps. A body that
//! accelerates otherwise than most, or whose spin changes as no moments explain, is driven: it tells nothing. If positions are
//! not those of the centres, all is found again from the centres and their velocities; if the velocities hold for other moments
//! than this project's, again from those of this project's moments.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU32;

use glam::{DMat3, DQuat, DVec3};
use rhumb_protocol::limits::{DAMPING_MAX, GRAVITY_MAX};
use rhumb_reckoning::{BodyId, BodyState, Inertia};

use super::error::RecordingError;
use super::estimates::{self, Fall, First, Instants, Kept, SpinMoments, median, solve};
use super::recorded::{self, BodyPath, FREE_MIN, Recording, Velocities, set_digest};

/// The point of a body to which its recorded velocities belong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum VelocityPoint {
    #[default]
    Centre,
    /// The recorded place.
    Origin,
}

/// The parameters that were found.
#[derive(Clone, Debug, Default)]
pub(crate) struct Found {
    /// m/s², the median over bodies.
    pub(crate) gravity: Option<DVec3>,
    /// Centres of mass from the recorded places, body axes, metres; those that matter.
    pub(crate) centres: BTreeMap<BodyId, DVec3>,
    /// Principal moments, of which only ratios matter, and their axes; of bodies whose spin wanders.
    pub(crate) inertias: BTreeMap<BodyId, ([f64; 3], DQuat)>,
    /// The point to which the velocities belong.
    pub(crate) point: VelocityPoint,
    /// Bodies that spin freely at a constant spin, whatever their shape.
    pub(crate) constant: BTreeSet<BodyId>,
    /// Bodies that something drives: they accelerate otherwise than most, or turn as no free body does.
    pub(crate) driven: BTreeSet<BodyId>,
    /// Share of the linear velocity, and of the angular momentum, that stays after a second.
    pub(crate) kept: Option<[f64; 2]>,
    /// (n + 1) / 2n of n substeps: 1 for one, 0.5 for exact parabolas, 0 where the old velocity moves a body.
    pub(crate) fall: Option<f64>,
    /// The moment of the recorded velocities; all else is of velocities of this project's step.
    pub(crate) instants: Instants,
    /// Frames in which a body was free, of all in which it moved.
    pub(crate) free: [usize; 2],
}

/// Rounds of a fit, each without what fitted worst before.
const ROUNDS: usize = 8;
/// Distance of a centre from the origin that matters, as a share of the radius.
const CENTRE_SHARE: f64 = 0.02;

/// Largest distance of a centre of mass from the recorded place, metres.
const CENTRE_MAX: f64 = 1_000.0;

/// Damping that is noise, 1/s.
const DAMPING_NOISE: f64 = 1e-3;

/// Most substeps that are distinguished.
const SUBSTEPS_MAX: u32 = 8;

/// The share of g·t² by which a body falls beside its velocity in a tick of so many substeps.
fn fall_of(substeps: u32) -> f64 {
    f64::from(substeps + 1) / f64::from(2 * substeps)
}

/// The number of substeps with which a body falls so far beside its velocity.
pub(crate) fn substeps(fall: f64) -> Option<u32> {
    let off = |count: &u32| (fall_of(*count) - fall).abs();
    let nearest = (1..=SUBSTEPS_MAX).min_by(|a, b| off(a).total_cmp(&off(b)));
    nearest.filter(|count| off(count) < 0.03)
}

/// Falls that a velocity of some moment of the tick explains: from that of its end to that of its begin, but for rounding.
const FALLS: std::ops::RangeInclusive<f64> = -0.05..=1.05;

/// The share of g·t by which velocities are ahead of those with which ticks of so many substeps fall as far; none if they are
/// those of some number of substeps.
pub(crate) fn ahead(fall: f64, count: NonZeroU32) -> Option<f64> {
    let is_other = substeps(fall).is_none() && FALLS.contains(&fall);
    is_other.then(|| fall_of(count.get()) - fall)
}

/// Takes out what no scene can have; returns a sentence about each.
fn without_beyond(found: &mut Found, step_s: f64) -> Vec<String> {
    let mut beyond = Vec::new();
    // NaN is none.
    let is_gravity = |gravity: DVec3| {
        gravity.is_finite() && gravity.abs().max_element() <= f64::from(GRAVITY_MAX)
    };
    if let Some(gravity) = found.gravity.take_if(|gravity| !is_gravity(*gravity)) {
        beyond.push(format!("gravity {gravity} m/s²"));
    }
    let least = (1.0 + f64::from(DAMPING_MAX) * step_s).powf(-1.0 / step_s);
    let is_kept = |kept: &[f64; 2]| kept.iter().all(|kept| *kept >= least);
    if let Some(kept) = found.kept.take_if(|kept| !is_kept(kept)) {
        beyond.push(format!("what is kept of velocities in a second, {kept:?},"));
    }
    let all = found.centres.len();
    found
        .centres
        .retain(|_, centre| centre.length() <= CENTRE_MAX);
    if found.centres.len() < all {
        let far = all - found.centres.len();
        beyond.push(format!("the centre of mass of {far} bodies"));
    }
    let said = |what: String| format!("{what} is beyond what a scene has, and is not taken");
    beyond.into_iter().map(said).collect()
}

/// Gives a recording the parameters that were found; a note for each that no scene can have, which stays as it was.
///
/// # Errors
///
/// [`RecordingError::Number`] if a state would have a number that is none.
pub(crate) fn apply(recording: &mut Recording, found: &Found) -> Result<(), RecordingError> {
    let step_s = recording.integrator.rate.step().seconds();
    let mut found = found.clone();
    let notes = without_beyond(&mut found, step_s);
    recording.notes.extend(notes);
    if let Some(gravity) = found.gravity {
        // An even acceleration below what the fit can tell is none.
        let gravity = if gravity.length() < 0.02 {
            DVec3::ZERO
        } else {
            gravity
        };
        recording.gravity = gravity.as_vec3();
    }
    let count = found.fall.and_then(substeps).and_then(NonZeroU32::new);
    recording.integrator.substeps = count.unwrap_or(recording.integrator.substeps);
    if let Some(kept) = found.kept {
        let [linear, angular] = kept.map(|kept| {
            let tick = kept.powf(step_s).min(1.0);
            let damping = (1.0 / tick - 1.0) / step_s;
            if damping < DAMPING_NOISE {
                0.0
            } else {
                damping as f32
            }
        });
        recording.damping.linear = linear;
        recording.damping.angular = angular;
        for placed in &mut recording.truth.placed {
            placed.desc.damping = None;
        }
    }
    for placed in &mut recording.truth.placed {
        if found.constant.contains(&placed.desc.id) {
            placed.inertia = None;
        } else if let Some((moments, axes)) = found.inertias.get(&placed.desc.id)
            // An inertia that the file states is exact.
            && placed.inertia.is_none()
        {
            let moments = moments.map(|moment| moment as f32);
            if let Ok(inertia) = Inertia::new(moments, axes.as_quat().to_array()) {
                recording.inertias.insert(placed.desc.id, inertia);
            }
        }
    }
    let correction = Correction::new(recording, &found);
    recorded::change_states(recording, |id, states| correction.states(id, states))?;
    set_digest(&mut recording.truth);
    Ok(())
}

/// The moments of inertia that a file states.
fn stated_moments(recording: &Recording) -> BTreeMap<BodyId, estimates::Moments> {
    let placed = recording.truth.placed.iter();
    let stated = placed.filter_map(|placed| {
        let id = placed.desc.id;
        let known = || recording.inertias.get(&id).copied();
        let inertia = placed.inertia.or_else(known)?;
        let moments = estimates::Moments {
            moments: inertia.moments().map(f64::from),
            axes: DQuat::from_array(inertia.frame().map(f64::from)).normalize(),
        };
        Some((id, moments))
    });
    stated.collect()
}

/// The inertia that a file states for a body, or else the one that was found; none of a body that keeps its spin.
fn known_moments(recording: &Recording, found: &Found) -> BTreeMap<BodyId, estimates::Moments> {
    let fitted = found.inertias.iter();
    let mut known: BTreeMap<BodyId, estimates::Moments> = fitted
        .map(|(id, (moments, axes))| {
            let (moments, axes) = (*moments, *axes);
            (*id, estimates::Moments { moments, axes })
        })
        .collect();
    let stated = stated_moments(recording).into_iter();
    known.extend(stated.filter(|(id, _)| !found.constant.contains(id)));
    known
}

impl Found {
    fn substeps(&self) -> f64 {
        f64::from(self.fall.and_then(substeps).unwrap_or(1))
    }

    /// The share of the linear velocity that stays after a substep.
    pub(crate) fn kept_in_substep(&self, step_s: f64) -> f64 {
        let [kept, _] = self.kept.unwrap_or([1.0; 2]);
        kept.powf(step_s / self.substeps())
    }

    /// The shares of its velocities by which a body moves in a tick, if each substep damps it first: the mean over substeps.
    fn kept_on_the_way(&self, step_s: f64) -> Kept {
        let count = self.substeps();
        let [linear, angular] = self.kept.unwrap_or([1.0; 2]).map(|kept| {
            let lost = 1.0 - kept.powf(step_s);
            1.0 - lost * (count + 1.0) / (2.0 * count)
        });
        Kept { linear, angular }
    }
}

/// Makes recorded states those of centres of mass, with the velocities of this project's step.
struct Correction<'a> {
    found: &'a Found,
    known: BTreeMap<BodyId, estimates::Moments>,
    kept: Kept,
    step_s: f64,
    /// Of velocities that are fitted: that by which a body is behind a parabola.
    behind: Option<DVec3>,
    /// Of bodies in flight: what is taken from their velocities.
    ahead: DVec3,
}

/// Time over which a body is seen to be in flight, seconds: gravity moves it by more than a position is rounded.
const SEEN_S: f64 = 1.0 / 60.0;

impl<'a> Correction<'a> {
    /// That by what was found of a recording, which has its gravity and substeps.
    fn new(recording: &Recording, found: &'a Found) -> Self {
        let step_s = recording.integrator.rate.step().seconds();
        let is_fitted = recording.velocities == Velocities::Fitted;
        let ahead = found
            .fall
            .and_then(|fall| ahead(fall, recording.integrator.substeps));
        Self {
            found,
            known: known_moments(recording, found),
            kept: found.kept_on_the_way(step_s),
            step_s,
            behind: is_fitted.then(|| recorded::behind(recording)),
            ahead: found.gravity.unwrap_or_default() * (ahead.unwrap_or_default() * step_s),
        }
    }

    /// The states of a body in all frames of a stay.
    fn states(&self, id: BodyId, states: &[BodyState]) -> Vec<BodyState> {
        let centre = self.found.centres.get(&id);
        let centred = centre.map(|centre| self.centred(states, *centre));
        let mut states = centred.unwrap_or_else(|| states.to_vec());
        if let Some(behind) = self.behind {
            return recorded::fitted(&states, self.step_s, behind);
        }
        if self.found.driven.contains(&id) {
            return states;
        }
        if !self.found.instants.is_own() {
            let moments = self.known.get(&id).copied();
            for state in &mut states {
                *state = self
                    .found
                    .instants
                    .own(state, self.kept, moments, self.step_s);
            }
        }
        if self.ahead != DVec3::ZERO {
            let flies: Vec<bool> = (0..states.len())
                .map(|frame| self.flies(&states, frame))
                .collect();
            for (state, _) in states.iter_mut().zip(flies).filter(|(_, flies)| *flies) {
                let twist = state.motion().twist();
                *state = moved_to(state, position(state), twist.linear - self.ahead);
            }
        }
        states
    }

    /// The states of the centre of mass, which is here in the body's axes.
    fn centred(&self, states: &[BodyState], centre: DVec3) -> Vec<BodyState> {
        let of = |state: &BodyState| {
            let arm = rotation(state) * centre;
            let twist = state.motion().twist();
            let linear = match self.found.point {
                VelocityPoint::Centre => twist.linear,
                VelocityPoint::Origin => twist.linear + twist.angular.cross(arm),
            };
            moved_to(state, position(state) + arm, linear)
        };
        states.iter().map(of).collect()
    }

    /// True if a body accelerates by gravity alone.
    fn flies(&self, states: &[BodyState], frame: usize) -> bool {
        let reach = (SEEN_S / self.step_s).round().max(1.0) as usize;
        let Some(last) = states
            .len()
            .checked_sub(1 + reach)
            .filter(|last| *last >= reach)
        else {
            return false;
        };
        let frame = frame.clamp(reach, last);
        let at = |frame: usize| position(&states[frame]);
        let second = at(frame + reach) - 2.0 * at(frame) + at(frame - reach);
        let time_s = self.step_s * reach as f64;
        let fall = self.found.gravity.unwrap_or_default() * (time_s * time_s);
        (second - fall).length() < fall.length() / 4.0
    }
}

/// A state at another place, with another linear velocity. Both are finite, as what they are made of.
fn moved_to(state: &BodyState, at: DVec3, linear: DVec3) -> BodyState {
    let [_, _, _, x, y, z, w, _, _, _, wx, wy, wz] = state.parts();
    let [at, linear] = [at, linear].map(|of| of.as_vec3().to_array());
    BodyState::new(at, [x, y, z, w], linear, [wx, wy, wz]).unwrap_or(*state)
}

fn position(state: &BodyState) -> DVec3 {
    state.motion().pose().position
}

fn rotation(state: &BodyState) -> DQuat {
    state.motion().pose().rotation
}

/// A body's evenly accelerated part.
struct Flight {
    acceleration: DVec3,
    /// Of the linear velocity, 1/s.
    damping: f64,
    centre: DVec3,
    /// Frames in the middle of three that fit.
    free: Vec<usize>,
}

/// Fits the free part of a path.
fn flight(path: &BodyPath, step_s: f64) -> Option<Flight> {
    let states = &path.states;
    let moves = |frame: &usize| {
        (frame - 1..frame + 1).all(|frame| position(&states[frame]) != position(&states[frame + 1]))
    };
    let mut frames: Vec<usize> = (1..states.len().saturating_sub(1)).filter(moves).collect();
    let all = frames.len();
    let mut fitted = None;
    for round in 0..ROUNDS {
        if frames.len() < FREE_MIN {
            return None;
        }
        let (acceleration, centre, damping) = fit_flight(path, &frames, step_s)?;
        let misfit = |frame: usize| {
            let (second, turn) = second_differences(states, frame);
            let lost = moved(states, frame) * (damping * step_s);
            (second - turn * centre - acceleration * (step_s * step_s) + lost).length()
        };
        let mut rated: Vec<(f64, usize)> = (1..states.len() - 1)
            .filter(moves)
            .map(|frame| (misfit(frame), frame))
            .collect();
        rated.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Half of the frames decide; the last round takes all that fit like those.
        let half = rated[rated.len() / 2].0.max(1e-7);
        let limit = if round + 1 == ROUNDS {
            4.0 * half
        } else {
            half
        };
        frames = rated
            .into_iter()
            .filter(|(off, _)| *off <= limit)
            .map(|(_, frame)| frame)
            .collect();
        frames.sort_unstable();
        fitted = Some((acceleration, centre, damping, half));
    }
    let (acceleration, centre, damping, off) = fitted?;
    // A body among contacts fits nothing.
    let is_even = off <= 2e-3 * path.radius.max(0.01) && frames.len() * 4 > all;
    is_even.then_some(Flight {
        acceleration,
        damping,
        // The recorded place is the centre less its arm.
        centre: -centre,
        free: frames,
    })
}

/// The way of a frame, the mean of those before and after it.
fn moved(states: &[BodyState], frame: usize) -> DVec3 {
    (position(&states[frame + 1]) - position(&states[frame - 1])) / 2.0
}

/// Second differences of the position, and of the rotation as a matrix.
fn second_differences(states: &[BodyState], frame: usize) -> (DVec3, DMat3) {
    let [before, here, after] = [frame - 1, frame, frame + 1].map(|frame| &states[frame]);
    let turn = |state: &BodyState| DMat3::from_quat(rotation(state));
    (
        position(after) - 2.0 * position(here) + position(before),
        turn(after) - turn(here) * 2.0 + turn(before),
    )
}

/// Acceleration, centre and damping by least squares over frames.
fn fit_flight(path: &BodyPath, frames: &[usize], step_s: f64) -> Option<(DVec3, DVec3, f64)> {
    let (mut matrix, mut right) = ([[0.0; 7]; 7], [0.0; 7]);
    let square = step_s * step_s;
    for frame in frames {
        let (second, turn) = second_differences(&path.states, *frame);
        let way = moved(&path.states, *frame);
        for axis in 0..3 {
            let mut row = [0.0; 7];
            row[axis] = square;
            row[6] = -way[axis] * step_s;
            row[3..6].copy_from_slice(&turn.row(axis).to_array());
            for (a, line) in matrix.iter_mut().enumerate() {
                right[a] += row[a] * second[axis];
                for (b, cell) in line.iter_mut().enumerate() {
                    *cell += row[a] * row[b];
                }
            }
        }
    }
    // Without a turn the centre is unknown, and taken as the origin: a weak pull towards it, a millionth of the weight of a
    // turn by a tenth of a radian in a frame.
    for (axis, line) in matrix.iter_mut().enumerate().skip(3).take(3) {
        line[axis] += 1e-10 * frames.len() as f64;
    }
    // Without a change of speed damping is unknown, and taken as none.
    matrix[6][6] += 1e-12 * frames.len() as f64;
    let x = solve(matrix, right)?;
    let (acceleration, centre) = (DVec3::new(x[0], x[1], x[2]), DVec3::new(x[3], x[4], x[5]));
    Some((acceleration, centre, x[6]))
}

/// Distance of a body's acceleration from that of most, m/s², from which on something drives it.
const APART: f64 = 0.5;

/// Flights that accelerate alike, and the bodies of the others; no flights if fewer than half are alike.
fn alike(flights: Vec<(&BodyPath, Flight)>) -> (Vec<(&BodyPath, Flight)>, BTreeSet<BodyId>) {
    let axis = |axis: usize| {
        let along = flights.iter().map(|(_, flight)| flight.acceleration[axis]);
        median(along.collect()).unwrap_or_default()
    };
    let common = DVec3::new(axis(0), axis(1), axis(2));
    let all = flights.len();
    let is_alike = |(_, flight): &(&BodyPath, Flight)| {
        (flight.acceleration - common).length() <= APART + 0.05 * common.length()
    };
    let (mut alike, mut apart): (Vec<_>, Vec<_>) = flights.into_iter().partition(is_alike);
    if alike.len() * 2 < all {
        apart.append(&mut alike);
    }
    let apart = apart.iter().map(|(path, _)| path.id).collect();
    (alike, apart)
}

/// Finds what the poses and velocities of free bodies say.
pub(crate) fn find(recording: &Recording, paths: &[BodyPath]) -> Found {
    let mut found = look(recording, paths);
    if !found.centres.is_empty() {
        if recording.velocities == Velocities::Recorded {
            found.point = point(
                paths,
                &found.centres,
                recording.integrator.rate.step().seconds(),
            );
        }
        let centred = Found {
            instants: Instants::default(),
            ..found.clone()
        };
        let again = look_again(recording, centred, paths);
        found = Found {
            centres: found.centres,
            point: found.point,
            ..again
        };
    }
    if !found.instants.is_own() {
        let again = look_again(recording, found.clone(), paths);
        found = Found {
            centres: found.centres,
            point: found.point,
            instants: found.instants,
            ..again
        };
    }
    found
}

/// Looks at the states that follow from what was found.
fn look_again(recording: &Recording, found: Found, paths: &[BodyPath]) -> Found {
    // By how much velocities are ahead is found from the other findings.
    let correction = Correction {
        ahead: DVec3::ZERO,
        ..Correction::new(recording, &found)
    };
    let own = |path: &BodyPath| BodyPath {
        id: path.id,
        states: correction.states(path.id, &path.states),
        radius: path.radius,
    };
    let own: Vec<BodyPath> = paths.iter().map(own).collect();
    look(recording, &own)
}

/// The point to which velocities belong. That of a centre is by its spin and arm beside that of the recorded place, so that
/// one of both is beside the way of the centre by what does not turn with the body.
fn point(paths: &[BodyPath], centres: &BTreeMap<BodyId, DVec3>, step_s: f64) -> VelocityPoint {
    let (mut both, mut spread) = (0.0, 0.0);
    for path in paths {
        let Some(centre) = centres.get(&path.id) else {
            continue;
        };
        let arm = |state: &BodyState| rotation(state) * *centre;
        let beside = |three: &[BodyState]| {
            let [before, after] = [0, 2].map(|of| position(&three[of]) + arm(&three[of]));
            let twist = three[1].motion().twist();
            let off = (after - before) / (2.0 * step_s) - twist.linear;
            [off, twist.angular.cross(arm(&three[1]))]
        };
        let all: Vec<[DVec3; 2]> = path.states.windows(3).map(beside).collect();
        let mean = |of: usize| all.iter().map(|pair| pair[of]).sum::<DVec3>() / all.len() as f64;
        let [off, turned] = [mean(0), mean(1)];
        for pair in &all {
            both += (pair[0] - off).dot(pair[1] - turned);
            spread += (pair[1] - turned).length_squared();
        }
    }
    if both > spread / 2.0 {
        VelocityPoint::Origin
    } else {
        VelocityPoint::Centre
    }
}

/// The findings of free bodies, one after another.
#[derive(Default)]
struct Evidence {
    /// Velocities before and after a tick.
    steps: Vec<[DVec3; 2]>,
    /// Shares of the linear velocity that stay after a tick, by the poses.
    linear: Vec<f64>,
    /// Shares of the angular momentum.
    angular: Vec<f64>,
    falls: Vec<f64>,
    /// Bodies that are damped before they move, less the others.
    damped: i64,
}

/// Finds what poses and velocities say as they are.
fn look(recording: &Recording, paths: &[BodyPath]) -> Found {
    let step_s = recording.integrator.rate.step().seconds();
    let mut found = Found::default();
    let mut evidence = Evidence::default();
    let moving = paths.iter().flat_map(|path| path.states.windows(2));
    found.free[1] = moving.filter(|pair| pair[0] != pair[1]).count();
    let flights = paths.iter();
    let flights = flights.filter_map(|path| Some((path, flight(path, step_s)?)));
    let (flights, apart) = alike(flights.collect());
    found.driven = apart;
    let mut wandering = Vec::new();
    let stated = stated_moments(recording);
    for (path, flight) in &flights {
        let pairs = pairs(&flight.free);
        let kept = median(estimates::kept_spins(path, &pairs)).unwrap_or(1.0);
        match estimates::moments(path, &pairs, kept) {
            Some(SpinMoments::Unequal(moments, axes)) => {
                found.inertias.insert(path.id, (moments, axes));
                wandering.extend(
                    pairs
                        .iter()
                        .map(|frame| [*frame, frame + 1].map(|of| &path.states[of])),
                );
            }
            Some(SpinMoments::Equal) => {
                let stated = stated.get(&path.id);
                if stated.is_none_or(|of| estimates::contradicts(path, &pairs, kept, of)) {
                    found.constant.insert(path.id);
                }
            }
            Some(SpinMoments::Unexplained) => {
                found.driven.insert(path.id);
                continue;
            }
            None => {}
        }
        found.free[0] += flight.free.len();
        if flight.centre.length() > CENTRE_SHARE * path.radius {
            found.centres.insert(path.id, flight.centre);
        }
        let tensor = found.inertias.get(&path.id).copied();
        let frames = pairs.iter();
        evidence
            .angular
            .extend(frames.filter_map(|frame| estimates::kept_momentum(path, *frame, tensor)));
        evidence.take(path, &pairs, flight, step_s);
    }
    let Some(kept) = evidence.kept(recording.velocities) else {
        return found;
    };
    if recording.velocities == Velocities::Recorded {
        found.fall = median(evidence.falls.clone());
    }
    found.gravity = evidence.gravity(recording.velocities, kept.linear, step_s);
    found.kept = Some([kept.linear, kept.angular].map(|kept| kept.powf(1.0 / step_s)));
    if recording.velocities == Velocities::Recorded {
        let is_damped = -kept.linear.ln() > DAMPING_NOISE * step_s;
        let first = if is_damped && evidence.damped > 0 {
            First::Damped
        } else {
            First::Moved
        };
        let share = |pair| estimates::turn_share(pair, kept.angular, first, step_s);
        found.instants = Instants::new(first, wandering.into_iter().filter_map(share).collect());
    }
    found
}

impl Evidence {
    /// Takes what a body's free part says of its linear velocity.
    fn take(&mut self, path: &BodyPath, pairs: &[usize], flight: &Flight, step_s: f64) {
        let velocity = |frame: usize| path.states[frame].motion().twist().linear;
        let steps = pairs.iter();
        self.steps
            .extend(steps.map(|frame| [velocity(*frame), velocity(frame + 1)]));
        let kept = (-flight.damping * step_s).exp();
        self.linear.push(kept);
        let falls = falls(path, pairs, flight, step_s);
        if falls.is_empty() {
            return;
        }
        let lost = 1.0 - kept;
        let (first, given) = if flight.damping > DAMPING_NOISE {
            let given = estimates::given(&falls);
            (estimates::first(given, lost), given)
        } else {
            (First::Moved, 0.0)
        };
        self.damped += if first == First::Damped { 1 } else { -1 };
        // The way that damping takes is no part of the fall.
        let fall = |fall: &Fall| fall.beside - given * fall.way;
        self.falls.extend(falls.iter().map(fall));
    }

    /// The part of a velocity that stays after a tick; `None` if nothing was said.
    fn kept(&self, source: Velocities) -> Option<Kept> {
        let linear = match source {
            Velocities::Recorded => linear_flow(&self.steps).map(|(kept, _)| kept),
            Velocities::Fitted => median(self.linear.clone()),
        };
        let angular = median(self.angular.clone());
        (linear.is_some() || angular.is_some()).then(|| Kept {
            linear: linear.unwrap_or(1.0),
            angular: angular.unwrap_or(1.0),
        })
    }

    /// Gravity: a step adds it to the velocity, of which damping then leaves a share.
    fn gravity(&self, source: Velocities, kept: f64, step_s: f64) -> Option<DVec3> {
        if source == Velocities::Recorded {
            return linear_flow(&self.steps).map(|(kept, added)| added / (kept * step_s));
        }
        let axis = |axis: usize| {
            let steps = self.steps.iter();
            median(
                steps
                    .map(|[before, after]| (after[axis] / kept - before[axis]) / step_s)
                    .collect(),
            )
        };
        Some(DVec3::new(axis(0)?, axis(1)?, axis(2)?))
    }
}

/// Rounds of a fit of velocities, each without those that fitted worst before.
const FLOW_ROUNDS: usize = 3;

/// The share of a velocity that stays after a tick, and what the tick adds to it, by least squares.
fn linear_flow(steps: &[[DVec3; 2]]) -> Option<(f64, DVec3)> {
    let mut taken: Vec<[DVec3; 2]> = steps.to_vec();
    let mut fitted = None;
    for _ in 0..FLOW_ROUNDS {
        if taken.is_empty() {
            return None;
        }
        let count = taken.len() as f64;
        let mean = |place: usize| taken.iter().map(|step| step[place]).sum::<DVec3>() / count;
        let [before, after] = [mean(0), mean(1)];
        // Without a change of speed damping is unknown, and taken as none.
        let pull = 1e-9 * count;
        let (mut both, mut spread) = (pull, pull);
        for step in &taken {
            both += (step[0] - before).dot(step[1] - after);
            spread += (step[0] - before).length_squared();
        }
        let kept = both / spread;
        let added = after - before * kept;
        fitted = Some((kept, added));
        let off = |step: &[DVec3; 2]| (step[1] - step[0] * kept - added).length();
        let middle = median(taken.iter().map(off).collect())?;
        taken.retain(|step| off(step) <= 4.0 * middle);
    }
    fitted
}

/// Frames that are free together with the next one.
fn pairs(free: &[usize]) -> Vec<usize> {
    free.windows(2)
        .filter(|pair| pair[1] == pair[0] + 1)
        .map(|pair| pair[0])
        .collect()
}

/// The falls of a body in these frames; none where it hardly falls.
fn falls(path: &BodyPath, pairs: &[usize], flight: &Flight, step_s: f64) -> Vec<Fall> {
    let strength = flight.acceleration.length();
    if strength < 0.1 {
        return Vec::new();
    }
    let down = flight.acceleration / strength;
    let square = strength * step_s * step_s;
    let of = |frame: &usize| {
        let velocity = path.states[*frame].motion().twist().linear;
        let moved = position(&path.states[frame + 1]) - position(&path.states[*frame]);
        Fall {
            beside: (moved - velocity * step_s).dot(down) / square,
            way: velocity.dot(down) * step_s / square,
        }
    };
    pairs.iter().map(of).collect()
}

#[cfg(test)]
mod tests;
