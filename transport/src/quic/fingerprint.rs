//! Fingerprint of a certificate, for a client to pin.
//!
//! Decides no trust by itself; see `trust`.

use std::fmt;
use std::str::FromStr;

use ring::digest;

/// SHA-256 of a server's own certificate in DER form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Fingerprint(pub [u8; 32]);

/// Error of a written fingerprint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FingerprintError {
    /// The text has this many characters rather than 64.
    Length(usize),
    /// The character at this place is not a hexadecimal digit.
    Digit(usize),
}

impl Fingerprint {
    /// The fingerprint of a certificate in DER form.
    #[must_use]
    pub fn of(certificate_der: &[u8]) -> Self {
        let digest = digest::digest(&digest::SHA256, certificate_der);
        let mut bytes = [0; 32];
        bytes.copy_from_slice(digest.as_ref());
        Self(bytes)
    }
}

impl fmt::Display for Fingerprint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl FromStr for Fingerprint {
    type Err = FingerprintError;

    fn from_str(text: &str) -> Result<Self, FingerprintError> {
        let digits = text.as_bytes();
        if digits.len() != 64 {
            return Err(FingerprintError::Length(digits.len()));
        }
        let mut bytes = [0; 32];
        for (at, &digit) in digits.iter().enumerate() {
            let value = char::from(digit)
                .to_digit(16)
                .ok_or(FingerprintError::Digit(at))?;
            bytes[at / 2] = bytes[at / 2] << 4 | value as u8;
        }
        Ok(Self(bytes))
    }
}

impl fmt::Display for FingerprintError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length(have) => {
                write!(f, "a fingerprint is 64 hexadecimal digits, this has {have}")
            }
            Self::Digit(at) => write!(
                f,
                "character {} of the fingerprint is not a hexadecimal digit",
                at + 1
            ),
        }
    }
}

impl std::error::Error for FingerprintError {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_displayed_fingerprint_parses_back() {
        let print = Fingerprint::of(b"abc");
        let text = print.to_string();
        assert_eq!(
            text,
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        assert_eq!(text.parse(), Ok(print));
        assert_eq!(text.to_uppercase().parse(), Ok(print));
    }

    #[test]
    fn a_malformed_fingerprint_error_names_the_fault() {
        assert_eq!(
            "ab".parse::<Fingerprint>(),
            Err(FingerprintError::Length(2))
        );
        let text = "0".repeat(9) + "x" + &"0".repeat(54);
        assert_eq!(text.parse::<Fingerprint>(), Err(FingerprintError::Digit(9)));
    }
}
