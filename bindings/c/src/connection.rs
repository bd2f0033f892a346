//! Connections before they join: to a server, and to one in this process.

use std::ffi::c_char;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rhumb_bindings::rhumb_client::{Checkpoint, Client, LocalServer, ServerConnection, Trust};
use rhumb_bindings::{BindingError, OwnServer, Reach, ServedScenes};

use crate::border::{
    HandleTable, RhumbCode, check_out, copy_out, copy_text, elements, guard, optional_text, text,
    value, write,
};

/// A connection to a server that has joined no scene. All zeros is none.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbConnection {
    /// Its number.
    pub id: u64,
}

/// How to reach a server, and which one to trust: by `fingerprint` or by `roots`, one of the two. The address may end with
/// `#` and the fingerprint. `unix:` and a path reach a server of this machine and user, which needs neither.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbConnectOptions {
    /// Host and port.
    pub address: *const c_char,
    /// SHA-256 of the server's certificate, as the server prints it; or null.
    pub fingerprint: *const c_char,
    /// Path of a PEM file with the roots that sign the server's certificate; or null.
    pub roots: *const c_char,
    /// Token of access; null for a server that needs none.
    pub token: *const c_char,
    /// Time limit of every call that waits for the server, seconds; zero for five.
    pub timeout_s: f64,
}

static CONNECTIONS: HandleTable<HeldConnection> = HandleTable::new();

/// A connection, and its server if that is in this process.
pub(crate) struct HeldConnection {
    pub(crate) connection: ServerConnection,
    pub(crate) server: Option<OwnServer>,
}

/// Connects to a server. Join a scene with the connection, or close it.
///
/// Every text ends with a zero byte and is UTF-8. All are copied.
///
/// # Safety
///
/// `options` and its texts, and `connection`, point to what their types say.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_connect(
    options: *const RhumbConnectOptions,
    connection: *mut RhumbConnection,
) -> RhumbCode {
    guard(|| {
        check_out(connection, "connection")?;
        // SAFETY: the caller promises what the pointers point to.
        let ((address, trust), token, timeout) = unsafe {
            let options = value(options, "options")?;
            (
                named_server(options)?,
                optional_text(options.token, "options.token")?,
                time_limit(options.timeout_s, "options.timeout_s")?,
            )
        };
        let mut opened = Client::connect_within(address, trust, timeout)?;
        if let Some(token) = token {
            opened = opened.token(token);
        }
        let id = insert(opened, None);
        // SAFETY: the caller promises the memory.
        unsafe { write(connection, RhumbConnection { id }, "connection") }
    })
}

/// Closes a connection that has joined no scene.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_connection_close(connection: RhumbConnection) -> RhumbCode {
    guard(|| CONNECTIONS.take(connection.id, |_| Ok(())).map(drop))
}

/// Gives out the handle of a connection.
pub(crate) fn insert(connection: ServerConnection, server: Option<OwnServer>) -> u64 {
    CONNECTIONS.insert(HeldConnection { connection, server })
}

/// The connection of a handle, which is closed from now on. A wrong name of the scene or a wrong token leaves it open.
pub(crate) fn take_for(
    connection: RhumbConnection,
    scene: &str,
) -> Result<HeldConnection, BindingError> {
    CONNECTIONS.take(connection.id, |opened| {
        Ok(opened.connection.check_join(scene)?)
    })
}

/// The same as [`Client::connect`]'s.
const DEFAULT_TIMEOUT: Duration = Duration::from_secs(5);

/// # Safety
///
/// The texts of `options` end with a zero byte.
unsafe fn named_server(options: &RhumbConnectOptions) -> Result<(&str, Trust), BindingError> {
    // SAFETY: the caller promises the texts.
    let (address, fingerprint, roots) = unsafe {
        (
            text(options.address, "options.address")?,
            optional_text(options.fingerprint, "options.fingerprint")?,
            optional_text(options.roots, "options.roots")?,
        )
    };
    rhumb_bindings::server_of(address, fingerprint, roots.map(Path::new))
}

/// A time limit that a caller gives in seconds; zero for the default.
pub(crate) fn time_limit(limit: f64, argument: &'static str) -> Result<Duration, BindingError> {
    let limit = seconds(limit, argument)?;
    Ok(match limit.is_zero() {
        true => DEFAULT_TIMEOUT,
        false => limit,
    })
}

/// A time that a caller gives in seconds.
pub(crate) fn seconds(seconds: f64, argument: &'static str) -> Result<Duration, BindingError> {
    let needed = "seconds, 0 to 1e19";
    Duration::try_from_secs_f64(seconds).map_err(|_| BindingError::value(argument, seconds, needed))
}

/// A physics server in this process. All zeros is none.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLocalServer {
    /// Its number.
    pub id: u64,
}

/// Bytes of an address, with the zero byte that ends it.
pub const RHUMB_ADDRESS_BYTES: usize = 320;

/// An address as text: of a server, or of a page.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbAddress {
    /// UTF-8 that ends with a zero byte; empty where there is none.
    pub text: [c_char; 320],
}

static SERVERS: HandleTable<OwnServer> = HandleTable::new();

/// Gives out the handle of a server.
pub(crate) fn insert_server(server: OwnServer) -> u64 {
    SERVERS.insert(server)
}

/// The server of a handle.
pub(crate) fn server_of(server: RhumbLocalServer) -> Result<OwnServer, BindingError> {
    SERVERS.with(server.id, |server| Ok(server.clone()))
}

/// The machines that reach a server's address.
pub(crate) fn reach(open_to_network: u8) -> Result<Reach, BindingError> {
    match open_to_network {
        0 => Ok(Reach::ThisMachine),
        1 => Ok(Reach::Network),
        other => Err(BindingError::value("open_to_network", other, "0 or 1")),
    }
}

/// A free port of this machine.
pub(crate) const FREE_PORT: &str = "127.0.0.1:0";

/// Connects to a server of the connection's own, in this process and without sockets. It steps within the calls of its
/// client, and ends with it. Join a scene with the connection, or close it.
///
/// # Safety
///
/// `connection` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_local(connection: *mut RhumbConnection) -> RhumbCode {
    guard(|| {
        check_out(connection, "connection")?;
        let server = LocalServer::new();
        let id = insert(server.connect(), Some(OwnServer::Local(server)));
        // SAFETY: the caller promises the memory.
        unsafe { write(connection, RhumbConnection { id }, "connection") }
    })
}

/// Makes a server in this process for any number of connections.
///
/// `own_thread`: 0 has it step within the calls of its clients. Clients on several threads take turns then: each waits while
/// another one's call steps. 1 has it step on a thread of its own, so that a free-running scene moves on between calls.
///
/// # Safety
///
/// `server` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_local_server_open(
    own_thread: u8,
    server: *mut RhumbLocalServer,
) -> RhumbCode {
    guard(|| {
        check_out(server, "server")?;
        let made = match own_thread {
            0 => LocalServer::new(),
            1 => LocalServer::spawn().map_err(|cause| {
                BindingError::Fault(format!("the server's thread cannot start: {cause}"))
            })?,
            other => return Err(BindingError::value("own_thread", other, "0 or 1")),
        };
        let id = insert_server(OwnServer::Local(made));
        // SAFETY: the caller promises the memory.
        unsafe { write(server, RhumbLocalServer { id }, "server") }
    })
}

/// Makes a server in this process that other processes join too. It has threads of its own; a scene that is joined here goes
/// over a socket of this machine.
///
/// `listen`: IP address and port; port 0 is a free one; null for a free port of this machine. `open_to_network`: 1 for an
/// address that other machines reach. There are no tokens: each client may do everything.
///
/// # Safety
///
/// `listen` is null or a text that ends with a zero byte; `server` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_serve(
    listen: *const c_char,
    open_to_network: u8,
    server: *mut RhumbLocalServer,
) -> RhumbCode {
    guard(|| {
        check_out(server, "server")?;
        // SAFETY: the caller promises the text.
        let listen = unsafe { optional_text(listen, "listen") }?;
        let reach = reach(open_to_network)?;
        let served = ServedScenes::start(listen.unwrap_or(FREE_PORT), reach)?;
        let id = insert_server(OwnServer::Served(Arc::new(served)));
        // SAFETY: the caller promises the memory.
        unsafe { write(server, RhumbLocalServer { id }, "server") }
    })
}

/// The one text by which other processes connect: address and fingerprint, for `RhumbConnectOptions`. It is empty for a
/// server without sockets.
///
/// # Safety
///
/// `address` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_local_server_address(
    server: RhumbLocalServer,
    address: *mut RhumbAddress,
) -> RhumbCode {
    guard(|| {
        check_out(address, "address")?;
        let text = SERVERS.with(server.id, |server| Ok(server.address()))?;
        let text = copy_text(&text.unwrap_or_default());
        // SAFETY: the caller promises the memory.
        unsafe { write(address, RhumbAddress { text }, "address") }
    })
}

/// Connects one more client. `timeout_s` is as that of RhumbConnectOptions.
///
/// # Safety
///
/// `connection` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_local_server_connect(
    server: RhumbLocalServer,
    timeout_s: f64,
    connection: *mut RhumbConnection,
) -> RhumbCode {
    guard(|| {
        check_out(connection, "connection")?;
        let timeout = time_limit(timeout_s, "timeout_s")?;
        let server = server_of(server)?;
        let id = insert(server.connect(timeout)?, Some(server));
        // SAFETY: the caller promises the memory.
        unsafe { write(connection, RhumbConnection { id }, "connection") }
    })
}

/// The whole state of a scene. All zeros is none.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbCheckpoint {
    /// Its number.
    pub id: u64,
}

pub(crate) static CHECKPOINTS: HandleTable<Checkpoint> = HandleTable::new();

/// The bytes of a checkpoint, for a file. `count` receives their number, also if `capacity` is too small for them.
///
/// # Safety
///
/// `bytes` points to memory for `capacity` bytes, `count` to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_checkpoint_bytes(
    checkpoint: RhumbCheckpoint,
    bytes: *mut u8,
    capacity: usize,
    count: *mut usize,
) -> RhumbCode {
    guard(|| {
        check_out(count, "count")?;
        let all = CHECKPOINTS.with(checkpoint.id, |checkpoint| Ok(checkpoint.to_bytes()))?;
        // SAFETY: the caller promises the memory of both.
        unsafe {
            write(count, all.len(), "count")?;
            copy_out(bytes, capacity, &all, "bytes")
        }
    })
}

/// Reads a checkpoint from its bytes; what is damaged, or of another version, is refused. The checksum finds damage and no
/// malice: read bytes of those whose programs you would run.
///
/// # Safety
///
/// `bytes` points to `count` bytes, `checkpoint` to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_checkpoint_read(
    bytes: *const u8,
    count: usize,
    checkpoint: *mut RhumbCheckpoint,
) -> RhumbCode {
    guard(|| {
        check_out(checkpoint, "checkpoint")?;
        // SAFETY: the caller promises the memory.
        let bytes = unsafe { elements(bytes, count, "bytes") }?;
        let id = CHECKPOINTS.insert(Checkpoint::from_bytes(bytes)?);
        // SAFETY: the caller promises the memory.
        unsafe { write(checkpoint, RhumbCheckpoint { id }, "checkpoint") }
    })
}

/// Closes a checkpoint. Scenes that were made of it stay.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_checkpoint_close(checkpoint: RhumbCheckpoint) -> RhumbCode {
    guard(|| CHECKPOINTS.remove(checkpoint.id).map(drop))
}

/// Makes a scene that continues from a checkpoint, to be joined by its name. Bodies keep their ids. The scene has no
/// members at first: it ends if none joins for ten minutes.
///
/// # Safety
///
/// `name` is a text that ends with a zero byte.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_local_server_restore(
    server: RhumbLocalServer,
    name: *const c_char,
    checkpoint: RhumbCheckpoint,
) -> RhumbCode {
    guard(|| {
        // SAFETY: the caller promises the text.
        let name = unsafe { text(name, "name") }?;
        let server = server_of(server)?;
        CHECKPOINTS.with(checkpoint.id, |checkpoint| server.restore(name, checkpoint))
    })
}

/// Closes the handle of a server. The server itself ends with the last of its connections and scenes.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_local_server_close(server: RhumbLocalServer) -> RhumbCode {
    guard(|| SERVERS.remove(server.id).map(drop))
}
