//! Which of the bodies that are spoken of at a tick touch.
//!
//! Their updates go together, so that they arrive all or none.
//!
//! The publisher's own affair, and asked for only where a tick takes several packets. Bodies touch here when the spheres
//! around them do: contacts and joints of any engine lie within that. Bodies that touch only by way of one that nothing
//! is said of are not joined.

use alloc::vec::Vec;

use rhumb_reckoning::Tick;

use super::Publisher;
use super::packing::sort_by_alias;
use crate::packet::Update;

/// Beyond so many updates nobody is kept together: a tick that says so much of all bodies is a pit's, whose bodies all
/// touch.
const ISLAND_UPDATES_MAX: usize = 2_000;
/// Balls touch when they would if they were so much larger.
const REACH: f64 = 1.1;

/// A body that is spoken of, by its place among the updates.
#[derive(Clone, Copy, Debug)]
struct BoundingSphere {
    place: usize,
    centre: [f64; 3],
    radius: f64,
}

/// Which places are of one island, as far as is known: each points at a lower one of its own, or at itself.
#[derive(Debug)]
struct UnionFind {
    places: Vec<usize>,
    /// Whether any were joined.
    joined: bool,
}

impl UnionFind {
    /// Each an island of its own.
    fn of(places: usize) -> Self {
        Self {
            places: (0..places).collect(),
            joined: false,
        }
    }

    fn root(&mut self, mut place: usize) -> usize {
        while self.places[place] != place {
            self.places[place] = self.places[self.places[place]];
            place = self.places[place];
        }
        place
    }

    fn join(&mut self, one: usize, other: usize) {
        let (one, other) = (self.root(one), self.root(other));
        self.places[one.max(other)] = one.min(other);
        self.joined = true;
    }
}

/// The axis along which spheres lie farthest apart: in a wall few overlap along it, and all across.
fn longest_axis(spheres: &[BoundingSphere]) -> usize {
    let extent = |axis: usize| {
        let along = spheres.iter().map(|sphere| sphere.centre[axis]);
        along.clone().fold(f64::NEG_INFINITY, f64::max) - along.fold(f64::INFINITY, f64::min)
    };
    let (mut longest, mut most) = (0, extent(0));
    for axis in 1..3 {
        let here = extent(axis);
        if here > most {
            (longest, most) = (axis, here);
        }
    }
    longest
}

/// Joins spheres that touch.
fn join_touching(mut spheres: Vec<BoundingSphere>, union: &mut UnionFind) {
    let axis = longest_axis(&spheres);
    let least = |sphere: &BoundingSphere| sphere.centre[axis] - sphere.radius;
    spheres.sort_by(|a, b| least(a).total_cmp(&least(b)));
    for (at, one) in spheres.iter().enumerate() {
        let end = one.centre[axis] + one.radius;
        for other in spheres[at + 1..]
            .iter()
            .take_while(|other| least(other) <= end)
        {
            let far2: f64 = (0..3)
                .map(|i| (one.centre[i] - other.centre[i]) * (one.centre[i] - other.centre[i]))
                .sum();
            let reach = one.radius + other.radius;
            if far2 <= reach * reach {
                union.join(one.place, other.place);
            }
        }
    }
}

impl Publisher {
    /// Sorts the updates of a tick by islands, the aliases of each rising but for what names a parent, which comes last in
    /// its island; returns how many updates each has.
    pub(super) fn sort_by_island(&self, tick: Tick, updates: &mut [Update]) -> Vec<usize> {
        sort_by_alias(updates);
        let aliases = self.alias_table.aliases();
        let index = |update: &Update| update.body.or_else(|| aliases.body(update.alias));
        let mut union = UnionFind::of(updates.len());
        if updates.len() <= ISLAND_UPDATES_MAX {
            let mut spheres = Vec::with_capacity(updates.len());
            for (place, update) in updates.iter().enumerate() {
                let Some(index) = index(update) else {
                    continue;
                };
                let Some(slot) = self.tracks.slot(index) else {
                    continue;
                };
                spheres.push(BoundingSphere {
                    place,
                    centre: self
                        .tracks
                        .predicted_motion((index, slot), tick)
                        .pose()
                        .position
                        .to_array(),
                    radius: self.tracks.radius(slot).metres() * REACH,
                });
            }
            join_touching(spheres, &mut union);
        }
        self.join_attached(updates, &mut union);
        if !union.joined {
            return alloc::vec![1; updates.len()];
        }
        // Updates are large: what they are sorted by is not.
        let mut order: Vec<(usize, bool, usize)> = updates
            .iter()
            .enumerate()
            .map(|(place, update)| (union.root(place), update.payload.names_parent(), place))
            .collect();
        order.sort_unstable();
        let sizes = order.chunk_by(|a, b| a.0 == b.0).map(<[_]>::len).collect();
        let sorted: Vec<Update> = order.iter().map(|(.., place)| updates[*place]).collect();
        updates.copy_from_slice(&sorted);
        sizes
    }

    /// Joins what builds on another body's track to that body, if it is spoken of too: the one cannot be read without the
    /// other.
    fn join_attached(&self, updates: &[Update], union: &mut UnionFind) {
        let aliases = self.alias_table.aliases();
        for &(parent, body) in &self.attached {
            let place = |index: u32| {
                let alias = aliases.of(index)?;
                updates
                    .binary_search_by_key(&alias, |update| update.alias)
                    .ok()
            };
            if let (Some(held), Some(parent_candidate)) = (place(body), place(parent)) {
                union.join(held, parent_candidate);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn islands(spheres: &[([f64; 3], f64)]) -> Vec<usize> {
        let mut union = UnionFind::of(spheres.len());
        let sphere = |(place, (centre, radius)): (usize, &([f64; 3], f64))| BoundingSphere {
            place,
            centre: *centre,
            radius: *radius,
        };
        join_touching(spheres.iter().enumerate().map(sphere).collect(), &mut union);
        (0..spheres.len()).map(|place| union.root(place)).collect()
    }

    #[test]
    fn balls_that_touch_are_one_island_however_they_do() {
        let row = |x: f64| ([x, 0.0, 0.0], 0.5);
        assert_eq!(islands(&[row(3.0), row(0.0), row(1.0), row(2.0)]), [0; 4]);
        let apart = [row(0.0), ([0.0, 1.1, 0.0], 0.5), row(0.9)];
        assert_eq!(islands(&apart), [0, 1, 0]);
        let bridged = [row(0.0), row(9.0), ([4.5, 3.0, 0.0], 6.0)];
        assert_eq!(islands(&bridged), [0; 3]);
        assert_eq!(islands(&[]), [0; 0]);
        // Of walls across each axis.
        for axis in 0..3 {
            let sphere = |along: f64| {
                let mut centre = [0.0; 3];
                centre[axis] = along;
                (centre, 0.5)
            };
            let wall = [sphere(30.0), sphere(0.0), sphere(0.9), sphere(30.8)];
            assert_eq!(islands(&wall), [0, 1, 1, 0], "{axis}");
        }
    }
}
