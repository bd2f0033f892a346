//! Fields that several messages share: names and surfaces.

use core::fmt;

use super::codec::fields;

fields! {
    /// Names an actor, a shape or a joint; each kind has its own numbers.
    #[derive(Eq, PartialOrd, Ord, Hash)]
    Id {
        /// The simulation; always zero in the shape's name of `AttachShape` and `DetachShape`.
        simulation: u32,
        /// Number within its kind.
        object: u32,
    }
}

fields! {
    /// Density and surface of a shape on an actor.
    Surface {
        /// Density, kg/m³.
        density: f32,
        /// Coefficient of static friction.
        static_friction: f32,
        /// Coefficient of kinetic friction.
        kinetic_friction: f32,
        /// Share of the closing speed that is returned.
        restitution: f32,
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.simulation, self.object)
    }
}
