//! `rhumb-edge-zenoh`: edges whose packets come over zenoh's routers.
//!
//! A hub is a member of the scenes' server for each stream, and publishes their packets; edges subscribe. What differs between
//! members passes between edge and hub over connections, as between any edge and its owner. Steps nothing, keeps nothing.
#![forbid(unsafe_code)]

mod fan_out;
mod zenoh_settings;

use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::mpsc;

use clap::{Args, Parser, Subcommand};
use rhumb_server::{EdgeArguments, FanOutSide, run_shared_edge};
use zenoh::Wait;

use crate::fan_out::ZenohFanOut;
use crate::zenoh_settings::{LinkCertificates, SessionKind, config};

/// Edges of Rhumb whose packets come over zenoh's routers.
#[derive(Debug, Parser)]
#[command(name = "rhumb-edge-zenoh", version, about)]
struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Forwards packets, as zenohd does, with the settings that edges have.
    Router(RouterArguments),
    /// Publishes the streams that edges need; its members are edges alone.
    Hub(SharedArguments),
    /// Serves members; its owner is a hub.
    Edge(SharedArguments),
}

/// A router and its neighbours.
#[derive(Debug, Args)]
struct RouterArguments {
    /// Endpoint to listen on, as udp/192.0.2.1:7447, tcp/… or tls/…; may be repeated.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    listen: Vec<String>,
    /// Endpoint of another router; may be repeated.
    #[arg(long, value_name = "ENDPOINT")]
    connect: Vec<String>,
    #[command(flatten)]
    certificates: LinkCertificates,
}

/// An edge and its routers.
#[derive(Debug, Args)]
struct SharedArguments {
    #[command(flatten)]
    edge: EdgeArguments,
    /// Endpoint of a router, as udp/192.0.2.1:7447, tcp/… or tls/…; may be repeated: the first that answers is taken.
    #[arg(long, value_name = "ENDPOINT", required = true)]
    router: Vec<String>,
    #[command(flatten)]
    certificates: LinkCertificates,
    /// Name of the world: the same for a hub and its edges, another for each hub of these routers.
    #[arg(long, value_name = "NAME", default_value = "world")]
    world: String,
}

fn main() -> ExitCode {
    let done = match Arguments::parse().task {
        Task::Router(arguments) => run_router(&arguments),
        Task::Hub(arguments) => run_edge(&arguments, FanOutSide::Publishes),
        Task::Edge(arguments) => run_edge(&arguments, FanOutSide::Follows),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(cause) => {
            // If standard error is closed, no other place is left to report to.
            let _ = writeln!(io::stderr(), "error: {cause}");
            ExitCode::FAILURE
        }
    }
}

fn run_router(arguments: &RouterArguments) -> Result<(), Box<dyn Error>> {
    let endpoints = (&*arguments.listen, &*arguments.connect);
    let config = config(SessionKind::Router, endpoints, &arguments.certificates).map_err(plain)?;
    let session = zenoh::open(config).wait().map_err(plain)?;
    writeln!(io::stdout(), "forwarding at {}", arguments.listen.join(" "))?;
    let (stop, stopped) = mpsc::channel();
    ctrlc::set_handler(move || {
        // A second signal finds no receiver.
        let _ = stop.send(());
    })?;
    stopped.recv()?;
    session.close().wait().map_err(plain)
}

fn run_edge(arguments: &SharedArguments, side: FanOutSide) -> Result<(), Box<dyn Error>> {
    let endpoints = (&[][..], &*arguments.router);
    let config = config(SessionKind::Client, endpoints, &arguments.certificates).map_err(plain)?;
    run_shared_edge(&arguments.edge, side, |deliver| {
        let opened = ZenohFanOut::open(config, &arguments.world, deliver).map_err(plain)?;
        Ok(Box::new(opened))
    })
}

/// The error of another library as one of this program.
fn plain(cause: Box<dyn Error + Send + Sync>) -> Box<dyn Error> {
    cause
}
