//! Scenes live for viewers, over Foxglove's WebSocket protocol.
//!
//! A topic is announced with its first message. Viewers get messages from then on; one that comes later is noticed, so
//! that the drawings can be sent whole again.

use std::collections::BTreeMap;
use std::fmt;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use foxglove::messages::SceneUpdate;
use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{
    ChannelBuilder, Context, Encode, FoxgloveError, PartialMetadata, RawChannel, WebSocketServer,
    WebSocketServerHandle,
};
use prost::Message;
use tokio::runtime::Runtime;

use super::messages::DESCRIPTORS;
use super::topics::{Schema, Topic, TraceSink};

/// Messages that wait for a slow viewer; beyond them it misses the oldest.
const BACKLOG: usize = 256;

/// Viewers at an address.
pub struct LiveScenes {
    context: Arc<Context>,
    handle: WebSocketServerHandle,
    channels: BTreeMap<String, Arc<RawChannel>>,
    subscriptions: Arc<Subscriptions>,
    buffer: Vec<u8>,
    /// Runs the connections; dropped last.
    _runtime: Runtime,
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

/// Notes that a viewer subscribed.
#[derive(Default)]
struct Subscriptions(AtomicBool);

impl ServerListener for Subscriptions {
    fn on_subscribe(&self, _client: Client, _channel: ChannelView) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl LiveScenes {
    /// Listens at a TCP address; `name` is shown to viewers.
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
        let server = WebSocketServer::new()
            .name(name)
            .bind(address.ip().to_string(), address.port())
            .context(&context)
            .message_backlog_size(BACKLOG)
            .listener(Arc::<Subscriptions>::clone(&subscriptions))
            .tokio_runtime(runtime.handle());
        let handle = runtime
            .block_on(server.start())
            .map_err(|cause| LiveError::Listen { address, cause })?;
        Ok(Self {
            context,
            handle,
            channels: BTreeMap::new(),
            subscriptions,
            buffer: Vec::new(),
            _runtime: runtime,
        })
    }

    /// The port that it listens at.
    #[must_use]
    pub fn port(&self) -> u16 {
        self.handle.port()
    }

    /// True if a viewer subscribed since the last call: it has no drawing yet.
    pub fn has_new_viewer(&mut self) -> bool {
        self.subscriptions.0.swap(false, Ordering::Relaxed)
    }

    /// Withdraws all topics whose names begin so.
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
        let schema = match topic.schema {
            Schema::Scene => SceneUpdate::get_schema(),
            Schema::Own(name) | Schema::Wire(name) => {
                Some(foxglove::Schema::new(name, "protobuf", DESCRIPTORS))
            }
        };
        let channel = ChannelBuilder::new(&topic.name)
            .context(&self.context)
            .message_encoding("protobuf")
            .schema(schema)
            .build_raw()?;
        self.channels
            .insert(topic.name.clone(), Arc::clone(&channel));
        Ok(channel)
    }
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
        if !channel.has_sinks() {
            return Ok(());
        }
        self.buffer.clear();
        message
            .encode(&mut self.buffer)
            .expect("a vector grows as needed");
        channel.log_with_meta(&self.buffer, PartialMetadata::with_log_time(at_ns));
        Ok(())
    }
}
