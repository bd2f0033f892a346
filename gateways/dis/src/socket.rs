//! A gateway's UDP socket, and the clock of its timestamps.
//!
//! Unicast, broadcast and multicast over IPv4 alone: DIS is broadcast, which IPv6 does not have.

use std::fmt;
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};
use std::time::{Duration, Instant, SystemTime};

use socket2::{Domain, Protocol, Socket, Type};

/// The address to listen on, and the targets of datagrams.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SocketOptions {
    /// Own address; port 3000 is that of DIS.
    pub listen: SocketAddrV4,
    /// Targets of datagrams: hosts, broadcast addresses, groups. The groups are joined too.
    pub targets: Vec<SocketAddrV4>,
    /// Further groups to hear.
    pub groups: Vec<Ipv4Addr>,
    /// Address of the network interface of the groups; the system's choice if unspecified.
    pub interface: Ipv4Addr,
    /// Hops that datagrams to a group may take.
    pub hops: u32,
    /// Other programs of this machine may hear the port too, or not.
    pub port: PortUse,
}

/// The programs that may listen on the port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PortUse {
    /// This program alone. A second one is refused.
    Own,
    /// All programs that share it. Broadcasts and groups reach all of them, unicast one.
    Shared,
}

/// The reason why there is no socket.
#[derive(Debug)]
pub enum SocketError {
    /// The system has none, or no room for its own address.
    Bind {
        /// The address.
        listen: SocketAddrV4,
        /// The system's reason.
        cause: io::Error,
    },
    /// The group cannot be joined by this interface.
    Join {
        /// The group.
        group: Ipv4Addr,
        /// Its address.
        interface: Ipv4Addr,
        /// The system's reason.
        cause: io::Error,
    },
    /// An address that is no group.
    NoGroup(Ipv4Addr),
}

impl fmt::Display for SocketError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bind { listen, cause } => {
                write!(f, "udp port {listen}: {cause}")?;
                if cause.kind() == io::ErrorKind::AddrInUse {
                    f.write_str("; another program has it: --share-port on both, or --listen with another port")?;
                }
                Ok(())
            }
            Self::Join {
                group,
                interface,
                cause,
            } => write!(
                f,
                "group {group} by interface {interface}: {cause}; --interface takes the address of one that has multicast"
            ),
            Self::NoGroup(address) => {
                write!(
                    f,
                    "{address} is no group: groups are 224.0.0.0 to 239.255.255.255"
                )
            }
        }
    }
}

impl std::error::Error for SocketError {}

/// Datagrams of a gateway.
#[derive(Debug)]
pub struct DisSocket {
    socket: UdpSocket,
    targets: Vec<SocketAddrV4>,
}

impl DisSocket {
    /// Opens the socket, and joins the groups.
    ///
    /// # Errors
    ///
    /// [`SocketError`] with its address.
    pub fn open(options: &SocketOptions) -> Result<Self, SocketError> {
        let listen = options.listen;
        let bound = bind(options).map_err(|cause| SocketError::Bind { listen, cause })?;
        let of_targets = options.targets.iter().map(|target| *target.ip());
        let mut groups: Vec<_> = of_targets.filter(Ipv4Addr::is_multicast).collect();
        for group in &options.groups {
            if !group.is_multicast() {
                return Err(SocketError::NoGroup(*group));
            }
            groups.push(*group);
        }
        groups.sort_unstable();
        groups.dedup();
        let interface = options.interface;
        for group in groups {
            bound
                .join_multicast_v4(&group, &interface)
                .map_err(|cause| SocketError::Join {
                    group,
                    interface,
                    cause,
                })?;
        }
        Ok(Self {
            socket: bound.into(),
            targets: options.targets.clone(),
        })
    }

    /// Own address, with the port that the system gave.
    ///
    /// # Errors
    ///
    /// The system's.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.socket.local_addr()
    }

    /// Sends a datagram to all targets, and returns the first error after all of them.
    ///
    /// # Errors
    ///
    /// The system's. One that says that a target's port is closed may be about an earlier datagram.
    pub fn send(&self, datagram: &[u8]) -> io::Result<()> {
        let mut first = Ok(());
        for target in &self.targets {
            let sent = self.socket.send_to(datagram, target).map(drop);
            first = first.and(sent);
        }
        first
    }

    /// Waits for a datagram, `timeout` at most; returns its bytes.
    ///
    /// # Errors
    ///
    /// The system's, but for the end of the time, and for closed ports of targets.
    pub fn receive(&self, to: &mut [u8], timeout: Duration) -> io::Result<Option<usize>> {
        // A timeout of zero would be none.
        let timeout = timeout.max(Duration::from_micros(1));
        self.socket.set_read_timeout(Some(timeout))?;
        match self.socket.recv(to) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(error) => match error.kind() {
                io::ErrorKind::WouldBlock
                | io::ErrorKind::TimedOut
                | io::ErrorKind::Interrupted
                | io::ErrorKind::ConnectionRefused
                | io::ErrorKind::ConnectionReset => Ok(None),
                _ => Err(error),
            },
        }
    }
}

fn bind(options: &SocketOptions) -> io::Result<Socket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    if options.port == PortUse::Shared {
        socket.set_reuse_address(true)?;
    }
    socket.set_broadcast(true)?;
    socket.set_multicast_ttl_v4(options.hops)?;
    if !options.interface.is_unspecified() {
        socket.set_multicast_if_v4(&options.interface)?;
    }
    // The system may give less; datagrams beyond it are lost, as on a network.
    let _ = socket.set_recv_buffer_size(RECEIVE_BUFFER_BYTES);
    socket.bind(&options.listen.into())?;
    Ok(socket)
}

/// Room for a second of states of some thousand entities.
const RECEIVE_BUFFER_BYTES: usize = 1 << 20;

/// A clock since 1970 for timestamps, which follows the system's and never runs backwards.
#[derive(Debug)]
pub struct StampClock {
    started: Instant,
    steady: Steady,
}

impl StampClock {
    /// Starts at the system's time.
    #[must_use]
    pub fn start() -> Self {
        let steady = Steady {
            shown: system_time(),
            elapsed: Duration::ZERO,
        };
        Self {
            started: Instant::now(),
            steady,
        }
    }

    /// The present moment, since a full hour of UTC.
    pub fn now(&mut self) -> Duration {
        self.steady.read(system_time(), self.started.elapsed())
    }
}

/// Time since 1970; zero before.
fn system_time() -> Duration {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH);
    since.unwrap_or_default()
}

/// A clock that never goes back. If the system's time does, this one runs at nine tenths until they meet.
#[derive(Debug)]
struct Steady {
    shown: Duration,
    elapsed: Duration,
}

impl Steady {
    fn read(&mut self, system: Duration, elapsed: Duration) -> Duration {
        let passed = elapsed.saturating_sub(self.elapsed);
        self.elapsed = elapsed;
        self.shown = system.max(self.shown + passed * 9 / 10);
        self.shown
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clock_follows_jumps_ahead_at_once_and_jumps_back_slowly() {
        let at = Duration::from_secs;
        let mut clock = Steady {
            shown: at(1000),
            elapsed: at(0),
        };
        assert_eq!(clock.read(at(1010), at(10)), at(1010));
        assert_eq!(clock.read(at(5000), at(20)), at(5000));
        assert_eq!(clock.read(at(4999), at(30)), at(5009));
        assert_eq!(clock.read(at(5099), at(130)), at(5099));
    }

    fn options(listen: SocketAddrV4) -> SocketOptions {
        SocketOptions {
            listen,
            targets: Vec::new(),
            groups: Vec::new(),
            interface: Ipv4Addr::UNSPECIFIED,
            hops: 1,
            port: PortUse::Own,
        }
    }

    #[test]
    fn a_port_in_use_and_a_wrong_group_are_named() {
        let loopback = SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0);
        let first = DisSocket::open(&options(loopback)).expect("a free port");
        let SocketAddr::V4(taken) = first.local_addr().expect("it has one") else {
            panic!("an address of version 4")
        };
        let error = DisSocket::open(&options(taken)).expect_err("it is taken");
        assert!(error.to_string().contains("--share-port"), "{error}");
        let mut wrong = options(loopback);
        wrong.groups.push(Ipv4Addr::LOCALHOST);
        let error = DisSocket::open(&wrong).expect_err("no group");
        assert!(
            error.to_string().starts_with("127.0.0.1 is no group"),
            "{error}"
        );
    }
}
