//! Bodies at their poses, as one set that queries search.
//!
//! For engines without such queries of their own. A set is made anew when bodies have moved; it does not follow them.

use glam::{Quat, Vec3};
use parry3d::math::Pose;
use parry3d::partitioning::{Bvh, BvhBuildStrategy};
use parry3d::query::details::NormalConstraints;
use parry3d::shape::{CompositeShape, Shape, SharedShape};
use rhumb_protocol::scene::{QueryCandidate, QueryFilter};
use rhumb_reckoning::BodyId;

use crate::parts::{SolidPart, pose};
use crate::queries::SearchedBodies;

/// Bodies at their poses.
#[derive(Default)]
pub struct PlacedBodies {
    /// By the number of a leaf of the tree.
    parts: Vec<PlacedPart>,
    tree: Bvh,
}

struct PlacedPart {
    body: QueryCandidate,
    at: Pose,
    solid: SharedShape,
}

impl PlacedBodies {
    /// The set of these bodies: what a filter reads of each, its pose in the world, and its parts.
    pub fn new<'a>(
        bodies: impl IntoIterator<Item = (QueryCandidate, (Vec3, Quat), &'a [SolidPart])>,
    ) -> Self {
        let mut parts = Vec::new();
        for (body, (position, rotation), of_body) in bodies {
            let at = pose(position, rotation);
            parts.extend(of_body.iter().map(|part| PlacedPart {
                body,
                at: at * part.at,
                solid: part.shape.clone(),
            }));
        }
        let around = |part: &PlacedPart| part.solid.compute_aabb(&part.at);
        let boxes: Vec<_> = parts.iter().map(around).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        Self { parts, tree }
    }
}

/// The parts that one query considers.
struct Considered<'a> {
    placed: &'a PlacedBodies,
    filter: &'a QueryFilter,
    before: &'a [BodyId],
}

impl CompositeShape for Considered<'_> {
    fn map_part_at(
        &self,
        part: u32,
        find: &mut dyn FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>),
    ) {
        let Some(part) = self.placed.parts.get(part as usize) else {
            return;
        };
        if self.filter.takes(&part.body) && !self.before.contains(&part.body.id) {
            find(Some(&part.at), &*part.solid.0, None);
        }
    }

    fn bvh(&self) -> &Bvh {
        &self.placed.tree
    }
}

impl SearchedBodies for PlacedBodies {
    fn search(
        &self,
        filter: &QueryFilter,
        before: &[BodyId],
        find: &mut dyn FnMut(&dyn CompositeShape),
    ) {
        find(&Considered {
            placed: self,
            filter,
            before,
        });
    }

    fn body_of(&self, part: u32) -> Option<BodyId> {
        let part = self.parts.get(part as usize)?;
        Some(part.body.id)
    }
}
