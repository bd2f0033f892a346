//! The command line of `rhumb-conformance`.
//!
//! Verdicts that are not good go to standard output as they come, the summary last. Exit code 0: all is good; 1: something
//! is not; 2: nothing could be tried.

use std::collections::BTreeSet;
use std::fmt;
use std::io::Write;
use std::net::{SocketAddr, ToSocketAddrs};
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Duration;

use clap::{Args, Parser, Subcommand};
use rhumb_transport::{Fingerprint, LinkConfig, RawConnection, RawPeerConfig, Trust};

use super::case::{Case, Feature, Profile, Role};
use super::coverage;
use super::matrix::{self, NamedClient, NamedServer, Pairing};
use super::report::{self, Report, RunSettings};
use super::run;
use super::suite::{self, Selection};
use super::trace;
use super::trial::{Conditions, Subject};

/// Tries implementations of Rhumb over the real wire.
#[derive(Debug, Parser)]
#[command(name = "rhumb-conformance", version, about)]
pub struct Arguments {
    #[command(subcommand)]
    task: Task,
}

#[derive(Debug, Subcommand)]
enum Task {
    /// Tries a server, as clients that behave badly.
    Server(ServerTask),
    /// Tries a server by the cases of level L5 alone.
    Security(ServerTask),
    /// Tries a client, as a server that behaves badly.
    Client(ClientTask),
    /// Tries who reads bytes by the golden vectors.
    Vectors(VectorsTask),
    /// Tries each of some clients with each of some servers.
    Matrix(MatrixTask),
    /// Judges a recorded run by the promise.
    Trace(TraceTask),
    /// Says which requirements no case tries, and why.
    Coverage,
}

#[derive(Debug, Args)]
struct ServerTask {
    /// Host and port of the server.
    #[arg(long, required_unless_present = "list")]
    target: Option<String>,
    /// SHA-256 of the server's certificate, as 64 hexadecimal digits.
    #[arg(long, conflicts_with = "roots", required_unless_present_any = ["roots", "list"])]
    fingerprint: Option<Fingerprint>,
    /// PEM file with the roots that watermark for the server.
    #[arg(long)]
    roots: Option<PathBuf>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct ClientTask {
    /// Where to listen; port 0: each case elsewhere.
    #[arg(long, default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// The command that starts the client.
    #[arg(long, required_unless_present = "list")]
    exec: Option<String>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct VectorsTask {
    /// The command that starts the decoder; without one this house's own is tried.
    #[arg(long)]
    exec: Option<String>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct MatrixTask {
    /// A server that listens; as often as there are some.
    #[arg(
        long = "server",
        value_name = "NAME=HOST:PORT,FINGERPRINT",
        required_unless_present = "list"
    )]
    servers: Vec<NamedServer>,
    /// The command that starts a client, as for `client`; as often as there are some.
    #[arg(
        long = "client",
        value_name = "NAME=COMMAND",
        required_unless_present = "list"
    )]
    clients: Vec<NamedClient>,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Args)]
struct TraceTask {
    /// A trace of `rhumb-bench`.
    file: PathBuf,
    #[command(flatten)]
    reports: Reports,
}

#[derive(Debug, Args)]
struct Common {
    /// Only shows which cases would be tried.
    #[arg(long)]
    list: bool,
    /// Only these cases: the beginning of an id, or words of a name, `*` for anything.
    #[arg(long, value_name = "PATTERN")]
    case: Vec<String>,
    /// What should be counts as what must be.
    #[arg(long)]
    strict: bool,
    /// Of all chance.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Seconds that an answer may take.
    #[arg(long, default_value = "2", value_parser = seconds)]
    timeout: Duration,
    /// What lies between the ends, as `rtt=100ms,loss=5%`.
    #[arg(long, default_value = "")]
    link: LinkConfig,
    /// How much is wanted.
    #[arg(long, value_enum, default_value = "core")]
    profile: Profile,
    /// What the peer says that it has not: it must then refuse it.
    #[arg(long, value_enum, value_delimiter = ',')]
    without: Vec<Feature>,
    /// Cases that run at a time.
    #[arg(long, default_value = "8")]
    side_by_side: NonZeroUsize,
    #[command(flatten)]
    reports: Reports,
}

#[derive(Debug, Args)]
struct Reports {
    /// Where to write a report as JSON.
    #[arg(long)]
    json: Option<PathBuf>,
    /// Where to write a report as JUnit XML.
    #[arg(long)]
    junit: Option<PathBuf>,
    /// Where to write a report as a page.
    #[arg(long)]
    html: Option<PathBuf>,
}

/// A time that is not none.
fn seconds(text: &str) -> Result<Duration, String> {
    let number: f64 = text.parse().map_err(|_| "no number".to_owned())?;
    let time = Duration::try_from_secs_f64(number).map_err(|error| error.to_string())?;
    if time.is_zero() {
        return Err("nothing answers in no time".into());
    }
    Ok(time)
}

/// Why nothing was tried, or a report not written.
type BoxError = Box<dyn std::error::Error>;

/// Does what the arguments say.
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
            // Nowhere is left to say that this failed.
            let _ = writeln!(std::io::stderr(), "error: {trouble}");
            ExitCode::from(2)
        }
    }
}

impl ServerTask {
    /// `level`: the beginning of the ids that are tried.
    fn run(self, level: &str) -> Result<bool, BoxError> {
        let mut cases = suite::cases(Role::Server);
        cases.retain(|case| case.id.starts_with(level));
        if self.common.list {
            return self.common.list(&cases);
        }
        let given = self.target.clone().unwrap_or_default();
        let target = given.to_socket_addrs()?.next();
        let target = target.ok_or("the target has no address")?;
        let name = given.rsplit_once(':').map_or("localhost", |(host, _)| host);
        let name = name.trim_matches(['[', ']']).to_owned();
        let trust = match (self.fingerprint, self.roots.clone()) {
            (Some(fingerprint), _) => Trust::Fingerprint(fingerprint),
            (None, Some(roots)) => Trust::Roots(roots),
            (None, None) => return Err("a server is known by --fingerprint or --roots".into()),
        };
        let subject = Subject::Server {
            target,
            name,
            trust,
        };
        self.common.run(given, subject, cases)
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
        self.common.run(exec, subject, cases)
    }
}

/// Whether the shell finds what a command starts: it ends with the status that says *unsupported* where it does not.
fn must_be_there(command: &str) -> Result<(), BoxError> {
    let programme = command.split_whitespace().next().unwrap_or_default();
    if programme.contains(['\'', '"', '\\', '~', '$', '`']) {
        // What the shell makes of it only the shell knows.
        return Ok(());
    }
    let found = Command::new("sh")
        .args(["-c", "command -v \"$0\" >/dev/null", programme])
        .status()?;
    match found.success() {
        true => Ok(()),
        false => Err(format!("{programme:?} is no command that is there").into()),
    }
}

/// That no name is sent twice: a pair is known by two.
fn must_differ<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), BoxError> {
    let mut seen = BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            return Err(format!("two are called {name}").into());
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
            return Err("--link and --without are of peers: bytes are read without them".into());
        }
        self.exec.as_deref().map_or(Ok(()), must_be_there)?;
        let name = self.exec.clone().unwrap_or_else(|| "this house".into());
        let exec = self.exec;
        self.common.run(name, Subject::Decoder { exec }, cases)
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
            common.must_listen(&server.name, server.target, &server.host, &trust)?;
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
        // Whom is sent for each pair.
        let conditions = self.common.conditions(Subject::Decoder { exec: None });
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
        let results = trace::judge(&self.file);
        let results = results.map_err(|error| named(&self.file, &error))?;
        let mut out = std::io::stdout();
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
    /// That no profile is asked for where there is but one: of what moves bodies a server alone is asked.
    fn must_be_core(&self) -> Result<(), BoxError> {
        match self.profile {
            Profile::Core => Ok(()),
            _ => Err("--profile is of servers".into()),
        }
    }

    fn selection(&self) -> Selection {
        Selection {
            patterns: self.case.clone(),
            profile: self.profile,
            without: self.without.clone(),
        }
    }

    /// That each pattern means a case, and that some are wanted.
    fn must_mean(&self, cases: &[Case]) -> Result<(), BoxError> {
        for pattern in &self.case {
            if !cases.iter().any(|case| case.is_meant_by(pattern)) {
                return Err(format!("no case is meant by --case {pattern:?}").into());
            }
        }
        let selection = self.selection();
        if !cases.iter().any(|case| selection.wants(case)) {
            return Err("no case that is meant is of this --profile".into());
        }
        Ok(())
    }

    /// That a server is there, and is the one that was meant: else each case would wait for it and fail.
    fn must_listen(
        &self,
        sent: &str,
        target: SocketAddr,
        name: &str,
        trust: &Trust,
    ) -> Result<(), BoxError> {
        let config = RawPeerConfig::default();
        let line = RawConnection::connect(target, name, trust, &config, self.timeout * 2);
        let line = line.map_err(|error| format!("the server {sent} cannot be tried: {error}"))?;
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

    fn conditions(&self, subject: Subject) -> Conditions {
        Conditions {
            subject,
            timeout: self.timeout,
            seed: self.seed,
            link: self.link,
            without: self.without.clone(),
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

    fn run(self, name: String, subject: Subject, cases: Vec<Case>) -> Result<bool, BoxError> {
        self.must_mean(&cases)?;
        self.reports.must_have_folders()?;
        if let Subject::Server {
            target,
            name: host,
            trust,
        } = &subject
        {
            self.must_listen(&name, *target, host, trust)?;
        }
        let (conditions, selection) = (self.conditions(subject), self.selection());
        let (at_a_time, mut out) = (self.side_by_side.get(), std::io::stdout());
        let results = run::run(cases, &selection, &conditions, at_a_time, &mut out);
        self.conclude(name, results, Vec::new())
    }

    /// Writes the reports, and says whether all is good.
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
    /// That what is to be written can be, before anything is tried for it.
    fn must_have_folders(&self) -> Result<(), BoxError> {
        for path in [&self.json, &self.junit, &self.html].into_iter().flatten() {
            let folder = path.parent().filter(|folder| *folder != Path::new(""));
            if folder.is_some_and(|folder| !folder.is_dir()) {
                return Err(named(path, &"its folder is not there"));
            }
            if path.is_dir() {
                return Err(named(path, &"it is a folder, and no place for a report"));
            }
        }
        Ok(())
    }

    /// Says how it went, writes the reports, and says whether all is good.
    fn conclude(&self, report: &Report) -> Result<bool, BoxError> {
        // First: what cannot be written must not cost what was found.
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

/// What is wrong with a file, with its name.
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
