//! The page in which scenes are seen, served over HTTP.
//!
//! Beside the page's files it answers what the page needs to connect, and conditions the link of the page's own
//! connections: these pass through a relay, and no other connection does. It refuses pages of other origins. The same page,
//! written with recordings, needs no server.

mod answer;
mod static_page;

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener};
use std::sync::Arc;
use std::{fmt, io};

use rhumb_transport::conditioner::{LinkConfig, RelayError, UdpRelay};

use self::answer::{Hashes, Page};
use crate::access::TokenIssuer;
use crate::http::{self, HttpRequest};
use crate::metrics::Metrics;
use crate::tcp::TcpService;

pub use self::answer::ViewScene;
pub(crate) use self::static_page::{PageArguments, run as write_page};

/// Sockets of the page: bound, but not yet answering.
#[derive(Debug)]
pub(crate) struct PageListener {
    listener: TcpListener,
    address: SocketAddr,
    relay: UdpRelay,
    /// Address of the server.
    listens: SocketAddr,
}

/// Reason why the page cannot be served.
#[derive(Debug)]
pub enum ViewError {
    /// This build has no page; the text says what to do.
    Unavailable(&'static str),
    /// Listening for the page's requests failed.
    Listen {
        /// The TCP address.
        address: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The relay of the page's connections cannot start.
    Relay(RelayError),
}

impl PageListener {
    /// Listens at a TCP address for a server at a UDP address.
    pub(crate) fn bind(address: SocketAddr, listens: SocketAddr) -> Result<Self, ViewError> {
        if let Some(reason) = rhumb_viewer::UNAVAILABLE {
            return Err(ViewError::Unavailable(reason));
        }
        let failed = |cause| ViewError::Listen { address, cause };
        let listener = TcpListener::bind(address).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let relay = UdpRelay::start(
            SocketAddr::new(listens.ip(), 0),
            reachable(listens),
            LinkConfig::PERFECT,
            SEED,
        );
        Ok(Self {
            listener,
            address,
            relay: relay.map_err(ViewError::Relay)?,
            listens,
        })
    }

    /// Its address.
    pub(crate) const fn address(&self) -> SocketAddr {
        self.address
    }

    /// Answers requests until the result is dropped.
    pub(crate) fn start(
        self,
        hashes: Hashes,
        (scenes, metrics): (Vec<ViewScene>, Metrics),
        issuer: Option<TokenIssuer>,
        now: fn() -> i64,
    ) -> io::Result<TcpService> {
        let page = Page {
            listens: self.listens,
            relay: self.relay,
            hashes,
            scenes,
            metrics,
            issuer,
            now,
            named: !self.address.ip().is_loopback(),
        };
        let answer = Arc::new(move |request: &HttpRequest| page.answer(request));
        http::start(self.listener, "rhumb-server-view", answer)
    }
}

/// Seed of the relay's links: chance need not differ from run to run.
const SEED: u64 = 1;

/// The address by which this machine reaches a server that may listen at every address.
fn reachable(listens: SocketAddr) -> SocketAddr {
    let ip = match listens.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
        IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
        ip => ip,
    };
    SocketAddr::new(ip, listens.port())
}

impl fmt::Display for ViewError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unavailable(reason) => write!(f, "this build has no page: {reason}"),
            Self::Listen { address, cause } => write!(
                f,
                "cannot serve the page at tcp {address}: {cause}; choose another address by --view ADDRESS"
            ),
            Self::Relay(cause) => write!(f, "cannot relay the page's connections: {cause}"),
        }
    }
}

impl std::error::Error for ViewError {}
