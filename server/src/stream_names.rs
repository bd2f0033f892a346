//! What the streams of a scene are called: short names, none again soon.
//!
//! Late datagrams of a stream that ended must not be taken for those of another.

use rhumb_protocol::packet::StreamId;

/// Gives names to streams.
#[derive(Clone, Copy, Debug)]
pub(crate) struct StreamNames {
    small: u32,
    large: u32,
}

impl StreamNames {
    /// Those of the so many-th scene of a server: one that follows upon another under its name goes on elsewhere.
    pub(crate) const fn of_scene(number: u32) -> Self {
        Self {
            small: number % StreamId::SMALL.end,
            large: StreamId::SMALL.end,
        }
    }

    /// A name for a stream that begins now: not one of those that are said.
    pub(crate) fn next(&mut self, is_taken: impl Fn(StreamId) -> bool) -> StreamId {
        for _ in StreamId::SMALL {
            let name = StreamId(self.small);
            self.small = (self.small + 1) % StreamId::SMALL.end;
            if !is_taken(name) {
                return name;
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
    fn a_name_comes_again_after_all_others_that_are_free() {
        let mut names = StreamNames::of_scene(18);
        let given: Vec<u32> = (0..17)
            .map(|_| names.next(|name| name == StreamId(4)).0)
            .collect();
        let expected = [3, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 0, 1, 2, 3, 5, 6];
        assert_eq!(given, expected);
        assert_eq!(names.next(|name| name.0 < 15), StreamId(15));
        assert_eq!(names.next(|name| name.0 < 15), StreamId(16));
    }
}
