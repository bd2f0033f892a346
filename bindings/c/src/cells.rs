//! Cells of a scene: those that a client takes, and their states.

use std::ffi::c_char;

use rhumb_bindings::rhumb_client::glam::Vec3;
use rhumb_bindings::{CellBand, CellChoice, CellRecord, RemoteScene, TakenState};

use crate::answers::RHUMB_EVENT_TEXT_BYTES;
use crate::border::{RhumbCode, check_out, copy_out, copy_text, elements, guard, value, write};
use crate::scene::{RhumbScene, with};

/// State of a cell that is taken.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbCellState {
    /// Its snapshot has not come over this connection. A session that resumes shows it until then as it was.
    Awaited,
    /// The view has its bodies. After another choice they are those of the tolerance before, until the new stream has caught up.
    Shown,
    /// The server denies it: `text` says why. The next call that takes it asks again.
    Denied,
}

/// All cells within a distance of a point, and the tolerance of their streams.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCellBand {
    /// From the point to the nearest point of a cell, units of length.
    pub radius: f32,
    /// How far any point of a copied body may be off, metres in any coordinates: 0.001 to 10, or 0 for exact states.
    pub tolerance_m: f64,
}

/// A cell to take, and the tolerance of its stream.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCellChoice {
    /// Its places along x, y and z: from place times edge to place + 1 times edge; 0 along an axis that is not divided.
    pub places: [i32; 3],
    /// As that of a band.
    pub tolerance_m: f64,
}

/// A cell that is taken.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbTakenCell {
    /// Its places along x, y and z.
    pub places: [i32; 3],
    /// A `RhumbCellState`.
    pub state: u32,
    /// Why it is denied, a sentence in UTF-8 that ends with a zero byte; otherwise empty.
    pub text: [c_char; 192],
}

/// Writes the edges of the scene's cells along x, y and z, units of length; 0 along an axis that is not divided. All are 0 for a
/// scene that is not divided, and for one that was joined without `cells`.
///
/// # Safety
///
/// `edges` points to memory for three numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_cell_grid(scene: RhumbScene, edges: *mut f32) -> RhumbCode {
    guard(|| {
        let grid = with(scene, |scene| Ok(scene.cell_grid()))?;
        // SAFETY: the caller promises the memory.
        unsafe { copy_out(edges, 3, &grid.unwrap_or_default(), "edges") }
    })
}

/// Takes the cells around a point and no others: each by the nearest of `count` bands that reaches it. Call it as the point
/// moves: what is taken already costs nothing. It does not wait. A radius of 0 takes the cell that has the point.
///
/// The view has the bodies of these cells, each once, and those that are in no cell: bodies whose bounding radius is more than
/// half of the shortest edge, such as floors. A body that leaves the cells is among `removed` of the poses, and no event tells of
/// it: it was not removed from the scene. A scene that is not divided, more than 256 cells, a point that is in no world, and a
/// radius that is negative or not finite are `RHUMB_CODE_INVALID`; then all stays as it was.
///
/// # Safety
///
/// `point` points to three numbers, `bands` to `count` bands.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_take_cells_around(
    scene: RhumbScene,
    point: *const f32,
    bands: *const RhumbCellBand,
    count: usize,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the numbers and the bands.
        let (point, bands) = unsafe {
            let point = value(point.cast::<[f32; 3]>(), "point")?;
            (Vec3::from_array(*point), elements(bands, count, "bands")?)
        };
        let bands: Vec<_> = bands.iter().map(RhumbCellBand::band).collect();
        with(scene, |scene| scene.take_cells_around(point, &bands))
    })
}

/// Takes `count` cells and no others, as `rhumb_scene_take_cells_around`. Of a cell that is there twice, the last one counts.
///
/// # Safety
///
/// `choices` points to `count` cells.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_take_cells(
    scene: RhumbScene,
    choices: *const RhumbCellChoice,
    count: usize,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the cells.
        let choices = unsafe { elements(choices, count, "choices") }?;
        let choices: Vec<_> = choices.iter().map(RhumbCellChoice::choice).collect();
        with(scene, |scene| scene.take_cells(&choices))
    })
}

/// Writes the cells that are taken, and the state of each. `count` receives their number, 256 at most, also if `capacity`
/// is too small for them; then nothing is written to `cells`.
///
/// # Safety
///
/// `cells` points to memory for `capacity` cells, `count` to memory for a number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_cells(
    scene: RhumbScene,
    cells: *mut RhumbTakenCell,
    capacity: usize,
    count: *mut usize,
) -> RhumbCode {
    guard(|| {
        check_out(count, "count")?;
        let taken = with(scene, |scene| Ok(RemoteScene::cells(scene)))?;
        let taken: Vec<_> = taken.iter().map(RhumbTakenCell::of).collect();
        // SAFETY: the caller promises the memory of both.
        unsafe {
            write(count, taken.len(), "count")?;
            copy_out(cells, capacity, &taken, "cells")
        }
    })
}

impl RhumbCellBand {
    const fn band(&self) -> CellBand {
        CellBand {
            radius: self.radius,
            tolerance_m: self.tolerance_m,
        }
    }
}

impl RhumbCellChoice {
    const fn choice(&self) -> CellChoice {
        CellChoice {
            places: self.places,
            tolerance_m: self.tolerance_m,
        }
    }
}

impl RhumbTakenCell {
    fn of(record: &CellRecord) -> Self {
        let state = match record.state {
            TakenState::Awaited => RhumbCellState::Awaited,
            TakenState::Shown => RhumbCellState::Shown,
            TakenState::Denied => RhumbCellState::Denied,
        };
        let text: [c_char; RHUMB_EVENT_TEXT_BYTES] = copy_text(&record.text);
        Self {
            places: record.places,
            state: state as u32,
            text,
        }
    }
}
