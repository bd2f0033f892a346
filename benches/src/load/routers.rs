//! Two routers of zenoh, and the hub that publishes by them.
//!
//! They are processes of the program of `edge/zenoh`, which is given by its path. The hub is at the first router, the edges
//! are at the second, and each of them knows the other router too. Measures nothing.

use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::Command as Program;

use crate::drive::{OwnProcess, ServerProcess, Signal};
use crate::output::Failure;

/// The routers and the hub.
pub(super) struct Routers {
    program: PathBuf,
    endpoints: [String; 2],
    routers: [OwnProcess; 2],
    hub: ServerProcess,
}

impl Routers {
    /// Starts the routers, and the hub as a member of a server.
    pub(super) fn start(program: &Path, owner: &ServerProcess) -> Result<Self, Failure> {
        let endpoints = [free_endpoint()?, free_endpoint()?];
        let first = start_router(program, &endpoints, 0)?;
        let second = start_router(program, &endpoints, 1)?;
        let mut hub = edge_of(program, "hub", owner);
        hub.args(["--listen", "127.0.0.1:0"]);
        let [at_first, at_second] = &endpoints;
        hub.args(["--router", at_first, "--router", at_second]);
        Ok(Self {
            program: program.to_owned(),
            routers: [first, second],
            hub: ServerProcess::run(&mut hub, None)?,
            endpoints,
        })
    }

    /// A command that starts an edge of the hub.
    pub(super) fn edge(&self) -> Program {
        let mut edge = edge_of(&self.program, "edge", &self.hub);
        let [first, second] = &self.endpoints;
        edge.args(["--router", second, "--router", first]);
        edge
    }

    /// Sends a router a signal.
    pub(super) fn send(&self, router: usize, signal: Signal) -> Result<(), Failure> {
        Ok(self.routers[router].send(signal)?)
    }

    /// Starts a router again that has ended.
    pub(super) fn start_again(&mut self, router: usize) -> Result<(), Failure> {
        self.routers[router] = start_router(&self.program, &self.endpoints, router)?;
        Ok(())
    }

    /// The processes of the routers, and that of the hub.
    pub(super) fn ids(&self) -> impl Iterator<Item = u32> {
        let routers = self.routers.iter().map(OwnProcess::id);
        routers.chain([self.hub.id()])
    }
}

/// A command of the program for a task of an edge.
fn edge_of(program: &Path, task: &str, owner: &ServerProcess) -> Program {
    let mut edge = Program::new(program);
    edge.args([task, "--owner", &owner.address.to_string()]);
    edge.args(["--fingerprint", &owner.fingerprint.to_string()]);
    edge
}

fn start_router(
    program: &Path,
    endpoints: &[String; 2],
    number: usize,
) -> Result<OwnProcess, Failure> {
    let mut router = Program::new(program);
    router.args(["router", "--listen", &endpoints[number]]);
    if number > 0 {
        router.args(["--connect", &endpoints[0]]);
    }
    let forwards = |line: &str| line.starts_with("forwarding").then_some(());
    let (process, ()) = OwnProcess::run(&mut router, forwards)?;
    Ok(process)
}

/// An endpoint of UDP that is free now.
fn free_endpoint() -> Result<String, Failure> {
    let socket = UdpSocket::bind("127.0.0.1:0")?;
    Ok(format!("udp/{}", socket.local_addr()?))
}
