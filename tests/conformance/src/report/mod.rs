//! The report of a run, in forms for people and for machines.

mod config;
mod html;
mod json;
mod junit;
mod results;
mod style;

pub use config::RunSettings;
pub use html::html;
pub use json::json;
pub use junit::junit;
pub use results::Report;
