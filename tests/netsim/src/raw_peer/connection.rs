//! One connection of a raw peer: its operations and its events.
//!
//! The tasks run on an I/O thread; the caller's thread gives them operations and takes their events.

use std::fmt;
use std::net::SocketAddr;
use std::sync::mpsc::{self, Receiver, Sender};
use std::time::Duration;

use bytes::Bytes;
use quinn::ConnectionError;
use tokio::sync::mpsc::{UnboundedReceiver, UnboundedSender, unbounded_channel};
use tokio::sync::watch;
use web_transport_quinn::{
    ReadError, RecvStream, SendStream, Session, SessionError, WebTransportError,
};

/// An event of a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RawEvent {
    /// The peer opened a stream.
    Opened {
        /// True if the stream is bidirectional.
        both_ways: bool,
    },
    /// Bytes of the control stream, cut at any place.
    Control(Bytes),
    /// The peer finished the control stream.
    ControlFinished,
    /// The peer reset the control stream with this code.
    ControlReset(u64),
    /// A datagram.
    Datagram(Bytes),
    /// The connection has ended; the last event.
    Ended(RawPeerEnd),
}

/// The end of a connection, as this end observed it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RawPeerEnd {
    /// The peer's application closed it with this code.
    Closed(u64),
    /// The peer's QUIC closed it with this code: TLS alerts start at 0x100.
    Transport(u64),
    /// This end's QUIC detected a fault of the peer.
    Fault(String),
    /// Nothing was received for the idle time.
    TimedOut,
    /// The peer does not know the connection any more.
    Reset,
    /// This end closed it.
    Here,
}

/// Operations of the I/O thread.
enum Op {
    OpenControl,
    OpenAnother { both_ways: bool },
    Control(Bytes),
    Finish,
    Break(u32),
}

/// A connection without a protocol: its owner decides every byte. It ends when either end closes it, or when it is
/// dropped.
#[derive(Debug)]
pub struct RawConnection {
    session: Session,
    ops: UnboundedSender<Op>,
    events: Receiver<RawEvent>,
    reads: watch::Sender<bool>,
}

/// The I/O thread's side.
struct ConnectionTask {
    session: Session,
    events: Sender<RawEvent>,
    reads: watch::Receiver<bool>,
}

impl RawConnection {
    /// Wraps an open connection; must be called inside the runtime that drives it.
    pub(super) fn over(session: Session) -> Self {
        let (ops, wanted) = unbounded_channel();
        let (events, receiver) = mpsc::channel();
        let (reads, may_read) = watch::channel(true);
        let task = |events: &Sender<RawEvent>| ConnectionTask {
            session: session.clone(),
            events: events.clone(),
            reads: may_read.clone(),
        };
        tokio::spawn(datagrams(task(&events)));
        tokio::spawn(streams_both_ways(task(&events), wanted));
        tokio::spawn(streams_one_way(task(&events)));
        tokio::spawn(end(task(&events)));
        Self {
            session,
            ops,
            events: receiver,
            reads,
        }
    }

    /// Opens the control stream; the peer is notified by the first bytes.
    pub fn open_control(&self) {
        self.request(Op::OpenControl);
    }

    /// Opens another stream and sends one byte on it.
    pub fn open_another(&self, both_ways: bool) {
        self.request(Op::OpenAnother { both_ways });
    }

    /// Sends bytes on the control stream.
    pub fn send_control(&self, bytes: impl Into<Bytes>) {
        self.request(Op::Control(bytes.into()));
    }

    /// Finishes the control stream.
    pub fn finish(&self) {
        self.request(Op::Finish);
    }

    /// Resets the control stream in both directions.
    pub fn reset_control(&self, code: u32) {
        self.request(Op::Break(code));
    }

    /// Sends one datagram; `false` when QUIC cannot.
    #[must_use]
    pub fn send_datagram(&self, bytes: impl Into<Bytes>) -> bool {
        self.session.send_datagram(bytes.into()).is_ok()
    }

    /// The longest datagram that the peer accepts now.
    #[must_use]
    pub fn datagram_bytes_max(&self) -> Option<usize> {
        Some(self.session.max_datagram_size()).filter(|bytes| *bytes > 0)
    }

    /// Starts or stops reading the control stream; unread bytes wait at the peer.
    pub fn read_control(&self, reads: bool) {
        self.reads.send_replace(reads);
    }

    /// Closes at once.
    pub fn close(&self, code: u32) {
        self.session.close(code, b"");
    }

    /// The next event, within `timeout`.
    #[must_use]
    pub fn next_event(&mut self, timeout: Duration) -> Option<RawEvent> {
        self.events.recv_timeout(timeout).ok()
    }

    /// Address of the peer.
    #[must_use]
    pub fn peer(&self) -> SocketAddr {
        self.session.remote_address()
    }

    /// The negotiated application protocol, by its TLS name.
    #[must_use]
    pub fn alpn(&self) -> Option<Vec<u8>> {
        let data = self.session.handshake_data()?;
        let data = data.downcast::<quinn::crypto::rustls::HandshakeData>();
        data.ok()?.protocol
    }

    /// Bytes of UDP payload that this end sent and received.
    #[must_use]
    pub fn udp_bytes(&self) -> (u64, u64) {
        let connection: &quinn::Connection = &self.session;
        let stats = connection.stats();
        (stats.udp_tx.bytes, stats.udp_rx.bytes)
    }

    fn request(&self, op: Op) {
        // A connection that has ended carries nothing more, and has reported its end.
        let _ = self.ops.send(op);
    }
}

impl Drop for RawConnection {
    fn drop(&mut self) {
        if self.session.close_reason().is_none() {
            self.close(rhumb_transport::TransportCode::LEFT.0);
        }
    }
}

impl ConnectionTask {
    /// Reports an event; a dropped connection takes none.
    fn report(&self, events: RawEvent) {
        let _ = self.events.send(events);
    }

    async fn read(mut self, mut stream: RecvStream) {
        loop {
            if self.reads.wait_for(|reads| *reads).await.is_err() {
                return;
            }
            match stream.read_chunk(64 << 10, true).await {
                Ok(Some(chunk)) => self.report(RawEvent::Control(chunk.bytes)),
                Ok(None) => return self.report(RawEvent::ControlFinished),
                Err(ReadError::Reset(code)) => {
                    return self.report(RawEvent::ControlReset(code.into()));
                }
                Err(_) => return,
            }
        }
    }
}

async fn datagrams(task: ConnectionTask) {
    while let Ok(bytes) = task.session.read_datagram().await {
        task.report(RawEvent::Datagram(bytes));
    }
}

async fn streams_one_way(task: ConnectionTask) {
    let mut kept = Vec::new();
    while let Ok(stream) = task.session.accept_uni().await {
        task.report(RawEvent::Opened { both_ways: false });
        kept.push(stream);
    }
}

/// Carries the control stream, whichever end opens it, and performs the caller's operations.
async fn streams_both_ways(task: ConnectionTask, mut wanted: UnboundedReceiver<Op>) {
    let session = task.session.clone();
    let mut control: Option<SendStream> = None;
    let mut others = Vec::new();
    loop {
        tokio::select! {
            opened = session.accept_bi() => {
                let Ok((send, recv)) = opened else { return };
                task.report(RawEvent::Opened { both_ways: true });
                if control.is_none() {
                    control = Some(send);
                    read(&task, recv);
                } else {
                    others.push((Some(send), Some(recv)));
                }
            }
            op = wanted.recv() => {
                let done = match op {
                    None => return,
                    Some(Op::OpenControl) => match session.open_bi().await {
                        Ok((send, recv)) => {
                            read(&task, recv);
                            control = Some(send);
                            true
                        }
                        Err(_) => false,
                    },
                    Some(Op::OpenAnother { both_ways }) => {
                        open_another(&session, both_ways, &mut others).await
                    }
                    Some(op) => perform(&mut control, op).await,
                };
                if !done && session.close_reason().is_some() {
                    return;
                }
            }
        }
    }
}

fn read(task: &ConnectionTask, recv: RecvStream) {
    let reader = ConnectionTask {
        session: task.session.clone(),
        events: task.events.clone(),
        reads: task.reads.clone(),
    };
    tokio::spawn(reader.read(recv));
}

/// Time limit for opening another stream.
const OPEN_TIMEOUT: Duration = Duration::from_millis(200);

async fn open_another(
    session: &Session,
    both_ways: bool,
    others: &mut Vec<(Option<SendStream>, Option<RecvStream>)>,
) -> bool {
    // Without a time limit, the wait for a peer that allows no more streams would not end.
    let opened = tokio::time::timeout(OPEN_TIMEOUT, async {
        if both_ways {
            let (send, recv) = session.open_bi().await.ok()?;
            Some((send, Some(recv)))
        } else {
            Some((session.open_uni().await.ok()?, None))
        }
    });
    let Ok(Some((mut send, recv))) = opened.await else {
        return false;
    };
    let written = send.write_all(&[0]).await.is_ok();
    others.push((Some(send), recv));
    written
}

/// Performs an operation on the control stream, if there is one.
async fn perform(control: &mut Option<SendStream>, op: Op) -> bool {
    let Some(stream) = control else {
        return false;
    };
    match op {
        Op::Control(bytes) => stream.write_all(&bytes).await.is_ok(),
        Op::Finish => stream.finish().is_ok(),
        Op::Break(code) => stream.reset(code).is_ok(),
        Op::OpenControl | Op::OpenAnother { .. } => false,
    }
}

async fn end(task: ConnectionTask) {
    let end = RawPeerEnd::from(task.session.closed().await);
    task.report(RawEvent::Ended(end));
}

impl From<SessionError> for RawPeerEnd {
    fn from(error: SessionError) -> Self {
        match error {
            SessionError::ConnectionError(error) => error.into(),
            SessionError::WebTransportError(WebTransportError::Closed(code, _)) => {
                Self::Closed(code.into())
            }
            other => Self::Fault(other.to_string()),
        }
    }
}

impl From<ConnectionError> for RawPeerEnd {
    fn from(error: ConnectionError) -> Self {
        match error {
            ConnectionError::ApplicationClosed(close) => {
                Self::Closed(close.error_code.into_inner())
            }
            ConnectionError::ConnectionClosed(close) => Self::Transport(close.error_code.into()),
            ConnectionError::TimedOut => Self::TimedOut,
            ConnectionError::Reset => Self::Reset,
            ConnectionError::LocallyClosed => Self::Here,
            other => Self::Fault(other.to_string()),
        }
    }
}

impl fmt::Display for RawPeerEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Closed(code) => write!(f, "closed with code {code}"),
            Self::Transport(code) => write!(f, "closed by QUIC with code {code:#x}"),
            Self::Fault(cause) => write!(f, "broken: {cause}"),
            Self::TimedOut => f.write_str("timed out"),
            Self::Reset => f.write_str("forgotten by the peer"),
            Self::Here => f.write_str("closed by this end"),
        }
    }
}
