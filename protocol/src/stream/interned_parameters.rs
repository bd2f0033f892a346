//! Prediction parameters of a stream's bodies, each distinct set kept once.
//!
//! Contains no bodies: the tables of bodies hold the numbers of parameter sets.

use rhumb_reckoning::{Grid, Inertia, Metres, Tolerance, ToleranceScale};

use crate::interner::{Internable, Interner};

/// One distinct set of parameters in a stream.
#[derive(Clone, Debug)]
pub(super) struct InternedParameters {
    pub(super) radius: Metres,
    pub(super) gravity_scale: f32,
    pub(super) inertia: Option<Inertia>,
    /// The index in the table of damping factors.
    pub(super) flow: u16,
    pub(super) tolerance_scale: ToleranceScale,
    /// A number that the subscriber's owner keeps with such bodies; see `Tracks::label`.
    pub(super) label: Option<u32>,
    /// The stream's tolerance, scaled for these bodies.
    pub(super) tolerance: Tolerance,
    pub(super) grid: Grid,
}

/// The values that distinguish two sets, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct ParameterKey {
    radius: u64,
    gravity_scale: u32,
    inertia: Option<[u32; 7]>,
    flow: u16,
    tolerance_scale: ToleranceScale,
    label: Option<u32>,
}

impl Internable for InternedParameters {
    type Key = ParameterKey;

    fn key(&self) -> ParameterKey {
        let inertia = self.inertia.map(|inertia| {
            let ([a, b, c], [x, y, z, w]) = (inertia.moments(), inertia.frame());
            [a, b, c, x, y, z, w].map(f32::to_bits)
        });
        ParameterKey {
            radius: self.radius.metres().to_bits(),
            gravity_scale: self.gravity_scale.to_bits(),
            inertia,
            flow: self.flow,
            tolerance_scale: self.tolerance_scale,
            label: self.label,
        }
    }
}

/// All parameter sets of one stream, by number.
pub(super) type InternedParameterTable = Interner<InternedParameters>;

#[cfg(test)]
mod tests {
    use super::*;

    fn interned(radius: f64, inertia: Option<Inertia>) -> InternedParameters {
        let radius = Metres::new(radius);
        InternedParameters {
            radius,
            gravity_scale: 1.0,
            inertia,
            flow: 0,
            tolerance_scale: ToleranceScale::USUAL,
            label: None,
            tolerance: Tolerance::NORMAL,
            grid: Grid::new(Tolerance::NORMAL, radius),
        }
    }

    #[test]
    fn parameters_differing_in_one_bit_are_distinct() {
        let mut interned_parameters = InternedParameterTable::default();
        let slab = |last| Inertia::new([1.0, 2.0, last], Inertia::OWN_AXES).ok();
        let (thick, thin) = (slab(2.9), slab(2.9_f32.next_down()));
        let bodies = [
            (0.5, None),
            (0.5, thick),
            (0.5, None),
            (0.5, thin),
            (0.5_f64.next_up(), None),
        ];
        let numbers =
            bodies.map(|(radius, inertia)| interned_parameters.join(interned(radius, inertia)));
        assert_eq!(numbers, [0, 1, 0, 2, 3]);
    }
}
