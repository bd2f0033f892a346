//! The view as the frames of a member show it.
//!
//! It is of a whole scene, or of the cells that the member takes. It chooses the moment, and whether corrections are
//! smoothed. Time is an argument; the session is the caller's.

use rhumb_protocol::limits::SILENCE_MS_MAX;
use rhumb_protocol::scene::{BodyDesc, Cell, SceneConfig, Stepping};
use rhumb_protocol::session::{ClientSession, Event, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Seconds, Tick, Ticks};

use crate::clocks::{SceneClock, ticks_or_none};
use crate::gathered_view::GatheredView;
use crate::moment::RenderTime;
use crate::view::{RenderParams, View};

/// Seconds that a free-running view predicts at most beyond the tick that should have been published by now. Then it
/// holds.
const PREDICT_SECONDS: f64 = 0.5;

/// Pause between two questions of a view that is held back.
const HELD_PAUSE: Span = Span::from_millis(100);

/// Ticks that a question for the watermark may wait for the frames of the program, there and back.
const FRAMES_TICKS: f64 = 2.0;

/// The options by which a free-running scene is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewOptions {
    /// Ticks that the view stays behind the newest tick that the server can have published, 0 to 3,600. A
    /// view takes any other number for zero.
    pub delay_ticks: f64,
    /// True if only whole ticks are shown.
    pub whole_ticks: bool,
    /// True if corrections are shown as short glides. A body that jumps does not glide.
    pub smooth: bool,
}

/// A view, and the clock that chooses its moment.
#[derive(Debug)]
pub struct LiveView {
    /// Of a whole scene, or of what is in no cell.
    of_scene: View,
    /// Of a member by cells: all that it takes.
    gathered: Option<GatheredView>,
    clock: SceneClock,
    config: SceneConfig,
    /// Its options; a change takes effect at the next view.
    pub options: ViewOptions,
}

impl LiveView {
    /// An empty view of a scene of this config.
    #[must_use]
    pub fn new(config: SceneConfig, options: ViewOptions) -> Self {
        Self {
            of_scene: View::default(),
            gathered: None,
            clock: SceneClock::new(config.integrator.rate),
            config,
            options,
        }
    }

    /// The config of the scene since its creation.
    #[must_use]
    pub const fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// The view as of the last call that computed it. That of a member by cells has all that it takes, each body once.
    #[must_use]
    pub const fn view(&self) -> &View {
        match &self.gathered {
            Some(gathered) => gathered.view(),
            None => &self.of_scene,
        }
    }

    /// The cell by which a body of the view is shown; `None` for one that is in no cell.
    #[must_use]
    pub fn cell_of(&self, id: BodyId) -> Option<Cell> {
        self.gathered.as_ref()?.cell_of(id)
    }

    /// Bound on the error of the pose that the view shows: see [`View::error_bound`]. `None` for a body that is not in the
    /// view.
    #[must_use]
    pub fn error_bound(&self, session: &ClientSession, id: BodyId) -> Option<ErrorBound> {
        match &self.gathered {
            Some(gathered) => gathered.error_bound(&self.of_scene, session, id),
            None => {
                let stream = session.replica().map(Replica::stream);
                self.of_scene.error_bound(stream, id)
            }
        }
    }

    /// The bound of each body of the view, in its order: see [`Self::error_bound`].
    pub fn error_bounds(&self, session: &ClientSession) -> impl Iterator<Item = ErrorBound> {
        let unknown = self.view().unknown();
        let bounds = self.view().ids().iter();
        bounds.map(move |id| self.error_bound(session, *id).unwrap_or(unknown))
    }

    /// The descriptor of a body of the view, as it is at the moment shown.
    #[must_use]
    pub fn body(&self, session: &ClientSession, id: BodyId) -> Option<BodyDesc> {
        let (copy, local) = self.copy_of(session, id)?;
        let tick = self.view().time().map_or(Tick::ZERO, |at| at.tick);
        let desc = copy.body_at(local, tick)?;
        Some(BodyDesc { id, ..desc })
    }

    /// The copy that the view shows a body of, and the body's id there: of a whole scene, whether or not the view has it.
    #[must_use]
    pub fn copy_of<'s>(
        &self,
        session: &'s ClientSession,
        id: BodyId,
    ) -> Option<(&'s Replica, BodyId)> {
        match &self.gathered {
            Some(gathered) => gathered.copy_of(session, id),
            None => Some((session.replica()?, id)),
        }
    }

    /// Learns from the events of the session: of the server's clock, and of a session that continues with other tracks.
    pub fn note(&mut self, event: &Event) {
        self.clock.note(event);
        if let Event::Resumed(_) = event {
            self.of_scene.begin_anew();
            if let Some(gathered) = &mut self.gathered {
                gathered.begin_anew();
            }
        }
    }

    /// Computes the view of the present moment. A lockstep scene stands still until a member advances it: its present is
    /// the newest complete tick.
    pub fn show_present(&mut self, session: &mut ClientSession, now: Instant) -> RenderTime {
        if self.config.stepping == Stepping::Lockstep {
            let complete = session.complete();
            let shown = self.view().time().map_or(Tick::ZERO, |at| at.tick);
            let at = RenderTime::at(complete.unwrap_or_default().max(shown));
            self.show(session, now, at, false);
            return at;
        }
        let step = self.config.integrator.rate.step().seconds();
        let stream = session.replica().map(Replica::stream);
        let known = stream.map_or(0.0, |stream| stream.watermark_tick().value() as f64);
        let silent = stream.map_or(0.0, |stream| stream.silent_ticks() as f64);
        // The next watermark is due at a published tick, when the silence has doubled or has reached the longest
        // allowed silence.
        let due = silent.min(f64::from(SILENCE_MS_MAX) / (1e3 * step));
        let publish_schedule = self.config.publish_schedule;
        let due = due.max(f64::from(publish_schedule.publish_interval.get()));
        let limit = known + due + PREDICT_SECONDS / step;
        let shown = self.clock.show(now, self.delay_ticks(), known, limit);
        let at = if self.options.whole_ticks {
            RenderTime::at(shown.tick)
        } else {
            shown
        };
        self.show(session, now, at, self.options.smooth);
        if self.clock.is_held() {
            // A member of a silent scene need not wait for what the server says next.
            session.query_watermark(now, HELD_PAUSE);
        }
        self.keep_known(session, now, due);
        at
    }

    /// Asks the server for its watermark if a program asks for bounds, and they would be unknown before the watermark that
    /// is `due` in so many ticks.
    fn keep_known(&mut self, session: &mut ClientSession, now: Instant, due: f64) {
        let mut is_asked = self.of_scene.take_bounds_asked();
        if let Some(gathered) = &mut self.gathered {
            is_asked |= gathered.take_bounds_asked();
        }
        let (Some(at), true) = (self.of_scene.time(), is_asked) else {
            return;
        };
        let step = self.config.integrator.rate.step().seconds();
        let round_trip = session.round_trip().as_nanos() as f64 / 1e9 / step;
        // Ticks that the view lies behind the watermark when it arrives.
        let spare = ticks_or_none(self.options.delay_ticks) - round_trip / 2.0;
        let Some(complete) = session.complete() else {
            return;
        };
        let known_for = complete.value() as f64 - at.ticks();
        // The next question comes in time if the answer of this one is lost.
        let pause = (spare / 2.0).max(1.0);
        if 0.0 < spare && spare < due && known_for < round_trip + pause + FRAMES_TICKS {
            session.query_watermark(now, Span::from_nanos((pause * step * 1e9) as u64));
        }
    }

    /// Computes the view of a moment.
    pub fn show(
        &mut self,
        session: &mut ClientSession,
        now: Instant,
        at: RenderTime,
        smooth: bool,
    ) {
        let instant = now;
        let now = Seconds::new(now.as_nanos() as f64 / 1e9);
        let Some(replica) = session.replica_mut() else {
            return;
        };
        let history = match self.config.stepping {
            Stepping::Lockstep => Ticks::ZERO,
            Stepping::FreeRunning => {
                // A view that has fallen behind needs the motions of more ticks.
                let behind = self
                    .clock
                    .server(instant)
                    .map_or(0.0, |server| server - at.ticks());
                let delay = ticks_or_none(self.options.delay_ticks);
                Ticks::new(delay.max(behind).ceil() as u32)
            }
        };
        replica.stream_mut().set_history(history);
        let step = self.config.integrator.rate.step();
        let render_params = RenderParams {
            at,
            now,
            smooth,
            step,
        };
        self.of_scene.refresh(replica.stream_mut(), &render_params);
        if session.cell_grid().is_some() || self.gathered.is_some() {
            for (_, copy) in session.cells_mut() {
                copy.stream_mut().set_history(history);
            }
            let gathered = self.gathered.get_or_insert_default();
            gathered.refresh(&self.of_scene, session, &render_params);
        }
    }

    /// Ticks by which a free-running view stays behind the server's clock: the delay of its options plus the scene's
    /// lookahead.
    #[must_use]
    pub fn delay_ticks(&self) -> f64 {
        ticks_or_none(self.options.delay_ticks)
            + f64::from(self.config.publish_schedule.lookahead.count())
    }

    /// Ticks by which the view lies behind the server's clock; `None` before the clock is known.
    #[must_use]
    pub fn behind_ticks(&self, now: Instant) -> Option<f64> {
        let shown = self.of_scene.time()?;
        Some(self.clock.server(now)? - shown.ticks())
    }
}

/// Number of published ticks that the server may compute beyond the tick that a lockstep client shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PipelineDepth(u32);

impl PipelineDepth {
    /// The client waits for each tick.
    pub const LOCKSTEP: Self = Self(0);
    /// The client shows a tick while the server computes the next.
    pub const PIPELINED: Self = Self(1);

    /// A depth in published ticks; [`Self::LOCKSTEP`] is 0, [`Self::PIPELINED`] is 1. A deeper one hides a link whose round
    /// trip is longer than a tick; [`DEPTH_MAX`](crate::DEPTH_MAX) is the greatest that a client takes.
    #[must_use]
    pub const fn new(ticks: u32) -> Self {
        Self(ticks)
    }

    /// The number of published ticks.
    #[must_use]
    pub const fn ticks(self) -> u32 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delay_that_is_no_number_of_ticks_is_none() {
        for delay_ticks in [f64::NAN, f64::INFINITY, -5.0, 2.5] {
            let options = ViewOptions {
                delay_ticks,
                whole_ticks: false,
                smooth: true,
            };
            let view = LiveView::new(SceneConfig::default(), options);
            let expected = if delay_ticks == 2.5 { 2.5 } else { 0.0 };
            assert_eq!(view.delay_ticks(), expected, "{delay_ticks}");
        }
    }
}
