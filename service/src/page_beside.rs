//! The page and the door of scenes that another part of this process runs.
//!
//! The page is reached by this machine alone. Browsers and clients connect to a socket of its own, whose endpoint carries
//! them to the scenes.

use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::thread::{self, JoinHandle};

use rhumb_protocol::Endpoint;
use rhumb_transport::{Fingerprint, Origins, QuicServer, ServerOptions, Stop, Waker, WebOptions};

use crate::http::TcpService;
use crate::metrics::Metrics;
use crate::serve::{Identity, RunError, seconds_since_1970};
use crate::start::page_url;
use crate::view::{PageListener, ViewScene};

/// A page of this machine that shows scenes of this process. It ends when this is dropped.
#[derive(Debug)]
pub struct PageBeside {
    address: SocketAddr,
    listens: SocketAddr,
    fingerprint: Fingerprint,
    stop: Stop,
    thread: Option<JoinHandle<()>>,
    _page: TcpService,
}

/// Any free port of this machine, for the page.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

impl PageBeside {
    /// Shows these scenes, and lets clients in that reach this address: there are no tokens, and each may do everything.
    /// `endpoint` makes what carries browsers and clients to the scenes; it gets what wakes its thread.
    ///
    /// # Errors
    ///
    /// [`RunError`] if the system refuses sockets or threads, or this build has no page.
    pub fn start<E: Endpoint + Send + 'static>(
        listen: SocketAddr,
        scenes: Vec<ViewScene>,
        endpoint: impl FnOnce(Waker) -> E,
    ) -> Result<Self, RunError> {
        let identity = Identity::Development;
        let options = ServerOptions {
            web: Some(WebOptions {
                origins: Origins::loopback(),
                certificate: identity.web(),
            }),
            ..ServerOptions::new(listen, identity.certificate()?)
        };
        let transport = QuicServer::bind(options).map_err(RunError::Bind)?;
        let page = PageListener::bind(LISTEN, transport.local_addr()).map_err(RunError::View)?;
        let address = page.address();
        let (listens, fingerprint) = (transport.local_addr(), transport.fingerprint());
        let hashes = transport.certificate_hashes();
        let texts = move || hashes.current().iter().map(ToString::to_string).collect();
        let shown = (scenes, Metrics::default());
        let page = page.start(Box::new(texts), shown, None, seconds_since_1970);
        let page = page.map_err(RunError::Thread)?;
        let stop = Stop::new();
        let mut endpoint = endpoint(transport.waker());
        let thread = thread::Builder::new()
            .name("rhumb-page".to_owned())
            .spawn({
                let stop = stop.clone();
                move || {
                    if let Err(cause) = transport.run(&mut endpoint, &stop) {
                        tracing::error!(%cause, "the page's connections ended");
                    }
                }
            })
            .map_err(RunError::Thread)?;
        Ok(Self {
            address,
            listens,
            fingerprint,
            stop,
            thread: Some(thread),
            _page: page,
        })
    }

    /// The address at which clients connect.
    #[must_use]
    pub const fn listens(&self) -> SocketAddr {
        self.listens
    }

    /// The fingerprint for them to pin.
    #[must_use]
    pub const fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// The page's address.
    #[must_use]
    pub fn url(&self) -> String {
        page_url(self.address)
    }
}

impl Drop for PageBeside {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the thread of the page's connections panicked");
        }
    }
}
