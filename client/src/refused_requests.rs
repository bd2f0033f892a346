//! Requests that the server refused, until a call reports them.
//!
//! Invariant: at most [`REFUSALS_KEPT`] are kept, the oldest ones; of the others only the number is known.

use std::fmt;

use rhumb_view::RefusedRequest;

/// Limit of refusals that no call has reported yet. Far more than an application reads, and some 50 KiB.
const REFUSALS_KEPT: usize = 1_024;

/// Requests that the server refused: at least one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusedRequests {
    kept: Box<[RefusedRequest]>,
    left_out: u64,
}

impl RefusedRequests {
    /// The first 1,024 of them, the oldest first.
    #[must_use]
    pub fn refusals(&self) -> &[RefusedRequest] {
        &self.kept
    }

    /// The number of further ones, of which nothing else is kept. They are events as well.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.left_out
    }

    /// The oldest one.
    ///
    /// # Panics
    ///
    /// Never: there is at least one.
    #[must_use]
    pub fn first(&self) -> &RefusedRequest {
        self.kept.first().expect("there is at least one refusal")
    }
}

impl fmt::Display for RefusedRequests {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.first().fmt(f)?;
        match self.kept.len() as u64 - 1 + self.left_out {
            0 => Ok(()),
            more => write!(f, " (and {more} more refusals)"),
        }
    }
}

/// Refusals that no call has reported yet.
#[derive(Debug, Default)]
pub(crate) struct Unreported {
    kept: Vec<RefusedRequest>,
    left_out: u64,
}

impl Unreported {
    /// Adds a refusal.
    pub(crate) fn add(&mut self, refusal: RefusedRequest) {
        if self.kept.len() < REFUSALS_KEPT {
            self.kept.push(refusal);
        } else {
            self.left_out += 1;
        }
    }

    /// Takes all refusals; `None` if there are none.
    pub(crate) fn take(&mut self) -> Option<RefusedRequests> {
        let Self { kept, left_out } = std::mem::take(self);
        (!kept.is_empty()).then(|| RefusedRequests {
            kept: kept.into(),
            left_out,
        })
    }
}
