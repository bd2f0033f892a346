//! One body's corrections, tried: what each says, and what it is worth.
//!
//! Most of a correction is the same for many: a place serves every law and every way to say velocities, and what it says
//! costs the same beside each of them. So a place is reckoned once, and allocates nothing.

use glam::DVec3;
use rhumb_reckoning::{
    Anchor, Grid, Motion, PackedRotation, Predictor, RESIDUAL_LIMIT, Residual, Seconds, Snapped,
    Ticks, Track, VelocityResidual,
};

use super::lasting::{Prospect, ROUGHLY};
use super::shares::{Shares, Worth};
use super::{Aim, Choice, Chooser, Frame, OVERHEAD, Subject, Way, apart, doubt};
use crate::packet::{Age, Opening, PlaceCost, Pricing, Saying};

/// Steps are rounded to the nearest.
const NEAREST: [f64; 2] = [0.5; 2];
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
    /// What errors are worth of its tolerance, and what each tick adds to the expected one.
    pub(super) worth: Worth,
    pub(super) doubt: f64,
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
    pub(super) off: Shares,
    /// The implied velocities, tick by tick.
    pub(super) implies: Shares,
    /// What position and turn cost.
    cost: PlaceCost,
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
    /// The grid point nearest to where it was predicted.
    position: [i32; 3],
    rotation: PackedRotation,
    /// How far the truth is from it, in steps of position and of turn.
    wanted: [DVec3; 2],
}

/// The best so far, and how it came about.
#[derive(Clone, Copy, Debug)]
pub(super) struct Best {
    candidate: Candidate,
    /// The number of its course.
    pub(super) way: usize,
    pub(super) aim: Aim,
    said: Option<u32>,
    outset: Outset,
}

/// What all corrections of one course have in common.
#[derive(Clone, Copy, Debug)]
struct Outset {
    /// What its form costs without velocities, and with them, in 1/256 bits.
    forms: [u32; 2],
    prospect: Prospect,
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
        let grid = chooser.tracks.grid(subject.slot);
        Self {
            chooser,
            subject,
            grid,
            age,
            over: subject.track.predictor.astray(ticks, rate),
            worth: Worth::of(&chooser.allowance(subject), grid, rate.step().seconds()),
            doubt: doubt(subject),
        }
    }
}

impl Trial<'_> {
    pub(super) fn footing<'f>(&self, frame: &'f Frame<'f>) -> Footing<'f> {
        let predicted = &frame.predicted;
        Footing {
            frame,
            position: Snapped::position_of(&predicted.pose(), self.grid),
            rotation: PackedRotation::of(predicted.pose().rotation),
            wanted: Residual::wanted(&frame.truth.pose(), &predicted.pose(), self.grid),
        }
    }

    /// Where a correction puts the body that comes nearest to an aim, if that keeps the promise.
    pub(super) fn place(&self, footing: &Footing<'_>, aim: Aim) -> Option<Place> {
        let residual = residual(self.wanted(footing, aim), NEAREST)?;
        self.place_at(footing, residual, 1.0)
    }

    /// How far an aim is from what was predicted, in steps of position and of turn.
    fn wanted(&self, footing: &Footing<'_>, aim: Aim) -> [DVec3; 2] {
        let [position, turn] = footing.wanted;
        match aim {
            Aim::Truth => [position, turn],
            Aim::Beside([metres, radians]) => [
                position + metres / self.grid.position(),
                turn + radians / self.grid.turn(),
            ],
        }
    }

    /// The same of a given correction, if it uses at most this share of the tolerance.
    fn place_at(&self, footing: &Footing<'_>, residual: Residual, most: f64) -> Option<Place> {
        let (grid, chooser, frame) = (self.grid, self.chooser, footing.frame);
        let from = (footing.position, footing.rotation);
        let implied = residual.onto_snapped(&frame.predicted, from, self.over, grid);
        let still = implied.stilled().motion(grid);
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
            off: Shares::of(apart(&still.pose(), &frame.truth.pose()), self.worth.still),
            implies: Shares::of_steps(implied.linear, implied.angular, self.worth.velocities),
            cost: PlaceCost::of(self.age, &residual),
        })
    }

    /// Tries a place without velocities, and with them for as long as they may pay.
    pub(super) fn try_all(
        &self,
        (number, way): (usize, &Way<'_>),
        aim: Aim,
        place: &Place,
        best: &mut Option<Best>,
    ) {
        let outset = Outset {
            forms: self.forms(way),
            prospect: self.prospect(way),
        };
        let mut note = |candidate: Candidate, said| {
            let least = best
                .as_ref()
                .map_or(f64::INFINITY, |best| best.candidate.price);
            let better = best.is_none() || candidate.price < least;
            if !better {
                return least;
            }
            *best = Some(Best {
                candidate,
                way: number,
                aim,
                said,
                outset,
            });
            candidate.price
        };
        let moves = way.predictor != Predictor::Rest;
        let mut least = f64::INFINITY;
        if let Some(candidate) = self.try_one(way, &outset, place, None) {
            least = note(candidate, None);
        }
        if !moves {
            return;
        }
        // Nothing lasts longer than what goes on at the true velocities, and finer steps cost more.
        let longest = self.life(way, &outset.prospect, place, Some(&place.lacking));
        for coarseness in self.chooser.features.steps(SAID) {
            let velocity = place.lacking.coarser(coarseness);
            let cost = self.cost(way, &outset.forms, place, Some(&velocity));
            if price(cost, longest) >= least {
                return;
            }
            if velocity.is_within_limits() {
                let life = self.life(way, &outset.prospect, place, Some(&velocity));
                let candidate = Candidate {
                    velocity: Some(velocity),
                    price: price(cost, life),
                };
                least = note(candidate, Some(coarseness));
            }
        }
    }

    /// One correction; velocities are not said, or in steps that are doubled so often.
    fn try_one(
        &self,
        way: &Way<'_>,
        outset: &Outset,
        place: &Place,
        said: Option<u32>,
    ) -> Option<Candidate> {
        let moves = way.predictor != Predictor::Rest;
        let features = &self.chooser.features;
        let plain = if features.coarse { PLAIN } else { 0 };
        let speaks = moves && (said.is_some() || !features.derived);
        let velocity = speaks.then(|| place.lacking.coarser(said.unwrap_or(plain)));
        // Of a place that was found position and turn are.
        if velocity.is_some_and(|velocity| !velocity.is_within_limits()) {
            return None;
        }
        let life = self.life(way, &outset.prospect, place, velocity.as_ref());
        let cost = self.cost(way, &outset.forms, place, velocity.as_ref());
        Some(Candidate {
            velocity,
            price: price(cost, life),
        })
    }

    /// What the form of a correction of this course costs without velocities, and with them, in 1/256 bits.
    fn forms(&self, way: &Way<'_>) -> [u32; 2] {
        let form = |moved| Opening.cost_of_form(&way.course, self.age, moved);
        let still = form(false);
        match way.predictor {
            Predictor::Rest => [still; 2],
            _ => [still, form(true)],
        }
    }

    /// What a correction costs, in 1/256 bits.
    fn cost(
        &self,
        way: &Way<'_>,
        forms: &[u32; 2],
        place: &Place,
        velocity: Option<&VelocityResidual>,
    ) -> u32 {
        let moved = velocity.is_some();
        let of_velocity = velocity.map_or(0, |velocity| {
            Opening.cost_of_velocity(&way.course, self.age, velocity)
        });
        forms[usize::from(moved)] + place.cost.by(&way.course, moved) + of_velocity
    }

    /// Leaves steps of the best correction out where that pays.
    pub(super) fn make_sparser(
        &self,
        way: &Way<'_>,
        footing: &Footing<'_>,
        place: &mut Place,
        best: &mut Best,
    ) {
        let slack = self.chooser.slack;
        let (sparse, most) = (SPARSE * slack, SPARSE_SHARE * slack);
        let wanted = self.wanted(footing, best.aim);
        // What was tried already is no better now.
        let mut tried = [place.residual; 3];
        for (count, rounding) in (1..).zip([[sparse; 2], [sparse, 0.5], [0.5, sparse]]) {
            let Some(residual) = residual(wanted, rounding) else {
                continue;
            };
            if tried.iter().any(|other| is_same_place(other, &residual)) {
                continue;
            }
            if let Some(free) = tried.get_mut(count) {
                *free = residual;
            }
            if self.surely_loses(way, footing, best, &residual) {
                continue;
            }
            let Some(sparser) = self.place_at(footing, residual, most) else {
                continue;
            };
            let candidate = self.try_one(way, &best.outset, &sparser, best.said);
            if let Some(candidate) = candidate
                && candidate.price < best.candidate.price
            {
                (best.candidate, *place) = (candidate, sparser);
            }
        }
    }

    /// Whether a sparser correction clearly takes too much of the tolerance, or lasts for too short a time for what it costs:
    /// then it need not be put on the grid.
    fn surely_loses(
        &self,
        way: &Way<'_>,
        footing: &Footing<'_>,
        best: &Best,
        residual: &Residual,
    ) -> bool {
        let Footing { frame, wanted, .. } = footing;
        let (position, turn) = (whole(residual.position), whole(residual.turn));
        let off = Shares::of([position - wanted[0], turn - wanted[1]], self.worth.steps);
        if self.worth.both(&off) > SPARSE_SHARE + ROUGHLY {
            return true;
        }
        // How long a track holds that begins otherwise is not known so roughly.
        if !self.subject.ahead.is_empty() || best.candidate.velocity.is_some() {
            return false;
        }
        let moves = way.predictor != Predictor::Rest;
        let implies = moves.then(|| {
            let twist = frame.predicted.twist();
            let rate = 1.0 / self.over.seconds();
            let linear = twist.linear + position * (self.grid.position() * rate);
            let angular = twist.angular + turn * (self.grid.turn() * rate);
            Shares::of([linear, angular], self.worth.moving)
        });
        let cost = best.outset.forms[0] + PlaceCost::of(self.age, residual).by(&way.course, false);
        let life = self.at_most(&best.outset.prospect, &off, implies);
        price(cost, life) >= best.candidate.price
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

impl Best {
    /// As it is said, and believed from then on.
    pub(super) fn choice(&self, way: &Way<'_>, place: &Place, trial: &Trial<'_>) -> Choice {
        let Candidate { velocity, .. } = &self.candidate;
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

/// Position and turn in whole steps.
fn residual([position, turn]: [DVec3; 2], [of_position, of_turn]: [f64; 2]) -> Option<Residual> {
    Some(Residual {
        position: rounded(position, of_position)?,
        turn: rounded(turn, of_turn)?,
        velocity: None,
    })
}

fn is_same_place(one: &Residual, other: &Residual) -> bool {
    let same = |[a, b, c]: [i32; 3], [x, y, z]: [i32; 3]| a == x && b == y && c == z;
    same(one.position, other.position) && same(one.turn, other.turn)
}

fn whole([x, y, z]: [i32; 3]) -> DVec3 {
    DVec3::new(f64::from(x), f64::from(y), f64::from(z))
}

/// To whole steps: up from this share of a step on, towards zero below; `None` beyond what an update may hold.
fn rounded(steps: DVec3, share: f64) -> Option<[i32; 3]> {
    let round = |x: f64| {
        let whole = x.abs() + (1.0 - share);
        // Written so that NaN is not within either; what is cut off is a fraction, and nothing of what is too large.
        let within = whole < f64::from(RESIDUAL_LIMIT) + 1.0;
        let whole = whole as i32;
        within.then_some(if x < 0.0 { -whole } else { whole })
    };
    Some([round(steps.x)?, round(steps.y)?, round(steps.z)?])
}
