//! The APP listener of a server: bound here, served by the server's loop.

use core::fmt;
use core::net::SocketAddr;
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::thread::{self, JoinHandle};

use rhumb_protocol::{Instant, Peer};
use tokio::net::{TcpListener, UdpSocket};
use tokio::sync::oneshot;

use super::connection::{AppConnection, AppInput};
use super::datagram_sender::DatagramSender;
use super::endpoint::{AppEndpoint, AppTransmit};
use super::io::{Sockets, carry};
use crate::quic::Input;
use crate::socket;

/// Address and rate of the APP listener.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AppListen {
    /// The address of both TCP and UDP; port 0 picks one that is free for both.
    pub address: SocketAddr,
    /// Datagrams to one address in about a millisecond; `None` for no limit.
    pub datagrams_per_ms: Option<u32>,
}

/// Reason why the APP listener cannot be opened.
#[derive(Debug)]
pub enum AppBindError {
    /// The address cannot be bound.
    Address {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The I/O thread cannot start.
    Thread(io::Error),
}

/// The server thread's end of the listener.
#[derive(Debug)]
pub(crate) struct AppListener {
    address: SocketAddr,
    connections: BTreeMap<Peer, AppConnection>,
    datagram_sender: Arc<DatagramSender>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Calls between the server loop and an endpoint with APP clients; no-ops for an endpoint without.
pub(crate) struct AppHooks<E> {
    handle: fn(&mut E, Instant, AppInput, &mut AppListener),
    poll: fn(&mut E) -> Option<AppTransmit>,
}

/// Ports to try when any port will do that is free for both TCP and UDP.
const PORTS_TRIED: usize = 16;

impl AppListener {
    /// Binds the address for TCP and UDP and starts the I/O thread.
    pub(crate) fn open(listen: AppListen, inputs: Sender<Input>) -> Result<Self, AppBindError> {
        let address = listen.address;
        let wrong = |cause| AppBindError::Address { address, cause };
        let runtime = socket::runtime().map_err(AppBindError::Thread)?;
        let (tcp, udp) = {
            let _inside = runtime.enter();
            bind_both(address).map_err(wrong)?
        };
        let address = tcp.local_addr().map_err(wrong)?;
        let datagram_sender = Arc::new(DatagramSender::new(listen.datagrams_per_ms));
        let (end, ended) = oneshot::channel();
        let sockets = Sockets {
            tcp,
            udp,
            datagram_sender: Arc::clone(&datagram_sender),
        };
        let thread = thread::Builder::new()
            .name("rhumb-app-io".into())
            .spawn(move || runtime.block_on(carry(sockets, inputs, ended)))
            .map_err(AppBindError::Thread)?;
        Ok(Self {
            address,
            connections: BTreeMap::new(),
            datagram_sender,
            end: Some(end),
            thread: Some(thread),
        })
    }

    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Queues a transmission of the endpoint. A connection that is closed or too slow is not read any more.
    fn send(&mut self, transmit: AppTransmit) {
        match transmit {
            AppTransmit::Bytes { to, bytes } => {
                let connection = self.connections.get(&to);
                if connection.is_some_and(|connection| connection.send(bytes).is_err()) {
                    tracing::warn!(peer = to.0, "an app client reads too slowly, closing");
                    self.connections.remove(&to);
                }
            }
            AppTransmit::Datagram { to, bytes } => self.datagram_sender.send(to, bytes),
            AppTransmit::Close { to } => drop(self.connections.remove(&to)),
        }
    }
}

impl Drop for AppListener {
    fn drop(&mut self) {
        self.connections.clear();
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the i/o thread of app clients panicked");
        }
    }
}

/// Sockets of both kinds on one port.
fn bind_both(address: SocketAddr) -> io::Result<(TcpListener, UdpSocket)> {
    let mut tries = 0;
    loop {
        tries += 1;
        let tcp = std::net::TcpListener::bind(address)?;
        tcp.set_nonblocking(true)?;
        match socket::bind(tcp.local_addr()?) {
            Ok(udp) => {
                udp.set_nonblocking(true)?;
                return Ok((TcpListener::from_std(tcp)?, UdpSocket::from_std(udp)?));
            }
            // The port that TCP got may be taken on UDP.
            Err(_) if address.port() == 0 && tries < PORTS_TRIED => {}
            Err(cause) => return Err(cause),
        }
    }
}

impl<E> AppHooks<E> {
    /// Hooks of an endpoint without APP clients.
    pub(crate) fn none() -> Self {
        Self {
            handle: |_, _, _, _| {},
            poll: |_| None,
        }
    }

    /// Passes an input to the endpoint.
    pub(crate) fn handle(
        &self,
        endpoint: &mut E,
        now: Instant,
        input: AppInput,
        listener: &mut AppListener,
    ) {
        (self.handle)(endpoint, now, input, listener);
    }

    /// Queues all transmissions of the endpoint.
    pub(crate) fn drain(&self, endpoint: &mut E, listener: &mut AppListener) {
        while let Some(transmit) = (self.poll)(endpoint) {
            listener.send(transmit);
        }
    }
}

impl<E: AppEndpoint> AppHooks<E> {
    /// Hooks of an endpoint with APP clients.
    pub(crate) fn of_endpoint() -> Self {
        Self {
            handle,
            poll: E::poll_app,
        }
    }
}

fn handle<E: AppEndpoint>(
    endpoint: &mut E,
    now: Instant,
    input: AppInput,
    listener: &mut AppListener,
) {
    match input {
        AppInput::Opened {
            peer,
            from,
            connection,
        } => {
            listener.connections.insert(peer, connection);
            endpoint.handle_app_opened(now, peer, from);
        }
        AppInput::Bytes { peer, piece } => {
            if let Some(connection) = listener.connections.get(&peer) {
                endpoint.handle_app_waiting(now, peer, connection.waiting_bytes());
                endpoint.handle_app_bytes(now, peer, &piece.bytes);
            }
        }
        AppInput::Datagram { from, piece } => {
            endpoint.handle_app_datagram(now, from, &piece.bytes);
        }
        AppInput::Ended { peer } => {
            listener.connections.remove(&peer);
            endpoint.handle_app_ended(now, peer);
        }
    }
}

impl fmt::Display for AppBindError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address { address, cause } => write!(
                f,
                "cannot listen on tcp and udp {address}: {cause}; choose another address or port 0"
            ),
            Self::Thread(cause) => write!(f, "cannot start the i/o thread of app clients: {cause}"),
        }
    }
}

impl std::error::Error for AppBindError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Address { cause, .. } | Self::Thread(cause) => Some(cause),
        }
    }
}
