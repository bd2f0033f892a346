//! The poses of all bodies, side by side, at one moment.
//!
//! A function of the tracks and the time: computing it twice for one moment gives the same. A body that rests costs
//! nothing until it is said to move. Invariant: the arrays have one length, and `places` points into them.

use std::num::NonZeroU32;

use glam::{DQuat, DVec3, Quat, Vec3};
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{Anchor, BodyId, Correction, Motion, Pose, Seconds, Ticks, Twist};

use crate::render_params::RenderParams;
use crate::render_time::RenderTime;

/// What a simulator reads each frame.
#[derive(Debug, Default)]
pub struct View {
    ids: Vec<BodyId>,
    positions: Vec<Vec3>,
    rotations: Vec<Quat>,
    linear: Vec<Vec3>,
    angular: Vec<Vec3>,
    resting: Vec<bool>,
    /// While views glide, as many as bodies; none else.
    corrections: Vec<Correction>,
    /// One more than the place of each body, by its index.
    places: Vec<Option<NonZeroU32>>,
    changed: Vec<u32>,
    removed: Vec<BodyId>,
    touched: Vec<u32>,
    time: Option<RenderTime>,
    /// The caller's time of the last look.
    looked: Seconds,
}

/// Moving bodies that are asked for together.
const LANES: usize = 64;

impl View {
    /// The bodies, in no order that means anything.
    #[must_use]
    pub fn ids(&self) -> &[BodyId] {
        &self.ids
    }

    /// Centres of mass, metres, world frame.
    #[must_use]
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Rotations body → world.
    #[must_use]
    pub fn rotations(&self) -> &[Quat] {
        &self.rotations
    }

    /// Linear velocities as shown, m/s; zero for a body at rest.
    #[must_use]
    pub fn linear_velocities(&self) -> &[Vec3] {
        &self.linear
    }

    /// Angular velocities as shown, rad/s; zero for a body at rest.
    #[must_use]
    pub fn angular_velocities(&self) -> &[Vec3] {
        &self.angular
    }

    /// Whether each body was said to lie still: its pose stays as it is until the body is spoken of again. One that the
    /// engine has put to sleep lies where the engine left it, to the bit, or, if it was woken since and sleeps again, within
    /// tolerance of there.
    #[must_use]
    pub fn resting(&self) -> &[bool] {
        &self.resting
    }

    /// Places whose pose differs from the last view's, each once; a simulator need not write any other.
    pub fn changed(&self) -> impl Iterator<Item = usize> {
        self.changed.iter().map(|place| *place as usize)
    }

    /// Bodies that went since the last view.
    #[must_use]
    pub fn removed(&self) -> &[BodyId] {
        &self.removed
    }

    /// Where a body is in the arrays of this view.
    #[must_use]
    pub fn place(&self, id: BodyId) -> Option<usize> {
        let place = self.place_of(id.index())?;
        (self.ids[place] == id).then_some(place)
    }

    /// A body's centre of mass, metres, world frame; none for a body that is not in this view.
    #[must_use]
    pub fn position(&self, id: BodyId) -> Option<Vec3> {
        self.place(id).map(|place| self.positions[place])
    }

    /// A body's rotation body → world; none for a body that is not in this view.
    #[must_use]
    pub fn rotation(&self, id: BodyId) -> Option<Quat> {
        self.place(id).map(|place| self.rotations[place])
    }

    /// The moment that it shows; none before the first.
    #[must_use]
    pub const fn time(&self) -> Option<RenderTime> {
        self.time
    }

    /// Computes the view of another moment. The client does it in each frame.
    pub fn refresh(&mut self, stream: &mut Subscriber, render_params: &RenderParams) {
        self.changed.clear();
        self.removed.clear();
        let mut touched = std::mem::take(&mut self.touched);
        touched.clear();
        stream.drain_changed(&mut touched);
        touched.sort_unstable();
        touched.dedup();
        self.make_room(&touched, render_params);
        for index in &touched {
            self.follow_body(*index, stream, render_params);
        }
        // A first look touches all bodies; hardly one after it does.
        let room = (self.ids.len() / 16).max(2 * touched.len());
        if touched.capacity() > 2 * room {
            touched.shrink_to(room);
        }
        self.touched = touched;
        let mut moving = [(0, BodyId::new(0, 0)); LANES];
        let mut waiting = 0;
        for place in 0..self.ids.len() {
            let gliding =
                render_params.smooth && !self.corrections[place].is_over(render_params.now);
            if (!self.resting[place] || gliding) && !self.show_still(place, stream, render_params) {
                moving[waiting] = (place as u32, self.ids[place]);
                waiting += 1;
            }
            if waiting == LANES {
                self.show_moving(&moving, stream, render_params);
                waiting = 0;
            }
        }
        self.show_moving(&moving[..waiting], stream, render_params);
        // Shown time never goes back.
        stream.forget_before(render_params.at.tick);
        self.time = Some(render_params.at);
        self.looked = render_params.now;
    }

    /// Sees to it that the tables have room for what comes, and little more.
    fn make_room(&mut self, touched: &[u32], render_params: &RenderParams) {
        let unknown = |index: &&u32| self.place_of(**index).is_none();
        let coming = touched.iter().filter(unknown).count();
        if let Some(last) = touched.last() {
            let end = (*last as usize + 1).saturating_sub(self.places.len());
            self.places.reserve_exact(end);
        }
        self.ids.reserve_exact(coming);
        self.positions.reserve_exact(coming);
        self.rotations.reserve_exact(coming);
        self.linear.reserve_exact(coming);
        self.angular.reserve_exact(coming);
        self.resting.reserve_exact(coming);
        self.changed.reserve_exact(self.ids.len() + coming);
        if render_params.smooth {
            self.corrections.resize(self.ids.len(), Correction::NONE);
        } else {
            self.corrections = Vec::new();
        }
    }

    /// Shows bodies that move, several side by side.
    fn show_moving(
        &mut self,
        moving: &[(u32, BodyId)],
        stream: &Subscriber,
        render_params: &RenderParams,
    ) {
        if render_params.at.fraction == 0.0 {
            stream.predict_each(moving, render_params.at.tick, |place, predicted| {
                self.show(place as usize, &predicted, render_params);
            });
            return;
        }
        for (place, id) in moving {
            if let Some(predicted) = predicted(stream, *id, render_params.at) {
                self.show(*place as usize, &predicted, render_params);
            }
        }
    }

    fn place_of(&self, index: u32) -> Option<usize> {
        let place = (*self.places.get(index as usize)?)?;
        Some(place.get() as usize - 1)
    }

    /// A body came, went or was spoken of.
    fn follow_body(&mut self, index: u32, stream: &Subscriber, render_params: &RenderParams) {
        let Some(id) = stream.body(index) else {
            self.take_out(index);
            return;
        };
        match self.place_of(index) {
            Some(place) if self.ids[place] == id => {
                if render_params.smooth
                    && let Some(predicted) = predicted(stream, id, render_params.at)
                {
                    let shown = self.carried_on(place, render_params.now);
                    self.corrections[place] =
                        Correction::between(render_params.now, &shown, &predicted);
                }
                // Shown below if it moves; if it has come to rest, this is the last time.
                self.resting[place] = false;
            }
            Some(_) => {
                self.take_out(index);
                self.put_in(id, render_params);
            }
            None => self.put_in(id, render_params),
        }
    }

    fn put_in(&mut self, id: BodyId, render_params: &RenderParams) {
        let index = id.index() as usize;
        if index >= self.places.len() {
            self.places.resize(index + 1, None);
        }
        self.ids.push(id);
        self.places[index] = NonZeroU32::new(self.ids.len() as u32);
        // NaN differs from everything, so that the first pose counts as a change.
        self.positions.push(Vec3::NAN);
        self.rotations.push(Quat::IDENTITY);
        self.linear.push(Vec3::ZERO);
        self.angular.push(Vec3::ZERO);
        self.resting.push(false);
        if render_params.smooth {
            self.corrections.push(Correction::NONE);
        }
    }

    fn take_out(&mut self, index: u32) {
        let Some(place) = self.place_of(index) else {
            return;
        };
        self.places[index as usize] = None;
        self.removed.push(self.ids.swap_remove(place));
        self.positions.swap_remove(place);
        self.rotations.swap_remove(place);
        self.linear.swap_remove(place);
        self.angular.swap_remove(place);
        self.resting.swap_remove(place);
        if !self.corrections.is_empty() {
            self.corrections.swap_remove(place);
        }
        if let Some(moved) = self.ids.get(place) {
            self.places[moved.index() as usize] = NonZeroU32::new(place as u32 + 1);
        }
    }

    /// Notes whether a body lies still; shows it if it does so to the bit, or is not there. `false`: it must be computed.
    fn show_still(
        &mut self,
        place: usize,
        stream: &Subscriber,
        render_params: &RenderParams,
    ) -> bool {
        let id = self.ids[place];
        match stream.is_resting(id) {
            None => return true,
            Some(false) => {
                self.resting[place] = false;
                return false;
            }
            Some(true) => {}
        }
        let Some(track) = stream.track(id) else {
            return true;
        };
        // A view that lies behind the stream does not show a rest before it began.
        let begun = track.origin <= render_params.at.tick;
        let gliding = render_params.smooth && !self.corrections[place].is_over(render_params.now);
        let still = begun && !gliding;
        self.resting[place] = still;
        match &track.anchor {
            // The engine's own bits, not what arithmetic makes of them.
            Anchor::Exact(body_state) if still => {
                self.linear[place] = Vec3::ZERO;
                self.angular[place] = Vec3::ZERO;
                let position = Vec3::from_array(body_state.position());
                self.put(place, position, Quat::from_array(body_state.rotation()));
                true
            }
            _ => false,
        }
    }

    /// Shows a body that is predicted to move so.
    fn show(&mut self, place: usize, predicted: &Motion, render_params: &RenderParams) {
        let glide = render_params
            .smooth
            .then(|| self.corrections[place].applied(render_params.now, predicted));
        let motion = glide.as_ref().unwrap_or(predicted);
        self.linear[place] = motion.twist().linear.as_vec3();
        self.angular[place] = motion.twist().angular.as_vec3();
        let pose = motion.pose();
        self.put(place, pose.position.as_vec3(), pose.rotation.as_quat());
    }

    /// Writes a pose, and notes whether it is another.
    fn put(&mut self, place: usize, position: Vec3, rotation: Quat) {
        if self.positions[place] != position || self.rotations[place] != rotation {
            self.positions[place] = position;
            self.rotations[place] = rotation;
            self.changed.push(place as u32);
        }
    }

    /// Where a body would be shown now had nothing been said of it: the motion of the last look, carried on.
    ///
    /// So a glide holds only what belief jumped by, however long ago the last look was.
    fn carried_on(&self, place: usize, now: Seconds) -> Motion {
        let passed = (now.seconds() - self.looked.seconds()).max(0.0);
        let twist = Twist {
            linear: self.linear[place].as_dvec3(),
            angular: self.angular[place].as_dvec3(),
        };
        let turn = DQuat::from_scaled_axis(twist.angular * passed);
        let pose = Pose {
            position: self.positions[place].as_dvec3() + twist.linear * passed,
            rotation: (turn * self.rotations[place].as_dquat()).normalize(),
        };
        Motion::new(pose, twist).unwrap_or(Motion::IDENTITY)
    }
}

/// What is predicted between two ticks: for display, halfway is halfway.
fn predicted(stream: &Subscriber, id: BodyId, at: RenderTime) -> Option<Motion> {
    let first = stream.predicted_motion(id, at.tick)?;
    if at.fraction == 0.0 {
        return Some(first);
    }
    let second = stream.predicted_motion(id, at.tick + Ticks::new(1))?;
    let (a, b) = (first.pose(), second.pose());
    let pose = Pose {
        position: DVec3::lerp(a.position, b.position, at.fraction),
        rotation: DQuat::slerp(a.rotation, b.rotation, at.fraction),
    };
    let twist = Twist {
        linear: DVec3::lerp(first.twist().linear, second.twist().linear, at.fraction),
        angular: DVec3::lerp(first.twist().angular, second.twist().angular, at.fraction),
    };
    Motion::new(pose, twist).ok()
}
