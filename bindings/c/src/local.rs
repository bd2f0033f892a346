//! Servers in the process of the caller.

use rhumb_bindings::BindingError;
use rhumb_bindings::rhumb_client::{Client, LocalServer};

use crate::border::{check_out, guard, write};
use crate::connection::{RhumbConnection, insert, time_limit};
use crate::handles::HandleTable;
use crate::status::RhumbCode;

/// A physics server in this process. All zeros is none.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct RhumbLocalServer {
    /// Its number.
    pub id: u64,
}

static SERVERS: HandleTable<LocalServer> = HandleTable::new();

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
        let id = insert(Client::local());
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
        let id = SERVERS.insert(made);
        // SAFETY: the caller promises the memory.
        unsafe { write(server, RhumbLocalServer { id }, "server") }
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
        let opened = SERVERS.with(server.id, |server| Ok(server.connect()))?;
        let id = insert(opened.timeout(timeout));
        // SAFETY: the caller promises the memory.
        unsafe { write(connection, RhumbConnection { id }, "connection") }
    })
}

/// Closes the handle of a server. The server itself ends with the last of its connections and scenes.
#[unsafe(no_mangle)]
pub extern "C" fn rhumb_local_server_close(server: RhumbLocalServer) -> RhumbCode {
    guard(|| SERVERS.remove(server.id).map(drop))
}
