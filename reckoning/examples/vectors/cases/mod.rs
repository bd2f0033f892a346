//! The cases of the golden vectors, computed through the public face.
//!
//! Chosen by hand where an edge is known, by a seeded generator elsewhere. One function a section of the file.

mod chance;
mod corrections;
mod flight;
mod holding;
mod packing;
mod said;
mod settling;
mod tumbling;

use chance::Chance;

use crate::document::written;

/// The file, complete.
pub(crate) fn document() -> String {
    let mut chance = Chance(0x5EED);
    written(&[
        ("integrators", flight::integrators()),
        ("flows", flight::flows()),
        ("gravities", flight::gravities()),
        ("starts", flight::starts()),
        ("predictions", flight::predictions()),
        ("inertias", tumbling::inertias()),
        ("tumblings", tumbling::tumblings()),
        ("radii", said::radii()),
        ("classes", said::classes()),
        ("grids", said::grids()),
        ("packings", packing::packings(&mut chance)),
        ("unpackings", packing::unpackings(&mut chance)),
        ("snappings", said::snappings(&mut chance)),
        ("residuals", corrections::residuals(&mut chance)),
        ("tracks", said::tracks(&mut chance)),
        ("holdings", holding::holdings(&mut chance)),
        ("settlings", settling::settlings(&mut chance)),
    ])
}
