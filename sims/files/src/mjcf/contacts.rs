//! Pairs of geoms that touch in MJCF, as groups of their bodies.
//!
//! Two geoms touch there if a bit of the one's type is in the other's affinity, either way round; collision groups here need
//! both ways. So bodies that touch the same others get a bit of their own, and name the bits that they touch.
//!
//! An exclusion there is about two of the file's bodies, the world and those that nothing moves among them. Such a body is
//! part of a moving one here, or a fixed body for each of its geoms.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_protocol::scene::CollisionGroups;

use crate::report::{Effect, Place, Report};
use crate::xml::Element;

/// The file's bodies, by numbers, and the bodies here that have their geoms. Number zero is the world.
#[derive(Debug, Default)]
pub(crate) struct Parts {
    last: usize,
    /// Number, and body.
    all: BTreeSet<(usize, usize)>,
    /// Pairs that a chain of joints connects.
    chains: BTreeSet<(usize, usize)>,
}

/// An exclusion, for two bodies here.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Excluded<'a> {
    /// The lower one first.
    bodies: (usize, usize),
    /// Those of the file, in the same order.
    parts: (usize, usize),
    element: &'a Element,
}

impl<'a> Excluded<'a> {
    pub(crate) const fn new(bodies: [usize; 2], parts: [usize; 2], element: &'a Element) -> Self {
        let (one, other) = match bodies[0] <= bodies[1] {
            true => (0, 1),
            false => (1, 0),
        };
        Self {
            bodies: (bodies[one], bodies[other]),
            parts: (parts[one], parts[other]),
            element,
        }
    }
}

impl Parts {
    /// Begins another body of the file; returns its number.
    pub(crate) const fn begin(&mut self) -> usize {
        self.last += 1;
        self.last
    }

    /// Adds a geom of the newest body of the file to a body.
    pub(crate) fn add(&mut self, part: usize, body: usize) {
        self.all.insert((part, body));
    }

    /// Says that the newest body has another place.
    pub(crate) fn moved(&mut self, part: usize, from: usize, to: usize) {
        if self.all.remove(&(part, from)) {
            self.all.insert((part, to));
        }
    }

    /// Adds two bodies that a chain of joints connects.
    pub(crate) fn add_chain(&mut self, holding: usize, held: usize) {
        self.chains.insert((holding, held));
    }

    /// The bodies that have geoms of a body of the file.
    pub(crate) fn bodies(&self, part: usize) -> Vec<usize> {
        let own = self.all.range((part, 0)..=(part, usize::MAX));
        own.map(|(_, body)| *body).collect()
    }

    /// Pairs of bodies that do not touch, the lower place first. `joined`: pairs that do not touch anyway.
    pub(crate) fn apart(
        self,
        excluded: &[Excluded<'_>],
        joined: &BTreeSet<(usize, usize)>,
        report: &mut Report,
    ) -> BTreeSet<(usize, usize)> {
        let mut counts: BTreeMap<usize, usize> = BTreeMap::new();
        for (_, body) in &self.all {
            *counts.entry(*body).or_default() += 1;
        }
        let mut apart: BTreeMap<_, BTreeSet<_>> = BTreeMap::new();
        for one in excluded.iter().filter(|one| one.bodies.0 != one.bodies.1) {
            apart.entry(one.bodies).or_default().insert(one.parts);
        }
        for one in excluded {
            let (a, b) = one.bodies;
            let whole = counts[&a] * counts[&b];
            let own = apart.get(&(a, b)).map_or(whole, BTreeSet::len);
            if own < whole && !joined.contains(&(a, b)) {
                let why = "bodies that nothing moves against each other are one here: none of its parts touches the other";
                let subject = "excluded contacts of a part".to_owned();
                let place = one.element.place();
                report.again(&place, subject, Effect::Approximated, why);
            }
        }
        let mut pairs = self.chains;
        pairs.extend(apart.into_keys());
        pairs
    }
}

/// Bits of a body's geoms together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Bits {
    pub(crate) contype: u32,
    pub(crate) conaffinity: u32,
}

impl Bits {
    const fn touches(self, other: Self) -> bool {
        self.contype & other.conaffinity != 0 || other.contype & self.conaffinity != 0
    }
}

/// Bits of groups.
const GROUPS_MAX: usize = 32;
/// Kinds of bodies that are compared with each other.
const KINDS_MAX: usize = 1_024;

/// Groups of each body. `apart`: pairs that do not touch, the lower place first.
pub(crate) fn groups(
    bodies: &[Bits],
    apart: &BTreeSet<(usize, usize)>,
    place: &Place,
    report: &mut Report,
) -> Vec<CollisionGroups> {
    let mut others: Vec<Vec<usize>> = vec![Vec::new(); bodies.len()];
    let touching = |(a, b): &&(usize, usize)| bodies[*a].touches(bodies[*b]);
    for (a, b) in apart.iter().filter(touching) {
        others[*a].push(*b);
        others[*b].push(*a);
    }
    // Two bodies of a kind are apart from the same ones, so none of them from the other.
    let exact = Kinds::of(bodies.len(), |body| (bodies[body], &others[body]));
    let touch =
        |a: usize, b: usize| bodies[a].touches(bodies[b]) && !apart.contains(&(a.min(b), a.max(b)));
    let exact = exact.merged(touch);
    if exact.count() <= GROUPS_MAX {
        return exact.groups(touch);
    }
    // Parts that lie in each other would be driven apart if they touched.
    let is_alone = |body: usize| !others[body].is_empty();
    let touch = |a: usize, b: usize| bodies[a].touches(bodies[b]) && !(is_alone(a) && is_alone(b));
    let coarse = Kinds::of(bodies.len(), |body| (bodies[body], is_alone(body))).merged(touch);
    if (0..bodies.len()).any(is_alone) {
        let why = "there are 32 groups: of the parts in such pairs, none touches another";
        let subject = "excluded contacts".to_owned();
        let value = format!("{} pairs", apart.len());
        report.add(place, subject, value, Effect::Approximated, why);
    }
    if coarse.count() > GROUPS_MAX {
        let why = "there are 32 groups: the bodies of the rarest kinds are one, which touches what most of them touch";
        let subject = "geom contype and conaffinity".to_owned();
        let value = format!("{} kinds of bodies", coarse.count());
        report.add(place, subject, value, Effect::Approximated, why);
    }
    coarse.fewer().groups(touch)
}

/// Bodies in kinds, all of which touch the same others.
#[derive(Clone, Debug)]
struct Kinds {
    /// Of each body.
    kinds: Vec<usize>,
    /// A body of each kind.
    first: Vec<usize>,
    /// Bodies of each kind.
    sizes: Vec<usize>,
    /// Members of the last kind that differ, each with its bodies; none where each kind is of one sort.
    rest: Vec<(usize, usize)>,
}

impl Kinds {
    fn of<K: Ord>(count: usize, key: impl Fn(usize) -> K) -> Self {
        let mut numbers: BTreeMap<K, usize> = BTreeMap::new();
        let mut all = Self {
            kinds: Vec::with_capacity(count),
            first: Vec::new(),
            sizes: Vec::new(),
            rest: Vec::new(),
        };
        for body in 0..count {
            let next = numbers.len();
            let kind = *numbers.entry(key(body)).or_insert(next);
            if kind == next {
                all.first.push(body);
                all.sizes.push(0);
            }
            all.sizes[kind] += 1;
            all.kinds.push(kind);
        }
        all
    }

    const fn count(&self) -> usize {
        self.first.len()
    }

    /// Kinds that touch the same others are one.
    fn merged(self, touch: impl Fn(usize, usize) -> bool) -> Self {
        if self.count() > KINDS_MAX {
            return self;
        }
        let row = |one: &usize| -> Vec<bool> {
            let others = self.first.iter();
            others.map(|other| touch(*one, *other)).collect()
        };
        let rows: Vec<_> = self.first.iter().map(row).collect();
        Self::of(self.kinds.len(), |body| &rows[self.kinds[body]])
    }

    /// At most as many kinds as there are groups: the rarest are one.
    fn fewer(self) -> Self {
        if self.count() <= GROUPS_MAX {
            return self;
        }
        let mut order: Vec<_> = (0..self.count()).collect();
        order.sort_by_key(|kind| std::cmp::Reverse(self.sizes[*kind]));
        let (kept, rest) = order.split_at(GROUPS_MAX - 1);
        let mut place = vec![GROUPS_MAX - 1; self.count()];
        for (at, kind) in kept.iter().enumerate() {
            place[*kind] = at;
        }
        let of = |kinds: &[usize], all: &[usize]| kinds.iter().map(|kind| all[*kind]).collect();
        let mut first: Vec<_> = of(kept, &self.first);
        let mut sizes: Vec<_> = of(kept, &self.sizes);
        first.extend(rest.first().map(|kind| self.first[*kind]));
        sizes.push(rest.iter().map(|kind| self.sizes[*kind]).sum());
        Self {
            kinds: self.kinds.iter().map(|kind| place[*kind]).collect(),
            first,
            sizes,
            rest: (rest.iter())
                .map(|kind| (self.first[*kind], self.sizes[*kind]))
                .collect(),
        }
    }

    /// Bodies that stand for a kind, each with its number.
    fn members(&self, kind: usize) -> Vec<(usize, usize)> {
        match kind + 1 == self.count() && !self.rest.is_empty() {
            true => self.rest.clone(),
            false => vec![(self.first[kind], self.sizes[kind])],
        }
    }

    fn groups(&self, touch: impl Fn(usize, usize) -> bool) -> Vec<CollisionGroups> {
        let members: Vec<_> = (0..self.count()).map(|kind| self.members(kind)).collect();
        let touches = |one: usize, other: usize| {
            let (mut yes, mut all) = (0, 0);
            for (a, some) in &members[one] {
                for (b, others) in &members[other] {
                    all += some * others;
                    yes += usize::from(touch(*a, *b)) * some * others;
                }
            }
            2 * yes > all
        };
        let row = |one: usize| -> u32 {
            let others = (0..self.count()).filter(|other| touches(one, *other));
            others.map(|other| 1_u32 << other).sum()
        };
        let rows: Vec<_> = (0..self.count()).map(row).collect();
        let group = |kind: &usize| CollisionGroups {
            members: 1 << kind,
            touches: rows[*kind],
        };
        self.kinds.iter().map(group).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const fn bits(contype: u32, conaffinity: u32) -> Bits {
        Bits {
            contype,
            conaffinity,
        }
    }

    const fn touch(groups: &[CollisionGroups], a: usize, b: usize) -> bool {
        let (x, y) = (groups[a], groups[b]);
        x.members & y.touches != 0 && y.members & x.touches != 0
    }

    /// Pairs for which the groups say otherwise than bits and exclusions.
    fn wrong(
        bodies: &[Bits],
        apart: &BTreeSet<(usize, usize)>,
        groups: &[CollisionGroups],
    ) -> Vec<(usize, usize)> {
        let mut wrong = Vec::new();
        for a in 0..bodies.len() {
            for b in a + 1..bodies.len() {
                let right = bodies[a].touches(bodies[b]) && !apart.contains(&(a, b));
                if touch(groups, a, b) != right {
                    wrong.push((a, b));
                }
            }
        }
        wrong
    }

    #[test]
    fn groups_touch_exactly_where_bits_and_exclusions_say_so() {
        let bodies = [
            bits(1, 1),
            bits(1, 0),
            bits(0, 1),
            bits(2, 1),
            bits(1, 1),
            bits(1, 1),
        ];
        let apart = BTreeSet::from([(0, 4)]);
        let mut report = Report::default();
        let few = groups(&bodies, &apart, &Place::of("a"), &mut report);
        assert!(report.is_empty());
        assert_eq!(wrong(&bodies, &apart, &few), []);
        let other = CollisionGroups::ALL;
        assert!(
            few.iter()
                .all(|own| own.touches & other.members != 0 && own.members != 0)
        );
        let many = [bits(1, 1); 40];
        let apart = (0..38).map(|body| (body, body + 1)).collect();
        let few = groups(&many, &apart, &Place::of("a"), &mut report);
        assert!((0..38).all(|a| !touch(&few, a, a + 1) && touch(&few, a, 39)));
        assert_eq!(report.notes()[0].subject, "excluded contacts");
    }

    #[test]
    fn many_bodies_that_are_apart_from_the_same_ones_need_few_groups() {
        let bodies = [bits(1, 1); 200];
        // A robot's base of a hundred geoms, and arms of fifty parts each, which leave it alone.
        let apart = (0..100).flat_map(|base| (100..200).map(move |part| (base, part)));
        let apart: BTreeSet<_> = apart.collect();
        let mut report = Report::default();
        let few = groups(&bodies, &apart, &Place::of("a"), &mut report);
        assert!(report.is_empty());
        assert_eq!(wrong(&bodies, &apart, &few), []);
    }

    #[test]
    fn bits_of_more_kinds_than_there_are_groups_are_right_for_most_bodies_and_listed() {
        let mut report = Report::default();
        // Forty kinds, each of which touches its own and the next one, and the ground.
        let ring = |kind: u32| bits(1 << (kind % 20), 1 << ((kind + 1 + kind / 20) % 20));
        let mut bodies: Vec<_> = (0..40).map(ring).collect();
        bodies.extend([bits(u32::MAX, u32::MAX); 60]);
        let none = BTreeSet::new();
        let few = groups(&bodies, &none, &Place::of("a"), &mut report);
        let [note] = report.notes() else {
            panic!("one note: {report:?}");
        };
        assert_eq!(note.subject, "geom contype and conaffinity");
        assert!(note.value.ends_with("kinds of bodies"), "{note}");
        // All rest on the ground, as each of them should.
        assert!((0..40).all(|body| (40..100).all(|ground| touch(&few, body, ground))));
        let wrong = wrong(&bodies, &none, &few).len();
        let touching = (0..100).flat_map(|a| (a + 1..100).map(move |b| (a, b)));
        let touching = touching.filter(|(a, b)| bodies[*a].touches(bodies[*b]));
        assert!(wrong * 20 < touching.count(), "{wrong} pairs are wrong");
    }
}
