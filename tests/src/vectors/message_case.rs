//! A message of the vectors: sent by one side, or refused.

/// A message that is valid, or that must be refused.
#[derive(Clone, Debug)]
pub(crate) struct MessageCase {
    pub(super) name: String,
    pub(super) kind: u8,
    pub(super) body: Vec<u8>,
}
