//! All APP clients of the server loop.
//!
//! A client names its simulation on TCP and, once, by a datagram, which may come first: simulation and address match
//! the two. No state is sent to an address without a logged-on connection.

use core::net::{IpAddr, SocketAddr};
use std::collections::{BTreeMap, VecDeque};

use rhumb_protocol::Peer;

use super::guest::Guest;
use super::options::AppOptions;

/// The APP clients of one server.
#[derive(Debug, Default)]
pub(crate) struct Guests {
    pub(super) options: AppOptions,
    pub(super) guests: BTreeMap<Peer, Guest>,
    /// Datagram logons without a logged-on connection yet, oldest first.
    pub(super) unassigned: VecDeque<(u32, SocketAddr)>,
    pub(super) closing: VecDeque<Peer>,
}

impl Guests {
    pub(crate) const fn configure(&mut self, options: AppOptions) {
        self.options = options;
    }

    /// Destination of a simulation's states, if its datagram came first; the last one counts.
    pub(super) fn claim_datagram_logon(
        &mut self,
        simulation: u32,
        ip: IpAddr,
    ) -> Option<SocketAddr> {
        let is_its = |prediction_error: &(u32, SocketAddr)| {
            prediction_error.0 == simulation && prediction_error.1.ip() == ip
        };
        let last = self
            .unassigned
            .iter()
            .rfind(|prediction_error| is_its(prediction_error))
            .copied();
        self.unassigned
            .retain(|prediction_error| !is_its(prediction_error));
        last.map(|(_, from)| from)
    }

    pub(super) fn is_taken(&self, simulation: u32, by_other_than: Peer) -> bool {
        let leads = |guest: &Guest| guest.simulation() == Some(simulation);
        let mut guests = self.guests.iter();
        guests.any(|(peer, guest)| *peer != by_other_than && leads(guest))
    }
}
