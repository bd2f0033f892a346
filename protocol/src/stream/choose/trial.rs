//! One body's corrections, tried: what each says, and what it is units.
//!
//! Most of a correction is the same for many: a place serves every predictor and every mode_candidate to say velocities, and what it says
//! costs the same beside each of them. So a place is reckoned once, and allocates nothing.

use glam::DVec3;
use rhumb_reckoning::{
    Anchor, Grid, Motion, PackedRotation, Predictor, QuantisedState, RESIDUAL_LIMIT, Residual,
    Seconds, Ticks, Track, VelocityResidual,
};

use super::lifetime::{LifetimeEstimate, ROUGHLY};
use super::shares::{ShareUnits, Shares};
use super::{
    Aim, Chooser, ChosenUpdate, ModeCandidate, OVERHEAD, ReferenceFrame, Subject, apart,
    error_growth,
};
use crate::packet::{Age, CostModel, InitialCostModel, PoseCost, UpdatePayload};

/// Steps are rounded to the nearest.
const NEAREST: [f64; 2] = [0.5; 2];
/// Steps by which corrections are made sparser: a part of the last step below this share is left out.
const SPARSE: f64 = 0.7;
/// A sparser correction may use this much of the tolerance.
const SPARSE_SHARE: f64 = 0.9;
/// The velocity_exponent of velocities that are exponent whether or not it pays.
const PLAIN: u32 = 3;
/// Velocities are exponent in steps that are doubled so often, if at all.
const VELOCITY_EXPONENTS: [u32; 6] = [9, 7, 5, 3, 1, 0];

/// What is tried for one body.
#[derive(Clone, Copy, Debug)]
pub(super) struct Trial<'t> {
    pub(super) chooser: &'t Chooser<'t>,
    pub(super) subject: &'t Subject<'t>,
    pub(super) grid: &'t Grid,
    /// Of the track that is corrected.
    age: Age,
    /// In what time its prediction went divergence_time.
    over: Seconds,
    /// What errors are units of its tolerance, and what each tick adds to the expected one.
    pub(super) units: ShareUnits,
    pub(super) error_growth: f64,
}

/// Where a correction puts a body, whatever its predictor.
#[derive(Clone, Copy, Debug)]
pub(super) struct CorrectedPose {
    /// Position and turn, without velocities.
    residual: Residual,
    /// The same on the grid, with the velocities that it implies; what these differ by from the true ones.
    implied: QuantisedState,
    velocity_error: VelocityResidual,
    /// Where that is, without velocities, and how far from the truth.
    still: Motion,
    pub(super) off: Shares,
    /// The implied velocities, tick by tick.
    pub(super) implies: Shares,
    /// What position and turn cost.
    cost: PoseCost,
}

/// A correction that keeps the promise.
#[derive(Clone, Copy, Debug)]
pub(super) struct PricedCorrection {
    velocity: Option<VelocityResidual>,
    /// Bits in 256ths by ticks: less is better.
    price: f64,
}

/// What a correction begins from, in the frame of its mode.
#[derive(Clone, Copy, Debug)]
pub(super) struct CorrectionBase<'f> {
    frame: &'f ReferenceFrame<'f>,
    /// The grid point nearest to where it was predicted.
    position: [i32; 3],
    rotation: PackedRotation,
    /// How far the truth is from it, in steps of position and of turn.
    wanted: [DVec3; 2],
}

/// The best so far, and how it came about.
#[derive(Clone, Copy, Debug)]
pub(super) struct BestCorrection {
    priced: PricedCorrection,
    /// The number of its mode.
    pub(super) mode_candidate: usize,
    pub(super) aim: Aim,
    exponent: Option<u32>,
    mode_costs: ModeCosts,
}

/// What all corrections of one mode have in common.
#[derive(Clone, Copy, Debug)]
struct ModeCosts {
    /// What its form costs without velocities, and with them, in 1/256 bits.
    forms: [u32; 2],
    lifetime_estimate: LifetimeEstimate,
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
            over: subject.track.predictor.divergence_time(ticks, rate),
            units: ShareUnits::of(&chooser.allowance(subject), grid, rate.step().seconds()),
            error_growth: error_growth(subject),
        }
    }
}

impl Trial<'_> {
    pub(super) fn correction_base<'f>(&self, frame: &'f ReferenceFrame<'f>) -> CorrectionBase<'f> {
        let predicted = &frame.predicted;
        CorrectionBase {
            frame,
            position: QuantisedState::position_of(&predicted.pose(), self.grid),
            rotation: PackedRotation::of(predicted.pose().rotation),
            wanted: Residual::wanted(&frame.truth.pose(), &predicted.pose(), self.grid),
        }
    }

    /// Where a correction puts the body that comes nearest to an aim, if that keeps the promise.
    pub(super) fn place(
        &self,
        correction_base: &CorrectionBase<'_>,
        aim: Aim,
    ) -> Option<CorrectedPose> {
        let residual = residual(self.wanted(correction_base, aim), NEAREST)?;
        self.place_at(correction_base, residual, 1.0)
    }

    /// How far an aim is from what was predicted, in steps of position and of turn.
    fn wanted(&self, correction_base: &CorrectionBase<'_>, aim: Aim) -> [DVec3; 2] {
        let [position, turn] = correction_base.wanted;
        match aim {
            Aim::Truth => [position, turn],
            Aim::Beside([metres, radians]) => [
                position + metres / self.grid.position(),
                turn + radians / self.grid.turn(),
            ],
        }
    }

    /// The same of a given correction, if it uses at most this share of the tolerance.
    fn place_at(
        &self,
        correction_base: &CorrectionBase<'_>,
        residual: Residual,
        most: f64,
    ) -> Option<CorrectedPose> {
        let (grid, chooser, frame) = (self.grid, self.chooser, correction_base.frame);
        let from = (correction_base.position, correction_base.rotation);
        let implied = residual.onto_quantised(&frame.predicted, from, self.over, grid);
        let still = implied.stilled().motion(grid);
        if !residual.is_within_limits()
            || chooser.exact_share(self.subject, frame, &still.pose()) > most
        {
            return None;
        }
        Some(CorrectedPose {
            residual,
            implied,
            velocity_error: VelocityResidual::finest(&frame.truth.twist(), &implied, grid),
            still,
            off: Shares::of(apart(&still.pose(), &frame.truth.pose()), self.units.still),
            implies: Shares::of_steps(implied.linear, implied.angular, self.units.velocities),
            cost: PoseCost::of(self.age, &residual),
        })
    }

    /// Tries a place without velocities, and with them for as long as they may pay.
    pub(super) fn try_all(
        &self,
        (number, mode_candidate): (usize, &ModeCandidate<'_>),
        aim: Aim,
        place: &CorrectedPose,
        best: &mut Option<BestCorrection>,
    ) {
        let mode_costs = ModeCosts {
            forms: self.forms(mode_candidate),
            lifetime_estimate: self.lifetime_estimate(mode_candidate),
        };
        let mut note = |priced: PricedCorrection, exponent| {
            let least = best
                .as_ref()
                .map_or(f64::INFINITY, |best| best.priced.price);
            let better = best.is_none() || priced.price < least;
            if !better {
                return least;
            }
            *best = Some(BestCorrection {
                priced,
                mode_candidate: number,
                aim,
                exponent,
                mode_costs,
            });
            priced.price
        };
        let moves = mode_candidate.predictor != Predictor::Rest;
        let mut least = f64::INFINITY;
        if let Some(priced) = self.try_one(mode_candidate, &mode_costs, place, None) {
            least = note(priced, None);
        }
        if !moves {
            return;
        }
        // Nothing lasts longer than what goes on at the true velocities, and finer steps cost more.
        let longest = self.lifetime(
            mode_candidate,
            &mode_costs.lifetime_estimate,
            place,
            Some(&place.velocity_error),
        );
        for velocity_exponent in self.chooser.features.steps(VELOCITY_EXPONENTS) {
            let velocity = place.velocity_error.coarser(velocity_exponent);
            let cost = self.cost(mode_candidate, &mode_costs.forms, place, Some(&velocity));
            if price(cost, longest) >= least {
                return;
            }
            if velocity.is_within_limits() {
                let lifetime = self.lifetime(
                    mode_candidate,
                    &mode_costs.lifetime_estimate,
                    place,
                    Some(&velocity),
                );
                let priced = PricedCorrection {
                    velocity: Some(velocity),
                    price: price(cost, lifetime),
                };
                least = note(priced, Some(velocity_exponent));
            }
        }
    }

    /// One correction; velocities are not exponent, or in steps that are doubled so often.
    fn try_one(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        mode_costs: &ModeCosts,
        place: &CorrectedPose,
        exponent: Option<u32>,
    ) -> Option<PricedCorrection> {
        let moves = mode_candidate.predictor != Predictor::Rest;
        let features = &self.chooser.features;
        let plain = if features.coarse { PLAIN } else { 0 };
        let speaks = moves && (exponent.is_some() || !features.derived);
        let velocity = speaks.then(|| place.velocity_error.coarser(exponent.unwrap_or(plain)));
        // Of a place that was found position and turn are.
        if velocity.is_some_and(|velocity| !velocity.is_within_limits()) {
            return None;
        }
        let lifetime = self.lifetime(
            mode_candidate,
            &mode_costs.lifetime_estimate,
            place,
            velocity.as_ref(),
        );
        let cost = self.cost(mode_candidate, &mode_costs.forms, place, velocity.as_ref());
        Some(PricedCorrection {
            velocity,
            price: price(cost, lifetime),
        })
    }

    /// What the form of a correction of this mode costs without velocities, and with them, in 1/256 bits.
    fn forms(&self, mode_candidate: &ModeCandidate<'_>) -> [u32; 2] {
        let form = |moved| InitialCostModel.cost_of_form(&mode_candidate.mode, self.age, moved);
        let still = form(false);
        match mode_candidate.predictor {
            Predictor::Rest => [still; 2],
            _ => [still, form(true)],
        }
    }

    /// What a correction costs, in 1/256 bits.
    fn cost(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        forms: &[u32; 2],
        place: &CorrectedPose,
        velocity: Option<&VelocityResidual>,
    ) -> u32 {
        let moved = velocity.is_some();
        let of_velocity = velocity.map_or(0, |velocity| {
            InitialCostModel.cost_of_velocity(&mode_candidate.mode, self.age, velocity)
        });
        forms[usize::from(moved)] + place.cost.by(&mode_candidate.mode, moved) + of_velocity
    }

    /// Leaves steps of the best correction out where that pays.
    pub(super) fn make_sparser(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        correction_base: &CorrectionBase<'_>,
        place: &mut CorrectedPose,
        best: &mut BestCorrection,
    ) {
        let slack = self.chooser.slack;
        let (sparse, most) = (SPARSE * slack, SPARSE_SHARE * slack);
        let wanted = self.wanted(correction_base, best.aim);
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
            if self.surely_loses(mode_candidate, correction_base, best, &residual) {
                continue;
            }
            let Some(sparser) = self.place_at(correction_base, residual, most) else {
                continue;
            };
            let priced = self.try_one(mode_candidate, &best.mode_costs, &sparser, best.exponent);
            if let Some(priced) = priced
                && priced.price < best.priced.price
            {
                (best.priced, *place) = (priced, sparser);
            }
        }
    }

    /// Whether a sparser correction clearly takes too much of the tolerance, or lasts for too short a time for what it costs:
    /// then it need not be put on the grid.
    fn surely_loses(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        correction_base: &CorrectionBase<'_>,
        best: &BestCorrection,
        residual: &Residual,
    ) -> bool {
        let CorrectionBase { frame, wanted, .. } = correction_base;
        let (position, turn) = (whole(residual.position), whole(residual.turn));
        let off = Shares::of([position - wanted[0], turn - wanted[1]], self.units.steps);
        if self.units.both(&off) > SPARSE_SHARE + ROUGHLY {
            return true;
        }
        // How long a track holds that begins otherwise is not known so roughly.
        if !self.subject.ahead.is_empty() || best.priced.velocity.is_some() {
            return false;
        }
        let moves = mode_candidate.predictor != Predictor::Rest;
        let implies = moves.then(|| {
            let twist = frame.predicted.twist();
            let rate = 1.0 / self.over.seconds();
            let linear = twist.linear + position * (self.grid.position() * rate);
            let angular = twist.angular + turn * (self.grid.turn() * rate);
            Shares::of([linear, angular], self.units.moving)
        });
        let cost = best.mode_costs.forms[0]
            + PoseCost::of(self.age, residual).by(&mode_candidate.mode, false);
        let lifetime = self.at_most(&best.mode_costs.lifetime_estimate, &off, implies);
        price(cost, lifetime) >= best.priced.price
    }
}

impl CorrectedPose {
    /// The motion that a track begins with.
    pub(super) fn begun(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        velocity: Option<&VelocityResidual>,
        grid: &Grid,
    ) -> Motion {
        match mode_candidate.predictor {
            Predictor::Rest => self.still,
            _ => self.still.moving(self.quantised(velocity).twist(grid)),
        }
    }

    fn quantised(&self, velocity: Option<&VelocityResidual>) -> QuantisedState {
        velocity.map_or(self.implied, |velocity| self.implied.hastened(velocity))
    }
}

impl BestCorrection {
    /// As it is exponent, and predicted_motion from then on.
    pub(super) fn choice(
        &self,
        mode_candidate: &ModeCandidate<'_>,
        place: &CorrectedPose,
        trial: &Trial<'_>,
    ) -> ChosenUpdate {
        let PricedCorrection { velocity, .. } = &self.priced;
        let quantised = place.quantised(velocity.as_ref());
        let rests = mode_candidate.predictor == Predictor::Rest;
        ChosenUpdate {
            payload: UpdatePayload::Residual {
                mode: mode_candidate.mode,
                age: trial.age,
                residual: Residual {
                    velocity: *velocity,
                    ..place.residual
                },
            },
            track: Track {
                origin: trial.subject.tick,
                predictor: mode_candidate.predictor,
                anchor: Anchor::Quantised(if rests {
                    quantised.stilled()
                } else {
                    quantised
                }),
                parent: mode_candidate
                    .frame
                    .parent_candidate
                    .map(|parent_candidate| parent_candidate.slot.id(parent_candidate.index)),
            },
        }
    }
}

/// Bits in 256ths by ticks.
fn price(cost: u32, lifetime: f64) -> f64 {
    f64::from(cost + OVERHEAD) / lifetime
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
