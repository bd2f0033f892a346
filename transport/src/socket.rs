//! A bound UDP socket with buffers for bursts, and a thread's runtime.
//!
//! No QUIC here. Small kernel buffers are no error: they cost packets, not correctness.

use std::io;
use std::net::{SocketAddr, UdpSocket};

use quinn::udp::{UdpSockRef, UdpSocketState};
use tokio::runtime::{Builder, Runtime};

/// Requested size of the kernel buffers: a burst of 500 packets costs about twice its bytes there.
const SOCKET_BUFFER_BYTES: usize = 4 << 20;

/// Binds `address` and requests kernel buffers that hold a tick's burst.
///
/// # Errors
///
/// When the address cannot be bound.
pub fn bind_udp(address: SocketAddr) -> io::Result<UdpSocket> {
    let socket = UdpSocket::bind(address)?;
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
