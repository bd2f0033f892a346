//! The ways to a server over sockets: addresses, connections, redials.
//!
//! An address of the network leads to QUIC, one of a Unix socket stays within the machine. Joins no scene.

use std::net::{SocketAddr, ToSocketAddrs};
#[cfg(unix)]
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

#[cfg(unix)]
use rhumb_link::UnixClient;
use rhumb_link::{ClientOptions, QuicClient, Trust};

use crate::client::Client;
use crate::connection::Redial;
use crate::error::OpenError;
use crate::server_connection::{ANSWER_TIMEOUT, ServerConnection};

/// The first characters of an address of the network, which may be absent (PROTOCOL 12).
const NETWORK_PREFIX: &str = "rhumb://";

/// The port of an address that names none (PROTOCOL 12).
const DEFAULT_PORT: u16 = 4433;

/// The first characters of the address of a Unix socket.
#[cfg(unix)]
const UNIX_PREFIX: &str = "unix:";

impl Client {
    /// Connects to the server at `address`, `host:port`, within five seconds. The same timeout holds for every later
    /// call that waits for an answer. An address without a port means port 4433; `rhumb://` may precede it. Servers that
    /// share their scenes are named with commas between: the first that answers is taken, also when a connection is lost.
    /// All of them show one certificate, for the first one's name, unless it is pinned.
    ///
    /// `unix:PATH` reaches a server of this machine by its Unix socket; the trust is then not asked, since only the user
    /// who runs the server can connect.
    ///
    /// The system resolves the host's name first; this has no time limit. A name with several addresses is tried at each,
    /// a quarter of a second after the one before at the most; the first that answers is taken.
    ///
    /// # Errors
    ///
    /// [`OpenError`] when the address, the network or the server's certificate fails.
    pub fn connect(address: &str, trust: Trust) -> Result<ServerConnection, OpenError> {
        Self::connect_within(address, trust, ANSWER_TIMEOUT)
    }

    /// Connects as [`Self::connect`], with another timeout than five seconds.
    ///
    /// # Errors
    ///
    /// As [`Self::connect`].
    pub fn connect_within(
        address: &str,
        trust: Trust,
        timeout: Duration,
    ) -> Result<ServerConnection, OpenError> {
        ServerConnection::open(address, trust, timeout)
    }
}

impl ServerConnection {
    fn open(address: &str, trust: Trust, timeout: Duration) -> Result<Self, OpenError> {
        #[cfg(unix)]
        if let Some(path) = address.strip_prefix(UNIX_PREFIX) {
            return Self::open_unix(path.into()).map(|opened| opened.timeout(timeout));
        }
        let servers = Servers::resolve(address, trust)?;
        let connection = QuicClient::connect(servers.options(0), timeout)?;
        let turns = AtomicUsize::new(0);
        let redial: Redial = Arc::new(move |elsewhere, timeout| {
            let options = match elsewhere {
                // The one that was lost is rather not the next.
                None => servers.options(1 + turns.fetch_add(1, Ordering::Relaxed)),
                Some(place) => servers.elsewhere(place)?.options(0),
            };
            Some(Box::new(QuicClient::connect(options, timeout).ok()?))
        });
        Ok(Self::with_redial(Box::new(connection), redial).timeout(timeout))
    }

    #[cfg(unix)]
    fn open_unix(path: PathBuf) -> Result<Self, OpenError> {
        let connection = UnixClient::connect(&path).map_err(|cause| OpenError::Socket {
            path: path.clone(),
            cause,
        })?;
        let redial: Redial = Arc::new(move |elsewhere, _| match elsewhere {
            // A server of another machine has no socket here, and this one's trust was not asked for.
            Some(_) => None,
            None => Some(Box::new(UnixClient::connect(&path).ok()?)),
        });
        Ok(Self::with_redial(Box::new(connection), redial))
    }
}

/// The servers of an address: one, or several that share their scenes.
struct Servers {
    /// The name that their certificate must have.
    name: String,
    /// Addresses of each.
    addresses: Vec<Vec<SocketAddr>>,
    trust: Trust,
}

impl Servers {
    fn resolve(address: &str, trust: Trust) -> Result<Self, OpenError> {
        let servers = address.split(',').map(|one| host_and_port(one.trim()));
        let servers: Vec<String> = servers.collect();
        let addresses = servers.iter().map(|server| resolve(server));
        Ok(Self {
            name: host_of(&servers[0]).to_owned(),
            addresses: addresses.collect::<Result<_, _>>()?,
            trust,
        })
    }

    /// The way to them, another one first at each turn.
    fn options(&self, turn: usize) -> ClientOptions {
        let (before, from) = self.addresses.split_at(turn % self.addresses.len());
        let mut addresses = from.iter().chain(before).flatten().copied();
        let first = addresses.next().expect("a name resolves to an address");
        ClientOptions {
            server_name: self.name.clone(),
            others: addresses.collect(),
            ..ClientOptions::new(first, self.trust.clone())
        }
    }

    /// The server that one of them has named (PROTOCOL 3.7). It is trusted as that one says: by its fingerprint, or as that
    /// one was.
    fn elsewhere(&self, place: &str) -> Option<Self> {
        let (address, trust) = match place.split_once('#') {
            Some((address, print)) => (address, Trust::Fingerprint(print.parse().ok()?)),
            None => (place, self.trust.clone()),
        };
        Self::resolve(address, trust).ok()
    }
}

/// `host:port` of an address whose prefix and port may be absent.
fn host_and_port(address: &str) -> String {
    let address = address.strip_prefix(NETWORK_PREFIX).unwrap_or(address);
    // An address of version 6 is in brackets, and has colons of its own.
    let behind_host = address.rsplit(']').next().unwrap_or_default();
    if behind_host.contains(':') {
        address.to_owned()
    } else {
        format!("{address}:{DEFAULT_PORT}")
    }
}

/// The addresses of `host:port`, one at least.
fn resolve(server: &str) -> Result<Vec<SocketAddr>, OpenError> {
    let failed = |cause| OpenError::Address {
        server: server.to_owned(),
        cause,
    };
    let addresses: Vec<_> = server.to_socket_addrs().map_err(failed)?.collect();
    match addresses.is_empty() {
        true => Err(failed(std::io::ErrorKind::NotFound.into())),
        false => Ok(addresses),
    }
}

/// The host of `host:port`, for comparison with the certificate.
fn host_of(server: &str) -> &str {
    let host = server.rsplit_once(':').map_or(server, |(host, _)| host);
    host.trim_start_matches('[').trim_end_matches(']')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_server_comes_first_at_each_turn() {
        let print = "ab".repeat(32).parse().unwrap();
        let trust = Trust::Fingerprint(print);
        let servers = Servers::resolve("127.0.0.1:1, rhumb://127.0.0.1:2", trust).unwrap();
        let ports = |turn| {
            let options = servers.options(turn);
            let others = options.others.iter();
            let all = std::iter::once(&options.server).chain(others);
            all.map(SocketAddr::port).collect::<Vec<_>>()
        };
        assert_eq!([ports(0), ports(1), ports(2)], [[1, 2], [2, 1], [1, 2]]);
        let named = servers.elsewhere("rhumb://127.0.0.1:3").unwrap();
        assert_eq!(named.options(0).server.port(), 3);
        assert!(servers.elsewhere("rhumb://127.0.0.1:3#no-print").is_none());
    }

    #[test]
    fn an_address_without_a_port_has_the_default_one() {
        for (address, expected) in [
            ("localhost", "localhost:4433"),
            ("localhost:5000", "localhost:5000"),
            ("rhumb://physics.example", "physics.example:4433"),
            ("rhumb://physics.example:5000", "physics.example:5000"),
            ("[::1]", "[::1]:4433"),
            ("rhumb://[::1]:5000", "[::1]:5000"),
        ] {
            let found = host_and_port(address);
            assert_eq!(found, expected);
            assert!(!host_of(&found).contains([']', '/']), "{found}");
        }
    }
}
