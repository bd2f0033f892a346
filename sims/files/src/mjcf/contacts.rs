//! Which bodies of MJCF touch each other, as collision groups.
//!
//! Two geoms touch there if a bit of the one's type is in the other's affinity, either way round; groups here need both
//! ways. So bodies that touch the same others get a bit of their own, and name the bits that they touch.

use std::collections::BTreeSet;

use rhumb_protocol::scene::CollisionGroups;

use crate::error::Place;
use crate::report::{Effect, Report};

/// Bits of a body's geoms together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Bits {
    pub(crate) contype: u32,
    pub(crate) conaffinity: u32,
}

impl Bits {
    fn touches(self, other: Self) -> bool {
        self.contype & other.conaffinity != 0 || other.contype & self.conaffinity != 0
    }
}

/// Groups of each body. `excluded`: pairs that do not touch, the lower place first.
pub(crate) fn groups(
    bodies: &[Bits],
    excluded: &BTreeSet<(usize, usize)>,
    place: &Place,
    report: &mut Report,
) -> Vec<CollisionGroups> {
    let alone: BTreeSet<_> = excluded.iter().flat_map(|(a, b)| [*a, *b]).collect();
    let all: Vec<_> = (0..bodies.len()).collect();
    let with = classes(&all, |body| {
        (bodies[body], alone.contains(&body).then_some(body))
    });
    if let Some(classes) = &with {
        return from_classes(bodies, classes, excluded);
    }
    let why = "there are 32 groups: parts that the file keeps apart may touch";
    let subject = "excluded contacts".to_owned();
    report.add(
        place,
        subject,
        format!("{} pairs", excluded.len()),
        Effect::Left,
        why,
    );
    match classes(&all, |body| bodies[body]) {
        Some(classes) => from_classes(bodies, &classes, &BTreeSet::new()),
        None => vec![CollisionGroups::ALL; bodies.len()],
    }
}

/// The class of each body; `None` for more classes than there are bits.
fn classes<K: Ord>(bodies: &[usize], key: impl Fn(usize) -> K) -> Option<Vec<usize>> {
    let keys: BTreeSet<_> = bodies.iter().map(|body| key(*body)).collect();
    if keys.len() > 32 {
        return None;
    }
    let keys: Vec<_> = keys.into_iter().collect();
    let class = |body: &usize| keys.binary_search(&key(*body)).ok();
    bodies.iter().map(class).collect()
}

fn from_classes(
    bodies: &[Bits],
    classes: &[usize],
    excluded: &BTreeSet<(usize, usize)>,
) -> Vec<CollisionGroups> {
    let count = classes.iter().max().map_or(0, |most| most + 1);
    let mut first = vec![0; count];
    for (body, class) in classes.iter().enumerate().rev() {
        first[*class] = body;
    }
    let row = |class: usize| {
        let (mine, mut touches) = (first[class], u32::MAX);
        for other in 0..count {
            let (a, b) = (mine.min(first[other]), mine.max(first[other]));
            let is_excluded = excluded.contains(&(a, b));
            if is_excluded || !bodies[mine].touches(bodies[first[other]]) {
                touches &= !(1 << other);
            }
        }
        touches
    };
    let rows: Vec<_> = (0..count).map(row).collect();
    let group = |class: &usize| CollisionGroups {
        members: 1 << class,
        touches: rows[*class],
    };
    classes.iter().map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_touch_exactly_where_bits_and_exclusions_say_so() {
        let bits = |contype, conaffinity| Bits {
            contype,
            conaffinity,
        };
        let bodies = [
            bits(1, 1),
            bits(1, 0),
            bits(0, 1),
            bits(2, 1),
            bits(1, 1),
            bits(1, 1),
        ];
        let excluded = BTreeSet::from([(0, 4)]);
        let mut report = Report::default();
        let groups = groups(&bodies, &excluded, &Place::of("a"), &mut report);
        assert!(report.is_empty());
        for a in 0..bodies.len() {
            for b in a + 1..bodies.len() {
                let expected = bodies[a].touches(bodies[b]) && !excluded.contains(&(a, b));
                let (x, y) = (groups[a], groups[b]);
                let touch = x.members & y.touches != 0 && y.members & x.touches != 0;
                assert_eq!(touch, expected, "{a} {b}");
            }
        }
        let other = CollisionGroups::ALL;
        assert!(
            groups
                .iter()
                .all(|own| own.touches & other.members != 0 && own.members != 0)
        );
    }
}
