//! Arguments of `rhumb-server demo`.

use core::net::{IpAddr, Ipv4Addr, SocketAddr};

use clap::Args;
use rhumb_scene::ProvidedScenes;

use super::scenes::{DemoScene, provided, view_scenes};
use crate::settings::ServerSettings;
use crate::view::ViewScene;

/// The TCP address of the page unless another one is named.
const DEFAULT_VIEW: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8433);

/// The scene to show first, and where.
#[derive(Debug, Args)]
pub(crate) struct DemoArguments {
    /// The scene: ball-pit, ragdolls, cubes, tumbler or asteroids. The page has the others too.
    #[arg(default_value = "ball-pit")]
    scene: DemoScene,
    /// TCP address of the page.
    #[arg(long, value_name = "ADDRESS", default_value_t = DEFAULT_VIEW)]
    view: SocketAddr,
    /// UDP address of the server; port 0 picks a free one.
    #[arg(long, default_value_t = SocketAddr::from(([127, 0, 0, 1], 0)))]
    listen: SocketAddr,
    /// Number of bodies of the scene, about.
    #[arg(long)]
    bodies: Option<u32>,
    /// Seed of the scenes.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Shows the scenes live to Foxglove's viewers too, at this TCP address, or without one at 127.0.0.1:8765.
    #[cfg(feature = "foxglove")]
    #[arg(long, value_name = "ADDRESS", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    foxglove: Option<SocketAddr>,
    /// Does not open a browser.
    #[arg(long)]
    no_browser: bool,
}

impl DemoArguments {
    /// The settings of a server that shows the demo.
    pub(crate) fn settings(&self) -> ServerSettings {
        ServerSettings {
            listen: self.listen,
            view: Some(self.view),
            open: true,
            #[cfg(feature = "foxglove")]
            foxglove: self.foxglove,
            ..ServerSettings::default()
        }
    }

    pub(crate) fn provided(&self) -> ProvidedScenes {
        provided(self.scene, self.bodies, self.seed)
    }

    pub(crate) fn scenes(&self) -> Vec<ViewScene> {
        view_scenes(self.scene)
    }

    pub(crate) const fn opens_browser(&self) -> bool {
        !self.no_browser
    }
}
