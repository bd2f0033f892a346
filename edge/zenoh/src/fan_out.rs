//! Carries the packets of streams by zenoh's routers.
//!
//! A packet is a put on the key of its stream; routers read nothing else. Keeps nothing, resends nothing: what is lost a member's
//! edge asks for over its own connection. Invariant: the bytes arrive as they were published.

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;

use rhumb_server::{Deliver, FanOut, SharedPacket, SharedStream};
use zenoh::bytes::ZBytes;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Config, Session, Wait};

/// Publishers that are kept open. Streams that have ended leave theirs behind; beyond this number all are made anew.
const PUBLISHERS_MAX: usize = 1_024;

/// Longest packet that is taken, bytes; a stream's largest has 1,150 and its head. What is longer no hub has published.
const PACKET_BYTES_MAX: usize = 1_500;

/// A session whose keys begin with the name of a world.
pub(crate) struct ZenohFanOut {
    session: Session,
    world: String,
    publishers: BTreeMap<SharedStream, Publisher<'static>>,
    subscribers: BTreeMap<SharedStream, Subscriber<()>>,
    deliver: Deliver,
}

impl ZenohFanOut {
    /// Connects to the first router that answers.
    ///
    /// # Errors
    ///
    /// None answers, or the name of the world is no part of a key.
    pub(crate) fn open(
        config: Config,
        world: &str,
        deliver: Deliver,
    ) -> Result<Self, Box<dyn Error + Send + Sync>> {
        OwnedKeyExpr::new(world)?;
        Ok(Self {
            session: zenoh::open(config).wait()?,
            world: world.to_owned(),
            publishers: BTreeMap::new(),
            subscribers: BTreeMap::new(),
            deliver,
        })
    }

    /// The key of a stream. A scene's name may have characters that a key may not.
    fn key(&self, stream: &SharedStream) -> String {
        let scene: String = (stream.scene.as_str().bytes())
            .map(|byte| format!("{byte:02x}"))
            .collect();
        format!("rhumb/{}/{scene}/{}", self.world, stream.stream.0)
    }

    fn publisher(&mut self, stream: &SharedStream) -> zenoh::Result<&Publisher<'static>> {
        if self.publishers.len() >= PUBLISHERS_MAX {
            self.publishers.clear();
        }
        if !self.publishers.contains_key(stream) {
            // Express would give each packet a batch of its own, of which two wait at most: the end of a tick would be lost.
            let declared = self.session.declare_publisher(self.key(stream));
            let declared = declared.congestion_control(CongestionControl::Drop);
            let declared = declared.priority(Priority::RealTime).express(false);
            self.publishers.insert(stream.clone(), declared.wait()?);
        }
        Ok(&self.publishers[stream])
    }

    fn subscriber(&self, stream: &SharedStream) -> zenoh::Result<Subscriber<()>> {
        let (of, deliver) = (stream.clone(), self.deliver.clone());
        let declared = self.session.declare_subscriber(self.key(stream));
        let declared = declared.callback(move |sample| {
            if sample.payload().len() > PACKET_BYTES_MAX {
                return;
            }
            let bytes = sample.payload().to_bytes().into_owned();
            let (of, bytes) = (of.clone(), bytes.into());
            deliver.packet(SharedPacket { of, bytes });
        });
        declared.wait()
    }
}

impl FanOut for ZenohFanOut {
    fn publish(&mut self, packet: SharedPacket) {
        let put = self.publisher(&packet.of);
        let put = put.and_then(|publisher| publisher.put(ZBytes::from(packet.bytes)).wait());
        if let Err(cause) = put {
            tracing::warn!(%cause, "a packet was not published");
        }
    }

    fn follow(&mut self, streams: &BTreeSet<SharedStream>) {
        self.subscribers
            .retain(|stream, _| streams.contains(stream));
        for stream in streams {
            if !self.subscribers.contains_key(stream) {
                match self.subscriber(stream) {
                    Ok(subscriber) => drop(self.subscribers.insert(stream.clone(), subscriber)),
                    Err(cause) => tracing::error!(%cause, "a stream cannot be followed"),
                }
            }
        }
    }
}
