//! The cells that a member takes: a subscription for each.
//!
//! What a cell tells and asks is what a scene does, so that a subscription serves both. The scene's own has the bodies that
//! are in no cell, and the shapes of all. Invariant: what a cell tells that was given up, or of an earlier time that it was
//! taken, changes nothing.

use alloc::collections::{BTreeMap, VecDeque};
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

use super::outbox::ClientOutbox;
use super::subscription::Subscription;
use crate::endpoint::{Instant, Span, Wake};
use crate::limits::CELLS_PER_MEMBER_MAX;
use crate::message::{
    CellNews, CellRequest, ClientMessage, Denial, Extensions, Joined, StreamChoice,
};
use crate::packet::Datagram;
use crate::scene::{Cell, CellGrid, IdRange, SceneConfig, Stepping};
use crate::session::replica::Replica;
use crate::session::{CloseCode, Event, Misuse};
use crate::stream::Subscriber;

/// The cells of one membership.
#[derive(Debug, Default)]
pub(super) struct CellSubscriptions {
    /// True if the client takes scenes by cells.
    joins: bool,
    /// The grid of the scene, once joined by cells.
    grid: Option<CellGrid>,
    taken: BTreeMap<Cell, WantedCell>,
    /// The tick requested last.
    awaited: Tick,
}

/// One cell that the application wants.
#[derive(Debug)]
struct WantedCell {
    choice: StreamChoice,
    subscription: Subscription,
    /// True from when on its copy is one of those that are shown.
    is_shown: bool,
    /// Why it was denied, until it is asked for again.
    denied: Option<Denial>,
}

impl CellSubscriptions {
    /// Asks the next join for cells.
    pub(super) fn join(&mut self, outbox: &mut ClientOutbox) {
        self.joins = true;
        self.ask(outbox);
    }

    /// Repeats the question before another join of the session.
    pub(super) fn ask(&self, outbox: &mut ClientOutbox) {
        if self.joins {
            outbox.send(&ClientMessage::JoinCells);
        }
    }

    /// The cells over the next connection of the session, before it joins.
    pub(super) fn over_next_connection(self) -> Self {
        let again = |(cell, taken): (Cell, WantedCell)| (cell, WantedCell::new(cell, taken.choice));
        Self {
            joins: self.joins,
            taken: self.taken.into_iter().map(again).collect(),
            ..Self::default()
        }
    }

    /// Begins with the grid of the joined scene; asks for the cells that an earlier connection had.
    pub(super) fn begin(&mut self, extensions: &Extensions, outbox: &mut ClientOutbox) {
        if self.grid.is_some() {
            return;
        }
        self.grid = extensions.cell_grid();
        if self.grid.is_some() {
            for taken in self.taken.values_mut() {
                taken.subscription.select(taken.choice, outbox);
            }
        }
    }

    /// The grid; `None` before joining, and for a scene that is not divided.
    pub(super) const fn grid(&self) -> Option<CellGrid> {
        self.grid
    }

    /// Takes these cells and no others.
    pub(super) fn take(
        &mut self,
        wanted: &BTreeMap<Cell, StreamChoice>,
        outbox: &mut ClientOutbox,
    ) -> Result<(), Misuse> {
        if wanted.len() > CELLS_PER_MEMBER_MAX {
            return Err(Misuse::TooManyCells);
        }
        let is_open = self.grid.is_some();
        self.taken.retain(|cell, taken| {
            let stays = wanted.contains_key(cell);
            if !stays && is_open {
                taken.subscription.send(CellRequest::Leave, outbox);
            }
            stays
        });
        for (cell, choice) in wanted {
            let is_new = !self.taken.contains_key(cell);
            let taken = self.taken.entry(*cell).or_insert_with(|| {
                let mut wanted = WantedCell::new(*cell, *choice);
                wanted.subscription.await_also(self.awaited);
                wanted
            });
            if is_open && (is_new || taken.choice != *choice || taken.denied.is_some()) {
                taken.denied = None;
                taken.subscription.select(*choice, outbox);
            }
            taken.choice = *choice;
        }
        Ok(())
    }

    /// Lets the copies wait for a tick that is requested now.
    pub(super) fn advance(&mut self, now: Instant, to: Tick) {
        self.awaited = self.awaited.max(to);
        for taken in self.taken.values_mut() {
            taken.subscription.advance(now, to);
        }
    }

    /// Lets the copies wait for a tick that was requested over another connection.
    pub(super) fn await_also(&mut self, to: Tick) {
        self.awaited = self.awaited.max(to);
        for taken in self.taken.values_mut() {
            taken.subscription.await_also(to);
        }
    }

    /// Handles news; returns the bodies that it is about, by their ids in the scene, unless it is part of a snapshot.
    /// `scene`: what has the shapes.
    pub(super) fn handle_news(
        &mut self,
        cell: Cell,
        news: &CellNews,
        (scene, config): (&Replica, &SceneConfig),
        outbox: &mut ClientOutbox,
    ) -> Result<Vec<BodyId>, CloseCode> {
        let Some(taken) = self.taken.get_mut(&cell) else {
            return Ok(Vec::new());
        };
        let subscription = &mut taken.subscription;
        match news {
            CellNews::Joined(start) => {
                let joined = Joined {
                    choice: start.choice,
                    config: *config,
                    start: start.start(config),
                    granted: IdRange::EMPTY,
                    extensions: Extensions::NONE,
                };
                subscription.begin_snapshot(&joined, outbox);
            }
            CellNews::SnapshotEnd if subscription.newest().is_some() => {
                subscription.end_snapshot()?;
                subscription.end_resync(outbox);
            }
            CellNews::SnapshotEnd => {}
            CellNews::Denied(denial) => {
                subscription.handle_denied(outbox);
                taken.denied = subscription.requested().is_none().then_some(*denial);
            }
            CellNews::Placed { .. }
            | CellNews::Arrived { .. }
            | CellNews::Departed { .. }
            | CellNews::SceneEvent(_) => {
                return subscription.handle_cell_news(news, scene);
            }
        }
        Ok(Vec::new())
    }

    /// Applies a datagram of a cell's stream; `false` for another one. `scene`: what is common.
    pub(super) fn handle_datagram(
        &mut self,
        now: Instant,
        (datagram, scene): (&Datagram<'_>, Option<&Replica>),
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) -> bool {
        let stream = datagram.head().stream;
        let mut taken = self.taken.values_mut();
        let Some(of_stream) = taken.find(|taken| taken.subscription.follows(stream)) else {
            return false;
        };
        of_stream.subscription.handle_datagram(datagram);
        self.update(now, scene, outbox, events);
        true
    }

    /// Shows replicas that have caught up, and restarts the timers. `scene`: what is common.
    pub(super) fn update(
        &mut self,
        now: Instant,
        scene: Option<&Replica>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        if self.taken.is_empty() {
            return;
        }
        let of_cells = self.copies().map(|(_, copy)| copy.stream().complete());
        let complete = scene.map(|scene| scene.stream().complete());
        let complete = complete.into_iter().chain(of_cells).min();
        let complete = complete.unwrap_or_default();
        for taken in self.taken.values_mut() {
            taken.subscription.show_until(complete);
            taken.update(now, outbox, events);
            let copy = taken.subscription.shown().map(Replica::stream);
            taken.is_shown |= copy.is_some_and(|copy| may_be_shown(copy, complete));
        }
    }

    /// Sends the reports that are due.
    pub(super) fn report(
        &mut self,
        now: Instant,
        round_trip: Span,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        for taken in self.taken.values_mut() {
            let mut of_cell = VecDeque::new();
            let subscription = &mut taken.subscription;
            subscription.report(now, round_trip, outbox, &mut of_cell);
            pass_on(of_cell, events);
        }
    }

    /// Asks for the watermarks, unless they were asked for within `pause`.
    pub(super) fn query(&mut self, now: Instant, pause: Span, outbox: &mut ClientOutbox) {
        for taken in self.taken.values_mut() {
            taken.subscription.query(now, pause, outbox);
        }
    }

    /// The next moment at which [`Self::report`] has something to do.
    pub(super) fn due(&self) -> Option<Wake> {
        let due = self
            .taken
            .values()
            .filter_map(|taken| taken.subscription.due());
        due.min_by_key(|wake| wake.at)
    }

    /// The copies, in the order of their cells; none of a cell whose snapshot has not come, or
    /// that has not caught up with the others of a lockstep scene.
    pub(super) fn copies(&self) -> impl Iterator<Item = (Cell, &Replica)> {
        let taken = self.taken.iter().filter(|(_, taken)| taken.is_shown);
        taken.filter_map(|(cell, taken)| Some((*cell, taken.subscription.shown()?)))
    }

    /// See [`Self::copies`].
    pub(super) fn copies_mut(&mut self) -> impl Iterator<Item = (Cell, &mut Replica)> {
        let taken = self.taken.iter_mut().filter(|(_, taken)| taken.is_shown);
        taken.filter_map(|(cell, taken)| Some((*cell, taken.subscription.shown_mut()?)))
    }

    /// The copies of all cells whose snapshots have come, shown or not.
    pub(super) fn complete_copies(&self) -> impl Iterator<Item = &Replica> {
        let taken = self.taken.values();
        taken.filter_map(|taken| taken.subscription.shown())
    }

    /// True unless a snapshot of a cell is to come.
    pub(super) fn are_there(&self) -> bool {
        self.grid.is_none() || !self.taken.values().any(WantedCell::is_awaited)
    }

    /// True for a cell whose snapshot is to come.
    pub(super) fn awaits(&self, cell: Cell) -> bool {
        let taken = self.taken.get(&cell);
        self.grid.is_some() && taken.is_some_and(WantedCell::is_awaited)
    }

    /// The cells that the server has denied.
    pub(super) fn denied(&self) -> impl Iterator<Item = (Cell, Denial)> {
        let taken = self.taken.iter();
        taken.filter_map(|(cell, taken)| Some((*cell, taken.denied?)))
    }
}

impl WantedCell {
    fn new(cell: Cell, choice: StreamChoice) -> Self {
        Self {
            choice,
            subscription: Subscription::of_cell(cell),
            is_shown: false,
            denied: None,
        }
    }

    /// True until its first snapshot has come, or it was denied.
    const fn is_awaited(&self) -> bool {
        self.subscription.shown().is_none() && self.denied.is_none()
    }

    fn update(&mut self, now: Instant, outbox: &mut ClientOutbox, events: &mut VecDeque<Event>) {
        let mut of_cell = VecDeque::new();
        self.subscription.update(now, outbox, &mut of_cell);
        pass_on(of_cell, events);
    }
}

/// True if a new copy may be shown beside others that are complete up to a tick: in lockstep once it has that tick, so that
/// what is complete never goes back; in a free-running scene, in which cells where nothing happens say so seldom, at once.
fn may_be_shown(copy: &Subscriber, complete: Tick) -> bool {
    match copy.stepping() {
        Stepping::Lockstep => (copy.start()..=copy.complete()).contains(&complete),
        Stepping::FreeRunning => true,
    }
}

/// Hands on what an application is to know of any stream.
fn pass_on(of_cell: VecDeque<Event>, events: &mut VecDeque<Event>) {
    let faults = of_cell.into_iter();
    events.extend(faults.filter(|event| *event == Event::ChecksumMismatch));
}
