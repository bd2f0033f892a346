//! The cells that a member takes: a subscription for each.
//!
//! A cell sends and requests as a scene does, so that a subscription serves both. The scene's own has the bodies that
//! are in no cell, and the shapes of all. A datagram and a timer concern one cell: the others cost nothing then, unless a copy
//! waits to be shown, which depends on all. Invariant: a message of a cell that was given up, or of an earlier time that it was
//! taken, changes nothing. An answer does not say to which request; so a cell that was given up with a request unanswered is
//! followed by a ping, and what comes of the cell before the pong is skipped (PROTOCOL 15-17).

use alloc::collections::{BTreeMap, BTreeSet, VecDeque};
use alloc::vec::Vec;

use rhumb_reckoning::{BodyId, Tick};

use super::outbox::ClientOutbox;
use super::subscription::Subscription;
use crate::endpoint::{Instant, Span, Wake};
use crate::limits::CELLS_PER_MEMBER_MAX;
use crate::message::{
    CellNews, CellRequest, ClientMessage, Denial, Extensions, Joined, StreamChoice,
};
use crate::packet::{Datagram, StreamId};
use crate::scene::{Cell, CellGrid, IdRange, SceneConfig, Stepping};
use crate::session::replica::Replica;
use crate::session::{CloseCode, Event, Misuse};
use crate::stream::Subscriber;

/// State of a cell that a member takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellState {
    /// Its snapshot has not come over this connection. A session that resumes shows it until then as it was.
    Awaited,
    /// Its bodies are shown. After another choice they are those of the stream before, until the new one has caught up.
    Shown,
    /// The server denies it, or the stream that was asked for last. What it had before is shown.
    Denied(Denial),
}

/// The cells of one membership.
#[derive(Debug, Default)]
pub(super) struct CellSubscriptions {
    /// True if the client takes scenes by cells.
    joins: bool,
    /// The grid of the scene, once joined by cells; also until the next connection of the session has joined.
    grid: Option<CellGrid>,
    /// True once this connection has joined by cells.
    is_open: bool,
    taken: BTreeMap<Cell, WantedCell>,
    /// The tick requested last.
    awaited: Tick,
    /// The cells of the copies, by stream.
    streams: BTreeMap<StreamId, Cell>,
    /// Cells with news since the last update.
    touched: BTreeSet<Cell>,
    /// Cells with a copy that is not shown yet.
    unsettled: BTreeSet<Cell>,
    /// When a cell has something to report.
    timers: BTreeSet<(Instant, Cell)>,
    /// Cells that were given up with a request unanswered, by the ping after that.
    given_up: Vec<(Cell, Instant)>,
    pings: u64,
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
    /// The timer that is set for it.
    due: Option<Wake>,
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
            grid: self.grid,
            taken: self.taken.into_iter().map(again).collect(),
            ..Self::default()
        }
    }

    /// What is left after a membership: the numbers of its pings are not used again.
    pub(super) fn after_membership(&self) -> Self {
        Self {
            pings: self.pings,
            ..Self::default()
        }
    }

    /// Begins with the grid of the joined scene; asks for the cells that an earlier connection had.
    pub(super) fn begin(&mut self, extensions: &Extensions, outbox: &mut ClientOutbox) {
        if self.is_open {
            return;
        }
        self.grid = extensions.cell_grid();
        self.is_open = self.grid.is_some();
        if self.is_open {
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
        if let Some(cell) = wanted.keys().find(|cell| !cell.is_in_a_world()) {
            return Err(Misuse::CellPlace(*cell));
        }
        let is_open = self.is_open;
        // A moment that no clock reaches: the pong is none of the clock's.
        let ping = Instant::from_nanos(u64::MAX - self.pings);
        let mut pings = false;
        self.taken.retain(|cell, taken| {
            let stays = wanted.contains_key(cell);
            if !stays {
                self.streams.retain(|_, of| of != cell);
                self.unsettled.remove(cell);
                self.touched.remove(cell);
                set_timer(&mut self.timers, *cell, (&mut taken.due, None));
                if is_open {
                    taken.subscription.send(CellRequest::Leave, outbox);
                    if taken.subscription.awaits_snapshot() {
                        self.given_up.retain(|(before, _)| before != cell);
                        self.given_up.push((*cell, ping));
                        pings = true;
                    }
                }
            }
            stays
        });
        if pings {
            outbox.send(&ClientMessage::Ping { sent: ping });
            self.pings += 1;
        }
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

    /// Notes that all is there that the server sent before it answered a ping.
    pub(super) fn handle_pong(&mut self, sent: Instant) {
        self.given_up.retain(|(_, ping)| *ping != sent);
    }

    /// Lets the copies wait for a tick that is requested now.
    pub(super) fn advance(&mut self, now: Instant, to: Tick) {
        self.awaited = self.awaited.max(to);
        for (cell, taken) in &mut self.taken {
            taken.subscription.advance(now, to);
            taken.set_timer(*cell, &mut self.timers);
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
        let is_given_up = self.given_up.iter().any(|(given_up, _)| *given_up == cell);
        let taken = self.taken.get_mut(&cell).filter(|_| !is_given_up);
        let Some(taken) = taken else {
            return Ok(Vec::new());
        };
        self.touched.insert(cell);
        let subscription = &mut taken.subscription;
        match news {
            CellNews::Joined(start) => {
                self.unsettled.insert(cell);
                let joined = Joined {
                    choice: start.choice,
                    config: *config,
                    start: start.start(config),
                    granted: IdRange::EMPTY,
                    extensions: Extensions::NONE,
                };
                let before: Vec<_> = subscription.streams().collect();
                subscription.begin_snapshot(&joined, outbox);
                self.streams.insert(start.stream, cell);
                forget_ended(&mut self.streams, cell, (&before, subscription));
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
        let cell = self.streams.get(&datagram.head().stream);
        let Some((cell, taken)) = cell.and_then(|cell| Some((*cell, self.taken.get_mut(cell)?)))
        else {
            return false;
        };
        taken.subscription.handle_datagram(datagram);
        self.touched.insert(cell);
        self.update(now, scene, outbox, events);
        true
    }

    /// Shows replicas that have caught up, and restarts the timers of the cells with news. `scene`: what is common.
    pub(super) fn update(
        &mut self,
        now: Instant,
        scene: Option<&Replica>,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        let touched = core::mem::take(&mut self.touched);
        if self.unsettled.is_empty() {
            for cell in touched {
                self.update_cell(cell, now, outbox, events);
            }
            return;
        }
        let of_cells = self.copies().map(|(_, copy)| copy.stream().complete());
        let complete = scene.map(|scene| scene.stream().complete());
        let complete = complete.into_iter().chain(of_cells).min();
        let complete = complete.unwrap_or_default();
        let cells: Vec<Cell> = self.taken.keys().copied().collect();
        for cell in cells {
            if let Some(taken) = self.taken.get_mut(&cell) {
                taken.subscription.show_until(complete);
            }
            self.update_cell(cell, now, outbox, events);
            let Some(taken) = self.taken.get_mut(&cell) else {
                continue;
            };
            let copy = taken.subscription.shown().map(Replica::stream);
            taken.is_shown |= copy.is_some_and(|copy| may_be_shown(copy, complete));
            if taken.is_shown && !taken.subscription.is_switching() {
                self.unsettled.remove(&cell);
            }
        }
    }

    fn update_cell(
        &mut self,
        cell: Cell,
        now: Instant,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        let Some(taken) = self.taken.get_mut(&cell) else {
            return;
        };
        let before: Option<StreamId> = taken.subscription.streams().last();
        taken.update(now, outbox, events);
        let ended = (before.as_slice(), &taken.subscription);
        forget_ended(&mut self.streams, cell, ended);
        taken.set_timer(cell, &mut self.timers);
    }

    /// Sends the reports that are due.
    pub(super) fn report(
        &mut self,
        now: Instant,
        round_trip: Span,
        outbox: &mut ClientOutbox,
        events: &mut VecDeque<Event>,
    ) {
        let due = self.timers.iter().take_while(|(at, _)| *at <= now);
        let due: Vec<Cell> = due.map(|(_, cell)| *cell).collect();
        for cell in due {
            let Some(taken) = self.taken.get_mut(&cell) else {
                continue;
            };
            let mut of_cell = VecDeque::new();
            let subscription = &mut taken.subscription;
            subscription.report(now, round_trip, outbox, &mut of_cell);
            pass_on(of_cell, events);
            taken.set_timer(cell, &mut self.timers);
        }
    }

    /// Asks for the watermarks, unless they were asked for within `pause`.
    pub(super) fn query(&mut self, now: Instant, pause: Span, outbox: &mut ClientOutbox) {
        for (cell, taken) in &mut self.taken {
            taken.subscription.query(now, pause, outbox);
            taken.set_timer(*cell, &mut self.timers);
        }
    }

    /// The next moment at which [`Self::report`] has something to do.
    pub(super) fn due(&self) -> Option<Wake> {
        let (_, cell) = self.timers.first()?;
        self.taken.get(cell)?.due
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

    /// True for a cell whose snapshot is to come.
    pub(super) fn awaits(&self, cell: Cell) -> bool {
        let taken = self.taken.get(&cell);
        self.is_open && taken.is_some_and(WantedCell::is_awaited)
    }

    /// The copy of a cell: see [`Self::copies`].
    pub(super) fn copy(&self, cell: Cell) -> Option<&Replica> {
        let taken = self.taken.get(&cell).filter(|taken| taken.is_shown)?;
        taken.subscription.shown()
    }

    /// The state of each cell.
    pub(super) fn states(&self) -> impl Iterator<Item = (Cell, CellState)> {
        let taken = self.taken.iter();
        taken.map(|(cell, taken)| (*cell, taken.state()))
    }
}

impl WantedCell {
    fn new(cell: Cell, choice: StreamChoice) -> Self {
        Self {
            choice,
            subscription: Subscription::of_cell(cell),
            is_shown: false,
            denied: None,
            due: None,
        }
    }

    /// True until its first snapshot has come, or it was denied.
    const fn is_awaited(&self) -> bool {
        self.subscription.shown().is_none() && self.denied.is_none()
    }

    fn state(&self) -> CellState {
        match self.denied {
            Some(denial) => CellState::Denied(denial),
            None if self.is_shown && self.subscription.shown().is_some() => CellState::Shown,
            None => CellState::Awaited,
        }
    }

    /// Sets its timer anew.
    fn set_timer(&mut self, cell: Cell, timers: &mut BTreeSet<(Instant, Cell)>) {
        let due = self.subscription.due();
        set_timer(timers, cell, (&mut self.due, due));
    }

    fn update(&mut self, now: Instant, outbox: &mut ClientOutbox, events: &mut VecDeque<Event>) {
        let mut of_cell = VecDeque::new();
        self.subscription.update(now, outbox, &mut of_cell);
        pass_on(of_cell, events);
    }
}

/// Sets the timer of a cell in place of the one that it has.
fn set_timer(
    timers: &mut BTreeSet<(Instant, Cell)>,
    cell: Cell,
    (set, due): (&mut Option<Wake>, Option<Wake>),
) {
    if *set == due {
        return;
    }
    if let Some(before) = core::mem::replace(set, due) {
        timers.remove(&(before.at, cell));
    }
    timers.extend(due.map(|wake| (wake.at, cell)));
}

/// Forgets those streams of a cell that no copy follows any more.
fn forget_ended(
    streams: &mut BTreeMap<StreamId, Cell>,
    cell: Cell,
    (before, subscription): (&[StreamId], &Subscription),
) {
    for stream in before {
        if !subscription.follows(*stream) && streams.get(stream) == Some(&cell) {
            streams.remove(stream);
        }
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
