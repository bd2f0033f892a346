//! The bodies of MJCF that touch each other, as collision groups.
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
        let apart = |a: usize, b: usize| excluded.contains(&(a.min(b), a.max(b)));
        return from_classes(bodies, classes, apart);
    }
    let why = "there are 32 groups: of the parts in such pairs, none touches another";
    let subject = "excluded contacts".to_owned();
    report.add(
        place,
        subject,
        format!("{} pairs", excluded.len()),
        Effect::Approximated,
        why,
    );
    // Parts that lie in each other would be driven apart if they touched.
    let is_alone = |body: usize| alone.contains(&body);
    match classes(&all, |body| (bodies[body], is_alone(body))) {
        Some(classes) => from_classes(bodies, &classes, |a, b| is_alone(a) && is_alone(b)),
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
    apart: impl Fn(usize, usize) -> bool,
) -> Vec<CollisionGroups> {
    let count = classes.iter().max().map_or(0, |most| most + 1);
    let mut first = vec![0; count];
    for (body, class) in classes.iter().enumerate().rev() {
        first[*class] = body;
    }
    let row = |class: usize| {
        let (mine, mut touches) = (first[class], u32::MAX);
        for other in 0..count {
            if apart(mine, first[other]) || !bodies[mine].touches(bodies[first[other]]) {
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
        let many: Vec<_> = (0..40).map(|_| bits(1, 1)).collect();
        let excluded = (0..38).map(|body| (body, body + 1)).collect();
        let few = super::groups(&many, &excluded, &Place::of("a"), &mut report);
        let touch = |a: usize, b: usize| few[a].members & few[b].touches != 0;
        assert!((0..38).all(|a| !touch(a, a + 1) && touch(a, 39) && touch(39, a)));
        assert_eq!(report.notes()[0].subject, "excluded contacts");
        assert!(
            groups
                .iter()
                .all(|own| own.touches & other.members != 0 && own.members != 0)
        );
    }
}
