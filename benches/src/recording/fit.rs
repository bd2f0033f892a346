//! Parameters of the engine that recorded poses, as the poses tell them.
//!
//! Gravity, centre of mass, inertia, damping, substeps.
//!
//! A body is taken as free where its centre accelerates evenly. A fit of least squares to each body's second differences
//! finds its acceleration and the place that moves so; poses that fit badly are left out, and the fit is repeated. Then
//! the momentum of free bodies tells their moments, and the change of velocities gravity, damping and substeps. A body
//! that accelerates otherwise than most, or whose spin changes as no moments explain, is driven: it tells nothing. If the
//! velocities hold for other moments than this project's, all is found again from those of this project's moments.

use std::collections::{BTreeMap, BTreeSet};

use glam::{DMat3, DQuat, DVec3};
use rhumb_protocol::limits::{DAMPING_MAX, GRAVITY_MAX};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState, Inertia};

use super::algebra::{least_eigenvector, median, principal_axes, solve};
use super::instants::{self, Fall, First, Instants, Kept};
use super::recorded::BodyPath;
use super::recorded::{Recording, Velocities, set_digest};

/// The parameters that were found.
#[derive(Clone, Debug, Default)]
pub(crate) struct Found {
    /// m/s², the median over bodies.
    pub(crate) gravity: Option<DVec3>,
    /// Centres of mass from the recorded places, body axes, metres; those that matter.
    pub(crate) centres: BTreeMap<BodyId, DVec3>,
    /// Principal moments, of which only ratios matter, and their axes; of bodies whose spin wanders.
    pub(crate) inertias: BTreeMap<BodyId, ([f64; 3], DQuat)>,
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

/// Least number of free frames of a body that says something.
const FREE_MIN: usize = 8;
/// Rounds of a fit, each without what fitted worst before.
const ROUNDS: usize = 8;
/// Distance of a centre from the origin that matters, as a share of the radius.
const CENTRE_SHARE: f64 = 0.02;

/// Largest distance of a centre of mass from the recorded place, metres.
const CENTRE_MAX: f64 = 1_000.0;

/// Most substeps that are distinguished.
const SUBSTEPS_MAX: u32 = 8;

/// The number of substeps with which a body falls so far beside its velocity.
pub(crate) fn substeps(fall: f64) -> Option<u32> {
    let of = |count: u32| f64::from(count + 1) / f64::from(2 * count);
    let mut all = 1..=SUBSTEPS_MAX;
    let nearest = all
        .by_ref()
        .min_by(|a, b| (of(*a) - fall).abs().total_cmp(&(of(*b) - fall).abs()));
    nearest.filter(|count| (of(*count) - fall).abs() < 0.03)
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
pub(crate) fn apply(recording: &mut Recording, found: &Found) {
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
    let count = found
        .fall
        .and_then(substeps)
        .and_then(std::num::NonZeroU32::new);
    recording.integrator.substeps = count.unwrap_or(recording.integrator.substeps);
    if let Some(kept) = found.kept {
        let [linear, angular] = kept.map(|kept| {
            let tick = kept.powf(step_s).min(1.0);
            let damping = (1.0 / tick - 1.0) / step_s;
            // Below a thousandth a second it is noise.
            if damping < 1e-3 { 0.0 } else { damping as f32 }
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
    own_velocities(recording, &found);
    let centred = |observation: &mut Observation| {
        if let Some(centre) = found.centres.get(&observation.id) {
            let motion = observation.motion.motion();
            let at = motion.pose().position + motion.pose().rotation * *centre;
            let [_, _, _, x, y, z, w, vx, vy, vz, wx, wy, wz] = observation.motion.parts();
            let moved = BodyState::new(
                at.as_vec3().to_array(),
                [x, y, z, w],
                [vx, vy, vz],
                [wx, wy, wz],
            );
            // Both are finite, and so is their sum.
            observation.motion = moved.unwrap_or(observation.motion);
        }
    };
    recording
        .truth
        .placed
        .iter_mut()
        .for_each(|placed| centred(&mut placed.observation));
    recording.truth.ticks.iter_mut().flatten().for_each(centred);
    set_digest(&mut recording.truth);
}

/// The inertia that a file states for a body, or else the one that was found; none of a body that keeps its spin.
fn known_moments(recording: &Recording, found: &Found) -> BTreeMap<BodyId, instants::Moments> {
    let of = |moments: [f64; 3], axes: DQuat| instants::Moments { moments, axes };
    let fitted = found.inertias.iter();
    let mut known: BTreeMap<BodyId, instants::Moments> = fitted
        .map(|(id, (moments, axes))| (*id, of(*moments, *axes)))
        .collect();
    for placed in &recording.truth.placed {
        let id = placed.desc.id;
        let stated = placed
            .inertia
            .or_else(|| recording.inertias.get(&id).copied());
        if let Some(inertia) = stated.filter(|_| !found.constant.contains(&id)) {
            let axes = DQuat::from_array(inertia.frame().map(f64::from)).normalize();
            known.insert(id, of(inertia.moments().map(f64::from), axes));
        }
    }
    known
}

/// Shares of the velocities that stay after a tick.
fn kept_in_tick(found: &Found, step_s: f64) -> Kept {
    let [linear, angular] = found.kept.unwrap_or([1.0; 2]).map(|kept| kept.powf(step_s));
    Kept { linear, angular }
}

/// Gives the free bodies of a recording the velocities that this project's step would have.
fn own_velocities(recording: &mut Recording, found: &Found) {
    if found.instants.is_own() {
        return;
    }
    let step_s = recording.integrator.rate.step().seconds();
    let known = known_moments(recording, found);
    let kept = kept_in_tick(found, step_s);
    let own = |observation: &mut Observation| {
        let id = observation.id;
        if !found.driven.contains(&id) {
            let moments = known.get(&id).copied();
            observation.motion = found
                .instants
                .own(&observation.motion, kept, moments, step_s);
        }
    };
    let placed = recording.truth.placed.iter_mut();
    placed.for_each(|placed| own(&mut placed.observation));
    recording.truth.ticks.iter_mut().flatten().for_each(own);
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
    let found = look(recording, paths);
    if found.instants.is_own() {
        return found;
    }
    let step_s = recording.integrator.rate.step().seconds();
    let known = known_moments(recording, &found);
    let kept = kept_in_tick(&found, step_s);
    let own = |path: &BodyPath| {
        let moments = known.get(&path.id).copied();
        let own = |state| found.instants.own(state, kept, moments, step_s);
        BodyPath {
            id: path.id,
            states: path.states.iter().map(own).collect(),
            radius: path.radius,
        }
    };
    let own: Vec<BodyPath> = paths.iter().map(own).collect();
    Found {
        instants: found.instants,
        ..look(recording, &own)
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
    for (path, flight) in &flights {
        let pairs = pairs(&flight.free);
        let kept = kept_spins(path, &pairs);
        match moments(path, &pairs, median(kept).unwrap_or(1.0)) {
            Some(Moments::Unequal(moments, axes)) => {
                found.inertias.insert(path.id, (moments, axes));
                wandering.extend(
                    pairs
                        .iter()
                        .map(|frame| [*frame, frame + 1].map(|of| &path.states[of])),
                );
            }
            Some(Moments::Equal) => {
                found.constant.insert(path.id);
            }
            Some(Moments::Unexplained) => {
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
        let spins = pairs.iter();
        evidence
            .angular
            .extend(spins.filter_map(|frame| kept_momentum(path, *frame, tensor)));
        evidence.take(path, &pairs, flight, step_s);
    }
    let Some(kept) = evidence.kept(recording.velocities) else {
        return found;
    };
    found.gravity = evidence.gravity(recording.velocities, kept.linear, step_s);
    found.kept = Some([kept.linear, kept.angular].map(|kept| kept.powf(1.0 / step_s)));
    found.fall = median(evidence.falls);
    if recording.velocities == Velocities::Recorded {
        let first = if evidence.damped > 0 {
            First::Damped
        } else {
            First::Moved
        };
        let share = |pair| instants::turn_share(pair, kept.angular, first, step_s);
        found.instants = Instants::new(first, wandering.into_iter().filter_map(share).collect());
    }
    found
}

/// Shares of its angular momentum that a body keeps, by the moments that fit it without damping.
fn kept_spins(path: &BodyPath, pairs: &[usize]) -> Vec<f64> {
    // The first moments tell the damping of the spin, and that tells the moments.
    let tensor = moments(path, pairs, 1.0).and_then(Moments::tensor);
    let pairs = pairs.iter();
    pairs
        .filter_map(|frame| kept_momentum(path, *frame, tensor))
        .collect()
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
        let first = instants::first(&falls, lost);
        self.damped += if first == First::Damped { 1 } else { -1 };
        // Of those that damp first the way that damping takes is no part of the fall.
        let share = if first == First::Damped { lost } else { 0.0 };
        self.falls
            .extend(falls.iter().map(|fall| fall.beside + share * fall.way));
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

enum Moments {
    Equal,
    Unequal([f64; 3], DQuat),
    /// The spin changes as that of no free body does.
    Unexplained,
}

impl Moments {
    const fn tensor(self) -> Option<([f64; 3], DQuat)> {
        match self {
            Self::Equal | Self::Unexplained => None,
            Self::Unequal(moments, axes) => Some((moments, axes)),
        }
    }
}

/// Moments that differ by less than this share count as equal.
const EQUAL_SHARE: f64 = 0.01;

/// Change of a spin in a frame, as a share of it, that is the rounding of an engine in single precision.
const KEPT_SPIN: f64 = 1e-5;

/// Square of the change of a spin in a frame, as a share of it, that moments need not explain.
const CHANGE_MIN: f64 = 1e-8;

/// Part of that change that moments may leave unexplained: integrators keep momentum within far less.
const UNEXPLAINED_MOST: f64 = 0.1;

/// The square of a tensor's momentum, or of its change, by the sums of their products.
fn quadratic(matrix: &[[f64; 6]; 6], tensor: &[f64; 6]) -> f64 {
    let rows = matrix.iter().zip(tensor);
    rows.map(|(row, of)| of * row.iter().zip(tensor).map(|(a, b)| a * b).sum::<f64>())
        .sum()
}

/// The moments of inertia with which a body keeps this share of its angular momentum in a frame.
fn moments(path: &BodyPath, pairs: &[usize], kept: f64) -> Option<Moments> {
    let mut matrix = [[0.0; 6]; 6];
    let mut whole = [[0.0; 6]; 6];
    let mut spins = 0.0;
    for frame in pairs {
        let [a, b] = [*frame, frame + 1].map(|frame| momentum_rows(&path.states[frame]));
        for axis in 0..3 {
            let row: [f64; 6] = std::array::from_fn(|part| b[part][axis] - kept * a[part][axis]);
            for (i, line) in matrix.iter_mut().enumerate() {
                for (j, cell) in line.iter_mut().enumerate() {
                    *cell += row[i] * row[j];
                    whole[i][j] += a[i][axis] * a[j][axis];
                }
            }
        }
        let spin = path.states[*frame].motion().twist().angular;
        spins += spin.length_squared();
    }
    if pairs.len() < FREE_MIN || spins / (pairs.len() as f64) < 1e-4 {
        return None;
    }
    if keeps_spin(path, pairs) {
        return Some(Moments::Equal);
    }
    let plain = matrix;
    let change = |tensor: &[f64; 6]| quadratic(&plain, tensor) / quadratic(&whole, tensor);
    let of_equal = change(&[1.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
    // Moments that the spin does not tell are taken as equal.
    let pull = 1e-9 * spins;
    for (i, line) in matrix.iter_mut().enumerate() {
        for (j, cell) in line.iter_mut().enumerate() {
            let same = f64::from(u8::from(i == j));
            let mean = if i < 3 && j < 3 { 1.0 / 3.0 } else { 0.0 };
            *cell += pull * (same - mean);
        }
    }
    let tensor = least_eigenvector(matrix);
    let left = change(&tensor);
    // A spin along one axis says nothing of the others: its tensor has no momentum, and NaN explains nothing.
    let is_explained = left <= UNEXPLAINED_MOST * of_equal;
    if of_equal > CHANGE_MIN && !is_explained {
        return Some(Moments::Unexplained);
    }
    let [xx, yy, zz, xy, xz, yz] = tensor;
    let trace = xx + yy + zz;
    if trace.abs() < 1e-9 {
        return None;
    }
    let tensor = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]].map(|row| row.map(|part| part / trace));
    let (moments, axes) = principal_axes(tensor);
    let greatest = moments.into_iter().fold(f64::MIN, f64::max);
    let least = moments.into_iter().fold(f64::MAX, f64::min);
    if greatest - least <= EQUAL_SHARE * greatest {
        return Some(Moments::Equal);
    }
    // No body has a moment beyond the sum of the others.
    (least > 0.0 && 2.0 * greatest <= 1.1).then_some(Moments::Unequal(moments, axes))
}

/// True for a spin about one axis of the world, but for rounding: any moments would do.
fn keeps_spin(path: &BodyPath, pairs: &[usize]) -> bool {
    let spin = |frame: usize| path.states[frame].motion().twist().angular;
    let (mut before, mut both, mut after) = (0.0, 0.0, 0.0);
    for frame in pairs {
        let [a, b] = [spin(*frame), spin(frame + 1)];
        before += a.length_squared();
        both += a.dot(b);
        after += b.length_squared();
    }
    // The second spins without their best share of the first ones.
    after - both * both / before <= KEPT_SPIN * KEPT_SPIN * before
}

/// Angular momentum in the world for each part of a tensor: xx, yy, zz, xy, xz, yz.
fn momentum_rows(state: &BodyState) -> [DVec3; 6] {
    let turn = rotation(state);
    let w = turn.conjugate() * state.motion().twist().angular;
    let parts = [
        DVec3::new(w.x, 0.0, 0.0),
        DVec3::new(0.0, w.y, 0.0),
        DVec3::new(0.0, 0.0, w.z),
        DVec3::new(w.y, w.x, 0.0),
        DVec3::new(w.z, 0.0, w.x),
        DVec3::new(0.0, w.z, w.y),
    ];
    parts.map(|part| turn * part)
}

/// The share of its angular momentum that a body keeps in a frame.
fn kept_momentum(path: &BodyPath, frame: usize, tensor: Option<([f64; 3], DQuat)>) -> Option<f64> {
    let momentum = |frame: usize| {
        let state = &path.states[frame];
        let (moments, axes) = tensor.unwrap_or(([1.0; 3], DQuat::IDENTITY));
        let turn = rotation(state) * axes;
        let spin = turn.conjugate() * state.motion().twist().angular;
        (spin * DVec3::from_array(moments)).length()
    };
    let before = momentum(frame);
    (before > 1e-3).then(|| momentum(frame + 1) / before)
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
mod tests {
    use super::*;
    use crate::recording::recorded::tests::recording;

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
            apply(&mut recording, &found);
            assert_eq!(recording.gravity, before.gravity, "{found:?}");
            assert_eq!(recording.damping, before.damping, "{found:?}");
            assert_eq!(recording.truth.digest, before.truth.digest, "{found:?}");
            let notes = recording.notes.len() - before.notes.len();
            assert_eq!(notes, 1, "{found:?}");
        }
    }
}
