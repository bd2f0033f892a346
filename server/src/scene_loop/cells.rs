//! Members that take a scene by cells: their requests and streams.
//!
//! Which bodies a cell has is decided in `bodies_by_cell`, which knows no members.

use rhumb_protocol::Peer;
use rhumb_protocol::limits::CELLS_PER_MEMBER_MAX;
use rhumb_protocol::message::{
    CellNews, CellRequest, CellStart, Denial, ResyncCause, ServerMessage, StreamChoice,
};
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Cell;

use super::RunningScene;
use crate::bodies_by_cell::{Cells, Placement, TAKEN_CELLS_MAX};
use crate::clients::Clients;
use crate::member::{Extent, SnapshotRequest, Subscribed};
use crate::streams::{self, Stream, Streams};

/// Cost of an answer about a cell beside its snapshot, as bytes of a snapshot: a member has some thousand a second.
const CELL_WORK: usize = 16 << 10;
/// Work for one member after which others, and the ticks, have their turn.
const WORK_AT_ONCE: usize = 16 * CELL_WORK;

impl RunningScene {
    /// The cells, while a member takes some.
    pub(super) fn used_cells(&mut self) -> Option<&mut Cells> {
        self.cells.as_mut().filter(|cells| cells.is_used())
    }

    /// Observes the newest tick in every cell that is taken.
    pub(super) fn observe_cells(&mut self, clients: &Clients) {
        if self.used_cells().is_none() {
            return;
        }
        let silences = self.silences(clients);
        if let Some(cells) = &mut self.cells {
            cells.observe(&self.scene, &silences);
        }
    }

    /// Places a new or changed body in its cell.
    pub(super) fn place_in_cells(&mut self, placement: &Placement) {
        let cells = self.cells.as_mut().filter(|cells| cells.is_used());
        if let Some(cells) = cells {
            cells.place(&self.scene, placement);
        }
    }

    /// The streams that a member gets beside those of cells: what its cells have in common, or the whole scene.
    pub(super) fn streams_of(&self, extent: Extent) -> Option<&Streams> {
        match extent {
            Extent::Cells => self.cells.as_ref()?.streams(None),
            Extent::Whole => Some(&self.streams),
        }
    }

    /// See [`Self::streams_of`].
    pub(super) fn streams_of_mut(&mut self, extent: Extent) -> Option<&mut Streams> {
        match extent {
            Extent::Cells => self.cells.as_mut()?.streams_mut(None),
            Extent::Whole => Some(&mut self.streams),
        }
    }

    /// Ends a member's subscription to a stream of the scene, if there is one to end.
    pub(super) fn unsubscribe(&mut self, stream: Option<StreamId>, peer: Peer, extent: Extent) {
        let Some(stream) = stream else {
            return;
        };
        match (extent, &mut self.cells) {
            (Extent::Cells, Some(cells)) => cells.unsubscribe(None, stream, peer),
            _ => self.streams.unsubscribe(stream, peer),
        }
    }

    /// Ends all of a member's subscriptions to streams of the scene.
    pub(super) fn unsubscribe_all(
        &mut self,
        streams: impl IntoIterator<Item = StreamId>,
        peer: Peer,
        extent: Extent,
    ) {
        for stream in streams {
            self.unsubscribe(Some(stream), peer, extent);
        }
        if let Some(cells) = self.used_cells().filter(|_| extent == Extent::Cells) {
            cells.leave();
        }
    }

    /// Ends a member's subscription to a stream of a cell.
    pub(super) fn unsubscribe_from_cell(&mut self, cell: Cell, stream: StreamId, peer: Peer) {
        if let Some(cells) = self.used_cells() {
            cells.unsubscribe(Some(cell), stream, peer);
            cells.give_up(cell);
        }
    }

    /// Adds a new member to a stream of its choice.
    pub(super) fn subscribe(
        &mut self,
        choice: StreamChoice,
        extent: Extent,
        clients: &Clients,
    ) -> Result<StreamId, Denial> {
        if extent == Extent::Cells {
            return self.enter_cells(choice, clients);
        }
        Ok(match self.streams.subscribe(choice)? {
            Some(stream) => stream,
            None => self.begin_stream(choice, clients),
        })
    }

    /// A member that takes cells comes: it gets a stream of what they have in common.
    fn enter_cells(&mut self, choice: StreamChoice, clients: &Clients) -> Result<StreamId, Denial> {
        if let Some(cells) = &mut self.cells {
            cells.enter(&self.scene);
        }
        let subscribed = self.subscribe_to_cell(None, choice, clients);
        if subscribed.is_err()
            && let Some(cells) = &mut self.cells
        {
            cells.leave();
        }
        subscribed
    }

    /// Adds a member to a stream of a cell, or of what all have in common. Begins the stream if it is not there.
    pub(super) fn subscribe_to_cell(
        &mut self,
        cell: Option<Cell>,
        choice: StreamChoice,
        clients: &Clients,
    ) -> Result<StreamId, Denial> {
        if let Some(cells) = &mut self.cells {
            cells.take(cell, &self.scene);
        }
        let cells = self.cells.as_mut().ok_or(Denial::NoSuchScene)?;
        let streams = cells.streams_mut(cell).ok_or(Denial::NoSuchScene)?;
        if let Some(stream) = streams.subscribe(choice)? {
            return Ok(stream);
        }
        let id = self.new_stream(clients);
        let mut stream = Stream::new(choice, id, self.settings.largest_packet, &self.scene);
        if let Some(cells) = &mut self.cells {
            for (local, placement) in cells.placements(cell, &self.scene) {
                if let Some(parameters) = streams::parameters(&self.scene, placement.desc.id) {
                    let Placement { motion, track, .. } = placement;
                    stream.insert(local, &parameters, track, motion);
                }
            }
            cells.begin(cell, stream);
        }
        Ok(id)
    }

    /// Handles a member's request about a cell.
    pub(crate) fn handle_cell_request(
        &mut self,
        peer: Peer,
        cell: Cell,
        request: CellRequest,
        clients: &mut Clients,
    ) {
        let now = clients.now();
        if let Some(member) = clients.member_mut(peer) {
            member.charge_cell_request(now);
        }
        match request {
            CellRequest::Subscribe(choice) => {
                let member = clients.member_mut(peer);
                let requested = member.map(|member| member.request_cell(cell, choice));
                if let Some(Err(denial)) = requested {
                    deny(peer, cell, denial, clients);
                }
            }
            CellRequest::Subscribed(stream) => {
                let subscribed = clients.member_mut(peer);
                let subscribed = subscribed.and_then(|member| member.subscribed_mut(cell));
                let former = subscribed.and_then(|subscribed| subscribed.caught_up(stream));
                if let Some(former) = former {
                    self.unsubscribe_from_cell(cell, former, peer);
                }
            }
            CellRequest::Resync(cause) => {
                let member = clients.member_mut(peer);
                let stream = member.and_then(|member| member.request_cell_again(cell));
                if let Some(stream) = stream {
                    self.note_cell_resync((peer, cause), (cell, stream));
                }
            }
            CellRequest::Leave => {
                let member = clients.member_mut(peer);
                let left = member.and_then(|member| member.leave_cell(cell));
                for stream in left.iter().flat_map(Subscribed::streams) {
                    self.unsubscribe_from_cell(cell, stream, peer);
                }
            }
        }
    }

    /// Answers requests about cells that may be answered, after the effects of all that was read before: of each member some,
    /// for which it pays by the pause before the next ones.
    pub(super) fn answer_cell_requests(&mut self, clients: &mut Clients) {
        for peer in clients.asking_for_cells() {
            let mut work = 0;
            while work < WORK_AT_ONCE
                && let Some((cell, request)) = clients.next_cell_request(peer)
            {
                work += CELL_WORK + self.answer_cell_request((peer, cell), request, clients);
            }
            clients.note_snapshot(peer, work);
            self.pace.note_snapshot();
        }
    }

    /// Answers a request about a cell; returns the bytes of its snapshot.
    fn answer_cell_request(
        &mut self,
        (peer, cell): (Peer, Cell),
        request: SnapshotRequest,
        clients: &mut Clients,
    ) -> usize {
        let changed = match request {
            SnapshotRequest::Again => Ok(()),
            SnapshotRequest::Other(choice) => {
                self.change_cell_stream((peer, cell), choice, clients)
            }
        };
        match changed {
            Ok(()) => self.send_cell_snapshot(peer, cell, clients),
            Err(denial) => {
                deny(peer, cell, denial, clients);
                0
            }
        }
    }

    fn note_cell_resync(
        &mut self,
        (peer, cause): (Peer, ResyncCause),
        (cell, stream): (Cell, StreamId),
    ) {
        self.note_resync((peer, cause), stream);
        let streams = self
            .used_cells()
            .and_then(|cells| cells.streams_mut(Some(cell)));
        if let Some(stream) = streams.and_then(|streams| streams.get_mut(stream))
            && cause == ResyncCause::ChecksumMismatch
        {
            stream.sender.count_mismatch();
        }
    }

    /// Subscribes a member to a stream of a cell, in place of the one that it has.
    fn change_cell_stream(
        &mut self,
        (peer, cell): (Peer, Cell),
        choice: StreamChoice,
        clients: &mut Clients,
    ) -> Result<(), Denial> {
        let member = clients.member(peer).ok_or(Denial::NoSuchScene)?;
        let taken = member.cells.as_ref().ok_or(Denial::NoSuchScene)?;
        let subscribed = taken.get(&cell).copied();
        if subscribed.is_none() && taken.len() >= CELLS_PER_MEMBER_MAX {
            return Err(Denial::TooManyStreams);
        }
        let cells = self.cells.as_ref().ok_or(Denial::NoSuchScene)?;
        if !cells.grid().has(cell) {
            return Err(Denial::NoSuchScene);
        }
        let streams = cells.streams(Some(cell));
        if streams.is_none() && cells.taken_count() >= TAKEN_CELLS_MAX {
            return Err(Denial::TooManyStreams);
        }
        let wanted = streams.and_then(|streams| streams.of_choice(choice));
        let rights = self.rights_of(peer, clients).ok_or(Denial::NoSuchScene)?;
        rights.take_cell(cell, wanted)?;
        if subscribed.is_some_and(|subscribed| Some(subscribed.present()) == wanted) {
            return Ok(());
        }
        // The stream that the member is leaving counts already.
        let mut received = subscribed.iter().flat_map(Subscribed::streams);
        let stream = match received.find(|received| Some(*received) == wanted) {
            Some(leaving) => leaving,
            None => self.subscribe_to_cell(Some(cell), choice, clients)?,
        };
        let member = clients.member_mut(peer);
        let Some(taken) = member.and_then(|member| member.cells.as_mut()) else {
            return Ok(());
        };
        let former = match taken.get_mut(&cell) {
            Some(subscribed) => subscribed.change(stream),
            None => {
                taken.insert(cell, Subscribed::to(stream));
                None
            }
        };
        if let Some(former) = former {
            self.unsubscribe_from_cell(cell, former, peer);
        }
        Ok(())
    }

    /// Sends the start of a member's stream of a cell, and every body of the cell; returns the bytes.
    fn send_cell_snapshot(&mut self, peer: Peer, cell: Cell, clients: &mut Clients) -> usize {
        let subscribed = clients.member_mut(peer);
        let subscribed = subscribed.and_then(|member| member.subscribed_mut(cell));
        let Some(id) = subscribed.map(|subscribed| subscribed.present()) else {
            return 0;
        };
        let silences = self.silences(clients);
        let gravity = self.scene.gravity();
        let Some(cells) = &mut self.cells else {
            return 0;
        };
        if let Some(streams) = cells.streams_mut(Some(cell)) {
            streams.begin_snapshot(id, peer);
        }
        let streams = cells.streams(Some(cell));
        let Some(stream) = streams.and_then(|streams| streams.get(id)) else {
            return 0;
        };
        let news = CellNews::Joined(CellStart {
            choice: stream.choice,
            stream: id,
            largest_packet: stream.sender.largest_packet(),
            gravity,
            tick: stream.sender.tick(),
            next: stream.sender.next_number(),
            scene_events: cells.scene_events(Some(cell)),
        });
        let mut rest = Vec::new();
        let scene = (&self.scene, &silences[..]);
        cells.append_snapshot(Some(cell), id, scene, &mut rest);
        let bytes = rest.len();
        clients.send(peer, &ServerMessage::OfCell { cell, news });
        clients.send_encoded(peer, &rest.into());
        bytes
    }
}

/// Tells a member why it does not get a cell.
fn deny(peer: Peer, cell: Cell, denial: Denial, clients: &mut Clients) {
    let news = CellNews::Denied(denial);
    clients.send(peer, &ServerMessage::OfCell { cell, news });
}
