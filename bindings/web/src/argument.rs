//! Arguments out of JSON, which know their places, and errors for JavaScript.
//!
//! A wrong argument is named by its place, as in `body.shape.radius`. A field that no reader asks for is wrong, too. An error
//! has a code for programs and a sentence for people.
//!
//! Objects of JSON leave absent fields out. JavaScript reads an absent field as `undefined`, and `rhumb.d.ts` says so. Null
//! would pass as the number zero.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

use glam::{Quat, Vec3};
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::IdOutOfRange;
use rhumb_protocol::session::Misuse;
use rhumb_reckoning::BodyId;
use rhumb_view::AddError;
use serde_json::{Map, Value};

/// An object, written as in `json!`, without the fields that are null.
macro_rules! object {
    ({$($name:literal: $value:expr),* $(,)?}) => {{
        let mut object = serde_json::Map::new();
        $($crate::argument::set(&mut object, $name, $value);)*
        serde_json::Value::Object(object)
    }};
}
pub(crate) use object;

/// Sets a field, but for one that is null. Inlined into each field of each object, it makes the module 2 % larger.
#[inline(never)]
pub(crate) fn set(object: &mut Map<String, Value>, name: &str, value: impl Into<Value>) {
    let value = value.into();
    if !value.is_null() {
        object.insert(name.to_owned(), value);
    }
}

/// An error, as JavaScript sees it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Failure {
    code: &'static str,
    message: String,
    denial: Option<&'static str>,
}

impl Failure {
    /// An argument that is not what the call takes. `place` names it, as in `body.shape.radius`.
    pub(crate) fn argument(place: &str, wanted: impl fmt::Display) -> Self {
        Self::of("argument", format!("{place}: {wanted}"))
    }

    pub(crate) fn of(code: &'static str, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            denial: None,
        }
    }

    pub(crate) fn denied(denial: Denial) -> Self {
        Self {
            denial: Some(denial_code(denial)),
            ..Self::of("denied", denial.to_string())
        }
    }

    pub(crate) fn to_json(&self) -> Value {
        object!({
            "code": self.code, "message": self.message.as_str(), "denial": self.denial
        })
    }
}

impl From<Misuse> for Failure {
    fn from(misuse: Misuse) -> Self {
        let code = match misuse {
            Misuse::NotNow | Misuse::AuthorityUnanswered | Misuse::NotDivided => "notNow",
            Misuse::Indices(_) => "noIds",
            Misuse::Invalid(_)
            | Misuse::TooManyAuthorityBodies(_)
            | Misuse::NoAuthority(_)
            | Misuse::State(..)
            | Misuse::NoInside
            | Misuse::JoinedToItself(_)
            | Misuse::Hits(_)
            | Misuse::QueryCost(_)
            | Misuse::TooManyCells
            | Misuse::CellPlace(_) => "argument",
        };
        Self::of(code, misuse.to_string())
    }
}

impl From<AddError> for Failure {
    fn from(error: AddError) -> Self {
        match error {
            AddError::Misuse(misuse) => misuse.into(),
            AddError::TooManyShapes => Self::of("tooManyShapes", error.to_string()),
        }
    }
}

/// The name of a denial, for programs.
pub(crate) const fn denial_code(denial: Denial) -> &'static str {
    match denial {
        Denial::NoSuchScene => "noSuchScene",
        Denial::SceneExists => "sceneExists",
        Denial::InvalidConfig(_) => "invalidConfig",
        Denial::TooManyScenes => "tooManyScenes",
        Denial::TooManyMembers => "tooManyMembers",
        Denial::TooManyStreams => "tooManyStreams",
        Denial::NoIndicesLeft => "noIndicesLeft",
        Denial::NotLockstep => "notLockstep",
        Denial::TooFarAhead => "tooFarAhead",
        Denial::SceneFaulted => "sceneFaulted",
        Denial::Owned => "owned",
        Denial::NotAllowed => "notAllowed",
        Denial::AdvanceNotAllowed => "advanceNotAllowed",
        Denial::OverQuota => "overQuota",
        Denial::Overloaded { .. } => "overloaded",
        Denial::Other(_) => "other",
    }
}

/// Most characters of a wrong value that its error names.
const FOUND_CHARACTERS: usize = 40;

/// The fields that readers have asked each object for.
#[derive(Debug, Default)]
pub(crate) struct AskedFields(RefCell<BTreeMap<*const Value, BTreeSet<String>>>);

/// A part of a JSON value, and its place.
///
/// Functions that read a field by its name are not inlined: each inlined copy would make the module larger.
#[derive(Clone, Debug)]
pub(crate) struct Argument<'a> {
    value: &'a Value,
    place: String,
    asked: &'a AskedFields,
}

impl<'a> Argument<'a> {
    pub(crate) fn new(value: &'a Value, place: &str, asked: &'a AskedFields) -> Self {
        Self {
            value,
            place: place.to_owned(),
            asked,
        }
    }

    /// Refuses a field that no reader has asked for.
    pub(crate) fn check_fields(&self) -> Result<(), Failure> {
        match self.value {
            Value::Array(items) => {
                let has_fields = |item: &Value| item.is_object() || item.is_array();
                let items = items.iter().enumerate();
                for (index, value) in items.filter(|(_, item)| has_fields(item)) {
                    let place = format!("{}[{index}]", self.place);
                    Self::new(value, &place, self.asked).check_fields()?;
                }
                Ok(())
            }
            Value::Object(fields) => {
                let place = |field: &String| format!("{}.{field}", self.place);
                if let Some(asked) = self.asked.0.borrow().get(&std::ptr::from_ref(self.value))
                    && let Some(unknown) = fields.keys().find(|field| !asked.contains(*field))
                {
                    let known: Vec<&str> = asked.iter().map(String::as_str).collect();
                    let known = known.join(", ");
                    let why = format_args!("is not known: the fields here are {known}");
                    return Err(Failure::argument(&place(unknown), why));
                }
                let mut fields = fields.iter();
                fields.try_for_each(|(field, value)| {
                    Self::new(value, &place(field), self.asked).check_fields()
                })
            }
            _ => Ok(()),
        }
    }

    /// The error that this argument is not what is wanted.
    pub(crate) fn wrong(&self, wanted: &str) -> Failure {
        // A long value would hide the sentence.
        let found = self.value.to_string();
        let found = match found.char_indices().nth(FOUND_CHARACTERS) {
            Some((end, _)) => format!("{}...", &found[..end]),
            None => found,
        };
        Failure::argument(&self.place, format_args!("must be {wanted}, not {found}"))
    }

    /// The error of a check that this argument does not pass.
    pub(crate) fn refused(&self, why: impl fmt::Display) -> Failure {
        Failure::argument(&self.place, why)
    }

    /// A field; null and an absent one are none.
    pub(crate) fn optional(&self, field: &str) -> Option<Self> {
        let fields = self.value.as_object()?;
        let mut asked = self.asked.0.borrow_mut();
        let asked = asked.entry(std::ptr::from_ref(self.value)).or_default();
        if !asked.contains(field) {
            asked.insert(field.to_owned());
        }
        let value = fields.get(field).filter(|value| !value.is_null())?;
        let place = format!("{}.{field}", self.place);
        Some(Self::new(value, &place, self.asked))
    }

    /// A field that must be there.
    pub(crate) fn field(&self, field: &str) -> Result<Self, Failure> {
        self.optional(field)
            .ok_or_else(|| Failure::argument(&format!("{}.{field}", self.place), "is missing"))
    }

    /// The elements of a list.
    pub(crate) fn items(&self) -> Result<impl Iterator<Item = Self> + use<'a>, Failure> {
        let items = self.value.as_array().ok_or_else(|| self.wrong("a list"))?;
        let (place, asked) = (self.place.clone(), self.asked);
        let items = items.iter().enumerate();
        Ok(items.map(move |(index, value)| Self::new(value, &format!("{place}[{index}]"), asked)))
    }

    pub(crate) fn text(&self) -> Result<&'a str, Failure> {
        self.value.as_str().ok_or_else(|| self.wrong("a text"))
    }

    /// The text, if it is one.
    pub(crate) fn as_text(&self) -> Option<&'a str> {
        self.value.as_str()
    }

    /// The number, if it is one.
    pub(crate) fn as_number(&self) -> Option<f64> {
        self.value.as_f64()
    }

    pub(crate) fn is_null(&self) -> bool {
        self.value.is_null()
    }

    pub(crate) fn flag(&self) -> Result<bool, Failure> {
        self.value
            .as_bool()
            .ok_or_else(|| self.wrong("true or false"))
    }

    pub(crate) fn number(&self) -> Result<f64, Failure> {
        self.as_number().ok_or_else(|| self.wrong("a number"))
    }

    pub(crate) fn single(&self) -> Result<f32, Failure> {
        Ok(self.number()? as f32)
    }

    /// A whole number within bounds, both inclusive.
    pub(crate) fn whole(&self, least: i64, most: i64) -> Result<i64, Failure> {
        let number = self.as_number();
        let whole = number.filter(|number| number.fract() == 0.0);
        let within = whole.filter(|number| (least as f64..=most as f64).contains(number));
        let number =
            within.ok_or_else(|| self.wrong(&format!("a whole number from {least} to {most}")))?;
        Ok(number as i64)
    }

    pub(crate) fn u32(&self) -> Result<u32, Failure> {
        Ok(self.whole(0, i64::from(u32::MAX))? as u32)
    }

    pub(crate) fn singles<const N: usize>(&self) -> Result<[f32; N], Failure> {
        let wanted = || self.wrong(&format!("a list of {N} numbers"));
        let items = self.value.as_array().filter(|items| items.len() == N);
        let mut singles = [0.0; N];
        for (single, item) in singles.iter_mut().zip(items.ok_or_else(wanted)?) {
            *single = item.as_f64().ok_or_else(wanted)? as f32;
        }
        Ok(singles)
    }

    pub(crate) fn vector(&self) -> Result<Vec3, Failure> {
        Ok(Vec3::from_array(self.singles()?))
    }

    pub(crate) fn rotation(&self) -> Result<Quat, Failure> {
        Ok(Quat::from_array(self.singles()?))
    }

    /// The vector of a field.
    #[inline(never)]
    pub(crate) fn vector_of(&self, field: &str) -> Result<Vec3, Failure> {
        self.field(field)?.vector()
    }

    /// A vector of a field, or another one where it is left out.
    #[inline(never)]
    pub(crate) fn vector_or(&self, field: &str, otherwise: Vec3) -> Result<Vec3, Failure> {
        self.optional(field)
            .map_or(Ok(otherwise), |field| field.vector())
    }

    /// A rotation of a field, or another one where it is left out.
    #[inline(never)]
    pub(crate) fn rotation_or(&self, field: &str, otherwise: Quat) -> Result<Quat, Failure> {
        self.optional(field)
            .map_or(Ok(otherwise), |field| field.rotation())
    }

    /// The number of a field.
    #[inline(never)]
    pub(crate) fn number_of(&self, field: &str) -> Result<f32, Failure> {
        self.field(field)?.single()
    }

    /// A number of a field, or another one where it is left out.
    #[inline(never)]
    pub(crate) fn number_or(&self, field: &str, otherwise: f32) -> Result<f32, Failure> {
        self.optional(field)
            .map_or(Ok(otherwise), |field| field.single())
    }

    /// True or false of a field, or another one where it is left out.
    #[inline(never)]
    pub(crate) fn flag_or(&self, field: &str, otherwise: bool) -> Result<bool, Failure> {
        self.optional(field)
            .map_or(Ok(otherwise), |field| field.flag())
    }

    /// The body of the field `id`.
    #[inline(never)]
    pub(crate) fn id(&self) -> Result<BodyId, Failure> {
        self.field("id")?.body()
    }

    /// Numbers of several fields, each with what it is where it is left out.
    pub(crate) fn numbers<const N: usize>(
        &self,
        fields: [(&str, f32); N],
    ) -> Result<[f32; N], Failure> {
        let mut numbers = [0.0; N];
        for (number, (field, otherwise)) in numbers.iter_mut().zip(fields) {
            *number = self.number_or(field, otherwise)?;
        }
        Ok(numbers)
    }

    /// The values of a list.
    pub(crate) fn each<T>(
        &self,
        read: impl Fn(&Argument<'_>) -> Result<T, Failure>,
    ) -> Result<Vec<T>, Failure> {
        self.items()?.map(|item| read(&item)).collect()
    }

    /// Numbers, as many as there are.
    pub(crate) fn all_singles(&self) -> Result<Vec<f32>, Failure> {
        self.items()?.map(|item| item.single()).collect()
    }

    pub(crate) fn body(&self) -> Result<BodyId, Failure> {
        let most = (i64::from(u16::MAX) << 32) | i64::from(u32::MAX);
        let number = self.whole(0, most)?;
        let id = BodyId::new(number as u32, (number >> 32) as u16);
        match IdOutOfRange::check_body(id) {
            Ok(()) => Ok(id),
            Err(out_of_range) => Err(Failure::of("argument", out_of_range.to_string())),
        }
    }
}

/// A body's id as a number of JavaScript: its index plus 2³² times its generation.
pub(crate) fn id_number(id: BodyId) -> f64 {
    f64::from(id.generation()) * 4_294_967_296.0 + f64::from(id.index())
}

/// The id of a number of JavaScript; `None` for a number that is none.
pub(crate) fn body_of(number: f64) -> Option<BodyId> {
    let most = f64::from(u16::MAX) * 4_294_967_296.0 + f64::from(u32::MAX);
    let fits = (0.0..=most).contains(&number) && number.fract() == 0.0;
    fits.then(|| BodyId::new(number as u64 as u32, (number as u64 >> 32) as u16))
}
