//! What predictors need to know of bodies, each kind kept once.
//!
//! Most bodies of a scene are alike, so that a table of bodies holds the number of a kind in place of all that makes it
//! one. Invariant: a kind is kept while a body is of it, and no longer.

use alloc::collections::BTreeMap;
use alloc::vec::Vec;

use rhumb_reckoning::{Class, Grid, Inertia, Metres, Tolerance};

/// One kind of body in one stream.
#[derive(Clone, Debug)]
pub(super) struct Nature {
    pub(super) radius: Metres,
    pub(super) gravity_scale: f32,
    pub(super) inertia: Option<Inertia>,
    /// Which of the tables of dampings.
    pub(super) flow: u16,
    pub(super) class: Class,
    /// The stream's, by the class.
    pub(super) tolerance: Tolerance,
    pub(super) grid: Grid,
}

/// What two kinds differ by, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    radius: u64,
    gravity_scale: u32,
    inertia: Option<[u32; 7]>,
    flow: u16,
    class: Class,
}

impl Key {
    fn of(nature: &Nature) -> Self {
        let inertia = nature.inertia.map(|inertia| {
            let ([a, b, c], [x, y, z, w]) = (inertia.moments(), inertia.frame());
            [a, b, c, x, y, z, w].map(f32::to_bits)
        });
        Self {
            radius: nature.radius.metres().to_bits(),
            gravity_scale: nature.gravity_scale.to_bits(),
            inertia,
            flow: nature.flow,
            class: nature.class,
        }
    }
}

/// All kinds of one stream, by number.
#[derive(Clone, Debug, Default)]
pub(super) struct Natures {
    /// With how many bodies are of each; those of none are free.
    kinds: Vec<(Nature, u32)>,
    numbers: BTreeMap<Key, u32>,
    free: Vec<u32>,
}

impl Natures {
    pub(super) fn get(&self, number: u32) -> &Nature {
        &self.kinds[number as usize].0
    }

    /// One body more is of this kind; returns its number.
    pub(super) fn join(&mut self, nature: Nature) -> u32 {
        let key = Key::of(&nature);
        if let Some(number) = self.numbers.get(&key) {
            self.kinds[*number as usize].1 += 1;
            return *number;
        }
        let number = match self.free.pop() {
            Some(number) => {
                self.kinds[number as usize] = (nature, 1);
                number
            }
            None => {
                self.kinds.push((nature, 1));
                self.kinds.len() as u32 - 1
            }
        };
        self.numbers.insert(key, number);
        number
    }

    /// One body less is of this kind.
    pub(super) fn leave(&mut self, number: u32) {
        let (nature, bodies) = &mut self.kinds[number as usize];
        *bodies -= 1;
        if *bodies == 0 {
            self.numbers.remove(&Key::of(nature));
            self.free.push(number);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn nature(radius: f64, inertia: Option<Inertia>) -> Nature {
        let radius = Metres::new(radius);
        Nature {
            radius,
            gravity_scale: 1.0,
            inertia,
            flow: 0,
            class: Class::USUAL,
            tolerance: Tolerance::NORMAL,
            grid: Grid::new(Tolerance::NORMAL, radius),
        }
    }

    #[test]
    fn a_kind_is_kept_once_while_a_body_is_of_it() {
        let mut natures = Natures::default();
        let slab = Inertia::new([1.0, 2.0, 2.9], Inertia::OWN_AXES).ok();
        let numbers = [nature(0.5, None), nature(0.5, slab), nature(0.5, None)]
            .map(|nature| natures.join(nature));
        assert_eq!(numbers, [0, 1, 0]);
        natures.leave(0);
        assert_eq!(natures.join(nature(2.0, None)), 2);
        natures.leave(0);
        assert_eq!(natures.join(nature(7.0, None)), 0);
        assert_eq!(natures.join(nature(0.5, None)), 3);
        assert_eq!(natures.get(0).radius, Metres::new(7.0));
    }
}
