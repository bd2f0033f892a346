//! Command line of `rhumb-server`, reusable by other binaries.
//!
//! Start-up lines go to standard output, one fact a line, for readers and scripts; the log goes to standard error.

use std::error::Error;
use std::ffi::OsString;
use std::io::Write;
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use clap::builder::NonEmptyStringValueParser;
use clap::{Arg, Command, Parser, Subcommand};
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::CellGrid;
use rhumb_protocol::scene::SceneName;
use rhumb_scene::engine::EngineKind;
use rhumb_scene::{Hooks, ProvidedScenes, SceneSettings};
use rhumb_transport::{IdleLimit, PageOrigin, Stop};
use tracing::level_filters::LevelFilter;

use crate::access::KeyFile;
#[cfg(feature = "demo")]
use crate::demo::{DemoArguments, open_browser};
use crate::directory::{
    DrainArguments, Endpoints, LeaseSeconds, MoveArguments, run_drain, run_move,
};
use crate::dispatcher;
use crate::durable::{self, DataDir, DataError};
use crate::edge::{self, EdgeArguments};
use crate::flight;
use crate::log;
use crate::serve::{Access, Identity, RunError, Server, seconds_since_1970};
use crate::settings::{ServerSettings, WorkerKind};
use crate::signals;
use crate::start::{self, BoundAddresses, CheckedStart, announce};
#[cfg(feature = "demo")]
use crate::start::{announce_opening, page_url};
use crate::token_command::{self, TokenArguments};
#[cfg(feature = "top")]
use crate::top::{self, TopArguments};
#[cfg(feature = "view")]
use crate::view::{PageArguments, ViewScene, write_page};

/// A Rapier server for remote rigid-body physics.
#[derive(Debug, Parser)]
#[command(
    name = "rhumb-server",
    version,
    about,
    args_conflicts_with_subcommands = true
)]
pub struct Arguments {
    #[command(subcommand)]
    task: Option<Task>,
    /// TOML file with settings; `rhumb-server config` prints one with all defaults. Flags and environment replace it.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Checks everything that would keep the server from starting, except addresses in use, and ends: code 0 if it could
    /// start.
    #[arg(long)]
    check_config: bool,
    /// UDP address to listen on; port 0 picks a free one [default: 127.0.0.1:4433].
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// PEM file with the certificate chain; without it a development certificate is made at start.
    #[arg(long, requires = "key")]
    cert: Option<PathBuf>,
    /// PEM file with the certificate's private key.
    #[arg(long, requires = "cert")]
    key: Option<PathBuf>,
    /// File with a public key of tokens, for all scenes, or as FILE=team/*,lobby for these; may be repeated. SIGHUP has the
    /// files read again. `rhumb-server token --new-key FILE` makes keys.
    #[arg(long, value_name = "FILE[=SCENES]", conflicts_with = "open")]
    token_key: Vec<KeyFile>,
    /// Name that a token must give as its audience [default: rhumb].
    #[arg(long, value_parser = NonEmptyStringValueParser::new())]
    audience: Option<String>,
    /// Admits every client of this machine without a token, for development.
    #[arg(long)]
    open: bool,
    /// Lets clients without a token come from other machines too: those of --open, --view, --foxglove,
    /// --metrics and --app-listen.
    #[arg(long)]
    open_to_network: bool,
    /// Path of a Unix socket for clients of this machine, beside the address; only this user can connect.
    #[arg(long, value_name = "PATH")]
    socket: Option<PathBuf>,
    /// TCP address for metrics (/metrics) and health (/health).
    #[arg(long, value_name = "ADDRESS")]
    metrics: Option<SocketAddr>,
    /// Serves a page in which scenes are seen, at this TCP address, or without one at 127.0.0.1:8433. With tokens, the page
    /// observes only.
    #[cfg(feature = "view")]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8433")]
    view: Option<SocketAddr>,
    /// Directory for the flight recorders of scenes that fault; `rhumb-server flight FILE` prints one.
    #[arg(long, value_name = "DIR")]
    flight: Option<PathBuf>,
    /// Directory for MCAP files with the states of every scene.
    #[cfg(feature = "record")]
    #[arg(long, value_name = "DIR")]
    record: Option<PathBuf>,
    /// Shows every scene live to Foxglove's viewers, at this TCP address, or without one at 127.0.0.1:8765. It has no tokens.
    #[cfg(feature = "foxglove")]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    foxglove: Option<SocketAddr>,
    /// Log level: off, error, warn, info, debug or trace [default: info].
    #[arg(long)]
    log: Option<LevelFilter>,
    /// Run on this processor core alone, or on these cores.
    #[arg(long, value_delimiter = ',')]
    core: Vec<usize>,
    /// Physics engine of all scenes: rapier, or one that this program was built with by a feature [default: rapier].
    #[arg(long, value_name = "NAME")]
    engine: Option<EngineKind>,
    /// Number of threads to step and publish on, shared by all scenes; more than one needs the feature `parallel`
    /// [default: 1].
    #[arg(long)]
    threads: Option<NonZeroU32>,
    /// Runs scenes on threads of the server, or in processes, one for each tenant [default: threads].
    #[arg(long, value_name = "KIND")]
    workers: Option<WorkerKind>,
    /// All scenes without a tenant share one worker process.
    #[arg(long)]
    share_worker: bool,
    /// Largest packet of a stream, bytes, from 700 to 1150 [default: 1100]. Relays and browsers add headers of their own.
    #[arg(long, value_name = "BYTES")]
    largest_packet: Option<LargestPacket>,
    /// Divides scenes into cells of this edge along x and z, metres, or of edges X,Y,Z with 0 along an axis that is not divided.
    /// Clients that join by cells then have the bodies of those that they take.
    #[arg(long, value_name = "METRES")]
    cells: Option<CellGrid>,
    /// Directory for command logs and snapshots, from which scenes are restored at start; without it, scenes end with
    /// the process.
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Etcd cluster that says which of several servers has a scene, as http://host:port, with commas between. The servers share
    /// --data.
    #[arg(long, value_name = "ENDPOINTS")]
    directory: Option<String>,
    /// Address that the other servers of a directory tell clients for this one, as host:port [default: that of --listen].
    #[arg(long, value_name = "ADDRESS")]
    advertise: Option<String>,
    /// Time for which the directory holds this server's scenes after its last renewal, in seconds, from 3 to 30 [default: 5].
    #[arg(long, value_name = "SECONDS")]
    lease: Option<LeaseSeconds>,
    /// Reports to Agones, by the sidecar of this pod: the server is ready and well, has these scenes, drains.
    #[arg(long)]
    agones: bool,
    /// Origin of a web page that may connect, as https://host:port, or * for all; may be repeated. Pages of this machine
    /// may always.
    #[arg(long, value_name = "ORIGIN", conflicts_with = "no_web")]
    web_origin: Vec<PageOrigin>,
    /// Serves no browsers.
    #[arg(long)]
    no_web: bool,
    #[cfg(feature = "app")]
    #[command(flatten)]
    app: app::AppArguments,
}

/// Tasks beside serving.
#[derive(Debug, Subcommand)]
enum Task {
    /// Shows a scene in a page, over the real protocol.
    #[cfg(feature = "demo")]
    Demo(DemoArguments),
    /// Serves members of scenes that another server steps: it has one member for each stream, however many watch.
    Edge(EdgeArguments),
    /// Makes a token for a client, or the keys for tokens.
    Token(TokenArguments),
    /// Verifies every scene of a data directory that no server uses: authentic, whole, and replayed to the same bits.
    Check {
        /// The directory.
        dir: PathBuf,
    },
    /// Runs the log of a scene again from the oldest state that is kept.
    Replay {
        /// The directory.
        dir: PathBuf,
        /// The scene.
        scene: SceneName,
    },
    /// Cuts the damaged scenes of a data directory that no server uses back to their last good ticks. Says what is lost, and
    /// asks first. The files before stay beside.
    Repair {
        /// The directory.
        dir: PathBuf,
        /// The scene; all damaged ones if none is named.
        scene: Option<SceneName>,
        /// Agrees beforehand.
        #[arg(long)]
        yes: bool,
    },
    /// Moves a scene from the server that has it to another one of their directory, while it runs.
    Move(MoveArguments),
    /// Moves all scenes of a server to the others of their directory, and has it take no scene any more until it ends.
    Drain(DrainArguments),
    /// Prints the last moments of a scene before a fault, from a file that --flight wrote.
    Flight {
        /// The file.
        file: PathBuf,
    },
    /// Prints a layout for Foxglove's viewers, in which these scenes are drawn: live, and of recordings.
    #[cfg(feature = "record")]
    Layout {
        /// The scenes, by their names.
        #[arg(required = true)]
        scenes: Vec<SceneName>,
    },
    /// Writes a page that plays recordings without a server, for any web host.
    #[cfg(feature = "view")]
    Page(PageArguments),
    /// Runs the scenes of a tenant for the server that starts it.
    #[command(hide = true)]
    Worker {
        /// The tenant, as a list of processes shows it.
        #[arg(value_parser = NonEmptyStringValueParser::new())]
        tenant: String,
    },
    /// Shows a running server's metrics in this terminal: scenes, clients, bytes, times of ticks.
    #[cfg(feature = "top")]
    Top(TopArguments),
    /// Prints a configuration file with every setting at its default, and the reason of each limit.
    Config,
}

/// Time for which a data directory may be in use at a start, and the pause between two attempts.
const IN_USE: Duration = Duration::from_millis(1_000);
const IN_USE_PAUSE: Duration = Duration::from_millis(20);

/// Runs a server until SIGINT or SIGTERM. Exit code 0 after such a stop, 1 when it cannot start or fails, 3 when it
/// does not stop in time.
pub fn main(arguments: Arguments) -> ExitCode {
    main_with(arguments, None)
}

/// As [`main`], with hooks for the scenes that clients create.
pub fn main_with(arguments: Arguments, hooks: Option<Hooks>) -> ExitCode {
    let outcome = match &arguments.task {
        Some(Task::Edge(arguments)) => edge::run(arguments),
        Some(Task::Token(token)) => token_command::run(token, seconds_since_1970()),
        Some(Task::Check { dir }) => durable::check(dir, &mut std::io::stdout()),
        Some(Task::Replay { dir, scene }) => durable::replay(dir, scene, &mut std::io::stdout()),
        Some(Task::Repair { dir, scene, yes }) => durable::repair(
            (dir, scene.as_ref()),
            *yes,
            (&mut std::io::stdin().lock(), &mut std::io::stdout()),
        ),
        Some(Task::Move(order)) => run_move(order, &mut std::io::stdout()),
        Some(Task::Drain(order)) => run_drain(order, &mut std::io::stdout()),
        Some(Task::Flight { file }) => flight::run(file, &mut std::io::stdout()),
        Some(Task::Worker { .. }) => dispatcher::run_worker(hooks, seconds_since_1970),
        #[cfg(feature = "record")]
        Some(Task::Layout { scenes }) => {
            let names: Vec<_> = scenes.iter().map(SceneName::as_str).collect();
            print(&rhumb_trace::scene_layout(&names))
        }
        #[cfg(feature = "top")]
        Some(Task::Top(arguments)) => top::run(arguments),
        #[cfg(feature = "view")]
        Some(Task::Page(page)) => write_page(page, &mut std::io::stdout()).map_err(Into::into),
        Some(Task::Config) => print(&ServerSettings::file()),
        #[cfg(feature = "demo")]
        Some(Task::Demo(demo)) => {
            let settings = demo.settings();
            let _last_lines = log::start(settings.log, settings.limits.log_lines_per_second);
            let parts = Parts {
                provided: Some(demo.provided()),
                scenes: demo.scenes(),
                opens_browser: demo.opens_browser(),
                ..Parts::default()
            };
            print(&demo.left_out()).and_then(|()| run(&settings, parts))
        }
        None => settings_of(&arguments).and_then(|settings| {
            let parts = Parts {
                #[cfg(feature = "app")]
                app: Some(arguments.app.clone()),
                hooks,
                ..Parts::default()
            };
            if arguments.check_config {
                start::check(&settings, parts.app_beyond_loopback())?;
                return print("the configuration is valid\n");
            }
            let _last_lines = log::start(settings.log, settings.limits.log_lines_per_second);
            run(&settings, parts)
        }),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // The cause of a failed start is printed at any log level. If standard error fails too, nothing is left to
            // try.
            let _ = writeln!(std::io::stderr(), "error: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The settings of the file and the environment, and then of the flags.
fn settings_of(arguments: &Arguments) -> Result<ServerSettings, Box<dyn Error>> {
    // A variable that is no text is none of ours.
    let text = |(name, value): (OsString, OsString)| {
        Some((name.into_string().ok()?, value.into_string().ok()?))
    };
    let environment = std::env::vars_os().filter_map(text);
    let mut settings = ServerSettings::read(arguments.config.as_deref(), environment)?;
    set(&mut settings.listen, arguments.listen);
    set(&mut settings.audience, arguments.audience.clone());
    set(&mut settings.log, arguments.log);
    set(&mut settings.engine, arguments.engine);
    set(&mut settings.threads, arguments.threads);
    settings.workers = arguments.workers.or(settings.workers);
    settings.agones |= arguments.agones;
    settings.share_worker |= arguments.share_worker;
    set(&mut settings.largest_packet, arguments.largest_packet);
    settings.cells = arguments.cells.or(settings.cells);
    settings.flight = arguments.flight.clone().or(settings.flight);
    settings.metrics = arguments.metrics.or(settings.metrics);
    settings.socket = arguments.socket.clone().or(settings.socket);
    #[cfg(feature = "view")]
    {
        settings.view = arguments.view.or(settings.view);
    }
    #[cfg(feature = "record")]
    {
        settings.record = arguments.record.clone().or(settings.record);
    }
    #[cfg(feature = "foxglove")]
    {
        settings.foxglove = arguments.foxglove.or(settings.foxglove);
    }
    settings.data = arguments.data.clone().or(settings.data);
    settings.directory = arguments.directory.clone().or(settings.directory);
    settings.advertise = arguments.advertise.clone().or(settings.advertise);
    set(&mut settings.lease, arguments.lease);
    if arguments.cert.is_some() {
        settings.cert = arguments.cert.clone();
        settings.key = arguments.key.clone();
    }
    if !arguments.token_key.is_empty() {
        settings.token_keys = arguments.token_key.clone();
    }
    if !arguments.core.is_empty() {
        settings.cores = arguments.core.clone();
    }
    settings.open |= arguments.open;
    settings.open_to_network |= arguments.open_to_network;
    settings.web &= !arguments.no_web;
    if !arguments.web_origin.is_empty() {
        settings.web_origins = arguments.web_origin.clone();
    }
    Ok(settings)
}

fn set<T>(setting: &mut T, flag: Option<T>) {
    if let Some(value) = flag {
        *setting = value;
    }
}

fn print(text: &str) -> Result<(), Box<dyn Error>> {
    Ok(std::io::stdout().lock().write_all(text.as_bytes())?)
}

/// The parts of a server beside its settings.
#[derive(Default)]
struct Parts {
    /// The flags about APP clients, unless another task than serving is at hand.
    #[cfg(feature = "app")]
    app: Option<app::AppArguments>,
    hooks: Option<Hooks>,
    provided: Option<ProvidedScenes>,
    /// Provided scenes that the page offers.
    #[cfg(feature = "view")]
    scenes: Vec<ViewScene>,
    /// True if the page is opened in the browser of the desktop.
    #[cfg(feature = "demo")]
    opens_browser: bool,
}

impl Parts {
    /// The address for APP clients, if other machines reach it.
    fn app_beyond_loopback(&self) -> Option<SocketAddr> {
        #[cfg(feature = "app")]
        return (self.app.as_ref()).and_then(app::AppArguments::beyond_loopback);
        #[cfg(not(feature = "app"))]
        None
    }
}

fn bind(
    settings: &ServerSettings,
    identity: &Identity,
    access: Access,
) -> Result<Server, RunError> {
    let origins = settings.web_origins.iter().cloned().collect();
    let origins = settings.web.then_some(origins);
    // Clients of one of several servers are to notice soon that it is gone.
    let idle_limit = match settings.directory {
        Some(_) => IdleLimit::Short,
        None => IdleLimit::Usual,
    };
    let mut server = Server::bind_among(settings.listen, identity, access, (origins, idle_limit))?;
    server.set_engine(settings.engine);
    Ok(server)
}

fn run(settings: &ServerSettings, parts: Parts) -> Result<(), Box<dyn Error>> {
    let CheckedStart {
        threads,
        access,
        processes,
        directory,
        agones,
    } = start::check(settings, parts.app_beyond_loopback())?;
    let data = stored(settings, directory.as_ref())?;
    let identity = start::identity(settings, data.as_ref())?;
    let stop = Stop::new();
    let keys = match &access {
        Access::Tokens(keys) => Some(keys.clone()),
        Access::OpenOnLoopback | Access::OpenToNetwork => None,
    };
    let mut server = bind(settings, &identity, access)?;
    server.scenes = SceneSettings {
        threads,
        largest_packet: settings.largest_packet,
        cells: settings.cells,
        limits: settings.limits,
        hooks: parts.hooks,
        provided: parts.provided,
        ..server.scenes
    };
    if let Some(processes) = processes {
        server.use_processes(processes);
    }
    if let Some(data) = data {
        server.store_in(data);
    }
    if let Some(directory) = directory {
        server.share_scenes(directory, (settings.advertise.as_deref(), settings.lease));
    }
    server.report_to(agones);
    listen_at(&mut server, settings.socket.as_deref())?;
    let foxglove = observe(&mut server, settings)?;
    let addresses = BoundAddresses {
        foxglove,
        #[cfg(feature = "app")]
        app: match &parts.app {
            Some(app) => app.listen(&mut server)?,
            None => None,
        },
        #[cfg(not(feature = "app"))]
        app: None,
        metrics: match settings.metrics {
            Some(address) => Some(server.answer_metrics(address)?),
            None => None,
        },
        #[cfg(feature = "view")]
        view: match settings.view {
            Some(address) => Some(server.show_page(address, parts.scenes)?),
            None => None,
        },
        #[cfg(not(feature = "view"))]
        view: None,
    };
    announce(&server, &identity, &addresses);
    #[cfg(feature = "demo")]
    if let Some(page) = addresses.view.map(page_url).filter(|_| parts.opens_browser) {
        announce_opening(&page, open_browser(&page));
    }
    let running = signals::obey(&stop, keys);
    let outcome = server.run(&stop);
    running.store(false, Ordering::Relaxed);
    let statistics = outcome?;
    tracing::info!(connections = statistics.opened, "stopped");
    Ok(())
}

/// The data directory, if there is one. Servers of one `directory` share it. Processes of a server that was killed end a
/// moment later than it, and hold the lock so long.
fn stored(
    settings: &ServerSettings,
    directory: Option<&Endpoints>,
) -> Result<Option<DataDir>, DataError> {
    let Some(path) = &settings.data else {
        return Ok(None);
    };
    let begun = Instant::now();
    loop {
        let opened = match directory {
            None => DataDir::open(path),
            Some(_) => DataDir::open_shared(path),
        };
        match opened {
            Err(DataError::InUse { .. }) if begun.elapsed() < IN_USE => thread::sleep(IN_USE_PAUSE),
            opened => return opened.map(Some),
        }
    }
}

/// Starts flight recorders, recording and live viewing; returns where.
fn observe(
    server: &mut Server,
    settings: &ServerSettings,
) -> Result<Option<SocketAddr>, Box<dyn Error>> {
    if let Some(directory) = &settings.flight {
        server.record_flights(directory.clone());
    }
    #[cfg(feature = "record")]
    if let Some(directory) = &settings.record {
        server.record_scenes(directory.clone());
    }
    #[cfg(feature = "foxglove")]
    if let Some(address) = settings.foxglove {
        let pages = settings.web_origins.iter().cloned().collect();
        return Ok(Some(server.show_in_foxglove(address, pages)?));
    }
    let _ = (server, settings);
    Ok(None)
}

/// Serves clients of this machine at a Unix socket.
#[cfg(unix)]
fn listen_at(server: &mut Server, path: Option<&Path>) -> Result<(), Box<dyn Error>> {
    if let Some(path) = path {
        server.listen_at(path)?;
    }
    Ok(())
}

/// This system has no Unix sockets, and a start that names one was refused.
#[cfg(not(unix))]
fn listen_at(_server: &mut Server, _path: Option<&Path>) -> Result<(), Box<dyn Error>> {
    Ok(())
}

/// Reads the command line of this process. On an error, or for help, it ends the process as Clap does.
///
/// A value may begin with a minus sign and a digit: a number that is too small is refused with its limits, not as a flag that
/// does not exist.
#[must_use]
pub fn parse<P: Parser>() -> P {
    let mut matches = with_negative_numbers(P::command()).get_matches();
    P::from_arg_matches_mut(&mut matches).unwrap_or_else(|error| {
        let mut command = P::command();
        error.format(&mut command).exit()
    })
}

fn with_negative_numbers(command: Command) -> Command {
    let allow = |argument: Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    command
        .mut_args(allow)
        .mut_subcommands(with_negative_numbers)
}

/// Arguments for APP clients.
#[cfg(feature = "app")]
mod app {
    use core::net::SocketAddr;

    use clap::{Args, ValueEnum};
    use rhumb_app::{AppBindError, AppListen, AppOptions, Datagrams, States, TimeAdvanced};

    use crate::serve::Server;

    /// Listener for APP clients, and what they are sent.
    #[derive(Clone, Debug, Args)]
    pub(crate) struct AppArguments {
        /// TCP and UDP address for APP clients, such as OpenSimulator's RemotePhysics plug-in.
        #[arg(long)]
        app_listen: Option<SocketAddr>,
        /// The message by which APP clients learn that a frame is over.
        #[arg(long, value_enum, default_value = "tcp", requires = "app_listen")]
        app_time_advanced: FrameEnd,
        /// Bodies whose state is sent to APP clients in each frame.
        #[arg(long, value_enum, default_value = "changed", requires = "app_listen")]
        app_states: StateSelection,
        /// Datagrams to each APP client in a millisecond; 0 for no limit. The plug-in takes up to 277 every 10 ms.
        #[arg(long, default_value_t = 20, requires = "app_listen")]
        app_datagram_rate: u32,
        /// Pack as many states in a datagram as fit, for measurements: the plug-in reads only the first.
        #[arg(long, requires = "app_listen")]
        app_packed: bool,
    }

    /// The message by which APP clients learn that a frame is over.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
    enum FrameEnd {
        /// On TCP, where the message is not lost.
        Tcp,
        /// By the last datagram.
        Udp,
        /// Not at all: saves the plug-in the cost of its lists.
        Never,
    }

    /// Bodies whose state is sent to APP clients.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
    enum StateSelection {
        /// Every body that can move.
        All,
        /// Every body that is awake.
        Active,
        /// Every body that has moved since its last sent state.
        Changed,
    }

    impl AppArguments {
        /// Listens for APP clients if the arguments say so, and returns the address.
        pub(crate) fn listen(
            &self,
            server: &mut Server,
        ) -> Result<Option<SocketAddr>, AppBindError> {
            let Some(address) = self.app_listen else {
                return Ok(None);
            };
            let listen = AppListen {
                address,
                datagrams_per_ms: (self.app_datagram_rate > 0).then_some(self.app_datagram_rate),
            };
            server.listen_app(listen, self.options()).map(Some)
        }

        /// The address to listen at, if other machines reach it. APP clients have no tokens.
        pub(crate) fn beyond_loopback(&self) -> Option<SocketAddr> {
            self.app_listen
                .filter(|address| !address.ip().is_loopback())
        }

        fn options(&self) -> AppOptions {
            AppOptions {
                time_advanced: match self.app_time_advanced {
                    FrameEnd::Tcp => TimeAdvanced::Tcp,
                    FrameEnd::Udp => TimeAdvanced::Udp,
                    FrameEnd::Never => TimeAdvanced::Never,
                },
                states: match self.app_states {
                    StateSelection::All => States::All,
                    StateSelection::Active => States::Active,
                    StateSelection::Changed => States::Changed,
                },
                datagrams: if self.app_packed {
                    Datagrams::Packed
                } else {
                    Datagrams::Single
                },
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory as _;

    use super::*;

    #[derive(Debug, Parser)]
    struct TriedLine {
        #[command(subcommand)]
        task: TriedTask,
    }

    #[derive(Debug, clap::Subcommand)]
    enum TriedTask {
        Make {
            #[arg(long, value_parser = clap::value_parser!(u32).range(1..=24))]
            hours: u32,
            #[arg(long)]
            bodies: Option<u32>,
            #[arg(long)]
            open: bool,
        },
    }

    #[test]
    fn a_negative_number_is_refused_with_its_value_and_its_limits() {
        let command = || with_negative_numbers(TriedLine::command());
        let refused = |words: &[&str]| {
            let refused = command().try_get_matches_from([&["x", "make"], words].concat());
            refused.expect_err("it is out of range").to_string()
        };
        let hours = refused(&["--hours", "-1"]);
        assert!(
            hours.contains("'-1' for '--hours <HOURS>': -1 is not in 1..=24"),
            "{hours}"
        );
        let bodies = refused(&["--hours", "2", "--bodies", "-1"]);
        assert!(bodies.contains("-1 is not in 0..=4294967295"), "{bodies}");
        let matches = command().try_get_matches_from(["x", "make", "--hours", "2", "--open"]);
        let matches = matches.expect("they are in range");
        let TriedLine {
            task:
                TriedTask::Make {
                    hours,
                    bodies,
                    open,
                },
        } = <TriedLine as clap::FromArgMatches>::from_arg_matches(&matches).expect("all of them");
        assert_eq!((hours, bodies, open), (2, None, true));
    }
}
