//! What several messages say: names of things, and what a surface does.

use core::fmt;

use crate::wire::fields;

fields! {
    /// Names an actor, a shape or a joint, which have separate numbers.
    #[derive(Eq, PartialOrd, Ord, Hash)]
    Id {
        /// The simulation; zero in the shape's name of `AttachShape` and `DetachShape`, whatever the session's is.
        simulation: u32,
        /// Which of them.
        object: u32,
    }
}

fields! {
    /// Density and surface of a shape on an actor.
    Surface {
        /// kg/m³.
        density: f32,
        /// Coefficient.
        static_friction: f32,
        /// Coefficient.
        kinetic_friction: f32,
        /// Share of the closing speed given back.
        restitution: f32,
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.simulation, self.object)
    }
}
