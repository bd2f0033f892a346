//! Names of a scene's streams: short, and not reused soon.
//!
//! Late datagrams of an ended stream must not be taken for those of another. Invariant: a free name is reused only
//! after [`REST`] other streams were named, however few names are free; long names fill the gap.

use rhumb_protocol::packet::StreamId;

/// Assigns names to streams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StreamNames {
    small: u32,
    large: u32,
    /// Number of names assigned.
    given: u64,
    /// For each small name: the count of names when it was last in use; `None` if never.
    taken: [Option<u64>; StreamId::SMALL.end as usize],
}

/// Number of other streams named before a small name is reused.
const REST: u64 = 8;

impl StreamNames {
    /// The names of the server's scene of this number: a new scene under an old name starts elsewhere.
    pub(crate) const fn of_scene(number: u32) -> Self {
        Self {
            small: number % StreamId::SMALL.end,
            large: StreamId::SMALL.end,
            given: 0,
            taken: [None; StreamId::SMALL.end as usize],
        }
    }

    /// A name for a new stream: none that is in use or was until lately.
    pub(crate) fn next(&mut self, is_taken: impl Fn(StreamId) -> bool) -> StreamId {
        for (name, taken) in StreamId::SMALL.zip(&mut self.taken) {
            if is_taken(StreamId(name)) {
                *taken = Some(self.given);
            }
        }
        self.given += 1;
        for _ in StreamId::SMALL {
            let name = self.small;
            self.small = (name + 1) % StreamId::SMALL.end;
            let taken = &mut self.taken[name as usize];
            if taken.is_none_or(|taken| self.given - taken > REST) {
                *taken = Some(self.given);
                return StreamId(name);
            }
        }
        let name = StreamId(self.large);
        self.large = self.large.checked_add(1).unwrap_or(StreamId::SMALL.end);
        name
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_reused_after_all_other_free_ones() {
        let mut names = StreamNames::of_scene(18);
        let given: Vec<u32> = (0..17)
            .map(|_| names.next(|name| name == StreamId(4)).0)
            .collect();
        let expected = [3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 0, 1, 2, 3, 5, 6];
        assert_eq!(given, expected);
        assert_eq!(names.next(|name| name.0 < 15), StreamId(15));
        assert_eq!(names.next(|name| name.0 < 15), StreamId(16));
    }

    #[test]
    fn a_freed_name_rests_even_without_other_free_small_names() {
        let mut names = StreamNames::of_scene(0);
        for name in 0..14 {
            assert_eq!(names.next(|taken| taken.0 < name), StreamId(name));
        }
        // One member changes its tier again and again, while all others keep theirs.
        let mut last = StreamId(13);
        let mut given = Vec::new();
        for _ in 0..30 {
            let present = last;
            last = names.next(|name| name.0 < 13 || name == present);
            given.push(last);
        }
        for (place, name) in given.iter().enumerate() {
            let until = (place + 1 + REST as usize).min(given.len());
            let soon = &given[place + 1..until];
            assert!(!soon.contains(name), "{name} at {place} of {given:?}");
        }
        let small = given
            .iter()
            .filter(|name| StreamId::SMALL.contains(&name.0));
        assert!(small.count() >= 4, "they come again: {given:?}");
    }
}
