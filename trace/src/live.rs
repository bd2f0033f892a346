//! Scenes live for viewers, over Foxglove's WebSocket protocol.
//!
//! A topic is announced with its first message. A viewer that subscribes gets nothing until it is admitted, which is
//! followed by a message on every topic that is whole: so its first message of a topic is a whole one.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{
    ChannelBuilder, Context, FoxgloveError, PartialMetadata, RawChannel, SinkId, WebSocketServer,
    WebSocketServerHandle,
};
use prost::Message;
use tokio::runtime::Runtime;

use super::topics::{Topic, TraceSink};

/// Messages that wait for a slow viewer; beyond them it misses the oldest.
const BACKLOG: usize = 256;

/// Viewers at an address.
pub struct LiveScenes {
    context: Arc<Context>,
    address: SocketAddr,
    name: String,
    handle: WebSocketServerHandle,
    channels: BTreeMap<String, Arc<RawChannel>>,
    subscriptions: Arc<Subscriptions>,
    buffer: Vec<u8>,
    /// Runs the connections; dropped last.
    runtime: Runtime,
}

/// Reason why scenes cannot be shown live.
#[derive(Debug)]
pub enum LiveError {
    /// Listening at the address failed.
    Listen {
        /// The TCP address.
        address: SocketAddr,
        /// The cause.
        cause: FoxgloveError,
    },
    /// The system starts no thread.
    Thread(std::io::Error),
}

impl fmt::Display for LiveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Listen { address, cause } => write!(
                f,
                "cannot serve Foxglove at tcp {address}: {cause}; choose another address by --foxglove ADDRESS"
            ),
            Self::Thread(cause) => write!(f, "cannot start a thread: {cause}"),
        }
    }
}

impl std::error::Error for LiveError {}

/// The subscriptions of all viewers.
#[derive(Default)]
struct Subscriptions(Mutex<Subscribed>);

#[derive(Default)]
struct Subscribed {
    /// Topics and their viewers.
    waiting: BTreeSet<(String, SinkId)>,
    /// Topics and viewers that get messages.
    admitted: BTreeSet<(String, SinkId)>,
}

impl Subscriptions {
    fn lock(&self) -> MutexGuard<'_, Subscribed> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Admits the subscriptions that wait; true if there are any.
    fn admit(&self) -> bool {
        let mut subscribed = self.lock();
        let waiting = std::mem::take(&mut subscribed.waiting);
        let is_new = !waiting.is_empty();
        subscribed.admitted.extend(waiting);
        is_new
    }

    fn admitted(&self, topic: &str) -> Vec<SinkId> {
        let subscribed = self.lock();
        let of_topic = subscribed.admitted.iter().filter(|(of, _)| of == topic);
        of_topic.map(|(_, sink)| *sink).collect()
    }
}

impl ServerListener for Subscriptions {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        let sink = client
            .sink_id()
            .map(|sink| (channel.topic().to_owned(), sink));
        self.lock().waiting.extend(sink);
    }

    fn on_unsubscribe(&self, client: Client, channel: ChannelView) {
        if let Some(sink) = client.sink_id() {
            let subscription = (channel.topic().to_owned(), sink);
            let mut subscribed = self.lock();
            subscribed.waiting.remove(&subscription);
            subscribed.admitted.remove(&subscription);
        }
    }
}

impl LiveScenes {
    /// Listens at a TCP address; `name` is shown to viewers. It asks for no token and no origin: any program that
    /// reaches the address sees the scenes, and any web page that a browser of this machine shows.
    ///
    /// # Errors
    ///
    /// [`LiveError`] for an address that cannot be used.
    pub fn listen(address: SocketAddr, name: &str) -> Result<Self, LiveError> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .thread_name("rhumb-foxglove-io")
            .enable_all()
            .build()
            .map_err(LiveError::Thread)?;
        let (context, subscriptions) = (Context::new(), Arc::new(Subscriptions::default()));
        let handle = serve(address, name, &context, &subscriptions, &runtime)?;
        Ok(Self {
            context,
            address,
            name: name.to_owned(),
            handle,
            channels: BTreeMap::new(),
            subscriptions,
            buffer: Vec::new(),
            runtime,
        })
    }

    /// Listens again with the same topics. The library stops accepting, without a word, when the system has no descriptors
    /// for a connection. A port that was chosen by the system is another one then.
    ///
    /// # Errors
    ///
    /// [`LiveError`] for an address that cannot be used; then nothing has changed.
    pub fn listen_again(&mut self) -> Result<(), LiveError> {
        self.handle = serve(
            self.address,
            &self.name,
            &self.context,
            &self.subscriptions,
            &self.runtime,
        )?;
        Ok(())
    }

    /// The address that it listens at.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        SocketAddr::new(self.address.ip(), self.handle.port())
    }

    /// Admits the viewers that have subscribed since the last call. True if there are any: then every topic is to be
    /// written whole, before anything else.
    #[must_use]
    pub fn admit_viewers(&mut self) -> bool {
        self.subscriptions.admit()
    }

    /// Withdraws all topics whose names begin with this prefix.
    pub fn withdraw(&mut self, prefix: &str) {
        self.channels.retain(|name, channel| {
            let stays = !name.starts_with(prefix);
            if !stays {
                channel.close();
            }
            stays
        });
    }

    /// The channel of a topic, which is announced if it is new.
    fn channel(&mut self, topic: &Topic) -> Result<Arc<RawChannel>, FoxgloveError> {
        if let Some(channel) = self.channels.get(&topic.name) {
            return Ok(Arc::clone(channel));
        }
        let channel = ChannelBuilder::new(&topic.name)
            .context(&self.context)
            .message_encoding("protobuf")
            .schema(Some(topic.schema.message_schema()))
            .build_raw()?;
        self.channels
            .insert(topic.name.clone(), Arc::clone(&channel));
        Ok(channel)
    }
}

fn serve(
    address: SocketAddr,
    name: &str,
    context: &Arc<Context>,
    subscriptions: &Arc<Subscriptions>,
    runtime: &Runtime,
) -> Result<WebSocketServerHandle, LiveError> {
    let server = WebSocketServer::new()
        .name(name)
        .bind(address.ip().to_string(), address.port())
        .context(context)
        .message_backlog_size(BACKLOG)
        .listener(Arc::<Subscriptions>::clone(subscriptions))
        .tokio_runtime(runtime.handle());
    let started = runtime.block_on(server.start());
    started.map_err(|cause| LiveError::Listen { address, cause })
}

impl TraceSink for LiveScenes {
    type Error = FoxgloveError;

    fn put(
        &mut self,
        topic: &mut Topic,
        at_ns: u64,
        message: &impl Message,
    ) -> Result<(), FoxgloveError> {
        let channel = self.channel(topic)?;
        topic.sequence = topic.sequence.wrapping_add(1);
        let sinks = self.subscriptions.admitted(&topic.name);
        if sinks.is_empty() {
            return Ok(());
        }
        self.buffer.clear();
        message
            .encode(&mut self.buffer)
            .expect("a vector grows as needed");
        for sink in sinks {
            let metadata = PartialMetadata::with_log_time(at_ns);
            channel.log_with_meta_to_sink(&self.buffer, metadata, Some(sink));
        }
        Ok(())
    }
}
