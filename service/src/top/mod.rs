//! `rhumb-server top`: a running server's metrics in the terminal.
//!
//! It reads `/metrics` and `/health` of a server as any other program could, once a second. Rates are differences of two
//! readings. It changes nothing at the server.

mod reading;

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
use ratatui::Frame;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::layout::{Alignment, Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::Line;
use ratatui::widgets::{Block, Cell, Paragraph, Row, Table, TableState, Wrap};

use self::reading::{
    COLUMNS, MetricsReader, MetricsUrl, NAME_TITLE, NAME_WIDTH, ReadError, Reading, SceneChange,
    SortOrder, count, fitting, milliseconds, number, percent,
};
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
        let text = plain(&url, &now, Some(&before));
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
        terminal.draw(|frame| draw(frame, &state))?;
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

/// The state of the screen.
#[derive(Debug)]
struct TopState {
    url: String,
    before: Option<Reading>,
    now: Option<Reading>,
    /// The reason why the last attempt failed.
    failure: Option<String>,
    order: SortOrder,
    /// The selected scene, which stays selected when rows change their places.
    selected: Option<String>,
    shows_details: bool,
}

/// The effect of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum KeyEffect {
    Continue,
    Quit,
}

impl TopState {
    fn new(url: String) -> Self {
        Self {
            url,
            before: None,
            now: None,
            failure: None,
            order: SortOrder::default(),
            selected: None,
            shows_details: false,
        }
    }

    /// Takes the outcome of an attempt to read the server.
    fn take(&mut self, outcome: Result<Reading, String>) {
        match outcome {
            Ok(reading) => {
                // A server that was restarted counts anew, and so do the rates.
                self.before = (self.now.take()).filter(|_| self.failure.is_none());
                self.now = Some(reading);
                self.failure = None;
            }
            Err(reason) => self.failure = Some(reason),
        }
    }

    /// Scenes in the order of rows.
    fn rows(&self) -> Vec<SceneChange<'_>> {
        let Some(now) = &self.now else {
            return Vec::new();
        };
        let mut rows: Vec<_> = SceneChange::all(now, self.before.as_ref()).collect();
        self.order.sort(&mut rows);
        rows
    }

    /// The place of the selected row: the first until one is chosen.
    fn selected_row(&self, rows: &[SceneChange<'_>]) -> Option<usize> {
        let selected = self.selected.as_deref();
        let place = rows.iter().position(|row| Some(row.name) == selected);
        place.or((!rows.is_empty()).then_some(0))
    }

    fn press(&mut self, key: TopKey) -> KeyEffect {
        match key {
            TopKey::Quit => return KeyEffect::Quit,
            TopKey::Sort => self.order = self.order.next(),
            TopKey::Reverse => self.order = self.order.reversed(),
            TopKey::Details => self.shows_details = !self.shows_details,
            TopKey::Up => self.select(|row, _| row.saturating_sub(1)),
            TopKey::Down => self.select(|row, last| (row + 1).min(last)),
            TopKey::First => self.select(|_, _| 0),
            TopKey::Last => self.select(|_, last| last),
        }
        KeyEffect::Continue
    }

    fn select(&mut self, place: impl Fn(usize, usize) -> usize) {
        let rows = self.rows();
        if let Some(row) = self.selected_row(&rows) {
            let chosen = rows[place(row, rows.len() - 1)].name.to_owned();
            self.selected = Some(chosen);
        }
    }
}

/// A key that does something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TopKey {
    Quit,
    Sort,
    Reverse,
    Details,
    Up,
    Down,
    First,
    Last,
}

/// The line that explains the keys.
const HELP: &str = " q quit   s sort   r reverse   ↑ ↓ Home End select   Enter details ";

impl TopKey {
    /// The key of a terminal's event; `None` for all others.
    fn of(event: &Event) -> Option<Self> {
        let Event::Key(KeyEvent {
            code,
            modifiers,
            kind: KeyEventKind::Press | KeyEventKind::Repeat,
            ..
        }) = *event
        else {
            return None;
        };
        if modifiers.contains(KeyModifiers::CONTROL) {
            // The terminal sends no signal while its keys are read.
            return (code == KeyCode::Char('c')).then_some(Self::Quit);
        }
        match code {
            KeyCode::Char('q') | KeyCode::Esc => Some(Self::Quit),
            KeyCode::Char('s') => Some(Self::Sort),
            KeyCode::Char('r') => Some(Self::Reverse),
            KeyCode::Enter => Some(Self::Details),
            KeyCode::Up | KeyCode::Char('k') => Some(Self::Up),
            KeyCode::Down | KeyCode::Char('j') => Some(Self::Down),
            KeyCode::Home => Some(Self::First),
            KeyCode::End => Some(Self::Last),
            _ => None,
        }
    }
}

/// Lines about the server.
const HEAD_LINES: u16 = 3;
/// Lines of details with their frame.
const DETAIL_LINES: u16 = 9;

/// Draws a whole screen.
fn draw(frame: &mut Frame<'_>, state: &TopState) {
    let details = if state.shows_details { DETAIL_LINES } else { 0 };
    let areas = Layout::vertical([
        Constraint::Length(HEAD_LINES),
        Constraint::Min(2),
        Constraint::Length(details),
        Constraint::Length(1),
    ]);
    let [head, table, detail, keys] = areas.areas(frame.area());
    frame.render_widget(head_lines(state), head);
    let rows = state.rows();
    let selected = state.selected_row(&rows);
    draw_table(frame, state, &rows, selected, table);
    if let Some(scene) = selected.and_then(|row| rows.get(row))
        && state.shows_details
    {
        frame.render_widget(detail_lines(state, scene), detail);
    }
    frame.render_widget(Line::from(HELP).dim(), keys);
}

fn head_lines(state: &TopState) -> Paragraph<'_> {
    let text = match (&state.failure, &state.now) {
        (Some(reason), _) => {
            let text = format!("{}: {reason}; trying again each second", state.url);
            Line::from(text).style(Style::new().fg(Color::Red).bold())
        }
        (None, None) => Line::from(format!("{}: connecting", state.url)),
        (None, Some(now)) => Line::from(format!("{}: {}", state.url, summary(now))),
    };
    Paragraph::new(text).wrap(Wrap { trim: true })
}

fn draw_table(
    frame: &mut Frame<'_>,
    state: &TopState,
    rows: &[SceneChange<'_>],
    selected: Option<usize>,
    area: Rect,
) {
    let sorted = state.order.column;
    let places = fitting(area.width, sorted);
    let columns = || places.iter().map(|place| &COLUMNS[*place]);
    let title = |text: &'static str, is_sorted: bool| {
        let line = Line::from(text);
        if is_sorted {
            line.bold().underlined()
        } else {
            line.bold()
        }
    };
    let titles = places.iter().map(|place| {
        let title = title(COLUMNS[*place].title, sorted == Some(*place));
        Cell::from(title.alignment(Alignment::Right))
    });
    let name = Cell::from(title(NAME_TITLE, sorted.is_none()));
    let head = Row::new(std::iter::once(name).chain(titles));
    let lines = rows.iter().map(|scene| {
        let cells = columns().map(|column| {
            let text = Line::from(column.cell(scene));
            Cell::from(text.alignment(Alignment::Right))
        });
        let name = Cell::from(scene.name.to_owned());
        let row = Row::new(std::iter::once(name).chain(cells));
        if scene.value("faulted") == Some(1.0) {
            row.style(Style::new().fg(Color::Red))
        } else {
            row
        }
    });
    let widths = columns().map(|column| Constraint::Length(column.width));
    let widths = std::iter::once(Constraint::Min(NAME_WIDTH)).chain(widths);
    let mut table = Table::new(lines, widths)
        .header(head)
        .row_highlight_style(Style::new().reversed());
    if state.failure.is_some() {
        table = table.dim();
    }
    let mut place = TableState::new().with_selected(selected);
    frame.render_stateful_widget(table, area, &mut place);
}

fn detail_lines<'a>(state: &'a TopState, scene: &SceneChange<'a>) -> Paragraph<'a> {
    let value = |metric| scene.value(metric);
    let rate = value("step_period_seconds").map(|period| 1.0 / period);
    let limit = (state.now.as_ref()).and_then(|now: &Reading| now.value("rhumb_scene_load_limit"));
    let load = value("load").zip(limit).map(|(load, most)| load / most);
    let fault = if value("faulted") == Some(1.0) {
        "stands still: its engine failed"
    } else {
        "runs"
    };
    let lines = vec![
        Line::from(format!(
            "{fault}; {} so far; {} % of the load that a scene may reserve",
            count(value("restorations_total"), "restoration"),
            percent(load)
        )),
        Line::from(format!(
            "ticks: {}/s of {}/s; {} late, {} too late to catch up",
            number(scene.rate("tick"), 1),
            number(rate, 1),
            number(value("late_total"), 0),
            number(value("slowed_total"), 0)
        )),
        Line::from(format!(
            "step: p50 {} ms, p95 {} ms, p99 {} ms; publishing: mean {} ms",
            milliseconds(scene.step_quantile(0.50)),
            milliseconds(scene.step_quantile(0.95)),
            milliseconds(scene.step_quantile(0.99)),
            milliseconds(scene.publish_mean())
        )),
        Line::from(format!(
            "bodies: {}, {} awake, {} waiting for a budget",
            number(value("bodies"), 0),
            number(value("bodies_awake"), 0),
            number(value("bodies_waiting"), 0)
        )),
        Line::from(format!(
            "commands: {}/s, {} refused so far",
            number(scene.rate("commands_total"), 1),
            number(value("commands_refused_total"), 0)
        )),
        Line::from(format!(
            "bytes: {} received, {} sent so far, without headers",
            number(value("received_bytes_total"), 0),
            number(value("sent_bytes_total"), 0)
        )),
        Line::from(format!("connections closed by code: {}", closed(state))),
    ];
    Paragraph::new(lines).block(Block::bordered().title(scene.name))
}

/// The codes by which the server closed connections, with their counts.
fn closed(state: &TopState) -> String {
    let reading = state.now.iter();
    let closed = reading.flat_map(Reading::closed);
    let texts: Vec<_> = closed
        .map(|(code, count)| format!("{code}: {count}"))
        .collect();
    if texts.is_empty() {
        "none".to_owned()
    } else {
        texts.join(", ")
    }
}

/// One line about the server as a whole.
fn summary(now: &Reading) -> String {
    let health = if now.is_healthy {
        "healthy"
    } else {
        "not healthy: connections are not served"
    };
    let load = now.value("rhumb_load").zip(now.value("rhumb_load_limit"));
    let load = load.map(|(load, most)| load / most);
    let restored: f64 = sum(now, "restorations_total");
    let faulted: f64 = sum(now, "faulted");
    format!(
        "{health}, {}, {} so far, {}, {} quarantined, {} faulted, {}, load {} %",
        count(now.value("rhumb_connections"), "connection"),
        number(now.value("rhumb_connections_total"), 0),
        count(now.value("rhumb_scenes"), "scene"),
        number(now.value("rhumb_scenes_quarantined"), 0),
        number(Some(faulted), 0),
        count(Some(restored), "restoration"),
        percent(load),
    )
}

fn sum(now: &Reading, metric: &str) -> f64 {
    let scenes = now.scenes.values();
    let sum: f64 = scenes.filter_map(|scene| scene.value(metric)).sum();
    // The sum of nothing is -0.
    sum + 0.0
}

/// The whole table: a line about the server, titles, and a line for each scene.
fn plain(url: &str, now: &Reading, before: Option<&Reading>) -> String {
    let mut rows: Vec<_> = SceneChange::all(now, before).collect();
    SortOrder::default().sort(&mut rows);
    let mut lines = vec![titles()];
    lines.extend(rows.iter().map(cells));
    let widths: Vec<usize> = (0..lines[0].len())
        .map(|at| lines.iter().map(|line| line[at].len()).max().unwrap_or(0))
        .collect();
    let mut text = format!("{url}: {}\n", summary(now));
    for line in lines {
        let mut padded = format!("{:<1$}", line[0], widths[0]);
        for (cell, width) in line.iter().zip(&widths).skip(1) {
            padded += &format!("  {cell:>width$}");
        }
        text += padded.trim_end();
        text.push('\n');
    }
    text
}

fn titles() -> Vec<String> {
    let titles = COLUMNS.iter().map(|column| column.title);
    [NAME_TITLE]
        .into_iter()
        .chain(titles)
        .map(str::to_owned)
        .collect()
}

fn cells(scene: &SceneChange<'_>) -> Vec<String> {
    let cells = COLUMNS.iter().map(|column| column.cell(scene));
    std::iter::once(scene.name.to_owned())
        .chain(cells)
        .collect()
}

#[cfg(test)]
mod tests {
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;
    use rhumb_protocol::{Instant, Span};

    use super::*;
    use crate::top::TopKey;

    fn bodies_at(seconds: u64, scenes: &[(&str, u64)]) -> Reading {
        let rows = scenes
            .iter()
            .map(|(name, bodies)| format!("rhumb_scene_bodies{{scene=\"{name}\"}} {bodies}\n"));
        let text = format!("rhumb_scenes 1\n{}", rows.collect::<String>());
        let at = Instant::ZERO + Span::from_millis(seconds * 1_000);
        Reading::parse(at, true, &text).unwrap()
    }

    fn names(state: &TopState) -> Vec<&str> {
        state.rows().iter().map(|row| row.name).collect()
    }

    fn selected(state: &TopState) -> String {
        let rows = state.rows();
        rows[state.selected_row(&rows).unwrap()].name.to_owned()
    }

    #[test]
    fn rows_are_sorted_by_name_or_by_a_column() {
        let mut state = TopState::new(String::new());
        state.take(Ok(bodies_at(0, &[("a", 1), ("b", 3), ("c", 2)])));
        assert_eq!(names(&state), ["a", "b", "c"]);
        state.press(TopKey::Reverse);
        assert_eq!(names(&state), ["c", "b", "a"]);
        state.press(TopKey::Sort);
        state.press(TopKey::Sort);
        assert_eq!(names(&state), ["b", "c", "a"], "by bodies, most first");
        state.press(TopKey::Reverse);
        assert_eq!(names(&state), ["a", "c", "b"]);
    }

    #[test]
    fn a_selected_scene_stays_selected_when_rows_move() {
        let mut state = TopState::new(String::new());
        state.take(Ok(bodies_at(0, &[("a", 1), ("b", 3)])));
        assert_eq!(selected(&state), "a");
        state.press(TopKey::Down);
        state.press(TopKey::Down);
        assert_eq!(selected(&state), "b");
        state.press(TopKey::Reverse);
        assert_eq!(selected(&state), "b");
        state.press(TopKey::Up);
        assert_eq!(selected(&state), "b", "it is the first now");
        state.take(Ok(bodies_at(1, &[("a", 1)])));
        assert_eq!(selected(&state), "a", "the scene is gone");
    }

    #[test]
    fn a_failure_keeps_the_metrics_and_the_next_reading_begins_anew() {
        let mut state = TopState::new(String::new());
        state.take(Ok(bodies_at(0, &[("a", 1)])));
        state.take(Err("gone".to_owned()));
        assert_eq!(names(&state), ["a"]);
        assert_eq!(state.failure.as_deref(), Some("gone"));
        state.take(Ok(bodies_at(9, &[("a", 5)])));
        assert_eq!(state.failure, None);
        assert_eq!(state.rows()[0].rate("bodies"), None);
        state.take(Ok(bodies_at(10, &[("a", 6)])));
        assert_eq!(state.rows()[0].rate("bodies"), Some(1.0));
    }

    #[test]
    fn keys_without_scenes_do_nothing() {
        let mut state = TopState::new(String::new());
        for key in [TopKey::Up, TopKey::Down, TopKey::Last, TopKey::Details] {
            assert_eq!(state.press(key), KeyEffect::Continue);
        }
        assert_eq!(state.press(TopKey::Quit), KeyEffect::Quit);
    }

    fn reading(seconds: u64, tick: u64, sent: u64) -> Reading {
        let text = format!(
            "rhumb_connections 2\nrhumb_connections_total 5\nrhumb_scenes 2\nrhumb_scenes_quarantined 0\n\
             rhumb_load 500\nrhumb_load_limit 1000\nrhumb_scene_load_limit 800\nrhumb_closed_total{{code=\"18\"}} 3\n\
             rhumb_scene_tick{{scene=\"pit\"}} {tick}\nrhumb_scene_members{{scene=\"pit\"}} 2\n\
             rhumb_scene_bodies{{scene=\"pit\"}} 511\nrhumb_scene_bodies_awake{{scene=\"pit\"}} 40\n\
             rhumb_scene_sent_bytes_total{{scene=\"pit\"}} {sent}\nrhumb_scene_load{{scene=\"pit\"}} 200\n\
             rhumb_scene_step_period_seconds{{scene=\"pit\"}} 0.02\n\
             rhumb_scene_step_seconds_bucket{{scene=\"pit\",le=\"0.002\"}} {tick}\n\
             rhumb_scene_step_seconds_bucket{{scene=\"pit\",le=\"+Inf\"}} {tick}\n\
             rhumb_scene_tick{{scene=\"tower\"}} 7\n"
        );
        let at = Instant::ZERO + Span::from_millis(seconds * 1_000);
        Reading::parse(at, true, &text).unwrap()
    }

    fn state() -> TopState {
        let mut state = TopState::new("http://127.0.0.1:9464".to_owned());
        state.take(Ok(reading(1, 100, 1_000)));
        state.take(Ok(reading(2, 150, 26_600)));
        state
    }

    /// The lines of a screen of this size.
    fn drawn(state: &TopState, width: u16, height: u16) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, state)).unwrap();
        let buffer = terminal.backend().buffer().clone();
        let line = |y| {
            let cells = (0..width).map(|x| buffer[(x, y)].symbol().to_owned());
            cells.collect::<String>().trim_end().to_owned()
        };
        (0..height).map(line).collect()
    }

    #[test]
    fn the_table_shows_the_scenes_with_their_rates() {
        let lines = drawn(&state(), 120, 12);
        assert!(
            lines[0].starts_with("http://127.0.0.1:9464: healthy, 2 connections"),
            "{lines:#?}"
        );
        let words: Vec<_> = lines[3].split_whitespace().collect();
        assert_eq!(words[0], "SCENE");
        assert_eq!(words.len(), 1 + COLUMNS.len());
        let row: Vec<_> = lines[4].split_whitespace().collect();
        let expected = [
            "pit", "2", "511", "40", "150", "50.0", "1.00", "1.98", "-", "-", "-", "25.6", "-",
        ];
        assert_eq!(row, expected);
        assert!(lines[5].starts_with("tower"), "{lines:#?}");
        assert!(lines[11].contains("q quit"), "{lines:#?}");
    }

    #[test]
    fn a_narrow_screen_leaves_columns_out_and_cuts_none() {
        let titles = COLUMNS.map(|column| column.title);
        for (width, least) in [(104, 11), (80, 8), (40, 3), (20, 1)] {
            let lines = drawn(&state(), width, 12);
            let mut words = lines[3].split_whitespace();
            assert_eq!(words.next(), Some("SCENE"), "{lines:#?}");
            let shown: Vec<_> = words.collect();
            assert!(shown.len() >= least, "{width}: {lines:#?}");
            assert!(
                shown.iter().all(|word| titles.contains(word)),
                "{width}: {lines:#?}"
            );
        }
        let mut sorted = state();
        while sorted.order.column != Some(COLUMNS.len() - 1) {
            sorted.press(TopKey::Sort);
        }
        let lines = drawn(&sorted, 40, 12);
        assert!(lines[3].contains("WAIT"), "{lines:#?}");
    }

    #[test]
    fn a_server_without_scenes_has_no_faults() {
        let mut state = TopState::new("http://127.0.0.1:9464".to_owned());
        let at = Instant::ZERO;
        state.take(Ok(Reading::parse(at, true, "rhumb_scenes 0\n").unwrap()));
        let text = drawn(&state, 160, 12).join("\n");
        assert!(text.contains(" 0 faulted, 0 restorations"), "{text}");
    }

    #[test]
    fn details_belong_to_the_selected_scene() {
        let mut state = state();
        state.press(TopKey::Details);
        let text = drawn(&state, 120, 20).join("\n");
        for expected in [
            "┌pit",
            "25.0 % of the load that a scene may reserve",
            "ticks: 50.0/s of 50.0/s",
            "26600 sent so far, without headers",
            "18: 3",
        ] {
            assert!(text.contains(expected), "{expected} in\n{text}");
        }
        state.press(TopKey::Down);
        let text = drawn(&state, 120, 20).join("\n");
        assert!(text.contains("┌tower"), "{text}");
    }

    #[test]
    fn a_server_that_is_gone_is_named_and_its_last_metrics_stay() {
        let mut state = state();
        state.take(Err("cannot connect: refused".to_owned()));
        let lines = drawn(&state, 120, 12);
        assert_eq!(
            lines[0],
            "http://127.0.0.1:9464: cannot connect: refused; trying again each second"
        );
        assert!(lines[4].starts_with("pit"), "{lines:#?}");
    }

    #[test]
    fn a_screen_of_any_size_is_drawn() {
        let mut state = state();
        for _ in 0..2 {
            for (width, height) in [(1, 1), (10, 4), (40, 6), (300, 60)] {
                assert_eq!(drawn(&state, width, height).len(), usize::from(height));
            }
            state.press(TopKey::Details);
        }
    }
}
