//! Properties of a body of a scene, before the engine has it.

use rhumb_protocol::limits::MOMENT_MAX;
use rhumb_protocol::scene::{BodyDesc, BodyKind, CommandError, Invalid, Quantity};

use super::Scene;
use crate::engine::BodyProperties;

impl Scene {
    /// Refuses a dynamic body whose momentum the engine could not compute.
    pub(super) fn check_moment(&self, properties: &BodyProperties) -> Result<(), CommandError> {
        let is_dynamic = properties.desc.kind == BodyKind::Dynamic;
        match self.engine.moment(properties).filter(|_| is_dynamic) {
            Some(moment) if !moment.is_finite() || moment > MOMENT_MAX => {
                let moments = Invalid::out_of_range(Quantity::Moments);
                Err(CommandError::Invalid(moments))
            }
            _ => Ok(()),
        }
    }

    /// A body's description with the scene's defaults filled in.
    pub(super) fn properties(&self, desc: BodyDesc) -> BodyProperties {
        BodyProperties {
            desc,
            material: desc.material.unwrap_or(self.config.material),
            damping: desc.damping.unwrap_or(self.config.damping),
            sleep: desc.sleep.unwrap_or(self.config.sleep),
        }
    }
}
