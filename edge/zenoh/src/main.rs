//! `rhumb-edge-zenoh`: edges whose packets come over zenoh's routers.
//!
//! A hub is a member of the scenes' server for each stream, and publishes their packets; edges subscribe. Data of single members
//! pass between edge and hub over connections, as between any edge and its owner. Steps nothing, keeps nothing.
//!
//! A packet is a put on the key of its stream; routers read nothing else. Nothing is resent: for a lost packet a member's edge
//! asks over its own connection. Invariant: the bytes arrive as they were published. The settings of sessions are those for
//! state that is superseded and not resent; each constant says how it differs from zenoh's default, and why.
#![forbid(unsafe_code)]

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::mpsc;

use clap::{Args, Parser, Subcommand};
use rhumb_server::{
    Deliver, EdgeArguments, FanOut, FanOutSide, SharedPacket, SharedStream, run_shared_edge,
};
use zenoh::bytes::ZBytes;
use zenoh::key_expr::OwnedKeyExpr;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::qos::{CongestionControl, Priority};
use zenoh::{Config, Session, Wait};

/// Edges of Rhumb whose packets come over zenoh's routers.
#[derive(Debug, Parser)]
#[command(name = "rhumb-edge-zenoh", version, about)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Forwards packets, as zenohd does, with the settings that edges have.
    Router(RouterArguments),
    /// Publishes the streams that edges need; its members are edges alone.
    Hub(SharedArguments),
    /// Serves members; its owner is a hub.
    Edge(SharedArguments),
}

/// A router and its neighbours.
#[derive(Debug, Args)]
struct RouterArguments {
    /// Endpoint to listen on, as udp/192.0.2.1:7447, tcp/… or tls/…; may be repeated.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    listen: Vec<String>,
    /// Endpoint of another router; may be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    #[command(flatten)]
    certificates: LinkCertificates,
}

/// An edge and its routers.
#[derive(Debug, Args)]
struct SharedArguments {
    #[command(flatten)]
    edge: EdgeArguments,
    /// Endpoint of a router, as udp/192.0.2.1:7447, tcp/… or tls/…; may be repeated: the first that answers is taken.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    router: Vec<String>,
    #[command(flatten)]
    certificates: LinkCertificates,
    /// Name of the world: the same for a hub and its edges, another for each hub of these routers.
    #[arg(long, value_name = "NAME", default_value = "world")]
    world: String,
}

fn main() -> ExitCode {
    let done = match Arguments::parse().task {
        Task::Router(arguments) => run_router(&arguments),
        Task::Hub(arguments) => run_edge(&arguments, FanOutSide::Publishes),
        Task::Edge(arguments) => run_edge(&arguments, FanOutSide::Follows),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(cause) => {
            // If standard error is closed, no other place is left to report to.
            let _ = writeln!(io::stderr(), "error: {cause}");
            ExitCode::FAILURE
        }
    }
}

fn run_router(arguments: &RouterArguments) -> Result<(), Box<dyn Error>> {
    let endpoints = (&*arguments.listen, &*arguments.connect);
    let config = config(SessionKind::Router, endpoints, &arguments.certificates).map_err(plain)?;
    let session = zenoh::open(config).wait().map_err(plain)?;
    writeln!(io::stdout(), "forwarding at {}", arguments.listen.join(" "))?;
    let (stop, stopped) = mpsc::channel();
    ctrlc::set_handler(move || {
        // A second signal finds no receiver.
        let _ = stop.send(());
    })?;
    stopped.recv()?;
    session.close().wait().map_err(plain)
}

fn run_edge(arguments: &SharedArguments, side: FanOutSide) -> Result<(), Box<dyn Error>> {
    let endpoints = (&[][..], &*arguments.router);
    let config = config(SessionKind::Client, endpoints, &arguments.certificates).map_err(plain)?;
    run_shared_edge(&arguments.edge, side, |deliver| {
        let opened = ZenohFanOut::open(config, &arguments.world, deliver).map_err(plain)?;
        Ok(Box::new(opened))
    })
}

/// The error of another library as one of this program.
fn plain(cause: Box<dyn Error + Send + Sync>) -> Box<dyn Error> {
    cause
}

/// Publishers that are kept open. Streams that have ended leave theirs behind; beyond this number all are made anew.
const PUBLISHERS_MAX: usize = 1_024;

/// Longest packet that is taken, bytes; a stream's largest has 1,150 and its head. No hub publishes a longer one.
const PACKET_BYTES_MAX: usize = 1_500;

/// A session whose keys begin with the name of a world.
struct ZenohFanOut {
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
    fn open(
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

/// Silence of a neighbour after which a link is given up, milliseconds. By default 10 s: that long a frozen router would hold up all
/// behind it.
const LEASE_MS: u32 = 600;
/// Time to open a link, milliseconds; 10 s by default. A frozen router is still the first of a list.
const OPEN_MS: u32 = 600;
/// Sessions of a router; 1,000 by default.
const SESSIONS_MAX: u32 = 16_384;

/// Longest message that a session puts together, bytes; 1 GiB by default. A packet of a stream is a small part of it.
const MESSAGE_BYTES_MAX: u32 = 65_536;

/// The use of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SessionKind {
    /// It forwards.
    Router,
    /// It publishes or subscribes, by the first router of its list that answers.
    Client,
}

/// Certificates of links over TLS. Each end shows its own, and connects to none that shows none: who could publish could move bodies.
#[derive(Args, Clone, Debug)]
struct LinkCertificates {
    /// PEM file with the own certificate for tls endpoints.
    #[arg(long, value_name = "FILE", requires_all = ["link_key", "link_roots"])]
    link_cert: Option<PathBuf>,
    /// PEM file with its private key.
    #[arg(long, value_name = "FILE", requires = "link_cert")]
    link_key: Option<PathBuf>,
    /// PEM file with the roots that sign the certificates of the other ends.
    #[arg(long, value_name = "FILE", requires = "link_cert")]
    link_roots: Option<PathBuf>,
}

impl LinkCertificates {
    /// Settings and their files.
    fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        [
            ("listen_certificate", &self.link_cert),
            ("connect_certificate", &self.link_cert),
            ("listen_private_key", &self.link_key),
            ("connect_private_key", &self.link_key),
            ("root_ca_certificate", &self.link_roots),
        ]
        .into_iter()
        .filter_map(|(name, file)| Some((name, file.as_deref()?)))
    }
}

/// The configuration of a session.
///
/// # Errors
///
/// An endpoint is none, or one of TLS has no certificates.
fn config(
    kind: SessionKind,
    (listen, connect): (&[String], &[String]),
    certificates: &LinkCertificates,
) -> Result<Config, Box<dyn Error + Send + Sync>> {
    let is_tls = |endpoint: &&String| endpoint.starts_with("tls/");
    if let Some(endpoint) = listen.iter().chain(connect).find(is_tls)
        && certificates.link_cert.is_none()
    {
        return Err(format!("{endpoint}: give --link-cert, --link-key and --link-roots").into());
    }
    let mut config = Config::default();
    let mode = match kind {
        SessionKind::Router => "router",
        SessionKind::Client => "client",
    };
    let text = |value: &str| format!("{value:?}");
    let list = |values: &[String]| format!("{values:?}");
    let settings = [
        ("mode", text(mode)),
        ("listen/endpoints", list(listen)),
        ("connect/endpoints", list(connect)),
        // No session is found by multicast, and none that was not named is connected.
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/link/tx/lease", LEASE_MS.to_string()),
        ("transport/unicast/open_timeout", OPEN_MS.to_string()),
        ("transport/unicast/accept_timeout", OPEN_MS.to_string()),
        ("transport/unicast/max_sessions", SESSIONS_MAX.to_string()),
        (
            "transport/link/rx/max_message_size",
            MESSAGE_BYTES_MAX.to_string(),
        ),
    ];
    for (name, value) in settings {
        config.insert_json5(name, &value)?;
    }
    let file = |path: &Path| text(&path.display().to_string());
    for (name, path) in certificates.files() {
        config.insert_json5(&format!("transport/link/tls/{name}"), &file(path))?;
    }
    config.insert_json5("transport/link/tls/enable_mtls", "true")?;
    Ok(config)
}
