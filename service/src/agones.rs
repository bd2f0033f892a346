//! Reports to Agones: a server is ready and well, has scenes, or drains.
//!
//! Agones owns machines: it starts servers, chooses one for a new scene, and never removes one that is allocated. A server
//! speaks to the sidecar of its pod, by REST (its `proto/sdk`, version 1.57). The sidecar starts in its own time and answers any
//! error with status 500, so that each call is made again until it succeeds, and the list is read before it is changed.
//!
//! Chooses no server, and stops none. A scene waits for none of this.

use std::collections::BTreeSet;
use std::env;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use bytes::Bytes;
use hyper::{Method, StatusCode};
use rhumb_protocol::scene::SceneName;
use rhumb_transport::io_runtime;
use serde_json::{Value, json};
use tokio::sync::oneshot;
use tokio::time::sleep;

use crate::http;
use crate::metrics::Metrics;

/// Where the sidecar of this pod answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sidecar {
    port: u16,
}

impl Sidecar {
    /// The sidecar that Agones names to its pods, or the usual port.
    ///
    /// # Errors
    ///
    /// A text in the environment that is no port.
    pub(crate) fn from_environment() -> Result<Self, String> {
        const VARIABLE: &str = "AGONES_SDK_HTTP_PORT";
        const USUAL: u16 = 9358;
        let port = match env::var(VARIABLE) {
            Err(env::VarError::NotPresent) => USUAL,
            Ok(text) => (text.parse().ok().filter(|port| *port != 0))
                .ok_or_else(|| format!("{VARIABLE} is {text:?}: Agones sets it to a port"))?,
            Err(env::VarError::NotUnicode(text)) => {
                return Err(format!("{VARIABLE} is {text:?}: Agones sets it to a port"));
            }
        };
        Ok(Self { port })
    }

    /// Asks once; `None` without an answer in time.
    async fn ask(
        self,
        (method, path): (Method, &str),
        body: Option<&Value>,
    ) -> Option<(StatusCode, Bytes)> {
        http::ask(("127.0.0.1", self.port), (method, path), body, ANSWER_TIME).await
    }
}

/// The facts of a server that are reported.
pub(crate) struct ReportedServer {
    metrics: Metrics,
    drained: Arc<AtomicBool>,
}

impl ReportedServer {
    /// `drained`: true while the server gives all scenes away, and takes none.
    pub(crate) const fn new(metrics: Metrics, drained: Arc<AtomicBool>) -> Self {
        Self { metrics, drained }
    }

    fn look(&self) -> Look {
        Look {
            is_healthy: self.metrics.is_healthy(),
            is_draining: self.drained.load(Ordering::Relaxed),
            scenes: self.metrics.scene_names().into_iter().collect(),
        }
    }
}

/// Reports to Agones until it is dropped; then says that the server shuts down.
pub(crate) struct Agones {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Time between two looks at the server. Agones asks for a sign of health every 5 s, unless its settings say otherwise.
const PAUSE: Duration = Duration::from_secs(1);
/// Time for an answer.
const ANSWER_TIME: Duration = Duration::from_secs(1);
/// Names that are added to the list or taken from it at one look, at a second each at worst: signs of health do not wait longer.
const CHANGES_MAX: usize = 8;
/// The list of a GameServer in which the names of its scenes are.
const LIST: &str = "/v1beta1/lists/scenes";

impl Agones {
    /// Starts the thread.
    ///
    /// # Errors
    ///
    /// The system's, if it has no thread or no event queue.
    pub(crate) fn start(sidecar: Sidecar, server: ReportedServer) -> io::Result<Self> {
        let runtime = io_runtime()?;
        let (stop, stopped) = oneshot::channel();
        let reporting = Reporting {
            sidecar,
            server,
            reported: ReportedState::default(),
            failed: None,
        };
        let thread = thread::Builder::new()
            .name("rhumb-agones".to_owned())
            .spawn(move || runtime.block_on(reporting.run(stopped)))?;
        Ok(Self {
            stop: Some(stop),
            thread: Some(thread),
        })
    }
}

impl Agones {
    /// Says from now on alone that the server shuts down.
    pub(crate) fn stop(&mut self) {
        self.stop = None;
    }
}

impl Drop for Agones {
    fn drop(&mut self) {
        self.stop();
        if self
            .thread
            .take()
            .is_some_and(|thread| thread.join().is_err())
        {
            tracing::error!("the thread that reports to Agones panicked");
        }
    }
}

struct Reporting {
    sidecar: Sidecar,
    server: ReportedServer,
    reported: ReportedState,
    /// The call that was not taken at the last look, and the status of its answer; the log has said so.
    failed: Option<(String, Option<StatusCode>)>,
}

/// A call that was not taken: its path, and the answer if one came.
struct NotTaken(String, Option<(StatusCode, Bytes)>);

impl Reporting {
    async fn run(mut self, mut stopped: oneshot::Receiver<()>) {
        loop {
            tokio::select! {
                _ = &mut stopped => break,
                outcome = self.report() => self.note(outcome),
            }
            tokio::select! {
                _ = &mut stopped => break,
                () = sleep(PAUSE) => {}
            }
        }
        if self.reported.state != State::ShutDown {
            let outcome = self.call(SdkCall::ShutDown).await;
            self.note(outcome);
        }
    }

    /// Reports what changed. The first call that fails ends it until the next look.
    async fn report(&mut self) -> Result<(), NotTaken> {
        let now = self.server.look();
        for call in self.reported.calls(&now) {
            self.call(call).await?;
            self.reported.note(call);
        }
        match self.reported.list_differs(&now) {
            true => self.change_list(&now).await,
            false => Ok(()),
        }
    }

    async fn call(&self, call: SdkCall) -> Result<(), NotTaken> {
        let (method, path, body) = call.request();
        taken(path, self.sidecar.ask((method, path), Some(&body)).await)
    }

    /// Makes the list name the scenes. Names that are not of this server's scenes are of scenes that Agones has promised a
    /// place, and stay. A list that is full still gives up the names of scenes that ended.
    async fn change_list(&mut self, now: &Look) -> Result<(), NotTaken> {
        let answer = self.sidecar.ask((Method::GET, LIST), None).await;
        let Some((status, bytes)) = answer else {
            return Err(NotTaken(LIST.to_owned(), None));
        };
        let list = serde_json::from_slice(&bytes).ok();
        let list = list.filter(|_| status == StatusCode::OK);
        let Some(list) = list.as_ref().and_then(ScenesList::read) else {
            if !std::mem::replace(&mut self.reported.misses_list, true) {
                tracing::warn!(
                    "Agones has no list of this server's scenes: give the GameServer spec.lists.scenes with the capacity \
                     of limits.scenes, and the feature gate CountsAndLists"
                );
            }
            return Ok(());
        };
        self.reported.misses_list = false;
        self.reported.note_list(&list, now);
        let mut outcome = Ok(());
        for change in self.reported.changes(&list, now) {
            let path = change.path();
            let body = json!({ "value": change.scene().as_str() });
            match taken(
                &path,
                self.sidecar.ask((Method::POST, &path), Some(&body)).await,
            ) {
                Ok(()) => self.reported.note_change(change),
                Err(none @ NotTaken(_, None)) => return Err(none),
                Err(refused) => outcome = outcome.and(Err(refused)),
            }
        }
        outcome
    }

    /// Logs what is not taken when it begins and when it is over.
    fn note(&mut self, outcome: Result<(), NotTaken>) {
        /// Letters of an answer that the log shows.
        const SHOWN: usize = 200;
        let Err(NotTaken(path, answer)) = outcome else {
            if self.failed.take().is_some() {
                tracing::info!("Agones takes this server's calls again");
            }
            return;
        };
        let status = answer.as_ref().map(|(status, _)| *status);
        let is_known = |(known, of): &(String, Option<StatusCode>)| *known == path && *of == status;
        if self.failed.as_ref().is_some_and(is_known) {
            return;
        }
        match answer {
            None => tracing::warn!("Agones does not answer at {path}: it is asked every second"),
            Some((status, text)) => {
                let text: String = String::from_utf8_lossy(&text).chars().take(SHOWN).collect();
                tracing::warn!(%status, "Agones refuses {path}, and is asked every second: {text:?}");
            }
        }
        self.failed = Some((path, status));
    }
}

/// An error for any answer but that of success.
fn taken(path: &str, answer: Option<(StatusCode, Bytes)>) -> Result<(), NotTaken> {
    match answer {
        Some((StatusCode::OK, _)) => Ok(()),
        answer => Err(NotTaken(path.to_owned(), answer)),
    }
}

/// A server at one moment.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Look {
    is_healthy: bool,
    is_draining: bool,
    scenes: BTreeSet<SceneName>,
}

/// A call that needs no answer but its success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SdkCall {
    Ready,
    Health,
    Allocate,
    /// True while it drains.
    Drain(bool),
    ShutDown,
}

impl SdkCall {
    fn request(self) -> (Method, &'static str, Value) {
        let post = |path| (Method::POST, path, json!({}));
        match self {
            Self::Ready => post("/ready"),
            Self::Health => post("/health"),
            Self::Allocate => post("/allocate"),
            // Agones writes it as agones.dev/sdk-draining.
            Self::Drain(drains) => {
                let label = json!({ "key": "draining", "value": drains.to_string() });
                (Method::PUT, "/metadata/label", label)
            }
            Self::ShutDown => post("/shutdown"),
        }
    }
}

/// The state of a GameServer, as far as this server has set it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Starting,
    Ready,
    /// It has scenes, and is not removed.
    Allocated,
    ShutDown,
}

/// The newest reports.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct ReportedState {
    state: State,
    drains: bool,
    /// Scenes that the list had by this server's doing, or had already.
    listed: BTreeSet<SceneName>,
    misses_list: bool,
}

impl ReportedState {
    /// The calls that are due, in order. A server that does not answer its clients says nothing, so that Agones replaces it.
    fn calls(&self, now: &Look) -> Vec<SdkCall> {
        if !now.is_healthy || self.state == State::ShutDown {
            return Vec::new();
        }
        let mut calls = vec![SdkCall::Health];
        if now.is_draining != self.drains {
            calls.push(SdkCall::Drain(now.is_draining));
        }
        let is_empty = now.scenes.is_empty();
        calls.extend(match self.state {
            _ if now.is_draining && is_empty => Some(SdkCall::ShutDown),
            State::Starting => Some(SdkCall::Ready),
            State::Ready => (!is_empty).then_some(SdkCall::Allocate),
            State::Allocated => is_empty.then_some(SdkCall::Ready),
            State::ShutDown => None,
        });
        calls
    }

    fn note(&mut self, call: SdkCall) {
        match call {
            SdkCall::Ready => self.state = State::Ready,
            SdkCall::Allocate => self.state = State::Allocated,
            SdkCall::ShutDown => self.state = State::ShutDown,
            SdkCall::Drain(drains) => self.drains = drains,
            SdkCall::Health => {}
        }
    }

    fn list_differs(&self, now: &Look) -> bool {
        now.is_healthy && self.listed != now.scenes
    }

    /// The changes after which the list names the scenes. Scenes that ended leave their places first.
    fn changes(&self, list: &ScenesList, now: &Look) -> Vec<ListChange> {
        let ended = self.listed.difference(&now.scenes);
        let ended = ended.filter(|scene| list.values.contains(scene.as_str()));
        let begun = now.scenes.iter();
        let begun = begun.filter(|scene| !list.values.contains(scene.as_str()));
        let ended = ended.cloned().map(ListChange::Remove);
        let changes = ended.chain(begun.cloned().map(ListChange::Add));
        changes.take(CHANGES_MAX).collect()
    }

    /// The list was read: it has some scenes by a promise, and some that ended no more.
    fn note_list(&mut self, list: &ScenesList, now: &Look) {
        let has = |scene: &&SceneName| list.values.contains(scene.as_str());
        self.listed.retain(|scene| has(&scene));
        self.listed.extend(now.scenes.iter().filter(has).cloned());
    }

    fn note_change(&mut self, change: ListChange) {
        match change {
            ListChange::Add(scene) => self.listed.insert(scene),
            ListChange::Remove(scene) => self.listed.remove(&scene),
        };
    }
}

/// A change of the list.
#[derive(Clone, Debug, PartialEq, Eq)]
enum ListChange {
    Add(SceneName),
    Remove(SceneName),
}

impl ListChange {
    fn path(&self) -> String {
        match self {
            Self::Add(_) => format!("{LIST}:addValue"),
            Self::Remove(_) => format!("{LIST}:removeValue"),
        }
    }

    const fn scene(&self) -> &SceneName {
        match self {
            Self::Add(scene) | Self::Remove(scene) => scene,
        }
    }
}

/// The list as Agones has it.
#[derive(Clone, Debug, PartialEq, Eq)]
struct ScenesList {
    values: BTreeSet<String>,
}

impl ScenesList {
    /// `None` for what is no list. One without values may leave them out.
    fn read(answer: &Value) -> Option<Self> {
        let answer = answer.as_object()?;
        let values = match answer.get("values") {
            None => BTreeSet::new(),
            Some(values) => {
                let values = values.as_array()?.iter();
                let values = values.map(|value| value.as_str().map(str::to_owned));
                values.collect::<Option<_>>()?
            }
        };
        Some(Self { values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenes(names: &[&str]) -> BTreeSet<SceneName> {
        let names = names.iter().map(|name| name.parse());
        names.collect::<Result<_, _>>().expect("valid names")
    }

    fn look(names: &[&str]) -> Look {
        Look {
            is_healthy: true,
            is_draining: false,
            scenes: scenes(names),
        }
    }

    /// The calls at a look, all of which are taken.
    fn taken_all(reported: &mut ReportedState, now: &Look) -> Vec<SdkCall> {
        let calls = reported.calls(now);
        calls.iter().for_each(|call| reported.note(*call));
        calls
    }

    #[test]
    fn a_server_is_ready_and_is_allocated_while_it_has_scenes() {
        let mut reported = ReportedState::default();
        assert_eq!(
            taken_all(&mut reported, &look(&["restored"])),
            [SdkCall::Health, SdkCall::Ready]
        );
        assert_eq!(
            taken_all(&mut reported, &look(&["restored"])),
            [SdkCall::Health, SdkCall::Allocate]
        );
        assert_eq!(
            taken_all(&mut reported, &look(&["a", "b"])),
            [SdkCall::Health]
        );
        assert_eq!(
            taken_all(&mut reported, &look(&[])),
            [SdkCall::Health, SdkCall::Ready]
        );
        assert_eq!(taken_all(&mut reported, &look(&[])), [SdkCall::Health]);
    }

    #[test]
    fn a_call_that_was_not_taken_is_due_again() {
        let reported = ReportedState::default();
        assert_eq!(
            reported.calls(&look(&[])),
            [SdkCall::Health, SdkCall::Ready]
        );
        assert_eq!(
            reported.calls(&look(&[])),
            [SdkCall::Health, SdkCall::Ready]
        );
    }

    #[test]
    fn a_server_that_is_stuck_says_nothing() {
        let now = Look {
            is_healthy: false,
            ..look(&["a"])
        };
        assert_eq!(ReportedState::default().calls(&now), []);
        assert!(!ReportedState::default().list_differs(&now));
    }

    #[test]
    fn a_server_that_drains_shuts_down_once_its_scenes_are_gone() {
        let mut reported = ReportedState::default();
        taken_all(&mut reported, &look(&["a"]));
        taken_all(&mut reported, &look(&["a"]));
        let draining = |names| Look {
            is_draining: true,
            ..look(names)
        };
        assert_eq!(
            taken_all(&mut reported, &draining(&["a"])),
            [SdkCall::Health, SdkCall::Drain(true)]
        );
        assert_eq!(
            taken_all(&mut reported, &draining(&["a"])),
            [SdkCall::Health]
        );
        assert_eq!(
            taken_all(&mut reported, &draining(&[])),
            [SdkCall::Health, SdkCall::ShutDown]
        );
        assert_eq!(
            taken_all(&mut reported, &draining(&[])),
            [],
            "its pod is going"
        );
    }

    fn list(text: &str) -> ScenesList {
        let answer = serde_json::from_str(text).expect("JSON");
        ScenesList::read(&answer).expect("a list")
    }

    #[test]
    fn a_server_that_drains_no_more_says_so() {
        let mut reported = ReportedState {
            drains: true,
            ..ReportedState::default()
        };
        let calls = [SdkCall::Health, SdkCall::Drain(false), SdkCall::Ready];
        assert_eq!(taken_all(&mut reported, &look(&[])), calls);
        assert!(!reported.drains);
    }

    #[test]
    fn a_place_that_agones_has_promised_stays_on_the_list() {
        let mut reported = ReportedState::default();
        let [a, b] = ["a", "b"].map(|name| name.parse::<SceneName>().expect("a valid name"));
        let promised = list(r#"{"name":"scenes", "capacity":"4", "values":["b", "c"]}"#);
        let now = look(&["a", "b"]);
        reported.note_list(&promised, &now);
        assert_eq!(
            reported.changes(&promised, &now),
            [ListChange::Add(a.clone())]
        );
        reported.note_change(ListChange::Add(a.clone()));
        assert_eq!(reported.listed, now.scenes);
        let full = list(r#"{"name":"scenes", "capacity":"4", "values":["a", "b", "c"]}"#);
        let now = look(&["a"]);
        reported.note_list(&full, &now);
        assert_eq!(reported.changes(&full, &now), [ListChange::Remove(b)]);
        let none = list(r#"{"name":"scenes", "capacity":"4"}"#);
        reported.note_list(&none, &now);
        assert_eq!(reported.changes(&none, &now), [ListChange::Add(a)]);
    }

    #[test]
    fn a_full_list_gives_up_a_name_whose_scene_has_ended() {
        let mut reported = ReportedState::default();
        let [a, b] = ["a", "b"].map(|name| name.parse::<SceneName>().expect("a valid name"));
        // The list took one of two scenes.
        reported.note_change(ListChange::Add(a.clone()));
        let full = list(r#"{"name":"scenes", "capacity":"2", "values":["promised", "a"]}"#);
        let now = look(&["b"]);
        reported.note_list(&full, &now);
        let changes = [ListChange::Remove(a), ListChange::Add(b)];
        assert_eq!(reported.changes(&full, &now), changes);
    }
}
