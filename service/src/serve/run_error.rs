//! Reasons for which a server does not start, or stops by itself.

use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::path::PathBuf;

use rhumb_scene::engine::{EngineKind, StepThreadsError};

use rhumb_transport::{BindError, CertificateError, ServeError};

#[cfg(feature = "view")]
use crate::access::KeyError;
use crate::durable::DataError;
#[cfg(feature = "view")]
use crate::view::ViewError;

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
