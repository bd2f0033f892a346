//! Followers of a stream without a copy of it, in any number.
//!
//! A follower joins as an observer does, and then counts its packets in place of reading them: a thousand copies of two
//! thousand bodies would measure the copies. It reports no losses. When its connection ends it comes back, as often as
//! that happens.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use bytes::Bytes;
use rhumb_protocol::message::{
    ClientMessage, Extensions, Frames, ServerMessage, StreamChoice, VERSIONS,
};
use rhumb_protocol::packet::{Datagram, PacketKind};
use rhumb_reckoning::Tolerance;
use rhumb_transport::{ClientOptions, ClientTransport, QuicClient, Received, Trust};

use super::member::Place;
use super::rig::LIMIT;
use crate::output::Failure;

/// Followers of one place, which a thread drives.
pub(super) struct Crowd {
    thread: JoinHandle<()>,
    tasks: Sender<Task>,
    counts: Arc<Counts>,
}

/// Counts of what a crowd has received so far.
#[derive(Debug, Default)]
struct Counts {
    packets: AtomicU64,
    lost: AtomicU64,
    absence: Mutex<Absence>,
}

/// Followers that have lost their connection and are not back.
#[derive(Clone, Copy, Debug, Default)]
struct Absence {
    absent: usize,
    /// The first loss of those that are not all repaired.
    since: Option<Instant>,
    /// The duration of the last absence, until all were back.
    lasted: Option<Duration>,
}

enum Task {
    /// This follower has something to receive.
    Receive(usize),
    /// An attempt of this follower to connect has ended.
    Opened(usize, Option<QuicClient>),
    /// The crowd ends.
    End,
}

struct Follower {
    connection: QuicClient,
    frames: Frames,
    /// True while the loop knows that something has come.
    has_news: Arc<AtomicBool>,
    is_member: bool,
}

impl Crowd {
    /// Followers who are all members of a place's scene.
    ///
    /// # Errors
    ///
    /// One of them is not connected, or is no member in time.
    pub(super) fn enter(
        place: &Place,
        followers: u32,
        entered: &dyn Fn(),
    ) -> Result<Self, Failure> {
        let (tasks, receiver) = mpsc::channel();
        let (joined, has_joined) = mpsc::channel();
        let counts = Arc::new(Counts::default());
        let running = RunningCrowd {
            place: place.clone(),
            followers: BTreeMap::new(),
            tasks: tasks.clone(),
            joined,
            counts: Arc::clone(&counts),
        };
        let thread = thread::spawn(move || running.run(&receiver));
        for number in 0..followers as usize {
            let connection = connect(place)?;
            tasks.send(Task::Opened(number, Some(connection)))?;
            has_joined.recv_timeout(LIMIT)?;
            entered();
        }
        Ok(Self {
            thread,
            tasks,
            counts,
        })
    }

    /// Datagrams of the stream so far, of all followers.
    pub(super) fn packets(&self) -> u64 {
        self.counts.packets.load(Ordering::Relaxed)
    }

    /// Connections that have ended so far.
    pub(super) fn lost(&self) -> u64 {
        self.counts.lost.load(Ordering::Relaxed)
    }

    /// The time from the first of the last losses until all were members again; `None` if some are not, or none was lost.
    pub(super) fn absence(&self) -> Option<Duration> {
        let absence = self.counts.absence();
        absence.lasted.filter(|_| absence.absent == 0)
    }

    /// Closes all connections.
    pub(super) fn end(self) -> Result<(), Failure> {
        // A thread that has ended is noticed by the join.
        let _ = self.tasks.send(Task::End);
        let ended = self.thread.join();
        ended.map_err(|_| "the thread of a crowd panicked".into())
    }
}

impl Counts {
    fn absence(&self) -> MutexGuard<'_, Absence> {
        self.absence.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn connect(place: &Place) -> Result<QuicClient, Failure> {
    let options = ClientOptions::new(place.address, Trust::Fingerprint(place.fingerprint));
    Ok(QuicClient::connect(options, LIMIT)?)
}

struct RunningCrowd {
    place: Place,
    followers: BTreeMap<usize, Follower>,
    tasks: Sender<Task>,
    joined: Sender<()>,
    counts: Arc<Counts>,
}

impl RunningCrowd {
    fn run(mut self, tasks: &Receiver<Task>) {
        while let Ok(task) = tasks.recv() {
            match task {
                Task::Receive(number) => self.receive(number),
                Task::Opened(number, Some(connection)) => self.open(number, connection),
                Task::Opened(number, None) => self.come_back(number),
                Task::End => break,
            }
        }
        // Closing waits for each connection in turn: all at once.
        let closing = self.followers.into_values();
        let closing: Vec<_> = closing
            .map(|follower| thread::spawn(move || drop(follower)))
            .collect();
        for closed in closing {
            // A connection that is not closed in order ends with the process.
            let _ = closed.join();
        }
    }

    fn open(&mut self, number: usize, connection: QuicClient) {
        let hello = ClientMessage::Hello {
            versions: VERSIONS.to_vec(),
            scene: self.place.scene(),
            extensions: Extensions::NONE,
        };
        let has_news = Arc::new(AtomicBool::new(false));
        send(&connection, &hello);
        let (known, tasks) = (Arc::clone(&has_news), self.tasks.clone());
        connection.on_arrival(move || {
            if !known.swap(true, Ordering::AcqRel) {
                let _ = tasks.send(Task::Receive(number));
            }
        });
        let follower = Follower {
            connection,
            frames: Frames::new(),
            has_news,
            is_member: false,
        };
        self.followers.insert(number, follower);
    }

    fn receive(&mut self, number: usize) {
        let Some(follower) = self.followers.get_mut(&number) else {
            return;
        };
        follower.has_news.store(false, Ordering::Release);
        let was_member = follower.is_member;
        while let Some(received) = follower.connection.recv(Duration::ZERO) {
            match received {
                Received::Control(bytes) => follower.read(&bytes),
                Received::State(bytes) => {
                    let packets = u64::from(is_of_stream(&bytes));
                    self.counts.packets.fetch_add(packets, Ordering::Relaxed);
                }
                Received::Ended(_) => return self.lose(number),
            }
        }
        if follower.is_member && !was_member {
            self.note_member();
        }
    }

    fn note_member(&self) {
        // One that comes back is not awaited.
        let _ = self.joined.send(());
        let mut absence = self.counts.absence();
        if let Some(since) = absence.since {
            absence.absent -= 1;
            if absence.absent == 0 {
                absence.lasted = Some(since.elapsed());
                absence.since = None;
            }
        }
    }

    fn lose(&mut self, number: usize) {
        let Some(lost) = self.followers.remove(&number) else {
            return;
        };
        if lost.is_member {
            self.counts.lost.fetch_add(1, Ordering::Relaxed);
            let mut absence = self.counts.absence();
            absence.absent += 1;
            absence.since.get_or_insert_with(Instant::now);
        }
        thread::spawn(move || drop(lost));
        self.come_back(number);
    }

    /// Tries again on a thread: opening waits.
    fn come_back(&self, number: usize) {
        let (place, tasks) = (self.place.clone(), self.tasks.clone());
        thread::spawn(move || {
            let connection = connect(&place).ok();
            // A crowd that has ended needs none.
            let _ = tasks.send(Task::Opened(number, connection));
        });
    }
}

impl Follower {
    fn read(&mut self, bytes: &[u8]) {
        self.frames.push(bytes);
        while let Ok(Some(framed)) = self.frames.next_frame() {
            match ServerMessage::decode(&framed) {
                Ok(Some(ServerMessage::Welcome(_))) => {
                    let choice = StreamChoice::Within(Tolerance::NORMAL);
                    send(&self.connection, &ClientMessage::Join(choice));
                }
                Ok(Some(ServerMessage::SnapshotEnd)) => self.is_member = true,
                _ => {}
            }
        }
    }
}

fn send(connection: &QuicClient, message: &ClientMessage) {
    let mut bytes = Vec::new();
    message.encode(&mut bytes);
    connection.send_control(Bytes::from(bytes));
}

/// True for what the scene's publisher sent, as the edge forwards it.
fn is_of_stream(bytes: &Bytes) -> bool {
    Datagram::open(bytes).is_ok_and(|datagram| datagram.head().kind != PacketKind::LossReport)
}
