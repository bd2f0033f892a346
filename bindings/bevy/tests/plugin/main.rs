//! The plug-in in apps without a window, beside a server process.
//!
//! The server is the binary that `RHUMB_TEST_SERVER` names, else the one that the main workspace's tests have built.

mod arena;
mod endings;
mod following;
mod server;
mod stepping;
