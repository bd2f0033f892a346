//! The server that a caller means and trusts, from the texts of any language.
//!
//! An address may end with `#` and the fingerprint of its server, so that one text suffices.

use std::path::{Path, PathBuf};

use rhumb_client::{Fingerprint, Trust};

use crate::error::BindingError;

/// The address of a server with its fingerprint, as [`server_of`] reads it.
#[must_use]
pub fn address_with(address: impl std::fmt::Display, fingerprint: Fingerprint) -> String {
    format!("{address}#{fingerprint}")
}

/// The plain address of a server, and what to trust: the certificate with a fingerprint, which the address may end with,
/// or those that the roots in a PEM file sign. A Unix socket has no certificate.
///
/// # Errors
///
/// [`BindingError`] for a text that is no fingerprint, for two fingerprints, for one and roots, and for neither; for either of
/// them beside a Unix socket, where neither would be checked.
pub fn server_of<'a>(
    address: &'a str,
    fingerprint: Option<&str>,
    roots: Option<&Path>,
) -> Result<(&'a str, Trust), BindingError> {
    let needed = |needed| BindingError::Argument {
        argument: "trust",
        needed,
    };
    if address.starts_with("unix:") {
        return match (fingerprint, roots) {
            // It is not asked for: only the user who runs the server can connect.
            (None, None) => Ok((address, Trust::Roots(PathBuf::new()))),
            _ => Err(needed(
                "left out for a Unix socket: it has no certificate, and only the user who runs the server can connect",
            )),
        };
    }
    let (address, own) = match address.rsplit_once('#') {
        Some((address, own)) => (address, Some(own)),
        None => (address, None),
    };
    let fingerprint = match (own, fingerprint) {
        (Some(own), Some(given)) if !own.eq_ignore_ascii_case(given) => {
            return Err(needed(
                "one fingerprint: that of the address and the other one differ",
            ));
        }
        (own, given) => own.or(given),
    };
    let trust = match (fingerprint, roots) {
        (Some(fingerprint), None) => Trust::Fingerprint(fingerprint.parse()?),
        (None, Some(roots)) => Trust::Roots(roots.to_owned()),
        (Some(_), Some(_)) => return Err(needed("a fingerprint or roots, and not both")),
        (None, None) => {
            return Err(needed(
                "given: the fingerprint that the server prints when it starts, also at the end of the address behind a #, \
                 or a PEM file of roots",
            ));
        }
    };
    Ok((address, trust))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRINT: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

    #[test]
    fn an_address_may_carry_its_fingerprint() {
        let text = address_with("127.0.0.1:4433", PRINT.parse().unwrap());
        for (text, fingerprint) in [
            (text.as_str(), None),
            (text.as_str(), Some(PRINT)),
            ("127.0.0.1:4433", Some(PRINT)),
        ] {
            let (address, trust) = server_of(text, fingerprint, None).unwrap();
            assert_eq!(address, "127.0.0.1:4433");
            assert!(matches!(trust, Trust::Fingerprint(print) if print.to_string() == PRINT));
        }
        // The path of a Unix socket may have such a sign.
        let (address, _) = server_of("unix:/tmp/a#b", None, None).unwrap();
        assert_eq!(address, "unix:/tmp/a#b");
        let other = "0".repeat(64);
        let roots = Path::new("roots.pem");
        let (_, trust) = server_of("example.org", None, Some(roots)).unwrap();
        assert!(matches!(trust, Trust::Roots(path) if path == roots));
        for (text, fingerprint, roots, words) in [
            (text.as_str(), Some(other.as_str()), None, "differ"),
            (text.as_str(), None, Some(roots), "not both"),
            ("127.0.0.1:4433", None, None, "behind a #"),
            ("127.0.0.1:4433#", None, None, "64 hexadecimal"),
            ("unix:/tmp/a#b", Some(PRINT), None, "Unix socket"),
            ("unix:/tmp/a", None, Some(roots), "Unix socket"),
        ] {
            let error = server_of(text, fingerprint, roots).unwrap_err();
            assert!(error.to_string().contains(words), "{text}: {error}");
        }
    }
}
