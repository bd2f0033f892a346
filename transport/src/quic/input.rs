//! Inputs from the sockets to the server thread, bounded.
//!
//! Each waiting piece holds a permit of its connection, returned when the piece is handled.

use std::sync::Arc;

use rhumb_protocol::{Ending, Peer};

use super::closing::Closing;
use super::control_queue::ControlSender;
use super::datagram_lane::DatagramLane;
use crate::piece::Piece;

/// One input for the server thread.
#[derive(Debug)]
pub(crate) enum Input {
    /// A connection was opened.
    Opened { peer: Peer, handles: PeerHandles },
    /// Bytes of a control stream.
    Control { peer: Peer, piece: Piece },
    /// The connection has taken all control bytes that were handed over.
    ControlTaken { peer: Peer },
    /// The endpoint has something to transmit.
    Wake,
    /// A datagram.
    State { peer: Peer, piece: Piece },
    /// A connection has ended; its last input.
    Ended { peer: Peer, ending: Ending },
    /// The server must stop.
    Stop,
    /// The I/O thread has ended; the last input.
    IoOver,
}

/// The server thread's handles of one connection.
#[derive(Debug)]
pub(crate) struct PeerHandles {
    pub(super) datagrams: DatagramLane,
    pub(super) control: ControlSender,
    pub(super) closing: Arc<Closing>,
}
