//! The server that a caller trusts, from the texts of any language.

use std::path::Path;

use rhumb_client::Trust;

use crate::error::BindingError;

/// Trusts the certificate with a fingerprint, or those that the roots in a PEM file sign.
///
/// # Errors
///
/// [`BindingError`] for a text that is no fingerprint, for both, and for neither.
pub fn trust(fingerprint: Option<&str>, roots: Option<&Path>) -> Result<Trust, BindingError> {
    match (fingerprint, roots) {
        (Some(fingerprint), None) => Ok(Trust::Fingerprint(fingerprint.parse()?)),
        (None, Some(roots)) => Ok(Trust::Roots(roots.to_owned())),
        (Some(_), Some(_)) => Err(BindingError::Argument {
            argument: "trust",
            needed: "a fingerprint or roots, and not both",
        }),
        (None, None) => Err(BindingError::Argument {
            argument: "trust",
            needed: "given: the fingerprint that the server prints when it starts, or a PEM file of roots",
        }),
    }
}
