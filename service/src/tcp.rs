//! Accepts TCP connections on a thread of its own.
//!
//! Peers cannot hold it up: connections are bounded, also those of one address, and a system without descriptors is asked
//! again.

use std::collections::BTreeMap;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_transport::io_runtime;
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, oneshot};

/// Connections at one time: several browsers, scrapers or viewers. Others wait.
const CONNECTIONS_MAX: usize = 64;
/// Connections of one address at one time; further ones are closed. A browser opens six.
pub(crate) const PEER_CONNECTIONS_MAX: usize = 16;
/// Pause after the system refused a connection, for lack of descriptors.
const REFUSED_PAUSE: Duration = Duration::from_millis(50);

/// Serves one connection to its end.
pub(crate) type Serving =
    Arc<dyn Fn(TcpStream, SocketAddr) -> Pin<Box<dyn Future<Output = ()> + Send>> + Send + Sync>;

/// The thread that accepts; it ends, with all connections, when this is dropped.
#[derive(Debug)]
pub(crate) struct TcpService {
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl TcpService {
    /// Serves connections to a bound socket.
    pub(crate) fn start(listener: TcpListener, name: &str, serving: Serving) -> io::Result<Self> {
        listener.set_nonblocking(true)?;
        let runtime = io_runtime()?;
        let listener = {
            let _inside = runtime.enter();
            tokio::net::TcpListener::from_std(listener)?
        };
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new()
            .name(name.into())
            .spawn(move || runtime.block_on(accept(listener, serving, ended)))?;
        Ok(Self {
            end: Some(end),
            thread: Some(thread),
        })
    }
}

impl Drop for TcpService {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was logged.
            let _ = thread.join();
        }
    }
}

/// Connections of each address.
type Peers = Arc<Mutex<BTreeMap<IpAddr, usize>>>;

/// The place of a connection among those of its address, given back when it is dropped.
struct PeerPlace {
    peers: Peers,
    ip: IpAddr,
}

impl PeerPlace {
    /// A place; `None` if the address has all of its places.
    fn take(peers: &Peers, ip: IpAddr) -> Option<Self> {
        let mut counts = peers.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(ip).or_default();
        (*count < PEER_CONNECTIONS_MAX).then(|| {
            *count += 1;
            Self {
                peers: Arc::clone(peers),
                ip,
            }
        })
    }
}

impl Drop for PeerPlace {
    fn drop(&mut self) {
        let mut counts = self.peers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.ip) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.ip);
            }
        }
    }
}

async fn accept(
    listener: tokio::net::TcpListener,
    serving: Serving,
    mut ended: oneshot::Receiver<()>,
) {
    let places = Arc::new(Semaphore::new(CONNECTIONS_MAX));
    let peers = Peers::default();
    loop {
        let place = tokio::select! {
            _ = &mut ended => return,
            place = Arc::clone(&places).acquire_owned() => place,
        };
        // The semaphore is never closed.
        let Ok(place) = place else {
            return;
        };
        let accepted = tokio::select! {
            _ = &mut ended => return,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, peer)) => {
                let Some(of_peer) = PeerPlace::take(&peers, peer.ip()) else {
                    tracing::debug!(%peer, "a connection was closed: its address has {PEER_CONNECTIONS_MAX}");
                    continue;
                };
                let served = serving(stream, peer);
                tokio::spawn(async move {
                    served.await;
                    drop((place, of_peer));
                });
            }
            Err(cause) => {
                tracing::debug!(%cause, "a connection was not accepted");
                tokio::time::sleep(REFUSED_PAUSE).await;
            }
        }
    }
}
