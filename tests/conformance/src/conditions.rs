//! The peer under test, the link before it, and how long to wait.

use std::time::Duration;

use rhumb_netsim::{Carrier, LinkConfig, UdpRelay};
use rhumb_protocol::message::Token;
use rhumb_transport::Trust;

use super::feature::Feature;
use super::outcome::Stop;

/// The peer under test and the limits of the run.
#[derive(Clone, Debug)]
pub struct Conditions {
    /// The peer under test.
    pub subject: Subject,
    /// Default time limit of every wait.
    pub timeout: Duration,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Simulated network between suite and peer, if not ideal.
    pub link: LinkConfig,
    /// The transport of the suite's own clients.
    pub carrier: Carrier,
    /// Features that the peer is declared to lack.
    pub without: Vec<Feature>,
    /// The token that every client of a server shows, if it asks for one.
    pub token: Option<Token>,
}

impl Conditions {
    /// A relay with the simulated network in front of a target, if one is configured; `nth` relay of its case.
    ///
    /// # Errors
    ///
    /// [`Stop::Inconclusive`] when the machine has no socket for it.
    pub(super) fn relay(
        &self,
        target: std::net::SocketAddr,
        number: u64,
    ) -> Result<Option<UdpRelay>, Stop> {
        if self.link == LinkConfig::PERFECT {
            return Ok(None);
        }
        let anywhere = match target {
            std::net::SocketAddr::V4(_) => "127.0.0.1:0",
            std::net::SocketAddr::V6(_) => "[::1]:0",
        };
        let anywhere = anywhere.parse().expect("an address");
        let seed = self.seed.wrapping_add(number);
        let relay = UdpRelay::start(anywhere, target, self.link, seed);
        relay
            .map(Some)
            .map_err(|error| Stop::Inconclusive(error.to_string()))
    }
}

/// The peer under test.
#[derive(Clone, Debug)]
pub enum Subject {
    /// A server that is already listening.
    Server {
        /// Its address.
        target: std::net::SocketAddr,
        /// The name in its certificate.
        name: String,
        /// The verification of its certificate.
        trust: Trust,
    },
    /// A client, which is started anew for each case.
    Client {
        /// Address that the suite listens on; port 0 is another port for each case.
        listen: std::net::SocketAddr,
        /// The command that starts it.
        exec: String,
    },
    /// A decoder: a command, or by default the project's own.
    Decoder {
        /// The command that starts it.
        exec: Option<String>,
    },
    /// A client, which is started anew for each case, with a server that is already listening.
    Pair {
        /// The server's address.
        target: std::net::SocketAddr,
        /// The name in its certificate.
        name: String,
        /// The verification of its certificate.
        trust: Trust,
        /// The command that starts the client.
        exec: String,
    },
}
