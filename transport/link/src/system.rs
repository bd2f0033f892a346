//! System services: the monotonic clock, UDP sockets, runtimes, random bytes.
//!
//! No QUIC here. Small kernel buffers are no error: they cost packets, not correctness.
//!
//! It has the protocol's units, no wall time and no ticks. It never goes backwards; all copies of one clock agree.

use std::io;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant as HostInstant};

use quinn::udp::{UdpSockRef, UdpSocketState};
use rhumb_protocol::{Instant, Span};
use ring::rand::{SecureRandom, SystemRandom};
use tokio::runtime::{Builder, Runtime};

/// Requested size of the kernel buffers: a burst of 500 packets costs about twice its bytes there.
const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// Binds `address` and requests kernel buffers that hold a tick's burst.
///
/// A socket at `[::]` takes IPv4 too, whatever the system's default is.
///
/// # Errors
///
/// When the address cannot be bound.
pub fn bind_udp(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = bind_plain(address)?;
    let state = UdpSocketState::new(UdpSockRef::from(&socket))?;
    for refused in [
        state.set_recv_buffer_size(UdpSockRef::from(&socket), SOCKET_BUFFER_BYTES),
        state.set_send_buffer_size(UdpSockRef::from(&socket), SOCKET_BUFFER_BYTES),
    ]
    .into_iter()
    .filter_map(Result::err)
    {
        tracing::debug!(%refused, "socket keeps its default buffer");
    }
    Ok(socket)
}

#[cfg(unix)]
fn bind_plain(address: SocketAddr) -> io::Result<UdpSocket> {
    use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with, sockopt};

    if !(address.is_ipv6() && address.ip().is_unspecified()) {
        return UdpSocket::bind(address);
    }
    let flags = SocketFlags::CLOEXEC;
    let socket = socket_with(AddressFamily::INET6, SocketType::DGRAM, flags, None)?;
    sockopt::set_ipv6_v6only(&socket, false)?;
    bind(&socket, &address)?;
    Ok(socket.into())
}

#[cfg(not(unix))]
fn bind_plain(address: SocketAddr) -> io::Result<UdpSocket> {
    UdpSocket::bind(address)
}

/// The address of this machine from which its way to other networks begins, of the kind of `any`. Nothing is sent.
///
/// # Errors
///
/// When there is no such way.
pub fn outward_ip(any: IpAddr) -> io::Result<IpAddr> {
    /// A port that no one listens at.
    const DISCARD: u16 = 9;
    // Addresses of documents, which no network has (RFC 5737, RFC 3849). The system chooses a way, and no packet goes.
    let (own, other): (IpAddr, IpAddr) = match any {
        IpAddr::V4(_) => (
            Ipv4Addr::UNSPECIFIED.into(),
            Ipv4Addr::new(192, 0, 2, 1).into(),
        ),
        IpAddr::V6(_) => (
            Ipv6Addr::UNSPECIFIED.into(),
            Ipv6Addr::new(0x2001, 0xdb8, 0, 0, 0, 0, 0, 1).into(),
        ),
    };
    let socket = UdpSocket::bind((own, 0))?;
    socket.connect((other, DISCARD))?;
    Ok(socket.local_addr()?.ip())
}

/// The runtime of one I/O thread.
///
/// # Errors
///
/// When the system gives no event queue.
pub fn io_runtime() -> io::Result<Runtime> {
    Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
}

/// Bytes that no other process can guess.
///
/// # Errors
/// An I/O error, if the system has none.
pub fn random_bytes<const N: usize>() -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    let filled = SystemRandom::new().fill(&mut bytes);
    filled.map_err(|_| io::Error::other("the system gives no random bytes"))?;
    Ok(bytes)
}

/// A monotonic clock whose zero is its own creation.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    zero: HostInstant,
}

impl Clock {
    /// Starts a clock at zero.
    #[must_use]
    pub fn start() -> Self {
        Self {
            zero: HostInstant::now(),
        }
    }

    /// The present moment.
    #[must_use]
    pub fn now(&self) -> Instant {
        let ns = self.zero.elapsed().as_nanos();
        Instant::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
    }

    /// The time until `moment`; zero if it has passed.
    #[must_use]
    pub fn until(&self, moment: Instant) -> Duration {
        duration(moment.since(self.now()))
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::start()
    }
}

/// A span as the standard library's type.
fn duration(span: Span) -> Duration {
    Duration::from_nanos(span.as_nanos())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_clock_never_goes_backwards_and_its_copies_agree() {
        let clock = Clock::start();
        let copy = clock;
        let mut last = clock.now();
        for _ in 0..1_000 {
            let next = copy.now();
            assert!(next >= last);
            last = clock.now();
            assert!(last >= next);
        }
    }

    #[test]
    fn the_time_until_a_past_moment_is_zero() {
        let clock = Clock::start();
        assert_eq!(clock.until(Instant::ZERO), Duration::ZERO);
        let far = Instant::from_nanos(u64::MAX);
        assert!(clock.until(far) > Duration::from_secs(1));
    }
}
