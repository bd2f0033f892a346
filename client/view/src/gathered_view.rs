//! The view of a member by cells: all that it takes, each body once.
//!
//! Each cell has a view of its own, whose ids are the cell's; the poses that they show are gathered in one view, by the ids of
//! the scene. A body that crosses is in the old cell before the tick of its crossing and in the new one from it on. Where the
//! news of the old cell are late, both have it: the newer track counts. A cell that was taken after the moment shown gives way.
//! A cell that an earlier connection of the session had stands still until its snapshot comes, and gives way to all.
//! Invariant: the body of each place of the view has its source at the same place.

use std::collections::BTreeMap;

use rhumb_protocol::scene::Cell;
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_reckoning::{BodyId, Tick};

use crate::moment::{Crossing, RenderTime, ShownPose};
use crate::view::{RenderParams, View};

/// The views of the cells, and the view of all.
#[derive(Debug, Default)]
pub(crate) struct GatheredView {
    view: View,
    /// By place in the view.
    sources: Vec<BodySource>,
    cells: BTreeMap<Cell, CellView>,
}

/// The source of one body's pose.
#[derive(Clone, Copy, Debug)]
struct BodySource {
    /// The cell; `None` for what is in no cell.
    cell: Option<Cell>,
    /// The body's place in the view of the cell.
    place: u32,
    /// Of two sources of one body, that of the higher rank counts.
    rank: Rank,
}

/// Rank of a source, the lowest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    /// The source is of an earlier view.
    Before,
    /// The source is of an earlier connection.
    Former,
    /// The copy begins after the moment shown: the body may have been elsewhere then.
    BeginsLater,
    /// The track of the body has this origin.
    Since(Tick),
}

#[derive(Debug, Default)]
struct CellView {
    view: View,
    /// The stream of the copy that it shows.
    stream: Option<u32>,
    /// By place: the body's id in the cell and in the scene.
    names: Vec<(BodyId, BodyId)>,
}

impl GatheredView {
    /// Computes the views of a moment. `of_scene`: the view of what is in no cell, of the same moment. Cells that the member
    /// has given up are gone; one whose snapshot a resumed session has not got yet stays as it was.
    pub(crate) fn refresh(
        &mut self,
        of_scene: &View,
        session: &mut ClientSession,
        render_params: &RenderParams,
    ) {
        self.view.begin_gathering(render_params);
        for source in &mut self.sources {
            source.rank = Rank::Before;
        }
        if let Some(copy) = session.replica() {
            let bodies = of_scene.ids().iter().map(|id| (*id, *id));
            self.gather(None, bodies, |id| rank(copy, id, render_params));
        }
        let mut before = std::mem::take(&mut self.cells);
        let mut cells = BTreeMap::new();
        for (cell, copy) in session.cells_mut() {
            let mut of_cell = before.remove(&cell).unwrap_or_default();
            of_cell.refresh(copy, render_params);
            let names = of_cell.names.iter().copied();
            self.gather(Some(cell), names, |id| rank(copy, id, render_params));
            cells.insert(cell, of_cell);
        }
        for (cell, of_cell) in before {
            if session.awaits_cell(cell) {
                let names = of_cell.names.iter().copied();
                self.gather(Some(cell), names, |_| Rank::Former);
                cells.insert(cell, of_cell);
            }
        }
        self.cells = cells;
        self.give_up_others();
        self.copy_poses(of_scene, session, render_params);
    }

    /// Adds the bodies of a source, by their ids there and in the scene. A body that has a source keeps the one of higher rank.
    fn gather(
        &mut self,
        cell: Option<Cell>,
        bodies: impl Iterator<Item = (BodyId, BodyId)>,
        rank: impl Fn(BodyId) -> Rank,
    ) {
        for (place, (local, id)) in (0..).zip(bodies) {
            let rank = rank(local);
            let source = BodySource { cell, place, rank };
            match self.view.place_of(id.index()) {
                Some(known) if self.sources[known].rank >= rank => {}
                Some(known) if self.view.ids()[known] == id => self.sources[known] = source,
                known => {
                    known.into_iter().for_each(|known| self.give_up(known));
                    self.view.insert(id);
                    self.sources.push(source);
                }
            }
        }
    }

    /// Removes the bodies that no source has.
    fn give_up_others(&mut self) {
        for place in (0..self.sources.len()).rev() {
            if self.sources[place].rank == Rank::Before {
                self.give_up(place);
            }
        }
    }

    fn give_up(&mut self, place: usize) {
        self.view.remove(self.view.ids()[place].index());
        self.sources.swap_remove(place);
    }

    /// Copies the pose of each body from its source. Between two ticks, a crossing body moves from one cell's pose to the other's.
    fn copy_poses(&mut self, of_scene: &View, session: &ClientSession, params: &RenderParams) {
        for place in 0..self.sources.len() {
            let source = self.sources[place];
            let crossing = self.crossing(session, place, params.at);
            let moment = crossing.and_then(|of| of.motion(params.at, params.step));
            if let Some(motion) = moment.and_then(|of| of.motion(params.at)) {
                self.view.show_as_it_is(place, &motion);
                continue;
            }
            let from = match source.cell {
                None => Some(of_scene),
                Some(cell) => self.cells.get(&cell).map(|of| &of.view),
            };
            if let Some(from) = from {
                self.view.copy(place, from, source.place as usize);
            }
        }
    }

    /// The crossing of a body at a moment between two ticks, if the body has left its cell by the later tick.
    fn crossing<'s>(
        &self,
        session: &'s ClientSession,
        place: usize,
        at: RenderTime,
    ) -> Option<Crossing<'s>> {
        let source = self.sources[place];
        let cell = source.cell.filter(|_| at.fraction > 0.0)?;
        let from = session.cell(cell)?.stream();
        if !from.is_changing() {
            return None;
        }
        let local = self.cells.get(&cell)?.view.ids()[source.place as usize];
        let (to, there) = session.copy_of(self.view.ids()[place])?;
        let has_left = from.has_left(local, at.tick.next());
        has_left.then_some(Crossing {
            from: (from, local),
            to: (to.stream(), there),
        })
    }

    /// Prepares the next refresh for another connection of the session.
    pub(crate) fn begin_anew(&mut self) {
        for of_cell in self.cells.values_mut() {
            of_cell.stream = None;
        }
    }

    /// All bodies at the moment of the last refresh.
    pub(crate) const fn view(&self) -> &View {
        &self.view
    }

    /// True if a bound was asked for since the last call.
    pub(crate) fn take_bounds_asked(&mut self) -> bool {
        let each = self.cells.values_mut();
        each.fold(false, |is_asked, of| of.view.take_bounds_asked() | is_asked)
    }

    /// The cell of a body.
    pub(crate) fn cell_of(&self, id: BodyId) -> Option<Cell> {
        self.sources[self.view.place(id)?].cell
    }

    /// Bound on the error of the pose of a body.
    pub(crate) fn error_bound(
        &self,
        of_scene: &View,
        session: &ClientSession,
        id: BodyId,
    ) -> Option<ErrorBound> {
        let (Some(of_cell), place) = self.source(id)? else {
            return of_scene.error_bound(session.replica().map(Replica::stream), id);
        };
        let (view, local) = (&of_cell.view, of_cell.view.ids()[place]);
        let stream = self.copy_of(session, id).map(|(copy, _)| copy.stream());
        let bound = view.error_bound(stream, local);
        let at = self.view.time()?;
        let has_left = |stream: &Subscriber| stream.has_left(local, at.tick.next());
        if at.fraction == 0.0 || !stream.is_some_and(has_left) {
            return bound;
        }
        let place = self.view.place(id)?;
        let shown = ShownPose {
            position: self.view.positions()[place],
            rotation: self.view.rotations()[place],
        };
        let crossing = self.crossing(session, place, at);
        let crossing = crossing.map(|of| of.bound(&shown, at, self.view.step()));
        // If no other cell has the body, its way is unknown.
        Some(crossing.unwrap_or_else(|| self.view.unknown()))
    }

    /// The copy that a body is shown of, and the body's id there. `None` if it has gone since.
    pub(crate) fn copy_of<'s>(
        &self,
        session: &'s ClientSession,
        id: BodyId,
    ) -> Option<(&'s Replica, BodyId)> {
        let (Some(of_cell), place) = self.source(id)? else {
            return Some((session.replica()?, id));
        };
        let local = of_cell.view.ids()[place];
        let copy = session.cell(self.cell_of(id)?)?;
        // In a cell that was given up and taken again, the same id may be another body.
        (copy.id_in_scene(local) == Some(id)).then_some((copy, local))
    }

    /// The view of the cell that a body is shown of, and its place there.
    fn source(&self, id: BodyId) -> Option<(Option<&CellView>, usize)> {
        let source = self.sources[self.view.place(id)?];
        let of_cell = source.cell.and_then(|cell| self.cells.get(&cell));
        Some((of_cell, source.place as usize))
    }
}

/// Rank of a copy for a body that it shows at a moment.
fn rank(copy: &Replica, local: BodyId, render_params: &RenderParams) -> Rank {
    let stream = copy.stream();
    match stream.start() > render_params.at.tick {
        true => Rank::BeginsLater,
        false => Rank::Since(stream.track(local).map_or(Tick::ZERO, |track| track.origin)),
    }
}

impl CellView {
    fn refresh(&mut self, copy: &mut Replica, render_params: &RenderParams) {
        let stream = copy.stream().stream().0;
        if self.stream.replace(stream) != Some(stream) {
            self.view.begin_anew();
            self.names.clear();
        }
        self.view.refresh(copy.stream_mut(), render_params);
        let ids = self.view.ids();
        self.names.truncate(ids.len());
        for (place, local) in ids.iter().enumerate() {
            match self.names.get_mut(place) {
                Some((before, _)) if before == local => {}
                known => {
                    let name = (*local, copy.id_in_scene(*local).unwrap_or(*local));
                    match known {
                        Some(known) => *known = name,
                        None => self.names.push(name),
                    }
                }
            }
        }
    }
}
