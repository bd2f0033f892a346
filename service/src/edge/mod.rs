//! `rhumb-server edge`: serves members of scenes that another server steps.
//!
//! Opens the server of its members, and drives the edge until it is stopped. Steps nothing, and keeps nothing on disk.

mod driver;
mod fan_out;

use std::error::Error;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use clap::Args;
use rhumb_edge::{Edge, EdgeSettings};
use rhumb_protocol::Span;
use rhumb_protocol::message::{Role, Token};
use rhumb_scene::{Heartbeat, Limits, Permit, ServerLoad};
use rhumb_transport::{
    Clock, Fingerprint, IdleLimit, Origins, PageOrigin, QuicServer, ServerOptions, Stop, Trust,
    WebOptions,
};
use tracing::level_filters::LevelFilter;

use self::driver::{EdgeDriver, OwnerServer};
use self::fan_out::Sharing;
pub use self::fan_out::{Deliver, FanOut, FanOutSide};
use crate::access;
use crate::http::{self, TcpService};
use crate::log;
use crate::metrics::Metrics;
use crate::serve::{Identity, RunError, bind_metrics, seconds_since_1970};
use crate::signals;
use crate::start::{kind_of, write_lines};

/// The owner of the scenes, and the members of the edge.
#[derive(Debug, Args)]
pub struct EdgeArguments {
    /// The server of the scenes.
    #[arg(long, value_name = "HOST:PORT")]
    owner: String,
    /// Fingerprint of the owner's certificate, as the owner prints it.
    #[arg(
        long,
        value_name = "HEX",
        conflicts_with = "roots",
        required_unless_present = "roots"
    )]
    fingerprint: Option<Fingerprint>,
    /// PEM file with roots that sign the owner's certificate, in place of its fingerprint.
    #[arg(long, value_name = "FILE")]
    roots: Option<PathBuf>,
    /// File with the token that the edge shows for itself, where the owner asks for tokens; an observer's suffices.
    #[arg(long, value_name = "FILE")]
    token: Option<PathBuf>,
    /// UDP address for members; port 0 picks a free one.
    #[arg(long, default_value = "127.0.0.1:4434")]
    listen: SocketAddr,
    /// PEM file with the certificate chain; without it a development certificate is made at start.
    #[arg(long, requires = "key")]
    cert: Option<PathBuf>,
    /// PEM file with the certificate's private key.
    #[arg(long, requires = "cert")]
    key: Option<PathBuf>,
    /// Every member is an observer without a token, and is served by the edge alone.
    #[arg(long)]
    observers: bool,
    /// Lets members without a token come from other machines too: those of an owner without tokens, and those of --observers
    /// and --metrics.
    #[arg(long)]
    open_to_network: bool,
    /// Origin of a web page that may connect, as https://host:port, or * for all; may be repeated. Pages of this machine
    /// may always.
    #[arg(long, value_name = "ORIGIN", conflicts_with = "no_web")]
    web_origin: Vec<PageOrigin>,
    /// Serves no browsers.
    #[arg(long)]
    no_web: bool,
    /// TCP address for metrics (/metrics) and health (/health).
    #[arg(long, value_name = "ADDRESS")]
    metrics: Option<SocketAddr>,
    /// Log level: off, error, warn, info, debug or trace.
    #[arg(long, default_value = "info")]
    log: LevelFilter,
}

impl EdgeArguments {
    fn owner(&self) -> Result<OwnerServer, Box<dyn Error>> {
        let trust = match (self.fingerprint, &self.roots) {
            (Some(fingerprint), _) => Trust::Fingerprint(fingerprint),
            (None, Some(roots)) => Trust::Roots(roots.clone()),
            (None, None) => return Err("give --fingerprint or --roots of the owner".into()),
        };
        let address = self.owner.clone();
        Ok(OwnerServer { address, trust })
    }

    fn token(&self) -> Result<Option<Token>, Box<dyn Error>> {
        let Some(path) = &self.token else {
            return Ok(None);
        };
        let failed = |cause: &dyn Error| format!("{}: {cause}", path.display());
        let text = std::fs::read_to_string(path).map_err(|cause| failed(&cause))?;
        let token = text.trim().parse::<Token>();
        Ok(Some(token.map_err(|cause| failed(&cause))?))
    }

    fn identity(&self) -> Identity {
        match (self.cert.clone(), self.key.clone()) {
            (Some(certificate), Some(key)) => Identity::Files { certificate, key },
            _ => Identity::Development,
        }
    }

    /// Refuses what would let other machines in without a token, unless the operator says so.
    fn check_open(&self) -> Result<(), RunError> {
        let listeners = [
            ("--observers", Some(self.listen).filter(|_| self.observers)),
            ("--metrics", self.metrics),
        ];
        let open = listeners.into_iter().find_map(|(flag, address)| {
            let address = address.filter(|address| !address.ip().is_loopback())?;
            Some(RunError::OpenToNetwork { address, flag })
        });
        match open {
            Some(refusal) if !self.open_to_network => Err(refusal),
            _ => Ok(()),
        }
    }

    fn settings(&self) -> Result<EdgeSettings, Box<dyn Error>> {
        let role = match self.observers {
            true => Role::Observer,
            false => Role::Owner,
        };
        Ok(EdgeSettings {
            limits: Limits::default(),
            token: self.token()?,
            permit: Arc::new(Permit {
                role,
                ..Permit::OPEN
            }),
            asks_tokens: !self.open_to_network && !self.listen.ip().is_loopback(),
            token_life: |token| {
                let seconds = access::stated_seconds_left(token, seconds_since_1970())?;
                Some(Span::from_millis(seconds.saturating_mul(1_000)))
            },
        })
    }
}

/// Runs an edge until SIGINT or SIGTERM.
pub(crate) fn run(arguments: &EdgeArguments) -> Result<(), Box<dyn Error>> {
    run_with(arguments, |_| Ok(()))
}

/// Runs an edge at one end of a fan-out, until SIGINT or SIGTERM. `open` makes the fan-out, which delivers packets by its
/// argument.
///
/// # Errors
///
/// The reason why an edge cannot start, and the error of `open`.
pub fn run_shared_edge(
    arguments: &EdgeArguments,
    side: FanOutSide,
    open: impl FnOnce(Deliver) -> Result<Box<dyn FanOut>, Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    run_with(arguments, |driver| {
        let deliver = driver.deliver();
        let fan_out = open(deliver.clone())?;
        driver.share(Sharing::new(side, fan_out, deliver));
        Ok(())
    })
}

fn run_with(
    arguments: &EdgeArguments,
    prepare: impl FnOnce(&mut EdgeDriver) -> Result<(), Box<dyn Error>>,
) -> Result<(), Box<dyn Error>> {
    let (owner, settings) = (arguments.owner()?, arguments.settings()?);
    arguments.check_open()?;
    owner.resolve()?;
    let _last_lines = log::start(arguments.log, settings.limits.log_lines_per_second);
    let identity = arguments.identity();
    let web = (!arguments.no_web).then(|| WebOptions {
        origins: arguments.web_origin.iter().cloned().collect::<Origins>(),
        certificate: identity.web(),
    });
    let transport = QuicServer::bind(ServerOptions {
        listen: arguments.listen,
        certificate: identity.certificate()?,
        web,
        idle_limit: IdleLimit::Usual,
    })
    .map_err(RunError::Bind)?;
    let (metrics, clock) = (Metrics::default(), Clock::start());
    let heartbeat = Heartbeat::new(move || clock.now());
    metrics.set_dispatcher(heartbeat.clone(), ServerLoad::default(), &settings.limits);
    let answering = answer_metrics(arguments.metrics, metrics.clone())?;
    let (edge, waker) = (Edge::new(settings), transport.waker());
    let mut driver = EdgeDriver::new(edge, owner.clone(), waker, (metrics, heartbeat));
    prepare(&mut driver)?;
    announce(&transport, &identity, (&owner, answering.as_ref()));
    let stop = Stop::new();
    let running = signals::obey(&stop, None);
    let served = transport.run(&mut driver, &stop);
    drop(driver);
    running.store(false, Ordering::Relaxed);
    let statistics = served.map_err(RunError::Serve)?;
    tracing::info!(connections = statistics.opened, "stopped");
    Ok(())
}

fn answer_metrics(
    address: Option<SocketAddr>,
    metrics: Metrics,
) -> Result<Option<(SocketAddr, TcpService)>, RunError> {
    let Some(address) = address else {
        return Ok(None);
    };
    let (listener, local) = bind_metrics(address)?;
    let named = !local.ip().is_loopback();
    let answer = Arc::new(move |request: &_| metrics.answer(request, named));
    let started = http::start(listener, "rhumb-server-metrics", answer);
    Ok(Some((local, started.map_err(RunError::Thread)?)))
}

/// Prints the address and the fingerprint to pin, as a server does.
fn announce(
    transport: &QuicServer,
    identity: &Identity,
    (owner, answering): (&OwnerServer, Option<&(SocketAddr, TcpService)>),
) {
    let metrics = answering.map(|(at, _)| format!("metrics at http://{at}/metrics\n"));
    let hashes = transport.certificate_hashes().current();
    let hash = |hash: &Fingerprint| format!("certificate hash for browsers {hash}\n");
    let hashes: String = hashes.iter().map(hash).collect();
    write_lines(&format!(
        "rhumb-server {} edge of {}\nlistening on {}\ncertificate {}\nfingerprint {}\n{}{hashes}",
        env!("CARGO_PKG_VERSION"),
        owner.address,
        transport.local_addr(),
        kind_of(identity),
        transport.fingerprint(),
        metrics.unwrap_or_default(),
    ));
}
