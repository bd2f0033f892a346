//! The configuration: a file, then the environment, then the command line.
//!
//! An environment variable `RHUMB_SERVER_NAME` replaces the setting `name`, and `RHUMB_SERVER_LIMITS_NAME` a limit. A
//! name that no setting has is an error.

use std::fmt;
use std::fmt::Write;
use std::fs;
use std::io;
use std::net::SocketAddr;
use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::ValueEnum;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::CellGrid;
use rhumb_scene::engine::EngineKind;
use rhumb_scene::{InvalidLimit, Limits};
use rhumb_transport::PageOrigin;
use serde::{Deserialize, Deserializer};
use toml::{Table, Value};
use tracing::level_filters::LevelFilter;

use crate::access::{DEFAULT_AUDIENCE, KeyFile};
use crate::directory::LeaseSeconds;

/// The place of scenes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, ValueEnum)]
#[serde(rename_all = "lowercase")]
pub(crate) enum WorkerKind {
    /// Each on a thread of the server.
    Threads,
    /// In a process for each tenant.
    Processes,
}

/// All settings of a server but those of APP clients.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(crate) struct ServerSettings {
    pub(crate) listen: SocketAddr,
    pub(crate) cert: Option<PathBuf>,
    pub(crate) key: Option<PathBuf>,
    #[serde(deserialize_with = "parsed_list")]
    pub(crate) token_keys: Vec<KeyFile>,
    pub(crate) audience: String,
    pub(crate) open: bool,
    pub(crate) open_to_network: bool,
    pub(crate) socket: Option<PathBuf>,
    pub(crate) metrics: Option<SocketAddr>,
    pub(crate) view: Option<SocketAddr>,
    pub(crate) data: Option<PathBuf>,
    pub(crate) directory: Option<String>,
    pub(crate) advertise: Option<String>,
    #[serde(deserialize_with = "parsed")]
    pub(crate) lease: LeaseSeconds,
    pub(crate) flight: Option<PathBuf>,
    pub(crate) record: Option<PathBuf>,
    pub(crate) foxglove: Option<SocketAddr>,
    #[serde(deserialize_with = "parsed")]
    pub(crate) log: LevelFilter,
    pub(crate) cores: Vec<usize>,
    #[serde(deserialize_with = "parsed")]
    pub(crate) engine: EngineKind,
    pub(crate) threads: NonZeroU32,
    /// `None`: as [`Self::worker_kind`] has it.
    pub(crate) workers: Option<WorkerKind>,
    pub(crate) agones: bool,
    pub(crate) share_worker: bool,
    #[serde(deserialize_with = "parsed")]
    pub(crate) largest_packet: LargestPacket,
    #[serde(deserialize_with = "parsed_option")]
    pub(crate) cells: Option<CellGrid>,
    pub(crate) web: bool,
    #[serde(deserialize_with = "parsed_list")]
    pub(crate) web_origins: Vec<PageOrigin>,
    pub(crate) limits: Limits,
}

/// Reason why a configuration cannot be used.
#[derive(Debug)]
pub(crate) enum SettingsError {
    Read {
        path: PathBuf,
        cause: io::Error,
    },
    /// The file is not TOML.
    Syntax {
        path: PathBuf,
        cause: Box<toml::de::Error>,
    },
    /// A setting is unknown, or its value is of the wrong kind.
    Setting {
        /// The setting by itself; `None` if it is wrong with others only.
        setting: Option<WrongSetting>,
        cause: Box<toml::de::Error>,
    },
    Limit(InvalidLimit),
}

/// A setting that cannot be read.
#[derive(Debug)]
pub(crate) struct WrongSetting {
    /// The file or the environment variable that has it.
    origin: String,
    name: String,
    value: Value,
}

impl WrongSetting {
    /// The first setting that is wrong by itself, with the reason.
    fn first(table: &Table) -> Option<(String, Value, toml::de::Error)> {
        let alone = |name: &str, value: Value| {
            let table = Table::from_iter([(name.to_owned(), value)]);
            ServerSettings::deserialize(Value::Table(table)).err()
        };
        for (name, value) in table {
            let Value::Table(limits) = value else {
                if let Some(cause) = alone(name, value.clone()) {
                    return Some((name.clone(), value.clone(), cause));
                }
                continue;
            };
            for (limit, value) in limits {
                let one = Table::from_iter([(limit.clone(), value.clone())]);
                if let Some(cause) = alone(name, Value::Table(one)) {
                    return Some((format!("{name}.{limit}"), value.clone(), cause));
                }
            }
        }
        None
    }

    /// The value that the generated file has for it.
    fn example(&self) -> Option<String> {
        let row = ROWS.iter().find(|(name, ..)| *name == self.name);
        let limit = || {
            let name = self.name.strip_prefix("limits.")?;
            let row = Limits::ROWS.iter().find(|row| row.name == name)?;
            Some(row.default.to_string())
        };
        row.map(|(_, example, _)| (*example).to_owned())
            .or_else(limit)
    }
}

/// A value as the file writes it.
fn written(value: &Value) -> String {
    match value {
        Value::String(text) => format!("{text:?}"),
        Value::Integer(number) => number.to_string(),
        Value::Float(number) => number.to_string(),
        Value::Boolean(is_true) => is_true.to_string(),
        Value::Datetime(moment) => moment.to_string(),
        Value::Array(values) => {
            let values: Vec<String> = values.iter().map(written).collect();
            format!("[{}]", values.join(", "))
        }
        Value::Table(_) => "{ … }".to_owned(),
    }
}

impl fmt::Display for WrongSetting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} = {}",
            self.origin,
            self.name,
            written(&self.value)
        )
    }
}

impl fmt::Display for SettingsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Read { path, cause } => write!(f, "cannot read {}: {cause}", path.display()),
            Self::Syntax { path, cause } => write!(f, "{}: {cause}", path.display()),
            Self::Setting { setting, cause } => {
                let Some(setting) = setting else {
                    return write!(f, "the configuration: {}", cause.message());
                };
                write!(f, "{setting}: {}", cause.message())?;
                match setting.example() {
                    Some(example) => write!(f, "; an example is {} = {example}", setting.name),
                    None => Ok(()),
                }
            }
            Self::Limit(cause) => cause.fmt(f),
        }
    }
}

impl std::error::Error for SettingsError {}

/// The first characters of environment variables that replace settings.
const PREFIX: &str = "RHUMB_SERVER_";

/// The settings beside the limits: name, default as the file writes it, meaning.
const ROWS: [(&str, &str, &str); 28] = [
    (
        "listen",
        "\"127.0.0.1:4433\"",
        "UDP address to listen on; port 0 picks a free one.",
    ),
    (
        "cert",
        "\"chain.pem\"",
        "PEM file with the certificate chain; without it the server makes a certificate at start.",
    ),
    (
        "key",
        "\"key.pem\"",
        "PEM file with the certificate's private key.",
    ),
    (
        "token_keys",
        "[]",
        "Files with public keys of tokens; a key signs for all scenes, or as \"FILE=team/*,lobby\" for these. SIGHUP has them read again.",
    ),
    (
        "audience",
        "\"rhumb\"",
        "Name that a token must give as its audience.",
    ),
    (
        "open",
        "false",
        "Admits every client of this machine without a token, for development.",
    ),
    (
        "open_to_network",
        "false",
        "Lets clients without a token come from other machines too, and viewers and readers of figures.",
    ),
    (
        "socket",
        "\"rhumb.sock\"",
        "Path of a Unix socket for clients of this machine, beside the address; only the server's user can connect.",
    ),
    (
        "metrics",
        "\"127.0.0.1:9464\"",
        "TCP address for /metrics and /health; without it there are none.",
    ),
    (
        "view",
        "\"127.0.0.1:8433\"",
        "TCP address of the page in which scenes are seen; without it there is none. Needs the feature `view`.",
    ),
    (
        "data",
        "\"data\"",
        "Directory for command logs and snapshots, from which scenes are restored at start; without it, scenes end with the process.",
    ),
    (
        "directory",
        "\"http://127.0.0.1:2379\"",
        "The etcd cluster that says which of several servers has a scene, with commas between its endpoints; the servers share their data directory. Without it, all scenes are this server's.",
    ),
    (
        "advertise",
        "\"physics.example:4433\"",
        "Address at which clients of the other servers reach this one; without it, the one that it listens on.",
    ),
    (
        "lease",
        "5",
        "Seconds for which the directory holds this server's scenes after its last renewal, from 3 to 30.",
    ),
    (
        "flight",
        "\"flight\"",
        "Directory for the flight recorders of scenes that fault; without it nothing is recorded.",
    ),
    (
        "record",
        "\"recordings\"",
        "Directory for MCAP files with the states of every scene; without it nothing is recorded. Needs the feature `record`.",
    ),
    (
        "foxglove",
        "\"127.0.0.1:8765\"",
        "TCP address at which Foxglove's viewers see every scene live; without it there is none. Needs the feature `foxglove`.",
    ),
    (
        "log",
        "\"info\"",
        "Log level: off, error, warn, info, debug or trace.",
    ),
    ("cores", "[]", "Processor cores to run on; empty for all."),
    (
        "engine",
        "\"rapier\"",
        "Physics engine of all scenes; \"box3d\" needs the feature `box3d` and keeps no data directory.",
    ),
    (
        "threads",
        "1",
        "Threads to step on; more than one needs the feature `parallel`.",
    ),
    (
        "workers",
        "\"threads\"",
        "Where scenes run: \"threads\" of the server, or \"processes\", one for each tenant, which the first part of a scene's name names, up to a slash. A process that does not answer can be killed, and what breaks it breaks no scene of another tenant. Unless set: processes where token_keys are given, on Linux and without foxglove; else threads.",
    ),
    (
        "agones",
        "false",
        "Reports to Agones, by the sidecar of this pod: the server is ready and well, has these scenes, drains.",
    ),
    (
        "share_worker",
        "false",
        "All scenes without a tenant share one worker process; without this, each has its own.",
    ),
    (
        "largest_packet",
        "1100",
        "Largest packet of a stream, bytes, from 700 to 1150.",
    ),
    (
        "cells",
        "50",
        "Edge of the cells along x and z, metres, or \"x,y,z\" with 0 along an axis that is not divided: clients that join by cells have the bodies of those that they take. Without it, no scene is divided.",
    ),
    (
        "web",
        "true",
        "Serves browsers too, by WebTransport at the same address.",
    ),
    (
        "web_origins",
        "[]",
        "Origins of web pages that may connect, as \"https://host:port\", or \"*\" for all; pages of this machine may always.",
    ),
];

/// The settings that a file need not have, and that have no default.
const OPTIONAL: [&str; 13] = [
    "cells",
    "directory",
    "advertise",
    "cert",
    "key",
    "socket",
    "metrics",
    "view",
    "data",
    "flight",
    "record",
    "foxglove",
    "workers",
];

impl Default for ServerSettings {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 4433)),
            cert: None,
            key: None,
            token_keys: Vec::new(),
            audience: DEFAULT_AUDIENCE.to_owned(),
            open: false,
            open_to_network: false,
            socket: None,
            metrics: None,
            view: None,
            data: None,
            directory: None,
            advertise: None,
            lease: LeaseSeconds::default(),
            flight: None,
            record: None,
            foxglove: None,
            log: LevelFilter::INFO,
            cores: Vec::new(),
            engine: EngineKind::default(),
            threads: NonZeroU32::MIN,
            workers: None,
            agones: false,
            share_worker: false,
            largest_packet: LargestPacket::DEFAULT,
            cells: None,
            web: true,
            web_origins: Vec::new(),
            limits: Limits::default(),
        }
    }
}

impl ServerSettings {
    /// Reads a file, if there is one, and applies the environment.
    pub(crate) fn read(
        path: Option<&Path>,
        environment: impl Iterator<Item = (String, String)>,
    ) -> Result<Self, SettingsError> {
        let mut table = match path {
            Some(path) => read_table(path)?,
            None => Table::new(),
        };
        let mut variables = Vec::new();
        for (variable, text) in environment {
            if let Some(name) = variable.strip_prefix(PREFIX) {
                replace(&mut table, &name.to_ascii_lowercase(), &text);
                variables.push(variable);
            }
        }
        let settings = Self::deserialize(Value::Table(table.clone()));
        let settings = settings.map_err(|cause| {
            let Some((name, value, cause)) = WrongSetting::first(&table) else {
                let cause = Box::new(cause);
                return SettingsError::Setting {
                    setting: None,
                    cause,
                };
            };
            let variable = format!("{PREFIX}{}", name.replace('.', "_")).to_ascii_uppercase();
            let is_own = |own: &String| own.to_ascii_uppercase() == variable;
            let file = || path.map(|path| path.display().to_string());
            let origin = variables.into_iter().find(is_own).or_else(file);
            let setting = WrongSetting {
                origin: origin.unwrap_or_else(|| "the configuration".to_owned()),
                name,
                value,
            };
            SettingsError::Setting {
                setting: Some(setting),
                cause: Box::new(cause),
            }
        })?;
        settings.limits.check().map_err(SettingsError::Limit)?;
        Ok(settings)
    }

    /// Where scenes run. Unless it is said, tenants whose clients show tokens have processes of their own: a thread
    /// whose step does not end cannot be killed, and neither its time nor its memory is bounded.
    pub(crate) fn worker_kind(&self) -> WorkerKind {
        let separates = !self.token_keys.is_empty() && self.foxglove.is_none();
        self.workers.unwrap_or({
            if separates && cfg!(target_os = "linux") {
                WorkerKind::Processes
            } else {
                WorkerKind::Threads
            }
        })
    }

    /// A file with every setting at its default.
    pub(crate) fn file() -> String {
        let mut text = String::from(
            "# Configuration of rhumb-server. Each line below is a default; remove the # before it to change it.\n\
             # The environment replaces settings: RHUMB_SERVER_LISTEN, RHUMB_SERVER_LIMITS_SCENES and so on. Flags of\n\
             # the command line replace both.\n",
        );
        for (name, default, meaning) in ROWS {
            text += "\n";
            describe(&mut text, meaning);
            if OPTIONAL.contains(&name) {
                describe(&mut text, "None by default; for example:");
            }
            text += &format!("# {name} = {default}\n");
        }
        text += "\n[limits]\n";
        for row in Limits::ROWS {
            text += "\n";
            for line in row.reason.lines() {
                describe(&mut text, line.trim());
            }
            text += &format!("# {} = {}\n", row.name, row.default);
        }
        text
    }
}

fn describe(text: &mut String, line: &str) {
    // Writing to a text does not fail.
    let _ = writeln!(text, "# {line}");
}

/// A value that has a text form; a number counts as its text.
fn parsed<'de, T, D>(from: D) -> Result<T, D::Error>
where
    T: FromStr<Err: fmt::Display>,
    D: Deserializer<'de>,
{
    let value = Value::deserialize(from)?;
    let text = match &value {
        Value::String(text) => text.clone(),
        Value::Integer(number) => number.to_string(),
        Value::Float(number) => number.to_string(),
        _ => return Err(serde::de::Error::custom("neither a text nor a number")),
    };
    text.parse().map_err(serde::de::Error::custom)
}

/// A value that has a text form and need not be there.
fn parsed_option<'de, T, D>(from: D) -> Result<Option<T>, D::Error>
where
    T: FromStr<Err: fmt::Display>,
    D: Deserializer<'de>,
{
    parsed(from).map(Some)
}

/// Several values that have a text form.
fn parsed_list<'de, T, D>(from: D) -> Result<Vec<T>, D::Error>
where
    T: FromStr<Err: fmt::Display>,
    D: Deserializer<'de>,
{
    let texts = Vec::<String>::deserialize(from)?;
    let parsed = texts.iter().map(|text| text.parse());
    parsed
        .collect::<Result<_, _>>()
        .map_err(serde::de::Error::custom)
}

fn read_table(path: &Path) -> Result<Table, SettingsError> {
    let text = fs::read_to_string(path).map_err(|cause| SettingsError::Read {
        path: path.to_owned(),
        cause,
    })?;
    text.parse().map_err(|cause| SettingsError::Syntax {
        path: path.to_owned(),
        cause: Box::new(cause),
    })
}

/// Replaces a setting by the text of an environment variable, which is a value of TOML or a plain text.
fn replace(table: &mut Table, name: &str, text: &str) {
    let parsed = format!("value = {text}").parse::<Table>().ok();
    let parsed = parsed.and_then(|mut table| table.remove("value"));
    let value = parsed.unwrap_or_else(|| Value::String(text.to_owned()));
    match name.strip_prefix("limits_") {
        None => {
            table.insert(name.to_owned(), value);
        }
        Some(limit) => {
            let limits = table.entry("limits");
            let limits = limits.or_insert_with(|| Value::Table(Table::new()));
            if let Value::Table(limits) = limits {
                limits.insert(limit.to_owned(), value);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of_environment(pairs: &[(&str, &str)]) -> Result<ServerSettings, SettingsError> {
        let pairs = pairs.iter();
        let owned = pairs.map(|(name, text)| ((*name).to_owned(), (*text).to_owned()));
        ServerSettings::read(None, owned)
    }

    #[test]
    fn a_grid_is_an_edge_or_three() {
        let squares = CellGrid::new([50.0, 0.0, 50.0]);
        for text in ["50", "50.0", "\"50\"", "50,0,50"] {
            let settings = of_environment(&[("RHUMB_SERVER_CELLS", text)]).unwrap();
            assert_eq!(settings.cells, squares, "{text}");
        }
        let wrong = of_environment(&[("RHUMB_SERVER_CELLS", "0.5")]).unwrap_err();
        let text = wrong.to_string();
        assert!(
            text.contains("1 to 10000") && text.contains("cells = 50"),
            "{text}"
        );
        assert_eq!(of_environment(&[]).unwrap().cells, None);
    }

    #[test]
    fn the_generated_file_says_the_defaults() {
        let file = ServerSettings::file();
        assert_eq!(file.parse::<Table>().unwrap().len(), 1, "all is commented");
        let mut lines = String::new();
        for line in file.lines() {
            let setting = line.strip_prefix("# ").unwrap_or(line);
            let is_setting = setting.split_once(" = ").is_some_and(|(name, _)| {
                let known = |row: &(&str, &str, &str)| row.0 == name;
                let limit = Limits::ROWS.iter().any(|row| row.name == name);
                !OPTIONAL.contains(&name) && (limit || ROWS.iter().any(known))
            });
            if is_setting || line == "[limits]" {
                lines += setting;
                lines += "\n";
            }
        }
        let table: Table = lines.parse().unwrap();
        assert_eq!(table.len(), ROWS.len() - OPTIONAL.len() + 1);
        let settings = ServerSettings::deserialize(Value::Table(table)).unwrap();
        assert_eq!(settings, ServerSettings::default());
    }

    #[test]
    fn the_environment_replaces_settings_and_limits() {
        let settings = of_environment(&[
            ("RHUMB_SERVER_LISTEN", "0.0.0.0:9000"),
            ("RHUMB_SERVER_OPEN", "true"),
            ("RHUMB_SERVER_DATA", "/var/lib/rhumb"),
            ("RHUMB_SERVER_CORES", "[2, 3]"),
            ("RHUMB_SERVER_LIMITS_SCENES", "4"),
            ("RHUMB_OTHER", "1"),
        ])
        .unwrap();
        assert_eq!(settings.listen, "0.0.0.0:9000".parse().unwrap());
        assert!(settings.open);
        assert_eq!(settings.data, Some("/var/lib/rhumb".into()));
        assert_eq!(settings.cores, [2, 3]);
        assert_eq!(settings.limits.scenes, 4);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn scenes_of_clients_with_tokens_run_in_processes_unless_it_is_said() {
        let keys = ("RHUMB_SERVER_TOKEN_KEYS", "[\"key.pub\"]");
        let threads = ("RHUMB_SERVER_WORKERS", "threads");
        let processes = ("RHUMB_SERVER_WORKERS", "processes");
        let foxglove = ("RHUMB_SERVER_FOXGLOVE", "127.0.0.1:1");
        for (pairs, kind) in [
            (&[][..], WorkerKind::Threads),
            (&[keys], WorkerKind::Processes),
            (&[keys, threads], WorkerKind::Threads),
            (&[processes], WorkerKind::Processes),
            (&[keys, foxglove], WorkerKind::Threads),
        ] {
            let settings = of_environment(pairs).unwrap();
            assert_eq!(settings.worker_kind(), kind, "{pairs:?}");
        }
    }

    #[test]
    fn a_wrong_value_is_named_with_its_place_its_setting_and_an_example() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("server.toml");
        let file = path.display().to_string();
        for (text, parts) in [
            (
                "open = true\nlisten = \"1.2.3.4\"\n",
                ["listen = \"1.2.3.4\": ", "listen = \"127.0.0.1:4433\""],
            ),
            ("log = 7\n", ["log = 7: ", "log = \"info\""]),
            (
                "[limits]\nscenes = \"many\"\n",
                [
                    "limits.scenes = \"many\": ",
                    "an example is limits.scenes = ",
                ],
            ),
        ] {
            fs::write(&path, text).unwrap();
            let error = ServerSettings::read(Some(&path), [].into_iter());
            let error = error.unwrap_err().to_string();
            assert!(error.starts_with(&file), "{error}");
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
        let error = of_environment(&[("RHUMB_SERVER_METRICS", "9464")]).unwrap_err();
        let error = error.to_string();
        assert!(
            error.starts_with("RHUMB_SERVER_METRICS: metrics = 9464: "),
            "{error}"
        );
    }

    #[test]
    fn an_unknown_setting_or_a_limit_out_of_bounds_is_named() {
        for (name, text, named) in [
            ("RHUMB_SERVER_LISTENS", "1", "listens"),
            ("RHUMB_SERVER_LIMITS_SCENERY", "1", "scenery"),
            ("RHUMB_SERVER_LIMITS_SCENES", "0", "limits.scenes"),
            ("RHUMB_SERVER_THREADS", "many", "many"),
            ("RHUMB_SERVER_WEB_ORIGINS", "[\"nowhere\"]", "nowhere"),
        ] {
            let error = of_environment(&[(name, text)]).unwrap_err().to_string();
            assert!(error.contains(named), "{error}");
        }
    }
}
