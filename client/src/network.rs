//! The ways to a server over sockets: addresses, connections, redials.
//!
//! An address of the network leads to QUIC, one of a Unix socket stays within the machine. Joins no scene.

use std::net::{SocketAddr, ToSocketAddrs};
#[cfg(unix)]
use std::path::PathBuf;
use std::sync::Arc;
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
    /// call that waits for an answer. An address without a port means port 4433; `rhumb://` may precede it.
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
        let address = host_and_port(address);
        let (server, others) = resolve(&address)?;
        let options = ClientOptions {
            server_name: host_of(&address).to_owned(),
            others,
            ..ClientOptions::new(server, trust)
        };
        let connection = QuicClient::connect(options.clone(), timeout)?;
        let redial: Redial = Arc::new(move |timeout| {
            let connection = QuicClient::connect(options.clone(), timeout).ok()?;
            Some(Box::new(connection))
        });
        Ok(Self::with_redial(Box::new(connection), redial).timeout(timeout))
    }

    #[cfg(unix)]
    fn open_unix(path: PathBuf) -> Result<Self, OpenError> {
        let connection = UnixClient::connect(&path).map_err(|cause| OpenError::Socket {
            path: path.clone(),
            cause,
        })?;
        let redial: Redial = Arc::new(move |_| Some(Box::new(UnixClient::connect(&path).ok()?)));
        Ok(Self::with_redial(Box::new(connection), redial))
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

/// The addresses of `host:port`: the first one, and the others.
fn resolve(server: &str) -> Result<(SocketAddr, Vec<SocketAddr>), OpenError> {
    let failed = |cause| OpenError::Address {
        server: server.to_owned(),
        cause,
    };
    let mut addresses = server.to_socket_addrs().map_err(failed)?;
    let first = addresses
        .next()
        .ok_or_else(|| failed(std::io::ErrorKind::NotFound.into()))?;
    Ok((first, addresses.collect()))
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
