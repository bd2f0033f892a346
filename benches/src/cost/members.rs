//! Measures the server's cost of one more member, per datagram.
//!
//! A real server sends one datagram sixty times a second to each member over QUIC on loopback; all share its bytes.
//! Counted are the times of the server-loop thread and the socket thread, per datagram and per additional datagram
//! against fewer members. The lower bound is the work of any protocol: seal the datagram, send it to a blocked
//! receiver, and receive and open an acknowledgement of every second one. Only Linux reports thread times.

use std::collections::VecDeque;
use std::fs;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant as HostInstant};

use bytes::Bytes;
use rhumb_netsim::{LinkConfig, UdpRelay};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_transport::{
    Certificate, ClientOptions, QuicClient, QuicServer, ServerOptions, Stop, Trust,
};
use ring::aead::{AES_256_GCM, Aad, LessSafeKey, Nonce, UnboundKey};
use serde::{Deserialize, Serialize};

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
pub(super) fn can_be_measured() -> bool {
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
    pub(super) fn floor_of_one_more_us(&self, fewer: &Self) -> Option<f64> {
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
pub(super) fn members(
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
