//! The thread that shows scenes to Foxglove's viewers, and the door before it.
//!
//! The library behind the door asks no client for its origin. It listens at an address that cannot be guessed. The door reads
//! the head of each request, refuses web pages of others, and passes the rest on. The library stops accepting when the
//! system has no descriptors; the door says so.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use std::{fmt, io};

use hyper::StatusCode;
use rhumb_protocol::scene::SceneName;
use rhumb_trace::{LiveError, LiveScenes};
use rhumb_transport::{Origins, PageOrigin, random_bytes};
use tokio::io::{AsyncReadExt, AsyncWriteExt, copy_bidirectional};
use tokio::net::{TcpSocket, TcpStream};
use tokio::time::timeout;

use super::recorder::RecordingLimits;
use super::tap::{QueuedBytes, SceneTaps, SceneWriter, TapMessage, TapQueue};
use crate::http::{TcpService, reached_host};

/// Longest time until a new viewer of a scene that stands still sees it.
const LOOK: Duration = Duration::from_millis(200);
/// The name of the server in a viewer.
const NAME: &str = concat!("rhumb-server ", env!("CARGO_PKG_VERSION"));

/// The page of Foxglove's viewer in a browser.
const FOXGLOVE_PAGE: &str = "https://app.foxglove.dev";

/// The sockets and the threads; dropping this ends them.
pub(crate) struct LiveViewers {
    _door: TcpService,
    messages: Sender<TapMessage>,
    thread: Option<JoinHandle<()>>,
}

/// Reason why viewers cannot be served.
#[derive(Debug)]
pub enum ViewersError {
    /// Listening at the address failed.
    Listen {
        /// The TCP address.
        address: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The endpoint behind the address cannot start.
    Endpoint(LiveError),
}

impl fmt::Display for ViewersError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Listen { address, cause } => write!(
                f,
                "cannot serve Foxglove at tcp {address}: {cause}; choose another address by --foxglove ADDRESS"
            ),
            Self::Endpoint(cause) => cause.fmt(f),
        }
    }
}

impl std::error::Error for ViewersError {}

/// Viewers at an address, not served yet.
pub(crate) struct BoundViewers {
    listener: TcpListener,
    address: SocketAddr,
    pages: Origins,
    live: LiveScenes,
}

impl BoundViewers {
    /// Listens at a TCP address. Web pages of others than `pages`, of this machine and of Foxglove do not pass.
    pub(crate) fn bind(address: SocketAddr, mut pages: Origins) -> Result<Self, ViewersError> {
        let failed = |cause| ViewersError::Listen { address, cause };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let local = listener.local_addr().map_err(failed)?;
        pages.allow(
            FOXGLOVE_PAGE
                .parse::<PageOrigin>()
                .expect("it is an origin"),
        );
        let hidden = hidden_address().map_err(failed)?;
        Ok(Self {
            listener,
            address: local,
            pages,
            live: LiveScenes::listen(hidden, NAME).map_err(ViewersError::Endpoint)?,
        })
    }

    /// Its address.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Shows the scenes that begin from now on.
    pub(crate) fn start(
        self,
        limits: RecordingLimits,
        taps: &SceneTaps,
    ) -> io::Result<LiveViewers> {
        let (messages, received) = channel();
        let waiting = QueuedBytes::default();
        taps.add(TapQueue {
            messages: messages.clone(),
            waiting: waiting.clone(),
            bytes_max: limits.waiting_bytes(),
        });
        let inner = HiddenEndpoint::default();
        inner.set(self.live.address());
        let door = ViewerDoor::new(self.pages, self.address, inner.clone()).open(self.listener)?;
        let showing = Showing {
            live: self.live,
            inner,
            scenes: BTreeMap::new(),
        };
        let thread = thread::Builder::new()
            .name("rhumb-foxglove".to_owned())
            .spawn(move || showing.run(&received, &waiting))?;
        Ok(LiveViewers {
            _door: door,
            messages,
            thread: Some(thread),
        })
    }
}

impl Drop for LiveViewers {
    fn drop(&mut self) {
        // Fails only if the thread has ended.
        let _ = self.messages.send(TapMessage::End);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was logged.
            let _ = thread.join();
        }
    }
}

/// The scenes that are shown.
struct Showing {
    live: LiveScenes,
    /// The address at which the door finds `live`.
    inner: HiddenEndpoint,
    scenes: BTreeMap<SceneName, (u64, SceneWriter)>,
}

impl Showing {
    fn run(mut self, messages: &Receiver<TapMessage>, waiting: &QueuedBytes) {
        loop {
            if self.inner.is_gone() {
                self.listen_again();
            }
            if self.live.admit_viewers() {
                self.show_all();
            }
            match messages.recv_timeout(LOOK) {
                Ok(TapMessage::Tick(record)) => {
                    let new = || (record.number, SceneWriter::new(&record));
                    let shown = self.scenes.entry(record.scene.clone()).or_insert_with(new);
                    if shown.0 != record.number {
                        *shown = new();
                    }
                    if let Err(cause) = shown.1.write(&mut self.live, &record) {
                        tracing::warn!(scene = %record.scene, %cause, "a tick cannot be shown to viewers");
                    }
                    waiting.remove(record.bytes());
                }
                Ok(TapMessage::Ended(scene, number)) => {
                    let is_shown = self.scenes.get(&scene).is_some_and(|(of, _)| *of == number);
                    if is_shown && let Some((_, writer)) = self.scenes.remove(&scene) {
                        self.live.withdraw(&format!("{}/truth/", writer.prefix()));
                    }
                }
                Ok(TapMessage::End) | Err(RecvTimeoutError::Disconnected) => return,
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Puts the endpoint back, which ended when the system had no descriptors.
    fn listen_again(&mut self) {
        match self.live.listen_again() {
            Ok(()) => {
                tracing::warn!("the endpoint for viewers had ended, and is back");
                self.inner.set(self.live.address());
            }
            Err(cause) => tracing::debug!(%cause, "the endpoint for viewers is not back yet"),
        }
    }

    /// Sends every scene whole.
    fn show_all(&mut self) {
        for (scene, (_, writer)) in &mut self.scenes {
            if let Err(cause) = writer.write_whole(&mut self.live) {
                tracing::warn!(%scene, %cause, "a scene cannot be shown to viewers");
            }
        }
    }
}

/// Time for the head of a request, and to reach the library.
const HEAD_TIMEOUT: Duration = Duration::from_secs(5);
/// Longest head of a request.
const HEAD_BYTES_MAX: usize = 16 << 10;
/// Most lines in a head.
const LINES_MAX: usize = 64;
/// Buffer of the socket towards the library, bytes: a slow viewer misses messages soon, and does not see them late.
const BUFFER_BYTES: u32 = 64 << 10;

/// The pages that may connect, and the address behind the door.
struct ViewerDoor {
    pages: Origins,
    /// True if other machines reach the door: then it answers to names.
    named: bool,
    inner: HiddenEndpoint,
}

/// The address of the library's listener.
#[derive(Clone, Default)]
struct HiddenEndpoint(Arc<Mutex<EndpointState>>);

#[derive(Default)]
struct EndpointState {
    address: Option<SocketAddr>,
    is_gone: bool,
}

impl HiddenEndpoint {
    fn state(&self) -> MutexGuard<'_, EndpointState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets where the library listens now.
    pub(super) fn set(&self, address: SocketAddr) {
        *self.state() = EndpointState {
            address: Some(address),
            is_gone: false,
        };
    }

    /// True if the library has stopped listening since [`Self::set`].
    pub(super) fn is_gone(&self) -> bool {
        self.state().is_gone
    }

    /// The library refused a connection to an address, which may be an earlier one.
    fn note_refusal(&self, of: SocketAddr) {
        let mut state = self.state();
        state.is_gone |= state.address == Some(of);
    }

    async fn connect(&self) -> io::Result<TcpStream> {
        let address = self.state().address;
        let address = address.ok_or(io::ErrorKind::NotConnected)?;
        let socket = TcpSocket::new_v4()?;
        socket.set_recv_buffer_size(BUFFER_BYTES)?;
        let connected = socket.connect(address).await;
        if let Err(cause) = &connected
            && cause.kind() == io::ErrorKind::ConnectionRefused
        {
            self.note_refusal(address);
        }
        connected
    }
}

/// An address for the library: of this machine, and not to be found by trying. A web page can try all ports of 127.0.0.1,
/// and nothing but the door would ask for its origin.
fn hidden_address() -> io::Result<SocketAddr> {
    // Other systems have 127.0.0.1 alone.
    let bytes = match cfg!(target_os = "linux") {
        true => random_bytes()?,
        false => [0; 3],
    };
    let ip = match bytes {
        // The network's own address, and its broadcast.
        [0, 0, 0] | [255, 255, 255] => Ipv4Addr::LOCALHOST,
        [b, c, d] => Ipv4Addr::new(127, b, c, d),
    };
    Ok(SocketAddr::new(IpAddr::V4(ip), 0))
}

/// A refusal: its status, and the reason.
type Refusal = (StatusCode, String);

impl ViewerDoor {
    /// A door for these pages at an address.
    pub(super) fn new(pages: Origins, address: SocketAddr, inner: HiddenEndpoint) -> Self {
        Self {
            pages,
            named: !address.ip().is_loopback(),
            inner,
        }
    }

    /// Opens it.
    pub(super) fn open(self, listener: TcpListener) -> io::Result<TcpService> {
        let door = Arc::new(self);
        let serving = move |stream, peer| -> Pin<Box<dyn Future<Output = ()> + Send>> {
            let door = Arc::clone(&door);
            Box::pin(async move {
                if let Err(cause) = door.serve(stream).await {
                    tracing::debug!(%peer, %cause, "a viewer's connection failed");
                }
            })
        };
        TcpService::start(listener, "rhumb-foxglove-door", Arc::new(serving))
    }

    async fn serve(&self, mut viewer: TcpStream) -> io::Result<()> {
        let head = timeout(HEAD_TIMEOUT, read_head(&mut viewer)).await?;
        let admitted = head?.and_then(|head| self.check(&head).map(|()| head));
        let head = match admitted {
            Ok(head) => head,
            Err(refusal) => return refuse(&mut viewer, refusal).await,
        };
        let library = timeout(HEAD_TIMEOUT, self.inner.connect()).await;
        let mut library = match library.unwrap_or_else(|elapsed| Err(elapsed.into())) {
            Ok(library) => library,
            Err(cause) => {
                let reason =
                    format!("the endpoint does not answer: {cause}; try again in a second");
                return refuse(&mut viewer, (StatusCode::SERVICE_UNAVAILABLE, reason)).await;
            }
        };
        viewer.set_nodelay(true)?;
        library.set_nodelay(true)?;
        library.write_all(&head).await?;
        copy_bidirectional(&mut viewer, &mut library).await?;
        Ok(())
    }

    /// Lets programs pass, and web pages that may.
    fn check(&self, head: &[u8]) -> Result<(), Refusal> {
        let mut lines = [httparse::EMPTY_HEADER; LINES_MAX];
        let mut request = httparse::Request::new(&mut lines);
        let parsed = request.parse(head);
        parsed.map_err(|cause| (StatusCode::BAD_REQUEST, cause.to_string()))?;
        let only = |name: &str| {
            let mut values = (request.headers.iter())
                .filter(|line| line.name.eq_ignore_ascii_case(name))
                .map(|line| str::from_utf8(line.value));
            match (values.next(), values.next()) {
                (None, _) => Ok(None),
                (Some(Ok(value)), None) => Ok(Some(value)),
                _ => Err((
                    StatusCode::BAD_REQUEST,
                    format!("a request has one line {name}, of text"),
                )),
            }
        };
        let forbidden = |reason: String| Err((StatusCode::FORBIDDEN, reason));
        let host = only("host")?.and_then(|host| reached_host(host, self.named));
        if host.is_none() {
            return forbidden(
                "connect by the address that the server printed, not by another name".into(),
            );
        }
        match only("origin")? {
            // Pages in a program's own folder; a browser writes `null` for pages of a disk.
            Some("file://") => Ok(()),
            origin if self.pages.allows(origin) => Ok(()),
            origin => forbidden(format!(
                "a page of {} may not see these scenes: allow it by --web-origin",
                origin.unwrap_or_default()
            )),
        }
    }
}

/// The first bytes of a connection, up to the end of the head at least.
async fn read_head(viewer: &mut TcpStream) -> io::Result<Result<Vec<u8>, Refusal>> {
    let mut head = Vec::new();
    while !head.windows(4).any(|end| end == b"\r\n\r\n") {
        if head.len() >= HEAD_BYTES_MAX {
            let reason = format!("a request's head has {HEAD_BYTES_MAX} bytes at most");
            return Ok(Err((StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE, reason)));
        }
        let mut more = [0; 2_048];
        match viewer.read(&mut more).await? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => head.extend_from_slice(&more[..read]),
        }
    }
    Ok(Ok(head))
}

async fn refuse(viewer: &mut TcpStream, (status, reason): Refusal) -> io::Result<()> {
    let answer = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{reason}\n",
        reason.len() + 1
    );
    viewer.write_all(answer.as_bytes()).await?;
    viewer.shutdown().await
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The status with which a door at an address answers a head; `None` if it lets it pass.
    fn status(address: &str, lines: &str) -> Option<u16> {
        let pages = ["https://app.example".parse().unwrap()];
        let door = ViewerDoor::new(
            pages.into_iter().collect(),
            address.parse().unwrap(),
            HiddenEndpoint::default(),
        );
        let head = format!("GET / HTTP/1.1\r\n{lines}\r\n\r\n");
        let checked = door.check(head.as_bytes());
        checked.err().map(|(status, _)| status.as_u16())
    }

    #[test]
    fn programs_and_pages_of_this_machine_pass_and_other_pages_do_not() {
        let here = "127.0.0.1:8765";
        for passes in [
            "Host: 127.0.0.1:8765",
            "host: [::1]:8765",
            "Host: localhost:8765\r\nOrigin: http://localhost:8080",
            "Host: localhost:8765\r\nOrigin: http://127.0.0.1:5173",
            "Host: localhost:8765\r\nOrigin: https://app.example",
            "Host: localhost:8765\r\nOrigin: file://",
        ] {
            assert_eq!(status(here, passes), None, "{passes}");
        }
        for refused in [
            "Accept: */*",
            "Host: rebound.example:8765",
            "Host: localhost:8765\r\nOrigin: null",
            "Host: localhost:8765\r\nOrigin: https://other.example",
            "Host: localhost:8765\r\nOrigin: http://localhost.other.example",
            "Host: localhost:8765\r\nOrigin: https://app.example.other",
        ] {
            assert_eq!(status(here, refused), Some(403), "{refused}");
        }
        for wrong in [
            "Host: localhost\r\nHost: other.example",
            "Host: localhost\r\nOrigin: http://localhost\r\norigin: http://other.example",
            "Host localhost",
        ] {
            assert_eq!(status(here, wrong), Some(400), "{wrong}");
        }
    }

    #[test]
    fn a_door_that_other_machines_reach_answers_to_names() {
        let there = "0.0.0.0:8765";
        assert_eq!(status(there, "Host: scenes.example:8765"), None);
        let page = "Host: scenes.example:8765\r\nOrigin: http://scenes.example";
        assert_eq!(status(there, page), Some(403));
    }

    #[test]
    fn an_endpoint_is_gone_when_it_refuses_and_a_late_refusal_of_an_earlier_one_does_not_count() {
        let closed = TcpListener::bind("127.0.0.1:0").unwrap();
        let (first, second) = (closed.local_addr().unwrap(), "127.0.0.1:1".parse().unwrap());
        drop(closed);
        let endpoint = HiddenEndpoint::default();
        endpoint.set(first);
        assert!(!endpoint.is_gone());
        let connecting = rhumb_transport::io_runtime().unwrap();
        assert!(connecting.block_on(endpoint.connect()).is_err());
        assert!(endpoint.is_gone());
        endpoint.set(second);
        endpoint.note_refusal(first);
        assert!(!endpoint.is_gone());
    }
}
