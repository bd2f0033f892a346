//! The keys of the screen.

use ratatui::crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

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
