//! Arguments of the command line for APP clients.

use core::net::SocketAddr;

use clap::{Args, ValueEnum};
use rhumb_app::{AppBindError, AppListen, AppOptions, Datagrams, States, TimeAdvanced};

use crate::serve::Server;

/// Listener for APP clients, and what they are sent.
#[derive(Clone, Debug, Args)]
pub(crate) struct AppArguments {
    /// TCP and UDP address for APP clients, such as OpenSimulator's RemotePhysics plug-in.
    #[arg(long)]
    app_listen: Option<SocketAddr>,
    /// The message by which APP clients learn that a frame is over.
    #[arg(long, value_enum, default_value = "tcp", requires = "app_listen")]
    app_time_advanced: FrameEnd,
    /// Bodies whose state is sent to APP clients in each frame.
    #[arg(long, value_enum, default_value = "changed", requires = "app_listen")]
    app_states: StateSelection,
    /// Datagrams to each APP client in a millisecond; 0 for no limit. The plug-in takes up to 277 every 10 ms.
    #[arg(long, default_value_t = 20, requires = "app_listen")]
    app_datagram_rate: u32,
    /// Pack as many states in a datagram as fit, for measurements: the plug-in reads only the first.
    #[arg(long, requires = "app_listen")]
    app_packed: bool,
}

/// The message by which APP clients learn that a frame is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum FrameEnd {
    /// On TCP, where the message is not lost.
    Tcp,
    /// By the last datagram.
    Udp,
    /// Not at all: saves the plug-in the cost of its lists.
    Never,
}

/// Bodies whose state is sent to APP clients.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum StateSelection {
    /// Every body that can move.
    All,
    /// Every body that is awake.
    Active,
    /// Every body that has moved since its last sent state.
    Changed,
}

impl AppArguments {
    /// Listens for APP clients if the arguments say so, and returns the address.
    pub(crate) fn listen(&self, server: &mut Server) -> Result<Option<SocketAddr>, AppBindError> {
        let Some(address) = self.app_listen else {
            return Ok(None);
        };
        let listen = AppListen {
            address,
            datagrams_per_ms: (self.app_datagram_rate > 0).then_some(self.app_datagram_rate),
        };
        server.listen_app(listen, self.options()).map(Some)
    }

    /// The address to listen at, if other machines reach it. APP clients have no tokens.
    pub(crate) fn beyond_loopback(&self) -> Option<SocketAddr> {
        self.app_listen
            .filter(|address| !address.ip().is_loopback())
    }

    fn options(&self) -> AppOptions {
        AppOptions {
            time_advanced: match self.app_time_advanced {
                FrameEnd::Tcp => TimeAdvanced::Tcp,
                FrameEnd::Udp => TimeAdvanced::Udp,
                FrameEnd::Never => TimeAdvanced::Never,
            },
            states: match self.app_states {
                StateSelection::All => States::All,
                StateSelection::Active => States::Active,
                StateSelection::Changed => States::Changed,
            },
            datagrams: if self.app_packed {
                Datagrams::Packed
            } else {
                Datagrams::Single
            },
        }
    }
}
