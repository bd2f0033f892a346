//! Groups the updated bodies of a tick into islands of touching bodies.
//!
//! The updates of an island go together, so that all or none arrive. Used only for ticks with several packets, and not
//! part of the protocol. Bodies count as touching when their bounding spheres overlap; contacts and joints of any
//! engine lie within that. Two bodies that touch only a third body without an update are not joined.

use alloc::vec::Vec;

use rhumb_reckoning::Tick;

use super::Publisher;
use super::packing::sort_by_alias;
use crate::packet::Update;

/// With more updates than this, islands are not kept together: at such a tick the whole scene moves, and its bodies
/// form one island.
const ISLAND_UPDATES_MAX: usize = 2_000;
/// Factor on radii: spheres this much larger count as touching.
const REACH: f64 = 1.1;

/// The bounding sphere of an updated body, with its position among the updates.
#[derive(Clone, Copy, Debug)]
struct BoundingSphere {
    place: usize,
    centre: [f64; 3],
    radius: f64,
}

/// A union-find over positions: each points at a lower one of its own island, or at itself.
#[derive(Debug)]
struct UnionFind {
    places: Vec<usize>,
    /// Whether any two were joined.
    joined: bool,
}

impl UnionFind {
    /// Every position is an island of its own.
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

/// The axis along which spheres lie farthest apart: few overlap along it, as the bodies of a wall along its length.
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

/// Joins touching spheres.
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
    /// Sorts the updates of a tick by island and returns the number of updates in each. Within an island aliases rise,
    /// except that updates with a parent reference come last.
    pub(super) fn sort_by_island(&self, tick: Tick, updates: &mut [Update]) -> Vec<usize> {
        if !self.features.islands {
            updates.sort_unstable_by_key(|update| (update.payload.names_parent(), update.alias));
            return alloc::vec![1; updates.len()];
        }
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
        // Updates are large; their sort keys are small.
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

    /// Joins an update that refers to a parent with the parent's update, if there is one, because it cannot be applied
    /// without it.
    fn join_attached(&self, updates: &[Update], union: &mut UnionFind) {
        let aliases = self.alias_table.aliases();
        for &(parent, body) in &self.attached {
            let place = |index: u32| {
                let alias = aliases.of(index)?;
                updates
                    .binary_search_by_key(&alias, |update| update.alias)
                    .ok()
            };
            if let (Some(child), Some(parent_candidate)) = (place(body), place(parent)) {
                union.join(child, parent_candidate);
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
    fn spheres_that_touch_are_one_island_in_any_arrangement() {
        let row = |x: f64| ([x, 0.0, 0.0], 0.5);
        assert_eq!(islands(&[row(3.0), row(0.0), row(1.0), row(2.0)]), [0; 4]);
        let apart = [row(0.0), ([0.0, 1.1, 0.0], 0.5), row(0.9)];
        assert_eq!(islands(&apart), [0, 1, 0]);
        let bridged = [row(0.0), row(9.0), ([4.5, 3.0, 0.0], 6.0)];
        assert_eq!(islands(&bridged), [0; 3]);
        assert_eq!(islands(&[]), [0; 0]);
        // Walls across each axis.
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
