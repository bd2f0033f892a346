//! The page in which scenes are seen, served over HTTP.
//!
//! Beside the page's files it answers what the page needs to connect, and conditions the link of the page's own
//! connections: these pass through a relay, and no other connection does. It refuses pages of other origins.

mod answer;
mod facts;
mod listener;

use core::net::{IpAddr, Ipv4Addr, SocketAddr};

pub use self::facts::ViewScene;
pub(crate) use self::listener::PageListener;
pub use self::listener::ViewError;

/// The TCP address of the page unless another one is named.
pub(crate) const DEFAULT_VIEW: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8433);
