//! Server over a Unix socket, beside another driver's peers.
//!
//! A credit bounds each connection's control bytes that wait for the server.

use std::collections::BTreeMap;
use std::io::Read;
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::Duration;
use std::{fs, io, thread};

use bytes::Bytes;
use rhumb_link::unix::{FrameReader, Outgoing, StreamFrame};
use rhumb_link::{Clock, HeldBack};
use rhumb_protocol::session::TransportCode;
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::server_loop::Waker;

/// The first number of peers of a Unix socket, above those of the network.
const FIRST_PEER: u64 = 1 << 63;
/// Connections of one socket.
const CONNECTIONS_MAX: usize = 256;
/// Frames of all connections that wait for the server's thread; beyond them sockets are not read.
const FRAMES_WAITING: usize = 1_024;
/// Frames that are handled before the network's peers and ticks get their turn.
const FRAMES_PER_TURN: usize = 256;
/// Bytes of one read.
const READ_BYTES: usize = 16 << 10;
/// The pause after a connection that cannot be accepted.
const ACCEPT_PAUSE: Duration = Duration::from_millis(100);

/// A socket that listens. Its file is removed when it is dropped.
#[derive(Debug)]
pub struct UnixServer {
    listener: UnixListener,
    path: PathBuf,
}

/// An endpoint, and its peers of a Unix socket beside those of the driver that calls it.
pub struct WithUnixPeers<'a, E> {
    endpoint: &'a mut E,
    clock: Clock,
    waker: Waker,
    inputs: Receiver<(Peer, SocketInput)>,
    peers: BTreeMap<Peer, UnixPeer>,
    /// Control bytes that the endpoint does not want yet: none of a peer that this end has closed.
    held_back: HeldBack<WaitingBytes>,
    /// Removes the socket's file when it is dropped.
    socket: UnixServer,
    stop: Arc<AtomicBool>,
}

enum SocketInput {
    Opened(Arc<Outgoing>),
    Control(WaitingBytes),
    State(Bytes),
    /// The peer has closed, with this code.
    Closed(u32),
    /// The socket has taken more.
    Written,
    Ended,
}

struct UnixPeer {
    outgoing: Arc<Outgoing>,
    /// Control bytes that the endpoint knows to be taken.
    reported: u64,
    /// True once this end has closed.
    closing: bool,
}

impl UnixServer {
    /// Listens at a path. Only this user's processes may connect. A socket that a dead server left there is replaced.
    ///
    /// # Errors
    /// An I/O error: another server listens at the path, another file has it, or the folder cannot be written.
    pub fn bind(path: &Path) -> io::Result<Self> {
        let listener = match UnixListener::bind(path) {
            Err(cause) if cause.kind() == io::ErrorKind::AddrInUse && is_dead(path) => {
                fs::remove_file(path)?;
                UnixListener::bind(path)?
            }
            bound => bound?,
        };
        fs::set_permissions(path, fs::Permissions::from_mode(0o600))?;
        let path = path.to_owned();
        Ok(Self { listener, path })
    }

    /// Accepts connections, on a thread of its own, whose peers join those of the driver with this waker.
    ///
    /// # Errors
    ///
    /// The system's, if the thread cannot start.
    pub fn serve<E: Endpoint>(
        self,
        endpoint: &mut E,
        waker: Waker,
    ) -> io::Result<WithUnixPeers<'_, E>> {
        let (sender, inputs) = sync_channel(FRAMES_WAITING);
        let stop = Arc::new(AtomicBool::new(false));
        let listener = self.listener.try_clone()?;
        let (on_thread, stopped) = (waker.clone(), Arc::clone(&stop));
        thread::Builder::new()
            .name("rhumb-unix".to_owned())
            .spawn(move || accept(&listener, &sender, &on_thread, &stopped))?;
        Ok(WithUnixPeers {
            endpoint,
            clock: Clock::start(),
            waker,
            inputs,
            peers: BTreeMap::new(),
            held_back: HeldBack::default(),
            socket: self,
            stop,
        })
    }
}

/// True if a socket is at the path and nothing listens there.
fn is_dead(path: &Path) -> bool {
    // A connection to a file that is no socket is refused too.
    let is_socket = fs::symlink_metadata(path).is_ok_and(|file| file.file_type().is_socket());
    let refused = |cause: io::Error| cause.kind() == io::ErrorKind::ConnectionRefused;
    is_socket && UnixStream::connect(path).err().is_some_and(refused)
}

/// Accepts connections until the server stops.
fn accept(
    listener: &UnixListener,
    to: &SyncSender<(Peer, SocketInput)>,
    waker: &Waker,
    stop: &AtomicBool,
) {
    let open = Arc::new(AtomicUsize::new(0));
    for number in FIRST_PEER.. {
        let accepted = listener.accept();
        if stop.load(Ordering::Relaxed) {
            return;
        }
        let started = accepted.and_then(|(socket, _)| {
            if open.load(Ordering::Relaxed) >= CONNECTIONS_MAX {
                return Err(io::Error::other("too many connections"));
            }
            start_peer(socket, Peer(number), to, waker, &open)
        });
        if let Err(cause) = started {
            tracing::warn!(%cause, "a connection of the Unix socket is refused");
            thread::sleep(ACCEPT_PAUSE);
        }
    }
}

/// Starts the threads of a connection.
fn start_peer(
    socket: UnixStream,
    peer: Peer,
    to: &SyncSender<(Peer, SocketInput)>,
    waker: &Waker,
    open: &Arc<AtomicUsize>,
) -> io::Result<()> {
    let (written, on_writer) = (to.clone(), waker.clone());
    let outgoing = Outgoing::start(socket.try_clone()?, move || {
        // A full queue has the server read what was taken soon enough.
        if written.try_send((peer, SocketInput::Written)).is_ok() {
            on_writer.wake();
        }
    })?;
    let (to, waker, counted) = (to.clone(), waker.clone(), Arc::clone(open));
    open.fetch_add(1, Ordering::Relaxed);
    let opened = SocketInput::Opened(Arc::clone(&outgoing));
    let started = thread::Builder::new()
        .name("rhumb-unix-in".to_owned())
        .spawn(move || {
            // A server that is gone reads nothing; its sockets end with it.
            let send = |input| {
                let sent = to.send((peer, input)).is_ok();
                waker.wake();
                sent
            };
            if send(opened) {
                read(&socket, &send);
            }
            send(SocketInput::Ended);
            counted.fetch_sub(1, Ordering::Relaxed);
        });
    if started.is_err() {
        open.fetch_sub(1, Ordering::Relaxed);
        outgoing.abort();
    }
    started.map(drop)
}

/// Reads frames until the stream ends.
fn read(mut socket: &UnixStream, send: &dyn Fn(SocketInput) -> bool) {
    let credit = Arc::new(Credit::default());
    let mut frames = FrameReader::default();
    let mut buffer = vec![0; READ_BYTES];
    loop {
        match socket.read(&mut buffer) {
            Ok(0) => return,
            Ok(bytes) => frames.put(&buffer[..bytes]),
            Err(cause) if cause.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return,
        }
        loop {
            let input = match frames.next_frame() {
                Ok(Some(StreamFrame::Control(bytes))) => {
                    SocketInput::Control(credit.admit(bytes, || has_ended(socket)))
                }
                Ok(Some(StreamFrame::State(bytes))) => SocketInput::State(bytes),
                Ok(Some(StreamFrame::End(code))) => {
                    send(SocketInput::Closed(code));
                    return;
                }
                Ok(None) => break,
                Err(_) => return,
            };
            if !send(input) {
                return;
            }
        }
    }
}

/// True if nothing follows the bytes that a socket holds.
fn has_ended(socket: &UnixStream) -> bool {
    let mut polled = [PollFd::new(socket, PollFlags::HUP)];
    let at_once = Timespec {
        tv_sec: 0,
        tv_nsec: 0,
    };
    poll(&mut polled, Some(&at_once)).is_ok()
        && polled[0]
            .revents()
            .intersects(PollFlags::HUP | PollFlags::ERR)
}

impl<E: Endpoint> WithUnixPeers<'_, E> {
    /// Handles the sockets' input.
    fn handle_inputs(&mut self) {
        for _ in 0..FRAMES_PER_TURN {
            let Ok((peer, input)) = self.inputs.try_recv() else {
                return;
            };
            self.handle(peer, input);
        }
        self.waker.wake();
    }

    fn handle(&mut self, from: Peer, input: SocketInput) {
        let now = self.clock.now();
        match input {
            SocketInput::Opened(outgoing) => {
                let peer = UnixPeer {
                    outgoing,
                    reported: 0,
                    closing: false,
                };
                self.peers.insert(from, peer);
                self.endpoint.handle_opened(now, from);
                self.endpoint.handle_control_taken(now, from, 0);
            }
            SocketInput::Control(bytes) => {
                if self.is_open(from) {
                    (self.held_back).handle_control(now, self.endpoint, from, bytes);
                }
            }
            SocketInput::State(bytes) => {
                if self.is_open(from) {
                    self.endpoint.handle_datagram(now, from, &bytes);
                }
            }
            SocketInput::Closed(code) => self.end(now, from, Ending::Closed(code)),
            SocketInput::Written => self.report(from),
            SocketInput::Ended => self.end(now, from, Ending::Broken),
        }
    }

    /// True unless the connection has ended, or this end has closed it.
    fn is_open(&self, peer: Peer) -> bool {
        self.peers.get(&peer).is_some_and(|peer| !peer.closing)
    }

    /// Tells the endpoint what a socket has taken of its control bytes.
    fn report(&mut self, to: Peer) {
        let Some(peer) = self.peers.get_mut(&to).filter(|peer| !peer.closing) else {
            return;
        };
        let taken = peer.outgoing.taken();
        let more = taken - peer.reported;
        peer.reported = taken;
        if more > 0 {
            let more = usize::try_from(more).unwrap_or(usize::MAX);
            self.endpoint
                .handle_control_taken(self.clock.now(), to, more);
        }
    }

    fn end(&mut self, now: Instant, from: Peer, ending: Ending) {
        let Some(peer) = self.peers.remove(&from) else {
            return;
        };
        self.held_back.deliver_rest(now, self.endpoint, from);
        peer.outgoing.abort();
        self.endpoint.handle_ended(now, from, ending);
    }

    /// Sends a transmission to a peer of the socket.
    fn send(&mut self, transmit: Transmit) {
        let (Transmit::Control { to, .. }
        | Transmit::State { to, .. }
        | Transmit::Close { to, .. }) = transmit;
        let Some(peer) = self.peers.get_mut(&to).filter(|peer| !peer.closing) else {
            return;
        };
        match transmit {
            Transmit::Control { bytes, .. } => {
                if peer.outgoing.send_control(bytes).is_err() {
                    tracing::warn!(peer = to.0, "control lane too slow, closing");
                    peer.outgoing.close(TransportCode::CONTROL_OVERFLOW.0);
                    peer.closing = true;
                    self.held_back.forget(to);
                }
                self.report(to);
            }
            Transmit::State { bytes, .. } => {
                let bytes_len = bytes.len();
                let dropped = peer.outgoing.send_state(bytes);
                if dropped > 0 {
                    tracing::debug!(peer = to.0, bytes_len, dropped, "state datagrams not sent");
                }
            }
            Transmit::Close { code, .. } => {
                peer.outgoing.close(code);
                peer.closing = true;
                self.held_back.forget(to);
            }
        }
    }
}

impl<E> Drop for WithUnixPeers<'_, E> {
    /// Closes every connection, and stops listening.
    fn drop(&mut self) {
        for peer in self.peers.values().filter(|peer| !peer.closing) {
            peer.outgoing.close(TransportCode::GOING_AWAY.0);
        }
        self.stop.store(true, Ordering::Relaxed);
        // Wakes the thread that accepts; without a listener it has ended.
        let _ = UnixStream::connect(&self.socket.path);
    }
}

impl Drop for UnixServer {
    fn drop(&mut self) {
        // A file that is gone needs no removal.
        let _ = fs::remove_file(&self.path);
    }
}

impl<E: Endpoint> Endpoint for WithUnixPeers<'_, E> {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.endpoint.handle_opened(now, peer);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.endpoint.handle_control(now, from, bytes);
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.endpoint.handle_datagram(now, from, bytes);
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.endpoint.handle_ended(now, peer, ending);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.endpoint.handle_timeout(now);
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        self.endpoint.handle_link(now, peer, report);
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.endpoint.handle_control_taken(now, peer, bytes);
    }

    fn wants_control(&self, from: Peer) -> bool {
        self.endpoint.wants_control(from)
    }

    /// The next transmission of the network; those of the socket leave on the way.
    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.handle_inputs();
        loop {
            while let Some(transmit) = self.endpoint.poll_transmit() {
                let (Transmit::Control { to, .. }
                | Transmit::State { to, .. }
                | Transmit::Close { to, .. }) = &transmit;
                if to.0 < FIRST_PEER {
                    return Some(transmit);
                }
                self.send(transmit);
            }
            if !self.held_back.deliver(self.clock.now(), self.endpoint) {
                return None;
            }
        }
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.endpoint.poll_timeout()
    }
}

/// Waiting bytes beyond which a socket is not read.
const WAITING_MAX: usize = 256 << 10;
/// Interval of the checks whether a connection that is not read has ended.
const END_CHECK: Duration = Duration::from_millis(100);

/// The waiting bytes of one connection.
#[derive(Debug, Default)]
struct Credit {
    waiting: Mutex<usize>,
    freed: Condvar,
}

/// Waiting bytes, which hold their share of the bound until they are dropped.
#[derive(Debug)]
struct WaitingBytes {
    bytes: Bytes,
    credit: Arc<Credit>,
}

impl Credit {
    /// Waits until the bound allows more bytes, or until their connection has ended.
    ///
    /// The server holds bytes back until it learns of the end, which comes after the last of them. Before the end
    /// no more arrives than a socket's buffer takes, which needs no other bound.
    pub(crate) fn admit(
        self: &Arc<Self>,
        bytes: Bytes,
        has_ended: impl Fn() -> bool,
    ) -> WaitingBytes {
        let mut waiting = self.lock();
        while *waiting > WAITING_MAX && !has_ended() {
            (waiting, _) = self.freed.wait_timeout(waiting, END_CHECK).expect(LOCK);
        }
        *waiting += bytes.len();
        let credit = Arc::clone(self);
        WaitingBytes { bytes, credit }
    }

    fn lock(&self) -> MutexGuard<'_, usize> {
        self.waiting.lock().expect(LOCK)
    }
}

impl AsRef<[u8]> for WaitingBytes {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl Drop for WaitingBytes {
    fn drop(&mut self) {
        *self.credit.lock() -= self.bytes.len();
        self.credit.freed.notify_one();
    }
}

const LOCK: &str = "nothing panics while a number is locked";
