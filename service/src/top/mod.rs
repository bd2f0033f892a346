//! `rhumb-server top`: a running server's metrics in the terminal.
//!
//! It reads `/metrics` and `/health` of a server as any other program could, once a second. Rates are differences of two
//! readings. It changes nothing at the server.

mod columns;
mod reading;
mod screen;
mod state;

use std::error::Error;
use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{
    Receiver, RecvTimeoutError, SyncSender, TryRecvError, TrySendError, sync_channel,
};
use std::thread;
use std::time::Duration;

use clap::Args;
use ratatui::crossterm::event;

use self::reading::{MetricsReader, MetricsUrl, ReadError, Reading};
use self::state::{KeyEffect, TopKey, TopState};
use crate::signals;

/// Time between two readings.
const INTERVAL: Duration = Duration::from_secs(1);
/// Longest wait for a key before a new reading is shown.
const KEY_WAIT: Duration = Duration::from_millis(100);

/// Shows a server's metrics until a key ends it, or once.
pub(crate) fn run(arguments: &TopArguments) -> Result<(), Box<dyn Error>> {
    let url = arguments.url.to_string();
    let reader = MetricsReader::new(arguments.url.clone())?;
    if arguments.once {
        let failed = |cause: ReadError| {
            format!(
                "cannot read {url}/metrics: {cause}; start the server with --metrics ADDRESS, and name that address"
            )
        };
        let before = reader.read().map_err(failed)?;
        thread::sleep(INTERVAL);
        let now = reader.read().map_err(failed)?;
        let text = screen::plain(&url, &now, Some(&before));
        return Ok(io::stdout().lock().write_all(text.as_bytes())?);
    }
    // A signal ends it as a key does: the terminal is as it was before.
    let stopped = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&stopped);
    signals::watch(move |_| stop.store(true, Ordering::Relaxed))?;
    let mut terminal = ratatui::try_init().map_err(|cause| {
        format!("cannot use this terminal: {cause}; --once prints a table without one")
    })?;
    let outcome = show(&mut terminal, TopState::new(url), reader, &stopped);
    let restored = ratatui::try_restore();
    outcome.and(restored).map_err(Into::into)
}

/// Draws whatever is new, until a key or a signal ends it.
fn show(
    terminal: &mut ratatui::DefaultTerminal,
    mut state: TopState,
    reader: MetricsReader,
    stopped: &AtomicBool,
) -> io::Result<()> {
    let (_end, outcomes) = read_on_thread(reader)?;
    loop {
        terminal.draw(|frame| screen::draw(frame, &state))?;
        loop {
            if stopped.load(Ordering::Relaxed) {
                return Ok(());
            }
            if event::poll(KEY_WAIT)? {
                let key = TopKey::of(&event::read()?);
                if key.map(|key| state.press(key)) == Some(KeyEffect::Quit) {
                    return Ok(());
                }
                break;
            }
            match outcomes.try_recv() {
                Ok(outcome) => {
                    state.take(outcome);
                    break;
                }
                Err(TryRecvError::Empty) => {}
                Err(TryRecvError::Disconnected) => {
                    return Err(io::Error::other("the thread that reads has ended"));
                }
            }
        }
    }
}

type Outcome = Result<Reading, String>;

/// Reads the server each second, on a thread that ends when the first part of the result is dropped.
fn read_on_thread(reader: MetricsReader) -> io::Result<(SyncSender<()>, Receiver<Outcome>)> {
    let (end, ended) = sync_channel::<()>(0);
    let (outcomes, received) = sync_channel(1);
    thread::Builder::new()
        .name("rhumb-top".to_owned())
        .spawn(move || {
            loop {
                let outcome = reader.read().map_err(|cause| cause.to_string());
                // A screen that is behind gets a newer reading later.
                if let Err(TrySendError::Disconnected(_)) = outcomes.try_send(outcome) {
                    return;
                }
                if ended.recv_timeout(INTERVAL) != Err(RecvTimeoutError::Timeout) {
                    return;
                }
            }
        })?;
    Ok((end, received))
}

/// The server to read, and how often.
#[derive(Debug, Args)]
pub(crate) struct TopArguments {
    /// URL of the server's metrics: the address that its --metrics names.
    #[arg(default_value = "http://127.0.0.1:9464", value_name = "URL")]
    url: MetricsUrl,
    /// Prints one table as plain text and ends, for scripts; no terminal is needed.
    #[arg(long)]
    pub(super) once: bool,
}
