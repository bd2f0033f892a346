//! The command line of `rhumb-conformance`.
//!
//! Verdicts that are not good go to standard output immediately, the summary last. Exit code 0: all is good; 1: a case
//! is not good; 2: no case could run.

use std::collections::BTreeSet;
use std::fmt;
use std::io::Write;
use std::net::{SocketAddr, ToSocketAddrs};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args, Parser, Subcommand};
use rhumb_netsim::{Carrier, LinkConfig, RawConnection, RawPeerConfig};
use rhumb_protocol::message::Token;
use rhumb_transport::{Fingerprint, Trust};

use super::case::Case;
use super::conditions::{Conditions, Subject};
use super::coverage;
use super::feature::Feature;
use super::matrix::{self, NamedClient, NamedServer, Pairing};
use super::report::{self, Report, RunSettings};
use super::role::Role;
use super::run;
use super::schedule::Profile;
use super::shown_token::ShownToken;
use super::suite::{self, Selection};
use super::trace;

/// Tests implementations of Rhumb over a real connection.
#[derive(Debug, Parser)]
#[command(name = "rhumb-conformance", version, about)]
pub struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Tests a server; the suite plays misbehaving clients.
    Server(ServerTask),
    /// Tests a server with the cases of level L5 only.
    Security(ServerTask),
    /// Tests a client; the suite plays a misbehaving server.
    Client(ClientTask),
    /// Tests a decoder with the golden vectors.
    Vectors(VectorsTask),
    /// Tests each given client with each given server.
    Matrix(MatrixTask),
    /// Checks a recorded run against the accuracy promise.
    Trace(TraceTask),
    /// Lists the requirements that no case tests, with reasons.
    Coverage,
}

#[derive(Debug, Args)]
struct ServerTask {
    /// Host and port of the server.
    #[arg(long, required_unless_present = "list", value_parser = NonEmptyStringValueParser::new())]
    target: Option<String>,
    /// SHA-256 of the server's certificate, as 64 hexadecimal digits.
    #[arg(long, conflicts_with = "roots", required_unless_present_any = ["roots", "list"])]
    fingerprint: Option<Fingerprint>,
    /// PEM file with the root certificates that the server's certificate must chain to.
    #[arg(long)]
    roots: Option<PathBuf>,
    /// The transport of the suite's clients. Over WebTransport the fingerprint is that of the certificate for browsers.
    #[arg(long, value_enum, default_value = "quic")]
    transport: Transport,
    #[command(flatten)]
    shown: ShownToken,
    #[command(flatten)]
    common: Common,
}

/// The transport of the suite's clients to a server.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Transport {
    Quic,
    #[value(name = "webtransport")]
    WebTransport,
}

impl Transport {
    const fn carrier(self) -> Carrier {
        match self {
            Self::Quic => Carrier::Quic,
            Self::WebTransport => Carrier::WebTransport,
        }
    }
}

#[derive(Debug, Args)]
struct ClientTask {
    /// Address to listen on; port 0: another port for each case.
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Command that starts the client.
    #[arg(long, required_unless_present = "list", value_parser = NonEmptyStringValueParser::new())]
    exec: Option<String>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct VectorsTask {
    /// Command that starts the decoder; by default the project's own decoder is tested.
    #[arg(long, value_parser = NonEmptyStringValueParser::new())]
    exec: Option<String>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct MatrixTask {
    /// A server that is already listening; may be repeated.
    #[arg(
        long = "server",
        value_name = "NAME=HOST:PORT,FINGERPRINT",
        required_unless_present = "list"
    )]
    servers: Vec<NamedServer>,
    /// Command that starts a client, as for `client`; may be repeated.
    #[arg(
        long = "client",
        value_name = "NAME=COMMAND",
        required_unless_present = "list"
    )]
    clients: Vec<NamedClient>,
    #[command(flatten)]
    shown: ShownToken,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct TraceTask {
    /// A trace written by `rhumb-bench`, or a recording of a server.
    file: PathBuf,
    /// This load of the trace alone, such as n500, or this scene of the recording.
    #[arg(long, value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    load: Option<String>,
    #[command(flatten)]
    reports: Reports,
}

#[derive(Debug, Args)]
struct Common {
    /// Only list the selected cases.
    #[arg(long)]
    list: bool,
    /// Only these cases: a prefix of an id, or words of a name; `*` matches any text.
    #[arg(long, value_name = "PATTERN", value_parser = NonEmptyStringValueParser::new())]
    case: Vec<String>,
    /// Treat SHOULD as MUST.
    #[arg(long)]
    strict: bool,
    /// Seed of all random numbers.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Seconds that the peer has to answer.
    #[arg(long, default_value = "2", value_parser = seconds)]
    timeout: Duration,
    /// Simulated network between suite and peer, as `rtt=100ms,loss=5%`.
    #[arg(long, default_value = "")]
    link: LinkConfig,
    /// The cases to run.
    #[arg(long, value_enum, default_value = "core")]
    profile: Profile,
    /// Features that the peer declares as missing: it must refuse them.
    #[arg(long, value_enum, value_delimiter = ',')]
    without: Vec<Feature>,
    /// Number of cases that run at a time.
    #[arg(long, default_value = "8")]
    side_by_side: NonZeroUsize,
    #[command(flatten)]
    reports: Reports,
}

#[derive(Debug, Args)]
struct Reports {
    /// The file for the report as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// The file for the report as JUnit XML.
    #[arg(long)]
    junit: Option<PathBuf>,
    /// The file for the report as HTML.
    #[arg(long)]
    html: Option<PathBuf>,
}

/// Parses a positive number of seconds.
fn seconds(text: &str) -> Result<Duration, String> {
    let number: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    let time = Duration::try_from_secs_f64(number).map_err(|error| error.to_string())?;
    if time.is_zero() {
        return Err("the time must be positive".into());
    }
    Ok(time)
}

/// The error of a run without cases, or of a report that was not written.
type BoxError = Box<dyn std::error::Error>;

/// Runs the command that the arguments select.
#[must_use]
pub fn main(arguments: Arguments) -> ExitCode {
    let done = match arguments.task {
        Task::Server(task) => task.run(""),
        Task::Security(task) => task.run("L5"),
        Task::Client(task) => task.run(),
        Task::Vectors(task) => task.run(),
        Task::Matrix(task) => task.run(),
        Task::Trace(task) => task.run(),
        Task::Coverage => show_coverage(),
    };
    match done {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(trouble) => {
            // Standard error is closed too: there is no other place for the message.
            let _ = writeln!(std::io::stderr(), "error: {trouble}");
            ExitCode::from(2)
        }
    }
}

impl ServerTask {
    /// `level`: the prefix of the ids to run.
    fn run(self, level: &str) -> Result<bool, BoxError> {
        let mut cases = suite::cases(Role::Server);
        cases.retain(|case| case.id.starts_with(level));
        if self.common.list {
            return self.common.list(&cases);
        }
        let given = self.target.clone().unwrap_or_default();
        let target = given.to_socket_addrs()?.next();
        let target = target.ok_or("the target name resolves to no address")?;
        let name = given.rsplit_once(':').map_or("localhost", |(host, _)| host);
        let name = name.trim_matches(['[', ']']).to_owned();
        let trust = match (self.fingerprint, self.roots.clone()) {
            (Some(fingerprint), _) => Trust::Fingerprint(fingerprint),
            (None, Some(roots)) => Trust::Roots(roots),
            (None, None) => return Err("the server needs --fingerprint or --roots".into()),
        };
        let subject = Subject::Server {
            target,
            name,
            trust,
        };
        let shown = (self.transport.carrier(), self.shown.read()?);
        self.common.run(given, subject, cases, shown)
    }
}

impl ClientTask {
    fn run(self) -> Result<bool, BoxError> {
        self.common.must_be_core()?;
        let cases = suite::cases(Role::Client);
        if self.common.list {
            return self.common.list(&cases);
        }
        if self.listen.port() != 0 && self.common.side_by_side.get() > 1 {
            return Err(
                "--listen with a port is for --side-by-side 1: each case listens there".into(),
            );
        }
        let exec = self.exec.unwrap_or_default();
        must_be_there(&exec)?;
        let subject = Subject::Client {
            listen: self.listen,
            exec: exec.clone(),
        };
        self.common.run(exec, subject, cases, (Carrier::Quic, None))
    }
}

/// Checks that the shell finds the program of a command. If it does not, the exit status would mean *unsupported*.
fn must_be_there(command: &str) -> Result<(), BoxError> {
    let programme = command.split_whitespace().next().unwrap_or_default();
    if programme.contains(['\'', '"', '\\', '~', '$', '`']) {
        // Only the shell can expand these characters.
        return Ok(());
    }
    let found = Command::new("sh")
        .args(["-c", "command -v \"$0\" >/dev/null", programme])
        .status()?;
    match found.success() {
        true => Ok(()),
        false => Err(format!("{programme:?} is not an executable command").into()),
    }
}

/// Checks that no name occurs twice: a pair is identified by two names.
fn must_differ<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), BoxError> {
    let mut seen = BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(format!("the name {name} occurs twice").into());
        }
    }
    Ok(())
}

impl VectorsTask {
    fn run(self) -> Result<bool, BoxError> {
        self.common.must_be_core()?;
        let cases = suite::cases(Role::Decoder);
        if self.common.list {
            return self.common.list(&cases);
        }
        if self.common.link != LinkConfig::PERFECT || !self.common.without.is_empty() {
            return Err("--link and --without do not apply to a decoder".into());
        }
        self.exec.as_deref().map_or(Ok(()), must_be_there)?;
        let name = self
            .exec
            .clone()
            .unwrap_or_else(|| "built-in decoder".into());
        let exec = self.exec;
        self.common.run(
            name,
            Subject::Decoder { exec },
            cases,
            (Carrier::Quic, None),
        )
    }
}

impl MatrixTask {
    fn run(self) -> Result<bool, BoxError> {
        self.common.must_be_core()?;
        if self.common.list {
            return self.common.list(&suite::cases(Role::Pair));
        }
        self.common.reports.must_have_folders()?;
        must_differ(self.servers.iter().map(|server| server.name.as_str()))?;
        must_differ(self.clients.iter().map(|client| client.name.as_str()))?;
        for server in &self.servers {
            let trust = Trust::Fingerprint(server.fingerprint);
            let common = &self.common;
            common.must_listen(
                &server.name,
                server.target,
                &server.host,
                &trust,
                Carrier::Quic,
            )?;
        }
        for client in &self.clients {
            must_be_there(&client.exec)?;
        }
        let mut cases = Vec::new();
        for server in &self.servers {
            for client in &self.clients {
                cases.extend(matrix::cases(&server.name, &client.name));
            }
        }
        self.common.must_mean(&cases)?;
        let token = self.shown.read()?;
        // The subject is replaced for each pair.
        let conditions = self
            .common
            .conditions(Subject::Decoder { exec: None }, (Carrier::Quic, token));
        let (pairs, results) = matrix::run(
            &self.servers,
            &self.clients,
            &self.common.selection(),
            &conditions,
            self.common.side_by_side.get(),
            &mut std::io::stdout(),
        );
        write!(std::io::stdout(), "{}", matrix::table(&pairs))?;
        self.common.conclude("pairs".into(), results, pairs)
    }
}

impl TraceTask {
    fn run(self) -> Result<bool, BoxError> {
        self.reports.must_have_folders()?;
        let judged = trace::judge(&self.file, self.load.as_deref());
        let trace::Judged {
            tried: results,
            note,
        } = judged.map_err(|error| named(&self.file, &error))?;
        let mut out = std::io::stdout();
        if let Some(note) = note {
            writeln!(out, "{note}")?;
        }
        for result in &results {
            let (word, why) = (result.outcome.verdict.word(), &result.outcome.why);
            writeln!(out, "{word:12} {:?} {why}", result.case)?;
        }
        self.reports.conclude(&Report {
            subject: self.file.display().to_string(),
            config: None,
            strict: false,
            results,
            pairs: Vec::new(),
            coverage: coverage::coverage(),
        })
    }
}

impl Common {
    /// Rejects `--profile` where only one profile exists: only a server has a physics engine.
    fn must_be_core(&self) -> Result<(), BoxError> {
        match self.profile {
            Profile::Core => Ok(()),
            _ => Err("--profile applies to servers only".into()),
        }
    }

    fn selection(&self) -> Selection {
        Selection {
            patterns: self.case.clone(),
            profile: self.profile,
            without: self.without.clone(),
        }
    }

    /// Checks that each pattern selects a case, and that the selection is not empty.
    fn must_mean(&self, cases: &[Case]) -> Result<(), BoxError> {
        for pattern in &self.case {
            if !cases.iter().any(|case| case.is_selected_by(pattern)) {
                return Err(format!("--case {pattern:?} selects no case").into());
            }
        }
        let selection = self.selection();
        if !cases.iter().any(|case| selection.wants(case)) {
            return Err("this --profile contains none of the selected cases".into());
        }
        Ok(())
    }

    /// Checks that the server listens and presents the expected certificate. Otherwise each case would wait for it and
    /// fail.
    fn must_listen(
        &self,
        sent: &str,
        target: SocketAddr,
        name: &str,
        trust: &Trust,
        carrier: Carrier,
    ) -> Result<(), BoxError> {
        let config = RawPeerConfig::over(carrier);
        let line = RawConnection::connect(target, name, trust, &config, self.timeout * 2);
        let line = line.map_err(|error| format!("the server {sent} cannot be reached: {error}"))?;
        line.close(0);
        Ok(())
    }

    fn list(&self, cases: &[Case]) -> Result<bool, BoxError> {
        self.must_mean(cases)?;
        let selection = self.selection();
        let mut out = std::io::stdout().lock();
        for case in cases.iter().filter(|case| selection.wants(case)) {
            writeln!(out, "{case:?}")?;
        }
        Ok(true)
    }

    fn conditions(
        &self,
        subject: Subject,
        (carrier, token): (Carrier, Option<Token>),
    ) -> Conditions {
        Conditions {
            subject,
            carrier,
            timeout: self.timeout,
            seed: self.seed,
            link: self.link,
            without: self.without.clone(),
            token,
        }
    }

    fn config(&self) -> RunSettings {
        RunSettings {
            seed: self.seed,
            timeout_s: self.timeout.as_secs_f64(),
            link: self.link,
            profile: self.profile,
            without: self.without.clone(),
        }
    }

    fn run(
        self,
        name: String,
        subject: Subject,
        cases: Vec<Case>,
        (carrier, token): (Carrier, Option<Token>),
    ) -> Result<bool, BoxError> {
        self.must_mean(&cases)?;
        self.reports.must_have_folders()?;
        if let Subject::Server {
            target,
            name: host,
            trust,
        } = &subject
        {
            self.must_listen(&name, *target, host, trust, carrier)?;
        }
        let (conditions, selection) =
            (self.conditions(subject, (carrier, token)), self.selection());
        let (at_a_time, mut out) = (self.side_by_side.get(), std::io::stdout());
        let results = run::run(cases, &selection, &conditions, at_a_time, &mut out);
        self.conclude(name, results, Vec::new())
    }

    /// Writes the reports; returns whether all is good.
    fn conclude(
        &self,
        subject: String,
        results: Vec<run::Tried>,
        pairs: Vec<Pairing>,
    ) -> Result<bool, BoxError> {
        self.reports.conclude(&Report {
            subject,
            config: Some(self.config()),
            strict: self.strict,
            results,
            pairs,
            coverage: coverage::coverage(),
        })
    }
}

impl Reports {
    /// Checks, before any case runs, that the reports can be written.
    fn must_have_folders(&self) -> Result<(), BoxError> {
        for path in [&self.json, &self.junit, &self.html].into_iter().flatten() {
            let folder = path.parent().filter(|folder| *folder != Path::new(""));
            if folder.is_some_and(|folder| !folder.is_dir()) {
                return Err(named(path, &"its folder does not exist"));
            }
            if path.is_dir() {
                return Err(named(path, &"it is a folder, not a file"));
            }
        }
        Ok(())
    }

    /// Prints the summary, writes the reports, returns whether all is good.
    fn conclude(&self, report: &Report) -> Result<bool, BoxError> {
        // The summary comes first: a failing write must not cost the results.
        writeln!(std::io::stdout(), "{}", report.summary())?;
        if let Some(path) = &self.json {
            write(path, &report::json(report))?;
        }
        if let Some(path) = &self.junit {
            write(path, &report::junit(report)?)?;
        }
        if let Some(path) = &self.html {
            write(path, &report::html(report))?;
        }
        Ok(report.passed())
    }
}

fn write(path: &Path, text: &str) -> Result<(), BoxError> {
    std::fs::write(path, text).map_err(|error| named(path, &error))
}

/// An error message with the name of its file.
fn named(path: &Path, error: &dyn fmt::Display) -> BoxError {
    format!("{}: {error}", path.display()).into()
}

fn show_coverage() -> Result<bool, BoxError> {
    let mut out = std::io::stdout().lock();
    let coverage = coverage::coverage();
    for one in &coverage {
        let cases = match (&one.reason, one.cases.len()) {
            (Some(reason), 0) => format!("no case: {reason}"),
            (None, 0) => "NO CASE, NO REASON".to_owned(),
            (_, count) => format!("{count} cases"),
        };
        writeln!(
            out,
            "{:18} {:6} {cases}",
            one.requirement.to_string(),
            one.requirement.level.to_string()
        )?;
    }
    let holes = coverage::holes();
    writeln!(
        out,
        "{} requirements, {} holes",
        coverage.len(),
        holes.len()
    )?;
    Ok(holes.is_empty())
}
