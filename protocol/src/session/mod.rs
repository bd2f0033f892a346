//! The connection's state at both ends: allowed messages and their effects.
mod client;
mod close;
mod event;
mod misuse;
mod pings;
mod replica;
mod replica_switch;
mod server;
mod transport_code;
mod upstream_receiver;
mod upstream_sender;
mod upstream_timeout;

pub use client::ClientSession;
pub use close::CloseCode;
pub use event::Event;
pub use misuse::Misuse;
pub use replica::Replica;
pub use server::ServerSession;
pub use transport_code::TransportCode;
pub use upstream_receiver::UpstreamReceiver;
