//! Connections, before they join a scene.

use std::ffi::c_char;
use std::path::Path;
use std::time::Duration;

use rhumb_bindings::rhumb_client::{Client, ServerConnection, Trust};
use rhumb_bindings::{BindingError, OwnServer};

use crate::border::{HandleTable, RhumbCode, check_out, guard, optional_text, text, value, write};

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
                server_of(options)?,
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
unsafe fn server_of(options: &RhumbConnectOptions) -> Result<(&str, Trust), BindingError> {
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
