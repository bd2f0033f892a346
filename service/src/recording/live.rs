//! The thread that shows scenes to Foxglove's viewers.

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::net::{SocketAddr, TcpListener};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_trace::{LiveError, LiveScenes};
use rhumb_transport::{Origins, PageOrigin};

use super::door::{HiddenEndpoint, ViewerDoor, hidden_address};
use super::recorder::RecordingLimits;
use super::tap::{QueuedBytes, SceneTaps, TapMessage, TapQueue};
use super::writer::SceneWriter;
use crate::tcp::TcpService;

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
