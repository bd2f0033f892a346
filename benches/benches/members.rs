//! What one more member of a stream costs its server, datagram by datagram
//!
//! A real server over QUIC on loopback says one datagram sixty times a second to each of its members; its bytes are made
//! once and shared. Standard error gets a table: what the thread of the host and that of the sockets took for a datagram,
//! and what each took for one more, against the row before. Below it stands what the system alone takes for a datagram of
//! that size, from one socket to another. Only Linux tells the time of a thread.

use std::collections::VecDeque;
use std::fs;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;

use bytes::Bytes;
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit, Wake, WakeReason};
use rhumb_transport::{
    Certificate, ClientOptions, QuicClient, QuicServer, ServerOptions, Stop, Trust,
};

/// Of the datagram that all members hear: a tick of recorded cubes takes about as many.
const DATAGRAM_BYTES: usize = 200;
const PERIOD: Span = Span::from_nanos(1_000_000_000 / 60);
const MEMBERS: [usize; 4] = [1, 8, 16, 32];
/// What the congestion control needs to find out that a link is good.
const WARM_UP: Duration = Duration::from_millis(1_500);
const MEASURED: Duration = Duration::from_secs(4);
/// Datagrams from one socket to another.
const PLAIN: u32 = 50_000;

/// The names of the server's threads, as the system knows them.
const HOST: &str = "members-host";
const IO: &str = "rhumb-server-io";

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

fn measure(members: usize) -> Cost {
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
    eprintln!("members    host  sockets     sum  one more");
    let mut before: Option<Cost> = None;
    for members in MEMBERS {
        let cost = measure(members);
        let each = |ns: u64| ns as f64 / cost.datagrams as f64 / 1e3;
        let more = before.map_or(String::from("-"), |less| {
            let all = |cost: &Cost| (cost.host_ns + cost.io_ns) as f64;
            let datagrams = (cost.datagrams - less.datagrams) as f64;
            format!("{:.2}", (all(&cost) - all(&less)) / datagrams / 1e3)
        });
        let (host, io) = (each(cost.host_ns), each(cost.io_ns));
        eprintln!(
            "{members:7} {host:7.2} {io:8.2} {:7.2} {more:>9}",
            host + io
        );
        before = Some(cost);
    }
    eprintln!("plain sockets           {:7.2}", plain_ns() / 1e3);
}
