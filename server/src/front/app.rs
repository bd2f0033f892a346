//! The front as the endpoint of APP: all its clients and scenes are one worker's.

use core::net::SocketAddr;

use bytes::Bytes;
use rhumb_protocol::{Instant, Peer};
use rhumb_transport::{AppEndpoint, AppTransmit};

use super::message::{WorkerId, WorkerInput};
use super::{Front, INPUTS_WAITING_MAX, Scope};

impl Front {
    /// The worker of all APP clients; once started, it stays.
    fn app_worker(&mut self) -> Option<WorkerId> {
        self.worker_of(Scope::App).ok()
    }

    fn route_app(&mut self, now: Instant, peer: Peer, input: WorkerInput) {
        if !self.app_peers.contains(&peer) {
            return;
        }
        let Some(id) = self.app_worker() else {
            return self.close_app(peer);
        };
        let waiting = self
            .workers
            .get(&id)
            .map(|worker| worker.sent - worker.taken);
        if waiting.is_some_and(|waiting| waiting >= INPUTS_WAITING_MAX) {
            tracing::warn!(
                peer = peer.0,
                "an app client sends faster than its scene steps"
            );
            self.route(now, id, WorkerInput::AppEnded(peer));
            return self.close_app(peer);
        }
        self.route(now, id, input);
    }

    fn close_app(&mut self, to: Peer) {
        self.app_peers.remove(&to);
        self.app_out.push_back(AppTransmit::Close { to });
    }
}

impl AppEndpoint for Front {
    fn handle_app_opened(&mut self, now: Instant, peer: Peer, from: SocketAddr) {
        self.app_peers.insert(peer);
        let Some(id) = self.app_worker() else {
            return self.close_app(peer);
        };
        self.route(now, id, WorkerInput::AppOpened(peer, from));
    }

    fn handle_app_waiting(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.route_app(now, peer, WorkerInput::AppWaiting(peer, bytes));
    }

    fn handle_app_bytes(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        let bytes = Bytes::copy_from_slice(bytes);
        self.route_app(now, from, WorkerInput::AppBytes(from, bytes));
    }

    fn handle_app_datagram(&mut self, now: Instant, from: SocketAddr, bytes: &[u8]) {
        let Some(id) = self.app_worker() else {
            return;
        };
        let waiting = self
            .workers
            .get(&id)
            .map(|worker| worker.sent - worker.taken);
        if waiting.is_some_and(|waiting| waiting < INPUTS_WAITING_MAX) {
            let bytes = Bytes::copy_from_slice(bytes);
            self.route(now, id, WorkerInput::AppDatagram(from, bytes));
        }
    }

    fn handle_app_ended(&mut self, now: Instant, peer: Peer) {
        if !self.app_peers.remove(&peer) {
            return;
        }
        if let Some(id) = self.by_scope.get(&Scope::App).copied() {
            self.route(now, id, WorkerInput::AppEnded(peer));
        }
    }

    fn poll_app(&mut self) -> Option<AppTransmit> {
        if self.app_out.is_empty() {
            self.collect();
        }
        self.app_out.pop_front()
    }
}
