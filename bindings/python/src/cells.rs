//! Cells of a scene: those that a member takes, and their states.

use std::collections::BTreeMap;

use pyo3::prelude::*;
use rhumb_bindings::{CellBand, CellChoice, CellRecord, TakenState};

use crate::arguments::vector;
use crate::number::within;
use crate::scene::PyScene;

/// Places along x, y and z.
type Places = (i32, i32, i32);

const CELLS: &str = "a dictionary from cells, three whole numbers each, to tolerances in metres, or None for exact states";
const BANDS: &str = "pairs of a radius and a tolerance in metres, or None for exact states";

#[pymethods]
impl PyScene {
    /// Edges of the scene's cells along x, y and z, units of length; 0 along an axis that is not divided.
    ///
    /// Cell (i, j, k) reaches from i times the edge to i + 1 times the edge along x, and so on; along an axis that is not
    /// divided, its number is 0. None for a scene that is not divided, and for one that was not joined with cells=True.
    #[getter]
    fn cell_grid(&self, py: Python<'_>) -> PyResult<Option<(f32, f32, f32)>> {
        let edges = self.with(py, |opened| Ok(opened.scene.cell_grid()))?;
        Ok(edges.map(Into::into))
    }

    /// Takes these cells and no others, each with its tolerance in metres; None: exact states. As take_cells_around.
    fn take_cells(&self, py: Python<'_>, cells: &Bound<'_, PyAny>) -> PyResult<()> {
        let read = cells.extract::<BTreeMap<Places, Option<f64>>>();
        let cells = within(cells, "cells", read, CELLS)?.into_iter();
        let choices = cells.map(|(places, tolerance)| CellChoice {
            places: places.into(),
            tolerance_m: tolerance.unwrap_or(0.0),
        });
        let choices: Vec<_> = choices.collect();
        self.with(py, |opened| opened.scene.take_cells(&choices))
    }

    /// Takes the cells around a point and no others: each with the tolerance of the nearest band that reaches it.
    ///
    /// bands: pairs of a radius in units of length and a tolerance in metres, as in [(40, 0.01), (150, 0.2)];
    /// None in place of a tolerance: exact states. Call it as the point moves: what is taken already costs nothing.
    ///
    /// The view has the bodies of these cells, each once, and those that are in no cell: bodies whose bounding radius is more
    /// than half of the shortest edge, such as floors. A body that leaves the cells is among removed, and no event tells of it: it
    /// was not removed from the scene. It does not wait: cells tells which are there. A radius of 0 takes the cell that has the point.
    ///
    /// Raises InvalidError for a scene whose cell_grid is None, for more than 256 cells, for a point that is in no world, and for a
    /// radius that is negative or not finite; then all stays as it was.
    fn take_cells_around(
        &self,
        py: Python<'_>,
        point: &Bound<'_, PyAny>,
        bands: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let point = vector(point, "point")?;
        let read = bands.extract::<Vec<(f32, Option<f64>)>>();
        let bands = within(bands, "bands", read, BANDS)?.into_iter();
        let bands = bands.map(|(radius, tolerance)| CellBand {
            radius,
            tolerance_m: tolerance.unwrap_or(0.0),
        });
        let bands: Vec<_> = bands.collect();
        self.with(py, |opened| opened.scene.take_cells_around(point, &bands))
    }

    /// States of the cells that are taken: "awaited", "shown", or "denied", as denied_cells explains.
    ///
    /// A cell is awaited until its snapshot has come, once more after a resumed session, which shows it until then as it was. It stays
    /// shown while another tolerance is on its way. A cell that was denied is asked for again by the next take_cells or take_cells_around.
    #[getter]
    fn cells(&self, py: Python<'_>) -> PyResult<BTreeMap<Places, &'static str>> {
        let cells = self.with(py, |opened| Ok(opened.scene.cells()))?;
        let states = cells.into_iter();
        Ok(states
            .map(|of| (of.places.into(), of.state.word()))
            .collect())
    }

    /// Why the server denies cells that are taken, a sentence each.
    #[getter]
    fn denied_cells(&self, py: Python<'_>) -> PyResult<BTreeMap<Places, String>> {
        let cells = self.with(py, |opened| Ok(opened.scene.cells()))?;
        let is_denied = |of: &CellRecord| of.state == TakenState::Denied;
        let denied = cells.into_iter().filter(is_denied);
        Ok(denied.map(|of| (of.places.into(), of.text)).collect())
    }
}
