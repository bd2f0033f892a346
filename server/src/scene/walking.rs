//! Characters and vehicles of a scene.

use rhumb_protocol::scene::{CommandError, JumpFrom, Locomotion, WheelInput};
use rhumb_reckoning::BodyId;

use super::Scene;

impl Scene {
    /// The locomotion of a body that is a character or a vehicle.
    #[must_use]
    pub fn locomotion(&self, id: BodyId) -> Option<&Locomotion> {
        self.registry.locomotion(id)
    }

    /// Every locomotion of a body, in the order of ids.
    pub(crate) fn locomotions(&self) -> impl Iterator<Item = &Locomotion> {
        self.registry.locomotions()
    }

    pub(super) fn set_locomotion(
        &mut self,
        id: BodyId,
        locomotion: &Locomotion,
    ) -> Result<(), CommandError> {
        self.registry.set_locomotion(id, locomotion)?;
        self.engine.set_locomotion(id, locomotion);
        Ok(())
    }

    pub(super) fn jump(
        &mut self,
        id: BodyId,
        speed: f32,
        from: JumpFrom,
    ) -> Result<(), CommandError> {
        self.enabled(id)?;
        match self.locomotion(id) {
            Some(Locomotion::Character(_)) => {
                self.engine.jump(id, speed, from);
                Ok(())
            }
            _ => Err(CommandError::NotCharacter(id)),
        }
    }

    pub(super) fn set_wheels(
        &mut self,
        id: BodyId,
        inputs: &[WheelInput],
    ) -> Result<(), CommandError> {
        self.enabled(id)?;
        self.registry.check_wheels(id, inputs.len())?;
        self.engine.set_wheels(id, inputs);
        Ok(())
    }
}
