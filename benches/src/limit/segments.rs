//! One body's way, cut into as few segments as are found.
//!
//! Greedy: from where the last segment breaks the promise, the one that keeps it longest. For one family of fits no
//! other cut of the way has fewer segments, since what holds over a stretch holds over each part of it. A cut for few
//! bits takes the segment that costs least for the time that it holds, which is no more than a good guess.

use rhumb_reckoning::{
    Cursor, Grid, Motion, Predictor, Push, Residual, Snapped, carried, seen_from,
};

use super::course::{Course, Law, Saying};
use super::fit::fit;
use super::path::Path;

/// Frames by which a push is found at first.
const PUSH_SEEN: usize = 4;
/// A body is held within this many radii of its holder, and the holder is larger by the factor below, as publishers
/// have it.
const HOLDER_REACH: f64 = 3.0;
/// Velocities are said in steps of half the tolerance a second, where no finer ones are sought.
const COARSENESS: u32 = 3;
/// See above.
pub(super) const HOLDER_RATIO: f64 = 1.2;

/// What has to be said at the beginning of a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Update {
    pub(super) frame: usize,
    /// Place of the body.
    pub(super) body: usize,
    /// The law until now, and from now on.
    pub(super) laws: [Law; 2],
    /// Whether the body is held by another than before.
    pub(super) changes_holder: bool,
    /// What pushes it, if that is another push than before.
    pub(super) push: Option<Push>,
    /// Position and turn in grid steps, and velocities where those implied would not hold as long.
    pub(super) residual: Residual,
}

/// A body's whole way.
#[derive(Clone, Debug, Default)]
pub(super) struct Way {
    pub(super) updates: Vec<Update>,
    /// Surface errors at frames at which the body is elsewhere than a frame before, metres.
    pub(super) errors_m: Vec<f32>,
    /// Where it is believed to be, frame by frame.
    pub(super) believed: Vec<Motion>,
}

/// What a cut is to have little of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Least {
    /// Segments.
    Updates,
    /// Bits for the time that a segment holds, as far as they can be guessed.
    Bits,
    /// Segments whose motions are such as the protocol can say: rounded to its grid, and judged as rounded.
    UpdatesOnGrid,
}

/// A saying, until when it holds, and what has to be said for it.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    saying: Saying,
    until: usize,
    update: Update,
}

/// Cuts a body's way into segments.
pub(super) fn cut(course: &Course<'_>, body: usize, least: Least) -> Way {
    let path = course.path;
    let grid = Grid::new(course.tolerance, path.radius);
    let mut way = Way::default();
    let mut saying = known(path, &grid);
    let mut frame = course.holds_until(&saying);
    note(course, &saying, frame, &mut way);
    while frame < path.end() {
        let mut best: Option<Candidate> = None;
        let realised = |fitted: Saying| match least {
            Least::UpdatesOnGrid => on_grid(course, &grid, &saying, &fitted),
            Least::Updates | Least::Bits => (fitted, course.holds_until(&fitted)),
        };
        for found in longest(course, frame, &realised) {
            for candidate in candidates(course, &grid, (saying, found), body, least) {
                if best.is_none_or(|best| price(&candidate, least) < price(&best, least)) {
                    best = Some(candidate);
                }
            }
        }
        let Some(next) = best else {
            break;
        };
        way.updates.push(next.update);
        (saying, frame) = (next.saying, next.until);
        note(course, &saying, frame, &mut way);
    }
    way
}

/// Less is better.
fn price(candidate: &Candidate, least: Least) -> f64 {
    let frames = (candidate.until - candidate.saying.frame) as f64;
    match least {
        Least::Updates | Least::UpdatesOnGrid => 1.0 / frames,
        Least::Bits => guess(&candidate.update) / frames,
    }
}

/// What an update may take: enough to choose by; what it takes is reckoned when all are known.
fn guess(update: &Update) -> f64 {
    let residual = &update.residual;
    let number = |value: &i32| match value.unsigned_abs() {
        0 => 0.7,
        size => 2.5 + 2.0 * f64::from(size).log2(),
    };
    let three = |values: &[i32; 3]| values.iter().map(number).sum::<f64>();
    let velocity = residual
        .velocity
        .map_or(0.0, |by| three(&by.linear) + three(&by.angular));
    let push = update.push.map_or(0.0, |push| {
        three(&push.steps().map(i32::from)) + number(&i32::from(push.doublings()))
    });
    NAMING_BITS + three(&residual.position) + three(&residual.turn) + velocity + push
}

/// Which body, and which law.
const NAMING_BITS: f64 = 6.0;

/// What both ends know before anything is said.
fn known(path: &Path, grid: &Grid) -> Saying {
    let law = match path.known.predictor {
        Predictor::Rest => Law::Rest,
        Predictor::Uniform | Predictor::Tumbling => Law::Uniform,
        _ => Law::Ballistic,
    };
    Saying {
        law,
        frame: path.first,
        motion: path.known.start(grid),
        holder: None,
        push: None,
    }
}

/// Writes down where a segment has the body, and how far off that is.
fn note(course: &Course<'_>, saying: &Saying, until: usize, way: &mut Way) {
    let (mut there, mut apart) = (Cursor::default(), Cursor::default());
    for frame in saying.frame..until {
        if let Some(believed) = course.believed(saying, frame, &mut there) {
            way.believed.push(believed);
        }
        if !course.path.is_same(frame)
            && let Some(off) = course.apart(saying, frame, &mut apart)
        {
            let error = off.surface_error(course.path.radius);
            way.errors_m.push(error.metres() as f32);
        }
    }
}

/// What is said of a fitted motion, and until when that holds.
type Realised<'r> = &'r dyn Fn(Saying) -> (Saying, usize);

/// The motion that the protocol says where it wants to say a fitted one, with the velocities that hold longer: those
/// that the correction implies, or those that are nearest to the fitted ones.
fn on_grid(course: &Course<'_>, grid: &Grid, last: &Saying, fitted: &Saying) -> (Saying, usize) {
    let (residual, implied) = implied(course, grid, last, fitted);
    let mut all = vec![implied];
    if fitted.law.moves() {
        // The finest steps that can be said, and those that most words have: what is nearer does not always hold longer.
        for coarseness in [0, COARSENESS] {
            let twist = fitted.motion.twist();
            let velocity = Residual::of_velocity(&twist, &implied, grid, coarseness);
            let residual = Residual {
                velocity: Some(velocity),
                ..residual
            };
            all.push(said(course, grid, last, fitted, &residual));
        }
    }
    let held = all.into_iter().map(|snapped| {
        let motion = snapped.motion(grid);
        let saying = Saying { motion, ..*fitted };
        (saying, course.holds_until(&saying))
    });
    held.max_by_key(|(_, until)| *until)
        .unwrap_or((*fitted, fitted.frame))
}

/// The correction of a pose, rounded, and the motion that it leads to by itself.
fn implied(course: &Course<'_>, grid: &Grid, last: &Saying, next: &Saying) -> (Residual, Snapped) {
    let predicted = in_frame_of(course, last, next);
    let [position, turn] = Residual::wanted(&next.motion.pose(), &predicted.pose(), grid);
    let rounded = |steps: glam::DVec3| steps.to_array().map(|step| step.round() as i32);
    let residual = Residual {
        position: rounded(position),
        turn: rounded(turn),
        velocity: None,
    };
    (residual, said(course, grid, last, next, &residual))
}

/// The motion that a correction leads to.
fn said(
    course: &Course<'_>,
    grid: &Grid,
    last: &Saying,
    next: &Saying,
    residual: &Residual,
) -> Snapped {
    let predicted = in_frame_of(course, last, next);
    let age = course.ticks(last.frame, next.frame);
    let over = course.predictor(last).astray(age, course.rate);
    let snapped = residual.onto(&predicted, over, grid);
    if next.law.moves() {
        snapped
    } else {
        snapped.stilled()
    }
}

/// By each law the saying that holds longest from a frame on, and until when.
fn longest(course: &Course<'_>, frame: usize, realised: Realised<'_>) -> Vec<(Saying, usize)> {
    let by = |law: Law| {
        let holder = match law {
            Law::Held => Some(nearest_holder(course, frame)?),
            _ => None,
        };
        let pulled = course.path.gravity != glam::DVec3::ZERO;
        let found = (law != Law::Ballistic || pulled)
            .then(|| longest_by(course, law, holder, frame, realised))
            .flatten();
        found.filter(|(_, until)| *until > frame)
    };
    Law::ALL.into_iter().filter_map(by).collect()
}

/// By one law.
fn longest_by(
    course: &Course<'_>,
    law: Law,
    holder: Option<usize>,
    frame: usize,
    realised: Realised<'_>,
) -> Option<(Saying, usize)> {
    let end = course.horizon(law, frame);
    let motion = course.target(frame, holder)?;
    let start = Saying {
        law,
        frame,
        motion: if law.moves() {
            motion
        } else {
            motion.stilled()
        },
        holder,
        push: None,
    };
    let begun = match law {
        Law::Pushed => fit(course, law, holder, frame, (frame + PUSH_SEEN).min(end))?,
        _ => start,
    };
    let mut best = realised(begun);
    let attempt = |to: usize, best: &mut (Saying, usize)| {
        let fitted = fit(course, law, holder, frame, to);
        let until = fitted.map(realised);
        *best = until.filter(|(_, until)| *until > best.1).unwrap_or(*best);
        best.1 >= to
    };
    // Ever longer until none is found, then between what was found and what was not.
    let mut beyond = end + 1;
    while best.1 < end {
        let length = best.1 - frame;
        let to = (best.1 + (length / 2).max(1)).min(end);
        if !attempt(to, &mut best) {
            beyond = to;
            break;
        }
    }
    while best.1 + 1 < beyond.min(end + 1) {
        let to = best.1 + (beyond - best.1) / 2;
        if !attempt(to, &mut best) {
            beyond = to;
        }
    }
    Some(best)
}

/// The nearest body that may hold this one.
fn nearest_holder(course: &Course<'_>, frame: usize) -> Option<usize> {
    let path = course.path;
    let here = path.at(frame).pose().position;
    let far = |place: usize| {
        let holder = &course.holders[place];
        let radius = holder.radius.metres();
        let far = holder.at(frame)?.pose().position.distance(here);
        let holds = radius >= path.radius.metres() * HOLDER_RATIO && far <= radius * HOLDER_REACH;
        holds.then_some((far, place))
    };
    (0..course.holders.len())
        .filter_map(far)
        .min_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, place)| place)
}

/// The ways to say what was found: as it is, and with the velocities that the correction itself implies.
fn candidates(
    course: &Course<'_>,
    grid: &Grid,
    (last, (next, until)): (Saying, (Saying, usize)),
    body: usize,
    least: Least,
) -> Vec<Candidate> {
    let frame = next.frame;
    let (residual, implied) = implied(course, grid, &last, &next);
    let candidate = |saying, until, residual| Candidate {
        saying,
        until,
        update: Update {
            frame,
            body,
            laws: [last.law, next.law],
            changes_holder: next.holder.is_some() && last.holder != next.holder,
            push: next.push.filter(|push| last.push != Some(*push)),
            residual,
        },
    };
    if !next.law.moves() {
        return vec![candidate(next, until, residual)];
    }
    let velocity = Some(Residual::of_velocity(
        &next.motion.twist(),
        &implied,
        grid,
        COARSENESS,
    ));
    let mut all = vec![candidate(
        next,
        until,
        Residual {
            velocity,
            ..residual
        },
    )];
    if let Ok(motion) = Motion::new(next.motion.pose(), implied.motion(grid).twist()) {
        let saying = Saying { motion, ..next };
        let holds = course.holds_until(&saying);
        if holds >= until || least == Least::Bits && holds > frame {
            all.insert(0, candidate(saying, holds, residual));
        }
    }
    all
}

/// What was predicted of the frame at which the next saying begins, as that saying's holder sees it.
fn in_frame_of(course: &Course<'_>, last: &Saying, next: &Saying) -> Motion {
    let frame = next.frame;
    let predicted = course.predicted(last, frame, &mut Cursor::default());
    if last.holder == next.holder {
        return predicted;
    }
    let by = |holder: usize| course.holders[holder].at(frame);
    let world = match last.holder.and_then(by) {
        Some(by) => carried(by, &predicted.pose()),
        None => predicted,
    };
    match next.holder.and_then(by) {
        Some(by) => seen_from(&by.pose(), &world.pose()),
        None => world,
    }
}
