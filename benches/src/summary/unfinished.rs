//! A replay that did not come to its end.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::columns::setting;
use crate::record::Unfinished;

/// A failed replay.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnfinishedReplay {
    /// Its settings, as tables name them.
    pub setting: String,
    /// The simulated link; `null` without one.
    pub link: Option<String>,
    /// Seed of that link.
    pub link_seed: u64,
    /// Cause of the failure.
    pub cause: String,
}

impl UnfinishedReplay {
    pub(super) fn of(unfinished: &Unfinished) -> Self {
        let config = &unfinished.config;
        let replayed = config.replayed.as_ref();
        let setting =
            replayed.map(|of| setting(of, config.tolerance_m, config.budget_bytes_per_second));
        Self {
            setting: setting.unwrap_or_else(|| config.mode.name().to_owned()),
            link: (!config.link.is_empty()).then(|| config.link.clone()),
            link_seed: replayed.map_or(config.seed, |of| of.link_seed),
            cause: unfinished.cause.clone(),
        }
    }
}

impl fmt::Display for UnfinishedReplay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.setting)?;
        if let Some(link) = &self.link {
            write!(f, ", {link}, seed {}", self.link_seed)?;
        }
        write!(f, ": {}", self.cause)
    }
}
