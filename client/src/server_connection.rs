//! A connection to a server before it joins a scene.
//!
//! Joining takes up to three answers: welcome, creation, snapshot. Each must arrive within the connection's timeout.

use std::net::{SocketAddr, ToSocketAddrs};
#[cfg(unix)]
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use rhumb_protocol::message::{Denial, SessionKey, Token};
use rhumb_protocol::scene::{IdRange, SceneName};
use rhumb_protocol::session::{ClientSession, Event};
#[cfg(unix)]
use rhumb_transport::UnixClient;
use rhumb_transport::{ClientOptions, ClientTransport, QuicClient, Trust, random_bytes};
use rhumb_view::{JoinError, Joining};

use crate::client::Client;
use crate::error::{ClientError, OpenError};
use crate::join_options::JoinOptions;
use crate::pump::{Pump, span};
use crate::redial::{BoxedConnection, Redial};

/// Default time limit for an answer of the server.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(5);

/// The first characters of an address of the network, which may be absent (PROTOCOL 12).
const NETWORK_PREFIX: &str = "rhumb://";

/// The port of an address that names none (PROTOCOL 12).
const DEFAULT_PORT: u16 = 4433;

/// The first characters of the address of a Unix socket.
#[cfg(unix)]
const UNIX_PREFIX: &str = "unix:";

/// A connection to a server that has joined no scene yet.
pub struct ServerConnection {
    connection: BoxedConnection,
    redial: Option<Redial>,
    timeout: Duration,
    token: Option<String>,
}

impl ServerConnection {
    pub(crate) fn open(address: &str, trust: Trust, timeout: Duration) -> Result<Self, OpenError> {
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
        Ok(Self {
            redial: Some(redial),
            ..Self::over(connection)
        }
        .timeout(timeout))
    }

    #[cfg(unix)]
    fn open_unix(path: PathBuf) -> Result<Self, OpenError> {
        let connection = UnixClient::connect(&path).map_err(|cause| OpenError::Socket {
            path: path.clone(),
            cause,
        })?;
        let redial: Redial = Arc::new(move |_| Some(Box::new(UnixClient::connect(&path).ok()?)));
        Ok(Self {
            redial: Some(redial),
            ..Self::over(connection)
        })
    }

    /// A connection that another program carries, such as one to a server in the same process. A client that loses it
    /// does not reconnect.
    #[must_use]
    pub fn over(connection: impl ClientTransport + 'static) -> Self {
        Self {
            connection: Box::new(connection),
            redial: None,
            timeout: ANSWER_TIMEOUT,
            token: None,
        }
    }

    /// A connection whose server `redial` reaches again.
    #[cfg(test)]
    pub(crate) fn with_redial(connection: BoxedConnection, redial: Redial) -> Self {
        Self {
            connection,
            redial: Some(redial),
            timeout: ANSWER_TIMEOUT,
            token: None,
        }
    }

    /// Sets the time limit for each answer of the server; without this, five seconds.
    #[must_use]
    pub fn timeout(self, timeout: Duration) -> Self {
        Self { timeout, ..self }
    }

    /// Shows this token, which `rhumb-server token` made, when it joins. Only a server started with `--open` needs none.
    #[must_use]
    pub fn token(mut self, token: &str) -> Self {
        self.token = Some(token.to_owned());
        self
    }

    /// Checks what the caller gives to [`Self::join_with`]: the name of the scene, and the token. An error of the join
    /// itself comes after the connection is used up.
    ///
    /// # Errors
    ///
    /// [`OpenError::SceneName`] or [`OpenError::Token`].
    pub fn check_join(&self, scene: &str) -> Result<(), OpenError> {
        scene_name(scene)?;
        self.parsed_token().map(drop)
    }

    /// Joins a scene of this name with [`JoinOptions::default`], which creates the scene unless it exists.
    ///
    /// # Errors
    ///
    /// As [`Self::join_with`].
    pub fn join(self, scene: &str) -> Result<Client, OpenError> {
        self.join_with(scene, JoinOptions::default())
    }

    /// Joins a scene of this name, and returns when the client's copy of the scene is complete.
    ///
    /// # Errors
    ///
    /// [`OpenError`] for an invalid scene name, token, delay or lead, a request that the server denies, and an answer that
    /// does not arrive in time.
    pub fn join_with(self, scene: &str, options: JoinOptions) -> Result<Client, OpenError> {
        let name = scene_name(scene)?;
        options.check().map_err(OpenError::Ticks)?;
        let timeout = self.timeout;
        let denied = |denial| OpenError::Denied {
            scene: name.clone(),
            denial,
        };
        let mut session = ClientSession::new(name.clone());
        if let Some(token) = self.parsed_token()? {
            session.set_token(token);
        }
        let key = match options.resume_within {
            _ if self.redial.is_none() => None,
            Some(Duration::ZERO) => None,
            _ => Some(SessionKey(random_bytes().map_err(OpenError::Random)?)),
        };
        let mut joining = Joining::new(options.mode, options.stream, key);
        let mut pump = Pump::new(session, self.connection, self.redial);
        let granted = await_scene(&mut pump, timeout, &mut joining)?.map_err(denied)?;
        Ok(Client::joined(pump, timeout, &options, granted))
    }

    fn parsed_token(&self) -> Result<Option<Token>, OpenError> {
        let token = self.token.as_ref().map(|token| token.parse::<Token>());
        token.transpose().map_err(OpenError::Token)
    }
}

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

/// Waits until the session has joined; each answer has the whole time limit. The inner error is the server's.
fn await_scene(
    pump: &mut Pump,
    timeout: Duration,
    joining: &mut Joining,
) -> Result<Result<IdRange, Denial>, ClientError> {
    let mut awaited = joining.awaited();
    let mut deadline = pump.now() + span(timeout);
    loop {
        pump.turn(deadline);
        while let Some(event) = pump.session.poll_event() {
            if let Event::Ended(ending) = event {
                return Err(ClientError::Ended(ending));
            }
            match joining.handle(&mut pump.session, &event) {
                Ok(None) => {}
                Ok(Some(granted)) => return Ok(Ok(granted)),
                Err(JoinError::Denied(denial)) => return Ok(Err(denial)),
                Err(JoinError::Misuse(misuse)) => return Err(misuse.into()),
            }
        }
        if awaited != joining.awaited() {
            awaited = joining.awaited();
            deadline = pump.now() + span(timeout);
        }
        if pump.now() >= deadline {
            return Err(ClientError::Timeout { awaited, timeout });
        }
    }
}

fn scene_name(scene: &str) -> Result<SceneName, OpenError> {
    scene.parse().map_err(|cause| OpenError::SceneName {
        scene: scene.to_owned(),
        cause,
    })
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
