//! Connections, before they join a scene, and servers in this process.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use pyo3::prelude::*;
use pyo3::types::PyDict;
use rhumb_bindings::rhumb_client::scene::Stepping;
use rhumb_bindings::rhumb_client::{Client, LocalServer, Refusals, ServerConnection};
use rhumb_bindings::{
    BindingError, JoinCondition, JoinParams, OwnServer, Reach, RemoteScene, ServedScenes, server_of,
};

use crate::arguments::{COORDINATES, one_of, seconds, sleep as sleep_rule, vector};
use crate::errors::{exception, wrong_value};
use crate::file::PyCheckpoint;
use crate::number;
use crate::scene::PyScene;

/// Longest wait for a server of this process.
const TIMEOUT: Duration = Duration::from_secs(5);

const CONDITIONS: [(&str, JoinCondition); 3] = [
    ("create or join", JoinCondition::CreateOrJoin),
    ("create", JoinCondition::Create),
    ("join", JoinCondition::Join),
];

const STEPPINGS: [(&str, Stepping); 2] = [
    ("lockstep", Stepping::Lockstep),
    ("free running", Stepping::FreeRunning),
];

const REFUSALS: [(&str, Refusals); 2] = [("raise", Refusals::Errors), ("events", Refusals::Events)];

/// A connection to a server that has joined no scene; connect makes it, and LocalServer.connect.
///
/// It closes at the end of a with block, unless join has used it up.
#[pyclass(frozen, name = "Connection", module = "rhumb")]
pub(crate) struct PyConnection {
    /// The server, in words.
    server: String,
    /// `None` once it has joined or is closed.
    connection: Mutex<Option<ServerConnection>>,
    /// `None` for a server in another process.
    origin: Option<OwnServer>,
}

/// Connects to the server at host:port, or at unix:PATH.
///
/// Trust its certificate by the fingerprint that the server prints, or by a PEM file with roots; not by both. The Unix
/// socket of a server of this machine and user has none, and needs neither. A token admits the client to a server that is
/// not open. The time limit, in seconds, holds for every later call that waits.
#[pyfunction]
#[pyo3(signature = (address, *, fingerprint = None, roots = None, token = None, timeout = 5.0))]
pub(crate) fn connect(
    py: Python<'_>,
    address: &str,
    fingerprint: Option<&str>,
    roots: Option<PathBuf>,
    token: Option<&str>,
    #[pyo3(from_py_with = number::double::timeout)] timeout: f64,
) -> PyResult<PyConnection> {
    let server = server_of(address, fingerprint, roots.as_deref());
    let (address, trust) = server.map_err(|error| exception(py, &error))?;
    let timeout = seconds(py, timeout, "timeout")?;
    let opened = py.detach(|| Client::connect_within(address, trust, timeout));
    let mut opened = opened.map_err(|error| exception(py, &error.into()))?;
    if let Some(token) = token {
        opened = opened.token(token);
    }
    Ok(PyConnection::new(format!("{address:?}"), opened, None))
}

/// Seconds, or none.
fn resume_within(value: &Bound<'_, PyAny>) -> PyResult<Option<f64>> {
    number::within(value, "resume_within", value.extract(), "seconds")
}

#[pymethods]
impl PyConnection {
    /// Joins a scene by name, makes it if it is new, and returns it. Uses the connection up; wrong arguments do not.
    ///
    /// coordinates: axes and unit of every position, length and force of this client. "rhumb": y up, metres; "unity":
    /// left-handed, y up, metres; "unreal": left-handed, z up, centimetres; "z-up": z up, metres, as in ROS and PyBullet.
    /// condition: "create or join", "create" (the scene must be new), or "join" (it must exist).
    /// tolerance: how far any point of a copied body may be off, 0.001 to 10 metres whatever the coordinates.
    /// cells: whether the scene is taken by cells, if its server divides it: see Scene.take_cells_around. The tolerance is then
    /// of the bodies that are in no cell.
    /// refusals: "raise" has the next advance, wait or poll raise RefusedError for what the server refused; "events" leaves
    /// that to events().
    /// resume_within: seconds for which the client tries to continue over another connection; None: as the scene suggests.
    ///
    /// Of a new scene are: stepping, "lockstep" (advance steps it) or "free running" (the server's clock does);
    /// ticks_per_second, 1 to 1000; substeps of each tick, 1 to 16; publish_interval, the ticks from one that is sent to the
    /// next; gravity, three numbers, the earth's if it is None; sleep, as of add_body, of bodies without one, "settled" if it is
    /// None.
    ///
    /// Of a free-running view are: delay_ticks, by which it stays behind the server's clock, so that nothing of it is
    /// guessed; whole_ticks, whether only whole ticks are shown; smooth, whether corrections are shown as short glides;
    /// lead_ticks, by which publish is ahead of the server's clock.
    ///
    /// resume_within: seconds for which the session continues over another connection after one that ended, as when the
    /// process stood still for ten seconds; None: a minute if the server keeps its scenes, else not at all.
    #[pyo3(signature = (
        scene, *, coordinates = "rhumb", condition = "create or join", tolerance = 0.05, cells = false,
        stepping = "lockstep", ticks_per_second = 60, substeps = 4, publish_interval = 1,
        gravity = None, sleep = None, delay_ticks = 0.0, lead_ticks = 0.0, whole_ticks = false,
        smooth = true, refusals = "raise", resume_within = None,
    ))]
    // Named parameters are the interface of Python.
    #[expect(clippy::too_many_arguments)]
    fn join(
        &self,
        py: Python<'_>,
        scene: &str,
        coordinates: &str,
        condition: &str,
        #[pyo3(from_py_with = number::double::tolerance)] tolerance: f64,
        cells: bool,
        stepping: &str,
        #[pyo3(from_py_with = number::whole::ticks_per_second)] ticks_per_second: u32,
        #[pyo3(from_py_with = number::whole::substeps)] substeps: u32,
        #[pyo3(from_py_with = number::whole::publish_interval)] publish_interval: u32,
        gravity: Option<&Bound<'_, PyAny>>,
        sleep: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = number::double::delay_ticks)] delay_ticks: f64,
        #[pyo3(from_py_with = number::double::lead_ticks)] lead_ticks: f64,
        whole_ticks: bool,
        smooth: bool,
        refusals: &str,
        #[pyo3(from_py_with = resume_within)] resume_within: Option<f64>,
    ) -> PyResult<PyScene> {
        let gravity = gravity.map(|gravity| vector(gravity, "gravity"));
        let resume_within = resume_within.map(|within| seconds(py, within, "resume_within"));
        let params = JoinParams {
            coordinates: one_of(py, &COORDINATES, coordinates, "coordinates")?,
            condition: one_of(py, &CONDITIONS, condition, "condition")?,
            tolerance_m: tolerance,
            cells,
            stepping: one_of(py, &STEPPINGS, stepping, "stepping")?,
            ticks_per_second,
            substeps,
            publish_interval,
            gravity: gravity.transpose()?,
            sleep: sleep.map_or(Ok(None), sleep_rule)?.unwrap_or_default(),
            delay_ticks,
            lead_ticks,
            whole_ticks,
            smooth,
            refusals: one_of(py, &REFUSALS, refusals, "refusals")?,
            resume_within: resume_within.transpose()?,
        };
        params.options().map_err(|error| exception(py, &error))?;
        let connection = self.take_for(scene);
        let connection = connection.map_err(|error| exception(py, &error))?;
        let joined = py.detach(|| RemoteScene::join(connection, scene, &params));
        let mut joined = joined.map_err(|error| exception(py, &error))?;
        if let Some(origin) = &self.origin {
            joined = joined.of(origin.clone(), scene);
        }
        Ok(PyScene::new(scene.to_owned(), joined))
    }

    /// Closes the connection. A second time does nothing.
    fn close(&self, py: Python<'_>) {
        let connection = self.lock().take();
        py.detach(|| drop(connection));
    }

    /// True once it is closed, or a scene was joined with it.
    #[getter]
    fn closed(&self) -> bool {
        self.lock().is_none()
    }

    fn __repr__(&self) -> String {
        let closed = if self.closed() { ", closed" } else { "" };
        format!("<rhumb.Connection to {}{closed}>", self.server)
    }

    const fn __enter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    #[pyo3(signature = (*_error))]
    fn __exit__(&self, py: Python<'_>, _error: &Bound<'_, PyAny>) {
        self.close(py);
    }
}

impl PyConnection {
    /// An open connection to a server that these words name.
    pub(crate) const fn new(
        server: String,
        opened: ServerConnection,
        origin: Option<OwnServer>,
    ) -> Self {
        Self {
            server,
            connection: Mutex::new(Some(opened)),
            origin,
        }
    }

    /// The connection, which is closed for Python from now on. A wrong name or token leaves it open.
    fn take_for(&self, scene: &str) -> Result<ServerConnection, BindingError> {
        let mut opened = self.lock();
        let connection = opened.as_ref().ok_or(BindingError::Closed)?;
        connection.check_join(scene)?;
        opened.take().ok_or(BindingError::Closed)
    }

    /// Held for no longer than the connection is looked at or taken.
    fn lock(&self) -> MutexGuard<'_, Option<ServerConnection>> {
        let locked = self.connection.lock();
        locked.unwrap_or_else(PoisonError::into_inner)
    }
}

/// A physics server in this process, without sockets. It ends with the last of its clients and of the references to it.
///
/// own_thread: whether it steps on a thread of its own, so that a free-running scene moves on between calls; without it, it
/// steps within the calls of its clients. Clients on several threads take turns then: each waits while another one's call
/// steps, and other threads of the interpreter run meanwhile.
#[pyclass(frozen, name = "LocalServer", module = "rhumb")]
pub(crate) struct PyLocalServer {
    server: LocalServer,
    own_thread: bool,
}

#[pymethods]
impl PyLocalServer {
    #[new]
    #[pyo3(signature = (*, own_thread = false))]
    fn new(own_thread: bool) -> PyResult<Self> {
        let server = match own_thread {
            true => LocalServer::spawn()?,
            false => LocalServer::new(),
        };
        Ok(Self { server, own_thread })
    }

    /// A connection of one more client, which joins a scene. The time limit, in seconds, holds for every later call that waits.
    ///
    /// feed: the name of the scene that the client will make when it joins, and feed: see Scene.feed.
    #[pyo3(signature = (*, timeout = 5.0, feed = None))]
    fn connect(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = number::double::timeout)] timeout: f64,
        feed: Option<&str>,
    ) -> PyResult<PyConnection> {
        let timeout = seconds(py, timeout, "timeout")?;
        // Another client's call may be inside the server.
        let origin = OwnServer::Local(self.server.clone());
        let opened = py.detach(|| match feed {
            Some(scene) => origin.feed(scene, timeout),
            None => origin.connect(timeout),
        });
        let opened = opened.map_err(|error| exception(py, &error))?;
        Ok(PyConnection::new(
            "this process".to_owned(),
            opened,
            Some(origin),
        ))
    }

    /// Makes a scene that continues from a checkpoint, to be joined by its name.
    ///
    /// Bodies keep their ids. The scene has no members at first: it ends if none joins for ten minutes.
    fn restore(&self, py: Python<'_>, scene: &str, checkpoint: &PyCheckpoint) -> PyResult<()> {
        let restored = py.detach(|| self.server.restore(scene, &checkpoint.0));
        restored.map_err(|error| exception(py, &error.into()))
    }

    fn __repr__(&self) -> String {
        format!("LocalServer(own_thread={})", python(self.own_thread))
    }
}

/// As Python writes it.
const fn python(value: bool) -> &'static str {
    match value {
        true => "True",
        false => "False",
    }
}

/// A scene in this process, on a server of its own: no program to start, no sockets, no fingerprint.
///
/// The options are those of Connection.join. The server ends with the scene. It steps within the scene's calls, so that a
/// free-running scene moves on only while it is polled. LocalServer has several clients of one scene, and a thread.
/// fed: whether this program has the engine, and feeds the scene: see Scene.feed.
#[pyfunction]
#[pyo3(
    signature = (scene = "main", *, fed = false, **options),
    text_signature = "(scene='main', *, fed=False, coordinates='rhumb', condition='create or join', tolerance=0.05, cells=False, \
        stepping='lockstep', ticks_per_second=60, substeps=4, publish_interval=1, gravity=None, sleep=None, \
        delay_ticks=0.0, lead_ticks=0.0, whole_ticks=False, smooth=True, refusals='raise', resume_within=None)"
)]
pub(crate) fn local<'py>(
    py: Python<'py>,
    scene: &str,
    fed: bool,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let origin = OwnServer::Local(LocalServer::new());
    let opened = match fed {
        true => origin.feed(scene, TIMEOUT),
        false => origin.connect(TIMEOUT),
    };
    let opened = opened.map_err(|error| exception(py, &error))?;
    let connection = PyConnection::new("this process".to_owned(), opened, Some(origin));
    Bound::new(py, connection)?.call_method("join", (scene,), options)
}

/// A scene in this process that others join, on a server of its own: no program to start, no fingerprint to copy.
///
/// Scene.address is the one text by which other processes connect: rhumb.connect(scene.address).join("main"). It is printed
/// too, unless quiet. rhumb.view(scene) shows the scene in a browser.
///
/// listen: IP address and port of the server; port 0 is a free one. open_to_network: whether the address may be one that
/// other machines reach. There are no tokens: each client may do everything. The rest is as of Connection.join. The
/// server has threads of its own and ends with the scene, for every member. With a checkpoint, the scene continues from it.
/// fed: whether this program has the engine, and feeds the scene: see Scene.feed; not with a checkpoint.
#[pyfunction]
#[pyo3(
    signature = (
        scene = "main", *, listen = "127.0.0.1:0", open_to_network = false, quiet = false, checkpoint = None, fed = false,
        **options
    ),
    text_signature = "(scene='main', *, listen='127.0.0.1:0', open_to_network=False, quiet=False, checkpoint=None, fed=False, coordinates='rhumb', \
        condition='create or join', tolerance=0.05, cells=False, \
        stepping='lockstep', ticks_per_second=60, substeps=4, publish_interval=1, gravity=None, sleep=None, \
        delay_ticks=0.0, lead_ticks=0.0, whole_ticks=False, smooth=True, refusals='raise', resume_within=None)"
)]
// Named parameters are the interface of Python.
#[expect(clippy::too_many_arguments)]
pub(crate) fn serve<'py>(
    py: Python<'py>,
    scene: &str,
    listen: &str,
    open_to_network: bool,
    quiet: bool,
    checkpoint: Option<&Bound<'py, PyCheckpoint>>,
    fed: bool,
    options: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let reach = match open_to_network {
        true => Reach::Network,
        false => Reach::ThisMachine,
    };
    if checkpoint.is_some() {
        let creates = options.map_or(Ok(None), |options| options.get_item("condition"))?;
        let creates = creates.is_some_and(|condition| condition.eq("create").unwrap_or(false));
        if fed {
            let needed = "left out with a checkpoint: a fed scene is one of its owner's engine, and has none";
            return Err(wrong_value(py, "fed", "True", needed));
        }
        if creates {
            let needed = "'create or join' or 'join' with a checkpoint, of which the scene is made";
            return Err(wrong_value(py, "condition", "'create'", needed));
        }
    }
    let checkpoint = checkpoint.map(Bound::get);
    let started = py.detach(|| {
        let server = match fed {
            true => OwnServer::fed(listen, reach, scene)?,
            false => OwnServer::Served(Arc::new(ServedScenes::start(listen, reach)?)),
        };
        if let Some(checkpoint) = checkpoint {
            server.restore(scene, &checkpoint.0)?;
        }
        let opened = match fed {
            true => server.feed(scene, TIMEOUT)?,
            false => server.connect(TIMEOUT)?,
        };
        Ok((server, opened))
    });
    let (server, opened) = started.map_err(|error: BindingError| exception(py, &error))?;
    let address = server.address().unwrap_or_default();
    let connection = PyConnection::new(format!("{address:?}"), opened, Some(server));
    let joined = Bound::new(py, connection)?.call_method("join", (scene,), options)?;
    if !quiet {
        let coordinates = match options {
            Some(options) => options.get_item("coordinates")?,
            None => None,
        };
        let axes = match coordinates {
            Some(coordinates) => format!(", coordinates={}", coordinates.repr()?),
            None => String::new(),
        };
        let said = format!("rhumb.connect(\"{address}\").join(\"{scene}\"{axes}) joins this scene");
        py.import("builtins")?.call_method1("print", (said,))?;
    }
    Ok(joined)
}
