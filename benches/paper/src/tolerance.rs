//! A length in metres as a tolerance.

use rhumb_reckoning::{Metres, Tolerance};

use super::error::PaperError;

/// Checks a length in metres as a tolerance.
pub(crate) fn tolerance(metres: f64) -> Result<Tolerance, PaperError> {
    Tolerance::from_metres(Metres::new(metres)).map_err(|error| PaperError::Tolerance {
        metres,
        cause: error.to_string(),
    })
}
