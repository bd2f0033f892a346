//! Servers in the process of the caller.

use std::ffi::c_char;
use std::sync::Arc;

use rhumb_bindings::rhumb_client::{Checkpoint, LocalServer};
use rhumb_bindings::{BindingError, OwnServer, Reach, RemoteScene, ServedScenes};

use crate::border::{
    HandleTable, RhumbCode, check_out, copy_out, copy_text, elements, guard, optional_text, text,
    write,
};
use crate::connection::{RhumbConnection, insert, time_limit};
use crate::scene::{RhumbScene, with};

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

/// The address of the page that shows the scene to browsers of this machine, until the scene is closed. Its server must be in
/// this process.
///
/// # Safety
///
/// `address` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_page(
    scene: RhumbScene,
    address: *mut RhumbAddress,
) -> RhumbCode {
    guard(|| {
        check_out(address, "address")?;
        let text = copy_text(&with(scene, RemoteScene::page)?);
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

static CHECKPOINTS: HandleTable<Checkpoint> = HandleTable::new();

/// Saves a scene with everything that this client has sent. Scenes that `rhumb_local_server_restore` makes of it run to the
/// same bits, given the same commands before the same ticks. The scene's server must be in this process.
///
/// # Safety
///
/// `checkpoint` points to what its type says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn rhumb_scene_save(
    scene: RhumbScene,
    checkpoint: *mut RhumbCheckpoint,
) -> RhumbCode {
    guard(|| {
        check_out(checkpoint, "checkpoint")?;
        let id = CHECKPOINTS.insert(with(scene, RemoteScene::save)?);
        // SAFETY: the caller promises the memory.
        unsafe { write(checkpoint, RhumbCheckpoint { id }, "checkpoint") }
    })
}

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
