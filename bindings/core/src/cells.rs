//! Cells of a scene that a member takes, as plain fields.
//!
//! Places and lengths are along the axes and in the unit of the application. A tolerance is in metres in any coordinates; zero
//! asks for the exact stream.

use glam::Vec3;
use rhumb_client::scene::{Cell, CellGrid};
use rhumb_client::{CellState, Denial, Metres, StreamChoice};

use crate::coordinates::Coordinates;
use crate::error::BindingError;
use crate::joining::tolerance;

/// All cells within a distance, and the tolerance of their streams.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellBand {
    /// From the point to the nearest point of a cell, units of length.
    pub radius: f32,
    /// Metres; 0: exact.
    pub tolerance_m: f64,
}

/// A cell to take, and the tolerance of its stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellChoice {
    /// Its places along x, y and z.
    pub places: [i32; 3],
    /// Metres; 0: exact.
    pub tolerance_m: f64,
}

/// A cell that is taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CellRecord {
    /// Its places along x, y and z.
    pub places: [i32; 3],
    /// Its state.
    pub state: TakenState,
    /// Why it is denied, a sentence; otherwise empty.
    pub text: String,
}

/// State of a cell that is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TakenState {
    /// Its snapshot has not come over this connection. A session that resumes shows it until then as it was.
    Awaited,
    /// The view has its bodies. After another choice they are those of the tolerance before, until the new stream has caught up.
    Shown,
    /// The server denies it.
    Denied,
}

impl TakenState {
    /// Its word.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Awaited => "awaited",
            Self::Shown => "shown",
            Self::Denied => "denied",
        }
    }
}

impl CellBand {
    /// The band of the client.
    ///
    /// # Errors
    ///
    /// [`BindingError`] for a radius that is no length, and a tolerance that no stream can have.
    pub fn of_client(
        &self,
        coordinates: Coordinates,
    ) -> Result<(Metres, StreamChoice), BindingError> {
        if !(0.0..f32::INFINITY).contains(&self.radius) {
            let needed = "a length, 0 or more";
            return Err(BindingError::value("radius", self.radius, needed));
        }
        let radius = f64::from(coordinates.length_in(self.radius));
        Ok((Metres::new(radius), stream(self.tolerance_m)?))
    }
}

impl CellChoice {
    /// The choice of the client.
    ///
    /// # Errors
    ///
    /// [`BindingError`] for a tolerance that no stream can have.
    pub fn of_client(
        &self,
        grid: CellGrid,
        coordinates: Coordinates,
    ) -> Result<(Cell, StreamChoice), BindingError> {
        let cell = coordinates.cell_in(self.places, grid);
        Ok((cell, stream(self.tolerance_m)?))
    }
}

impl CellRecord {
    /// The record of a cell of the client.
    #[must_use]
    pub fn new((cell, state): (Cell, CellState), grid: CellGrid, coordinates: Coordinates) -> Self {
        let (state, text) = match state {
            CellState::Awaited => (TakenState::Awaited, String::new()),
            CellState::Shown => (TakenState::Shown, String::new()),
            CellState::Denied(denial) => (TakenState::Denied, sentence(denial)),
        };
        Self {
            places: coordinates.cell_out(cell, grid),
            state,
            text,
        }
    }
}

/// Why a cell is denied.
fn sentence(denial: Denial) -> String {
    match denial {
        Denial::NoSuchScene => {
            "the grid has no such cell: along an axis that is not divided its place is 0".to_owned()
        }
        Denial::TooManyStreams => {
            "members take as many cells of the scene as it may have, or this client has its share, or the cell has all its streams: take fewer, or a tolerance that others take there"
                .to_owned()
        }
        denial => denial.to_string(),
    }
}

/// A point that cells are taken around.
pub(crate) fn point(point: Vec3, coordinates: Coordinates) -> Result<Vec3, BindingError> {
    match point.is_finite() {
        true => Ok(coordinates.vector_in(point)),
        false => Err(BindingError::value("point", point, "three finite numbers")),
    }
}

/// The stream of a cell.
fn stream(tolerance_m: f64) -> Result<StreamChoice, BindingError> {
    match tolerance_m == 0.0 {
        true => Ok(StreamChoice::Full),
        false => tolerance(tolerance_m).map(StreamChoice::Within),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cell_of_a_point_is_the_same_in_all_coordinates() {
        let edges = [[10.0, 0.0, 10.0], [5.0, 20.0, 0.0], [3.0, 4.0, 5.0]];
        for grid in edges.map(|edges| CellGrid::new(edges).expect("edges within the limits")) {
            for at in [Vec3::new(14.5, 3.0, -27.0), Vec3::new(-1.0, -8.5, 2.5)] {
                let cell = grid.cell_of(at);
                for coordinates in Coordinates::EACH {
                    let (edges, there) =
                        (coordinates.cell_edges_out(grid), coordinates.vector_out(at));
                    let expected: [i32; 3] = std::array::from_fn(|axis| match edges[axis] {
                        0.0 => 0,
                        edge => (there[axis] / edge).floor() as i32,
                    });
                    assert_eq!(
                        coordinates.cell_out(cell, grid),
                        expected,
                        "{coordinates:?} {grid:?}"
                    );
                    assert_eq!(coordinates.cell_in(expected, grid), cell, "{coordinates:?}");
                }
            }
            for places in [[0, 1, 0], [i32::MAX, 0, i32::MIN]] {
                for coordinates in Coordinates::EACH {
                    let cell = coordinates.cell_in(places, grid);
                    let beyond = cell.0.iter().any(|place| place.abs() > Cell::PLACE_MAX);
                    assert!(beyond || coordinates.cell_out(cell, grid) == places);
                }
            }
        }
    }

    #[test]
    fn a_band_has_a_length_and_a_tolerance_that_a_stream_can_have() {
        let band = |radius, tolerance_m| {
            let band = CellBand {
                radius,
                tolerance_m,
            };
            band.of_client(Coordinates::Unreal)
        };
        let exact = band(200.0, 0.0).expect("two metres");
        assert_eq!(exact, (Metres::new(2.0), StreamChoice::Full));
        for (radius, tolerance_m) in [
            (-1.0, 0.05),
            (f32::NAN, 0.05),
            (f32::INFINITY, 0.05),
            (5.0, 1e-9),
        ] {
            assert!(band(radius, tolerance_m).is_err(), "{radius} {tolerance_m}");
        }
    }
}
