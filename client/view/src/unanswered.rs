//! Values of commands that the server has not answered yet.
//!
//! Invariant: the numbers rise. A session gives them out in this order, so that a new one is last.

/// A value for some of the commands, by number.
#[derive(Debug)]
pub(crate) struct Unanswered<T>(Vec<(u64, T)>);

impl<T> Default for Unanswered<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> Unanswered<T> {
    /// Stores the value of a command, unless it has one.
    pub(crate) fn insert(&mut self, command: u64, value: T) {
        let place = self.place(command);
        if self.0.get(place).is_none_or(|(at, _)| *at != command) {
            self.0.insert(place, (command, value));
        }
    }

    /// Takes the value of one command.
    pub(crate) fn remove(&mut self, command: u64) -> Option<T> {
        let place = self.place(command);
        let is_found = self.0.get(place).is_some_and(|(at, _)| *at == command);
        is_found.then(|| self.0.remove(place).1)
    }

    /// Takes the values of all commands up to this number.
    pub(crate) fn take_through(&mut self, through: u64) -> Vec<(u64, T)> {
        let later = self.0.split_off(self.place(through.saturating_add(1)));
        core::mem::replace(&mut self.0, later)
    }

    /// Keeps the values for which this holds; it may change them.
    pub(crate) fn retain_mut(&mut self, mut holds: impl FnMut(&mut T) -> bool) {
        self.0.retain_mut(|(_, value)| holds(value));
    }

    /// The values of the commands from this number on.
    pub(crate) fn from(&self, command: u64) -> &[(u64, T)] {
        &self.0[self.place(command)..]
    }

    /// True if a command has a value.
    pub(crate) fn has(&self, command: u64) -> bool {
        self.from(command)
            .first()
            .is_some_and(|(at, _)| *at == command)
    }

    fn place(&self, command: u64) -> usize {
        self.0.partition_point(|(at, _)| *at < command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_found_by_number_and_taken_in_order() {
        let mut unanswered = Unanswered::default();
        for command in [2, 5, 8, 3, 5] {
            unanswered.insert(command, 10 * command);
        }
        assert_eq!((unanswered.has(3), unanswered.has(4)), (true, false));
        assert_eq!(
            (unanswered.remove(4), unanswered.remove(3)),
            (None, Some(30))
        );
        assert_eq!(unanswered.from(3), [(5, 50), (8, 80)]);
        assert_eq!(unanswered.take_through(5), [(2, 20), (5, 50)]);
        assert_eq!(unanswered.take_through(u64::MAX), [(8, 80)]);
        assert!(!unanswered.has(8));
    }
}
