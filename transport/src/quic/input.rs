//! What the sockets tell the host thread, bounded.
//!
//! Decides nothing. Each waiting piece holds a permit of its connection, given back when the piece was handled.

use std::sync::Arc;

use quinn::Connection;
use rhumb_protocol::{Ending, Peer};

use super::closing::Closing;
use super::control_queue::ControlSender;
use crate::app::AppInput;
use crate::piece::Piece;

/// One thing for the host thread to handle.
#[derive(Debug)]
pub(crate) enum Input {
    /// A connection stands.
    Opened { peer: Peer, handles: PeerHandles },
    /// Bytes of its control stream.
    Control { peer: Peer, piece: Piece },
    /// One of its datagrams.
    State { peer: Peer, piece: Piece },
    /// It is gone; its last word.
    Ended { peer: Peer, ending: Ending },
    /// Something at the second listener.
    App(AppInput),
    /// The server shall stop.
    Stop,
    /// The I/O thread is over: nothing more will come.
    IoOver,
}

/// How the host thread speaks to one connection.
#[derive(Debug)]
pub(crate) struct PeerHandles {
    pub(super) connection: Connection,
    pub(super) control: ControlSender,
    pub(super) closing: Arc<Closing>,
}
