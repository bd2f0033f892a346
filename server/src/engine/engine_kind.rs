//! The engines that this program was built with.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// An engine by its name. A build without the feature of an engine does not know it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum EngineKind {
    /// Rapier, the engine of every build.
    #[default]
    Rapier,
    /// Box3D, with the feature `box3d`.
    #[cfg(feature = "box3d")]
    Box3d,
}

impl EngineKind {
    /// The engines of this build.
    pub const ALL: &'static [Self] = &[
        Self::Rapier,
        #[cfg(feature = "box3d")]
        Self::Box3d,
    ];

    /// Its name in settings.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Rapier => "rapier",
            #[cfg(feature = "box3d")]
            Self::Box3d => "box3d",
        }
    }

    /// True if a data directory can keep its scenes, and a scene continues after a fault: the engine has images and copies.
    #[must_use]
    pub const fn keeps_images(self) -> bool {
        matches!(self, Self::Rapier)
    }
}

impl fmt::Display for EngineKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Error: this build has no engine of the name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnknownEngine(String);

impl fmt::Display for UnknownEngine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let known: Vec<_> = EngineKind::ALL.iter().map(|kind| kind.name()).collect();
        let (name, known) = (&self.0, known.join(", "));
        write!(
            f,
            "no engine \"{name}\": this program was built with {known}"
        )
    }
}

impl std::error::Error for UnknownEngine {}

impl FromStr for EngineKind {
    type Err = UnknownEngine;

    fn from_str(name: &str) -> Result<Self, UnknownEngine> {
        let known = Self::ALL.iter().find(|kind| kind.name() == name);
        known.copied().ok_or_else(|| UnknownEngine(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_engine_has_its_name_and_an_unknown_name_lists_them() {
        for kind in EngineKind::ALL {
            assert_eq!(kind.name().parse(), Ok(*kind));
        }
        let error = "bulldozer".parse::<EngineKind>().unwrap_err().to_string();
        assert!(error.contains("\"bulldozer\"") && error.contains("rapier"));
    }
}
