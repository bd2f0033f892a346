//! The page that shows scenes in a browser, as bytes for a server to serve.
//!
//! Files of the page, the kept libraries and the web client are embedded: nothing is read at run time, and nothing comes
//! from outside. It opens no socket.
#![forbid(unsafe_code)]

mod page;

pub use page::{Asset, UNAVAILABLE, asset, assets, content_security_policy, static_files};
