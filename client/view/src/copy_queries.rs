//! Queries on a client's own copy: the bodies where a view shows them.
//!
//! Answers are those that the server would give if its bodies had the poses of the view. Nothing is sent, and nothing of
//! the view changes. A refresh looks at each body, and works for those that moved. It does nothing if neither the view
//! nor the scene has changed since the last one.

use std::collections::BTreeMap;
use std::sync::Arc;

use parry3d::math::Pose;
use parry3d::partitioning::{Bvh, BvhWorkspace};
use parry3d::query::details::NormalConstraints;
use parry3d::shape::{CompositeShape, Shape as Solid, SharedShape};
use rhumb_protocol::scene::{
    Answer, BodyDesc, Hit, Invalid, Query, QueryCandidate, QueryFilter, Shape, ShapeId,
};
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::BodyId;
use rhumb_solids::{SearchedBodies, SolidPart};

use crate::live_view::LiveView;
use crate::moment::ShownPose;

/// Answers queries on the bodies of one view and its session; another pair needs another one.
#[derive(Default)]
pub struct CopyQueries {
    solids: BTreeMap<ShapeId, CopiedShape>,
    bodies: BTreeMap<BodyId, CopiedBody>,
    /// By the number of a leaf of the tree.
    parts: Vec<Option<CopiedPart>>,
    free: Vec<u32>,
    tree: Bvh,
    workspace: BvhWorkspace,
    source: Option<RefreshSource>,
}

/// The state of the view and the copies at a refresh.
#[derive(Clone, Copy, PartialEq, Eq)]
struct RefreshSource {
    refreshes: u64,
    /// The sum of those of the copies.
    revision: u64,
}

/// The answer of a copy to a query, and how far it may be off.
#[derive(Clone, Debug, PartialEq)]
pub struct CopyAnswer {
    /// The same as of a server whose bodies are where the view shows them.
    pub answer: Answer,
    /// One for each body of the answer, in its order: every point of the body, and so of the surface that was found, is
    /// within this distance of its true place. A query that passes an edge nearer than that may find another body than
    /// the server would.
    ///
    /// The bounds are those of the view: see [`View::error_bound`](crate::View::error_bound).
    pub bounds: Vec<ErrorBound>,
}

/// A shape with its solid; `None` for one that the library cannot make, which is then not found.
struct CopiedShape {
    shape: Shape,
    parts: Option<Arc<[SolidPart]>>,
}

struct CopiedBody {
    desc: BodyDesc,
    solid: Arc<[SolidPart]>,
    shown: ShownPose,
    /// Leaves of the tree.
    leaves: Vec<u32>,
}

struct CopiedPart {
    desc: BodyDesc,
    at: Pose,
    solid: SharedShape,
}

impl CopyQueries {
    /// Takes over the bodies of a view and their shapes, as the copies that the view shows have them. Does nothing if
    /// neither has changed since the last call, or while the session has no replica.
    pub fn refresh(&mut self, live_view: &LiveView, session: &ClientSession) {
        let (view, Some(replica)) = (live_view.view(), session.replica()) else {
            return;
        };
        let of_cells = session.cells().map(|(_, copy)| copy.revision());
        let source = RefreshSource {
            refreshes: view.refreshes(),
            revision: of_cells.fold(replica.revision(), u64::wrapping_add),
        };
        if self.source.replace(source) == Some(source) {
            return;
        }
        self.forget_shapes(replica);
        let gone = |id: &BodyId| view.place(*id).is_none();
        let removed: Vec<_> = self.bodies.keys().copied().filter(gone).collect();
        for id in removed {
            self.remove(id);
        }
        for (place, id) in view.ids().iter().enumerate() {
            let shown = ShownPose {
                position: view.positions()[place],
                rotation: view.rotations()[place],
            };
            let desc = live_view.body(session, *id).filter(|desc| desc.enabled);
            let solid = desc.and_then(|desc| Some((desc, self.solid(desc.shape, replica)?)));
            match solid.filter(|_| shown.position.is_finite()) {
                Some((desc, solid)) => self.put(desc, solid, shown),
                None => self.remove(*id),
            }
        }
        self.tree.refit(&mut self.workspace);
        self.tree.optimize_incremental(&mut self.workspace);
    }

    /// Answers queries as of the last refresh, with the bounds of the same view.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number of a query; then none is answered.
    pub fn answer(
        &self,
        queries: &[Query],
        live_view: &LiveView,
        session: &ClientSession,
    ) -> Result<Vec<CopyAnswer>, Invalid> {
        queries.iter().try_for_each(Query::check)?;
        let answers = queries.iter().map(|query| {
            let answer = rhumb_solids::answer(self, query);
            let unknown = live_view.view().unknown();
            let bound = |id: &BodyId| live_view.error_bound(session, *id).unwrap_or(unknown);
            let bounds = match &answer {
                Answer::Hits(hits) => hits.iter().map(|Hit { body, .. }| bound(body)).collect(),
                Answer::Bodies(bodies) => bodies.iter().map(bound).collect(),
            };
            CopyAnswer { answer, bounds }
        });
        Ok(answers.collect())
    }

    /// Drops solids whose shape is gone or another one now; their bodies are put anew.
    fn forget_shapes(&mut self, replica: &Replica) {
        self.solids.retain(|id, solid| {
            let same = replica.shape(*id).filter(|shape| **shape == solid.shape);
            if let Some(shape) = same {
                // An equal shape of another replica has arrays of its own. With those the next comparison is short.
                solid.shape = shape.clone();
            }
            same.is_some()
        });
    }

    fn solid(&mut self, id: ShapeId, replica: &Replica) -> Option<Arc<[SolidPart]>> {
        if let Some(known) = self.solids.get(&id) {
            return known.parts.clone();
        }
        let shape = replica.shape(id)?.clone();
        let parts = rhumb_solids::parts(&shape).map(Arc::from);
        let made = CopiedShape {
            shape,
            parts: parts.clone(),
        };
        self.solids.insert(id, made);
        parts
    }

    fn put(&mut self, desc: BodyDesc, solid: Arc<[SolidPart]>, shown: ShownPose) {
        let known = self.bodies.get(&desc.id);
        let same = |body: &&CopiedBody| body.desc == desc && Arc::ptr_eq(&body.solid, &solid);
        match known.filter(same) {
            Some(body) if body.shown == shown => return,
            Some(_) => {}
            None => {
                self.remove(desc.id);
                self.insert(desc, solid);
            }
        }
        let Some(body) = self.bodies.get_mut(&desc.id) else {
            return;
        };
        body.shown = shown;
        let pose = rhumb_solids::pose(shown.position, shown.rotation);
        for (leaf, within) in body.leaves.iter().zip(body.solid.iter()) {
            if let Some(Some(part)) = self.parts.get_mut(*leaf as usize) {
                part.at = pose * within.at;
                let around = within.shape.compute_aabb(&part.at);
                self.tree.insert_or_update_partially(around, *leaf, 0.0);
            }
        }
    }

    /// Adds a body that is nowhere yet.
    fn insert(&mut self, desc: BodyDesc, solid: Arc<[SolidPart]>) {
        let mut leaves = Vec::with_capacity(solid.len());
        for part in solid.iter() {
            let part = CopiedPart {
                desc,
                at: Pose::IDENTITY,
                solid: part.shape.clone(),
            };
            match self.free.pop() {
                Some(leaf) => {
                    self.parts[leaf as usize] = Some(part);
                    leaves.push(leaf);
                }
                None => {
                    leaves.push(self.parts.len() as u32);
                    self.parts.push(Some(part));
                }
            }
        }
        let body = CopiedBody {
            desc,
            solid,
            shown: ShownPose::NOWHERE,
            leaves,
        };
        self.bodies.insert(desc.id, body);
    }

    fn remove(&mut self, id: BodyId) {
        let Some(body) = self.bodies.remove(&id) else {
            return;
        };
        for leaf in body.leaves {
            self.tree.remove(leaf);
            self.parts[leaf as usize] = None;
            self.free.push(leaf);
        }
    }
}

impl std::fmt::Debug for CopyQueries {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CopyQueries")
            .field("bodies", &self.bodies.len())
            .finish_non_exhaustive()
    }
}

/// The parts that one query considers.
struct Considered<'a> {
    copy: &'a CopyQueries,
    filter: &'a QueryFilter,
    before: &'a [BodyId],
}

impl CompositeShape for Considered<'_> {
    fn map_part_at(
        &self,
        part: u32,
        find: &mut dyn FnMut(Option<&Pose>, &dyn Solid, Option<&dyn NormalConstraints>),
    ) {
        let Some(Some(part)) = self.copy.parts.get(part as usize) else {
            return;
        };
        let candidate = QueryCandidate::of(&part.desc);
        if self.filter.takes(&candidate) && !self.before.contains(&candidate.id) {
            find(Some(&part.at), &*part.solid.0, None);
        }
    }

    fn bvh(&self) -> &Bvh {
        &self.copy.tree
    }
}

impl SearchedBodies for CopyQueries {
    fn search(
        &self,
        filter: &QueryFilter,
        before: &[BodyId],
        find: &mut dyn FnMut(&dyn CompositeShape),
    ) {
        find(&Considered {
            copy: self,
            filter,
            before,
        });
    }

    fn body_of(&self, part: u32) -> Option<BodyId> {
        let part = self.parts.get(part as usize)?.as_ref();
        part.map(|part| part.desc.id)
    }

    fn parts_of(&self, body: BodyId) -> Vec<SolidPart> {
        let Some(own) = self.bodies.get(&body) else {
            return Vec::new();
        };
        if !QueryFilter::ALL.takes(&QueryCandidate::of(&own.desc)) {
            return Vec::new();
        }
        let leaves = own.leaves.iter();
        let parts = leaves.filter_map(|leaf| self.parts.get(*leaf as usize)?.as_ref());
        let parts = parts.map(|part| SolidPart {
            at: part.at,
            shape: part.solid.clone(),
        });
        parts.collect()
    }
}
