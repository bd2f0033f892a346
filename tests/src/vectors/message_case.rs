//! A message of the vectors: sent by one side, or refused.

/// A message that is valid, or that must be refused.
#[derive(Clone, Debug)]
pub(crate) struct MessageCase {
    pub(super) name: String,
    pub(super) kind: u8,
    pub(super) body: Vec<u8>,
    /// The requirement that it is about, where it is about one.
    pub(super) rule: Option<&'static str>,
}

/// A case under construction: the requirement, its name, and the bytes behind the first ones.
pub(super) type Edge = (&'static str, String, Vec<u8>);

pub(super) fn edge(rule: &'static str, name: impl Into<String>, bytes: Vec<u8>) -> Edge {
    (rule, name.into(), bytes)
}
