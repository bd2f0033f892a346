//! Answers requests for figures and for the server's health.
//!
//! Speaks as much HTTP as such requests need: one GET for each connection. It shares no lock with a scene for longer
//! than a copy takes, so that it answers whatever a scene does. One peer that is slow delays others by a second at most;
//! bind it to an address that only operators reach.

use std::io::{self, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use super::Metrics;

/// Time for one request, and for one answer.
const REQUEST_TIMEOUT: Duration = Duration::from_millis(500);
/// Longest head of a request.
const REQUEST_BYTES_MAX: usize = 4_096;

/// The thread that answers; it ends when this is dropped.
#[derive(Debug)]
pub(crate) struct MetricsListener {
    address: SocketAddr,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl MetricsListener {
    /// Answers requests at a listener.
    pub(crate) fn start(listener: TcpListener, metrics: Metrics) -> io::Result<Self> {
        let address = listener.local_addr()?;
        let ended = Arc::new(AtomicBool::new(false));
        let ending = Arc::clone(&ended);
        let thread = thread::Builder::new()
            .name("rhumb-server-metrics".into())
            .spawn(move || {
                for stream in listener.incoming() {
                    if ending.load(Ordering::Relaxed) {
                        return;
                    }
                    let answered = stream.and_then(|stream| answer(stream, &metrics));
                    if let Err(cause) = answered {
                        tracing::debug!(%cause, "a request for figures failed");
                    }
                }
            })?;
        Ok(Self {
            address,
            ended,
            thread: Some(thread),
        })
    }
}

impl Drop for MetricsListener {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        // The thread waits for a connection: this one wakes it.
        let woken = TcpStream::connect_timeout(&self.address, REQUEST_TIMEOUT).is_ok();
        if let Some(thread) = self.thread.take().filter(|_| woken) {
            // A panic of the thread was logged.
            let _ = thread.join();
        }
    }
}

fn answer(mut stream: TcpStream, metrics: &Metrics) -> io::Result<()> {
    stream.set_read_timeout(Some(REQUEST_TIMEOUT))?;
    stream.set_write_timeout(Some(REQUEST_TIMEOUT))?;
    let mut head = [0; REQUEST_BYTES_MAX];
    let mut length = 0;
    while !head[..length].contains(&b'\n') && length < head.len() {
        match stream.read(&mut head[length..])? {
            0 => break,
            read => length += read,
        }
    }
    let head = String::from_utf8_lossy(&head[..length]);
    let (status, body) = match head.split_whitespace().nth(1) {
        Some("/metrics") => ("200 OK", metrics.text()),
        Some("/health") if metrics.is_healthy() => ("200 OK", "ok\n".to_owned()),
        Some("/health") => (
            "503 Service Unavailable",
            "the front does not answer\n".to_owned(),
        ),
        _ => (
            "404 Not Found",
            "there are /metrics and /health\n".to_owned(),
        ),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: text/plain; version=0.0.4\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body.as_bytes())
}
