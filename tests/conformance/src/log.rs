//! The lines that a case leaves behind: what each side sent.

use std::cell::RefCell;
use std::rc::Rc;

/// The log of sent and received data, in order.
#[derive(Clone, Debug, Default)]
pub struct Log(Rc<RefCell<Vec<String>>>);

impl Log {
    /// Number of lines kept: enough to show what led to a failure.
    const LINES_MAX: usize = 400;

    /// Adds a line; drops the oldest one when full.
    pub fn note(&self, line: impl Into<String>) {
        let mut lines = self.0.borrow_mut();
        if lines.len() >= Self::LINES_MAX {
            lines.remove(0);
        }
        let mut line = line.into();
        if line.len() > 400 {
            let end = (0..=400).rev().find(|end| line.is_char_boundary(*end));
            line.truncate(end.unwrap_or_default());
            line.push('…');
        }
        lines.push(line);
    }

    pub(super) fn take(&self) -> Vec<String> {
        self.0.take()
    }
}
