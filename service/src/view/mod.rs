//! The page in which scenes are seen, served over HTTP.
//!
//! Beside the page's files it answers what the page needs to connect, and conditions the link of the page's own
//! connections: these pass through a relay, and no other connection does. It refuses pages of other origins. The same page,
//! written with recordings, needs no server.

mod answer;
mod listener;
mod static_page;

pub use self::answer::ViewScene;
pub(crate) use self::listener::PageListener;
pub use self::listener::ViewError;
pub(crate) use self::static_page::{PageArguments, run as write_page};
