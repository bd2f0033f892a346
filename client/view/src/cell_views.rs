//! The views of the cells that a member takes, all at one moment.
//!
//! Each cell has a view of its own; this knows which body of the scene each place shows. A body that crosses is in the old
//! cell before the tick of its crossing and in the new one from it on. Where the news of the old cell are late, both have
//! it: the newer track counts. A cell that was taken after the moment shown gives way. Invariant: each body has one place.

use std::collections::BTreeMap;

use rhumb_protocol::scene::Cell;
use rhumb_protocol::session::{ClientSession, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Tick};

use crate::view::{RenderParams, View};

/// The views of a member's cells at one moment.
#[derive(Debug, Default)]
pub struct CellViews {
    cells: BTreeMap<Cell, CellView>,
    /// By index of the scene.
    bodies: Vec<Option<Shown>>,
}

/// A body's place in the view of a cell.
#[derive(Clone, Copy, Debug)]
pub struct CellPlace<'v> {
    /// The body, by its id in the scene.
    pub id: BodyId,
    /// The cell.
    pub cell: Cell,
    /// The view of the cell.
    pub view: &'v View,
    /// The body's place in the arrays of the view.
    pub place: usize,
}

/// Where a body is shown.
#[derive(Clone, Copy, Debug)]
struct Shown {
    id: BodyId,
    cell: Cell,
    place: u32,
    /// How far what the cell says of it counts.
    rank: Rank,
}

/// How far a cell counts that shows a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    /// Its copy begins after the moment shown: the body may have been elsewhere then.
    BeginsLater,
    /// It has a track of this origin.
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

impl CellViews {
    /// Computes the views of a moment. Cells that the member has given up are gone.
    pub fn refresh(&mut self, session: &mut ClientSession, render_params: &RenderParams) {
        for shown in self.cells.values().flat_map(|of| &of.names) {
            self.bodies[shown.1.index() as usize] = None;
        }
        let mut before = std::mem::take(&mut self.cells);
        for (cell, copy) in session.cells_mut() {
            let mut of_cell = before.remove(&cell).unwrap_or_default();
            of_cell.refresh(copy, render_params);
            let names = of_cell.names.iter().enumerate();
            for (place, (local, id)) in names {
                let track = copy.stream().track(*local);
                let rank = match copy.stream().start() > render_params.at.tick {
                    true => Rank::BeginsLater,
                    false => Rank::Since(track.map_or(Tick::ZERO, |track| track.origin)),
                };
                let shown = Shown {
                    id: *id,
                    cell,
                    place: place as u32,
                    rank,
                };
                show(&mut self.bodies, shown);
            }
            self.cells.insert(cell, of_cell);
        }
    }

    /// The cells with their views, in order. Ids in them are those of the cell: see [`Self::bodies`].
    pub fn cells(&self) -> impl Iterator<Item = (Cell, &View)> {
        self.cells.iter().map(|(cell, of)| (*cell, &of.view))
    }

    /// All bodies, each once, in the order of their indices in the scene.
    pub fn bodies(&self) -> impl Iterator<Item = CellPlace<'_>> {
        let shown = self.bodies.iter().flatten();
        shown.filter_map(|shown| self.place_of(shown))
    }

    /// The place of a body; `None` for one that is in no taken cell.
    #[must_use]
    pub fn place(&self, id: BodyId) -> Option<CellPlace<'_>> {
        let shown = self.bodies.get(id.index() as usize)?.as_ref()?;
        self.place_of(shown).filter(|place| place.id == id)
    }

    /// Bound on the error of the pose of a body: see [`View::error_bound`]. `None` for a body that is in no taken cell: where
    /// it is, or whether it is, is not known.
    #[must_use]
    pub fn error_bound(&self, session: &ClientSession, id: BodyId) -> Option<ErrorBound> {
        let CellPlace {
            cell, view, place, ..
        } = self.place(id)?;
        let local = view.ids()[place];
        let copy = session.cells().find(|(at, _)| *at == cell);
        view.error_bound(copy.map(|(_, copy)| copy.stream()), local)
    }

    fn place_of(&self, shown: &Shown) -> Option<CellPlace<'_>> {
        Some(CellPlace {
            id: shown.id,
            cell: shown.cell,
            view: &self.cells.get(&shown.cell)?.view,
            place: shown.place as usize,
        })
    }
}

impl CellView {
    fn refresh(&mut self, copy: &mut Replica, render_params: &RenderParams) {
        let stream = copy.stream().stream().0;
        if self.stream.replace(stream) != Some(stream) {
            self.view.begin_anew();
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

/// Notes where a body is shown, unless another cell has a newer track of it.
fn show(bodies: &mut Vec<Option<Shown>>, shown: Shown) {
    let index = shown.id.index() as usize;
    if index >= bodies.len() {
        bodies.resize(index + 1, None);
    }
    let at = &mut bodies[index];
    if at.is_none_or(|before| before.rank < shown.rank) {
        *at = Some(shown);
    }
}
