//! What an update says of a body: a correction of a prediction, or a track.
//!
//! Numbers are said by the range coder, as likely as the packet so far makes them. Nothing here looks at a track, so
//! that a packet can be read to its end by who lacks some of them (PROTOCOL 5.6).

use rhumb_reckoning::{Predictor, Push, Residual, Settling, VelocityResidual};

use super::age::Age;
use super::model::Model;
use super::push::numbers_of_push;
use super::steps::{SETTLED_STEPS, length, settled, settled_step};
use super::tables::{MODES, contexts};
use super::walk::numbers;
use super::whole::{PUSHED, TrackSaying, law_code, law_of};
use super::zigzag::{unzigzag, zigzag};
use crate::limits::INDICES_MAX;
use crate::wire::Malformed;
use crate::wire::alphabet::Alphabet;
use crate::wire::range::{RangeReader, RangeWriter, TOTAL_BITS};

/// What an update says of a body, at the tick of its packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Saying {
    /// A correction of what the last track predicts; readable only by who has that track.
    Residual {
        /// How the body goes on.
        course: Course,
        /// Of the track that this builds on: names its revision.
        age: Age,
        /// The correction, in the frame that the body goes on in.
        residual: Residual,
    },
    /// Rest, to the engine's own bits; readable only by who has the last track.
    Settled {
        /// Of the track that this builds on: names its revision.
        age: Age,
        /// What the pose differs by from the predicted one.
        settling: Settling,
    },
    /// A whole motion, readable by all.
    Whole(TrackSaying),
}

impl Saying {
    /// Whether it can only be read by who has another body's track too.
    #[must_use]
    pub const fn names_carrier(&self) -> bool {
        matches!(
            self,
            Self::Residual {
                course: Course::Held { .. }
                    | Course::World {
                        carrier_age: Some(_),
                        ..
                    },
                ..
            }
        )
    }
}

/// How a body goes on after a correction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Course {
    /// By the law and in the frame that it had.
    Same,
    /// In the world, by this law.
    World {
        /// The law.
        predictor: Predictor,
        /// If another body held it so far: of that body's track.
        carrier_age: Option<Age>,
    },
    /// Held by another body.
    Held {
        /// Its index; it is held by none itself.
        carrier: u32,
        /// Of that body's track.
        carrier_age: Age,
    },
}

impl Course {
    /// The push that is said with it.
    pub(super) const fn push(&self) -> Option<Push> {
        match self {
            Self::World { predictor, .. } => predictor.push(),
            _ => None,
        }
    }
}

/// The forms of an update: what its first symbol says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    /// [`Course::Same`], with velocities or without.
    Same { moved: bool },
    /// [`Course::World`] by the law of this code, likewise.
    World { law: u32, moved: bool },
    /// [`Course::Held`].
    Held,
    /// [`Saying::Whole`].
    Whole,
    /// [`Saying::Settled`].
    Settled,
}

impl Mode {
    /// In the order of their codes.
    const ALL: [Self; MODE_COUNT] = {
        const fn world(predictor: Predictor, moved: bool) -> Mode {
            let law = law_code(predictor);
            Mode::World { law, moved }
        }
        [
            Self::Same { moved: false },
            Self::Same { moved: true },
            world(Predictor::Rest, false),
            world(Predictor::Uniform, false),
            world(Predictor::Uniform, true),
            world(Predictor::Ballistic, false),
            world(Predictor::Ballistic, true),
            world(Predictor::Tumbling, false),
            world(Predictor::Tumbling, true),
            world(Predictor::Thrown, false),
            world(Predictor::Thrown, true),
            Self::Held,
            Self::Whole,
            Self::Settled,
            Self::World {
                law: PUSHED,
                moved: false,
            },
            Self::World {
                law: PUSHED,
                moved: true,
            },
        ]
    };

    pub(super) const fn of(saying: &Saying) -> Self {
        match saying {
            Saying::Whole(_) => Self::Whole,
            Saying::Settled { .. } => Self::Settled,
            Saying::Residual {
                course, residual, ..
            } => Self::of_course(course, residual.velocity.is_some()),
        }
    }

    /// Of a correction, with velocities or without.
    pub(super) const fn of_course(course: &Course, moved: bool) -> Self {
        match *course {
            Course::Same => Self::Same { moved },
            Course::Held { .. } => Self::Held,
            Course::World { predictor, .. } => Self::World {
                law: law_code(predictor),
                moved,
            },
        }
    }

    pub(super) const fn code(self) -> usize {
        match self {
            Self::Same { moved } => moved as usize,
            Self::World { law: 0, .. } => 2,
            Self::World { law: PUSHED, moved } => 14 + moved as usize,
            Self::World { law, moved } => 1 + 2 * law as usize + moved as usize,
            Self::Held => 11,
            Self::Whole => 12,
            Self::Settled => 13,
        }
    }

    const fn moved(self) -> bool {
        matches!(
            self,
            Self::Same { moved: true } | Self::World { moved: true, .. }
        )
    }

    /// Forms whose numbers are alike: of the same course or of another, with velocities or without.
    pub(super) const fn kind(self) -> usize {
        let same = matches!(self, Self::Same { .. });
        (!same as usize) * 2 + self.moved() as usize
    }
}

/// What the updates of one packet are said by, one after another.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tongue {
    pub(super) model: Model,
    /// Which expectation of the next update's form holds: by the form of the last one.
    pub(super) last: usize,
    /// Whether an update was said, and the body that the last held one is held by.
    begun: bool,
    pub(super) carrier: Option<u32>,
}

impl Tongue {
    /// Says an update: how many seats lie between its body's and the last one's, which body takes the seat if that is
    /// to be said, then what is said of it.
    ///
    /// # Panics
    ///
    /// When a whole track names no body.
    pub(crate) fn write(
        &mut self,
        gap: u32,
        body: Option<u32>,
        saying: &Saying,
        to: &mut RangeWriter,
    ) {
        let mode = Mode::of(saying);
        let seated = body.filter(|_| mode != Mode::Whole);
        if seated.is_some() {
            self.write_code(SEATING, to);
        }
        self.write_code(mode.code(), to);
        self.model.write(contexts::gap(self.begun), gap, to);
        if let Some(body) = seated {
            to.raw(body, INDEX_BITS);
        }
        match saying {
            Saying::Whole(whole) => {
                to.raw(body.expect("a whole track names its body"), INDEX_BITS);
                whole.encode(to);
            }
            Saying::Settled { age, settling } => {
                self.model.write(contexts::SETTLED_AGE, age.count() - 1, to);
                to.raw(u32::from(settling.negated), 1);
                for (context, step, expected) in settled(settling) {
                    let length = length(step);
                    self.model.write(context, zigzag(length, expected), to);
                    if length > 0 {
                        to.raw(u32::from(step < 0), 1);
                        to.raw(step.unsigned_abs() & ((1 << (length - 1)) - 1), length - 1);
                    }
                }
            }
            Saying::Residual {
                course,
                age,
                residual,
            } => {
                let kind = mode.kind();
                self.model.write(contexts::age(kind), age.count() - 1, to);
                self.write_carrier(course, to);
                if let Some(push) = course.push() {
                    self.write_push(&push, to);
                }
                if let Some(velocity) = &residual.velocity {
                    let context = contexts::coarseness(kind, age.count());
                    self.model.write(context, velocity.coarseness, to);
                }
                numbers(kind, *age, residual, |context, number| {
                    self.model.write(context, number.unsigned_abs(), to);
                    if number != 0 {
                        to.raw(u32::from(number < 0), 1);
                    }
                });
            }
        }
        self.went_on(mode);
    }

    /// Says that this was all.
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

    fn write_carrier(&mut self, course: &Course, to: &mut RangeWriter) {
        let age = match *course {
            Course::Same => return,
            Course::World { carrier_age, .. } => {
                to.raw(u32::from(carrier_age.is_some()), 1);
                carrier_age
            }
            Course::Held {
                carrier,
                carrier_age,
            } => {
                let again = self.carrier == Some(carrier);
                if self.carrier.is_some() {
                    to.raw(u32::from(again), 1);
                }
                if !again {
                    to.raw(carrier, INDEX_BITS);
                }
                self.carrier = Some(carrier);
                Some(carrier_age)
            }
        };
        if let Some(age) = age {
            self.model.write(contexts::CARRIER_AGE, age.count(), to);
        }
    }

    /// Reads an update: the gap, the body if it is named, then what is said of it; `None` at the end of all.
    ///
    /// # Errors
    ///
    /// [`Malformed`] for what is no saying within the limits.
    pub(crate) fn read(
        &mut self,
        from: &mut RangeReader<'_>,
    ) -> Result<Option<(u32, Option<u32>, Saying)>, Malformed> {
        let mut code = self.read_code(from)?;
        if code == END {
            return Ok(None);
        }
        let seated = code == SEATING;
        if seated {
            code = self.read_code(from)?;
        }
        let gap = self.model.read(contexts::gap(self.begun), from)?;
        let mut body = None;
        if seated {
            body = Some(from.raw(INDEX_BITS)?);
        }
        let mode = *Mode::ALL.get(code).ok_or(Malformed::NotCanonical)?;
        let saying = if mode == Mode::Whole {
            if body.is_some() {
                return Err(Malformed::NotCanonical);
            }
            body = Some(from.raw(INDEX_BITS)?);
            Saying::Whole(TrackSaying::decode(from)?)
        } else if mode == Mode::Settled {
            let age = self.read_age(contexts::SETTLED_AGE, from)?;
            let settling = self.read_settling(from)?;
            Saying::Settled { age, settling }
        } else {
            let kind = mode.kind();
            let age = self.read_age(contexts::age(kind), from)?;
            let course = self.read_course(mode, from)?;
            let residual = self.read_residual(kind, age, from)?;
            Saying::Residual {
                course,
                age,
                residual,
            }
        };
        self.went_on(mode);
        Ok(Some((gap, body, saying)))
    }

    fn read_course(&mut self, mode: Mode, from: &mut RangeReader<'_>) -> Result<Course, Malformed> {
        match mode {
            Mode::Same { .. } | Mode::Whole | Mode::Settled => Ok(Course::Same),
            Mode::World { law, .. } => {
                let held = from.bit()?;
                let carrier_age = if held {
                    Some(self.read_carrier_age(from)?)
                } else {
                    None
                };
                let predictor = match law {
                    PUSHED => Predictor::Pushed(self.read_push(from)?),
                    _ => law_of(law)?,
                };
                Ok(Course::World {
                    predictor,
                    carrier_age,
                })
            }
            Mode::Held => {
                let again = match self.carrier {
                    Some(carrier) if from.bit()? => Some(carrier),
                    _ => None,
                };
                let carrier = match again {
                    Some(carrier) => carrier,
                    None => from.raw(INDEX_BITS)?,
                };
                if again.is_none() && self.carrier == Some(carrier) {
                    return Err(Malformed::NotCanonical);
                }
                self.carrier = Some(carrier);
                let carrier_age = self.read_carrier_age(from)?;
                Ok(Course::Held {
                    carrier,
                    carrier_age,
                })
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

    fn read_settling(&mut self, from: &mut RangeReader<'_>) -> Result<Settling, Malformed> {
        let mut settling = Settling {
            negated: from.bit()?,
            ..Settling::default()
        };
        for place in 0..SETTLED_STEPS {
            let (context, _, expected) = settled(&settling)[place];
            let length = unzigzag(self.model.read(context, from)?, expected)?;
            let step = settled_step(&mut settling, place);
            if length > 0 {
                let negative = from.bit()?;
                let size = (from.raw(length - 1)? | 1 << (length - 1)) as i32;
                *step = if negative { -size } else { size };
            }
        }
        Ok(settling)
    }

    fn read_carrier_age(&mut self, from: &mut RangeReader<'_>) -> Result<Age, Malformed> {
        let age = self.model.read(contexts::CARRIER_AGE, from)?;
        if age > AGE_MAX {
            return Err(Malformed::OutOfRange);
        }
        Ok(Age::new(age))
    }

    fn read_residual(
        &mut self,
        kind: usize,
        age: Age,
        from: &mut RangeReader<'_>,
    ) -> Result<Residual, Malformed> {
        let mut residual = Residual::default();
        if kind % 2 == 1 {
            let context = contexts::coarseness(kind, age.count());
            residual.velocity = Some(VelocityResidual {
                coarseness: self.model.read(context, from)?,
                ..VelocityResidual::default()
            });
        }
        let (model, age) = (&mut self.model, contexts::age_class(age.count()));
        residual.position = model.read_three(contexts::position(kind, age), from)?;
        let [x, y, z] = residual.position;
        let largest = x.unsigned_abs().max(y.unsigned_abs()).max(z.unsigned_abs());
        residual.turn = model.read_three(contexts::turn(kind, age, largest), from)?;
        if let Some(velocity) = &mut residual.velocity {
            velocity.linear = model.read_three(contexts::velocity(kind, age, 2), from)?;
            velocity.angular = model.read_three(contexts::velocity(kind, age, 3), from)?;
        }
        if !residual.is_within_limits() {
            return Err(Malformed::OutOfRange);
        }
        Ok(residual)
    }

    fn went_on(&mut self, mode: Mode) {
        self.begun = true;
        self.last = contexts::after(mode.code());
    }

    /// What is to be counted of the end of all updates.
    pub(super) fn note_end(&self, tally: &mut impl Counted) {
        tally.code(self.last, END);
    }

    /// What is to be counted of an update when tables are fitted: the row and the code of its form, and its numbers with
    /// their contexts.
    pub(super) fn note(
        &mut self,
        gap: u32,
        named: bool,
        saying: &Saying,
        tally: &mut impl Counted,
    ) {
        tally.number(contexts::gap(self.begun), gap);
        let mode = Mode::of(saying);
        if named && mode != Mode::Whole {
            tally.code(self.last, SEATING);
        }
        tally.code(self.last, mode.code());
        each_number(saying, |context, number| {
            tally.number(context, number);
        });
        self.went_on(mode);
    }
}

/// Takes what is counted when tables are fitted.
pub(super) trait Counted {
    fn code(&mut self, row: usize, code: usize);
    fn number(&mut self, context: usize, number: u32);
}

/// The numbers of a saying that are said in contexts, in order.
pub(super) fn each_number(saying: &Saying, mut say: impl FnMut(usize, u32)) {
    match saying {
        Saying::Whole(_) => {}
        Saying::Settled { age, settling } => {
            say(contexts::SETTLED_AGE, age.count() - 1);
            for (context, step, expected) in settled(settling) {
                say(context, zigzag(length(step), expected));
            }
        }
        Saying::Residual {
            course,
            age,
            residual,
        } => {
            let kind = Mode::of(saying).kind();
            say(contexts::age(kind), age.count() - 1);
            if let Course::World {
                carrier_age: Some(carrier_age),
                ..
            }
            | Course::Held { carrier_age, .. } = course
            {
                say(contexts::CARRIER_AGE, carrier_age.count());
            }
            if let Some(push) = course.push() {
                numbers_of_push(&push, |context, number| {
                    say(context, number.unsigned_abs());
                });
            }
            if let Some(velocity) = &residual.velocity {
                say(contexts::coarseness(kind, age.count()), velocity.coarseness);
            }
            numbers(kind, *age, residual, |context, number| {
                say(context, number.unsigned_abs());
            });
        }
    }
}

/// The alphabets of [`MODES`] as they are read.
static FORMS: [Alphabet; MODES.len()] = [
    Alphabet::new(&MODES[0]),
    Alphabet::new(&MODES[1]),
    Alphabet::new(&MODES[2]),
    Alphabet::new(&MODES[3]),
];

/// Bits of a body's index.
pub(super) const INDEX_BITS: u32 = INDICES_MAX.ilog2();
/// A body that moves or holds others is spoken of at least this often, or said to rest.
const AGE_MAX: u32 = 1 << 30;
/// How many forms there are.
pub(super) const MODE_COUNT: usize = 16;
/// The code, behind those of the forms, that says that a body takes a seat; the form follows.
const SEATING: usize = MODE_COUNT;
/// The code that says that there are no more updates.
const END: usize = SEATING + 1;
/// All codes.
pub(super) const CODE_COUNT: usize = END + 1;

#[cfg(test)]
pub(crate) mod tests;
