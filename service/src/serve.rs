//! Runs a server behind real sockets until a stop is requested.
//!
//! The function of the `rhumb-server` binary, callable by programs that embed it. With it: reasons for which a server
//! does not start, or stops by itself.

use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::Receiver;
use std::time::SystemTime;
use std::{fmt, io};

#[cfg(feature = "app")]
use rhumb_app::{AppBindError, AppListen, AppListener, AppOptions, Gateway};
#[cfg(feature = "app")]
use rhumb_client::{LocalPeers, LocalServer};
use rhumb_protocol::{Endpoint, Instant};
use rhumb_scene::engine::{EngineKind, Engines, StepThreadsError};
use rhumb_scene::{Limits, SceneSettings};
#[cfg(unix)]
use rhumb_transport::UnixServer;
use rhumb_transport::{
    BindError, Certificate, CertificateError, CertificateHashes, Clock, Fingerprint, IdleLimit,
    Origins, QuicServer, ServeError, ServerOptions, ServerStatistics, Stop, WebIdentity,
    WebOptions,
};

#[cfg(feature = "view")]
use crate::access::KeyError;
use crate::access::{Authenticator, TokenKeys};
use crate::agones::{Agones, ReportedServer, Sidecar};
use crate::directory::{Endpoints, FenceClock, Keeper, LeaseSeconds, ServerPlace};
use crate::dispatcher::{Checkpoints, Dispatcher, DispatcherSettings, ProcessOptions, Question};
use crate::durable::{DataDir, DataError};
use crate::flight::{FlightRecorders, FlightWriter};
use crate::http::{self, TcpService};
use crate::metrics::Metrics;
#[cfg(feature = "record")]
use crate::recording::{Recorder, RecordingLimits, SceneTaps};
#[cfg(feature = "view")]
use crate::view::{PageListener, ViewError, ViewScene};

/// The server's certificate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Identity {
    /// A certificate made at start; clients pin its fingerprint.
    Development,
    /// The same, kept in PEM files of a data directory.
    DevelopmentFiles {
        /// The certificate.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
    },
    /// A certificate chain and its key, as PEM files.
    Files {
        /// The chain, the server's own first.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
    },
}

impl Identity {
    /// Makes or reads the certificate.
    pub(crate) fn certificate(&self) -> Result<Certificate, RunError> {
        match self {
            Self::Development => Certificate::development(["localhost"]),
            Self::Files { certificate, key } | Self::DevelopmentFiles { certificate, key } => {
                Certificate::from_pem_files(certificate, key)
            }
        }
        .map_err(RunError::Certificate)
    }

    /// The certificate for browsers, which accept one for development only if it is short-lived.
    pub(crate) fn web(&self) -> WebIdentity {
        let names = || vec!["localhost".to_owned()];
        match self {
            Self::Files { .. } => WebIdentity::Own,
            Self::Development => WebIdentity::Pinned(names()),
            Self::DevelopmentFiles { certificate, .. } => {
                let folder = certificate.parent().unwrap_or(Path::new(""));
                WebIdentity::Kept(names(), folder.to_owned())
            }
        }
    }
}

/// The clients that a server admits.
#[derive(Clone, Debug)]
pub enum Access {
    /// Clients with a token of one of these keys; each may do what its token says.
    Tokens(TokenKeys),
    /// All clients of this machine, which may do everything: for development.
    OpenOnLoopback,
    /// All clients that reach the server, which may do everything.
    OpenToNetwork,
}

/// A server that listens, but does not run yet.
pub struct Server {
    transport: QuicServer,
    access: Access,
    /// Settings of its scenes.
    pub scenes: SceneSettings,
    engine: EngineKind,
    /// `Some` if scenes run in worker processes.
    processes: Option<ProcessOptions>,
    metrics: Option<TcpListener>,
    #[cfg(unix)]
    socket: Option<UnixServer>,
    data: Option<DataDir>,
    /// The directory that says which scenes are this server's, the address that others tell its clients, and the time of its
    /// lease.
    directory: Option<(Endpoints, ServerPlace, LeaseSeconds)>,
    agones: Option<Sidecar>,
    flight: Option<PathBuf>,
    checkpoints: (Checkpoints, Receiver<Question>),
    #[cfg(feature = "record")]
    record: Option<PathBuf>,
    #[cfg(feature = "foxglove")]
    foxglove: Option<crate::recording::BoundViewers>,
    /// The page, and the provided scenes that it names.
    #[cfg(feature = "view")]
    view: Option<(PageListener, Vec<ViewScene>)>,
    /// Serves APP clients.
    #[cfg(feature = "app")]
    app: Option<(AppListener, LocalPeers)>,
}

impl Server {
    /// Listens, for pages of this machine too. Clients that connect wait until [`Self::run`].
    ///
    /// # Errors
    ///
    /// As [`Self::bind_with_origins`].
    pub fn bind(listen: SocketAddr, identity: &Identity, access: Access) -> Result<Self, RunError> {
        Self::bind_with_origins(listen, identity, access, Some(Origins::loopback()))
    }

    /// Listens. Clients that connect wait until [`Self::run`].
    ///
    /// `origins`: the web pages that may connect, by WebTransport on the same address; `None`: no browser.
    ///
    /// # Errors
    ///
    /// [`RunError`] for a certificate or an address that cannot be used, and for an open server at an address that
    /// other machines reach.
    pub fn bind_with_origins(
        listen: SocketAddr,
        identity: &Identity,
        access: Access,
        origins: Option<Origins>,
    ) -> Result<Self, RunError> {
        Self::bind_among(listen, identity, access, (origins, IdleLimit::Usual))
    }

    /// The same with the silence after which clients consider the server lost.
    pub(crate) fn bind_among(
        listen: SocketAddr,
        identity: &Identity,
        access: Access,
        (origins, idle_limit): (Option<Origins>, IdleLimit),
    ) -> Result<Self, RunError> {
        if matches!(access, Access::OpenOnLoopback) && !listen.ip().is_loopback() {
            return Err(RunError::OpenToNetwork {
                address: listen,
                flag: "--listen",
            });
        }
        let certificate = identity.certificate()?;
        let web = origins.map(|origins| WebOptions {
            origins,
            certificate: identity.web(),
        });
        let options = ServerOptions {
            listen,
            certificate,
            web,
            idle_limit,
        };
        let transport = QuicServer::bind(options).map_err(RunError::Bind)?;
        let clock = Clock::start();
        Ok(Self {
            checkpoints: Checkpoints::new(transport.waker()),
            transport,
            access,
            scenes: SceneSettings {
                limits: Limits::default(),
                ..SceneSettings::new(move || clock.now())
            },
            engine: EngineKind::default(),
            processes: None,
            metrics: None,
            #[cfg(unix)]
            socket: None,
            data: None,
            directory: None,
            agones: None,
            flight: None,
            #[cfg(feature = "record")]
            record: None,
            #[cfg(feature = "foxglove")]
            foxglove: None,
            #[cfg(feature = "view")]
            view: None,
            #[cfg(feature = "app")]
            app: None,
        })
    }

    /// The address that it listens at.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.transport.local_addr()
    }

    /// The fingerprint for clients to pin.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        self.transport.fingerprint()
    }

    /// The hashes of the certificates that browsers are shown, for pages to pin; they change every six days.
    #[must_use]
    pub fn certificate_hashes(&self) -> CertificateHashes {
        self.transport.certificate_hashes()
    }

    /// Listens for APP clients too, and returns the address. Each of them is a client of this server, with a thread of
    /// its own.
    ///
    /// # Errors
    ///
    /// [`AppBindError`] for an address that cannot be used.
    #[cfg(feature = "app")]
    pub fn listen_app(
        &mut self,
        listen: AppListen,
        options: AppOptions,
    ) -> Result<SocketAddr, AppBindError> {
        let waker = self.transport.waker();
        let (server, peers) = LocalServer::beside(move || waker.wake());
        let gateway = Gateway::new(options, move || Ok(server.connect()));
        let listener = AppListener::open(listen, gateway)?;
        let address = listener.address();
        self.app = Some((listener, peers));
        Ok(address)
    }

    /// Serves a page in which scenes are seen, at a TCP address, which is returned. The page observes every scene; where
    /// no tokens are asked for, it may command them too. `scenes`: provided scenes that the page offers before they begin.
    ///
    /// # Errors
    ///
    /// [`RunError::View`] for an address that cannot be used, and if this build has no page.
    #[cfg(feature = "view")]
    pub fn show_page(
        &mut self,
        address: SocketAddr,
        scenes: Vec<ViewScene>,
    ) -> Result<SocketAddr, RunError> {
        if matches!(self.access, Access::OpenOnLoopback) && !address.ip().is_loopback() {
            return Err(RunError::OpenToNetwork {
                address,
                flag: "--view",
            });
        }
        let page = PageListener::bind(address, self.address()).map_err(RunError::View)?;
        let local = page.address();
        self.view = Some((page, scenes));
        Ok(local)
    }

    /// Runs scenes in processes of this program, which answers to `worker` then.
    pub(crate) fn use_processes(&mut self, options: ProcessOptions) {
        self.processes = Some(options);
    }

    /// Sets the engine of later scenes; with a data directory it must keep images.
    pub fn set_engine(&mut self, engine: EngineKind) {
        self.engine = engine;
        self.scenes.engines = Engines::of(engine);
    }

    /// Answers requests for metrics (`/metrics`, as Prometheus reads them) and for its health (`/health`) at a TCP
    /// address, which is returned. Bind it where only operators reach it.
    ///
    /// # Errors
    ///
    /// [`RunError::Metrics`] for an address that cannot be used.
    pub fn answer_metrics(&mut self, address: SocketAddr) -> Result<SocketAddr, RunError> {
        let (listener, local) = bind_metrics(address)?;
        self.metrics = Some(listener);
        Ok(local)
    }

    /// Serves clients of this machine at a Unix socket too. Only the user who runs the server can connect.
    ///
    /// # Errors
    ///
    /// [`RunError::Socket`] if another server listens there or the folder cannot be written.
    #[cfg(unix)]
    pub fn listen_at(&mut self, path: &Path) -> Result<(), RunError> {
        let bound = UnixServer::bind(path).map_err(|cause| RunError::Socket {
            path: path.to_owned(),
            cause,
        })?;
        self.socket = Some(bound);
        Ok(())
    }

    /// Keeps scenes in a data directory, and restores those that it has.
    pub fn store_in(&mut self, data: DataDir) {
        self.data = Some(data);
    }

    /// Asks a directory which scenes are this server's. `advertise`, `host:port`: where clients of the others find it, if not
    /// at the address that it listens at. The data directory is shared with the other servers.
    pub(crate) fn share_scenes(
        &mut self,
        directory: Endpoints,
        (advertise, lease): (Option<&str>, LeaseSeconds),
    ) {
        let own = self.address().to_string();
        let address = advertise.unwrap_or(&own);
        let place = format!("rhumb://{address}#{}", self.fingerprint());
        self.directory = Some((directory, ServerPlace(place), lease));
    }

    /// Reports to Agones while it runs, if there is a sidecar.
    pub(crate) const fn report_to(&mut self, agones: Option<Sidecar>) {
        self.agones = agones;
    }

    /// Writes the last moments of a scene that faults to a file of this directory, which is made if it is missing.
    pub fn record_flights(&mut self, directory: PathBuf) {
        self.flight = Some(directory);
    }

    /// Records every scene in MCAP files of this directory, which is made if it is missing.
    #[cfg(feature = "record")]
    pub fn record_scenes(&mut self, directory: PathBuf) {
        self.record = Some(directory);
    }

    /// Shows every scene to Foxglove's viewers, over WebSockets at a TCP address, which is returned. It has no tokens:
    /// bind it where only those reach it who may see all scenes. Web pages pass if they are of this machine, of Foxglove,
    /// or among `pages`.
    ///
    /// # Errors
    ///
    /// [`RunError::Foxglove`] for an address that cannot be used.
    #[cfg(feature = "foxglove")]
    pub fn show_in_foxglove(
        &mut self,
        address: SocketAddr,
        pages: Origins,
    ) -> Result<SocketAddr, RunError> {
        let bound = crate::recording::BoundViewers::bind(address, pages);
        let viewers = bound.map_err(RunError::Foxglove)?;
        let local = viewers.address();
        self.foxglove = Some(viewers);
        Ok(local)
    }

    /// Saves and restores its scenes while it runs: for other threads.
    #[must_use]
    pub fn checkpoints(&self) -> Checkpoints {
        self.checkpoints.0.clone()
    }

    /// Serves on the calling thread, and each scene on a thread of its own, until `stop` is requested. Then every
    /// client learns that the server is going away.
    ///
    /// # Errors
    ///
    /// [`RunError::Serve`] if the thread of the sockets fails, [`RunError::Data`] if the data directory does,
    /// [`RunError::EngineWithoutImages`] for a data directory and an engine that cannot store its scenes.
    pub fn run(self, stop: &Stop) -> Result<ServerStatistics, RunError> {
        if self.data.is_some() {
            check_images(self.engine)?;
        }
        #[cfg(any(feature = "view", feature = "record"))]
        let mut server = self;
        #[cfg(not(any(feature = "view", feature = "record")))]
        let server = self;
        let mut settings = DispatcherSettings::of(server.scenes.clone());
        let metrics = settings.recorders.metrics.clone();
        #[cfg(feature = "record")]
        let observers = server.start_observers(&settings.recorders.taps)?;
        #[cfg(feature = "view")]
        let showing = server.start_page(&metrics)?;
        let flight = match server.flight {
            None => None,
            Some(directory) => {
                let (writer, flights) = start_flights(directory, &server.scenes.limits)?;
                settings.recorders.flights = flights;
                Some(writer)
            }
        };
        settings.authenticator = authenticator(server.access);
        settings.engine = server.engine;
        settings.processes = server.processes;
        let directory = server.directory.zip(server.data.clone());
        settings.data = server.data;
        let (waker, of_keeper) = (server.transport.waker(), server.transport.waker());
        let mut dispatcher = Dispatcher::new(settings, move || waker.wake());
        let mut drained = Arc::default();
        if let Some((directory, data)) = directory {
            let keeper = Keeper::start(directory, data, fence_clock(), move || of_keeper.wake());
            let keeper = keeper.map_err(RunError::Thread)?;
            drained = keeper.drained();
            dispatcher.ask_directory(keeper);
        }
        let reported = ReportedServer::new(metrics.clone(), drained);
        let answering = (server.metrics).map(|listener| start_metrics(listener, metrics));
        let answering = answering.transpose().map_err(RunError::Thread)?;
        dispatcher.answer_checkpoints(server.checkpoints.1);
        dispatcher.restore().map_err(RunError::Data)?;
        let reporting = (server.agones).map(|sidecar| Agones::start(sidecar, reported));
        let mut reporting = reporting.transpose().map_err(RunError::Thread)?;
        #[cfg(unix)]
        let listeners = (server.transport, server.socket);
        #[cfg(not(unix))]
        let listeners = server.transport;
        #[cfg(feature = "app")]
        let served = match server.app {
            None => drive(listeners, &mut dispatcher, stop),
            Some((listener, peers)) => {
                let served = drive(listeners, &mut peers.serve(&mut dispatcher), stop);
                drop(listener);
                served
            }
        };
        #[cfg(not(feature = "app"))]
        let served = drive(listeners, &mut dispatcher, stop);
        reporting.iter_mut().for_each(Agones::stop);
        dispatcher.shut_down();
        drop(reporting);
        drop(answering);
        #[cfg(feature = "view")]
        drop(showing);
        drop(flight);
        #[cfg(feature = "record")]
        drop(observers);
        served
    }

    /// Starts the threads that read the states of later scenes.
    #[cfg(feature = "record")]
    fn start_observers(&mut self, taps: &SceneTaps) -> Result<Observers, RunError> {
        let limits = RecordingLimits::of(&self.scenes.limits);
        let recorder = match self.record.take() {
            None => None,
            Some(directory) => {
                let started = Recorder::start(directory.clone(), limits, seconds_since_1970, taps);
                let failed = |cause| RunError::Record { directory, cause };
                Some(started.map_err(failed)?)
            }
        };
        #[cfg(feature = "foxglove")]
        let viewers = match self.foxglove.take() {
            None => None,
            Some(bound) => Some(bound.start(limits, taps).map_err(RunError::Thread)?),
        };
        Ok(Observers {
            _recorder: recorder,
            #[cfg(feature = "foxglove")]
            _viewers: viewers,
        })
    }
}

/// The threads that read the scenes' states; dropping them ends them.
#[cfg(feature = "record")]
struct Observers {
    _recorder: Option<Recorder>,
    #[cfg(feature = "foxglove")]
    _viewers: Option<crate::recording::LiveViewers>,
}

/// Runs an endpoint behind the sockets.
#[cfg(unix)]
fn drive<E: Endpoint>(
    (transport, socket): (QuicServer, Option<UnixServer>),
    endpoint: &mut E,
    stop: &Stop,
) -> Result<ServerStatistics, RunError> {
    let served = match socket {
        None => transport.run(endpoint, stop),
        Some(socket) => {
            let started = socket.serve(endpoint, transport.waker());
            let mut all = started.map_err(RunError::Thread)?;
            transport.run(&mut all, stop)
        }
    };
    served.map_err(RunError::Serve)
}

/// Runs an endpoint behind the socket.
#[cfg(not(unix))]
fn drive<E: Endpoint>(
    transport: QuicServer,
    endpoint: &mut E,
    stop: &Stop,
) -> Result<ServerStatistics, RunError> {
    transport.run(endpoint, stop).map_err(RunError::Serve)
}

/// Listens for requests for metrics at a TCP address, which is returned.
pub(crate) fn bind_metrics(address: SocketAddr) -> Result<(TcpListener, SocketAddr), RunError> {
    let failed = |cause| RunError::Metrics { address, cause };
    let listener = TcpListener::bind(address).map_err(failed)?;
    let local = listener.local_addr().map_err(failed)?;
    Ok((listener, local))
}

/// Begins to answer requests for metrics.
fn start_metrics(listener: TcpListener, metrics: Metrics) -> io::Result<TcpService> {
    let named = !listener.local_addr()?.ip().is_loopback();
    let answer = Arc::new(move |request: &_| metrics.answer(request, named));
    http::start(listener, "rhumb-server-metrics", answer)
}

/// Refuses an engine without images, whose scenes no data directory can keep.
pub(crate) const fn check_images(engine: EngineKind) -> Result<(), RunError> {
    match engine.keeps_images() {
        true => Ok(()),
        false => Err(RunError::EngineWithoutImages(engine)),
    }
}

/// Starts the thread that writes flight recorders.
fn start_flights(
    directory: PathBuf,
    limits: &Limits,
) -> Result<(FlightWriter, FlightRecorders), RunError> {
    let started = FlightWriter::start(directory.clone(), limits, seconds_since_1970);
    started.map_err(|cause| RunError::Flight { directory, cause })
}

#[cfg(feature = "view")]
impl Server {
    /// Begins to answer the page's requests, if there is a page.
    fn start_page(&mut self, metrics: &Metrics) -> Result<Option<TcpService>, RunError> {
        let Some((mut page, scenes)) = self.view.take() else {
            return Ok(None);
        };
        if self.directory.is_some() {
            page.share_scenes();
        }
        let issuer = match &mut self.access {
            Access::Tokens(keys) => Some(keys.issuer().map_err(RunError::ViewToken)?),
            Access::OpenOnLoopback | Access::OpenToNetwork => None,
        };
        let hashes = self.certificate_hashes();
        let texts = move || hashes.current().iter().map(ToString::to_string).collect();
        let hashes = Box::new(texts);
        let started = page.start(
            hashes,
            (scenes, metrics.clone()),
            issuer,
            seconds_since_1970,
        );
        started.map(Some).map_err(RunError::Thread)
    }
}

/// A clock that counts while the machine sleeps: leases end meanwhile.
#[cfg(target_os = "linux")]
fn fence_clock() -> FenceClock {
    use rustix::time::{ClockId, clock_gettime};
    Arc::new(|| {
        let now = clock_gettime(ClockId::Boottime);
        let whole = u64::try_from(now.tv_sec).unwrap_or(0) * 1_000_000_000;
        Instant::from_nanos(whole + u64::try_from(now.tv_nsec).unwrap_or(0))
    })
}

/// The monotonic clock: this system's counts while the machine sleeps, or such machines are not put to sleep.
#[cfg(not(target_os = "linux"))]
fn fence_clock() -> FenceClock {
    let clock = Clock::start();
    Arc::new(move || clock.now())
}

fn authenticator(access: Access) -> Authenticator {
    match access {
        Access::OpenOnLoopback | Access::OpenToNetwork => Authenticator::Open,
        Access::Tokens(keys) => Authenticator::Tokens {
            keys,
            clock: Arc::new(seconds_since_1970),
        },
    }
}

/// The system's time. A clock before 1970 counts as 1970: no token is valid then.
pub(crate) fn seconds_since_1970() -> i64 {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    now.map_or(0, |since| {
        i64::try_from(since.as_secs()).unwrap_or(i64::MAX)
    })
}

/// The cores that the calling thread may run on, lowest first; empty where the system does not report them.
#[cfg(target_os = "linux")]
#[must_use]
pub fn usable_cores() -> Vec<usize> {
    use rustix::thread::{CpuSet, sched_getaffinity};
    let set = sched_getaffinity(None).unwrap_or_default();
    (0..CpuSet::MAX_CPU)
        .filter(|core| set.is_set(*core))
        .collect()
}

/// The cores that the calling thread may run on, lowest first; empty where the system does not report them.
#[cfg(not(target_os = "linux"))]
#[must_use]
pub fn usable_cores() -> Vec<usize> {
    Vec::new()
}

/// Binds the calling thread, and the threads it starts from now on, to some cores.
///
/// # Errors
///
/// [`RunError::Cores`] when the system refuses or has none of them.
#[cfg(target_os = "linux")]
pub fn run_on_cores(cores: &[usize]) -> Result<(), RunError> {
    use rustix::thread::{CpuSet, sched_setaffinity};
    let failed = |cause| RunError::Cores {
        cores: cores.to_vec(),
        cause,
    };
    if cores.iter().any(|core| *core >= CpuSet::MAX_CPU) {
        return Err(failed(io::ErrorKind::InvalidInput.into()));
    }
    let mut set = CpuSet::new();
    for core in cores {
        set.set(*core);
    }
    sched_setaffinity(None, &set).map_err(|errno| failed(errno.into()))
}

/// Binds the calling thread, and the threads it starts from now on, to some cores.
///
/// # Errors
///
/// Always: this system has no such call.
#[cfg(not(target_os = "linux"))]
pub fn run_on_cores(cores: &[usize]) -> Result<(), RunError> {
    Err(RunError::Cores {
        cores: cores.to_vec(),
        cause: io::ErrorKind::Unsupported.into(),
    })
}

/// Reason why a server did not start, or stopped by itself.
#[derive(Debug)]
pub enum RunError {
    /// The certificate cannot be used.
    Certificate(CertificateError),
    /// Listening at the address failed.
    Bind(BindError),
    /// Listening for requests of metrics failed.
    Metrics {
        /// The TCP address.
        address: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The Unix socket cannot be used.
    Socket {
        /// Its path.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The page cannot be served.
    #[cfg(feature = "view")]
    View(ViewError),
    /// The system or a key refuses the page's tokens.
    #[cfg(feature = "view")]
    ViewToken(KeyError),
    /// The directory for flight recorders cannot be used.
    Flight {
        /// The directory.
        directory: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// The directory for recordings cannot be used.
    #[cfg(feature = "record")]
    Record {
        /// The directory.
        directory: PathBuf,
        /// The system's error.
        cause: io::Error,
    },
    /// Foxglove's viewers cannot be served.
    #[cfg(feature = "foxglove")]
    Foxglove(crate::recording::ViewersError),
    /// A listener that asks for no token may not be bound where other machines reach it.
    OpenToNetwork {
        /// The address.
        address: SocketAddr,
        /// The flag that asked for the listener.
        flag: &'static str,
    },
    /// Binding the threads to cores failed.
    Cores {
        /// The cores.
        cores: Vec<usize>,
        /// The system's error.
        cause: io::Error,
    },
    /// The requested number of threads is not available.
    StepThreads(StepThreadsError),
    /// A thread cannot start.
    Thread(io::Error),
    /// The data directory cannot be used.
    Data(DataError),
    /// The engine cannot store its scenes in a data directory.
    EngineWithoutImages(EngineKind),
    /// The thread of the sockets failed.
    Serve(ServeError),
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Certificate(cause) => cause.fmt(f),
            Self::Bind(cause) => cause.fmt(f),
            Self::Metrics { address, cause } => {
                write!(
                    f,
                    "cannot answer requests for metrics at {address}: {cause}"
                )
            }
            Self::Socket { path, cause } => {
                write!(f, "cannot listen at the socket {}: {cause}", path.display())
            }
            #[cfg(feature = "view")]
            Self::View(cause) => cause.fmt(f),
            #[cfg(feature = "view")]
            Self::ViewToken(cause) => write!(f, "cannot make tokens for the page: {cause}"),
            Self::Flight { directory, cause } => {
                let directory = directory.display();
                write!(f, "cannot write flight recorders to {directory}: {cause}")
            }
            #[cfg(feature = "record")]
            Self::Record { directory, cause } => {
                write!(f, "cannot record to {}: {cause}", directory.display())
            }
            #[cfg(feature = "foxglove")]
            Self::Foxglove(cause) => cause.fmt(f),
            Self::OpenToNetwork {
                address,
                flag: "--listen",
            } => write!(
                f,
                "a server that needs no token would be open to the network at {address}: \
                 give it --token-key, or --open-to-network if that is meant"
            ),
            Self::OpenToNetwork { address, flag } => write!(
                f,
                "{flag} asks for no token, and would be open to the network at {address}: \
                 choose an address of this machine, or give --open-to-network if that is meant"
            ),
            Self::Cores { cores, cause } => {
                let cores: Vec<_> = cores.iter().map(usize::to_string).collect();
                write!(f, "cannot run on cores {} alone: {cause}", cores.join(","))
            }
            Self::StepThreads(cause) => cause.fmt(f),
            Self::Thread(cause) => write!(f, "cannot start a thread: {cause}"),
            Self::Data(cause) => cause.fmt(f),
            Self::EngineWithoutImages(engine) => write!(
                f,
                "the engine {engine} cannot store its scenes: leave out --data, or take another --engine"
            ),
            Self::Serve(cause) => cause.fmt(f),
        }
    }
}

impl std::error::Error for RunError {}
