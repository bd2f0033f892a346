//! Servers in the process of the application, and the page of their scenes.
//!
//! Compiled by the feature `serve`. [`ServedScenes`] has sockets, so that other processes join; a [`LocalServer`] has none,
//! and its page has some of its own.

use core::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::io;
use std::sync::{Arc, OnceLock};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use rhumb_client::{
    Checkpoint, CheckpointError, Client, Fingerprint, LocalServer, ServerConnection, Trust,
};
use rhumb_server::{Access, Identity, PageBeside, RunError, Server, Stop, ViewScene, outward_ip};

use crate::door::NetworkDoor;
use crate::error::BindingError;
use crate::trust::address_with;

/// The machines that may reach a server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reach {
    /// This one.
    ThisMachine,
    /// All that the address reaches. There are no tokens: each client may do everything.
    Network,
}

/// A server on threads of this process, which other processes join. It ends when this is dropped.
#[derive(Debug)]
pub struct ServedScenes {
    listens: SocketAddr,
    fingerprint: Fingerprint,
    /// The page, or the reason why there is none.
    page: Result<String, &'static str>,
    stop: Stop,
    /// The reason why it stopped by itself.
    failed: Arc<OnceLock<RunError>>,
    thread: Option<JoinHandle<()>>,
}

impl ServedScenes {
    /// Listens at an address, port 0 for a free one, and begins to serve.
    ///
    /// # Errors
    ///
    /// [`BindingError`] for an address that cannot be used, and for one that other machines reach unless that is meant.
    pub fn start(listen: &str, reach: Reach) -> Result<Self, BindingError> {
        let needed = "an address with a port, such as 127.0.0.1:0";
        let listen: SocketAddr = listen
            .parse()
            .map_err(|_| BindingError::value("listen", format_args!("{listen:?}"), needed))?;
        let access = match reach {
            Reach::ThisMachine if !listen.ip().is_loopback() => {
                let needed = "an address of this machine alone, such as 127.0.0.1:0, unless open_to_network says that other \
                              machines may do everything in it, without a token";
                return Err(BindingError::value("listen", listen, needed));
            }
            Reach::ThisMachine => Access::OpenOnLoopback,
            Reach::Network => Access::OpenToNetwork,
        };
        let mut server = Server::bind(listen, &Identity::Development, access)?;
        let page = match server.show_page(SocketAddr::from((Ipv4Addr::LOCALHOST, 0)), Vec::new()) {
            Ok(page) => Ok(format!("http://{page}/")),
            Err(RunError::View(rhumb_server::ViewError::Unavailable(reason))) => Err(reason),
            Err(error) => return Err(error.into()),
        };
        let (listens, fingerprint) = (server.address(), server.fingerprint());
        let stop = Stop::new();
        let run = {
            let stop = stop.clone();
            move || server.run(&stop).map(drop)
        };
        let (failed, thread) = Self::spawn(run).map_err(RunError::Thread)?;
        Ok(Self {
            listens,
            fingerprint,
            page,
            stop,
            failed,
            thread: Some(thread),
        })
    }

    /// Runs a server on a thread, which keeps the reason why it stops by itself: each client sees only that its connection
    /// has ended.
    fn spawn(
        run: impl FnOnce() -> Result<(), RunError> + Send + 'static,
    ) -> io::Result<(Arc<OnceLock<RunError>>, JoinHandle<()>)> {
        let failed = Arc::new(OnceLock::new());
        let kept = Arc::clone(&failed);
        let run = move || {
            if let Err(error) = run() {
                kept.get_or_init(|| error);
            }
        };
        let thread = thread::Builder::new().name("rhumb-serve".to_owned());
        Ok((failed, thread.spawn(run)?))
    }

    /// An error if it stopped by itself.
    fn check(&self) -> Result<(), BindingError> {
        let failed = self.failed.get().map(ToString::to_string);
        failed.map_or(Ok(()), |reason| Err(BindingError::ServerEnded(reason)))
    }

    /// The address with the fingerprint: the one text by which other processes connect. Of a server at all addresses of this
    /// machine, it is the one by which other machines reach it.
    #[must_use]
    pub fn address(&self) -> String {
        address_with(outward(self.listens), self.fingerprint)
    }

    /// A connection from this process.
    ///
    /// # Errors
    ///
    /// As [`Client::connect_within`], and [`BindingError::ServerEnded`] if it stopped by itself.
    pub fn connect(&self, timeout: Duration) -> Result<ServerConnection, BindingError> {
        self.check()?;
        let trust = Trust::Fingerprint(self.fingerprint);
        let address = self.reached().to_string();
        Ok(Client::connect_within(&address, trust, timeout)?)
    }

    /// The address by which this machine reaches it.
    fn reached(&self) -> SocketAddr {
        let mut address = self.listens;
        if address.ip().is_unspecified() {
            address.set_ip(loopback(address.ip()));
        }
        address
    }
}

const fn loopback(any: IpAddr) -> IpAddr {
    match any {
        IpAddr::V4(_) => IpAddr::V4(Ipv4Addr::LOCALHOST),
        IpAddr::V6(_) => IpAddr::V6(Ipv6Addr::LOCALHOST),
    }
}

/// The address by which other machines reach one that is bound. A machine without a network has itself alone.
fn outward(mut address: SocketAddr) -> SocketAddr {
    let bound = address.ip();
    if bound.is_unspecified() {
        // A socket at [::] takes both kinds.
        let either = [bound, Ipv4Addr::UNSPECIFIED.into()];
        let outward = either.into_iter().find_map(|any| outward_ip(any).ok());
        address.set_ip(outward.unwrap_or_else(|| loopback(bound)));
    }
    address
}

impl Drop for ServedScenes {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread ended its clients, which have seen that.
            let _ = thread.join();
        }
    }
}

/// The server of a scene, where it is in this process.
#[derive(Clone)]
pub enum OwnServer {
    /// Without sockets.
    Local(LocalServer),
    /// With sockets.
    Served(Arc<ServedScenes>),
}

impl OwnServer {
    /// A connection of one more client. `timeout` holds for every later call that waits.
    ///
    /// # Errors
    ///
    /// As [`ServedScenes::connect`]; a server without sockets has none.
    pub fn connect(&self, timeout: Duration) -> Result<ServerConnection, BindingError> {
        match self {
            Self::Local(server) => Ok(server.connect().timeout(timeout)),
            Self::Served(served) => served.connect(timeout),
        }
    }

    /// The state of a scene, with everything that the server has read.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] as [`LocalServer::save`], and for a server with sockets.
    pub fn save(&self, scene: &str) -> Result<Checkpoint, CheckpointError> {
        match self {
            Self::Local(server) => server.save(scene),
            Self::Served(_) => Err(CheckpointError::NoServer),
        }
    }

    /// Makes a scene that continues from a checkpoint.
    ///
    /// # Errors
    ///
    /// [`CheckpointError`] as [`LocalServer::restore`], and for a server with sockets.
    pub fn restore(&self, scene: &str, checkpoint: &Checkpoint) -> Result<(), CheckpointError> {
        match self {
            Self::Local(server) => server.restore(scene, checkpoint),
            Self::Served(_) => Err(CheckpointError::NoServer),
        }
    }

    /// The one text by which other processes connect; `None` without sockets.
    #[must_use]
    pub fn address(&self) -> Option<String> {
        match self {
            Self::Local(_) => None,
            Self::Served(served) => Some(served.address()),
        }
    }
}

/// The server of a joined scene, and the page that shows it.
pub(crate) struct SceneServer {
    origin: OwnServer,
    scene: String,
    /// Of a local server, once it was asked for.
    page: Option<PageBeside>,
}

impl SceneServer {
    pub(crate) fn new(origin: OwnServer, scene: &str) -> Self {
        Self {
            origin,
            scene: scene.to_owned(),
            page: None,
        }
    }

    /// The one text by which other processes connect.
    pub(crate) fn address(&self) -> Option<String> {
        self.origin.address()
    }

    /// The state of the scene.
    pub(crate) fn save(&self) -> Result<Checkpoint, CheckpointError> {
        self.origin.save(&self.scene)
    }

    /// The address of the page that shows the scene; it answers until the scene is closed.
    pub(crate) fn page(&mut self) -> Result<String, BindingError> {
        let page = match &self.origin {
            OwnServer::Served(served) => {
                served.check()?;
                served.page.clone().map_err(BindingError::NoPage)?
            }
            OwnServer::Local(server) => match &self.page {
                Some(page) => page.url(),
                None => {
                    let shown = ViewScene {
                        name: self.scene.clone(),
                        player: None,
                    };
                    let server = server.clone();
                    let started = PageBeside::start(vec![shown], |waker| {
                        NetworkDoor::new(move || {
                            let waker = waker.clone();
                            server.open(move || waker.wake())
                        })
                    });
                    let started = match started {
                        Err(RunError::View(rhumb_server::ViewError::Unavailable(reason))) => {
                            return Err(BindingError::NoPage(reason));
                        }
                        started => started?,
                    };
                    self.page.insert(started).url()
                }
            },
        };
        Ok(format!("{page}?scene={}", escaped(&self.scene)))
    }
}

/// A text as a value in an address.
fn escaped(text: &str) -> String {
    let mut escaped = String::new();
    for byte in text.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' | b'/' => {
                escaped.push(char::from(byte));
            }
            _ => escaped += &format!("%{byte:02X}"),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_server_that_stops_by_itself_says_why() {
        let mut served = ServedScenes::start("127.0.0.1:0", Reach::ThisMachine).expect("it starts");
        served
            .connect(Duration::from_secs(5))
            .map(drop)
            .expect("it answers");
        let failing = || Err(RunError::Thread(io::Error::other("no more threads")));
        let (failed, thread) = ServedScenes::spawn(failing).expect("a thread");
        thread.join().expect("no panic");
        served.failed = failed;
        let refused = served.connect(Duration::from_secs(5)).err();
        let refused = refused.expect("it has stopped").to_string();
        assert!(refused.contains("no more threads"), "{refused}");
    }
}
