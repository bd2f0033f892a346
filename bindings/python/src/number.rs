//! Numbers of arguments, refused by name and limits where their type ends.

use std::fmt::Display;

use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::types::{PyBool, PyDict, PyFloat, PyInt, PyList, PyString, PyTuple};
use pyo3::{PyTypeInfo as _, prelude::*};

use crate::errors::wrong_value;

/// Characters of a value that an error shows.
const SHOWN: usize = 40;

/// Range of a 32-bit float.
pub(crate) const REAL: &str = "finite, and from -3.4e38 to 3.4e38";

/// Lists inside lists that are searched for truth values, in a value that was read: no argument has more.
const DEPTH_MAX: u32 = 4;

/// The same in one that was not: it may be of any size, and have itself inside.
const DEPTH_UNREAD: u32 = 2;

/// True for a truth value, and for a list, a row or an array that has one, within lists of this depth. Python and NumPy take
/// it for 0 or 1.
fn has_truth(value: &Bound<'_, PyAny>, depth: u32) -> PyResult<bool> {
    if value.is_exact_instance_of::<PyFloat>() || value.is_exact_instance_of::<PyInt>() {
        return Ok(false);
    }
    if value.is_instance_of::<PyBool>() {
        return Ok(true);
    }
    if value.is_none() || value.is_instance_of::<PyString>() {
        return Ok(false);
    }
    let Some(inner) = depth.checked_sub(1) else {
        return Ok(false);
    };
    if let Ok(by_key) = value.cast::<PyDict>() {
        let (keys, values) = (by_key.keys(), by_key.values());
        return Ok(has_truth(keys.as_any(), depth)? || has_truth(values.as_any(), depth)?);
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        for part in value.try_iter()? {
            if has_truth(&part?, inner)? {
                return Ok(true);
            }
        }
        return Ok(false);
    }
    // Only arrays of NumPy are sure to say what they hold; whatever else others say is no truth value.
    let kind = value
        .getattr("dtype")
        .and_then(|dtype| dtype.getattr("kind"));
    let Ok(kind) = kind.and_then(|kind| kind.extract::<String>()) else {
        return Ok(false);
    };
    match kind.as_str() {
        "b" => Ok(true),
        "O" => match value.call_method0("tolist") {
            Ok(parts) => has_truth(&parts, inner),
            Err(_) => Ok(false),
        },
        _ => Ok(false),
    }
}

/// Refuses a truth value where numbers are needed; `needed` says which.
pub(crate) fn no_truth(
    value: &Bound<'_, PyAny>,
    name: &'static str,
    needed: impl Display,
) -> PyResult<()> {
    refuse_truth(value, name, needed, DEPTH_UNREAD)
}

fn refuse_truth(
    value: &Bound<'_, PyAny>,
    name: &'static str,
    needed: impl Display,
    depth: u32,
) -> PyResult<()> {
    match has_truth(value, depth)? {
        true => Err(wrong_value(
            value.py(),
            name,
            written(value),
            format_args!("{needed}, and no truth value"),
        )),
        false => Ok(()),
    }
}

/// Numbers of an argument, read by Python's rules. A number beyond its type is wrong; `needed` says what it can be.
pub(crate) fn within<T>(
    value: &Bound<'_, PyAny>,
    name: &'static str,
    read: PyResult<T>,
    needed: impl Display,
) -> PyResult<T> {
    let depth = if read.is_ok() {
        DEPTH_MAX
    } else {
        DEPTH_UNREAD
    };
    refuse_truth(value, name, &needed, depth)?;
    let py = value.py();
    read.map_err(|error| {
        if error.is_instance_of::<PyTypeError>(py) {
            let text = error.value(py).to_string();
            return match text.starts_with("argument") {
                true => error,
                false => PyTypeError::new_err(format!("argument '{name}': {text}")),
            };
        }
        let is_value = error.is_instance_of::<PyOverflowError>(py)
            || error.get_type(py).is(PyValueError::type_object(py));
        match is_value {
            true => wrong_value(py, name, written(value), needed),
            false => error,
        }
    })
}

/// True or False.
pub(crate) fn flag(value: &Bound<'_, PyAny>, name: &'static str) -> PyResult<bool> {
    value.extract().map_err(|error: PyErr| {
        let text = error.value(value.py()).to_string();
        PyTypeError::new_err(format!("argument '{name}': {text}"))
    })
}

/// A number with a fraction. One that is finite in Python is finite here.
pub(crate) fn real(value: &Bound<'_, PyAny>, name: &'static str) -> PyResult<f32> {
    let wide: f64 = within(value, name, value.extract(), REAL)?;
    let narrow = wide as f32;
    match wide.is_finite() && !narrow.is_finite() {
        true => Err(wrong_value(value.py(), name, written(value), REAL)),
        false => Ok(narrow),
    }
}

/// The same of one that may be left out.
pub(crate) fn optional_real(
    value: Option<&Bound<'_, PyAny>>,
    name: &'static str,
) -> PyResult<Option<f32>> {
    value.map(|value| real(value, name)).transpose()
}

/// Several numbers with a fraction: their count is the caller's.
pub(crate) fn reals<const N: usize>(
    value: &Bound<'_, PyAny>,
    name: &'static str,
) -> PyResult<[f32; N]> {
    let needed = format_args!("{N} numbers");
    let each: Vec<Bound<'_, PyAny>> = within(value, name, value.extract(), needed)?;
    let numbers: Vec<f32> = each
        .iter()
        .map(|number| real(number, name))
        .collect::<PyResult<_>>()?;
    let count = numbers.len();
    numbers.try_into().map_err(|_| {
        let found = format_args!("{count} numbers");
        wrong_value(value.py(), name, found, format_args!("{N} numbers"))
    })
}

/// A value as Python writes it, cut to what a sentence can hold.
pub(crate) fn written(value: &Bound<'_, PyAny>) -> String {
    // Python itself refuses to write numbers of thousands of digits.
    let Ok(text) = value.str() else {
        return "a number of too many digits".to_owned();
    };
    let text = text.to_string();
    match text.char_indices().nth(SHOWN) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

/// Functions that read a whole number of the argument that they are named after.
macro_rules! whole {
    ($($name:ident: $type:ty, $needed:literal;)*) => {
        /// Whole numbers, by the names of their arguments.
        pub(crate) mod whole {
            use pyo3::prelude::*;

            use crate::number::within;

            $(pub(crate) fn $name(value: &Bound<'_, PyAny>) -> PyResult<$type> {
                within(value, stringify!($name), value.extract(), $needed)
            })*
        }
    };
}

/// The same of numbers with a fraction.
macro_rules! single {
    ($($name:ident)*) => {
        /// Numbers of 32 bits with a fraction, by the names of their arguments.
        pub(crate) mod single {
            use pyo3::prelude::*;

            use crate::number::real;

            $(pub(crate) fn $name(value: &Bound<'_, PyAny>) -> PyResult<f32> {
                real(value, stringify!($name))
            })*
        }
    };
}

/// The same of numbers of 64 bits.
macro_rules! double {
    ($($name:ident)*) => {
        /// Numbers of 64 bits with a fraction, by the names of their arguments.
        pub(crate) mod double {
            use pyo3::prelude::*;

            use crate::number::within;

            $(pub(crate) fn $name(value: &Bound<'_, PyAny>) -> PyResult<f64> {
                within(value, stringify!($name), value.extract(), "finite")
            })*
        }
    };
}

whole! {
    ticks_per_second: u32, "1 to 1000";
    substeps: u32, "1 to 16";
    publish_interval: u32, "at least 1, and less than 4294967296";
    locked_axes: u8, "six bits: 0 to 63";
    hits: u32, "1 to 64";
    groups: u32, "32 bits: 0 to 4294967295";
    id: u32, "0 to 65535";
    ticks: u32, "1 to 4294967295";
    depth: u32, "0 to 4294967295";
    tick: u64, "0 to 18446744073709551615";
    threads: u32, "1 to 4294967295";
}

single! {
    x y z radius half_height row_spacing column_spacing distance length stiffness damping
}

double! {
    timeout duration tolerance delay_ticks lead_ticks ticks
}
