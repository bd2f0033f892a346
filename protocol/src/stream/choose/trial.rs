//! One body's corrections, tried: what each says, and what it is worth.
//!
//! Most of a correction is the same for many: a place serves every law and every way to say velocities, and what it says
//! costs the same beside each of them. So a place is reckoned once, and allocates nothing.

use glam::DVec3;
use rhumb_reckoning::{
    Anchor, Grid, Motion, Predictor, RESIDUAL_LIMIT, Residual, Seconds, Snapped, Ticks, Track,
    VelocityResidual,
};

use super::{
    Aim, Allowance, Choice, Chooser, Frame, NEAREST, OVERHEAD, Subject, Way, apart, doubt,
};
use crate::packet::{Age, Course, Saying};

/// Steps by which corrections are made sparser: a part of the last step below this share is left out.
const SPARSE: f64 = 0.7;
/// A sparser correction may use this much of the tolerance.
const SPARSE_SHARE: f64 = 0.9;
/// The coarseness of velocities that are said whether or not it pays.
const PLAIN: u32 = 3;
/// Velocities are said in steps that are doubled so often, if at all.
const SAID: [u32; 6] = [9, 7, 5, 3, 1, 0];

/// What is tried for one body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<'t> {
    pub(super) chooser: &'t Chooser<'t>,
    pub(super) subject: &'t Subject<'t>,
    pub(super) grid: &'t Grid,
    /// Of the track that is corrected.
    age: Age,
    /// In what time its prediction went astray.
    over: Seconds,
    pub(super) allowance: Allowance,
    /// What each tick adds to the expected error, as a share of the tolerance.
    pub(super) doubt: f64,
    /// Seconds in a tick.
    pub(super) step_s: f64,
}

/// Where a correction puts a body, whatever its law.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Position and turn, without velocities.
    residual: Residual,
    /// The same on the grid, with the velocities that it implies; what these differ by from the true ones.
    implied: Snapped,
    lacking: VelocityResidual,
    /// Where that is, without velocities, and how far from the truth.
    still: Motion,
    pub(super) off: [DVec3; 2],
    /// What position and turn cost, by whether the course stays and whether velocities are said.
    costs: [Option<u32>; 4],
}

/// A correction that keeps the promise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    velocity: Option<VelocityResidual>,
    /// Bits in 256ths by ticks: less is better.
    price: f64,
}

/// What a correction begins from, in the frame of its course.
#[derive(Clone, Copy, Debug)]
pub(super) struct Footing<'f> {
    frame: &'f Frame<'f>,
    /// The grid point nearest to what was predicted.
    snapped: Snapped,
    /// How far the truth is from it, in steps of position and of turn.
    wanted: [DVec3; 2],
}

/// The best so far, and how it came about.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best<'w> {
    candidate: Candidate,
    way: &'w Way<'w>,
    footing: &'w Footing<'w>,
    place: Place,
    aim: Aim,
    said: Option<u32>,
}

impl<'t> Trial<'t> {
    /// Of a body whose track is so old.
    pub(super) fn new(
        chooser: &'t Chooser<'t>,
        subject: &'t Subject<'t>,
        age: Age,
        ticks: Ticks,
    ) -> Self {
        let rate = chooser.tracks.integrator().rate;
        Self {
            chooser,
            subject,
            grid: chooser.tracks.grid(subject.slot),
            age,
            over: subject.track.predictor.astray(ticks, rate),
            allowance: chooser.allowance(subject),
            doubt: doubt(subject),
            step_s: rate.step().seconds(),
        }
    }
}

impl Trial<'_> {
    pub(super) fn footing<'f>(&self, frame: &'f Frame<'f>) -> Footing<'f> {
        let predicted = &frame.predicted;
        Footing {
            frame,
            snapped: Snapped::of(predicted, self.grid),
            wanted: Residual::wanted(&frame.truth.pose(), &predicted.pose(), self.grid),
        }
    }

    /// Where a correction puts the body, if that keeps the promise.
    pub(super) fn place(
        &self,
        footing: &Footing<'_>,
        aim: Aim,
        rounding: [f64; 2],
    ) -> Option<Place> {
        let residual = self.residual(footing, aim, rounding)?;
        self.place_at(footing, residual, rounding)
    }

    fn residual(&self, footing: &Footing<'_>, aim: Aim, rounding: [f64; 2]) -> Option<Residual> {
        let (grid, [position, turn]) = (self.grid, footing.wanted);
        Some(Residual {
            position: rounded(position + aim.pose[0] / grid.position(), rounding[0])?,
            turn: rounded(turn + aim.pose[1] / grid.turn(), rounding[1])?,
            velocity: None,
        })
    }

    fn place_at(
        &self,
        footing: &Footing<'_>,
        residual: Residual,
        rounding: [f64; 2],
    ) -> Option<Place> {
        let (grid, chooser, frame) = (self.grid, self.chooser, footing.frame);
        let implied = residual.onto_snapped(&frame.predicted, &footing.snapped, self.over, grid);
        let still = implied.stilled().motion(grid);
        let most = if rounding == NEAREST {
            1.0
        } else {
            SPARSE_SHARE * chooser.slack
        };
        if !residual.is_within_limits()
            || chooser.exact_share(self.subject, frame, &still.pose()) > most
        {
            return None;
        }
        Some(Place {
            residual,
            implied,
            lacking: VelocityResidual::finest(&frame.truth.twist(), &implied, grid),
            still,
            off: apart(&still.pose(), &frame.truth.pose()),
            costs: [None; 4],
        })
    }

    /// Tries a place without velocities, and with them for as long as they may pay.
    pub(super) fn try_all<'w>(
        &self,
        way: &'w Way<'w>,
        (footing, aim): (&'w Footing<'w>, Aim),
        place: &mut Place,
        best: &mut Option<Best<'w>>,
    ) {
        let mut note = |candidate: Candidate, place: &Place, said| {
            if best
                .as_ref()
                .is_none_or(|best| candidate.price < best.candidate.price)
            {
                *best = Some(Best {
                    candidate,
                    way,
                    footing,
                    place: *place,
                    aim,
                    said,
                });
            }
            best.as_ref()
                .map_or(f64::INFINITY, |best| best.candidate.price)
        };
        let mut least = f64::INFINITY;
        if let Some(candidate) = self.try_one(way, place, None) {
            least = note(candidate, place, None);
        }
        if way.predictor == Predictor::Rest {
            return;
        }
        // Nothing lasts longer than what goes on at the true velocities, and finer steps cost more.
        let longest = self.life(way, place, Some(&place.lacking));
        for coarseness in SAID {
            let velocity = place.lacking.coarser(coarseness);
            let cost = self.cost(way, place, Some(&velocity));
            if price(cost, longest) >= least {
                return;
            }
            if let Some(candidate) = self.try_one(way, place, Some(coarseness)) {
                least = note(candidate, place, Some(coarseness));
            }
        }
    }

    /// One correction; velocities are not said, or in steps that are doubled so often.
    fn try_one(&self, way: &Way<'_>, place: &mut Place, said: Option<u32>) -> Option<Candidate> {
        let chooser = self.chooser;
        let moves = way.predictor != Predictor::Rest;
        if !moves && said.is_some() {
            return None;
        }
        let speaks = moves && (said.is_some() || !chooser.features.derived);
        let velocity = speaks.then(|| place.lacking.coarser(said.unwrap_or(PLAIN)));
        // Of a place that was found position and turn are.
        if velocity.is_some_and(|velocity| !velocity.is_within_limits()) {
            return None;
        }
        let life = self.life(way, place, velocity.as_ref());
        let cost = self.cost(way, place, velocity.as_ref());
        Some(Candidate {
            velocity,
            price: price(cost, life),
        })
    }

    /// What a correction costs, in 1/256 bits.
    fn cost(&self, way: &Way<'_>, place: &mut Place, velocity: Option<&VelocityResidual>) -> u32 {
        let (tongue, moved) = (self.chooser.tongue, velocity.is_some());
        let stays = way.course == Course::Same;
        let known = &mut place.costs[usize::from(stays) * 2 + usize::from(moved)];
        let of_place = *known.get_or_insert_with(|| {
            tongue.cost_of_place(&way.course, self.age, moved, &place.residual)
        });
        let of_velocity = velocity.map_or(0, |velocity| {
            tongue.cost_of_velocity(&way.course, self.age, velocity)
        });
        tongue.cost_of_form(&way.course, self.age, moved) + of_place + of_velocity
    }

    /// Leaves steps out where that pays.
    pub(super) fn make_sparser(&self, best: &mut Best<'_>) {
        let sparse = SPARSE * self.chooser.slack;
        let (way, footing, aim, said) = (best.way, best.footing, best.aim, best.said);
        let mut tried = [Some(best.place.residual), None, None];
        for rounding in [[sparse; 2], [sparse, 0.5], [0.5, sparse]] {
            let Some(residual) = self.residual(footing, aim, rounding) else {
                continue;
            };
            // What was tried already is no better now.
            if tried.contains(&Some(residual)) {
                continue;
            }
            if let Some(free) = tried.iter_mut().find(|tried| tried.is_none()) {
                *free = Some(residual);
            }
            let Some(mut place) = self.place_at(footing, residual, rounding) else {
                continue;
            };
            if let Some(candidate) = self.try_one(way, &mut place, said)
                && candidate.price < best.candidate.price
            {
                (best.candidate, best.place) = (candidate, place);
            }
        }
    }
}

impl Place {
    /// The motion that a track begins with.
    pub(super) fn begun(
        &self,
        way: &Way<'_>,
        velocity: Option<&VelocityResidual>,
        grid: &Grid,
    ) -> Motion {
        match way.predictor {
            Predictor::Rest => self.still,
            _ => self.still.moving(self.snapped(velocity).twist(grid)),
        }
    }

    fn snapped(&self, velocity: Option<&VelocityResidual>) -> Snapped {
        velocity.map_or(self.implied, |velocity| self.implied.hastened(velocity))
    }
}

impl Best<'_> {
    /// As it is said, and believed from then on.
    pub(super) fn choice(&self, trial: &Trial<'_>) -> Choice {
        let Self {
            candidate: Candidate { velocity, .. },
            way,
            place,
            ..
        } = self;
        let snapped = place.snapped(velocity.as_ref());
        let rests = way.predictor == Predictor::Rest;
        Choice {
            saying: Saying::Residual {
                course: way.course,
                age: trial.age,
                residual: Residual {
                    velocity: *velocity,
                    ..place.residual
                },
            },
            track: Track {
                origin: trial.subject.tick,
                predictor: way.predictor,
                anchor: Anchor::Snapped(if rests { snapped.stilled() } else { snapped }),
                carrier: way.frame.holder.map(|holder| holder.slot.id(holder.index)),
            },
        }
    }
}

/// Bits in 256ths by ticks.
fn price(cost: u32, life: f64) -> f64 {
    f64::from(cost + OVERHEAD) / life
}

/// To whole steps: up from this share of a step on, towards zero below; `None` beyond what an update may hold.
fn rounded(steps: DVec3, share: f64) -> Option<[i32; 3]> {
    let limit = f64::from(RESIDUAL_LIMIT);
    let round = |x: f64| {
        let whole = libm::copysign(libm::floor(x.abs() + (1.0 - share)), x);
        // Written so that NaN fails too.
        (whole.abs() <= limit).then_some(whole as i32)
    };
    Some([round(steps.x)?, round(steps.y)?, round(steps.z)?])
}
