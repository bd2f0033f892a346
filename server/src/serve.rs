//! Runs a host behind real sockets until it is told to stop.
//!
//! What the `rhumb-server` binary does, callable by whoever embeds it.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use rhumb_transport::{
    AppBindError, AppListen, BindError, Certificate, CertificateError, Clock, Fingerprint,
    QuicServer, ServeError, ServerOptions, ServerStatistics, Stop,
};

use crate::app::AppOptions;
use crate::engine::{Workers, WorkersError};
use crate::hook::Hooks;
use crate::server_loop::ServerLoop;

/// What the server proves itself with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Identity {
    /// A certificate made at start; clients pin its fingerprint.
    Development,
    /// A certificate chain and its key, as PEM files.
    Files {
        /// The chain, the server's own first.
        certificate: PathBuf,
        /// The key.
        key: PathBuf,
    },
}

/// A server that listens, and is not run yet.
pub struct Server {
    transport: QuicServer,
    hooks: Option<Hooks>,
    app: AppOptions,
    workers: Workers,
}

/// Why a server did not start, or stopped unasked.
#[derive(Debug)]
pub enum RunError {
    /// The certificate cannot be used.
    Certificate(CertificateError),
    /// The address cannot be listened on.
    Bind(BindError),
    /// The address for clients of the paper's protocol cannot be listened on.
    AppBind(AppBindError),
    /// The threads cannot be bound to cores.
    Cores {
        /// Which cores.
        cores: Vec<usize>,
        /// What the system says.
        cause: io::Error,
    },
    /// There are not as many threads to step on.
    Workers(WorkersError),
    /// The sockets' thread was lost.
    Serve(ServeError),
}

impl fmt::Display for RunError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Certificate(cause) => cause.fmt(f),
            Self::Bind(cause) => cause.fmt(f),
            Self::AppBind(cause) => cause.fmt(f),
            Self::Cores { cores, cause } => {
                let cores: Vec<_> = cores.iter().map(usize::to_string).collect();
                write!(f, "cannot run on cores {} alone: {cause}", cores.join(","))
            }
            Self::Workers(cause) => cause.fmt(f),
            Self::Serve(cause) => cause.fmt(f),
        }
    }
}

impl std::error::Error for RunError {}

impl Server {
    /// Listens. Clients that connect wait until [`Self::run`].
    ///
    /// # Errors
    ///
    /// [`RunError`] for a certificate or an address that cannot be used.
    pub fn bind(listen: SocketAddr, identity: &Identity) -> Result<Self, RunError> {
        let certificate = match identity {
            Identity::Development => Certificate::development(["localhost"]),
            Identity::Files { certificate, key } => Certificate::from_pem_files(certificate, key),
        }
        .map_err(RunError::Certificate)?;
        let options = ServerOptions {
            listen,
            certificate,
        };
        let transport = QuicServer::bind(options).map_err(RunError::Bind)?;
        Ok(Self {
            transport,
            hooks: None,
            app: AppOptions::default(),
            workers: Workers::default(),
        })
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.transport.local_addr()
    }

    /// What clients pin.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        self.transport.fingerprint()
    }

    /// Awaits clients of the paper's protocol too, and says where.
    ///
    /// # Errors
    ///
    /// [`RunError::AppBind`] for an address that cannot be used.
    pub fn listen_app(
        &mut self,
        listen: AppListen,
        options: AppOptions,
    ) -> Result<SocketAddr, RunError> {
        self.app = options;
        self.transport.listen_app(listen).map_err(RunError::AppBind)
    }

    /// Gives the scenes that will be created their hooks.
    pub fn attach(&mut self, hooks: Hooks) {
        self.hooks = Some(hooks);
    }

    /// Has the scenes that will be created stepped by these threads.
    pub fn employ(&mut self, workers: Workers) {
        self.workers = workers;
    }

    /// Serves on the calling thread until `stop` is said; then every client hears that the server is going away.
    ///
    /// # Errors
    ///
    /// [`RunError::Serve`] if the sockets' thread is lost.
    pub fn run(self, stop: &Stop) -> Result<ServerStatistics, RunError> {
        let clock = Clock::start();
        let mut host = ServerLoop::new(move || clock.now());
        host.employ(self.workers);
        if let Some(hooks) = self.hooks {
            host.attach(hooks);
        }
        host.configure_app(self.app);
        self.transport
            .run_app(&mut host, stop)
            .map_err(RunError::Serve)
    }
}

/// The cores that the calling thread may run on, lowest first; none where the system does not tell.
#[cfg(target_os = "linux")]
#[must_use]
pub fn usable_cores() -> Vec<usize> {
    use rustix::thread::{CpuSet, sched_getaffinity};
    let set = sched_getaffinity(None).unwrap_or_default();
    (0..CpuSet::MAX_CPU)
        .filter(|core| set.is_set(*core))
        .collect()
}

/// The cores that the calling thread may run on, lowest first; none where the system does not tell.
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
