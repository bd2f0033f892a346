//! Servers in the process of the application, and the page of their scenes.
//!
//! Compiled by the feature `serve`. [`ServedScenes`] has sockets, so that other processes join; a [`LocalServer`] has none,
//! and its page has some of its own. Bytes that a peer of the network sends to such a server pass unread.

use core::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::collections::BTreeMap;
use std::io;
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use rhumb_client::{
    Checkpoint, CheckpointError, Client, ClientTransport, FeedError, Fingerprint, LocalServer,
    OpenError, Received, ServerConnection, TransportCode, Trust,
};
use rhumb_protocol::{
    Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit, Wake, WakeReason,
};
use rhumb_server::{
    Access, Checkpoints, Identity, PageBeside, RunError, Server, Stop, ViewScene, outward_ip,
};

use crate::error::BindingError;
use crate::joining::address_with;

/// The machines that may reach a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// This one.
    ThisMachine,
    /// All that the address reaches. There are no tokens: each client may do everything.
    Network,
}

/// A server on threads of this process, which other processes join. It ends when this is dropped.
#[derive(Debug)]
pub struct ServedScenes {
    listens: SocketAddr,
    fingerprint: Fingerprint,
    /// The page, or the reason why there is none.
    page: Result<String, &'static str>,
    checkpoints: Checkpoints,
    stop: Stop,
    /// The reason why it stopped by itself.
    failed: Arc<OnceLock<RunError>>,
    thread: Option<JoinHandle<()>>,
}

impl ServedScenes {
    /// Listens at an address, port 0 for a free one, and begins to serve.
    ///
    /// # Errors
    ///
    /// [`BindingError`] for an address that cannot be used, and for one that other machines reach unless that is meant.
    pub fn start(listen: &str, reach: Reach) -> Result<Self, BindingError> {
        let listen = listened(listen, reach)?;
        let access = match reach {
            Reach::ThisMachine => Access::OpenOnLoopback,
            Reach::Network => Access::OpenToNetwork,
        };
        let mut server = Server::bind(listen, &Identity::Development, access)?;
        let page = match server.show_page(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), Vec::new()) {
            Ok(page) => Ok(format!("http://{page}/")),
            Err(RunError::View(rhumb_server::ViewError::Unavailable(reason))) => Err(reason),
            Err(error) => return Err(error.into()),
        };
        let (listens, fingerprint) = (server.address(), server.fingerprint());
        let checkpoints = server.checkpoints();
        let stop = Stop::new();
        let run = {
            let stop = stop.clone();
            move || server.run(&stop).map(drop)
        };
        let (failed, thread) = Self::spawn(run).map_err(RunError::Thread)?;
        Ok(Self {
            listens,
            fingerprint,
            page,
            checkpoints,
            stop,
            failed,
            thread: Some(thread),
        })
    }

    /// Runs a server on a thread, which keeps the reason why it stops by itself: each client sees only that its connection
    /// has ended.
    fn spawn(
        run: impl FnOnce() -> Result<(), RunError> + Send + 'static,
    ) -> io::Result<(Arc<OnceLock<RunError>>, JoinHandle<()>)> {
        let failed = Arc::new(OnceLock::new());
        let kept = Arc::clone(&failed);
        let run = move || {
            if let Err(error) = run() {
                kept.get_or_init(|| error);
            }
        };
        let thread = thread::Builder::new().name("rhumb-serve".to_owned());
        Ok((failed, thread.spawn(run)?))
    }

    /// An error if it stopped by itself.
    fn check(&self) -> Result<(), BindingError> {
        let failed = self.failed.get().map(ToString::to_string);
        failed.map_or(Ok(()), |reason| Err(BindingError::ServerEnded(reason)))
    }

    /// The address with the fingerprint: the one text by which other processes connect. Of a server at all addresses of this
    /// machine, it is the one by which other machines reach it.
    #[must_use]
    pub fn address(&self) -> String {
        address_with(outward(self.listens), self.fingerprint)
    }

    /// A connection from this process.
    ///
    /// # Errors
    ///
    /// As [`Client::connect_within`], and [`BindingError::ServerEnded`] if it stopped by itself.
    pub fn connect(&self, timeout: Duration) -> Result<ServerConnection, BindingError> {
        self.check()?;
        let trust = Trust::Fingerprint(self.fingerprint);
        let address = self.reached().to_string();
        Ok(Client::connect_within(&address, trust, timeout)?)
    }

    /// An answer of its scenes, or the reason why it gives none.
    fn answered<T>(&self, answer: Result<T, CheckpointError>) -> Result<T, BindingError> {
        if matches!(answer, Err(CheckpointError::NoServer)) {
            self.check()?;
        }
        Ok(answer?)
    }

    /// The address by which this machine reaches it.
    fn reached(&self) -> SocketAddr {
        let mut address = self.listens;
        if address.ip().is_unspecified() {
            address.set_ip(loopback(address.ip()));
        }
        address
    }
}

/// An address to listen at, which other machines do not reach unless that is meant.
fn listened(listen: &str, reach: Reach) -> Result<SocketAddr, BindingError> {
    let needed = "an address with a port, such as 127.0.0.1:0";
    let listen: SocketAddr = listen
        .parse()
        .map_err(|_| BindingError::value("listen", format_args!("{listen:?}"), needed))?;
    if reach == Reach::ThisMachine && !listen.ip().is_loopback() {
        let needed = "an address of this machine alone, such as 127.0.0.1:0, unless open_to_network says that other \
                      machines may do everything in it, without a token";
        return Err(BindingError::value("listen", listen, needed));
    }
    Ok(listen)
}

const fn loopback(any: IpAddr) -> IpAddr {
    match any {
        IpAddr::V4(_) => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(_) => IpAddr::V6(Ipv6Addr::LOCALHOST),
    }
}

/// The address by which other machines reach one that is bound. A machine without a network has itself alone.
fn outward(mut address: SocketAddr) -> SocketAddr {
    let bound = address.ip();
    if bound.is_unspecified() {
        // A socket at [::] takes both kinds.
        let either = [bound, Ipv4Addr::UNSPECIFIED.into()];
        let outward = either.into_iter().find_map(|any| outward_ip(any).ok());
        address.set_ip(outward.unwrap_or_else(|| loopback(bound)));
    }
    address
}

impl Drop for ServedScenes {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread ended its clients, which have seen that.
            let _ = thread.join();
        }
    }
}

/// The server of a scene, where it is in this process.
#[derive(Clone)]
pub enum OwnServer {
    /// Without sockets.
    Local(LocalServer),
    /// With sockets.
    Served(Arc<ServedScenes>),
    /// Without sockets of its own, beside a door for other processes: the server of scenes that a client feeds.
    Fed(LocalServer, Arc<PageBeside>),
}

impl OwnServer {
    /// A connection of one more client. `timeout` holds for every later call that waits.
    ///
    /// # Errors
    ///
    /// As [`ServedScenes::connect`]; a server without sockets has none.
    pub fn connect(&self, timeout: Duration) -> Result<ServerConnection, BindingError> {
        match self {
            Self::Local(server) | Self::Fed(server, _) => Ok(server.connect().timeout(timeout)),
            Self::Served(served) => served.connect(timeout),
        }
    }

    /// A server of scenes that a client feeds, which other processes join at an address. It steps on a thread of its own.
    ///
    /// # Errors
    ///
    /// As [`ServedScenes::start`].
    pub fn fed(listen: &str, reach: Reach, scene: &str) -> Result<Self, BindingError> {
        let listen = listened(listen, reach)?;
        let server = LocalServer::spawn().map_err(RunError::Thread)?;
        let door = page_of(&server, listen, scene)?;
        Ok(Self::Fed(server, Arc::new(door)))
    }

    /// The connection of the client that will feed a scene.
    ///
    /// # Errors
    ///
    /// As [`LocalServer::feed`].
    pub fn feed(&self, scene: &str, timeout: Duration) -> Result<ServerConnection, BindingError> {
        match self {
            Self::Local(server) | Self::Fed(server, _) => Ok(server.feed(scene)?.timeout(timeout)),
            Self::Served(_) => Err(OpenError::Feed(FeedError::NoServer).into()),
        }
    }

    /// The state of a scene, with everything that the server has read.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] as [`LocalServer::save`], and [`BindingError::ServerEnded`] if the server stopped by itself.
    pub fn save(&self, scene: &str) -> Result<Checkpoint, BindingError> {
        match self {
            Self::Local(server) | Self::Fed(server, _) => Ok(server.save(scene)?),
            Self::Served(served) => served.answered(served.checkpoints.save(scene)),
        }
    }

    /// Makes a scene that continues from a checkpoint.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] as [`LocalServer::restore`], and [`BindingError::ServerEnded`] if the server stopped by itself.
    pub fn restore(&self, scene: &str, checkpoint: &Checkpoint) -> Result<(), BindingError> {
        match self {
            Self::Local(server) | Self::Fed(server, _) => Ok(server.restore(scene, checkpoint)?),
            Self::Served(served) => served.answered(served.checkpoints.restore(scene, checkpoint)),
        }
    }

    /// The one text by which other processes connect; `None` without sockets.
    #[must_use]
    pub fn address(&self) -> Option<String> {
        match self {
            Self::Local(_) => None,
            Self::Served(served) => Some(served.address()),
            Self::Fed(_, door) => Some(address_with(outward(door.listens()), door.fingerprint())),
        }
    }
}

/// The server of a joined scene, and the page that shows it.
pub(crate) struct SceneServer {
    origin: OwnServer,
    scene: String,
    /// Of a local server, once it was asked for.
    page: Option<PageBeside>,
}

impl SceneServer {
    pub(crate) fn new(origin: OwnServer, scene: &str) -> Self {
        Self {
            origin,
            scene: scene.to_owned(),
            page: None,
        }
    }

    /// The one text by which other processes connect.
    pub(crate) fn address(&self) -> Option<String> {
        self.origin.address()
    }

    /// The state of the scene.
    pub(crate) fn save(&self) -> Result<Checkpoint, BindingError> {
        self.origin.save(&self.scene)
    }

    /// The address of the page that shows the scene; it answers until the scene is closed.
    pub(crate) fn page(&mut self) -> Result<String, BindingError> {
        let page = match &self.origin {
            OwnServer::Served(served) => {
                served.check()?;
                served.page.clone().map_err(BindingError::NoPage)?
            }
            OwnServer::Fed(_, door) => door.url(),
            OwnServer::Local(server) => match &self.page {
                Some(page) => page.url(),
                None => {
                    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
                    let started = page_of(server, any, &self.scene)?;
                    self.page.insert(started).url()
                }
            },
        };
        Ok(format!("{page}?scene={}", escaped(&self.scene)))
    }
}

/// The page of a scene of a server without sockets, and the door to it at an address.
fn page_of(
    server: &LocalServer,
    listen: SocketAddr,
    scene: &str,
) -> Result<PageBeside, BindingError> {
    let shown = ViewScene {
        name: scene.to_owned(),
        player: None,
    };
    let server = server.clone();
    let started = PageBeside::start(listen, vec![shown], |waker| {
        NetworkDoor::new(move || {
            let waker = waker.clone();
            server.open(move || waker.wake())
        })
    });
    match started {
        Err(RunError::View(rhumb_server::ViewError::Unavailable(reason))) => {
            Err(BindingError::NoPage(reason))
        }
        started => Ok(started?),
    }
}

/// A text as a value in an address.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    for byte in text.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => {
                escaped.push(char::from(byte));
            }
            _ => escaped += &format!("%{byte:02X}"),
        }
    }
    escaped
}

/// Control bytes that a link may have still to take.
const WINDOW_BYTES: usize = 256 << 10;
/// Time between two looks at a server that steps within calls: a page moves on while the program makes none.
const LOOK: Span = Span::from_millis(5);

/// Carries connections of the network to a server in this process.
struct NetworkDoor {
    open: Box<dyn FnMut() -> Box<dyn ClientTransport> + Send>,
    carried: BTreeMap<Peer, Carried>,
    next_look: Instant,
}

/// One carried connection.
struct Carried {
    inner: Box<dyn ClientTransport>,
    /// Control bytes that the link has still to take.
    ahead: usize,
    /// True once its end was handed on.
    ended: bool,
}

impl NetworkDoor {
    /// `open` opens one more connection to the server.
    fn new(open: impl FnMut() -> Box<dyn ClientTransport> + Send + 'static) -> Self {
        Self {
            open: Box::new(open),
            carried: BTreeMap::new(),
            next_look: Instant::ZERO,
        }
    }
}

impl Carried {
    /// The next bytes of the server for this peer.
    fn poll(&mut self, to: Peer) -> Option<Transmit> {
        if self.ended || self.ahead >= WINDOW_BYTES {
            return None;
        }
        Some(match self.inner.recv(Duration::ZERO)? {
            Received::Control(bytes) => {
                self.ahead += bytes.len();
                Transmit::Control { to, bytes }
            }
            Received::State(bytes) => Transmit::State { to, bytes },
            Received::Ended(ending) => {
                self.ended = true;
                let code = match ending {
                    Ending::Closed(code) => code,
                    Ending::TimedOut | Ending::Broken => TransportCode::GOING_AWAY.0,
                };
                Transmit::Close { to, code }
            }
        })
    }
}

impl Endpoint for NetworkDoor {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let carried = Carried {
            inner: (self.open)(),
            ahead: 0,
            ended: false,
        };
        self.carried.insert(peer, carried);
        self.next_look = now + LOOK;
    }

    fn handle_control(&mut self, _now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(carried) = self.carried.get(&from) {
            carried.inner.send_control(Bytes::copy_from_slice(bytes));
        }
    }

    fn handle_datagram(&mut self, _now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(carried) = self.carried.get(&from) {
            carried.inner.send_state(Bytes::copy_from_slice(bytes));
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        let carried = self.carried.get(&from);
        carried.is_none_or(|carried| carried.inner.wants_control())
    }

    fn handle_link(&mut self, _now: Instant, peer: Peer, report: &LinkReport) {
        if let Some(carried) = self.carried.get(&peer) {
            carried.inner.report_link(report);
        }
    }

    fn handle_ended(&mut self, _now: Instant, peer: Peer, _ending: Ending) {
        // Its connection ends with it.
        self.carried.remove(&peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.next_look = now + LOOK;
    }

    fn handle_control_taken(&mut self, _now: Instant, peer: Peer, bytes: usize) {
        if let Some(carried) = self.carried.get_mut(&peer) {
            carried.ahead = carried.ahead.saturating_sub(bytes);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        let mut each = self.carried.iter_mut();
        each.find_map(|(peer, carried)| carried.poll(*peer))
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let look = Wake {
            at: self.next_look,
            reason: WakeReason::Input,
        };
        (!self.carried.is_empty()).then_some(look)
    }
}

#[cfg(test)]
mod tests {
    use core::net::SocketAddr;
    use std::sync::{Arc, Mutex};
    use std::thread;

    use rhumb_client::scene::{BodyDesc, Shape};
    use rhumb_client::{
        Client, JoinMode, JoinOptions, LocalServer, PipelineDepth, TransportCode, Trust,
        WireStatistics,
    };
    use rhumb_transport::{Certificate, QuicServer, ServerOptions, Stop};

    use super::*;

    #[test]
    fn a_server_that_stops_by_itself_says_why() {
        let mut served = ServedScenes::start("127.0.0.1:0", Reach::ThisMachine).expect("it starts");
        served
            .connect(Duration::from_secs(5))
            .map(drop)
            .expect("it answers");
        let failing = || Err(RunError::Thread(io::Error::other("no more threads")));
        let (failed, thread) = ServedScenes::spawn(failing).expect("a thread");
        thread.join().expect("no panic");
        served.failed = failed;
        let refused = served.connect(Duration::from_secs(5)).err();
        let refused = refused.expect("it has stopped").to_string();
        assert!(refused.contains("no more threads"), "{refused}");
    }

    /// A server that has control bytes without end.
    struct Endless;

    impl ClientTransport for Endless {
        fn send_control(&self, _bytes: Bytes) {}

        fn send_state(&self, _bytes: Bytes) {}

        fn close(&self, _code: u32) {}

        fn recv(&mut self, _timeout: Duration) -> Option<Received> {
            Some(Received::Control(Bytes::from_static(&[0; 1 << 10])))
        }

        fn statistics(&self) -> WireStatistics {
            WireStatistics::default()
        }
    }

    #[test]
    fn a_slow_reader_is_given_a_window_and_does_not_hold_up_others() {
        let mut door = NetworkDoor::new(|| Box::new(Endless));
        let (slow, other) = (Peer(1), Peer(2));
        let drain = |door: &mut NetworkDoor, peer: Peer| {
            let all = std::iter::from_fn(|| door.poll_transmit());
            let own =
                all.filter(|sent| matches!(sent, Transmit::Control { to, .. } if *to == peer));
            own.count()
        };
        assert_eq!(door.poll_timeout(), None);
        door.handle_opened(Instant::ZERO, slow);
        assert_eq!(drain(&mut door, slow), WINDOW_BYTES >> 10);
        door.handle_opened(Instant::ZERO, other);
        assert_eq!(drain(&mut door, other), WINDOW_BYTES >> 10);
        door.handle_control_taken(Instant::ZERO, slow, 3 << 10);
        assert_eq!(drain(&mut door, slow), 3);
        door.handle_ended(Instant::ZERO, slow, Ending::Broken);
        door.handle_ended(Instant::ZERO, other, Ending::Closed(TransportCode::LEFT.0));
        assert_eq!(door.poll_timeout(), None);
    }

    /// A server that has enough for now, and the round trips that were reported to it.
    struct SatedServer(Arc<Mutex<Vec<Span>>>);

    impl ClientTransport for SatedServer {
        fn send_control(&self, _bytes: Bytes) {}

        fn send_state(&self, _bytes: Bytes) {}

        fn close(&self, _code: u32) {}

        fn recv(&mut self, _timeout: Duration) -> Option<Received> {
            None
        }

        fn statistics(&self) -> WireStatistics {
            WireStatistics::default()
        }

        fn wants_control(&self) -> bool {
            false
        }

        fn report_link(&self, report: &LinkReport) {
            self.0.lock().expect("no panic").push(report.round_trip);
        }
    }

    #[test]
    fn a_server_that_has_enough_slows_the_peer_down_and_hears_of_its_link() {
        let reported = Arc::new(Mutex::new(Vec::new()));
        let mut door = NetworkDoor::new({
            let reported = Arc::clone(&reported);
            move || Box::new(SatedServer(Arc::clone(&reported)))
        });
        let peer = Peer(1);
        door.handle_opened(Instant::ZERO, peer);
        assert!(!door.wants_control(peer));
        let report = LinkReport {
            waiting_bytes: 0,
            sent_bytes: 0,
            over: Span::from_millis(100),
            round_trip: Span::from_millis(7),
        };
        door.handle_link(Instant::ZERO, peer, &report);
        assert_eq!(reported.lock().expect("no panic")[..], [report.round_trip]);
        door.handle_ended(Instant::ZERO, peer, Ending::Broken);
        assert!(door.wants_control(peer));
    }

    #[test]
    fn a_client_of_the_network_joins_a_scene_of_this_process_and_sees_its_bodies() {
        let server = LocalServer::new();
        let mut own = server.connect().join("shared").expect("the scene is made");
        let certificate = Certificate::development(["localhost"]).expect("a certificate");
        let listen = SocketAddr::from(([127, 0, 0, 1], 0));
        let transport =
            QuicServer::bind(ServerOptions::new(listen, certificate)).expect("a socket");
        let (address, print) = (transport.local_addr(), transport.fingerprint());
        let (stop, waker) = (Stop::new(), transport.waker());
        let mut door = NetworkDoor::new(move || {
            let waker = waker.clone();
            server.open(move || waker.wake())
        });
        let carrying = thread::spawn({
            let stop = stop.clone();
            move || transport.run(&mut door, &stop)
        });
        let connected = Client::connect(&address.to_string(), Trust::Fingerprint(print));
        let options = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        let joined = connected
            .expect("the door answers")
            .join_with("shared", options);
        let mut other = joined.expect("the scene is there");
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
        let ball = own.add_body(ball).expect("a ball");
        for _ in 0..30 {
            own.advance(PipelineDepth::LOCKSTEP).expect("a step");
            other.advance(PipelineDepth::LOCKSTEP).expect("a step");
        }
        let heights =
            [&own, &other].map(|client| client.view().position(ball).expect("the ball").y);
        assert!(
            (heights[0] - heights[1]).abs() < 0.2 && heights[1] < 9.5,
            "{heights:?}"
        );
        stop.stop();
        carrying.join().expect("no panic").expect("a stop");
    }
}
