//! Arguments of Python: anything that NumPy takes as an array.

use std::time::Duration;

use numpy::{Element, PyArrayDyn, PyArrayMethods, PyUntypedArray, get_array_module};
use pyo3::prelude::*;
use pyo3::types::{PyList, PyTuple};
use rhumb_bindings::rhumb_client::BodyId;
use rhumb_bindings::rhumb_client::glam::{Quat, Vec3};
use rhumb_bindings::rhumb_client::scene::{Sleep, SleepThresholds};
use rhumb_bindings::{BindingError, Coordinates, Rows, parse_packed_id};

use crate::errors::{exception, wrong, wrong_value};
use crate::number::{REAL, no_truth, within, written};

/// Words for the coordinates of a scene.
pub(crate) const COORDINATES: [(&str, Coordinates); 4] = [
    ("rhumb", Coordinates::Rhumb),
    ("unity", Coordinates::Unity),
    ("unreal", Coordinates::Unreal),
    ("z-up", Coordinates::ZUp),
];

/// Numbers of an argument, with the shape of their array. The shape of one number alone is empty.
struct Numbers<T> {
    shape: Vec<usize>,
    values: Vec<T>,
}

impl<T: Element + Copy> Numbers<T> {
    /// The numbers of an array of NumPy, as another type.
    fn of(array: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = array.py();
        let dtype = numpy::dtype::<T>(py);
        // It makes a row of one number alone.
        let row = get_array_module(py)?.call_method1("ascontiguousarray", (array, dtype))?;
        let row = row.cast_into::<PyArrayDyn<T>>()?;
        let values = row.readonly().as_slice()?.to_vec();
        let shape = array.getattr("shape")?.extract::<Vec<usize>>()?;
        Ok(Self { shape, values })
    }
}

/// True for an array of NumPy with a masked entry: NumPy would take the value that it hides.
fn has_mask(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    let mask = match value.cast::<PyUntypedArray>() {
        Ok(array) => array.getattr_opt("mask")?,
        Err(_) => None,
    };
    mask.map_or(Ok(false), |mask| mask.call_method0("any")?.is_truthy())
}

/// Refuses an array with masked entries, also one in a list, and complex numbers, whose imaginary parts NumPy would drop.
fn check_kept(argument: &Bound<'_, PyAny>, name: &'static str) -> PyResult<()> {
    let py = argument.py();
    let wrong = |needed| Err(wrong_value(py, name, written(argument), needed));
    let is_list = argument.is_instance_of::<PyList>() || argument.is_instance_of::<PyTuple>();
    let mut is_masked = has_mask(argument)?;
    if is_list {
        for part in argument.try_iter()? {
            is_masked |= has_mask(&part?)?;
        }
    }
    if is_masked {
        return wrong("an array without masked entries");
    }
    // A value that is no array is refused where its numbers are read.
    let Ok(array) = get_array_module(py)?.call_method1("asarray", (argument,)) else {
        return Ok(());
    };
    match array.getattr("dtype")?.getattr("kind")?.extract::<char>()? {
        'c' => wrong("real, and not complex"),
        _ => Ok(()),
    }
}

fn numbers(argument: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Numbers<f32>> {
    let py = argument.py();
    check_kept(argument, name)?;
    let array_of = |dtype| get_array_module(py)?.call_method1("asarray", (argument, dtype));
    let numbers = Numbers::<f32>::of(&within(
        argument,
        name,
        array_of(numpy::dtype::<f32>(py)),
        REAL,
    )?)?;
    if numbers.values.iter().any(|number| number.is_infinite()) {
        // A number that becomes infinite only when it is rounded is out of range, and is named as it was given.
        let given = Numbers::<f64>::of(&array_of(numpy::dtype::<f64>(py))?)?;
        let mut pairs = given.values.iter().zip(&numbers.values);
        if let Some((given, _)) =
            pairs.find(|(given, number)| given.is_finite() && number.is_infinite())
        {
            return Err(wrong_value(py, name, format_args!("{given:e}"), REAL));
        }
    }
    Ok(numbers)
}

/// Whole numbers. A negative one becomes greater than any place or id. A float is refused: its fraction would be lost.
fn integers(argument: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Numbers<u64>> {
    let py = argument.py();
    check_kept(argument, name)?;
    let array = get_array_module(py)?.call_method1("asarray", (argument,));
    let array = within(argument, name, array, "whole numbers")?;
    let kind = array.getattr("dtype")?.getattr("kind")?.extract::<char>()?;
    // An array of nothing is one of floats.
    let is_empty = array.getattr("size")?.extract::<usize>()? == 0;
    if is_empty || matches!(kind, 'i' | 'u') {
        return Numbers::of(&array);
    }
    // So is an array of a list that has integers of Python beside unsigned ones of NumPy.
    let mixed = match kind {
        'f' => argument.extract::<Vec<u64>>().ok(),
        _ => None,
    };
    let values = mixed.ok_or_else(|| wrong_value(py, name, written(argument), "whole numbers"))?;
    let shape = vec![values.len()];
    Ok(Numbers { shape, values })
}

/// Rows of `W` numbers as they were given: one for each body, or one that stands for all.
pub(crate) struct GivenRows<const W: usize> {
    values: Vec<f32>,
    stands_for_all: bool,
}

impl<const W: usize> GivenRows<W> {
    /// The values of an argument for `count` bodies.
    pub(crate) fn of(
        argument: &Bound<'_, PyAny>,
        count: usize,
        name: &'static str,
    ) -> PyResult<Self> {
        let Numbers { shape, values } = numbers(argument, name)?;
        let stands_for_all = match *shape.as_slice() {
            [width] if width == W => true,
            [rows_given, width] if width == W && rows_given == count => false,
            _ => {
                return Err(wrong_value(
                    argument.py(),
                    name,
                    shape_of(&shape),
                    format_args!(
                        "one row of {W} numbers, or {count} such rows: as many as there are bodies"
                    ),
                ));
            }
        };
        Ok(Self {
            values,
            stands_for_all,
        })
    }

    /// The same of an argument that may be missing.
    pub(crate) fn of_optional(
        argument: Option<&Bound<'_, PyAny>>,
        count: usize,
        name: &'static str,
    ) -> PyResult<Option<Self>> {
        argument
            .map(|argument| Self::of(argument, count, name))
            .transpose()
    }

    pub(crate) fn rows(&self) -> Rows<'_, W> {
        match self.values.as_chunks().0 {
            [row] if self.stands_for_all => Rows::All(*row),
            rows => Rows::Each(rows),
        }
    }
}

/// Rows of `W` numbers: `count` of them, or one that stands for all.
pub(crate) fn rows<const W: usize>(
    argument: &Bound<'_, PyAny>,
    count: usize,
    name: &'static str,
) -> PyResult<Vec<[f32; W]>> {
    Ok(match GivenRows::of(argument, count, name)?.rows() {
        Rows::All(row) => vec![row; count],
        Rows::Each(rows) => rows.to_vec(),
    })
}

/// The same of an argument that may be missing: then each row is the same.
pub(crate) fn optional_rows<const W: usize>(
    argument: Option<&Bound<'_, PyAny>>,
    count: usize,
    name: &'static str,
    otherwise: [f32; W],
) -> PyResult<Vec<[f32; W]>> {
    argument.map_or_else(
        || Ok(vec![otherwise; count]),
        |argument| rows(argument, count, name),
    )
}

/// Any number of rows of three numbers.
pub(crate) fn points(argument: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Vec<Vec3>> {
    let numbers = numbers(argument, name)?;
    match *numbers.shape.as_slice() {
        [_, 3] => Ok(numbers
            .values
            .as_chunks()
            .0
            .iter()
            .copied()
            .map(Vec3::from_array)
            .collect()),
        _ => Err(wrong_value(
            argument.py(),
            name,
            shape_of(&numbers.shape),
            "rows of three numbers",
        )),
    }
}

/// Any number of rows of three places.
pub(crate) fn triangles(argument: &Bound<'_, PyAny>) -> PyResult<Vec<[u32; 3]>> {
    let numbers = integers(argument, "triangles")?;
    let places = numbers.values.iter();
    let places: Option<Vec<_>> = places.map(|place| u32::try_from(*place).ok()).collect();
    match (numbers.shape.as_slice(), places) {
        ([_, 3], Some(places)) => Ok(places.as_chunks().0.to_vec()),
        _ => Err(wrong(
            argument.py(),
            "triangles",
            "rows of three places of points",
        )),
    }
}

/// Rows of heights: their number, and all of them.
pub(crate) fn heights(argument: &Bound<'_, PyAny>) -> PyResult<(u32, Vec<f32>)> {
    let numbers = numbers(argument, "heights")?;
    match *numbers.shape.as_slice() {
        [rows, _] if u32::try_from(rows).is_ok() => Ok((rows as u32, numbers.values)),
        _ => Err(wrong(argument.py(), "heights", "rows of heights")),
    }
}

/// One vector.
pub(crate) fn vector(argument: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Vec3> {
    one_row::<3>(argument, name, "three numbers").map(Vec3::from_array)
}

/// One quaternion x, y, z, w.
pub(crate) fn rotation(argument: &Bound<'_, PyAny>, name: &'static str) -> PyResult<Quat> {
    one_row::<4>(argument, name, "four numbers: x, y, z, w").map(Quat::from_array)
}

fn one_row<const W: usize>(
    argument: &Bound<'_, PyAny>,
    name: &'static str,
    needed: &'static str,
) -> PyResult<[f32; W]> {
    let numbers = numbers(argument, name)?;
    let row = numbers.values.as_slice().try_into().ok();
    row.filter(|_| numbers.shape == [W])
        .ok_or_else(|| wrong_value(argument.py(), name, shape_of(&numbers.shape), needed))
}

/// The shape of an array, in words.
fn shape_of(shape: &[usize]) -> String {
    match shape {
        [] => "one number".to_owned(),
        [count] => format!("a row of {count}"),
        shape => format!("an array of shape {shape:?}"),
    }
}

/// One body, or a row of bodies.
pub(crate) struct Bodies {
    pub(crate) ids: Vec<BodyId>,
    /// True if the argument was one number.
    pub(crate) is_single: bool,
}

pub(crate) fn bodies(argument: &Bound<'_, PyAny>) -> PyResult<Bodies> {
    let numbers = packed_ids(argument)?;
    let ids = numbers.values.iter().map(|word| parse_packed_id(*word));
    let ids: Result<Vec<_>, _> = ids.collect();
    Ok(Bodies {
        ids: ids.map_err(|error| exception(argument.py(), &error.into()))?,
        is_single: numbers.shape.is_empty(),
    })
}

/// Packed ids of bodies, which may be wrong ones.
pub(crate) fn packed_bodies(argument: &Bound<'_, PyAny>) -> PyResult<Vec<u64>> {
    Ok(packed_ids(argument)?.values)
}

fn packed_ids(argument: &Bound<'_, PyAny>) -> PyResult<Numbers<u64>> {
    let numbers = integers(argument, "body")?;
    match numbers.shape.len() {
        0 | 1 => Ok(numbers),
        _ => Err(wrong(
            argument.py(),
            "body",
            "an id of a body, or a row of ids",
        )),
    }
}

/// One body.
pub(crate) fn single(argument: &Bound<'_, PyAny>) -> PyResult<BodyId> {
    match bodies(argument)?.ids.as_slice() {
        [id] => Ok(*id),
        _ => Err(wrong(argument.py(), "body", "one body")),
    }
}

/// One of several words.
pub(crate) fn one_of<T: Copy>(
    py: Python<'_>,
    words: &[(&str, T)],
    word: &str,
    name: &'static str,
) -> PyResult<T> {
    let found = words.iter().find(|(known, _)| *known == word);
    found.map(|(_, value)| *value).ok_or_else(|| {
        let known = words.iter().map(|(known, _)| *known);
        exception(py, &BindingError::word(name, word, known))
    })
}

/// Conditions of sleep: two words, or the thresholds of speed, of angular speed and of seconds.
pub(crate) fn sleep(value: &Bound<'_, PyAny>) -> PyResult<Option<Sleep>> {
    const NEEDED: &str = "\"settled\", \"never\", or a speed, an angular speed and seconds";
    if value.is_none() {
        return Ok(None);
    }
    no_truth(value, "sleep", NEEDED)?;
    if let Ok((speed, angular_speed, seconds)) = value.extract() {
        return Ok(Some(Sleep::Below(SleepThresholds {
            speed,
            angular_speed,
            seconds,
        })));
    }
    match value.extract::<String>().as_deref() {
        Ok("settled") => Ok(Some(Sleep::Settled)),
        Ok("never") => Ok(Some(Sleep::Never)),
        _ => Err(wrong_value(value.py(), "sleep", written(value), NEEDED)),
    }
}

/// A time in seconds.
pub(crate) fn seconds(py: Python<'_>, seconds: f64, name: &'static str) -> PyResult<Duration> {
    let needed = "seconds, 0 to 1e19";
    Duration::try_from_secs_f64(seconds)
        .map_err(|_| exception(py, &BindingError::value(name, seconds, needed)))
}

/// A tick, or none.
pub(crate) fn optional_tick(value: &Bound<'_, PyAny>) -> PyResult<Option<u64>> {
    within(value, "tick", value.extract(), "0 to 18446744073709551615")
}

/// A call as Python writes it, without the keywords that were left out.
pub(crate) fn call(name: &str, keywords: &[(&str, Option<String>)]) -> String {
    let given = keywords.iter().filter_map(|(keyword, value)| {
        let value = value.as_ref()?;
        Some(format!("{keyword}={value}"))
    });
    format!("{name}({})", given.collect::<Vec<_>>().join(", "))
}

/// A number as Python writes it.
pub(crate) fn number(value: f32) -> String {
    value.to_string()
}

/// A vector as Python writes it.
pub(crate) fn triple(v: Vec3) -> String {
    format!("({}, {}, {})", v.x, v.y, v.z)
}
