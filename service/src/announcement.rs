//! The lines that a server prints when it has started.

use std::io::Write;
use std::net::SocketAddr;

use rhumb_transport::Fingerprint;

use crate::serve::{Identity, Server};

/// Addresses of the listeners beside the server's own.
pub(crate) struct BoundAddresses {
    pub(crate) app: Option<SocketAddr>,
    pub(crate) metrics: Option<SocketAddr>,
    pub(crate) view: Option<SocketAddr>,
    pub(crate) foxglove: Option<SocketAddr>,
}

/// The URL of the page.
pub(crate) fn page_url(view: SocketAddr) -> String {
    format!("http://{view}/")
}

/// Prints the address and the fingerprint to pin. A closed standard output does not stop a server.
pub(crate) fn announce(server: &Server, identity: &Identity, addresses: &BoundAddresses) {
    let kind = match identity {
        Identity::Development => "development, made at start",
        Identity::Files { .. } => "from files",
        Identity::DevelopmentFiles { .. } => "development, kept in the data directory",
    };
    let hashes = server.certificate_hashes().current();
    let hash = |hash: &Fingerprint| format!("certificate hash for browsers {hash}\n");
    let hashes: String = hashes.iter().map(hash).collect();
    let line = |address: Option<SocketAddr>, text: fn(SocketAddr) -> String| {
        address.map_or_else(String::new, text)
    };
    let lines = format!(
        "rhumb-server {}\nlistening on {}\ncertificate {kind}\nfingerprint {}\n{}{}{}{}{hashes}",
        env!("CARGO_PKG_VERSION"),
        server.address(),
        server.fingerprint(),
        line(addresses.app, |app| format!("app listening on {app}\n")),
        line(addresses.metrics, |at| format!(
            "metrics at http://{at}/metrics\n"
        )),
        line(addresses.view, |at| format!("page at {}\n", page_url(at))),
        line(addresses.foxglove, |at| format!("foxglove at ws://{at}\n")),
    );
    write_lines(&lines);
}

/// Prints, as the last line of a demo's start, how a person comes to see the page.
#[cfg(feature = "demo")]
pub(crate) fn announce_opening(url: &str, asked: bool) {
    write_lines(&if asked {
        format!("the desktop was asked to open {url} in a browser; Ctrl-C ends the demo\n")
    } else {
        format!("open {url} in a browser of this machine; Ctrl-C ends the demo\n")
    });
}

fn write_lines(lines: &str) {
    let mut out = std::io::stdout().lock();
    if let Err(cause) = out.write_all(lines.as_bytes()).and_then(|()| out.flush()) {
        tracing::warn!("cannot write the start-up lines: {cause}");
    }
}
