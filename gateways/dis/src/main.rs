//! The `rhumb-dis` binary: a member of a scene that speaks DIS over UDP.

use std::io::{self, Write};
use std::net::{Ipv4Addr, SocketAddrV4};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use clap::{Parser, ValueEnum};
use rhumb_client::scene::{SceneConfig, Shape, Stepping};
use rhumb_client::{
    Client, JoinMode, JoinOptions, Metres, Refusals, StreamChoice, Tolerance, Trust,
};
use rhumb_dis::entity::{EntityType, Marking};
use rhumb_dis::foreign::ForeignConfig;
use rhumb_dis::gateway::{Gateway, GatewayConfig, Report};
use rhumb_dis::geodesy::{Geodetic, SceneAxes, TangentFrame};
use rhumb_dis::pdu::{ENTITY_STATE_BYTES, TimeBase};
use rhumb_dis::published::{Kind, PublisherConfig};
use rhumb_dis::rules::{Rules, shape};
use rhumb_dis::socket::{DisSocket, PortUse, SocketOptions, StampClock};

/// A scene's bodies as DIS entities, and the entities of others as its bodies.
#[derive(Debug, Parser)]
#[command(name = "rhumb-dis", version)]
struct Arguments {
    /// The scene's server: HOST:PORT, or unix:PATH for one of this machine.
    #[arg(value_name = "SERVER")]
    server: String,
    /// The scene, which must exist unless --create is given.
    #[arg(long, value_name = "NAME")]
    scene: String,
    /// Create the scene unless it exists: free running, with the earth's gravity.
    #[arg(long)]
    create: bool,
    /// Fingerprint of the server's certificate, which the server prints when it starts.
    #[arg(long, value_name = "HEX", conflicts_with = "roots")]
    fingerprint: Option<String>,
    /// PEM file of roots that sign the server's certificate.
    #[arg(long, value_name = "FILE")]
    roots: Option<PathBuf>,
    /// File with the token that the server asks for.
    #[arg(long, value_name = "FILE")]
    token: Option<PathBuf>,
    /// Tolerance of the scene's stream, metres for the centre and radians for the turn: thresholds are to the truth, and
    /// must be above it. A length alone bounds all points of a body, which leaves a small one more turn.
    #[arg(long, value_name = "METRES[:RADIANS]", default_value = "0.05:0.0175")]
    tolerance: Tolerance,

    /// The scene's origin on the earth: latitude and longitude in degrees, metres above the ellipsoid.
    #[arg(long, value_name = "LAT,LON,HEIGHT", value_parser = place, allow_hyphen_values = true)]
    origin: Geodetic,
    /// The scene's axes on the ground.
    #[arg(long, value_enum, default_value = "y-up")]
    axes: Axes,
    /// Number of the exercise; PDUs of others are ignored.
    #[arg(long, default_value_t = 1)]
    exercise: u8,
    /// Site of the gateway's entities.
    #[arg(long, default_value_t = 1)]
    site: u16,
    /// Application of the gateway's entities; each program of a site needs its own.
    #[arg(long, default_value_t = 1)]
    application: u16,

    /// Target of datagrams: a host, a broadcast address, or a group, with its port; may be repeated.
    #[arg(long, value_name = "IP:PORT", default_value = "255.255.255.255:3000")]
    send: Vec<SocketAddrV4>,
    /// Own address; port 3000 is that of DIS.
    #[arg(long, value_name = "IP:PORT", default_value = "0.0.0.0:3000")]
    listen: SocketAddrV4,
    /// A multicast group to hear, beside those of --send; may be repeated.
    #[arg(long, value_name = "IP")]
    join: Vec<Ipv4Addr>,
    /// Address of the network interface for groups.
    #[arg(long, value_name = "IP", default_value = "0.0.0.0")]
    interface: Ipv4Addr,
    /// Routers that datagrams to a group may pass, plus one.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(0..=255))]
    hops: u32,
    /// Let other programs of this machine hear the port too; they need the same option.
    #[arg(long)]
    share_port: bool,
    /// Direction of the translation.
    #[arg(long, value_enum, default_value = "both")]
    direction: Direction,

    /// File of rules: which body is what, with which thresholds, and which entity has what shape.
    #[arg(long, value_name = "FILE")]
    rules: Option<PathBuf>,
    /// Type of bodies without a rule: kind.domain.country.category.subcategory.specific.extra.
    #[arg(long, value_name = "TYPE", default_value = "1.1")]
    entity_type: EntityType,
    /// Marking of bodies without a rule, at most 11 ASCII characters.
    #[arg(long, value_name = "TEXT", default_value = "RHUMB", value_parser = marking)]
    marking: Marking,
    /// Most distance of a body from its dead reckoning, metres.
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = positive)]
    threshold: f64,
    /// Most turn of a body from its dead reckoning, degrees.
    #[arg(long, value_name = "DEGREES", default_value_t = 3.0, value_parser = positive)]
    turn: f64,
    /// Seconds between two states of a body that moves.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = positive)]
    heartbeat: f64,
    /// Seconds between two states of a body that rests.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0, value_parser = positive)]
    stationary: f64,
    /// Shape of entities without a rule: ball:R, cuboid:X,Y,Z, capsule:H,R or cylinder:H,R.
    #[arg(long, value_name = "SHAPE", default_value = "ball:0.5", value_parser = shape)]
    entity_shape: Shape,
    /// Tolerance of the bodies of entities to their dead reckoning, metres.
    #[arg(long, value_name = "METRES", default_value_t = 0.02)]
    entity_tolerance: f64,
    /// Seconds of silence after which an entity is gone: 2.4 heartbeats by the standard.
    #[arg(long, value_name = "SECONDS", default_value_t = 12.0, value_parser = positive)]
    timeout: f64,
    /// Entities further than this from the origin have no body, metres.
    #[arg(long, value_name = "METRES", default_value_t = 20_000.0, value_parser = positive)]
    reach: f64,

    /// Most bodies of entities; a member has authority over 256.
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = clap::value_parser!(u16).range(1..=256))]
    entities: u16,
    /// Most states a second to send; the largest errors first.
    #[arg(long, value_name = "N", default_value_t = 2_000, value_parser = clap::value_parser!(u32).range(1..))]
    states_per_second: u32,
    /// Most PDUs a second to take in; those beyond are dropped.
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..))]
    pdus_per_second: u32,
    /// Most bytes of a datagram; 144 sends each state alone.
    #[arg(long, value_name = "N", default_value_t = 1_440, value_parser = clap::value_parser!(u16).range(ENTITY_STATE_BYTES as i64..=65_507))]
    datagram_bytes: u16,
    /// Origin of timestamps: absolute needs clocks that agree.
    #[arg(long, value_enum, default_value = "absolute")]
    timestamps: Timestamps,
    /// Seconds between two lines about the traffic; 0 for none.
    #[arg(long, value_name = "SECONDS", default_value_t = 10)]
    report: u64,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Axes {
    /// x east, y up, z south.
    YUp,
    /// x east, y north, z up.
    ZUp,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Direction {
    /// Both ways.
    Both,
    /// Bodies become entities.
    Out,
    /// Entities become bodies.
    In,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Timestamps {
    /// From the last full hour of UTC.
    Absolute,
    /// From a moment that only the sender knows.
    Relative,
}

fn place(text: &str) -> Result<Geodetic, String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse()).collect();
    match numbers.as_deref() {
        Ok(&[latitude, longitude, height]) => {
            Geodetic::from_degrees(latitude, longitude, height).map_err(|error| error.to_string())
        }
        _ => Err("must be three numbers, latitude,longitude,height".to_owned()),
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok();
    let number = number.filter(|number| *number > 0.0 && *number <= 1e6);
    number.ok_or_else(|| "must be a number above 0 and at most 1000000".to_owned())
}

fn marking(text: &str) -> Result<Marking, String> {
    let fits = text.len() <= 11 && text.is_ascii();
    fits.then(|| Marking::ascii(text))
        .ok_or_else(|| "must be at most 11 ASCII characters".to_owned())
}

impl Arguments {
    fn frame(&self) -> (TangentFrame, SceneAxes) {
        let axes = match self.axes {
            Axes::YUp => SceneAxes::YUp,
            Axes::ZUp => SceneAxes::ZUp,
        };
        (TangentFrame::new(self.origin, axes), axes)
    }

    fn rules(&self) -> Result<Rules, String> {
        let kind = Kind {
            entity_type: self.entity_type,
            force: 0,
            marking: self.marking,
            metres: self.threshold,
            radians: self.turn.to_radians(),
            heartbeat: Duration::from_secs_f64(self.heartbeat),
            stationary: Duration::from_secs_f64(self.stationary),
        };
        let mut rules = Rules::new(kind, self.entity_shape.clone());
        if let Some(path) = &self.rules {
            let name = path.display();
            let text = std::fs::read_to_string(path).map_err(|cause| format!("{name}: {cause}"))?;
            rules
                .add(&text)
                .map_err(|error| format!("{name}: {error}"))?;
        }
        let [metres, radians] = rules.least_thresholds();
        let [position, turn] = match self.tolerance {
            Tolerance::Surface(length) => [length.metres().metres(), 0.0],
            Tolerance::Parts { position, turn } => {
                [position.metres().metres(), turn.radians().radians()]
            }
        };
        let refused = |threshold, off| {
            Err(format!(
                "a threshold of {threshold} is not above the {off} by which the scene's stream may be off: lower --tolerance"
            ))
        };
        if metres <= position {
            return refused(format!("{metres} m"), format!("{position} m"));
        }
        if radians <= turn {
            let degrees = radians.to_degrees();
            return refused(
                format!("{degrees:.3} degrees, {radians:.4} rad,"),
                format!("{turn} rad"),
            );
        }
        Ok(rules)
    }

    fn config(&self) -> Result<GatewayConfig, String> {
        let (frame, axes) = self.frame();
        let (exercise, site, application) = (self.exercise, self.site, self.application);
        let publisher = PublisherConfig {
            exercise,
            site,
            application,
            frame,
            axes,
            base: match self.timestamps {
                Timestamps::Absolute => TimeBase::Absolute,
                Timestamps::Relative => TimeBase::Relative,
            },
            datagram_bytes: usize::from(self.datagram_bytes),
            states_per_second: self.states_per_second,
        };
        let foreign = ForeignConfig {
            exercise,
            site,
            application,
            frame,
            axes,
            timeout: Duration::from_secs_f64(self.timeout),
            entities_max: usize::from(self.entities),
            reach: self.reach,
            pdus_per_second: self.pdus_per_second,
        };
        Ok(GatewayConfig {
            publisher: (self.direction != Direction::In).then_some(publisher),
            foreign: (self.direction != Direction::Out).then_some(foreign),
            rules: self.rules()?,
            tolerance: tolerance("--entity-tolerance", self.entity_tolerance)?,
        })
    }

    fn socket(&self) -> SocketOptions {
        SocketOptions {
            listen: self.listen,
            targets: match self.direction {
                Direction::In => Vec::new(),
                _ => self.send.clone(),
            },
            groups: self.join.clone(),
            interface: self.interface,
            hops: self.hops,
            port: match self.share_port {
                true => PortUse::Shared,
                false => PortUse::Own,
            },
        }
    }

    fn join(&self) -> Result<Client, String> {
        let trust = match (&self.fingerprint, &self.roots) {
            (Some(text), _) => Trust::Fingerprint(
                text.parse()
                    .map_err(|error| format!("--fingerprint: {error}"))?,
            ),
            (None, Some(roots)) => Trust::Roots(roots.clone()),
            // A Unix socket asks for no trust.
            (None, None) if self.server.starts_with("unix:") => Trust::Roots(PathBuf::new()),
            (None, None) => {
                return Err("a server over the network needs --fingerprint or --roots".to_owned());
            }
        };
        let options = JoinOptions {
            mode: if self.create {
                JoinMode::CreateOrJoin(self.scene_config())
            } else {
                JoinMode::Join
            },
            stream: StreamChoice::Within(self.tolerance),
            smooth: false,
            refusals: Refusals::Events,
            ..JoinOptions::default()
        };
        let text = |error: &dyn std::fmt::Display| format!("{}: {error}", self.server);
        let mut connection = Client::connect(&self.server, trust).map_err(|error| text(&error))?;
        if let Some(path) = &self.token {
            let token = std::fs::read_to_string(path);
            let token = token.map_err(|cause| format!("{}: {cause}", path.display()))?;
            connection = connection.token(token.trim());
        }
        let joined = connection.join_with(&self.scene, options);
        joined.map_err(|error| text(&error))
    }

    fn scene_config(&self) -> SceneConfig {
        let default = SceneConfig::default();
        let strength = default.gravity.length();
        SceneConfig {
            stepping: Stepping::FreeRunning,
            gravity: match self.axes {
                Axes::YUp => default.gravity,
                Axes::ZUp => glam::Vec3::NEG_Z * strength,
            },
            ..default
        }
    }
}

fn tolerance(flag: &str, metres: f64) -> Result<Tolerance, String> {
    Tolerance::from_metres(Metres::new(metres)).map_err(|error| format!("{flag}: {error}"))
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("error: {error}"));
            ExitCode::FAILURE
        }
    }
}

/// Writes a line to standard error.
fn say(line: &str) {
    // If standard error is closed, no other place is left to report to.
    let _ = writeln!(io::stderr(), "{line}");
}

fn run(arguments: &Arguments) -> Result<(), String> {
    let config = arguments.config()?;
    let socket = DisSocket::open(&arguments.socket()).map_err(|error| error.to_string())?;
    let client = arguments.join()?;
    let stopped = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stopped);
    ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed))
        .map_err(|error| format!("signals: {error}"))?;
    let rate = client.config().integrator.rate;
    let period = Duration::from_secs_f64(rate.step().seconds());
    say(&format!(
        "scene {} by {}, exercise {}, entities {}.{}, udp {}",
        arguments.scene,
        arguments.server,
        arguments.exercise,
        arguments.site,
        arguments.application,
        arguments.listen
    ));
    let mut clock = StampClock::start();
    let mut run = Run {
        gateway: Gateway::new(client, config),
        report: Report::new(arguments.report, clock.now()),
        buffer: vec![0; 65_536],
        socket,
        period,
    };
    let served = run.serve(&mut clock, &stopped);
    // Other simulators hear of any end, and the scene is left as it was.
    let mut problems: Vec<String> = served.err().into_iter().collect();
    problems.extend(run.leave(&mut clock));
    if problems.is_empty() {
        return Ok(());
    }
    Err(problems.join("; "))
}

/// A gateway with its socket.
struct Run {
    gateway: Gateway,
    socket: DisSocket,
    report: Report,
    buffer: Vec<u8>,
    /// Of a tick of the scene.
    period: Duration,
}

/// Longest time for last states that wait for the rate limit.
const LEAVE_MAX: Duration = Duration::from_secs(2);

impl Run {
    /// Carries both ways until it is stopped.
    fn serve(&mut self, clock: &mut StampClock, stopped: &AtomicBool) -> Result<(), String> {
        let mut next = clock.now();
        while !stopped.load(Ordering::Relaxed) {
            let handled = self.gateway.handle_time(clock.now());
            handled.map_err(|error| error.to_string())?;
            self.send_all();
            next = (next + self.period).max(clock.now());
            loop {
                let left = next.saturating_sub(clock.now());
                let received = self.socket.receive(&mut self.buffer, left);
                if let Some(bytes) = received.map_err(|cause| format!("receiving: {cause}"))? {
                    self.report.received(bytes);
                    let datagram = &self.buffer[..bytes];
                    let handled = self.gateway.handle_datagram(clock.now(), datagram);
                    if let Err(malformed) = handled {
                        self.report.malformed(&malformed);
                    }
                }
                if clock.now() >= next {
                    break;
                }
            }
            if let Some(line) = self.report.line(clock.now(), &self.gateway.statistics()) {
                say(&line);
            }
        }
        Ok(())
    }

    /// Sends the last states, within two seconds, and removes the bodies of entities; returns what could not be done.
    fn leave(&mut self, clock: &mut StampClock) -> Vec<String> {
        let begun = clock.now();
        let mut problems = Vec::new();
        loop {
            let left = self.gateway.leave(clock.now());
            self.send_all();
            let mut is_over = clock.now().saturating_sub(begun) >= LEAVE_MAX;
            let waiting = match left {
                Ok(0) => return problems,
                Ok(waiting) => waiting,
                // If the server is gone, no body of it can be removed, and last states leave all the same.
                Err(error) => {
                    problems.push(error.to_string());
                    if is_over {
                        return problems;
                    }
                    continue;
                }
            };
            // Datagrams that still arrive are dropped.
            if let Err(cause) = self.socket.receive(&mut self.buffer, self.period) {
                problems.push(format!("receiving: {cause}"));
                is_over = true;
            }
            if is_over {
                problems.push(format!(
                    "{waiting} bodies left without a last state: --states-per-second is too low for them"
                ));
                return problems;
            }
        }
    }

    fn send_all(&mut self) {
        while let Some(bytes) = self.gateway.poll_datagram(&mut self.buffer) {
            let sent = self.socket.send(&self.buffer[..bytes]);
            self.report.sent(bytes, sent);
        }
    }
}
