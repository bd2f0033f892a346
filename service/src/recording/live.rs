//! The thread that shows scenes to Foxglove's viewers.

use std::collections::BTreeMap;
use std::io;
use std::net::SocketAddr;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_protocol::scene::SceneName;
use rhumb_trace::{LiveError, LiveScenes};

use super::recorder::RecordingLimits;
use super::tap::{QueuedBytes, SceneTaps, TapMessage, TapQueue};
use super::writer::SceneWriter;

/// Longest time until a new viewer of a scene that stands still sees it.
const LOOK: Duration = Duration::from_millis(200);
/// The name of the server in a viewer.
const NAME: &str = concat!("rhumb-server ", env!("CARGO_PKG_VERSION"));

/// The socket and the thread; dropping this ends both.
pub(crate) struct LiveViewers {
    messages: Sender<TapMessage>,
    thread: Option<JoinHandle<()>>,
}

/// Viewers at an address, not served yet.
pub(crate) struct BoundViewers(LiveScenes);

impl BoundViewers {
    /// Listens at a TCP address.
    pub(crate) fn bind(address: SocketAddr) -> Result<Self, LiveError> {
        LiveScenes::listen(address, NAME).map(Self)
    }

    /// The port that it listens at.
    pub(crate) fn port(&self) -> u16 {
        self.0.port()
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
        let showing = Showing {
            live: self.0,
            scenes: BTreeMap::new(),
        };
        let thread = thread::Builder::new()
            .name("rhumb-foxglove".to_owned())
            .spawn(move || showing.run(&received, &waiting))?;
        Ok(LiveViewers {
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
    scenes: BTreeMap<SceneName, (u64, SceneWriter)>,
}

impl Showing {
    fn run(mut self, messages: &Receiver<TapMessage>, waiting: &QueuedBytes) {
        loop {
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

    /// Sends every scene whole.
    fn show_all(&mut self) {
        for (scene, (_, writer)) in &mut self.scenes {
            if let Err(cause) = writer.write_whole(&mut self.live) {
                tracing::warn!(%scene, %cause, "a scene cannot be shown to viewers");
            }
        }
    }
}
