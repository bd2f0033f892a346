//! The contents of the screen: newest readings, selection, order of rows.
//!
//! It draws nothing and reads nothing itself.

use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::columns::SceneChange;
use super::columns::SortOrder;
use super::reading::Reading;

/// The state of the screen.
#[derive(Debug)]
pub(super) struct TopState {
    pub(super) url: String,
    before: Option<Reading>,
    pub(super) now: Option<Reading>,
    /// The reason why the last attempt failed.
    pub(super) failure: Option<String>,
    pub(super) order: SortOrder,
    /// The selected scene, which stays selected when rows change their places.
    selected: Option<String>,
    pub(super) shows_details: bool,
}

/// The effect of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum KeyEffect {
    Continue,
    Quit,
}

impl TopState {
    pub(super) fn new(url: String) -> Self {
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
    pub(super) fn take(&mut self, outcome: Result<Reading, String>) {
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
    pub(super) fn rows(&self) -> Vec<SceneChange<'_>> {
        let Some(now) = &self.now else {
            return Vec::new();
        };
        let mut rows: Vec<_> = SceneChange::all(now, self.before.as_ref()).collect();
        self.order.sort(&mut rows);
        rows
    }

    /// The place of the selected row: the first until one is chosen.
    pub(super) fn selected_row(&self, rows: &[SceneChange<'_>]) -> Option<usize> {
        let selected = self.selected.as_deref();
        let place = rows.iter().position(|row| Some(row.name) == selected);
        place.or((!rows.is_empty()).then_some(0))
    }

    pub(super) fn press(&mut self, key: TopKey) -> KeyEffect {
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
pub(super) enum TopKey {
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
pub(super) const HELP: &str = " q quit   s sort   r reverse   ↑ ↓ Home End select   Enter details ";

impl TopKey {
    /// The key of a terminal's event; `None` for all others.
    pub(super) fn of(event: &Event) -> Option<Self> {
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

#[cfg(test)]
mod tests {
    use rhumb_protocol::{Instant, Span};

    use super::*;

    fn reading(seconds: u64, scenes: &[(&str, u64)]) -> Reading {
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
        state.take(Ok(reading(0, &[("a", 1), ("b", 3), ("c", 2)])));
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
        state.take(Ok(reading(0, &[("a", 1), ("b", 3)])));
        assert_eq!(selected(&state), "a");
        state.press(TopKey::Down);
        state.press(TopKey::Down);
        assert_eq!(selected(&state), "b");
        state.press(TopKey::Reverse);
        assert_eq!(selected(&state), "b");
        state.press(TopKey::Up);
        assert_eq!(selected(&state), "b", "it is the first now");
        state.take(Ok(reading(1, &[("a", 1)])));
        assert_eq!(selected(&state), "a", "the scene is gone");
    }

    #[test]
    fn a_failure_keeps_the_metrics_and_the_next_reading_begins_anew() {
        let mut state = TopState::new(String::new());
        state.take(Ok(reading(0, &[("a", 1)])));
        state.take(Err("gone".to_owned()));
        assert_eq!(names(&state), ["a"]);
        assert_eq!(state.failure.as_deref(), Some("gone"));
        state.take(Ok(reading(9, &[("a", 5)])));
        assert_eq!(state.failure, None);
        assert_eq!(state.rows()[0].rate("bodies"), None);
        state.take(Ok(reading(10, &[("a", 6)])));
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
}
