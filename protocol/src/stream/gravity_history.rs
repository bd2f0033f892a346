//! The present and earlier gravity of a scene.
//!
//! A track keeps the gravity of its origin tick: both ends look it up by that tick.

use alloc::vec::Vec;

use glam::{DVec3, Vec3};
use rhumb_reckoning::{TRACK_AGE_MAX, Tick};

/// Gravity by the tick from which on it acts.
#[derive(Clone, Debug)]
pub(crate) struct GravityHistory {
    /// Rising ticks; never empty.
    changes: Vec<(Tick, DVec3)>,
}

impl GravityHistory {
    pub(crate) fn new(gravity: Vec3) -> Self {
        Self {
            changes: alloc::vec![(Tick::ZERO, gravity.as_dvec3())],
        }
    }

    /// The gravity of tracks with this origin, m/s², world frame.
    #[inline]
    pub(crate) fn at(&self, origin: Tick) -> DVec3 {
        // Most scenes never change their gravity.
        if let [(_, gravity)] = self.changes[..] {
            return gravity;
        }
        self.changes
            .iter()
            .rev()
            .find(|(since, _)| *since <= origin)
            .map_or(self.changes[0].1, |(_, gravity)| *gravity)
    }

    /// The gravity and the first tick of each change, oldest first. The first entry also holds for all earlier ticks.
    pub(crate) fn changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        let since = |place: usize, tick: Tick| if place == 0 { Tick::ZERO } else { tick };
        self.changes
            .iter()
            .enumerate()
            .map(move |(place, (tick, gravity))| (since(place, *tick), gravity.as_vec3()))
    }

    /// Changes the gravity from `since` on and drops entries that no track can refer to.
    pub(crate) fn change(&mut self, since: Tick, gravity: Vec3) {
        self.changes.retain(|(earlier, _)| *earlier < since);
        let oldest_needed = since.before(TRACK_AGE_MAX).unwrap_or_default();
        let still_needed = self
            .changes
            .iter()
            .rposition(|(earlier, _)| *earlier <= oldest_needed)
            .unwrap_or(0);
        self.changes.drain(..still_needed);
        self.changes.push((since, gravity.as_dvec3()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_track_keeps_the_gravity_of_its_origin() {
        let mut gravity_history = GravityHistory::new(Vec3::NEG_Y);
        gravity_history.change(Tick::new(10), Vec3::X);
        gravity_history.change(Tick::new(10), Vec3::Z);
        assert_eq!(gravity_history.at(Tick::new(9)), DVec3::NEG_Y);
        assert_eq!(gravity_history.at(Tick::new(10)), DVec3::Z);
    }

    #[test]
    fn replayed_changes_give_the_same_gravity() {
        let mut gravity_history = GravityHistory::new(Vec3::NEG_Y);
        for (tick, gravity) in [(100, Vec3::X), (200, Vec3::ZERO), (4_000, Vec3::Z)] {
            gravity_history.change(Tick::new(tick), gravity);
        }
        let mut replayed = GravityHistory::new(Vec3::Z);
        for (since, gravity) in gravity_history.changes() {
            replayed.change(since, gravity);
        }
        for tick in 0..5_000 {
            assert_eq!(
                replayed.at(Tick::new(tick)),
                gravity_history.at(Tick::new(tick))
            );
        }
    }

    #[test]
    fn unreferenced_gravity_is_forgotten() {
        let mut gravity_history = GravityHistory::new(Vec3::NEG_Y);
        for tick in 0..10_000 {
            gravity_history.change(Tick::new(tick), Vec3::X);
        }
        assert!(gravity_history.changes.len() <= TRACK_AGE_MAX.count() as usize + 2);
    }
}
