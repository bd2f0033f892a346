//! Hellos from invented addresses.
//!
//! Each makes the server begin a handshake or ask for proof of the address, and nothing ever answers. The number is
//! 20,000 unless `RHUMB_TEST_HELLOS` gives another.

use rhumb_client::{Client, Trust};
use rhumb_netsim::InventedClients;
use rhumb_tests::ServerProcess;

use crate::SERVER;

/// Bytes by which the server's memory may grow.
const GROWTH_MAX: u64 = 10 << 20;

/// Resident bytes of a process.
fn resident(process: u32) -> u64 {
    let path = format!("/proc/{process}/status");
    let status = std::fs::read_to_string(path).expect("the server runs");
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.trim().strip_suffix(" kB"));
    let kib: u64 = kib.and_then(|kib| kib.parse().ok()).expect("a number");
    kib << 10
}

fn join_and_leave(server: &ServerProcess, scene: &str) {
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection = Client::connect(&server.address.to_string(), trust).expect("it is admitted");
    let mut client = connection.join(scene).expect("the scene begins");
    client.delete().expect("the scene ends");
}

#[test]
fn hellos_of_invented_clients_cost_no_memory_and_keep_no_client_out() {
    let hellos = std::env::var("RHUMB_TEST_HELLOS").map_or(20_000, |count| {
        count.parse::<u32>().expect("RHUMB_TEST_HELLOS is a number")
    });
    let server = SERVER.serve_with("127.0.0.1:0", &[]);
    let trust = Trust::Fingerprint(server.fingerprint);
    let mut invented = InventedClients::new(server.address, &trust).expect("a trust");
    let mut flood = |count: u32| {
        for _ in 0..count {
            invented.send().expect("loopback has such addresses");
        }
    };
    // Memory for the first clients and handshakes is kept, and is no growth.
    join_and_leave(&server, "first");
    flood(2_000);
    let before = resident(server.id());
    for part in 0..8 {
        flood(hellos / 8);
        join_and_leave(&server, &format!("scene-{part}"));
    }
    let grown = resident(server.id()).saturating_sub(before);
    assert!(grown < GROWTH_MAX, "{grown} bytes for {hellos} hellos");
    println!("{hellos} hellos: {grown} bytes more than {before}");
}
