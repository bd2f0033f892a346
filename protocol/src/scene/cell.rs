//! Cells of a scene, and the grid that divides it.
//!
//! Pure geometry: which cell has a body, and which cells a member near a point takes. Streams and members are the
//! server's. Invariant: a body leaves its cell only beyond a margin, so that none at a border goes to and fro.

use alloc::collections::BTreeMap;
use core::fmt;
use core::str::FromStr;

use glam::Vec3;
use rhumb_reckoning::Metres;

use super::checks::{self, Invalid, Quantity};
use crate::limits::{CELL_EDGE_MIN, CELLS_PER_MEMBER_MAX, COORDINATE_MAX, EXTENT_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// One cell of a grid: its place along x, y and z, 0 along an axis that is not divided.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cell(pub [i32; 3]);

/// The grid that divides a scene into cells: boxes along the axes of the world, from its origin on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellGrid {
    /// Metres along each axis; 0 for one that is not divided.
    edges: [f32; 3],
}

// Edges are numbers, so that each equals itself.
impl Eq for CellGrid {}

/// Reason why a text is no grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InvalidCellGrid;

impl fmt::Display for InvalidCellGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "a grid is the edge of its cells along x and z in metres, or three edges along x, y and z with commas between; an edge is {CELL_EDGE_MIN} to {EXTENT_MAX}, or 0 along an axis that is not divided"
        )
    }
}

impl core::error::Error for InvalidCellGrid {}

impl FromStr for CellGrid {
    type Err = InvalidCellGrid;

    fn from_str(text: &str) -> Result<Self, InvalidCellGrid> {
        let mut edges = [0.0; 3];
        let mut parts = text.split(',');
        for edge in &mut edges {
            let part = parts.next().ok_or(InvalidCellGrid);
            *edge = part?.trim().parse().map_err(|_| InvalidCellGrid)?;
            if !text.contains(',') {
                return Self::new([*edge, 0.0, *edge]).ok_or(InvalidCellGrid);
            }
        }
        let grid = Self::new(edges).filter(|_| parts.next().is_none());
        grid.ok_or(InvalidCellGrid)
    }
}

/// The part of an edge by which a body may be outside its cell.
const MARGIN: f64 = 1.0 / 16.0;
/// A body whose bounding radius is a greater part of the shortest edge belongs to no cell: every member has it.
const LARGEST: f64 = 1.0 / 2.0;

impl CellGrid {
    /// A grid of these edges, metres along x, y and z; 0 along an axis that is not divided. `None` if none is divided, or
    /// if an edge is not from [`CELL_EDGE_MIN`] to [`EXTENT_MAX`].
    #[must_use]
    pub fn new(edges: [f32; 3]) -> Option<Self> {
        let is_edge = |edge: f32| (CELL_EDGE_MIN..=EXTENT_MAX).contains(&edge);
        let fits = edges.iter().all(|edge| *edge == 0.0 || is_edge(*edge));
        // Zero has one form.
        let edges = edges.map(|edge| if edge == 0.0 { 0.0 } else { edge });
        (fits && edges != [0.0; 3]).then_some(Self { edges })
    }

    /// A grid of squares along x and z: cells have no floor and no ceiling.
    #[must_use]
    pub fn columns(edge: Metres) -> Option<Self> {
        let edge = edge.metres() as f32;
        Self::new([edge, 0.0, edge])
    }

    /// Metres along x, y and z; 0 along an axis that is not divided.
    #[must_use]
    pub const fn edges(&self) -> [f32; 3] {
        self.edges
    }

    /// True for a cell of this grid: along an axis that is not divided its place is 0.
    #[must_use]
    pub fn has(&self, cell: Cell) -> bool {
        let mut axes = self.edges.into_iter().zip(cell.0);
        axes.all(|(edge, place)| edge > 0.0 || place == 0)
    }

    /// The cell that has a point.
    #[must_use]
    pub fn cell_of(&self, point: Vec3) -> Cell {
        let point = point.to_array();
        Cell(core::array::from_fn(|axis| match self.edges[axis] {
            0.0 => 0,
            edge => place(f64::from(point[axis]) / f64::from(edge)),
        }))
    }

    /// The cell of a body that was in a cell and is at a point now: the same one, unless the point is beyond its margin.
    #[must_use]
    pub fn next_cell(&self, present: Cell, point: Vec3) -> Cell {
        let at = point.to_array();
        let is_kept = |axis: usize| {
            let edge = f64::from(self.edges[axis]);
            let from = f64::from(present.0[axis]) - MARGIN;
            let inside = f64::from(at[axis]) / edge - from;
            edge == 0.0 || (0.0..=1.0 + 2.0 * MARGIN).contains(&inside)
        };
        match (0..3).all(is_kept) {
            true => present,
            false => self.cell_of(point),
        }
    }

    /// True for a body too large for a cell: it belongs to none, and every member has it.
    #[must_use]
    pub fn is_too_large(&self, bounding_radius: Metres) -> bool {
        let divided = self.edges.into_iter().filter(|edge| *edge > 0.0);
        let shortest = divided.fold(f32::INFINITY, f32::min);
        bounding_radius.metres() > LARGEST * f64::from(shortest)
    }

    /// The cells within distances of a point, each with the choice of the nearest band that reaches it, in whatever order the
    /// bands are given. `Ok(None)` if they are more than [`CELLS_PER_MEMBER_MAX`].
    ///
    /// # Errors
    ///
    /// [`Invalid`] for a point that is in no world, and for a radius that is no length.
    pub fn within<T: Copy>(
        &self,
        point: Vec3,
        bands: &[(Metres, T)],
    ) -> Result<Option<BTreeMap<Cell, T>>, Invalid> {
        checks::vector(point, COORDINATE_MAX, Quantity::Position)?;
        let mut reach = 0.0_f32;
        for (radius, _) in bands {
            let radius = radius.metres() as f32;
            let checked = checks::scalar(radius, 0.0, f32::MAX, Quantity::Position);
            checked.map_err(|wrong| wrong.of("radius of a band", "m"))?;
            reach = reach.max(radius);
        }
        let reach = Vec3::splat(reach);
        let (first, last) = (self.cell_of(point - reach), self.cell_of(point + reach));
        let count = |axis: usize| u64::from(last.0[axis].abs_diff(first.0[axis])) + 1;
        // The cells of a ball are more than a third of those of the box around it.
        let box_cells = (0..3).map(count).fold(1, u64::saturating_mul);
        if box_cells > 8 * CELLS_PER_MEMBER_MAX as u64 {
            return Ok(None);
        }
        let mut cells = BTreeMap::new();
        for x in first.0[0]..=last.0[0] {
            for y in first.0[1]..=last.0[1] {
                for z in first.0[2]..=last.0[2] {
                    let cell = Cell([x, y, z]);
                    let distance = self.squared_distance(cell, point);
                    let bands = bands
                        .iter()
                        .map(|(radius, choice)| (radius.metres(), *choice));
                    let reaching = bands.filter(|(radius, _)| distance <= radius * radius);
                    let nearest = reaching.min_by(|(a, _), (b, _)| a.total_cmp(b));
                    cells.extend(nearest.map(|(_, choice)| (cell, choice)));
                }
            }
        }
        Ok((cells.len() <= CELLS_PER_MEMBER_MAX).then_some(cells))
    }

    /// The square of the distance of a cell from a point, square metres; 0 inside.
    fn squared_distance(&self, cell: Cell, point: Vec3) -> f64 {
        let point = point.to_array();
        let beside = |axis: usize| {
            let edge = f64::from(self.edges[axis]);
            let (least, at) = (f64::from(cell.0[axis]) * edge, f64::from(point[axis]));
            let beyond = (least - at).max(at - least - edge);
            if edge == 0.0 { 0.0 } else { beyond.max(0.0) }
        };
        (0..3).map(|axis| beside(axis) * beside(axis)).sum()
    }
}

/// The whole number below, within the limits of cells: also for a body that is out of the world before it is removed.
fn place(edges: f64) -> i32 {
    // A conversion from a float saturates.
    (libm::floor(edges) as i32).clamp(-Cell::PLACE_MAX, Cell::PLACE_MAX)
}

impl Cell {
    /// Bound on the place of a cell along an axis.
    pub const PLACE_MAX: i32 = (COORDINATE_MAX / CELL_EDGE_MIN) as i32 + 1;

    /// True if a message can name it: its places are within [`Self::PLACE_MAX`].
    pub(crate) fn is_in_a_world(self) -> bool {
        let places = -Self::PLACE_MAX..=Self::PLACE_MAX;
        self.0.iter().all(|place| places.contains(place))
    }
}

impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0;
        write!(f, "cell {x} {y} {z}")
    }
}

impl Wire for Cell {
    fn encode(&self, to: &mut Writer) {
        for place in self.0 {
            let size = u64::from(place.unsigned_abs());
            to.varint(if place < 0 { 2 * size - 1 } else { 2 * size });
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut cell = Self::default();
        for place in &mut cell.0 {
            let number = from.varint_to(2 * Self::PLACE_MAX as u64)?;
            let size = number.div_ceil(2) as i32;
            *place = if number % 2 == 1 { -size } else { size };
        }
        Ok(cell)
    }
}

impl Wire for CellGrid {
    fn encode(&self, to: &mut Writer) {
        to.f32s(&self.edges);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let edges = from.f32s()?;
        let grid = Self::new(edges).ok_or(Malformed::OutOfRange)?;
        // A negative zero is another form of zero.
        let bits = |edges: [f32; 3]| edges.map(f32::to_bits);
        match bits(grid.edges) == bits(edges) {
            true => Ok(grid),
            false => Err(Malformed::NotCanonical),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn squares(edge: f64) -> CellGrid {
        CellGrid::columns(Metres::new(edge)).expect("an edge within the limits")
    }

    fn at(x: f32, z: f32) -> Vec3 {
        Vec3::new(x, 5.0, z)
    }

    #[test]
    fn a_place_beyond_the_limits_is_refused() {
        for number in [u32::MAX, u32::MAX - 1, 2 * Cell::PLACE_MAX as u32 + 1] {
            let mut writer = Writer::new();
            writer.varint(u64::from(number));
            writer.varint(0);
            writer.varint(0);
            let cell = Cell::decode(&mut Reader::new(&writer.into_bytes()));
            assert_eq!(cell, Err(Malformed::OutOfRange), "{number}");
        }
    }

    proptest! {
        #[test]
        fn a_cell_round_trips(x in -Cell::PLACE_MAX..=Cell::PLACE_MAX, z in -2000..2000) {
            let cell = Cell([x, 0, z]);
            let mut writer = Writer::new();
            cell.encode(&mut writer);
            let bytes = writer.into_bytes();
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Cell::decode(&mut reader).unwrap(), cell);
            prop_assert!(reader.finish().is_ok());
        }

        #[test]
        fn whatever_decodes_to_a_cell_encodes_to_the_same_bytes(bytes in proptest::collection::vec(any::<u8>(), 0..16)) {
            let mut reader = Reader::new(&bytes);
            if let Ok(cell) = Cell::decode(&mut reader) {
                let mut writer = Writer::new();
                cell.encode(&mut writer);
                let used = bytes.len() - reader.rest().len();
                prop_assert_eq!(writer.into_bytes(), &bytes[..used]);
            }
        }

        #[test]
        fn a_body_is_never_farther_outside_its_cell_than_the_margin(
            ways in proptest::collection::vec((-3.0_f32..3.0, -3.0_f32..3.0), 1..200),
        ) {
            let grid = squares(4.0);
            let (mut x, mut z) = (0.0, 0.0);
            let mut cell = grid.cell_of(at(x, z));
            for (dx, dz) in ways {
                (x, z) = (x + dx, z + dz);
                cell = grid.next_cell(cell, at(x, z));
                let beyond = grid.squared_distance(cell, at(x, z));
                prop_assert!(beyond <= 2.0 * (4.0 * MARGIN) * (4.0 * MARGIN) + 1e-9, "{}", beyond);
            }
        }
    }

    #[test]
    fn a_text_says_the_edges() {
        for (text, edges) in [
            ("50", [50.0, 0.0, 50.0]),
            ("12.5", [12.5, 0.0, 12.5]),
            ("50,0,20", [50.0, 0.0, 20.0]),
            ("8, 16, 8", [8.0, 16.0, 8.0]),
        ] {
            assert_eq!(text.parse().ok(), CellGrid::new(edges), "{text}");
        }
        for text in [
            "", "0", "nan", "-5", "0.5", "50,", "50,50", "1,2,3,4", "0,0,0", "a",
        ] {
            assert_eq!(text.parse::<CellGrid>(), Err(InvalidCellGrid), "{text}");
        }
    }

    #[test]
    fn a_body_at_a_border_stays_in_its_cell() {
        let grid = squares(10.0);
        let mut cell = grid.cell_of(at(9.9, 3.0));
        assert_eq!(cell, Cell([0, 0, 0]));
        for x in [10.1, 9.9, 10.4, 9.7] {
            cell = grid.next_cell(cell, at(x, 3.0));
            assert_eq!(cell, Cell([0, 0, 0]), "at {x}");
        }
        cell = grid.next_cell(cell, at(10.7, 3.0));
        assert_eq!(cell, Cell([1, 0, 0]));
        assert_eq!(grid.next_cell(cell, at(9.5, 3.0)), cell);
        assert_eq!(grid.next_cell(cell, at(9.3, -20.0)), Cell([0, 0, -2]));
    }

    #[test]
    fn the_nearest_band_counts() {
        let grid = squares(10.0);
        let cells = grid.within(
            at(5.0, 5.0),
            &[(Metres::new(4.0), 'n'), (Metres::new(12.0), 'f')],
        );
        let cells = cells.expect("a place").expect("few cells");
        assert_eq!(cells.get(&Cell([0, 0, 0])), Some(&'n'));
        assert_eq!(cells.get(&Cell([1, 0, 1])), Some(&'f'));
        assert_eq!(cells.get(&Cell([-1, 0, 0])), Some(&'f'));
        assert_eq!(cells.get(&Cell([2, 0, 0])), None);
        assert_eq!(cells.len(), 9);
        let far_first = [(Metres::new(12.0), 'f'), (Metres::new(4.0), 'n')];
        assert_eq!(grid.within(at(5.0, 5.0), &far_first), Ok(Some(cells)));
        for radius in [150.0, 1e5, 1e30] {
            let all = grid.within(at(0.0, 0.0), &[(Metres::new(radius), ())]);
            assert_eq!(all, Ok(None), "{radius}");
        }
    }

    #[test]
    fn a_point_in_no_world_and_a_radius_that_is_no_length_are_errors() {
        let grid = squares(10.0);
        let bands = [(Metres::new(4.0), ())];
        for x in [1e30, -1.1e5, f32::NAN, f32::INFINITY] {
            assert!(grid.within(at(x, 0.0), &bands).is_err(), "{x}");
        }
        let corner = grid.within(at(1e5, -1e5), &bands);
        assert_eq!(
            corner.map(|cells| cells.map(|cells| cells.len())),
            Ok(Some(4))
        );
        for radius in [-1.0, f64::NAN, f64::INFINITY] {
            let radius = Metres::new(radius);
            assert!(
                grid.within(at(0.0, 0.0), &[(radius, ())]).is_err(),
                "{radius}"
            );
        }
    }

    #[test]
    fn a_radius_of_zero_takes_the_cell_that_has_the_point() {
        let grid = squares(10.0);
        let cells = grid.within(at(10.0, -10.0), &[(Metres::new(0.0), ())]);
        let only = BTreeMap::from([(Cell([1, 0, -1]), ())]);
        assert_eq!(cells, Ok(Some(only)));
    }

    #[test]
    fn a_grid_has_edges_within_the_limits() {
        for edges in [
            [0.0; 3],
            [0.5, 0.0, 0.0],
            [-4.0, 4.0, 4.0],
            [f32::NAN, 1.0, 1.0],
            [2e4, 0.0, 0.0],
        ] {
            assert_eq!(CellGrid::new(edges), None, "{edges:?}");
        }
        let grid = squares(10.0);
        assert!(grid.has(Cell([7, 0, -3])) && !grid.has(Cell([7, 1, -3])));
        assert!(!grid.is_too_large(Metres::new(5.0)) && grid.is_too_large(Metres::new(5.1)));
        assert_eq!(
            grid.cell_of(at(1e9, -1e9)),
            Cell([Cell::PLACE_MAX, 0, -Cell::PLACE_MAX])
        );
    }
}
