//! `rhumb-server demo`: scenes to look at, in a page that one command opens.

mod file;
mod reset_script;

use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::fmt;
use std::process::{Command, Stdio};
use std::str::FromStr;

use clap::Args;
use rhumb_protocol::scene::{SceneName, Stepping};
use rhumb_scene::{ProvidedScene, ProvidedScenes};
use rhumb_sims::{Asteroids, BallPit, Cubes, Ragdolls, Script, Spin, Tumbler};

use self::file::FileScene;
use self::reset_script::{ResetAfter, reset_script};
use crate::settings::ServerSettings;
use crate::view::ViewScene;

/// Seconds for which a scene whose bodies lie still is shown so: that silence costs nothing is to be seen, too.
const STILL_SECONDS: u32 = 2;

/// One scene of the demo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum DemoScene {
    BallPit,
    Ragdolls,
    Cubes,
    Tumbler,
    Asteroids,
}

/// The scene that a demo shows first.
#[derive(Clone, Debug)]
pub(crate) enum FirstScene {
    Own(DemoScene),
    File(Box<FileScene>),
}

/// A name that no scene of the demo has, and no file that is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct UnknownScene {
    name: String,
    /// The reason why the file cannot be shown.
    file: String,
}

impl DemoScene {
    pub(crate) const ALL: [Self; 5] = [
        Self::BallPit,
        Self::Ragdolls,
        Self::Cubes,
        Self::Tumbler,
        Self::Asteroids,
    ];

    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::BallPit => "ball-pit",
            Self::Ragdolls => "ragdolls",
            Self::Cubes => "cubes",
            Self::Tumbler => "tumbler",
            Self::Asteroids => "asteroids",
        }
    }

    /// Bodies, unless the command line names another number.
    const fn bodies(self) -> u32 {
        match self {
            Self::BallPit => BallPit::BALLS_PER_CYCLE,
            Self::Ragdolls => 300,
            Self::Cubes => Cubes::BODIES,
            Self::Tumbler => 500,
            Self::Asteroids => Asteroids::ROCKS,
        }
    }

    /// When its bodies are back where they began: something is to be seen whenever a visitor comes. The cubes wait for
    /// a visitor who moves them.
    const fn reset_after(self) -> ResetAfter {
        let (seconds, still_seconds) = match self {
            Self::BallPit => (BallPit::CYCLE_SECONDS, Some(STILL_SECONDS)),
            Self::Ragdolls => (20, Some(STILL_SECONDS)),
            Self::Tumbler => (60, None),
            Self::Cubes | Self::Asteroids => (120, None),
        };
        ResetAfter {
            seconds,
            still_seconds,
        }
    }

    fn script(self, bodies: u32, seed: u64) -> Box<dyn Script> {
        match self {
            Self::BallPit => Box::new(BallPit::new(bodies, 1, seed)),
            Self::Ragdolls => Box::new(Ragdolls::new(bodies, seed)),
            Self::Cubes => Box::new(Cubes::new(bodies, seed).driven_by_a_member()),
            Self::Tumbler => Box::new(Tumbler::new(bodies, seed)),
            Self::Asteroids => Box::new(Asteroids::new(bodies, seed, Spin::Gyroscopic)),
        }
    }

    fn provided(self, bodies: u32, seed: u64) -> ProvidedScene {
        let script = self.script(bodies, seed);
        let mut config = script.config();
        config.stepping = Stepping::FreeRunning;
        ProvidedScene {
            config,
            script: reset_script(script, self.reset_after()),
        }
    }
}

impl DemoScene {
    fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|scene| scene.name() == name)
    }
}

impl FromStr for FirstScene {
    type Err = UnknownScene;

    fn from_str(name: &str) -> Result<Self, UnknownScene> {
        if let Some(scene) = DemoScene::named(name) {
            return Ok(Self::Own(scene));
        }
        let read = FileScene::read(name).map(|file| Self::File(Box::new(file)));
        read.map_err(|why| UnknownScene {
            name: name.to_owned(),
            file: why.to_string(),
        })
    }
}

impl fmt::Display for UnknownScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names = DemoScene::ALL.map(DemoScene::name).join(", ");
        let Self { name, file } = self;
        write!(
            f,
            "the demo has no scene {name:?}: there are {names}; nor is it a file that can be shown: {file}"
        )
    }
}

impl std::error::Error for UnknownScene {}

/// All scenes of the demo, the first one with another number of bodies if that is given.
fn provided(first: FirstScene, bodies: Option<u32>, seed: u64) -> ProvidedScenes {
    ProvidedScenes::new(move |name: &SceneName| {
        let first = match &first {
            FirstScene::File(file) if file.name == *name => return Some(file.provided()),
            FirstScene::File(_) => None,
            FirstScene::Own(scene) => Some(*scene),
        };
        let scene = DemoScene::named(name.as_str())?;
        let bodies = bodies.filter(|_| Some(scene) == first);
        Some(scene.provided(bodies.unwrap_or(scene.bodies()), seed))
    })
}

/// The scenes that the page offers, the first one first.
fn view_scenes(first: &FirstScene) -> Vec<ViewScene> {
    let own = |scene: DemoScene| ViewScene {
        name: scene.name().to_owned(),
        player: (scene == DemoScene::Cubes).then_some(Cubes::PLAYER.index()),
    };
    let (first, taken) = match first {
        FirstScene::Own(scene) => (own(*scene), Some(*scene)),
        FirstScene::File(file) => {
            let name = file.name.as_str().to_owned();
            (ViewScene { name, player: None }, None)
        }
    };
    let others = DemoScene::ALL.into_iter();
    let others = others.filter(|scene| Some(*scene) != taken).map(own);
    [first].into_iter().chain(others).collect()
}

/// Variables of the environment that say that a desktop is there.
const DESKTOPS: [&str; 2] = ["DISPLAY", "WAYLAND_DISPLAY"];

/// Asks the desktop to open a URL in its browser; false if there is no desktop.
pub(crate) fn open_browser(url: &str) -> bool {
    if !cfg!(target_os = "macos") && DESKTOPS.iter().all(|name| std::env::var_os(name).is_none()) {
        return false;
    }
    let program = if cfg!(target_os = "macos") {
        "open"
    } else {
        "xdg-open"
    };
    let mut command = Command::new(program);
    command
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    match command.spawn() {
        // The program ends as soon as a browser has the URL, or with this process.
        Ok(_) => true,
        Err(cause) => {
            tracing::debug!(%cause, program, "no browser opens the page");
            false
        }
    }
}

/// The TCP address of the page unless another one is named.
const DEFAULT_VIEW: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8433);

/// The scene to show first, and where.
#[derive(Debug, Args)]
pub(crate) struct DemoArguments {
    /// The scene: ball-pit, ragdolls, cubes, tumbler or asteroids; or a file: URDF, MJCF or a JSON scene. The page has the
    /// others too.
    #[arg(default_value = "ball-pit")]
    scene: FirstScene,
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
        provided(self.scene.clone(), self.bodies, self.seed)
    }

    pub(crate) fn scenes(&self) -> Vec<ViewScene> {
        view_scenes(&self.scene)
    }

    /// The parts of a file that its scene has not, a line for each.
    pub(crate) fn left_out(&self) -> String {
        match &self.scene {
            FirstScene::Own(_) => String::new(),
            FirstScene::File(file) => file.to_string(),
        }
    }

    pub(crate) const fn opens_browser(&self) -> bool {
        !self.no_browser
    }
}
