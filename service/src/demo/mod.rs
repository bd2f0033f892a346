//! `rhumb-server demo`: scenes to look at, in a page that one command opens.

mod reset_script;
mod scenes;

pub(crate) use self::scenes::{DemoArguments, open_browser};
