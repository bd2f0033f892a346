//! The bound on bodies that overlap.
//!
//! A step cannot be cancelled: one that would meet too many pairs of bodies for the first time is not begun, and a body that
//! would bring them is not added. A scene without the bound counts nothing, so that a log is replayed under any limit.

use rhumb_protocol::scene::CommandError;
use rhumb_reckoning::BodyState;

use super::{Scene, SceneFault};
use crate::engine::BodyProperties;

impl Scene {
    /// Bounds the pairs of bodies that a step may meet for the first time, as the engine counts them.
    ///
    /// A body that brings more is refused. A step that other commands, or motion, bring more to fails with
    /// [`SceneFault::TooCrowded`], and nothing has changed.
    pub fn bound_crowding(&mut self, limit: u32) {
        self.crowding_max = Some(limit);
        self.engine.count_crowding(limit);
    }

    /// Refuses a step that would meet too many pairs.
    pub(super) fn check_crowding(&self) -> Result<(), SceneFault> {
        let pairs = self.engine.crowding();
        match self.crowding_max.filter(|limit| pairs > u64::from(*limit)) {
            Some(limit) => Err(SceneFault::TooCrowded { pairs, limit }),
            None => Ok(()),
        }
    }

    /// Refuses a body that would bring too many pairs.
    pub(super) fn check_crowding_with(
        &self,
        body: &BodyProperties,
        motion: &BodyState,
    ) -> Result<(), CommandError> {
        let Some(limit) = self.crowding_max else {
            return Ok(());
        };
        let pairs = self.engine.crowding() + self.engine.crowding_with(body, motion);
        if pairs > u64::from(limit) {
            return Err(CommandError::TooCrowded);
        }
        Ok(())
    }
}
