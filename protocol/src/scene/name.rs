//! The name of a scene.

use alloc::string::String;
use core::fmt;
use core::str::FromStr;

use crate::limits::SCENE_NAME_BYTES_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// One to 64 characters of `a`–`z`, `A`–`Z`, `0`–`9`, `-`, `_`, `.` and `/`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SceneName(String);

impl SceneName {
    /// As text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for SceneName {
    type Err = InvalidSceneName;

    fn from_str(text: &str) -> Result<Self, InvalidSceneName> {
        let fits = (1..=SCENE_NAME_BYTES_MAX).contains(&text.len());
        let allowed = |c: u8| c.is_ascii_alphanumeric() || b"-_./".contains(&c);
        if fits && text.bytes().all(allowed) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidSceneName)
        }
    }
}

impl fmt::Display for SceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Wire for SceneName {
    fn encode(&self, to: &mut Writer) {
        to.sized(self.0.as_bytes());
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let bytes = from.sized(SCENE_NAME_BYTES_MAX)?;
        let text = core::str::from_utf8(bytes).map_err(|_| Malformed::Text)?;
        text.parse().map_err(|_| Malformed::Text)
    }
}

/// A text that cannot name a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidSceneName;

impl fmt::Display for InvalidSceneName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a scene's name has 1 to 64 letters, digits, '-', '_', '.' or '/'")
    }
}

impl core::error::Error for InvalidSceneName {}
