//! The view as the frames of a member show it, and the views of its cells.
//!
//! Chooses the moment, and whether corrections are smoothed. Time is an argument; the session beside it is the caller's.
//!
//! Each cell has a view of its own; [`CellViews`] knows which body of the scene each place shows. A body that crosses is in
//! the old cell before the tick of its crossing and in the new one from it on. Where the news of the old cell are late, both
//! have it: the newer track counts. A cell that was taken after the moment shown gives way. A cell that an earlier connection
//! of the session had stands still until its snapshot comes, and gives way to all. Invariant: each body has one place.

use std::collections::BTreeMap;

use rhumb_protocol::limits::SILENCE_MS_MAX;
use rhumb_protocol::scene::{Cell, SceneConfig, Stepping};
use rhumb_protocol::session::{ClientSession, Event, Replica};
use rhumb_protocol::stream::ErrorBound;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, Seconds, Tick, Ticks};

use crate::clocks::{SceneClock, ticks_or_none};
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
    view: View,
    cells: CellViews,
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
            view: View::default(),
            cells: CellViews::default(),
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

    /// The view as of the last call that computed it.
    #[must_use]
    pub const fn view(&self) -> &View {
        &self.view
    }

    /// The views of the cells that the member takes, of the same moment; empty for a member of a whole scene.
    #[must_use]
    pub const fn cells(&self) -> &CellViews {
        &self.cells
    }

    /// Learns from the events of the session: of the server's clock, and of a session that continues with other tracks.
    pub fn note(&mut self, event: &Event) {
        self.clock.note(event);
        if let Event::Resumed(_) = event {
            self.view.begin_anew();
        }
    }

    /// Computes the view of the present moment. A lockstep scene stands still until a member advances it: its present is
    /// the newest complete tick.
    pub fn show_present(&mut self, session: &mut ClientSession, now: Instant) -> RenderTime {
        if self.config.stepping == Stepping::Lockstep {
            let complete = session.complete();
            let shown = self.view.time().map_or(Tick::ZERO, |at| at.tick);
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
        let (Some(at), true) = (self.view.time(), self.view.take_bounds_asked()) else {
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
        self.view.refresh(replica.stream_mut(), &render_params);
        for (_, copy) in session.cells_mut() {
            copy.stream_mut().set_history(history);
        }
        self.cells.refresh(session, &render_params);
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
        let shown = self.view.time()?;
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

/// The views of a member's cells at one moment.
#[derive(Debug, Default)]
pub struct CellViews {
    cells: BTreeMap<Cell, CellView>,
    /// By index of the scene.
    bodies: Vec<Option<Shown>>,
}

/// A body's place in the view of a cell.
#[derive(Clone, Copy, Debug)]
pub struct CellPlace<'v> {
    /// The body, by its id in the scene.
    pub id: BodyId,
    /// The cell.
    pub cell: Cell,
    /// The view of the cell.
    pub view: &'v View,
    /// The body's place in the arrays of the view.
    pub place: usize,
}

/// Where a body is shown.
#[derive(Clone, Copy, Debug)]
struct Shown {
    id: BodyId,
    cell: Cell,
    place: u32,
    /// How far what the cell says of it counts.
    rank: Rank,
}

/// How far a cell counts that shows a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Rank {
    /// It is of an earlier connection.
    Former,
    /// Its copy begins after the moment shown: the body may have been elsewhere then.
    BeginsLater,
    /// It has a track of this origin.
    Since(Tick),
}

#[derive(Debug, Default)]
struct CellView {
    view: View,
    /// The stream of the copy that it shows.
    stream: Option<u32>,
    /// By place: the body's id in the cell and in the scene.
    names: Vec<(BodyId, BodyId)>,
}

impl CellViews {
    /// Computes the views of a moment. Cells that the member has given up are gone; one whose snapshot a resumed session has
    /// not got yet stays as it was.
    pub fn refresh(&mut self, session: &mut ClientSession, render_params: &RenderParams) {
        for shown in self.cells.values().flat_map(|of| &of.names) {
            self.bodies[shown.1.index() as usize] = None;
        }
        let mut before = std::mem::take(&mut self.cells);
        for (cell, copy) in session.cells_mut() {
            let mut of_cell = before.remove(&cell).unwrap_or_default();
            of_cell.refresh(copy, render_params);
            let rank = |local| match copy.stream().start() > render_params.at.tick {
                true => Rank::BeginsLater,
                false => {
                    let track = copy.stream().track(local);
                    Rank::Since(track.map_or(Tick::ZERO, |track| track.origin))
                }
            };
            self.show(cell, of_cell, rank);
        }
        for (cell, of_cell) in before {
            if session.awaits_cell(cell) {
                self.show(cell, of_cell, |_| Rank::Former);
            }
        }
    }

    /// Shows the bodies of a cell, by how far the cell counts for each.
    fn show(&mut self, cell: Cell, of_cell: CellView, rank: impl Fn(BodyId) -> Rank) {
        for (place, (local, id)) in of_cell.names.iter().enumerate() {
            let shown = Shown {
                id: *id,
                cell,
                place: place as u32,
                rank: rank(*local),
            };
            show(&mut self.bodies, shown);
        }
        self.cells.insert(cell, of_cell);
    }

    /// The cells with their views, in order. Ids in them are those of the cell: see [`Self::bodies`].
    pub fn cells(&self) -> impl Iterator<Item = (Cell, &View)> {
        self.cells.iter().map(|(cell, of)| (*cell, &of.view))
    }

    /// All bodies, each once, in the order of their indices in the scene.
    pub fn bodies(&self) -> impl Iterator<Item = CellPlace<'_>> {
        let shown = self.bodies.iter().flatten();
        shown.filter_map(|shown| self.place_of(shown))
    }

    /// The place of a body; `None` for one that is in no taken cell.
    #[must_use]
    pub fn place(&self, id: BodyId) -> Option<CellPlace<'_>> {
        let shown = self.bodies.get(id.index() as usize)?.as_ref()?;
        self.place_of(shown).filter(|place| place.id == id)
    }

    /// Bound on the error of the pose of a body: see [`View::error_bound`]. `None` for a body that is in no taken cell: where
    /// it is, or whether it is, is not known.
    #[must_use]
    pub fn error_bound(&self, session: &ClientSession, id: BodyId) -> Option<ErrorBound> {
        let CellPlace {
            cell, view, place, ..
        } = self.place(id)?;
        let local = view.ids()[place];
        let copy = session.cells().find(|(at, _)| *at == cell);
        view.error_bound(copy.map(|(_, copy)| copy.stream()), local)
    }

    fn place_of(&self, shown: &Shown) -> Option<CellPlace<'_>> {
        Some(CellPlace {
            id: shown.id,
            cell: shown.cell,
            view: &self.cells.get(&shown.cell)?.view,
            place: shown.place as usize,
        })
    }
}

impl CellView {
    fn refresh(&mut self, copy: &mut Replica, render_params: &RenderParams) {
        let stream = copy.stream().stream().0;
        if self.stream.replace(stream) != Some(stream) {
            self.view.begin_anew();
        }
        self.view.refresh(copy.stream_mut(), render_params);
        let ids = self.view.ids();
        self.names.truncate(ids.len());
        for (place, local) in ids.iter().enumerate() {
            match self.names.get_mut(place) {
                Some((before, _)) if before == local => {}
                known => {
                    let name = (*local, copy.id_in_scene(*local).unwrap_or(*local));
                    match known {
                        Some(known) => *known = name,
                        None => self.names.push(name),
                    }
                }
            }
        }
    }
}

/// Notes where a body is shown, unless another cell has a newer track of it.
fn show(bodies: &mut Vec<Option<Shown>>, shown: Shown) {
    let index = shown.id.index() as usize;
    if index >= bodies.len() {
        bodies.resize(index + 1, None);
    }
    let at = &mut bodies[index];
    if at.is_none_or(|before| before.rank < shown.rank) {
        *at = Some(shown);
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
