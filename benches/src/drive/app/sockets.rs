//! The sockets of a sound client: its caller's own thread has them.
//!
//! But for what it is told to lose: a cap on what leaves, and the size of a buffer.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::thread;
use std::time::Duration;

use rhumb_app::{Frames, Message};

use super::defects::Defects;
use super::replica::AppReplica;
use super::wire::Wire;
use crate::drive::PATIENCE;

/// The sockets, once connected.
#[derive(Debug)]
pub(super) struct Sockets {
    pub(super) tcp: TcpStream,
    pub(super) udp: UdpSocket,
    /// How many datagrams of a state the buffer of `udp` holds.
    pub(super) room: usize,
    /// See [`LOST`].
    pub(super) patience: Duration,
}

/// A connection that its caller reads.
#[derive(Debug)]
pub(super) struct Direct {
    sockets: Sockets,
    defects: Defects,
    frames: Frames,
    buffer: Vec<u8>,
}

/// Of a sound client: a frame of ten thousand bodies and more.
#[cfg(target_os = "linux")]
const BUFFER_BYTES: usize = 16 << 20;
/// The system's default on Linux, which the published client leaves alone; the kernel doubles what it is told.
#[cfg(target_os = "linux")]
const DEFAULT_BUFFER_BYTES: usize = 212_992 / 2;
/// Silence behind the first word of a frame after which its end counts as lost: the published simulator begins its next frame then, 11.33 times
/// a second.
pub(super) const LOST: Duration = Duration::from_nanos(88_261_253);
/// What the system takes of a socket's buffer for the datagram of a state: 277 fit into the default one.
const KEPT_BYTES: usize = 768;
/// Messages that leave in one turn of the published client's pump.
pub(super) const MESSAGES_PER_POLL: usize = 50;
/// Between two turns of its pump.
pub(super) const PUMP: Duration = Duration::from_millis(30);
/// One read of TCP.
pub(super) const READ_BYTES: usize = 64 << 10;

impl Sockets {
    /// Connects both, and sends the logon by datagram as the published client does, before that on TCP.
    pub(super) fn open(server: SocketAddr, defects: Defects) -> io::Result<Self> {
        let udp = UdpSocket::bind("127.0.0.1:0")?;
        let room = set_buffer(&udp, defects)? / KEPT_BYTES;
        udp.connect(server)?;
        let tcp = TcpStream::connect(server)?;
        Ok(Self {
            tcp,
            udp,
            room,
            patience: LOST,
        })
    }
}

/// Gives a socket the buffer of the published client, or a large one; tells how large it is, bytes.
#[cfg(target_os = "linux")]
fn set_buffer(udp: &UdpSocket, defects: Defects) -> io::Result<usize> {
    use rustix::net::sockopt::{
        set_socket_recv_buffer_size, set_socket_recv_buffer_size_force, socket_recv_buffer_size,
    };
    if defects.buffer {
        set_socket_recv_buffer_size(udp, DEFAULT_BUFFER_BYTES)?;
    } else if set_socket_recv_buffer_size_force(udp, BUFFER_BYTES).is_err() {
        // Without the right to it, as much as anybody may have.
        set_socket_recv_buffer_size(udp, BUFFER_BYTES)?;
    }
    Ok(socket_recv_buffer_size(udp)?)
}

/// Elsewhere a socket keeps the buffer that it has, which is another: nothing can be said of this loss there.
#[cfg(not(target_os = "linux"))]
fn set_buffer(_: &UdpSocket, _: Defects) -> io::Result<usize> {
    Ok(0)
}

impl Direct {
    pub(super) fn new(sockets: Sockets, defects: Defects) -> io::Result<Self> {
        sockets.tcp.set_nodelay(true)?;
        Ok(Self {
            sockets,
            defects,
            frames: Frames::default(),
            buffer: vec![0; READ_BYTES],
        })
    }

    /// Sends messages, one write for as many as leave together.
    pub(super) fn send(&mut self, messages: &[Vec<u8>], wire: &mut Wire) -> io::Result<()> {
        if !self.defects.cap {
            return self.write(&messages.concat(), wire);
        }
        let mut turns = messages.chunks(MESSAGES_PER_POLL).peekable();
        while let Some(turn) = turns.next() {
            self.write(&turn.concat(), wire)?;
            if turns.peek().is_some() {
                thread::sleep(PUMP);
            }
        }
        Ok(())
    }

    fn write(&mut self, bytes: &[u8], wire: &mut Wire) -> io::Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        wire.segments_up(bytes);
        self.sockets.tcp.write_all(bytes)
    }

    /// Takes in what came too late: behind the end of a frame that was given up.
    pub(super) fn switch_when_caught_up(
        &mut self,
        replica: &mut AppReplica,
        wire: &mut Wire,
    ) -> io::Result<()> {
        if !replica.may_lose(self.sockets.room) {
            return Ok(());
        }
        self.sockets.udp.set_nonblocking(true)?;
        let heard = loop {
            match self.receive_one(replica, wire) {
                Ok(()) => {}
                Err(cause) if is_nothing_yet(&cause) => break Ok(()),
                Err(cause) => break Err(cause),
            }
        };
        self.sockets.udp.set_nonblocking(false)?;
        heard
    }

    /// Reads until a frame more is over; then takes in what TCP has. Where a burst may overflow the socket's buffer,
    /// silence behind a frame's first word ends it, too.
    ///
    /// Errors when a server says nothing of a frame for [`PATIENCE`].
    pub(super) fn receive(&mut self, replica: &mut AppReplica, wire: &mut Wire) -> io::Result<()> {
        let awaited = replica.await_end();
        let may_lose = replica.may_lose(self.sockets.room);
        // A server that steps is silent, however long it takes: an end is lost only behind what came before it.
        self.sockets.udp.set_read_timeout(Some(PATIENCE))?;
        let mut silent = true;
        while !replica.has_ended(awaited) {
            match self.receive_one(replica, wire) {
                Ok(()) if may_lose && std::mem::take(&mut silent) => {
                    let patience = self.sockets.patience;
                    self.sockets.udp.set_read_timeout(Some(patience))?;
                }
                Ok(()) => {}
                // Of a process that was stopped for a while.
                Err(cause) if cause.kind() == io::ErrorKind::Interrupted => {}
                Err(cause) if is_nothing_yet(&cause) && !silent => {
                    replica.give_up();
                    break;
                }
                Err(cause) if is_nothing_yet(&cause) => return Err(io::ErrorKind::TimedOut.into()),
                Err(cause) => return Err(cause),
            }
        }
        self.receive_tcp(replica, wire)
    }

    fn receive_one(&mut self, replica: &mut AppReplica, wire: &mut Wire) -> io::Result<()> {
        let count = self.sockets.udp.recv(&mut self.buffer)?;
        let datagram = &self.buffer[..count];
        wire.datagram_down(datagram);
        receive_datagram(datagram, replica)
    }

    pub(super) fn receive_tcp(
        &mut self,
        replica: &mut AppReplica,
        wire: &mut Wire,
    ) -> io::Result<()> {
        self.sockets.tcp.set_nonblocking(true)?;
        let heard = loop {
            match self.sockets.tcp.read(&mut self.buffer) {
                Ok(0) => break Err(io::ErrorKind::ConnectionAborted.into()),
                Ok(count) => {
                    wire.segments_down(&self.buffer[..count]);
                    self.frames.push(&self.buffer[..count]);
                }
                Err(cause) if is_nothing_yet(&cause) => break Ok(()),
                Err(cause) => break Err(cause),
            }
        };
        self.sockets.tcp.set_nonblocking(false)?;
        heard?;
        while let Some(message) = next_message(&mut self.frames)? {
            replica.receive(&message);
        }
        Ok(())
    }

    pub(super) fn send_datagram(&mut self, bytes: &[u8], wire: &mut Wire) -> io::Result<()> {
        wire.datagram_up(bytes);
        self.sockets.udp.send(bytes).map(drop)
    }
}

/// Takes in every message of a datagram: one, or as many as were packed.
pub(super) fn receive_datagram(datagram: &[u8], replica: &mut AppReplica) -> io::Result<()> {
    let mut frames = Frames::default();
    frames.push(datagram);
    while let Some(message) = next_message(&mut frames)? {
        replica.receive(&message);
    }
    Ok(())
}

/// The next message; bytes that are none are the server's fault.
pub(super) fn next_message(frames: &mut Frames) -> io::Result<Option<Message>> {
    let framed = frames.next_message();
    let framed =
        framed.map_err(|malformed| io::Error::new(io::ErrorKind::InvalidData, malformed))?;
    Ok(framed.map(|framed| framed.message))
}

/// Whether a read only found nothing there.
pub(super) fn is_nothing_yet(cause: &io::Error) -> bool {
    matches!(
        cause.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}

#[cfg(test)]
mod tests {
    use std::net::TcpListener;
    use std::sync::mpsc;

    use glam::{Quat, Vec3};
    use rhumb_app::{Id, Motion};

    use super::super::messages::SIMULATION;
    use super::*;
    use crate::drive::remote::Retention;

    const BODIES: u32 = 20;
    /// Silence after which these ends count as lost.
    const SHORT: Duration = Duration::from_millis(10);

    /// A server's end of both sockets, and a client's.
    fn ends(defects: Defects, room: usize) -> (UdpSocket, TcpStream, Direct) {
        let tcp = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = tcp.local_addr().unwrap();
        let udp = UdpSocket::bind(address).unwrap();
        let mut sockets = Sockets::open(address, defects).unwrap();
        (sockets.room, sockets.patience) = (room, SHORT);
        udp.connect(sockets.udp.local_addr().unwrap()).unwrap();
        let (server, _) = tcp.accept().unwrap();
        (udp, server, Direct::new(sockets, defects).unwrap())
    }

    fn encode(udp: &UdpSocket, message: &Message) {
        let mut bytes = Vec::new();
        message.encode(0, &mut bytes);
        udp.send(&bytes).unwrap();
    }

    /// The states of some bodies; their end by itself.
    fn send_states(udp: &UdpSocket, objects: std::ops::Range<u32>) {
        for object in objects {
            let actor = Id {
                simulation: SIMULATION,
                object,
            };
            let still = Motion {
                actor,
                position: Vec3::ZERO,
                rotation: Quat::IDENTITY,
                linear: Vec3::ZERO,
                angular: Vec3::ZERO,
                gravity_modifier: 1.0,
            };
            encode(udp, &Message::SetDynamicActor(still));
        }
    }

    #[test]
    fn a_server_that_stalls_in_a_frame_is_waited_for() {
        let (udp, _tcp, mut direct) = ends(Defects::SOUND, usize::MAX);
        let (asks, asked) = mpsc::channel();
        let server = thread::spawn(move || {
            for () in asked {
                send_states(&udp, 0..BODIES / 2);
                thread::sleep(2 * SHORT);
                send_states(&udp, BODIES / 2..BODIES);
                encode(&udp, &Message::TimeAdvanced(SIMULATION));
            }
        });
        let (mut replica, mut wire) =
            (AppReplica::new(Defects::SOUND), Wire::new(Retention::Costs));
        for frame in 1..=3 {
            asks.send(()).unwrap();
            direct
                .switch_when_caught_up(&mut replica, &mut wire)
                .unwrap();
            direct.receive(&mut replica, &mut wire).unwrap();
            assert_eq!((replica.over, replica.lost), (frame, 0));
            assert_eq!(replica.states, frame * u64::from(BODIES));
        }
        drop(asks);
        server.join().unwrap();
    }

    #[test]
    fn an_end_that_comes_too_late_is_not_taken_for_that_of_the_next_frame() {
        let (udp, _tcp, mut direct) = ends(Defects::SOUND, 0);
        let (mut replica, mut wire) =
            (AppReplica::new(Defects::SOUND), Wire::new(Retention::Costs));
        send_states(&udp, 0..BODIES);
        direct.receive(&mut replica, &mut wire).unwrap();
        assert_eq!((replica.over, replica.lost), (0, 1));
        // Its end comes with the next frame, which says states before its own.
        encode(&udp, &Message::TimeAdvanced(SIMULATION));
        send_states(&udp, 0..BODIES);
        encode(&udp, &Message::TimeAdvanced(SIMULATION));
        direct.receive(&mut replica, &mut wire).unwrap();
        assert_eq!((replica.over, replica.lost), (1, 1));
        assert_eq!(replica.states, 2 * u64::from(BODIES));
    }

    #[test]
    fn an_end_that_never_comes_is_owed_until_the_next_and_no_longer() {
        let (udp, _tcp, mut direct) = ends(Defects::SOUND, 0);
        let (mut replica, mut wire) =
            (AppReplica::new(Defects::SOUND), Wire::new(Retention::Costs));
        send_states(&udp, 0..BODIES);
        direct.receive(&mut replica, &mut wire).unwrap();
        assert_eq!((replica.over, replica.lost), (0, 1));
        // From now on all sleep: nothing tells this frame's end from the one that was lost but silence behind it.
        for frame in 1..=3 {
            encode(&udp, &Message::TimeAdvanced(SIMULATION));
            direct.receive(&mut replica, &mut wire).unwrap();
            assert_eq!((replica.over, replica.lost), (frame, 1));
        }
    }
}
