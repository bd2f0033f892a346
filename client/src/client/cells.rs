//! Cells of a divided scene: which ones a member takes, and what they show.
//!
//! A member that joins by cells has the bodies of those that it takes, each by a stream of its own choice.

use std::collections::BTreeMap;

use glam::Vec3;
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::scene::{Cell, CellGrid};
use rhumb_protocol::session::Misuse;
use rhumb_protocol::stream::ErrorBound;
use rhumb_reckoning::{BodyId, Metres};
use rhumb_view::CellViews;

use super::Client;
use crate::error::ClientError;

impl Client {
    /// The grid of the scene's cells; `None` for a scene that is not divided, and for a client that did not join by cells.
    #[must_use]
    pub const fn cell_grid(&self) -> Option<CellGrid> {
        self.pump.session.cell_grid()
    }

    /// Takes these cells and no others, each by a stream, at once, and does not wait. A cell is shown once its copy has caught
    /// up with the others.
    ///
    /// # Errors
    ///
    /// [`ClientError::Misuse`] for a scene that is not divided, and for more than 256 cells; [`ClientError::Ended`] when the
    /// connection is over.
    pub fn take_cells(&mut self, cells: &BTreeMap<Cell, StreamChoice>) -> Result<(), ClientError> {
        self.check_open()?;
        self.pump.session.take_cells(cells)?;
        self.pump.flush();
        Ok(())
    }

    /// Takes the cells around a point by bands, from the nearest to the farthest: each cell by the stream of the first band
    /// that reaches it. A program calls it as its point moves; what is taken already costs nothing.
    ///
    /// # Errors
    ///
    /// As [`Self::take_cells`].
    pub fn take_cells_around(
        &mut self,
        point: impl Into<Vec3>,
        bands: &[(Metres, StreamChoice)],
    ) -> Result<(), ClientError> {
        let grid = self.cell_grid().ok_or(Misuse::NotDivided)?;
        let cells = grid.within(point.into(), bands);
        self.take_cells(&cells.ok_or(Misuse::TooManyCells)?)
    }

    /// The views of the cells, of the moment of [`Self::view`].
    #[must_use]
    pub const fn cells(&self) -> &CellViews {
        self.live_view.cells()
    }

    /// The cells that the server has denied. The next [`Self::take_cells`] asks for them again.
    pub fn denied_cells(&self) -> impl Iterator<Item = (Cell, Denial)> {
        self.pump.session.denied_cells()
    }

    /// Bound on the error of the pose that the views of the cells show: see [`Self::error_bound`]. `None` for a body that is
    /// in no cell that the client takes.
    #[must_use]
    pub fn cell_error_bound(&self, id: BodyId) -> Option<ErrorBound> {
        self.cells().error_bound(&self.pump.session, id)
    }
}
