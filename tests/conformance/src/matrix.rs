//! The matrix: each client tested with each server.
//!
//! Servers are already listening; a client is started anew for each case.

use std::fmt;
use std::io::Write;
use std::net::{SocketAddr, ToSocketAddrs};
use std::str::FromStr;

use rhumb_transport::{Fingerprint, Trust};

use super::case::Case;
use super::conditions::{Conditions, Subject};
use super::outcome::Verdict;
use super::role::Role;
use super::run::{self, Tried};
use super::suite::{self, Selection};

/// A server with a name: `NAME=HOST:PORT,FINGERPRINT`.
#[derive(Clone, Debug)]
pub struct NamedServer {
    pub(super) name: String,
    pub(super) target: SocketAddr,
    pub(super) host: String,
    pub(super) fingerprint: Fingerprint,
}

/// A client with a name: `NAME=COMMAND`.
#[derive(Clone, Debug)]
pub struct NamedClient {
    pub(super) name: String,
    pub(super) exec: String,
}

/// The result of one client with one server.
#[derive(Clone, Debug)]
pub struct Pairing {
    /// The server's name.
    pub server: String,
    /// The client's name.
    pub client: String,
    /// Number of cases that ran.
    pub tried: usize,
    /// Number of these that passed.
    pub passed: usize,
    /// Number of these that the client declares unsupported.
    pub unsupported: usize,
}

/// Runs each client with each server. `conditions` apply to all pairs; only the subject differs.
pub fn run(
    servers: &[NamedServer],
    clients: &[NamedClient],
    selection: &Selection,
    conditions: &Conditions,
    side_by_side: usize,
    progress: &mut (dyn Write + Send),
) -> (Vec<Pairing>, Vec<Tried>) {
    let (mut pairs, mut all) = (Vec::new(), Vec::new());
    for server in servers {
        for client in clients {
            let conditions = Conditions {
                subject: Subject::Pair {
                    target: server.target,
                    name: server.host.clone(),
                    trust: Trust::Fingerprint(server.fingerprint),
                    exec: client.exec.clone(),
                },
                ..conditions.clone()
            };
            let cases = cases(&server.name, &client.name);
            let results = run::run(cases, selection, &conditions, side_by_side, progress);
            let count = |verdict| {
                let outcomes = results.iter().map(|result| &result.outcome);
                outcomes
                    .filter(|outcome| outcome.verdict == verdict && outcome.closing.is_good())
                    .count()
            };
            pairs.push(Pairing {
                server: server.name.clone(),
                client: client.name.clone(),
                tried: results.len(),
                passed: count(Verdict::Pass),
                unsupported: count(Verdict::Unsupported),
            });
            all.extend(results);
        }
    }
    (pairs, all)
}

/// The cases of one pair, with both names appended to the id.
pub(super) fn cases(server: &str, client: &str) -> Vec<Case> {
    let mut cases = suite::cases(Role::Pair);
    for case in &mut cases {
        case.id = format!("{}.{server}.{client}", case.id);
        case.name = format!("{} ({client} with {server})", case.name);
    }
    cases
}

/// The matrix as text: a row for each server, a column for each client.
#[must_use]
pub fn table(pairs: &[Pairing]) -> String {
    let clients = clients_of(pairs);
    let widths = pairs.iter().flat_map(|pair| {
        let cell = pair.to_string().len();
        [pair.server.len(), pair.client.len(), cell]
    });
    let width = widths.max().unwrap_or_default();
    let row = |first: &str, cells: Vec<String>| {
        let cells: String = cells
            .iter()
            .map(|cell| format!("  {cell:>width$}"))
            .collect();
        format!("{first:width$}{cells}\n")
    };
    let names = clients.iter().map(ToString::to_string).collect();
    let mut table = row("", names);
    for (server, cells) in rows(pairs) {
        table += &row(server, cells.into_iter().map(ToString::to_string).collect());
    }
    table
}

/// The names of the clients, in order.
pub(super) fn clients_of(pairs: &[Pairing]) -> Vec<&str> {
    let first = pairs.first().map(|pair| &pair.server);
    let of_first = pairs.iter().filter(|pair| Some(&pair.server) == first);
    of_first.map(|pair| pair.client.as_str()).collect()
}

/// The results of each server with all clients.
pub(super) fn rows(pairs: &[Pairing]) -> Vec<(&str, Vec<&Pairing>)> {
    let rows = pairs.chunk_by(|one, other| one.server == other.server);
    rows.map(|row| (row[0].server.as_str(), row.iter().collect()))
        .collect()
}

impl Pairing {
    /// True if no case failed.
    #[must_use]
    pub const fn is_good(&self) -> bool {
        self.passed + self.unsupported == self.tried
    }
}

impl fmt::Display for Pairing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.passed, self.tried)?;
        match self.unsupported {
            0 => Ok(()),
            lacking => write!(f, ", {lacking} unsupported"),
        }
    }
}

/// Splits `NAME=REST`; the name may be part of a case id.
fn named(text: &str) -> Result<(String, &str), String> {
    let (name, rest) = text.split_once('=').ok_or("expected NAME= at the start")?;
    let is_name = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
    if is_name {
        Ok((name.to_owned(), rest))
    } else {
        Err(format!("{name:?} is not a name: use letters, digits and -"))
    }
}

impl FromStr for NamedServer {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, rest) = named(text)?;
        let (place, fingerprint) = rest
            .rsplit_once(',')
            .ok_or("expected ,FINGERPRINT at the end")?;
        let mut found = (place.to_socket_addrs()).map_err(|error| format!("{place}: {error}"))?;
        let host = place.rsplit_once(':').map_or(place, |(host, _)| host);
        Ok(Self {
            name,
            target: found
                .next()
                .ok_or("the server name resolves to no address")?,
            host: host.trim_matches(['[', ']']).to_owned(),
            fingerprint: fingerprint
                .parse()
                .map_err(|error| format!("{fingerprint}: {error}"))?,
        })
    }
}

impl FromStr for NamedClient {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, exec) = named(text)?;
        let exec = exec.to_owned();
        Ok(Self { name, exec })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn servers_and_clients_are_named() {
        let pin = "ab".repeat(32);
        let server: NamedServer = format!("one=127.0.0.1:4433,{pin}")
            .parse()
            .expect("a valid server argument");
        assert_eq!((server.name.as_str(), server.target.port()), ("one", 4433));
        let client: NamedClient = "two=run it --with=this"
            .parse()
            .expect("a valid client argument");
        assert_eq!(
            (client.name.as_str(), client.exec.as_str()),
            ("two", "run it --with=this")
        );
        for wrong in [
            "127.0.0.1:4433",
            "a.b=127.0.0.1:1,00",
            "one=127.0.0.1:4433",
            "=x",
        ] {
            assert!(wrong.parse::<NamedServer>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_table_has_a_row_for_each_server() {
        let pair = |server: &str, client: &str, passed| Pairing {
            server: server.to_owned(),
            client: client.to_owned(),
            tried: 8,
            passed,
            unsupported: 0,
        };
        let pairs = [pair("rust", "rust", 8), pair("rust", "python", 7)];
        assert_eq!(
            table(&pairs),
            "          rust  python\nrust       8/8     7/8\n"
        );
    }
}
