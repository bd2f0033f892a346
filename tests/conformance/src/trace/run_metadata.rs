//! The metadata of a recorded run, by name.

use std::collections::BTreeMap;

/// The values of a run's metadata record, by name.
pub(super) type RunMetadata = BTreeMap<String, String>;
