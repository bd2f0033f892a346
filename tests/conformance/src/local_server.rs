//! A server on a thread of this process, for trying the suite itself.

use std::net::SocketAddr;
use std::thread::{self, JoinHandle};

use rhumb_server::{Access, Identity, RunError, Server, ServerStatistics, Stop};
use rhumb_transport::Fingerprint;

/// A running server; dropping it stops it.
#[derive(Debug)]
pub struct LocalServer {
    /// The address of its socket.
    pub address: SocketAddr,
    /// The fingerprint that clients pin.
    pub fingerprint: Fingerprint,
    /// The fingerprint of the certificate that browsers are shown.
    pub certificate_hash: Fingerprint,
    stop: Stop,
    thread: Option<JoinHandle<Result<ServerStatistics, RunError>>>,
}

impl LocalServer {
    /// Serves on a free port of the loopback interface, with a certificate for development.
    ///
    /// # Errors
    ///
    /// [`RunError`] when the server cannot start.
    pub fn start() -> Result<Self, RunError> {
        let loopback = SocketAddr::from(([127, 0, 0, 1], 0));
        let server = Server::bind(loopback, &Identity::Development, Access::OpenOnLoopback)?;
        let (address, fingerprint) = (server.address(), server.fingerprint());
        let hashes = server.certificate_hashes().current();
        let certificate_hash = *hashes.first().unwrap_or(&fingerprint);
        let stop = Stop::new();
        let thread = thread::spawn({
            let stop = stop.clone();
            move || server.run(&stop)
        });
        Ok(Self {
            address,
            fingerprint,
            certificate_hash,
            stop,
            thread: Some(thread),
        })
    }
}

impl Drop for LocalServer {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            // The test that used it has judged it already.
            let _ = thread.join();
        }
    }
}
