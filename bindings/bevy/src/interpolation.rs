//! Transforms between two ticks of a lockstep scene, for the time of a frame.
//!
//! The transform follows the state by one fixed step at most. A step without a new tick holds the bodies still.

use bevy_ecs::change_detection::DetectChangesMut as _;
use bevy_ecs::component::Component;
use bevy_ecs::system::{Query, Res};
use bevy_math::{Quat, Vec3};
use bevy_time::{Fixed, Time};
use bevy_transform::components::Transform;

use crate::body::RhumbState;

/// The pose at the fixed step before.
#[derive(Clone, Copy, Debug, PartialEq, Component)]
pub(crate) struct PoseBefore {
    position: Vec3,
    rotation: Quat,
}

impl PoseBefore {
    pub(crate) const fn of(state: &RhumbState) -> Self {
        Self {
            position: state.position,
            rotation: state.rotation,
        }
    }
}

/// Begins a fixed step: what was the newest pose is the one before.
pub(crate) fn begin_step(mut bodies: Query<'_, '_, (&RhumbState, &mut PoseBefore)>) {
    for (state, mut before) in &mut bodies {
        before.set_if_neq(PoseBefore::of(state));
    }
}

/// Writes the transforms of the frame's moment.
pub(crate) fn interpolate(
    time: Res<'_, Time<Fixed>>,
    mut bodies: Query<'_, '_, (&RhumbState, &PoseBefore, &mut Transform)>,
) {
    let share = time.overstep_fraction();
    for (state, before, mut transform) in &mut bodies {
        let drawn = Transform {
            translation: before.position.lerp(state.position, share),
            rotation: before.rotation.slerp(state.rotation, share),
            scale: transform.scale,
        };
        transform.set_if_neq(drawn);
    }
}
