//! The suite against the server and the clients of this project.

mod cli;
mod client;
mod server;
