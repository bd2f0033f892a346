//! The cases of the golden vectors, computed through the public interface.
//!
//! Edges are chosen by hand, other cases by a seeded generator. One function for each section of the file.

mod attaching;
mod corrections;
mod flight;
mod packing;
mod rest_correction;
mod rng;
mod tolerances;
mod torque_free;
mod traps;
mod turns;

use rng::VectorRng;

use crate::document::written;

/// The complete file.
pub(crate) fn document() -> String {
    let mut rng = VectorRng(0x5EED);
    written(&[
        ("traps", traps::traps()),
        ("turns", turns::turns()),
        ("integrators", flight::integrators()),
        ("flows", flight::flows()),
        ("gravities", flight::gravities()),
        ("initial_states", flight::starts()),
        ("predictions", flight::predictions()),
        ("inertias", torque_free::inertias()),
        (
            "torque_free_rotations",
            torque_free::torque_free_rotations(),
        ),
        ("radii", tolerances::radii()),
        ("tolerance_scales", tolerances::tolerance_scales()),
        ("grids", tolerances::grids()),
        ("packings", packing::packings(&mut rng)),
        ("unpackings", packing::unpackings(&mut rng)),
        ("quantisations", tolerances::quantisations(&mut rng)),
        ("residuals", corrections::residuals(&mut rng)),
        ("tracks", tolerances::tracks(&mut rng)),
        ("attachments", attaching::attachments(&mut rng)),
        (
            "rest_corrections",
            rest_correction::rest_corrections(&mut rng),
        ),
    ])
}
