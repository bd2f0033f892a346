//! `rhumb-bench cost`: processor time of a stream, stage by stage.
//!
//! Covers publishing of awake bodies beside the engine's step, a tick in which all bodies sleep, decoding, rendering,
//! and one more member of a stream. All but the members run in the calling thread, one after the other. Times are
//! processor times of that thread, so that other programs hardly change them. Each figure is the median of its
//! repeats, beside its target.
//!
//! For the members, a real server sends one datagram sixty times a second to each of them over QUIC on loopback; all share
//! its bytes. Counted are the times of the server-loop thread and the socket thread, per datagram and per additional
//! datagram against fewer members. The lower bound is the work of any protocol: seal the datagram, send it to a blocked
//! receiver, and receive and open an acknowledgement of every second one. Only Linux reports thread times.

use std::collections::VecDeque;
use std::hint::black_box;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::num::{NonZeroU32, NonZeroUsize};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant as HostInstant};
use std::{fs, thread};

use bytes::Bytes;
use clap::Args;
use rhumb_netsim::{LinkConfig, UdpRelay};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_reckoning::{Anchor, Grid, Metres, QuantisedState, Tolerance, Track};
use rhumb_transport::{
    Certificate, ClientOptions, QuicClient, QuicServer, ServerOptions, Stop, Trust,
};
use ring::aead::{AES_256_GCM, Aad, LessSafeKey, Nonce, UnboundKey};
use serde::{Deserialize, Serialize};

use crate::machine::time_of;
use crate::numbers::{self, markdown, number};
use crate::output::{self, Failure, Provenance, ended, write};
use crate::setup::decoding::{DecodeLoad, Lanes, RenderLoad, TICKS, config, impulse_state, track};
use crate::setup::{MEASURED, ObservedRun, PublishCost, SCENARIOS, Scenario, SleepLoad, TIERS};

/// Arguments: bodies, members, repeats, output.
#[derive(Clone, Debug, Args)]
pub struct CostArguments {
    /// Bodies that are published, decoded and rendered.
    #[arg(long, default_value = "10000", value_parser = clap::value_parser!(u32).range(100..=50_000))]
    bodies: u32,
    /// Repeats per measurement; the median counts.
    #[arg(long, default_value = "5")]
    repeats: NonZeroU32,
    /// Numbers of members of a stream over loopback, smallest first.
    #[arg(long, value_delimiter = ',', default_value = "1,8,16,32")]
    members: Vec<NonZeroUsize>,
    /// Seconds of measurement for each number of members.
    #[arg(long, default_value = "4")]
    member_seconds: NonZeroU32,
    /// Skip the measurement of members.
    #[arg(long)]
    no_members: bool,
    /// Folder for cost.json; created if missing.
    #[arg(long, default_value = "results/cost")]
    out: PathBuf,
}

/// Content of `cost.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Costs {
    /// Source of the figures.
    #[serde(flatten)]
    pub provenance: Provenance,
    /// Publishing of awake bodies, as one stream and as four.
    pub publishing: Vec<Publishing>,
    /// Publishing of sleeping bodies, by their number.
    pub sleeping: Vec<Sleeping>,
    /// Decoding and rendering.
    pub decoding: Decoding,
    /// Cost of one more member; empty if not measured or if the system does not report thread times.
    pub members: Vec<Members>,
}

/// Runs the measurements. Exit code 0 if everything was measured and written, 1 otherwise.
pub fn cost(arguments: &CostArguments) -> ExitCode {
    ended(cost_all(arguments))
}

fn cost_all(arguments: &CostArguments) -> Result<(), Failure> {
    output::make_folder(&arguments.out)?;
    let costs = Costs::measure(arguments)?;
    let tables = [
        (
            "publishing, beside the engine's step",
            costs.publishing_rows(),
        ),
        ("a tick in which all sleep", costs.sleeping_rows()),
        ("decoding and rendering", costs.decoding_rows()),
        (
            "a member's datagram, microseconds of a processor",
            costs.member_rows(),
        ),
    ];
    Ok(write(&arguments.out, "cost.json", &costs, &tables)?)
}

impl Costs {
    fn measure(arguments: &CostArguments) -> Result<Self, String> {
        let (bodies, repeats) = (arguments.bodies, arguments.repeats.get());
        let counts = match arguments.no_members || !can_be_measured() {
            true => &[][..],
            false => &arguments.members[..],
        };
        let steps = publishing_steps(repeats) + 2 * counts.len() as u64;
        let bar = output::progress_bar(steps, "cost".to_owned());
        let mut progress = || bar.inc(1);
        let publishing = measure_publishing(bodies, repeats, &mut progress)?;
        let sleepers = [bodies / 100, bodies / 10, bodies];
        let long = Duration::from_secs(u64::from(arguments.member_seconds.get()));
        let costs = Self {
            provenance: Provenance::here(),
            publishing,
            sleeping: sleepers
                .map(|bodies| measure_sleeping(bodies, repeats))
                .to_vec(),
            decoding: measure_decoding(bodies, repeats),
            members: members(counts, long, &mut progress)?,
        };
        bar.finish_and_clear();
        Ok(costs)
    }

    /// Text of a block of the documents; `None` if the block does not exist.
    pub fn block(&self, what: &str) -> Option<String> {
        let rows = match what {
            "command" => {
                return Some(self.provenance.paragraph());
            }
            "publishing" => self.publishing_rows(),
            "sleeping" => self.sleeping_rows(),
            "decoding" => self.decoding_rows(),
            "members" => self.member_rows(),
            _ => return None,
        };
        Some(markdown(&rows))
    }

    fn publishing_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles([
            "scene",
            "awake",
            "streams",
            "step ms",
            "observe ms",
            "publish ms",
            "% of step",
            "aimed at",
            "upd/tick",
            "ns/upd",
        ])];
        for of in &self.publishing {
            let each_ns = of.publish_ms * 1e6 / of.updates_per_tick;
            rows.push(vec![
                of.scene.clone(),
                of.awake.to_string(),
                of.streams.to_string(),
                number(Some(of.step_ms)),
                number(Some(of.observe_ms)),
                number(Some(of.publish_ms)),
                number(Some(100.0 * of.of_step)),
                if of.streams == 1 { "3" } else { "8" }.to_owned(),
                number(Some(of.updates_per_tick)),
                // With few updates, scanning for them takes the time, so a cost per update would mislead.
                number(
                    (of.updates_per_tick >= of.awake as f64 / 100.0 && of.updates_per_tick > 0.0)
                        .then_some(each_ns),
                ),
            ]);
        }
        rows
    }

    fn sleeping_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles(["sleepers", "publish us"])];
        let row = |of: &Sleeping| vec![of.bodies.to_string(), number(Some(of.publish_us))];
        rows.extend(self.sleeping.iter().map(row));
        rows
    }

    fn decoding_rows(&self) -> Vec<Vec<String>> {
        let of = &self.decoding;
        let row = |what: String, found: f64, aim: &str, floor: f64| {
            let [found, floor] = [found, floor].map(|figure| number(Some(figure)));
            vec![what, found, aim.to_owned(), floor]
        };
        let first = "a body's first update, ns".to_owned();
        let view = format!("a view of {} moving bodies, ms", of.bodies);
        vec![
            titles(["what", "found", "aimed at", "least"]),
            row(
                "an update, ns".to_owned(),
                of.update_ns,
                "200",
                of.correcting_ns,
            ),
            row(first, of.first_ns, "200", of.correcting_ns),
            row(view, of.view_ms, "0.3", of.predicting_ms),
        ]
    }

    fn member_rows(&self) -> Vec<Vec<String>> {
        let mut rows = vec![titles([
            "members",
            "rtt ms",
            "host us",
            "sockets us",
            "one more us",
            "aimed at",
            "its least us",
            "least of all us",
        ])];
        for (place, of) in self.members.iter().enumerate() {
            let before = place.checked_sub(1).map(|before| &self.members[before]);
            rows.push(vec![
                of.members.to_string(),
                of.round_trip_ms.to_string(),
                number(Some(of.server_loop_us)),
                number(Some(of.sockets_us)),
                number(of.one_more_us),
                "3".to_owned(),
                number(before.and_then(|before| of.floor_of_one_more_us(before))),
                number(Some(of.floor_us)),
            ]);
        }
        rows
    }
}

fn titles<const N: usize>(titles: [&str; N]) -> Vec<String> {
    titles.map(str::to_owned).to_vec()
}

/// Cost of decoding and rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decoding {
    /// Bodies of the stream.
    pub bodies: u32,
    /// First update of a body, nanoseconds.
    pub first_ns: f64,
    /// Update in mid-run, nanoseconds.
    pub update_ns: f64,
    /// View of all bodies, milliseconds.
    pub view_ms: f64,
    /// Lower bound: prediction and correction of one body alone, nanoseconds.
    pub correcting_ns: f64,
    /// Lower bound: prediction of all bodies alone, milliseconds.
    pub predicting_ms: f64,
}

/// Measures decoding; each figure is the median of `repeats`.
fn measure_decoding(bodies: u32, repeats: u32) -> Decoding {
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let often = repeats * TICKS as u32;
    let lanes =
        |track: &dyn Fn(u32) -> Track| Lanes::of((0..bodies).map(track), config().integrator, grid);
    // Anchors in mid-run lie on the grid; anchors of a snapshot do not.
    let quantised_track = |index| Track {
        anchor: Anchor::Quantised(QuantisedState::of(&impulse_state(index, 0).motion(), &grid)),
        ..track(index)
    };
    let (moving, quantised) = (lanes(&track), lanes(&quantised_track));
    let correcting = median_of(often, || quantised.correct());
    let mut render = RenderLoad::new(bodies);
    Decoding {
        bodies,
        first_ns: update_ns(&DecodeLoad::new(bodies), repeats),
        update_ns: update_ns(&DecodeLoad::in_mid_run(bodies), repeats),
        view_ms: ms(median_of(often, || render.refresh())),
        correcting_ns: correcting.as_nanos() as f64 / f64::from(bodies),
        predicting_ms: ms(median_of(often, || moving.predict())),
    }
}

/// Time to decode an update, nanoseconds.
fn update_ns(load: &DecodeLoad, repeats: u32) -> f64 {
    let once = || {
        let mut subscriber = load.subscriber.clone();
        let (took, ()) = time_of(|| load.decode(&mut subscriber));
        black_box(subscriber);
        took
    };
    let took = median((0..repeats).map(|_| once()));
    took.as_nanos() as f64 / load.updates.max(1) as f64
}

fn median_of(repeats: u32, mut work: impl FnMut()) -> Duration {
    median((0..repeats).map(|_| time_of(&mut work).0))
}

fn ms(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

/// Ticks with all bodies asleep, measured as one block.
const SILENT: u32 = 1_000;

/// Cost of publishing a scene, per tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Publishing {
    /// Scene and stage.
    pub scene: String,
    /// Number of streams, one tier each.
    pub streams: usize,
    /// Bodies awake in the last tick.
    pub awake: usize,
    /// Mean step of the engine, milliseconds.
    pub step_ms: f64,
    /// Mean time to read every body, milliseconds.
    pub observe_ms: f64,
    /// Mean time of selection and encoding for all streams, milliseconds.
    pub publish_ms: f64,
    /// Observing and publishing as a share of the step.
    pub of_step: f64,
    /// Updates per tick over all streams.
    pub updates_per_tick: f64,
}

/// Cost of publishing where nothing moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sleeping {
    /// Bodies of the stream, all asleep.
    pub bodies: u32,
    /// One tick of one stream, microseconds.
    pub publish_us: f64,
}

/// Number of progress calls for `repeats`.
fn publishing_steps(repeats: u32) -> u64 {
    let ticks = SCENARIOS.iter().map(Scenario::steps);
    ticks.sum::<u64>() + SCENARIOS.len() as u64 * TIERS.len() as u64 * u64::from(repeats)
}

/// Measures each scene, as one stream and as four.
///
/// # Errors
///
/// The refusal of the engine or its scene, as text.
fn measure_publishing(
    bodies: u32,
    repeats: u32,
    progress: &mut dyn FnMut(),
) -> Result<Vec<Publishing>, String> {
    let mut all = Vec::new();
    for scenario in &SCENARIOS {
        let run = ObservedRun::record(scenario, bodies, progress)?;
        for tiers in TIERS {
            let measured = (0..repeats).map(|_| {
                let cost = run.publish(tiers);
                progress();
                cost
            });
            let costs: Vec<PublishCost> = measured.collect();
            let ms = |time: Duration| time.as_secs_f64() * 1e3;
            let publish_ms = ms(median(costs.iter().map(|cost| cost.tick)));
            let observe_ms = ms(run.observe);
            let step_ms = ms(run.step);
            // All repeats encode the same updates.
            let updates = costs.first().map_or(0, |cost| cost.updates);
            all.push(Publishing {
                scene: scenario.name.to_owned(),
                streams: tiers.len(),
                awake: run.awake(),
                step_ms,
                publish_ms,
                observe_ms,
                of_step: (observe_ms + publish_ms) / step_ms,
                updates_per_tick: updates as f64 / MEASURED as f64,
            });
        }
    }
    Ok(all)
}

/// Measures a stream of `bodies` sleeping bodies.
fn measure_sleeping(bodies: u32, repeats: u32) -> Sleeping {
    let mut load = SleepLoad::new(bodies);
    let mut silence = || {
        let publish = || {
            for _ in 0..SILENT {
                load.publish();
            }
        };
        time_of(publish).0
    };
    silence();
    let took = median((0..repeats).map(|_| silence()));
    Sleeping {
        bodies,
        publish_us: took.as_secs_f64() * 1e6 / f64::from(SILENT),
    }
}

/// Median of several durations; zero if there are none.
fn median(values: impl Iterator<Item = Duration>) -> Duration {
    let mut all: Vec<u64> = values.map(|value| value.as_nanos() as u64).collect();
    Duration::from_nanos(numbers::of_nanoseconds(&mut all, 50).unwrap_or(0))
}

/// Size of the shared datagram: about that of a tick of recorded cubes.
const DATAGRAM_BYTES: usize = 200;
const PERIOD: Span = Span::from_nanos(1_000_000_000 / 60);
/// Time for congestion control to recognise a good link.
const WARM_UP: Duration = Duration::from_millis(1_500);

/// Size of a QUIC acknowledgement.
const ACKNOWLEDGEMENT_BYTES: usize = 36;
/// Round-trip time to distant members.
const FAR: Span = Span::from_nanos(50_000_000);

/// Names of the server's threads, as the system knows them.
const SERVER_LOOP: &str = "members-host";
const IO: &str = "rhumb-server-io";
/// Name of the thread that measures the lower bound.
const FLOOR: &str = "members-least";

/// An endpoint that sends the same datagram to all members.
struct Broadcaster {
    members: Vec<Peer>,
    datagram: Bytes,
    next: Instant,
    waiting: VecDeque<Peer>,
    sent: Arc<AtomicU64>,
}

impl Endpoint for Broadcaster {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.members.push(peer);
        self.next = self.next.max(now);
    }

    fn handle_control(&mut self, _: Instant, _: Peer, _: &[u8]) {}

    fn handle_datagram(&mut self, _: Instant, _: Peer, _: &[u8]) {}

    fn handle_ended(&mut self, _: Instant, peer: Peer, _: Ending) {
        self.members.retain(|member| *member != peer);
    }

    fn handle_timeout(&mut self, _: Instant) {
        self.next = self.next + PERIOD;
        self.waiting.extend(&self.members);
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        let to = self.waiting.pop_front()?;
        self.sent.fetch_add(1, Ordering::Relaxed);
        let bytes = self.datagram.clone();
        Some(Transmit::State { to, bytes })
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let some = !self.members.is_empty();
        some.then_some(Wake {
            at: self.next,
            reason: WakeReason::Tick,
        })
    }
}

/// Cost of a run: nanoseconds of both threads, and datagrams.
struct MemberCost {
    server_loop_ns: u64,
    io_ns: u64,
    datagrams: u64,
}

impl MemberCost {
    const fn all_ns(&self) -> f64 {
        (self.server_loop_ns + self.io_ns) as f64
    }
}

/// Measures a server with `members` members for `long`; `away` adds a round-trip time.
fn measure(members: usize, away: Option<Span>, long: Duration) -> Result<MemberCost, String> {
    let wrong = |what: &dyn std::fmt::Display| format!("a stream's members: {what}");
    let certificate = Certificate::development(["localhost"]).map_err(|error| wrong(&error))?;
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let options = ServerOptions::new(listen, certificate);
    let server = QuicServer::bind(options).map_err(|error| wrong(&error))?;
    let trust = Trust::Fingerprint(server.fingerprint());
    let address = server.local_addr();
    let (stop, sent) = (Stop::new(), Arc::new(AtomicU64::new(0)));
    let mut broadcaster = Broadcaster {
        members: Vec::new(),
        datagram: Bytes::from(vec![0x5a; DATAGRAM_BYTES]),
        next: Instant::ZERO,
        waiting: VecDeque::new(),
        sent: Arc::clone(&sent),
    };
    let until = stop.clone();
    let server_loop = thread::Builder::new().name(SERVER_LOOP.into());
    let server_loop = server_loop.spawn(move || server.run(&mut broadcaster, &until));
    let server_loop = server_loop.map_err(|error| wrong(&error))?;
    let measured = connect_members(members, address, &trust, away).and_then(|listening| {
        thread::sleep(WARM_UP);
        let now = || {
            Some((
                thread_ns(SERVER_LOOP)?,
                thread_ns(IO)?,
                sent.load(Ordering::Relaxed),
            ))
        };
        let before = now();
        thread::sleep(long);
        let between = before.zip(now());
        drop(listening);
        between.ok_or_else(|| "the system does not report thread times".to_owned())
    });
    stop.stop();
    let ended = server_loop.join();
    let (before, after) = measured.map_err(|error| wrong(&error))?;
    match ended {
        Ok(Ok(_)) => Ok(MemberCost {
            server_loop_ns: after.0 - before.0,
            io_ns: after.1 - before.1,
            datagrams: after.2 - before.2,
        }),
        Ok(Err(error)) => Err(wrong(&error)),
        Err(_) => Err(wrong(&"the server's thread panicked")),
    }
}

/// Connected members, and the relay that delays their packets.
type ConnectedMembers = (Vec<QuicClient>, Option<UdpRelay>);

fn connect_members(
    members: usize,
    server: SocketAddr,
    trust: &Trust,
    away: Option<Span>,
) -> Result<ConnectedMembers, String> {
    let relay = away.map(|away| {
        let front = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        UdpRelay::start(front, server, LinkConfig::round_trip(away), 1)
    });
    let relay = relay.transpose().map_err(|error| error.to_string())?;
    let address = relay.as_ref().map_or(server, UdpRelay::local_addr);
    let connect = |_| {
        let options = ClientOptions::new(address, trust.clone());
        QuicClient::connect(options, Duration::from_secs(5)).map_err(|error| error.to_string())
    };
    let clients: Result<_, _> = (0..members).map(connect).collect();
    Ok((clients?, relay))
}

/// Processor time of the thread with this name, nanoseconds; `None` where the system does not report it.
fn thread_ns(name: &str) -> Option<u64> {
    let tasks = fs::read_dir("/proc/self/task").ok()?;
    let of_name = tasks.flatten().find(|task| {
        fs::read_to_string(task.path().join("comm")).is_ok_and(|comm| comm.trim() == name)
    });
    let times = fs::read_to_string(of_name?.path().join("schedstat")).ok()?;
    times.split_whitespace().next()?.parse().ok()
}

/// True if the system reports thread times.
fn can_be_measured() -> bool {
    let probe = thread::Builder::new().name(FLOOR.into());
    let probe = probe.spawn(|| thread_ns(FLOOR));
    probe
        .ok()
        .and_then(|thread| thread.join().ok())
        .flatten()
        .is_some()
}

/// Lower bound per datagram, nanoseconds: seal it, send it to a blocked receiver, and receive and open an
/// acknowledgement of every second one.
fn floor_ns(members: usize, long: Duration) -> std::io::Result<f64> {
    let here = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let to = here.local_addr()?;
    let mut listeners = Vec::new();
    for _ in 0..members {
        let there = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        there.connect(to)?;
        let address = there.local_addr()?;
        let thread = thread::spawn(move || {
            let (mut received, mut count) = ([0; 2 * DATAGRAM_BYTES], 0_u32);
            // An empty datagram ends the thread.
            while there.recv(&mut received).is_ok_and(|bytes| bytes > 0) {
                count += 1;
                if count.is_multiple_of(2) {
                    drop(there.send(&received[..ACKNOWLEDGEMENT_BYTES]));
                }
            }
        });
        listeners.push((address, thread));
    }
    let addresses: Vec<_> = listeners.iter().map(|(address, _)| *address).collect();
    let sender = thread::Builder::new().name(FLOOR.into());
    let took = sender
        .spawn(move || send_floor(&here, &addresses, long))?
        .join();
    for (_, listener) in listeners {
        listener
            .join()
            .map_err(|_| std::io::Error::other("a listener panicked"))?;
    }
    took.map_err(|_| std::io::Error::other("the sender panicked"))?
}

fn send_floor(here: &UdpSocket, to: &[SocketAddr], long: Duration) -> std::io::Result<f64> {
    here.set_nonblocking(true)?;
    let thread_time = || thread_ns(FLOOR).ok_or(std::io::ErrorKind::Unsupported);
    let key = UnboundKey::new(&AES_256_GCM, &[7; 32]).expect("the key has the right length");
    let (key, period) = (
        LessSafeKey::new(key),
        Duration::from_nanos(PERIOD.as_nanos()),
    );
    let nonce = || Nonce::assume_unique_for_key([1; 12]);
    let (before, began) = (thread_time()?, HostInstant::now());
    let (mut next, mut sent) = (began, 0_u32);
    while began.elapsed() < long {
        for address in to {
            let mut datagram = Vec::with_capacity(DATAGRAM_BYTES + 16);
            datagram.resize(DATAGRAM_BYTES, 0x5a);
            let sealed = key.seal_in_place_append_tag(nonce(), Aad::empty(), &mut datagram);
            sealed.expect("the datagram is short enough to seal");
            drop(here.send_to(&datagram, address));
            sent += 1;
        }
        next += period;
        thread::sleep(next.saturating_duration_since(HostInstant::now()));
        let mut received = [0; 2 * DATAGRAM_BYTES];
        while let Ok((bytes, _)) = here.recv_from(&mut received) {
            // Authentication fails, which takes as long as success.
            drop(key.open_in_place(nonce(), Aad::empty(), &mut received[..bytes]));
        }
    }
    let took = thread_time()? - before;
    for address in to {
        drop(here.send_to(&[], address));
    }
    Ok(took as f64 / f64::from(sent.max(1)))
}

/// Cost of a datagram per member; microseconds of processor time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Members {
    /// Number of members.
    pub members: usize,
    /// Round-trip time to the members, milliseconds.
    pub round_trip_ms: f64,
    /// Server-loop thread, per datagram.
    pub server_loop_us: f64,
    /// Socket thread, per datagram: QUIC and the system.
    pub sockets_us: f64,
    /// Both threads, per additional datagram against the next smaller count; `None` for the smallest.
    pub one_more_us: Option<f64>,
    /// Lower bound for any protocol, per datagram on average.
    pub floor_us: f64,
}

impl Members {
    /// Lower bound per additional datagram against a smaller count; `None` if it is not smaller or its round trip
    /// differs.
    fn floor_of_one_more_us(&self, fewer: &Self) -> Option<f64> {
        let more = self.members.checked_sub(fewer.members)?;
        let alike = more > 0 && self.round_trip_ms == fewer.round_trip_ms;
        let all = |of: &Self| of.members as f64 * of.floor_us;
        alike.then(|| (all(self) - all(fewer)) / more as f64)
    }
}

/// Measures each count, smallest first, nearby and at a distance.
///
/// # Errors
///
/// The refusal of the system, as text.
fn members(
    counts: &[NonZeroUsize],
    long: Duration,
    progress: &mut dyn FnMut(),
) -> Result<Vec<Members>, String> {
    let mut all = Vec::new();
    for away in [None, Some(FAR)] {
        let mut before: Option<MemberCost> = None;
        for count in counts {
            let cost = measure(count.get(), away, long)?;
            let floor_ns = floor_ns(count.get(), long).map_err(|error| error.to_string())?;
            progress();
            let each = |ns: u64| ns as f64 / cost.datagrams.max(1) as f64 / 1e3;
            let more = before.filter(|less| less.datagrams < cost.datagrams);
            all.push(Members {
                members: count.get(),
                round_trip_ms: away.map_or(0.0, |away| away.as_nanos() as f64 / 1e6),
                server_loop_us: each(cost.server_loop_ns),
                sockets_us: each(cost.io_ns),
                one_more_us: more.map(|less| {
                    let datagrams = (cost.datagrams - less.datagrams) as f64;
                    (cost.all_ns() - less.all_ns()) / datagrams / 1e3
                }),
                floor_us: floor_ns / 1e3,
            });
            before = Some(cost);
        }
    }
    Ok(all)
}
