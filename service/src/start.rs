//! The start of a server: refusals before it, lines printed after it.
//!
//! Refused are wrong settings, and unusable files and directories. A start and `--check-config` run the same checks. Nothing
//! stays changed, and no address is taken, so a running server is not disturbed.

use std::error::Error;
use std::fs::File;
use std::io::{self, Write};
use std::net::SocketAddr;
use std::path::Path;

use hyper::http::uri::Authority;
use rhumb_scene::engine::StepThreads;
use rhumb_transport::Fingerprint;

use crate::access::TokenKeys;
use crate::agones::Sidecar;
use crate::directory::Endpoints;
use crate::dispatcher::ProcessOptions;
use crate::durable::DataDir;
use crate::serve::{Access, Identity, RunError, Server, check_images, run_on_cores};
use crate::settings::{ServerSettings, WorkerKind};

/// The message to an operator who has not decided about access.
const NO_ACCESS: &str = "no client could join: start with --open to admit all clients of this machine, \
    or make keys by `rhumb-server token --new-key FILE` and start with --token-key FILE.pub";

/// The parts of a start that were made while it was checked.
pub(crate) struct CheckedStart {
    pub(crate) threads: StepThreads,
    pub(crate) access: Access,
    /// `Some` if scenes run in worker processes.
    pub(crate) processes: Option<ProcessOptions>,
    /// `Some` if other servers have scenes too.
    pub(crate) directory: Option<Endpoints>,
    /// `Some` if the server reports to Agones.
    pub(crate) agones: Option<Sidecar>,
}

/// Checks everything that refuses a start, except addresses in use and the contents of the data directory.
///
/// `app`: an address at which clients of another protocol are served without tokens, if other machines reach it.
///
/// # Errors
///
/// The first reason for which a server with these settings would not start.
pub(crate) fn check(
    settings: &ServerSettings,
    app: Option<SocketAddr>,
) -> Result<CheckedStart, Box<dyn Error>> {
    if !settings.cores.is_empty() {
        run_on_cores(&settings.cores)?;
    }
    if settings.data.is_some() {
        check_images(settings.engine)?;
    }
    let threads = StepThreads::new(Some(settings.threads)).map_err(RunError::StepThreads)?;
    let access = access(settings)?;
    if matches!(access, Access::OpenOnLoopback) && !settings.listen.ip().is_loopback() {
        return Err(RunError::OpenToNetwork {
            address: settings.listen,
            flag: "--listen",
        }
        .into());
    }
    check_open(settings, app)?;
    check_page(settings, &access)?;
    check_observers(settings)?;
    if cfg!(not(unix)) && settings.socket.is_some() {
        return Err("this system has no Unix sockets: leave out --socket".into());
    }
    let processes = processes(settings)?;
    let directory = directory(settings)?;
    let agones = (settings.agones)
        .then(Sidecar::from_environment)
        .transpose()?;
    check_written("scenes", settings.data.as_deref())?;
    check_written("flight recorders", settings.flight.as_deref())?;
    check_written("recordings", settings.record.as_deref())?;
    // Without files, the certificate is made at the start.
    if let identity @ Identity::Files { .. } = identity(settings, None)? {
        identity.certificate()?;
    }
    Ok(CheckedStart {
        threads,
        access,
        processes,
        directory,
        agones,
    })
}

/// The certificate to serve with: its files, or one for development, which a data directory keeps.
pub(crate) fn identity(
    settings: &ServerSettings,
    data: Option<&DataDir>,
) -> Result<Identity, Box<dyn Error>> {
    match (settings.cert.clone(), settings.key.clone()) {
        (Some(certificate), Some(key)) => Ok(Identity::Files { certificate, key }),
        (None, None) => Ok(match data {
            None => Identity::Development,
            Some(data) => {
                let (certificate, key) = data.development_certificate()?;
                Identity::DevelopmentFiles { certificate, key }
            }
        }),
        _ => Err("a certificate needs its key, and a key its certificate".into()),
    }
}

/// The clients to admit. No client is admitted without a token unless the operator says so.
fn access(settings: &ServerSettings) -> Result<Access, Box<dyn Error>> {
    match (settings.open, settings.open_to_network) {
        (true, _) if !settings.token_keys.is_empty() => {
            Err("a server is open or has token keys, not both".into())
        }
        (true, true) => Ok(Access::OpenToNetwork),
        (true, false) => Ok(Access::OpenOnLoopback),
        _ if settings.token_keys.is_empty() => Err(NO_ACCESS.into()),
        _ => {
            let keys = TokenKeys::read(&settings.token_keys, &settings.audience)?;
            Ok(Access::Tokens(keys))
        }
    }
}

/// The directory of scenes. Its servers share a data directory and know each other's addresses.
fn directory(settings: &ServerSettings) -> Result<Option<Endpoints>, Box<dyn Error>> {
    let Some(directory) = &settings.directory else {
        return match &settings.advertise {
            None => Ok(None),
            Some(address) => Err(format!(
                "--advertise {address} names this server to the others of a directory: give --directory too"
            )
            .into()),
        };
    };
    if settings.data.is_none() {
        return Err(
            "a directory needs --data DIR, on a file system that all of its servers share: \
            a scene comes to another server by its files"
                .into(),
        );
    }
    let listen = settings.listen;
    match &settings.advertise {
        None if listen.ip().is_unspecified() => {
            return Err(format!(
                "--listen {listen} is no address that the directory could name to clients: give --advertise host:port"
            )
            .into());
        }
        Some(address) if !is_host_and_port(address) => {
            return Err(format!(
                "--advertise {address:?} is no address of a server: give host:port, of 255 characters at most"
            )
            .into());
        }
        _ => {}
    }
    Ok(Some(directory.parse()?))
}

/// True for a name or an address with a port, and nothing else.
fn is_host_and_port(address: &str) -> bool {
    let authority = address.parse::<Authority>().ok();
    authority.is_some_and(|authority| {
        let has_port = authority.port_u16().is_some_and(|port| port > 0);
        let has_user = address.contains('@');
        has_port && !has_user && !authority.host().is_empty() && address.len() <= 255
    })
}

/// Refuses what would let other machines in without a token, unless the operator says so.
fn check_open(settings: &ServerSettings, app: Option<SocketAddr>) -> Result<(), RunError> {
    let listeners = [
        ("--app-listen", app),
        ("--view", settings.view),
        ("--foxglove", settings.foxglove),
        ("--metrics", settings.metrics),
    ];
    let open = listeners.into_iter().find_map(|(flag, address)| {
        let address = address.filter(|address| !address.ip().is_loopback())?;
        Some(RunError::OpenToNetwork { address, flag })
    });
    match open {
        Some(refusal) if !settings.open_to_network => Err(refusal),
        _ => Ok(()),
    }
}

/// Refuses a page that could not be shown.
fn check_page(settings: &ServerSettings, access: &Access) -> Result<(), Box<dyn Error>> {
    if settings.view.is_none() {
        return Ok(());
    }
    #[cfg(not(feature = "view"))]
    {
        let _ = access;
        Err("this server was built without the feature `view`: it has no page".into())
    }
    #[cfg(feature = "view")]
    {
        if let Some(reason) = rhumb_viewer::UNAVAILABLE {
            return Err(RunError::View(crate::view::ViewError::Unavailable(reason)).into());
        }
        if !settings.web {
            return Err(
                "a page is no use to a server without browsers: leave out --no-web, or --view"
                    .into(),
            );
        }
        if let Access::Tokens(keys) = access {
            keys.clone().issuer().map_err(RunError::ViewToken)?;
        }
        Ok(())
    }
}

/// Refuses recordings and viewers that this server could not serve.
fn check_observers(settings: &ServerSettings) -> Result<(), Box<dyn Error>> {
    if cfg!(not(feature = "record")) && settings.record.is_some() {
        return Err(
            "this server was built without the feature `record`: it records nothing".into(),
        );
    }
    if cfg!(not(feature = "foxglove")) && settings.foxglove.is_some() {
        return Err("this server was built without the feature `foxglove`".into());
    }
    if settings.foxglove.is_some() && settings.worker_kind() == WorkerKind::Processes {
        return Err(
            "Foxglove's viewers see scenes of the server's own process alone: \
                    leave out `foxglove`, or set workers = \"threads\""
                .into(),
        );
    }
    Ok(())
}

#[cfg(target_os = "linux")]
fn processes(settings: &ServerSettings) -> Result<Option<ProcessOptions>, Box<dyn Error>> {
    let options = || ProcessOptions {
        share: settings.share_worker,
        log: settings.log,
        threads: settings.threads,
        record: settings.record.clone(),
    };
    Ok((settings.worker_kind() == WorkerKind::Processes).then(options))
}

/// This system has no worker processes.
#[cfg(not(target_os = "linux"))]
fn processes(settings: &ServerSettings) -> Result<Option<ProcessOptions>, Box<dyn Error>> {
    match settings.worker_kind() {
        WorkerKind::Threads => Ok(None),
        WorkerKind::Processes => {
            Err("this system has no worker processes: set `workers` to \"threads\"".into())
        }
    }
}

/// Checks that a directory takes files, or can still be made.
fn check_written(of: &str, directory: Option<&Path>) -> Result<(), Box<dyn Error>> {
    let Some(directory) = directory else {
        return Ok(());
    };
    let named = directory.display();
    let missing = directory.ancestors().skip(1).find(|above| above.exists());
    let above = if directory.exists() {
        directory
    } else {
        // A relative name stands in the current directory.
        missing
            .filter(|above| *above != Path::new(""))
            .unwrap_or(Path::new("."))
    };
    if !above.is_dir() {
        let above = above.display();
        return Err(
            format!("the directory {named} for {of} cannot be used: {above} is a file").into(),
        );
    }
    try_file_in(above).map_err(|cause| {
        let above = above.display();
        format!("the directory {named} for {of} cannot be used: {above} takes no files: {cause}")
            .into()
    })
}

/// Makes a file in a directory and removes it. A file or a link that is there already is left alone.
fn try_file_in(directory: &Path) -> io::Result<()> {
    for number in 0..u8::MAX {
        let probe = directory.join(format!(".rhumb-server-{}-{number}", std::process::id()));
        match File::create_new(&probe) {
            Ok(_) => return std::fs::remove_file(&probe),
            Err(cause) if cause.kind() == io::ErrorKind::AlreadyExists => {}
            Err(cause) => return Err(cause),
        }
    }
    Err(io::ErrorKind::AlreadyExists.into())
}

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

/// The kind of a certificate, for a start-up line.
pub(crate) const fn kind_of(identity: &Identity) -> &'static str {
    match identity {
        Identity::Development => "development, made at start",
        Identity::Files { .. } => "from files",
        Identity::DevelopmentFiles { .. } => "development, kept in the data directory",
    }
}

/// Prints the address and the fingerprint to pin. A closed standard output does not stop a server.
pub(crate) fn announce(server: &Server, identity: &Identity, addresses: &BoundAddresses) {
    let kind = kind_of(identity);
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

/// Prints lines. A closed standard output does not stop a server.
pub(crate) fn write_lines(lines: &str) {
    let mut out = io::stdout().lock();
    if let Err(cause) = out.write_all(lines.as_bytes()).and_then(|()| out.flush()) {
        tracing::warn!("cannot write the start-up lines: {cause}");
    }
}
