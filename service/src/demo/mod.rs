//! `rhumb-server demo`: scenes to look at, in a page that one command opens.

mod arguments;
mod browser;
mod reset_script;
mod scenes;

pub(crate) use self::arguments::DemoArguments;
pub(crate) use self::browser::open_browser;
