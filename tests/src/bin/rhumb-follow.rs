//! Leads a lockstep scene and writes the state of its copy, tick by tick.
//!
//! The output is for comparison with another client of the same scene. It prints `going` when others may join and
//! waits for a line of input. Then it leads on, prints `done` and waits for the end of its input. The file has one
//! line for each complete tick.

use std::fs::{self, File};
use std::io::{self, BufRead, BufWriter, Write};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use clap::Parser;
use rhumb_conformance::testee::copy_line;
use rhumb_conformance::vectors::known;
use rhumb_protocol::message::{InvalidToken, StreamChoice};
use rhumb_protocol::session::{ClientSession, Event};
use rhumb_protocol::{Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{LengthBound, Tick, Tolerance};
use rhumb_sims::{Script, by_name};
use rhumb_transport::{
    ClientOptions, ClientTransport, Clock, Fingerprint, QuicClient, Received, Trust,
};
use serde_json::{Value, json};

/// Leads a scene and writes the state of its copy.
#[derive(Debug, Parser)]
struct Arguments {
    /// Address of the server.
    #[arg(long)]
    server: SocketAddr,
    /// Fingerprint to pin.
    #[arg(long)]
    fingerprint: Fingerprint,
    /// Name of the scene, which is created.
    #[arg(long)]
    scene: String,
    /// Name of the script.
    #[arg(long, default_value = "ball-pit")]
    script: String,
    /// Number of bodies of the script.
    #[arg(long)]
    bodies: u32,
    /// Tolerance in micrometres.
    #[arg(long)]
    micrometres: u32,
    /// Number of ticks.
    #[arg(long)]
    ticks: u64,
    /// File to write.
    #[arg(long)]
    out: PathBuf,
    /// File for the received bytes, in the form of spec/vectors/streams.json.
    #[arg(long)]
    record: Option<PathBuf>,
    /// File with the token to show.
    #[arg(long)]
    token: Option<PathBuf>,
}

const SERVER: Peer = Peer(0);
/// Longest wait for an answer.
const TIME_LIMIT: Span = Span::from_millis(20_000);
/// Number of ticks before others join.
const ALONE: u64 = 20;
/// Shortest duration of a tick.
const FRAME: Span = Span::from_millis(16);

struct Leader {
    session: ClientSession,
    connection: QuicClient,
    clock: Clock,
    out: BufWriter<File>,
    written: Option<Tick>,
    /// The received data, with the state of the copy after each complete tick.
    recorded: Vec<Value>,
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn failed(what: &str) -> io::Error {
    io::Error::other(what.to_owned())
}

impl Leader {
    fn open(arguments: &Arguments) -> io::Result<Self> {
        let trust = Trust::Fingerprint(arguments.fingerprint);
        let options = ClientOptions::new(arguments.server, trust);
        let connection = QuicClient::connect(options, Duration::from_secs(10))
            .map_err(|error| failed(&error.to_string()))?;
        let scene = arguments.scene.parse();
        let mut session = ClientSession::new(scene.map_err(|_| failed("not a valid scene name"))?);
        if let Some(path) = &arguments.token {
            let token = fs::read_to_string(path)?.parse();
            session.set_token(token.map_err(|error: InvalidToken| failed(&error.to_string()))?);
        }
        let clock = Clock::start();
        session.handle_opened(clock.now(), SERVER);
        Ok(Self {
            session,
            connection,
            clock,
            out: BufWriter::new(File::create(&arguments.out)?),
            written: None,
            recorded: Vec::new(),
        })
    }

    /// Processes at most one event until a moment, and writes each tick that becomes complete.
    fn turn(&mut self, until: Instant) -> io::Result<()> {
        self.flush();
        let wake = self
            .session
            .poll_timeout()
            .map_or(until, |wake| wake.at.min(until));
        if let Some(received) = self.connection.recv(self.clock.until(wake)) {
            let now = self.clock.now();
            match received {
                Received::Control(bytes) => {
                    self.recorded.push(json!(["control", hex(&bytes)]));
                    self.session.handle_control(now, SERVER, &bytes);
                }
                Received::State(bytes) => {
                    self.recorded.push(json!(["datagram", hex(&bytes)]));
                    self.session.handle_datagram(now, SERVER, &bytes);
                }
                Received::Ended(ending) => return Err(failed(&format!("ended: {ending:?}"))),
            }
            self.write()?;
        }
        self.session.handle_timeout(self.clock.now());
        self.flush();
        Ok(())
    }

    fn flush(&mut self) {
        while let Some(transmit) = self.session.poll_transmit() {
            match transmit {
                Transmit::Control { bytes, .. } => self.connection.send_control(bytes),
                Transmit::State { bytes, .. } => self.connection.send_state(bytes),
                Transmit::Close { code, .. } => self.connection.close(code),
            }
        }
    }

    fn write(&mut self) -> io::Result<()> {
        let Some(replica) = self.session.replica() else {
            return Ok(());
        };
        let tick = replica.stream().complete();
        if self.written == Some(tick) || !replica.stream().is_converged() {
            return Ok(());
        }
        self.written = Some(tick);
        self.recorded.push(json!(["known", known(replica)]));
        writeln!(self.out, "{}", copy_line(replica, tick))
    }

    /// Waits for an event that `wanted` accepts.
    fn await_event(&mut self, wanted: impl Fn(&Event) -> bool) -> io::Result<()> {
        let end = self.clock.now() + TIME_LIMIT;
        while self.clock.now() < end {
            while let Some(event) = self.session.poll_event() {
                if wanted(&event) {
                    return Ok(());
                }
            }
            self.turn(end)?;
        }
        Err(failed("no answer of the server in time"))
    }

    /// Sends the script's commands of one tick, advances the scene, and waits for the complete tick.
    fn lead(&mut self, script: &mut dyn Script, tick: u64) -> io::Result<()> {
        let mut commands = Vec::new();
        script.commands(Tick::new(tick), &mut commands);
        for command in commands {
            let sent = self.session.command(command);
            sent.map_err(|misuse| failed(&misuse.to_string()))?;
        }
        let (begin, to) = (self.clock.now(), Tick::new(tick + 1));
        let sent = self.session.advance(begin, to);
        sent.map_err(|misuse| failed(&misuse.to_string()))?;
        let is_there = |leader: &Self| {
            let replica = leader.session.replica();
            replica.is_some_and(|replica| replica.stream().complete() >= to)
        };
        while !is_there(self) {
            if self.clock.now() > begin + TIME_LIMIT {
                return Err(failed("a tick was not complete in time"));
            }
            self.turn(begin + TIME_LIMIT)?;
        }
        while self.clock.now() < begin + FRAME {
            self.turn(begin + FRAME)?;
        }
        while self.session.poll_event().is_some() {}
        Ok(())
    }
}

/// Prints a word for the parent process.
fn write_line(word: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    writeln!(out, "{word}")?;
    out.flush()
}

fn main() -> io::Result<()> {
    let arguments = Arguments::parse();
    let script = by_name(&arguments.script, arguments.bodies, 1);
    let mut script = script.ok_or_else(|| failed("unknown script"))?;
    let length = LengthBound::from_micrometres(arguments.micrometres);
    let length = length.map_err(|_| failed("not a valid tolerance"))?;
    let mut leader = Leader::open(&arguments)?;
    leader.await_event(|event| matches!(event, Event::Welcomed(_)))?;
    let misuse = |misuse: rhumb_protocol::session::Misuse| failed(&misuse.to_string());
    leader.session.create(script.config()).map_err(misuse)?;
    leader.await_event(|event| *event == Event::Created)?;
    let choice = StreamChoice::Within(Tolerance::Surface(length));
    leader.session.join(choice).map_err(misuse)?;
    leader.await_event(|event| matches!(event, Event::Joined(_)))?;
    let mut answers = io::stdin().lock().lines();
    for tick in 0..arguments.ticks {
        if tick == ALONE {
            write_line("going")?;
            answers.next().transpose()?;
        }
        leader.lead(script.as_mut(), tick)?;
    }
    leader.out.flush()?;
    if let Some(record) = &arguments.record {
        let stream = json!({"name": "a recorded session", "events": leader.recorded});
        fs::write(record, json!({"streams": [stream]}).to_string())?;
    }
    write_line("done")?;
    while answers.next().transpose()?.is_some() {}
    Ok(())
}
