//! `rhumb-server move` and `drain`: orders in the directory.
//!
//! Everyone who may write to the directory may order: no server has a door for this. An order ends by itself if nothing
//! comes of it.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::time::Duration;

use clap::Args;
use rhumb_protocol::Span;
use rhumb_protocol::scene::SceneName;
use rhumb_transport::{Clock, io_runtime};
use tokio::time::sleep;

use super::claims::{LeaseId, ServerPlace};
use super::etcd::{Endpoints, Etcd};
use super::handovers::{Board, Notice};

/// The scene that is to move.
#[derive(Debug, Args)]
pub(crate) struct MoveArguments {
    /// The scene.
    scene: SceneName,
    /// The server that is to have it: the address, host:port, that it advertises.
    #[arg(long, value_name = "ADDRESS")]
    to: String,
    /// The directory of the servers: their `--directory`.
    #[arg(long, value_name = "ENDPOINTS")]
    directory: Endpoints,
}

/// The server that is to have no scenes.
#[derive(Debug, Args)]
pub(crate) struct DrainArguments {
    /// The address, host:port, that the server advertises.
    server: String,
    /// The directory of the servers: their `--directory`.
    #[arg(long, value_name = "ENDPOINTS")]
    directory: Endpoints,
}

/// Time for a move, after which its order ends.
const ORDER_SECONDS: u64 = 30;
const ORDER: Span = Span::from_millis(ORDER_SECONDS * 1_000);
/// Time between two looks at the directory.
const LOOK: Duration = Duration::from_millis(50);
/// Scenes of a drained server that move at the same time.
const AT_ONCE: usize = 4;

type Failure = Box<dyn Error>;

/// Moves a scene, and returns once the other server has it.
///
/// # Errors
///
/// The directory's silence, a scene or a server that it does not have, and a move that does not happen.
pub(crate) fn run_move(arguments: &MoveArguments, out: &mut dyn Write) -> Result<(), Failure> {
    io_runtime()?.block_on(async {
        let operator = Operator::begin(&arguments.directory).await?;
        let scene = &arguments.scene;
        let board = operator.board().await?;
        let to = server_at(&board, &arguments.to)?;
        let owner = operator.etcd.owner_of(scene).await.ok_or(SILENT)?;
        let Some(from) = owner else {
            return Err(format!(
                "no server has the scene {scene}: the first that a client asks for it takes it"
            )
            .into());
        };
        if from == to {
            writeln!(out, "{scene} is there already")?;
            return Ok(());
        }
        operator.order(scene, &to).await?;
        let took = operator.wait(scene, &to).await?;
        writeln!(out, "{scene} moved to {} in {took} ms", address_of(&to))?;
        operator.end().await;
        Ok(())
    })
}

/// Moves all scenes of a server to others, and has it take no scene any more until it ends.
///
/// # Errors
///
/// The directory's silence, a server that it does not have, no other server, and scenes that have not moved.
pub(crate) fn run_drain(arguments: &DrainArguments, out: &mut dyn Write) -> Result<(), Failure> {
    io_runtime()?.block_on(async {
        let operator = Operator::begin(&arguments.directory).await?;
        let board = operator.board().await?;
        let from = server_at(&board, &arguments.server)?;
        let mut scenes_of = others(&board, &from)?;
        // The notice ends with the server.
        let lease = board.servers[&from];
        let drained = Notice::Drained(from.clone());
        (operator.etcd.post(lease, &drained).await)
            .then_some(())
            .ok_or(SILENT)?;
        let (mut moved, mut stay) = (0, Vec::new());
        loop {
            let scenes = operator.etcd.scenes().await.ok_or(SILENT)?;
            let mut left = Vec::new();
            scenes_of.values_mut().for_each(|scenes| *scenes = 0);
            for (scene, owner) in scenes {
                if owner == from {
                    if !stay.contains(&scene) {
                        left.push(scene);
                    }
                } else if let Some(scenes) = scenes_of.get_mut(&owner) {
                    *scenes += 1;
                }
            }
            if left.is_empty() {
                operator.end().await;
                return report(out, (&arguments.server, moved), &stay);
            }
            left.truncate(AT_ONCE);
            let mut ordered = Vec::new();
            for scene in left {
                let to = fewest(&mut scenes_of);
                operator.order(&scene, &to).await?;
                ordered.push((scene, to));
            }
            for (scene, to) in ordered {
                match operator.wait(&scene, &to).await {
                    Ok(took) => {
                        writeln!(out, "{scene} moved to {} in {took} ms", address_of(&to))?;
                        moved += 1;
                    }
                    Err(cause) => {
                        writeln!(out, "{cause}")?;
                        stay.push(scene);
                    }
                }
            }
        }
    })
}

/// Says where the scenes of a server are now.
fn report(
    out: &mut dyn Write,
    (server, moved): (&str, usize),
    stay: &[SceneName],
) -> Result<(), Failure> {
    if stay.is_empty() {
        writeln!(out, "{server} has no scenes any more; {moved} moved")?;
        return Ok(());
    }
    let stay: Vec<_> = stay.iter().map(SceneName::as_str).collect();
    Err(format!("{server} still has {}; {moved} moved", stay.join(", ")).into())
}

const SILENT: &str = "the directory does not answer: check its endpoints, and that etcd runs";

/// One who orders moves.
struct Operator {
    etcd: Etcd,
    lease: LeaseId,
    clock: Clock,
}

impl Operator {
    async fn begin(directory: &Endpoints) -> Result<Self, Failure> {
        let etcd = Etcd::new(directory.clone());
        let lease = etcd.grant(ORDER_SECONDS).await.ok_or(SILENT)?;
        let clock = Clock::start();
        Ok(Self { etcd, lease, clock })
    }

    async fn board(&self) -> Result<Board, Failure> {
        Ok(self.etcd.read_board().await.ok_or(SILENT)?)
    }

    async fn order(&self, scene: &SceneName, to: &ServerPlace) -> Result<(), Failure> {
        let order = Notice::Order(scene.clone(), to.clone());
        let posted = self.etcd.renew(self.lease).await && self.etcd.post(self.lease, &order).await;
        posted.then_some(()).ok_or_else(|| SILENT.into())
    }

    /// Waits until a server has a scene; the milliseconds since this call.
    async fn wait(&self, scene: &SceneName, to: &ServerPlace) -> Result<u64, Failure> {
        let begun = self.clock.now();
        loop {
            let waited = self.clock.now().since(begun);
            if self.etcd.owner_of(scene).await.flatten().as_ref() == Some(to) {
                return Ok(waited.as_nanos() / 1_000_000);
            }
            let board = self.etcd.read_board().await;
            if board.is_some_and(|board| board.refused.get(scene) == Some(to)) {
                self.take_back(scene, to).await;
                return Err(format!(
                    "{scene} stays where it is: it has no files by which it could move, as a scene that one client \
                     owns"
                )
                .into());
            }
            if waited >= ORDER {
                let address = address_of(to);
                return Err(format!(
                    "{scene} has not moved to {address} in {ORDER_SECONDS} s, and the order has ended: the logs of both servers \
                     say why"
                )
                .into());
            }
            sleep(LOOK).await;
        }
    }

    /// Takes an order back, and the notice that nothing can come of it. What stays there ends with its lease.
    async fn take_back(&self, scene: &SceneName, to: &ServerPlace) {
        for notice in [Notice::Order, Notice::Refused] {
            self.etcd.remove(&notice(scene.clone(), to.clone())).await;
        }
    }

    /// Ends the lease of the orders, which are done.
    async fn end(&self) {
        if !self.etcd.revoke(self.lease).await {
            tracing::warn!(
                "the directory did not take the end of the orders: they end by themselves"
            );
        }
    }
}

/// `host:port` of a place.
fn address_of(place: &ServerPlace) -> &str {
    let address = place.0.split('#').next().unwrap_or_default();
    address.strip_prefix("rhumb://").unwrap_or(address)
}

fn server_at(board: &Board, address: &str) -> Result<ServerPlace, Failure> {
    let mut servers = board.servers.keys();
    if let Some(found) = servers.find(|place| address_of(place) == address) {
        return Ok(found.clone());
    }
    let there: Vec<_> = board.servers.keys().map(address_of).collect();
    let there = match there.is_empty() {
        true => "it has none".to_owned(),
        false => format!("it has {}", there.join(", ")),
    };
    Err(format!("the directory has no server at {address}: {there}").into())
}

/// The servers that take scenes, but for one, each without scenes yet.
fn others(board: &Board, but: &ServerPlace) -> Result<BTreeMap<ServerPlace, usize>, Failure> {
    let others: BTreeMap<_, _> = (board.taking(but))
        .map(|place| (place.clone(), 0))
        .collect();
    match others.is_empty() {
        true => Err("there is no other server that takes scenes".into()),
        false => Ok(others),
    }
}

/// The server with the fewest scenes, which gets one more. There is one.
fn fewest(scenes_of: &mut BTreeMap<ServerPlace, usize>) -> ServerPlace {
    let fewest = scenes_of.iter_mut().min_by_key(|(_, scenes)| **scenes);
    let (place, scenes) = fewest.expect("there is one server at least");
    *scenes += 1;
    place.clone()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board() -> Board {
        let place = |name: &str| ServerPlace(format!("rhumb://{name}:1#00"));
        let servers = [
            (place("a"), LeaseId(1)),
            (place("b"), LeaseId(2)),
            (place("c"), LeaseId(3)),
        ];
        Board {
            servers: servers.into(),
            drained: [(place("c"), LeaseId(3))].into(),
            ..Board::default()
        }
    }

    #[test]
    fn a_server_is_found_by_the_address_that_it_advertises() {
        let found = server_at(&board(), "a:1").expect("it is there");
        assert_eq!(found.0, "rhumb://a:1#00");
        let missing = server_at(&board(), "d:1").expect_err("it is not there");
        assert!(missing.to_string().contains("a:1, b:1, c:1"), "{missing}");
    }

    #[test]
    fn scenes_go_to_the_servers_with_the_fewest_of_them() {
        let from = server_at(&board(), "a:1").expect("it is there");
        let mut others = others(&board(), &from).expect("there is one");
        assert_eq!(others.len(), 1, "c is drained");
        others.insert(ServerPlace("rhumb://d:1".to_owned()), 5);
        let first: Vec<_> = (0..7).map(|_| fewest(&mut others)).collect();
        let of_d = first.iter().filter(|place| place.0.contains("d:1"));
        assert_eq!(of_d.count(), 1, "the seventh");
        let alone = Board {
            servers: [(from.clone(), LeaseId(1))].into(),
            ..Board::default()
        };
        assert!(super::others(&alone, &from).is_err());
    }
}
