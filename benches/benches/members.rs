//! What one more member of a stream costs its server, datagram by datagram
//!
//! A real server over QUIC on loopback says one datagram sixty times a second to each of its members; its bytes are made
//! once and shared. Standard error gets tables, without a delay and over a round trip of 50 ms: what the thread of the host
//! and that of the sockets took for a datagram, and what each took for one more, against the row before. Beside it stands
//! what the least takes that any protocol would have to do there: seal it, send it to who sleeps until it comes, and hear and
//! open an acknowledgement of every second one. Below stands what the system alone takes for a datagram of that size, from
//! one socket to another that nobody sleeps at. Only Linux tells the time of a thread.

use std::collections::VecDeque;
use std::fs;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant as HostInstant};

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_transport::{
    Certificate, ClientOptions, LinkTerms, QuicClient, QuicServer, ServerOptions, Stop, Trust,
    UdpRelay,
};
use ring::aead::{AES_256_GCM, Aad, LessSafeKey, Nonce, UnboundKey};

/// Of the datagram that all members hear: a tick of recorded cubes takes about as many.
const DATAGRAM_BYTES: usize = 200;
const PERIOD: Span = Span::from_nanos(1_000_000_000 / 60);
const MEMBERS: [usize; 4] = [1, 8, 16, 32];
/// What the congestion control needs to find out that a link is good.
const WARM_UP: Duration = Duration::from_millis(1_500);
const MEASURED: Duration = Duration::from_secs(4);
/// Datagrams from one socket to another.
const PLAIN: u32 = 50_000;

/// Of an acknowledgement as QUIC has it.
const ACKNOWLEDGEMENT_BYTES: usize = 36;
/// A round trip to members that are not next door.
const FAR: Span = Span::from_nanos(50_000_000);

/// The names of the server's threads, as the system knows them.
const HOST: &str = "members-host";
const IO: &str = "rhumb-server-io";
/// That of a thread that does the least.
const LEAST: &str = "members-least";

/// Says the same to all of its members.
struct Choir {
    members: Vec<Peer>,
    said: Bytes,
    next: Instant,
    waiting: VecDeque<Peer>,
    sent: Arc<AtomicU64>,
}

impl Endpoint for Choir {
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
        let bytes = self.said.clone();
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

/// What a run took: nanoseconds of both threads, and datagrams.
struct Cost {
    host_ns: u64,
    io_ns: u64,
    datagrams: u64,
}

/// Of so many members, each a round trip away if any is given.
fn measure(members: usize, away: Option<Span>) -> Cost {
    let certificate = Certificate::development(["localhost"]).expect("localhost is a name");
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let server = QuicServer::bind(ServerOptions {
        listen,
        certificate,
    })
    .expect("loopback has a free port");
    let (address, trust) = (
        server.local_addr(),
        Trust::Fingerprint(server.fingerprint()),
    );
    let (stop, sent) = (Stop::new(), Arc::new(AtomicU64::new(0)));
    let mut choir = Choir {
        members: Vec::new(),
        said: Bytes::from(vec![0x5a; DATAGRAM_BYTES]),
        next: Instant::ZERO,
        waiting: VecDeque::new(),
        sent: Arc::clone(&sent),
    };
    let host = thread::Builder::new().name(HOST.into());
    let until = stop.clone();
    let host = host
        .spawn(move || {
            server
                .run(&mut choir, &until)
                .expect("it runs until it is stopped")
        })
        .expect("a thread starts");
    let relay = away.map(|away| {
        let front = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
        UdpRelay::start(front, address, LinkTerms::round_trip(away), 1).expect("a port is free")
    });
    let address = relay.as_ref().map_or(address, UdpRelay::local_addr);
    let connect = |_| {
        let options = ClientOptions::new(address, trust.clone());
        QuicClient::connect(options, Duration::from_secs(5)).expect("the server is there")
    };
    let clients: Vec<QuicClient> = (0..members).map(connect).collect();
    thread::sleep(WARM_UP);
    let now = || (thread_ns(HOST), thread_ns(IO), sent.load(Ordering::Relaxed));
    let before = now();
    thread::sleep(MEASURED);
    let after = now();
    drop(clients);
    stop.stop();
    host.join().expect("the host does not panic");
    Cost {
        host_ns: after.0 - before.0,
        io_ns: after.1 - before.1,
        datagrams: after.2 - before.2,
    }
}

/// How long the thread of a name was on a processor, in nanoseconds.
fn thread_ns(name: &str) -> u64 {
    let tasks = fs::read_dir("/proc/self/task").expect("Linux lists a process' threads");
    let of_name = tasks.flatten().find(|task| {
        fs::read_to_string(task.path().join("comm")).is_ok_and(|comm| comm.trim() == name)
    });
    let task = of_name.expect("the thread runs");
    let times = fs::read_to_string(task.path().join("schedstat")).expect("Linux tells its time");
    let first = times.split_whitespace().next();
    first
        .and_then(|ns| ns.parse().ok())
        .expect("it begins with nanoseconds")
}

/// What the least takes for a datagram, in nanoseconds: it is sealed and sent to who sleeps until it comes, and of every
/// second one an acknowledgement is heard and opened.
fn least_ns(members: usize) -> f64 {
    let here = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("loopback has a free port");
    let to = here.local_addr().expect("it is bound");
    let hear = |_| {
        let there = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("loopback has a free port");
        there.connect(to).expect("it is there");
        let address = there.local_addr().expect("it is bound");
        let thread = thread::spawn(move || {
            let (mut heard, mut count) = ([0; 2 * DATAGRAM_BYTES], 0_u32);
            // A datagram of nothing is the last.
            while there.recv(&mut heard).is_ok_and(|bytes| bytes > 0) {
                count += 1;
                if count.is_multiple_of(2) {
                    drop(there.send(&heard[..ACKNOWLEDGEMENT_BYTES]));
                }
            }
        });
        (address, thread)
    };
    let listeners: Vec<_> = (0..members).map(hear).collect();
    let addresses: Vec<_> = listeners.iter().map(|(address, _)| *address).collect();
    let sender = thread::Builder::new().name(LEAST.into());
    let sender = sender.spawn(move || say_the_least(&here, &addresses));
    let took = sender.expect("a thread starts").join();
    for (_, listener) in listeners {
        listener.join().expect("listening does not panic");
    }
    took.expect("sending does not panic")
}

fn say_the_least(here: &UdpSocket, to: &[SocketAddr]) -> f64 {
    here.set_nonblocking(true).expect("a socket may be so");
    let key = UnboundKey::new(&AES_256_GCM, &[7; 32]).expect("it has so many bytes");
    let (key, period) = (
        LessSafeKey::new(key),
        Duration::from_nanos(PERIOD.as_nanos()),
    );
    let nonce = || Nonce::assume_unique_for_key([1; 12]);
    let (before, began) = (thread_ns(LEAST), HostInstant::now());
    let (mut next, mut said) = (began, 0_u32);
    while began.elapsed() < MEASURED {
        for address in to {
            let mut datagram = Vec::with_capacity(DATAGRAM_BYTES + 16);
            datagram.resize(DATAGRAM_BYTES, 0x5a);
            let sealed = key.seal_in_place_append_tag(nonce(), Aad::empty(), &mut datagram);
            sealed.expect("so many bytes can be sealed");
            drop(here.send_to(&datagram, address));
            said += 1;
        }
        next += period;
        thread::sleep(next.saturating_duration_since(HostInstant::now()));
        let mut heard = [0; 2 * DATAGRAM_BYTES];
        while let Ok((bytes, _)) = here.recv_from(&mut heard) {
            // It is none of this key's, which takes as long to find out.
            drop(key.open_in_place(nonce(), Aad::empty(), &mut heard[..bytes]));
        }
    }
    let took = thread_ns(LEAST) - before;
    for address in to {
        drop(here.send_to(&[], address));
    }
    took as f64 / f64::from(said)
}

/// What the system takes to hand a datagram of this size from one socket to another, in nanoseconds.
fn plain_ns() -> f64 {
    let there = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("loopback has a free port");
    let here = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("loopback has a free port");
    let to = there.local_addr().expect("it is bound");
    here.connect(to).expect("it is there");
    let sender = thread::Builder::new().name("members-plain".into());
    let sender = sender.spawn(move || {
        let said = [0x5a; DATAGRAM_BYTES];
        let before = thread_ns("members-plain");
        for _ in 0..PLAIN {
            // A full buffer there is as good: the datagram has gone all the way.
            drop(here.send(&said));
        }
        thread_ns("members-plain") - before
    });
    let took = sender.expect("a thread starts").join();
    took.expect("sending does not panic") as f64 / f64::from(PLAIN)
}

fn main() {
    if !cfg!(target_os = "linux") {
        eprintln!("only Linux tells the time of a thread");
        return;
    }
    eprintln!("microseconds of a processor for a datagram of {DATAGRAM_BYTES} bytes");
    for (link, away) in [("loopback", None), ("a round trip of 50 ms", Some(FAR))] {
        eprintln!("{link}");
        eprintln!("members    host  sockets     sum  one more   least");
        table(away);
    }
    eprintln!("plain sockets           {:7.2}", plain_ns() / 1e3);
}

/// A row for each number of members.
fn table(away: Option<Span>) {
    let mut before: Option<Cost> = None;
    for members in MEMBERS {
        let (cost, least) = (measure(members, away), least_ns(members) / 1e3);
        let each = |ns: u64| ns as f64 / cost.datagrams as f64 / 1e3;
        let more = before.map_or(String::from("-"), |less| {
            let all = |cost: &Cost| (cost.host_ns + cost.io_ns) as f64;
            let datagrams = (cost.datagrams - less.datagrams) as f64;
            format!("{:.2}", (all(&cost) - all(&less)) / datagrams / 1e3)
        });
        let (host, io) = (each(cost.host_ns), each(cost.io_ns));
        eprintln!(
            "{members:7} {host:7.2} {io:8.2} {:7.2} {more:>9} {least:7.2}",
            host + io
        );
        before = Some(cost);
    }
}
