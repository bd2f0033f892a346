//! The payload of an update: a correction of a prediction, or a keyframe.
//!
//! The range coder writes the numbers; their cost depends on the packet so far. Decoding needs no track, so a
//! subscriber that lacks some tracks can still read the packet to its end (PROTOCOL 5.6). Writer, reader and cost
//! model share one order of the numbers. A stream that publishes every few ticks has no other ages, so an age is not
//! given in ticks.

use core::num::NonZeroU32;

use rhumb_reckoning::{
    ConstantAcceleration, Predictor, Residual, RestCorrection, Tick, VelocityResidual,
};

use super::keyframe::{
    ACCELERATED, INDEX_BITS, Keyframe, numbers_of_acceleration, predictor_code, predictor_of,
    read_acceleration, unzigzag, write_acceleration, zigzag,
};
use super::model::Model;
use super::tables::contexts::TripleContexts;
use super::tables::{ASSIGN_ALIAS, END, FORM_COUNT, MODES, contexts};
use crate::wire::Malformed;
use crate::wire::range::{Alphabet, RangeReader, RangeWriter, TOTAL_BITS};

/// The new track of a body at the tick of its packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UpdatePayload {
    /// A correction of the last track's prediction. A subscriber needs that track to apply it.
    Residual {
        /// The prediction mode of the new track.
        mode: PredictionMode,
        /// The age of the last track; it identifies the track's revision.
        age: Age,
        /// The correction, in the frame of the new track.
        residual: Residual,
    },
    /// Rest at the engine's exact pose. A subscriber needs the last track to apply it.
    Resting {
        /// The age of the last track; it identifies the track's revision.
        age: Age,
        /// The difference between the rest pose and the predicted pose.
        rest_correction: RestCorrection,
    },
    /// A keyframe, which needs no earlier track.
    Keyframe(Keyframe),
}

impl UpdatePayload {
    /// True if applying it also needs another body's track.
    #[must_use]
    pub(crate) const fn names_parent(&self) -> bool {
        matches!(
            self,
            Self::Residual {
                mode: PredictionMode::Attached { .. }
                    | PredictionMode::World {
                        parent_age: Some(_),
                        ..
                    },
                ..
            }
        )
    }
}

/// The predictor and frame of the track that starts with a correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PredictionMode {
    /// The predictor and frame of the last track.
    Same,
    /// The world frame, with a new predictor.
    World {
        /// The predictor.
        predictor: Predictor,
        /// The age of the last parent's track, if the body was attached.
        parent_age: Option<Age>,
    },
    /// Attached to another body.
    Attached {
        /// The index of the parent, which is not attached itself.
        parent: u32,
        /// The age of the parent's track.
        parent_age: Age,
    },
}

impl PredictionMode {
    /// The acceleration that is encoded with the mode.
    pub(super) const fn acceleration(&self) -> Option<ConstantAcceleration> {
        match self {
            Self::World { predictor, .. } => predictor.acceleration(),
            _ => None,
        }
    }
}

/// The forms of an update, encoded as its first symbol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum UpdateForm {
    /// [`PredictionMode::Same`]; `moved`: with velocities.
    Same { moved: bool },
    /// [`PredictionMode::World`] with the predictor of this code; `moved`: with velocities.
    World { predictor: u32, moved: bool },
    /// [`PredictionMode::Attached`].
    Attached,
    /// [`UpdatePayload::Keyframe`].
    Keyframe,
    /// [`UpdatePayload::Resting`].
    Resting,
}

impl UpdateForm {
    /// All forms in the order of their codes.
    const ALL: [Self; FORM_COUNT] = {
        const fn world(predictor: Predictor, moved: bool) -> UpdateForm {
            let predictor = predictor_code(predictor);
            UpdateForm::World { predictor, moved }
        }
        [
            Self::Same { moved: false },
            Self::Same { moved: true },
            world(Predictor::Rest, false),
            world(Predictor::Uniform, false),
            world(Predictor::Uniform, true),
            world(Predictor::Ballistic, false),
            world(Predictor::Ballistic, true),
            world(Predictor::TorqueFree, false),
            world(Predictor::TorqueFree, true),
            world(Predictor::BallisticTorqueFree, false),
            world(Predictor::BallisticTorqueFree, true),
            Self::Attached,
            Self::Keyframe,
            Self::Resting,
            Self::World {
                predictor: ACCELERATED,
                moved: false,
            },
            Self::World {
                predictor: ACCELERATED,
                moved: true,
            },
        ]
    };

    pub(super) const fn of(payload: &UpdatePayload) -> Self {
        match payload {
            UpdatePayload::Keyframe(_) => Self::Keyframe,
            UpdatePayload::Resting { .. } => Self::Resting,
            UpdatePayload::Residual { mode, residual, .. } => {
                Self::of_mode(mode, residual.velocity.is_some())
            }
        }
    }

    /// The form of a correction; `moved`: with velocities.
    pub(super) const fn of_mode(mode: &PredictionMode, moved: bool) -> Self {
        match *mode {
            PredictionMode::Same => Self::Same { moved },
            PredictionMode::Attached { .. } => Self::Attached,
            PredictionMode::World { predictor, .. } => Self::World {
                predictor: predictor_code(predictor),
                moved,
            },
        }
    }

    pub(super) const fn code(self) -> usize {
        match self {
            Self::Same { moved } => moved as usize,
            Self::World { predictor: 0, .. } => 2,
            Self::World {
                predictor: ACCELERATED,
                moved,
            } => 14 + moved as usize,
            Self::World { predictor, moved } => 1 + 2 * predictor as usize + moved as usize,
            Self::Attached => 11,
            Self::Keyframe => 12,
            Self::Resting => 13,
        }
    }

    const fn moved(self) -> bool {
        matches!(
            self,
            Self::Same { moved: true } | Self::World { moved: true, .. }
        )
    }

    /// The kind of a form, which selects contexts: same or new mode, with or without velocities.
    pub(super) const fn kind(self) -> usize {
        let same = matches!(self, Self::Same { .. });
        (!same as usize) * 2 + self.moved() as usize
    }
}

/// The coder of the updates in one packet, one after another.
#[derive(Clone, Debug, Default)]
pub(crate) struct UpdateCoder {
    pub(super) model: Model,
    /// The row of frequencies for the next update's form, given by the last form.
    pub(super) last: usize,
    /// True if an update was coded before, and the parent of the last attached body.
    has_updates: bool,
    pub(super) parent: Option<u32>,
}

impl UpdateCoder {
    /// Writes an update: its alias gap, the body if it takes the alias, and the payload. The gap counts the aliases
    /// between the last update's alias and this one.
    ///
    /// # Panics
    ///
    /// If a keyframe has no body.
    pub(crate) fn write(
        &mut self,
        gap: u32,
        body: Option<u32>,
        payload: &UpdatePayload,
        to: &mut RangeWriter,
    ) {
        let form = UpdateForm::of(payload);
        let aliased = body.filter(|_| form != UpdateForm::Keyframe);
        if aliased.is_some() {
            self.write_code(ASSIGN_ALIAS, to);
        }
        self.write_code(form.code(), to);
        self.model.write(contexts::gap(self.has_updates), gap, to);
        if let Some(body) = aliased {
            to.raw(body, INDEX_BITS);
        }
        match payload {
            UpdatePayload::Keyframe(keyframe) => {
                to.raw(body.expect("a keyframe names its body"), INDEX_BITS);
                keyframe.encode(to);
            }
            UpdatePayload::Resting {
                age,
                rest_correction,
            } => {
                self.model.write(contexts::REST_AGE, age.count() - 1, to);
                to.raw(u32::from(rest_correction.negated), 1);
                for (context, step, expected) in resting(rest_correction) {
                    let length = length(step);
                    self.model.write(context, zigzag(length, expected), to);
                    if length > 0 {
                        to.raw(u32::from(step < 0), 1);
                        to.raw(step.unsigned_abs() & ((1 << (length - 1)) - 1), length - 1);
                    }
                }
            }
            UpdatePayload::Residual {
                mode,
                age,
                residual,
            } => {
                let kind = form.kind();
                self.model.write(contexts::age(kind), age.count() - 1, to);
                self.write_parent(mode, to);
                if let Some(push) = mode.acceleration() {
                    write_acceleration(&mut self.model, &push, to);
                }
                if let Some(velocity) = &residual.velocity {
                    let context = contexts::velocity_exponent(kind, age.count());
                    self.model.write(context, velocity.velocity_exponent, to);
                }
                numbers(kind, *age, residual, |context, number| {
                    self.model.write_signed(context, number, to);
                });
            }
        }
        self.note_form(form);
    }

    /// Writes the end of the updates.
    pub(crate) fn end(&self, to: &mut RangeWriter) {
        self.write_code(END, to);
    }

    fn write_code(&self, code: usize, to: &mut RangeWriter) {
        let starts = &MODES[self.last];
        let size = starts[code + 1] - starts[code];
        to.symbol(u32::from(starts[code]), u32::from(size), TOTAL_BITS);
    }

    fn read_code(&self, from: &mut RangeReader<'_>) -> Result<usize, Malformed> {
        from.symbol(&FORMS[self.last])
    }

    fn write_parent(&mut self, mode: &PredictionMode, to: &mut RangeWriter) {
        let age = match *mode {
            PredictionMode::Same => return,
            PredictionMode::World { parent_age, .. } => {
                to.raw(u32::from(parent_age.is_some()), 1);
                parent_age
            }
            PredictionMode::Attached { parent, parent_age } => {
                let again = self.parent == Some(parent);
                if self.parent.is_some() {
                    to.raw(u32::from(again), 1);
                }
                if !again {
                    to.raw(parent, INDEX_BITS);
                }
                self.parent = Some(parent);
                Some(parent_age)
            }
        };
        if let Some(age) = age {
            self.model.write(contexts::PARENT_AGE, age.count(), to);
        }
    }

    /// Reads an update and hands out its alias gap, the body if it is given, and the payload. Returns `false` at the end of
    /// the updates.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if the payload is not within the limits, and errors of `take`.
    #[inline]
    pub(crate) fn read(
        &mut self,
        from: &mut RangeReader<'_>,
        mut take: impl FnMut(u32, Option<u32>, UpdatePayload) -> Result<(), Malformed>,
    ) -> Result<bool, Malformed> {
        let mut code = self.read_code(from)?;
        if code == END {
            return Ok(false);
        }
        let aliased = code == ASSIGN_ALIAS;
        if aliased {
            code = self.read_code(from)?;
        }
        let gap = self.model.read(contexts::gap(self.has_updates), from)?;
        let body = if aliased {
            Some(from.raw(INDEX_BITS)?)
        } else {
            None
        };
        let form = *UpdateForm::ALL.get(code).ok_or(Malformed::NotCanonical)?;
        match form {
            UpdateForm::Keyframe if aliased => return Err(Malformed::NotCanonical),
            UpdateForm::Keyframe => {
                let body = Some(from.raw(INDEX_BITS)?);
                take(gap, body, UpdatePayload::Keyframe(Keyframe::decode(from)?))?;
            }
            UpdateForm::Resting => {
                let age = self.read_age(contexts::REST_AGE, from)?;
                let rest_correction = self.read_rest_correction(from)?;
                let payload = UpdatePayload::Resting {
                    age,
                    rest_correction,
                };
                take(gap, body, payload)?;
            }
            UpdateForm::Same { .. } | UpdateForm::World { .. } | UpdateForm::Attached => {
                let kind = form.kind();
                let age = self.read_age(contexts::age(kind), from)?;
                let mode = self.read_mode(form, from)?;
                let mut residual = Residual::default();
                self.read_residual((kind, age), from, &mut residual)?;
                let payload = UpdatePayload::Residual {
                    mode,
                    age,
                    residual,
                };
                take(gap, body, payload)?;
            }
        }
        self.note_form(form);
        Ok(true)
    }

    fn read_mode(
        &mut self,
        form: UpdateForm,
        from: &mut RangeReader<'_>,
    ) -> Result<PredictionMode, Malformed> {
        match form {
            UpdateForm::Same { .. } | UpdateForm::Keyframe | UpdateForm::Resting => {
                Ok(PredictionMode::Same)
            }
            UpdateForm::World { predictor, .. } => {
                let was_attached = from.bit()?;
                let parent_age = if was_attached {
                    Some(self.read_parent_age(from)?)
                } else {
                    None
                };
                let predictor = match predictor {
                    ACCELERATED => {
                        Predictor::Accelerated(read_acceleration(&mut self.model, from)?)
                    }
                    _ => predictor_of(predictor)?,
                };
                Ok(PredictionMode::World {
                    predictor,
                    parent_age,
                })
            }
            UpdateForm::Attached => {
                let again = match self.parent {
                    Some(parent) if from.bit()? => Some(parent),
                    _ => None,
                };
                let parent = match again {
                    Some(parent) => parent,
                    None => from.raw(INDEX_BITS)?,
                };
                if again.is_none() && self.parent == Some(parent) {
                    return Err(Malformed::NotCanonical);
                }
                self.parent = Some(parent);
                let parent_age = self.read_parent_age(from)?;
                Ok(PredictionMode::Attached { parent, parent_age })
            }
        }
    }

    fn read_age(&mut self, context: usize, from: &mut RangeReader<'_>) -> Result<Age, Malformed> {
        let age = self.model.read(context, from)?;
        if age >= AGE_MAX {
            return Err(Malformed::OutOfRange);
        }
        Ok(Age::new(age + 1))
    }

    fn read_rest_correction(
        &mut self,
        from: &mut RangeReader<'_>,
    ) -> Result<RestCorrection, Malformed> {
        let mut rest_correction = RestCorrection {
            negated: from.bit()?,
            ..RestCorrection::default()
        };
        for place in 0..REST_STEPS {
            let (context, _, expected) = resting(&rest_correction)[place];
            let length = unzigzag(self.model.read(context, from)?, expected)?;
            let step = rest_step(&mut rest_correction, place);
            if length > 0 {
                let negative = from.bit()?;
                let size = (from.raw(length - 1)? | 1 << (length - 1)) as i32;
                *step = if negative { -size } else { size };
            }
        }
        Ok(rest_correction)
    }

    fn read_parent_age(&mut self, from: &mut RangeReader<'_>) -> Result<Age, Malformed> {
        let age = self.model.read(contexts::PARENT_AGE, from)?;
        if age > AGE_MAX {
            return Err(Malformed::OutOfRange);
        }
        Ok(Age::new(age))
    }

    /// Reads the numbers of a form of this kind into `residual`, which has no velocity.
    #[inline]
    fn read_residual(
        &mut self,
        (kind, age): (usize, Age),
        from: &mut RangeReader<'_>,
        residual: &mut Residual,
    ) -> Result<(), Malformed> {
        let age = age.count();
        if kind % 2 == 1 {
            let context = contexts::velocity_exponent(kind, age);
            residual.velocity = Some(VelocityResidual {
                velocity_exponent: self.model.read(context, from)?,
                ..VelocityResidual::default()
            });
        }
        let Residual {
            position,
            turn,
            velocity,
        } = residual;
        let model = &mut self.model;
        model.read_three(contexts::POSITIONS, from, position)?;
        let [x, y, z] = *position;
        let largest = x.unsigned_abs().max(y.unsigned_abs()).max(z.unsigned_abs());
        model.read_three(contexts::turn(largest), from, turn)?;
        if let Some(velocity) = velocity {
            let linear = contexts::velocity(kind, age, 2);
            model.read_three(linear, from, &mut velocity.linear)?;
            let angular = contexts::velocity(kind, age, 3);
            model.read_three(angular, from, &mut velocity.angular)?;
        }
        if !residual.is_within_limits() {
            return Err(Malformed::OutOfRange);
        }
        Ok(())
    }

    fn note_form(&mut self, form: UpdateForm) {
        self.has_updates = true;
        self.last = contexts::after(form.code());
    }

    /// Counts the end of the updates.
    pub(super) fn note_end(&self, tally: &mut impl CountSink) {
        tally.code(self.last, END);
    }

    /// Counts an update for fitting tables: the row and the code of its form, and its numbers with their contexts.
    pub(super) fn note(
        &mut self,
        gap: u32,
        named: bool,
        payload: &UpdatePayload,
        tally: &mut impl CountSink,
    ) {
        tally.number(contexts::gap(self.has_updates), gap);
        let form = UpdateForm::of(payload);
        if named && form != UpdateForm::Keyframe {
            tally.code(self.last, ASSIGN_ALIAS);
        }
        tally.code(self.last, form.code());
        each_number(payload, |context, number| {
            tally.number(context, number);
        });
        self.note_form(form);
    }
}

/// Takes the counts for fitting tables.
pub(super) trait CountSink {
    fn code(&mut self, row: usize, code: usize);
    fn number(&mut self, context: usize, number: u32);
}

/// Calls `emit` for each number of a payload that has a context, in order.
pub(super) fn each_number(payload: &UpdatePayload, mut emit: impl FnMut(usize, u32)) {
    match payload {
        UpdatePayload::Keyframe(_) => {}
        UpdatePayload::Resting {
            age,
            rest_correction,
        } => {
            emit(contexts::REST_AGE, age.count() - 1);
            for (context, step, expected) in resting(rest_correction) {
                emit(context, zigzag(length(step), expected));
            }
        }
        UpdatePayload::Residual {
            mode,
            age,
            residual,
        } => {
            let kind = UpdateForm::of(payload).kind();
            emit(contexts::age(kind), age.count() - 1);
            if let PredictionMode::World {
                parent_age: Some(parent_age),
                ..
            }
            | PredictionMode::Attached { parent_age, .. } = mode
            {
                emit(contexts::PARENT_AGE, parent_age.count());
            }
            if let Some(push) = mode.acceleration() {
                numbers_of_acceleration(&push, |context, number| {
                    emit(context, number.unsigned_abs());
                });
            }
            if let Some(velocity) = &residual.velocity {
                emit(
                    contexts::velocity_exponent(kind, age.count()),
                    velocity.velocity_exponent,
                );
            }
            numbers(kind, *age, residual, |context, number| {
                emit(context, number.unsigned_abs());
            });
        }
    }
}

/// The alphabets of [`MODES`] for reading.
static FORMS: [Alphabet; MODES.len()] = [
    Alphabet::new(&MODES[0]),
    Alphabet::new(&MODES[1]),
    Alphabet::new(&MODES[2]),
    Alphabet::new(&MODES[3]),
];

/// The greatest age, half a year at 60 Hz. A moving body or a parent is updated before, or put to rest; a refresh gives
/// an older track this age.
pub(super) const AGE_MAX: u32 = 1 << 30;

/// The number of published ticks since the origin of a track. The published tick that carries the track counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Age(u32);

impl Age {
    /// An age of `count` published ticks.
    #[must_use]
    pub const fn new(count: u32) -> Self {
        Self(count)
    }

    /// The age at `tick` of a track with this origin, in a stream that publishes every `publish_interval` ticks. `None`
    /// if the origin is later.
    ///
    /// An origin between two published ticks counts as the earlier of them.
    #[must_use]
    pub fn of(origin: Tick, tick: Tick, publish_interval: NonZeroU32) -> Option<Self> {
        let published = |tick: Tick| tick.value() / u64::from(publish_interval.get());
        let age = published(tick).checked_sub(published(origin))?;
        u32::try_from(age).ok().filter(|_| origin <= tick).map(Self)
    }

    /// The number of published ticks.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.0
    }
}

/// Calls `emit` for each number of a residual in the order on the wire, with its context.
fn numbers(kind: usize, age: Age, residual: &Residual, mut emit: impl FnMut(usize, i32)) {
    each_of_place(residual, &mut emit);
    if let Some(velocity) = &residual.velocity {
        each_of_velocity(kind, age, velocity, &mut emit);
    }
}

#[inline]
fn each_of_place(residual: &Residual, emit: &mut impl FnMut(usize, i32)) {
    let largest = each(residual.position, contexts::POSITIONS, emit);
    each(residual.turn, contexts::turn(largest), emit);
}

#[inline]
fn each_of_velocity(
    kind: usize,
    age: Age,
    velocity: &VelocityResidual,
    emit: &mut impl FnMut(usize, i32),
) {
    let age = age.count();
    each(velocity.linear, contexts::velocity(kind, age, 2), emit);
    each(velocity.angular, contexts::velocity(kind, age, 3), emit);
}

/// Emits three numbers and returns the largest size. Their contexts depend on their index and on the sizes before.
#[inline]
fn each(numbers: [i32; 3], contexts: TripleContexts, emit: &mut impl FnMut(usize, i32)) -> u32 {
    let (mut sum, mut largest) = (0, 0);
    for (part, number) in numbers.into_iter().enumerate() {
        emit(contexts.context(part, sum), number);
        let size = number.unsigned_abs();
        sum += u64::from(size);
        largest = largest.max(size);
    }
    largest
}

/// Steps of a rest correction: three of position, three of the smaller parts of a quaternion, one of its greatest.
const REST_STEPS: usize = 7;
/// Expected bit lengths of the first position step, the first rotation step and the last step: about those of a body of
/// half a metre at 5 cm.
const LENGTHS: [u32; 3] = [14, 19, 1];

/// The steps of a rest correction in the order on the wire, each with its context and its expected bit length: that of
/// the step before, or a fixed one.
pub(super) fn resting(rest_correction: &RestCorrection) -> [(usize, i32, u32); REST_STEPS] {
    let ([x, y, z], [a, b, c]) = (rest_correction.position, rest_correction.others);
    let [first, turned, last] = LENGTHS;
    [
        (contexts::resting(0), x, first),
        (contexts::resting(1), y, length(x)),
        (contexts::resting(1), z, length(y)),
        (contexts::resting(2), a, turned),
        (contexts::resting(3), b, length(a)),
        (contexts::resting(3), c, length(b)),
        (contexts::resting(4), rest_correction.largest, last),
    ]
}

/// The bit length of a step without its sign.
pub(super) const fn length(step: i32) -> u32 {
    32 - step.unsigned_abs().leading_zeros()
}

const fn rest_step(rest_correction: &mut RestCorrection, place: usize) -> &mut i32 {
    match place {
        0..3 => &mut rest_correction.position[place],
        3..6 => &mut rest_correction.others[place - 3],
        _ => &mut rest_correction.largest,
    }
}

#[cfg(test)]
pub(crate) mod tests;
