//! The APP listener of a server: bound here, served by the server's thread.

use core::fmt;
use core::net::SocketAddr;
use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};

use rhumb_protocol::Peer;
use rhumb_transport::{bind_udp, io_runtime};
use tokio::net::{TcpListener, UdpSocket};
use tokio::sync::oneshot;

use super::connection::{AppConnection, AppInput, AppInputSender};
use super::datagram_sender::DatagramSender;
use super::io::{Sockets, carry};
use crate::server::{AppHost, AppServer, AppTransmit};

/// Address and rate of the APP listener.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AppListen {
    /// The address of both TCP and UDP; port 0 picks one that is free for both.
    pub address: SocketAddr,
    /// Datagrams to one address in a millisecond; `None` for no limit.
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

/// The server thread's end of the listener. Its clients wait until it is served.
#[derive(Debug)]
pub struct AppListener {
    address: SocketAddr,
    inputs: Receiver<AppInput>,
    connections: BTreeMap<Peer, AppConnection>,
    datagram_sender: Arc<DatagramSender>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Ports to try when any port will do that is free for both TCP and UDP.
const PORTS_TRIED: usize = 16;
/// Inputs handled before the host gets its turn: more than the wakes that its loop takes in a turn, so that no input is
/// left without one.
const INPUTS_PER_TURN: usize = 512;

impl AppListener {
    /// Binds the address for TCP and UDP and starts the I/O thread. `wake` has the thread that serves the clients call [`Self::serve`] soon.
    ///
    /// # Errors
    ///
    /// [`AppBindError`] names the address or the thread that failed.
    pub fn open(
        listen: AppListen,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, AppBindError> {
        let address = listen.address;
        let wrong = |cause| AppBindError::Address { address, cause };
        let runtime = io_runtime().map_err(AppBindError::Thread)?;
        let (tcp, udp) = {
            let _inside = runtime.enter();
            bind_both(address).map_err(wrong)?
        };
        let address = tcp.local_addr().map_err(wrong)?;
        let datagram_sender = Arc::new(DatagramSender::new(listen.datagrams_per_ms));
        let (end, ended) = oneshot::channel();
        let (sender, inputs) = channel();
        let sender = AppInputSender {
            inputs: sender,
            wake: Arc::new(wake),
        };
        let sockets = Sockets {
            tcp,
            udp,
            datagram_sender: Arc::clone(&datagram_sender),
        };
        let thread = thread::Builder::new()
            .name("rhumb-app-io".into())
            .spawn(move || runtime.block_on(carry(sockets, sender, ended)))
            .map_err(AppBindError::Thread)?;
        Ok(Self {
            address,
            inputs,
            connections: BTreeMap::new(),
            datagram_sender,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// The address of both TCP and UDP.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Passes the waiting inputs to the server, and queues its transmissions. To be called after each wake.
    pub fn serve(&mut self, server: &mut AppServer, host: &mut dyn AppHost) {
        for _ in 0..INPUTS_PER_TURN {
            match self.inputs.try_recv() {
                Ok(input) => self.handle(input, server, host),
                // If the I/O thread has ended, nothing comes any more.
                Err(_) => break,
            }
        }
        while let Some(transmit) = server.poll_transmit() {
            self.send(transmit);
        }
    }

    fn handle(&mut self, input: AppInput, server: &mut AppServer, host: &mut dyn AppHost) {
        match input {
            AppInput::Opened {
                peer,
                from,
                connection,
            } => {
                self.connections.insert(peer, connection);
                server.handle_opened(peer, from);
            }
            AppInput::Bytes { peer, piece } => {
                if let Some(connection) = self.connections.get(&peer) {
                    server.handle_bytes(host, peer, &piece.bytes, connection.waiting_bytes());
                }
            }
            AppInput::Datagram { from, piece } => server.handle_datagram(from, &piece.bytes),
            AppInput::Ended { peer } => {
                self.connections.remove(&peer);
                server.handle_ended(host, peer);
            }
        }
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
            AppTransmit::Datagram(datagram) => self.datagram_sender.send(datagram),
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
        match bind_udp(tcp.local_addr()?) {
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
