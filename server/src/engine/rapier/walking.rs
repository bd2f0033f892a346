//! Moves kinematic bodies before a step: characters, and the others.
//!
//! A character goes as far as the world lets it; a body that is none goes where its commands say.

use rhumb_reckoning::Pose;

use super::{RapierEngine, translate};
use crate::engine::kinematic_target::KinematicStep;

impl RapierEngine {
    /// Moves the characters, but not those whose commands put them elsewhere.
    pub(super) fn walk(&mut self) {
        self.characters.begin_step();
        for id in self.characters.ids() {
            let Some(place) = self.place(id) else {
                continue;
            };
            if self.body(place).is_none_or(|body| !body.is_enabled()) {
                continue;
            }
            let target = self.kinematic_targets.get_mut(&id);
            let kept = target.as_ref().map(|target| target.keeps());
            if kept == Some(None) {
                self.characters.halt(id);
                continue;
            }
            let twist = kept.flatten().unwrap_or_default();
            let velocity = translate::narrow_twist(&twist).0;
            let walker = (id, place.handle);
            let moved = self.characters.advance(&mut self.world, walker, velocity);
            let body = &mut self.world.bodies[place.handle];
            let mut next = *body.position();
            next.translation += moved;
            if let Some(target) = target {
                let there = Pose {
                    position: next.translation.as_dvec3(),
                    rotation: target.turned(self.integrator),
                };
                target.arrive(there);
                next = translate::nearest(translate::narrow(&there), *body.rotation());
            }
            body.set_next_kinematic_position(next);
        }
    }

    /// Moves the kinematic bodies that are no characters, and the characters that commands put elsewhere.
    pub(super) fn move_kinematic(&mut self) {
        let integrator = self.integrator;
        self.kinematic_targets
            .retain(|_, kinematic_target| kinematic_target.is_needed(integrator));
        let mut jumped = Vec::new();
        for (id, kinematic_target) in &mut self.kinematic_targets {
            if self.characters.contains(*id) && kinematic_target.keeps().is_some() {
                continue;
            }
            let is_moving = kinematic_target.is_moving();
            let step = kinematic_target.advance(integrator);
            let place = self.places.get(id.index() as usize).copied().flatten();
            let body = place.and_then(|place| self.world.bodies.get_mut(place.handle));
            let Some((place, body)) = place.zip(body).filter(|_| is_moving) else {
                continue;
            };
            let next = translate::narrow(&step.pose());
            let next = translate::nearest(next, *body.rotation());
            if matches!(step, KinematicStep::Jump(_)) {
                jumped.push(place.handle);
                body.set_position(next, true);
            }
            body.set_next_kinematic_position(next);
        }
        for handle in jumped {
            translate::wake_touching(&mut self.world, handle);
        }
    }
}
