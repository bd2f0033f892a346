//! Settings of zenoh's sessions, for state that is superseded and not resent.
//!
//! Opens nothing. What differs from zenoh's defaults, and why, is said beside each constant.

use std::error::Error;
use std::path::{Path, PathBuf};

use clap::Args;
use zenoh::Config;

/// Silence of a neighbour after which a link is given up, milliseconds. By default 10 s: that long a frozen router would hold up all
/// behind it.
const LEASE_MS: u32 = 600;
/// Time to open a link, milliseconds; 10 s by default. A frozen router is still the first of a list.
const OPEN_MS: u32 = 600;
/// Sessions of a router; 1,000 by default.
const SESSIONS_MAX: u32 = 16_384;

/// Longest message that a session puts together, bytes; 1 GiB by default. A packet of a stream is a small part of it.
const MESSAGE_BYTES_MAX: u32 = 65_536;

/// The use of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SessionKind {
    /// It forwards.
    Router,
    /// It publishes or subscribes, by the first router of its list that answers.
    Client,
}

/// Certificates of links over TLS. Each end shows its own, and connects to none that shows none: who could publish could move bodies.
#[derive(Args, Clone, Debug)]
pub(crate) struct LinkCertificates {
    /// PEM file with the own certificate for tls endpoints.
    #[arg(long, value_name = "FILE", requires_all = ["link_key", "link_roots"])]
    link_cert: Option<PathBuf>,
    /// PEM file with its private key.
    #[arg(long, value_name = "FILE", requires = "link_cert")]
    link_key: Option<PathBuf>,
    /// PEM file with the roots that sign the certificates of the other ends.
    #[arg(long, value_name = "FILE", requires = "link_cert")]
    link_roots: Option<PathBuf>,
}

impl LinkCertificates {
    /// Settings and their files.
    fn files(&self) -> impl Iterator<Item = (&'static str, &Path)> {
        [
            ("listen_certificate", &self.link_cert),
            ("connect_certificate", &self.link_cert),
            ("listen_private_key", &self.link_key),
            ("connect_private_key", &self.link_key),
            ("root_ca_certificate", &self.link_roots),
        ]
        .into_iter()
        .filter_map(|(name, file)| Some((name, file.as_deref()?)))
    }
}

/// The configuration of a session.
///
/// # Errors
///
/// An endpoint is none, or one of TLS has no certificates.
pub(crate) fn config(
    kind: SessionKind,
    (listen, connect): (&[String], &[String]),
    certificates: &LinkCertificates,
) -> Result<Config, Box<dyn Error + Send + Sync>> {
    let is_tls = |endpoint: &&String| endpoint.starts_with("tls/");
    if let Some(endpoint) = listen.iter().chain(connect).find(is_tls)
        && certificates.link_cert.is_none()
    {
        return Err(format!("{endpoint}: give --link-cert, --link-key and --link-roots").into());
    }
    let mut config = Config::default();
    let mode = match kind {
        SessionKind::Router => "router",
        SessionKind::Client => "client",
    };
    let text = |value: &str| format!("{value:?}");
    let list = |values: &[String]| format!("{values:?}");
    let settings = [
        ("mode", text(mode)),
        ("listen/endpoints", list(listen)),
        ("connect/endpoints", list(connect)),
        // No session is found by multicast, and none that was not named is connected.
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("transport/link/tx/lease", LEASE_MS.to_string()),
        ("transport/unicast/open_timeout", OPEN_MS.to_string()),
        ("transport/unicast/accept_timeout", OPEN_MS.to_string()),
        ("transport/unicast/max_sessions", SESSIONS_MAX.to_string()),
        (
            "transport/link/rx/max_message_size",
            MESSAGE_BYTES_MAX.to_string(),
        ),
    ];
    for (name, value) in settings {
        config.insert_json5(name, &value)?;
    }
    let file = |path: &Path| text(&path.display().to_string());
    for (name, path) in certificates.files() {
        config.insert_json5(&format!("transport/link/tls/{name}"), &file(path))?;
    }
    config.insert_json5("transport/link/tls/enable_mtls", "true")?;
    Ok(config)
}
