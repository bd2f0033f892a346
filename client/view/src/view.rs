//! The poses of all bodies at one moment, in parallel arrays.
//!
//! The view is a function of the tracks and the time: a second computation for the same moment gives the same view. A
//! resting body costs nothing until its track moves. Invariant: the arrays have one length, and `places` points into
//! them.

use std::num::NonZeroU32;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{Quat, Vec3};
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_reckoning::{Anchor, BodyId, Correction, Motion, Pose, Seconds, Tick, Ticks, Twist};

use crate::moment::Movers;
use crate::moment::{Leap, MomentMotion, RenderTime, ShownPose, is_orphaned, shown_bound};

/// Parameters for computing a view.
#[derive(Clone, Copy, Debug)]
pub struct RenderParams {
    /// The moment to show.
    pub at: RenderTime,
    /// The caller's own time, which times the smoothing of corrections.
    pub now: Seconds,
    /// True if corrections are smoothed.
    pub smooth: bool,
    /// The time from one tick to the next.
    pub step: Seconds,
}

/// The poses and velocities of all bodies at one moment, for a simulator to read each frame.
#[derive(Debug, Default)]
pub struct View {
    ids: Vec<BodyId>,
    positions: Vec<Vec3>,
    rotations: Vec<Quat>,
    linear: Vec<Vec3>,
    angular: Vec<Vec3>,
    resting: Vec<bool>,
    /// One for each body while corrections are smoothed; empty otherwise.
    corrections: Vec<Correction>,
    /// The first ticks of the tracks that the last refresh showed; beside the corrections.
    origins: Vec<Tick>,
    /// By body index: the body's place in the arrays, plus one.
    places: Vec<Option<NonZeroU32>>,
    movers: Movers,
    changed: Vec<u32>,
    removed: Vec<BodyId>,
    touched: Vec<u32>,
    /// True if the next refresh reads other tracks, which may lack bodies of this view.
    begins_anew: bool,
    time: Option<RenderTime>,
    /// The time from one tick to the next.
    step: Seconds,
    refreshes: u64,
    /// True once a bound was asked for; the clock of the view takes it back.
    bounds_asked: AtomicBool,
}

/// Number of moving bodies that are predicted in one call.
const LANES: usize = 64;

impl View {
    /// The bodies, in arbitrary order.
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

    /// True for each body that rests: its pose does not change until the next update or event of the body.
    ///
    /// A body that the engine has put to sleep has the engine's pose to the bit. If it was woken and sleeps again, its
    /// pose is within tolerance of the engine's.
    #[must_use]
    pub fn resting(&self) -> &[bool] {
        &self.resting
    }

    /// Places whose pose differs from that of the last view, each once; a simulator need not write any other.
    pub fn changed(&self) -> impl Iterator<Item = usize> {
        self.changed.iter().map(|place| *place as usize)
    }

    /// Bodies of the last view that are not in this one: removed, or, of a member by cells, in no cell that it takes.
    #[must_use]
    pub fn removed(&self) -> &[BodyId] {
        &self.removed
    }

    /// Place of a body in the arrays of this view; `None` for a body that is not in this view.
    #[must_use]
    pub fn place(&self, id: BodyId) -> Option<usize> {
        let place = self.place_of(id.index())?;
        (self.ids[place] == id).then_some(place)
    }

    /// A body's centre of mass, metres, world frame; `None` for a body that is not in this view.
    #[must_use]
    pub fn position(&self, id: BodyId) -> Option<Vec3> {
        self.place(id).map(|place| self.positions[place])
    }

    /// A body's rotation body → world; `None` for a body that is not in this view.
    #[must_use]
    pub fn rotation(&self, id: BodyId) -> Option<Quat> {
        self.place(id).map(|place| self.rotations[place])
    }

    /// The moment of this view; `None` before the first refresh.
    #[must_use]
    pub const fn time(&self) -> Option<RenderTime> {
        self.time
    }

    /// The time from one tick to the next.
    pub(crate) const fn step(&self) -> Seconds {
        self.step
    }

    /// Number of refreshes so far; the view changes only when it grows.
    #[must_use]
    pub const fn refreshes(&self) -> u64 {
        self.refreshes
    }

    /// Bound on the error of the pose that this view shows: how far any point of the body may be from its true place at
    /// the moment of the view. `None` for a body that is not in this view.
    ///
    /// The bound is that of the stream at this moment, plus the distance from the shown pose to the one that the stream
    /// has for it now: what a glide has still to cover, or an update that was read since the view was computed.
    ///
    /// Between two published ticks of a longer publish interval it is known while one track leads from the first to the
    /// second.
    ///
    /// A free-running scene in which nothing happens says so in growing pauses. A program that asks for bounds makes its
    /// client ask the server meanwhile, some ten times a second, if the delay of the view is long enough for the answers.
    ///
    /// There is no stream while a client resumes its session: the view stands still, and no bound is known.
    #[must_use]
    pub fn error_bound(&self, stream: Option<&Subscriber>, id: BodyId) -> Option<ErrorBound> {
        self.bounds_asked.store(true, Ordering::Relaxed);
        let place = self.place(id)?;
        let Some(stream) = stream else {
            return Some(self.unknown());
        };
        let shown = ShownPose {
            position: self.positions[place],
            rotation: self.rotations[place],
        };
        Some(shown_bound(stream, id, &shown, (self.time?, self.step)))
    }

    /// No bound is known since the moment shown.
    pub(crate) fn unknown(&self) -> ErrorBound {
        let since = self.time.map_or(Tick::ZERO, |time| time.tick);
        ErrorBound::Unknown { since }
    }

    /// True if a bound was asked for since the last call.
    pub(crate) fn take_bounds_asked(&mut self) -> bool {
        std::mem::take(self.bounds_asked.get_mut())
    }

    /// Prepares the next refresh for tracks that do not continue those before, such as a resumed session's: bodies that they
    /// lack are removed.
    pub const fn begin_anew(&mut self) {
        self.begins_anew = true;
    }

    /// Computes the view of a moment. The client calls this in each frame.
    pub fn refresh(&mut self, stream: &mut Subscriber, render_params: &RenderParams) {
        self.changed.clear();
        self.removed.clear();
        let mut touched = std::mem::take(&mut self.touched);
        touched.clear();
        stream.drain_changed(&mut touched);
        stream.coming_and_going(&mut touched);
        if std::mem::take(&mut self.begins_anew) {
            touched.extend(self.ids.iter().map(|id| id.index()));
        }
        touched.sort_unstable();
        touched.dedup();
        self.reserve(&touched, render_params);
        for index in &touched {
            self.update_body(*index, stream, render_params);
        }
        // The first refresh touches all bodies, later ones few: memory for all of them is given back.
        let capacity = (self.ids.len() / 16).max(2 * touched.len());
        if touched.capacity() > 2 * capacity {
            touched.shrink_to(capacity);
        }
        self.touched = touched;
        let mut moving = [(0, BodyId::new(0, 0)); LANES];
        let mut filled = 0;
        if self
            .time
            .is_some_and(|time| time.tick > render_params.at.tick)
        {
            self.movers.clear();
        }
        for place in 0..self.ids.len() {
            if self.movers.has(place) {
                continue;
            }
            let gliding =
                render_params.smooth && !self.corrections[place].is_over(render_params.now);
            if (!self.resting[place] || gliding) && !self.show_still(place, stream, render_params) {
                match stream.free_track(self.ids[place], render_params.at.tick) {
                    Some(track) => self.movers.add(place, &track),
                    None => {
                        moving[filled] = (place as u32, self.ids[place]);
                        filled += 1;
                    }
                }
            }
            if filled == LANES {
                self.show_moving(&moving, stream, render_params);
                filled = 0;
            }
        }
        self.show_moving(&moving[..filled], stream, render_params);
        self.show_movers(stream, render_params);
        // Shown time never goes back, so that older tracks are not needed.
        stream.forget_before(render_params.at.tick);
        self.time = Some(render_params.at);
        self.step = render_params.step;
        self.refreshes += 1;
    }

    /// Reserves exactly the capacity for new bodies: the amortised growth of `Vec` would waste memory.
    fn reserve(&mut self, touched: &[u32], render_params: &RenderParams) {
        let unknown = |index: &&u32| self.place_of(**index).is_none();
        let added = touched.iter().filter(unknown).count();
        if let Some(last) = touched.last() {
            let end = (*last as usize + 1).saturating_sub(self.places.len());
            self.places.reserve_exact(end);
        }
        self.ids.reserve_exact(added);
        self.positions.reserve_exact(added);
        self.rotations.reserve_exact(added);
        self.linear.reserve_exact(added);
        self.angular.reserve_exact(added);
        self.resting.reserve_exact(added);
        self.changed.reserve_exact(self.ids.len() + added);
        if render_params.smooth {
            self.corrections.resize(self.ids.len(), Correction::NONE);
            self.origins.resize(self.ids.len(), Tick::ZERO);
        } else {
            self.corrections = Vec::new();
            self.origins = Vec::new();
        }
    }

    /// Begins the next view of bodies that other views show.
    pub(crate) fn begin_gathering(&mut self, render_params: &RenderParams) {
        self.changed.clear();
        self.removed.clear();
        self.time = Some(render_params.at);
        self.step = render_params.step;
        self.refreshes += 1;
    }

    /// Shows a body as another view has it.
    pub(crate) fn copy(&mut self, place: usize, from: &Self, place_there: usize) {
        self.linear[place] = from.linear[place_there];
        self.angular[place] = from.angular[place_there];
        self.resting[place] = from.resting[place_there];
        let (position, rotation) = (from.positions[place_there], from.rotations[place_there]);
        self.put(place, position, rotation);
    }

    /// Writes the predicted motions of several moving bodies.
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
            if let Some(predicted) = predicted(stream, *id, render_params) {
                self.show(*place as usize, &predicted, render_params);
            }
        }
    }

    /// Writes the predicted motions of the bodies that are kept side by side.
    fn show_movers(&mut self, stream: &Subscriber, render_params: &RenderParams) {
        let movers = std::mem::take(&mut self.movers);
        movers.predict(stream, render_params.at, |place, predicted| {
            if render_params.smooth {
                self.show(place, &predicted, render_params);
            } else {
                self.show_as_it_is(place, &predicted);
            }
        });
        self.movers = movers;
    }

    /// The place of the body of this index, whatever its generation.
    pub(crate) fn place_of(&self, index: u32) -> Option<usize> {
        let place = (*self.places.get(index as usize)?)?;
        Some(place.get() as usize - 1)
    }

    /// Updates the arrays for a body that was added, removed or updated.
    fn update_body(&mut self, index: u32, stream: &Subscriber, render_params: &RenderParams) {
        let Some(id) = stream.body_at(index, render_params.at.tick) else {
            self.remove(index);
            return;
        };
        match self.place_of(index) {
            Some(place) if self.ids[place] == id => {
                if render_params.smooth {
                    self.begin_correction(place, stream, render_params);
                }
                self.movers.forget(place);
                // This refresh then computes the pose, for the last time if the body has come to rest.
                self.resting[place] = false;
            }
            Some(_) => {
                self.remove(index);
                self.insert_smoothed(id, render_params);
            }
            None => self.insert_smoothed(id, render_params),
        }
        if render_params.smooth
            && let Some(place) = self.place_of(index)
            && let Some(shown) = stream.track_at(id, render_params.at.tick)
        {
            self.origins[place] = shown.track.origin;
        }
    }

    fn insert_smoothed(&mut self, id: BodyId, render_params: &RenderParams) {
        self.insert(id);
        if render_params.smooth {
            self.corrections.push(Correction::NONE);
            self.origins.push(Tick::ZERO);
        }
    }

    /// Adds a body at the last place, without a pose.
    pub(crate) fn insert(&mut self, id: BodyId) {
        let index = id.index() as usize;
        if index >= self.places.len() {
            self.places.resize(index + 1, None);
        }
        self.ids.push(id);
        self.places[index] = NonZeroU32::new(self.ids.len() as u32);
        // NaN differs from every number, so that the first pose counts as a change.
        self.positions.push(Vec3::NAN);
        self.rotations.push(Quat::IDENTITY);
        self.linear.push(Vec3::ZERO);
        self.angular.push(Vec3::ZERO);
        self.resting.push(false);
    }

    /// Takes a body out. That of the last place moves to its place.
    pub(crate) fn remove(&mut self, index: u32) {
        let Some(place) = self.place_of(index) else {
            return;
        };
        self.places[index as usize] = None;
        self.movers.swap_remove(place, self.ids.len() - 1);
        self.removed.push(self.ids.swap_remove(place));
        self.positions.swap_remove(place);
        self.rotations.swap_remove(place);
        self.linear.swap_remove(place);
        self.angular.swap_remove(place);
        self.resting.swap_remove(place);
        if !self.corrections.is_empty() {
            self.corrections.swap_remove(place);
            self.origins.swap_remove(place);
        }
        if let Some(moved) = self.ids.get(place) {
            self.places[moved.index() as usize] = NonZeroU32::new(place as u32 + 1);
        }
    }

    /// Begins a glide from the shown pose to the predicted one if its newest track changes that. A body that jumps does not
    /// glide, and none does after a pause: the first frame shows the present.
    fn begin_correction(
        &mut self,
        place: usize,
        stream: &Subscriber,
        render_params: &RenderParams,
    ) {
        let (id, at) = (self.ids[place], render_params.at);
        if is_orphaned(stream, id, at) {
            return;
        }
        let (Some(predicted), Some(known)) = (
            predicted(stream, id, render_params),
            stream.track_at(id, at.tick),
        ) else {
            return;
        };
        let Some(passed) = self.passed(render_params) else {
            self.corrections[place] = Correction::NONE;
            return;
        };
        if !known.is_newest {
            return;
        }
        let shown = self.extrapolated(place, passed);
        let jumps = new_jump(stream, id, self.origins[place], render_params);
        let jumps = jumps.unwrap_or_else(|| {
            let age = (at.ticks() - known.track.origin.value() as f64).max(0.0);
            let leap = Leap {
                before: &shown,
                after: &predicted,
                within: Seconds::new((age + 1.0) * render_params.step.seconds()),
            };
            leap.is_jump(stream, id, at.tick)
        });
        self.corrections[place] = match jumps {
            true => Correction::NONE,
            false => Correction::between(render_params.now, &shown, &predicted),
        };
    }

    /// Updates whether a body rests, and writes the pose of a body at exact rest. `false`: the pose must be predicted.
    /// An orphaned body keeps its pose.
    fn show_still(
        &mut self,
        place: usize,
        stream: &Subscriber,
        render_params: &RenderParams,
    ) -> bool {
        let (id, at) = (self.ids[place], render_params.at);
        if stream.moves_freely_at(id, at.tick) {
            self.resting[place] = false;
            return false;
        }
        let Some(shown) = stream.track_at(id, at.tick) else {
            return true;
        };
        if !shown.track.is_resting() {
            self.resting[place] = false;
            // Its update follows the removal of its parent; until then it stays where it is, if it was anywhere.
            let has_pose = !self.positions[place].is_nan();
            return has_pose && is_orphaned(stream, id, at);
        }
        // A view behind the stream shows a rest from the tick of its track to that of the next one.
        let begun = shown.is_newest && shown.track.origin <= at.tick;
        let gliding = render_params.smooth && !self.corrections[place].is_over(render_params.now);
        let still = begun && !gliding;
        self.resting[place] = still;
        match &shown.track.anchor {
            // The engine's bits are copied, because a computation would round them.
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

    /// Writes a body's predicted motion, with its correction if corrections are smoothed.
    fn show(&mut self, place: usize, predicted: &Motion, render_params: &RenderParams) {
        let glide = render_params
            .smooth
            .then(|| self.corrections[place].applied(render_params.now, predicted));
        self.show_as_it_is(place, glide.as_ref().unwrap_or(predicted));
    }

    /// Writes a body's motion.
    #[inline]
    pub(crate) fn show_as_it_is(&mut self, place: usize, motion: &Motion) {
        self.linear[place] = motion.twist().linear.as_vec3();
        self.angular[place] = motion.twist().angular.as_vec3();
        let pose = motion.pose();
        self.put(place, pose.position.as_vec3(), pose.rotation.as_quat());
    }

    /// Writes a pose, and records a change.
    #[inline]
    fn put(&mut self, place: usize, position: Vec3, rotation: Quat) {
        if self.positions[place] != position || self.rotations[place] != rotation {
            self.positions[place] = position;
            self.rotations[place] = rotation;
            self.changed.push(place as u32);
        }
    }

    /// Time of the scene since the last refresh; `None` if it is longer than a glide.
    fn passed(&self, render_params: &RenderParams) -> Option<Seconds> {
        let ticks = render_params.at.ticks() - self.time?.ticks();
        let passed = ticks * render_params.step.seconds();
        (0.0..=Correction::SPAN.seconds())
            .contains(&passed)
            .then_some(Seconds::new(passed))
    }

    /// The motion of the last refresh, extrapolated by its velocities: a correction that begins there contains only the
    /// jump of the prediction.
    fn extrapolated(&self, place: usize, passed: Seconds) -> Motion {
        let passed = passed.seconds();
        let twist = Twist {
            linear: self.linear[place].as_dvec3(),
            angular: self.angular[place].as_dvec3(),
        };
        let turn = twist.turn_over(Seconds::new(passed));
        let pose = Pose {
            position: self.positions[place].as_dvec3() + twist.linear * passed,
            rotation: (turn * self.rotations[place].as_dquat()).normalize(),
        };
        Motion::new(pose, twist).unwrap_or(Motion::IDENTITY)
    }
}

/// True if a body jumped at the first tick of one of the tracks since the one that began at `origin`; `None` if they are not
/// kept down to that one, such as those before a change of the body.
fn new_jump(
    stream: &Subscriber,
    id: BodyId,
    origin: Tick,
    render_params: &RenderParams,
) -> Option<bool> {
    let mut tick = render_params.at.tick;
    while stream.track_at(id, tick)?.track.origin != origin {
        let replacement = stream.replacement(id, tick)?;
        if Leap::at(&replacement, render_params.step).is_jump(stream, id, replacement.at) {
            return Some(true);
        }
        tick = replacement.at.before(Ticks::new(1))?;
    }
    Some(false)
}

/// The predicted motion of a body at the moment of a view.
fn predicted(stream: &Subscriber, id: BodyId, render_params: &RenderParams) -> Option<Motion> {
    let at = render_params.at;
    MomentMotion::of(stream, id, at, render_params.step)?.motion(at)
}
