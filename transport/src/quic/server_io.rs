//! I/O thread of the server: accepts, and carries to the server thread.
//!
//! Interprets nothing. Inputs are bounded per connection and lane; a full server refuses attempts at the listener.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::Sender;
use std::time::Duration;

use quinn::{Connecting, Connection, Endpoint, Incoming, ReadError, RecvStream, VarInt};
use rhumb_protocol::Peer;
use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

use super::addresses::Addresses;
use super::closing::Closing;
use super::code::TransportCode;
use super::control_queue::{ControlWriter, control_queue};
use super::input::{Input, PeerHandles};
use super::tuning::{
    CONNECTIONS_MAX, CONTROL_IN_FLIGHT_BYTES, DATAGRAM_BYTES_MIN, HANDSHAKES_UNPROVEN_MAX, SETUP,
    STATE_IN_FLIGHT_BYTES,
};
use super::watch::ServerWatch;
use crate::piece::ByteCredit;

/// Accepts until its end is requested, then refuses the attempts that still arrive.
pub(super) async fn accept(
    endpoint: Endpoint,
    inputs: Sender<Input>,
    watch: ServerWatch,
    mut ended: oneshot::Receiver<()>,
) {
    let handshakes = Arc::new(AtomicUsize::new(0));
    let addresses = Addresses::default();
    let mut peers = 0;
    loop {
        let incoming = tokio::select! {
            incoming = endpoint.accept() => incoming,
            _ = &mut ended => break,
        };
        let Some(incoming) = incoming else { break };
        let Some(place) = addresses.take(incoming.remote_address().ip()) else {
            watch.count(|counters| &counters.refused);
            incoming.refuse();
            continue;
        };
        let Some(connecting) = admit(&endpoint, incoming, &handshakes, &watch) else {
            continue;
        };
        let peer = Peer(peers);
        peers += 1;
        handshakes.fetch_add(1, Ordering::Relaxed);
        let (inputs, watch, handshakes) = (inputs.clone(), watch.clone(), Arc::clone(&handshakes));
        tokio::spawn(async move {
            let connected = timeout(SETUP, connecting).await;
            handshakes.fetch_sub(1, Ordering::Relaxed);
            match connected {
                Ok(Ok(connection)) => serve(connection, peer, inputs, watch).await,
                Ok(Err(cause)) => tracing::debug!(peer = peer.0, %cause, "handshake failed"),
                Err(_) => tracing::debug!(peer = peer.0, "handshake took too long"),
            }
            drop(place);
        });
    }
    endpoint.close(VarInt::from_u32(TransportCode::GOING_AWAY.0), b"");
    // Every connection's task gets a turn to send its close frame, those in a handshake too.
    sleep(LAST_TURN).await;
}

/// Accepts an attempt, demands proof of its address when many wait, or refuses it when the server is full.
fn admit(
    endpoint: &Endpoint,
    incoming: Incoming,
    handshakes: &AtomicUsize,
    watch: &ServerWatch,
) -> Option<Connecting> {
    if endpoint.open_connections() >= CONNECTIONS_MAX {
        watch.count(|counters| &counters.refused);
        incoming.refuse();
        return None;
    }
    if handshakes.load(Ordering::Relaxed) >= HANDSHAKES_UNPROVEN_MAX
        && !incoming.remote_address_validated()
        && incoming.may_retry()
    {
        // The attempt may retry, so that this call cannot fail.
        let _ = incoming.retry();
        return None;
    }
    match incoming.accept() {
        Ok(connecting) => Some(connecting),
        Err(cause) => {
            tracing::debug!(%cause, "attempt failed at once");
            None
        }
    }
}

/// Carries one connection from start to end.
async fn serve(connection: Connection, peer: Peer, inputs: Sender<Input>, watch: ServerWatch) {
    let closing = Closing::of(&connection);
    if connection
        .max_datagram_size()
        .is_none_or(|bytes| bytes < DATAGRAM_BYTES_MIN)
    {
        closing.now(TransportCode::NO_DATAGRAMS.0);
        return;
    }
    tracing::debug!(peer = peer.0, address = %connection.remote_address(), "opened");
    watch.opened(peer, connection.clone());
    let (control, writer) = control_queue();
    let handles = PeerHandles {
        connection: connection.clone(),
        control,
        closing: Arc::clone(&closing),
    };
    // If the server thread has ended, this thread ends soon too.
    let _ = inputs.send(Input::Opened { peer, handles });
    tokio::join!(
        carry_control(&connection, peer, &inputs, &closing, writer),
        carry_state(&connection, peer, &inputs, &watch),
    );
    let ending = closing.ended().await;
    tracing::debug!(peer = peer.0, ?ending, "ended");
    watch.ended(peer);
    let _ = inputs.send(Input::Ended { peer, ending });
}

/// Both directions of the control stream, from its opening.
async fn carry_control(
    connection: &Connection,
    peer: Peer,
    inputs: &Sender<Input>,
    closing: &Closing,
    mut writer: ControlWriter,
) {
    let opened = tokio::select! {
        opened = timeout(SETUP, connection.accept_bi()) => opened,
        () = closing.flush_requested() => return closing.finish(),
    };
    match opened {
        Ok(Ok((mut send, recv))) => {
            tokio::join!(
                writer.run(closing, &mut send, || {
                    // If the server thread has ended, this thread ends soon too.
                    let _ = inputs.send(Input::ControlTaken { peer });
                }),
                read_control(peer, inputs, closing, recv)
            );
        }
        Ok(Err(_)) => {}
        Err(_) => closing.now(TransportCode::NO_CONTROL_STREAM.0),
    }
}

/// Reads no further than the server thread keeps up: QUIC's flow control then slows the client down.
async fn read_control(
    peer: Peer,
    inputs: &Sender<Input>,
    closing: &Closing,
    mut stream: RecvStream,
) {
    let credit = ByteCredit::new(CONTROL_IN_FLIGHT_BYTES);
    loop {
        match stream.read_chunk(READ_BYTES_MAX, true).await {
            Ok(Some(chunk)) => {
                let piece = credit.admit(&chunk.bytes).await;
                if inputs.send(Input::Control { peer, piece }).is_err() {
                    return;
                }
            }
            // The client has finished its stream; its close follows.
            Ok(None) | Err(ReadError::ConnectionLost(_)) => return,
            Err(_) => return closing.now(TransportCode::NO_CONTROL_STREAM.0),
        }
    }
}

async fn carry_state(
    connection: &Connection,
    peer: Peer,
    inputs: &Sender<Input>,
    watch: &ServerWatch,
) {
    let credit = ByteCredit::new(STATE_IN_FLIGHT_BYTES);
    while let Ok(bytes) = connection.read_datagram().await {
        match credit.try_admit(&bytes) {
            Some(piece) => {
                if inputs.send(Input::State { peer, piece }).is_err() {
                    return;
                }
            }
            None => watch.count(|counters| &counters.state_dropped),
        }
    }
}

/// Long enough for a turn of each task, short enough not to delay a stop.
const LAST_TURN: Duration = Duration::from_millis(2);

/// Bytes of one read of the control stream, at most.
const READ_BYTES_MAX: usize = 64 << 10;
