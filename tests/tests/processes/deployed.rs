//! The set of `deploy/compose.yaml` as processes of one machine.
//!
//! A directory, two servers, an edge before them, and two edges for members. Every command is that of the file; only
//! addresses and folders are replaced. Members of both edges go with a scene that moves and whose server is killed: equal
//! digests mean that no command was lost, doubled or moved to another tick.

use std::collections::BTreeMap;
use std::fs;
use std::net::SocketAddr;
use std::path::Path;
use std::time::{Duration, Instant};

use rhumb_client::scene::SceneConfig;
use rhumb_client::{Client, JoinMode, JoinOptions, Tick, Trust};
use rhumb_tests::ServerProcess;
use rhumb_transport::DevelopmentPem;

use crate::SERVER;
use crate::access::{make_key, token};
use crate::directory::Etcd;
use crate::durable::{LONG, Run, ids_of_the_run};
use crate::hostile_load::free_address;

/// The commands of a compose file's services; each stands on one line.
fn commands(file: &str) -> BTreeMap<String, Vec<String>> {
    let (_, services) = file.split_once("\nservices:\n").expect("it has services");
    let (mut name, mut commands) = (String::new(), BTreeMap::new());
    for line in services.lines() {
        if let Some(command) = line.strip_prefix("    command: ") {
            let command = serde_json::from_str(command).expect("a list of texts");
            commands.insert(name.clone(), command);
        } else if let Some(service) = line.strip_prefix("  ")
            && !service.starts_with([' ', '#'])
        {
            name = service.trim_end_matches(':').to_owned();
        }
    }
    commands
}

/// The services of the file on this machine.
struct Set {
    commands: BTreeMap<String, Vec<String>>,
    /// Addresses and folders of the file, as they are here.
    here: BTreeMap<String, String>,
}

impl Set {
    /// `secrets` has the files of the file's secrets.
    fn new(file: &str, data: &Path, secrets: &Path, etcd: &Etcd) -> Self {
        let commands = commands(file);
        let path = |path: &Path| path.to_str().expect("text").to_owned();
        let mut here = BTreeMap::from([
            ("/data".to_owned(), path(data)),
            ("http://etcd:2379".to_owned(), etcd.endpoint.clone()),
        ]);
        for secret in fs::read_dir(secrets).expect("a folder") {
            let secret = secret.expect("a file");
            let name = secret.file_name().into_string().expect("text");
            here.insert(format!("/run/secrets/{name}"), path(&secret.path()));
        }
        for service in commands.keys() {
            here.insert(format!("{service}:4433"), free_address());
        }
        // Here no name has the addresses of both.
        here.insert("servers:4433".to_owned(), here["server-1:4433"].clone());
        Self { commands, here }
    }

    fn address(&self, service: &str) -> SocketAddr {
        self.here[&format!("{service}:4433")]
            .parse()
            .expect("an address")
    }

    fn start(&self, service: &str) -> ServerProcess {
        let own = self.address(service).to_string();
        // Bound as in the set, where a server asks whether that is meant.
        let metrics = free_address().replace("127.0.0.1", "0.0.0.0");
        let argument = |argument: &String| match argument.as_str() {
            "0.0.0.0:4433" => own.clone(),
            "0.0.0.0:9100" => metrics.clone(),
            other => self.here.get(other).cloned().unwrap_or(other.to_owned()),
        };
        let command: Vec<_> = self.commands[service].iter().map(argument).collect();
        assert!(
            !command.iter().any(|word| word.starts_with("/run/")),
            "{command:?}"
        );
        SERVER.start(&command.iter().map(String::as_str).collect::<Vec<_>>())
    }
}

#[test]
fn members_of_both_edges_stay_in_a_scene_that_moves_and_whose_server_is_killed() {
    let Some(etcd) = Etcd::start() else { return };
    let folder = tempfile::tempdir().expect("a temporary directory");
    let (data, secrets) = (folder.path().join("data"), folder.path().join("secrets"));
    fs::create_dir(&secrets).expect("a folder");
    make_key(&secrets, "token.key");
    let key = secrets.join("token.key");
    let key = key.to_str().expect("text");
    let made = DevelopmentPem::new(["127.0.0.1"]).expect("a certificate");
    let write = |name: &str, text: &str| fs::write(secrets.join(name), text).expect("a file");
    write("server.crt", &made.certificate);
    write("roots.crt", &made.certificate);
    write("server.key", &made.key);
    write("edge.token", &token(key, "edge", "*", "observer", &[]));
    let file = include_str!("../../../deploy/compose.yaml");
    let set = Set::new(file, &data, &secrets, &etcd);
    let servers = [set.start("server-1"), set.start("server-2")];
    let _edges = ["router", "edge-1", "edge-2"].map(|service| set.start(service));

    let trust = || Trust::Roots(secrets.join("roots.crt"));
    let member = |edge: &str, client: &str, role: &str, mode: JoinMode| {
        let address = set.address(edge).to_string();
        let connection = Client::connect_within(&address, trust(), LONG).expect("it answers");
        let connection = connection.token(&token(key, client, "*", role, &[]));
        let options = JoinOptions {
            mode,
            ..JoinOptions::default()
        };
        connection
            .join_with("pit", options)
            .expect("it is admitted")
    };
    let create = JoinMode::Create(SceneConfig::default());
    let mut owner = member("edge-1", "anna", "owner", create);
    let ids = ids_of_the_run(&mut owner);
    let run = Run::start(owner, ids);
    run.go(20);
    let mut observer = member("edge-2", "ben", "observer", JoinMode::Join);
    let mut sees = |run: &Run, when: &str| {
        let (tick, begun) = (run.ticks(), Instant::now());
        while observer.statistics().complete < Tick::new(tick) {
            assert!(begun.elapsed() < LONG, "the observer sees the scene {when}");
            observer
                .idle(Duration::from_millis(1))
                .expect("it is there");
            while observer.poll_event().is_some() {}
        }
    };
    sees(&run, "at first");
    let to = set.address("server-2").to_string();
    let moved = SERVER.run(&["move", "pit", "--to", &to, "--directory", &etcd.endpoint]);
    assert_eq!(moved.code, Some(0), "{}{}", moved.out, moved.log);
    run.go(20);
    sees(&run, "after a move");
    let [_one, other] = servers;
    other.kill();
    run.go(20);
    sees(&run, "after the end of its server");
    assert!(run.end().seen.resumed >= 1);
}
