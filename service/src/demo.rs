//! `rhumb-server demo`: scenes to look at, in a page that one command opens.
//!
//! A scene is a script that begins anew, again and again; it can come from a file.
//! A reset puts the script's bodies back where they began and removes all others. Bodies keep their ids, so that what
//! members know of them holds. It comes after so many seconds, or when nothing has been seen to move for some.

use core::fmt;
use core::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::collections::BTreeMap;
use std::process::{self, Stdio};
use std::str::FromStr;

use clap::Args;
use glam::{Quat, Vec3};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneName, Shape, Stepping};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_scene::{ProvidedScene, ProvidedScenes, Scene, SceneScript};
use rhumb_scene_files::{
    FileScript, Folder, LoadError, LoadOptions, LoadedBody, LoadedScene, UpAxis, load,
};
use rhumb_sims::{Asteroids, BallPit, Cubes, Ragdolls, Script, Spin, Tumbler};

use crate::settings::ServerSettings;
use crate::view::ViewScene;

/// Seconds for which a scene whose bodies lie still is shown so: that silence costs nothing is to be seen, too.
const STILL_SECONDS: u32 = 2;

/// One scene of the demo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DemoScene {
    BallPit,
    Ragdolls,
    Cubes,
    Tumbler,
    Asteroids,
}

/// The scene that a demo shows first.
#[derive(Clone, Debug)]
enum FirstScene {
    Own(DemoScene),
    File(Box<FileScene>),
}

/// A name that no scene of the demo has, and no file that is read.
#[derive(Clone, Debug, PartialEq, Eq)]
struct UnknownScene {
    name: String,
    /// The reason why the file cannot be shown.
    file: String,
}

impl DemoScene {
    const ALL: [Self; 5] = [
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
    let mut command = process::Command::new(program);
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
    /// The scene: ball-pit, ragdolls, cubes, tumbler or asteroids; or a file: URDF, MJCF, glTF or a JSON scene. The
    /// page has the others too.
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

/// A scene of the demo that is read from a file.
#[derive(Clone, Debug)]
struct FileScene {
    name: SceneName,
    scene: LoadedScene,
    script: FileScript,
}

/// Seconds after which the bodies of a file are back where they began.
const RESET_SECONDS: u32 = 20;
/// Seconds for which they lie still before.
const FILE_STILL_SECONDS: u32 = 4;

impl FileScene {
    /// Reads a file. A scene whose bodies would fall for ever gets a floor.
    pub(crate) fn read(path: &str) -> Result<Self, LoadError> {
        let options = LoadOptions {
            up: UpAxis::Y,
            ..LoadOptions::default()
        };
        let mut scene = load(&Folder::default(), path, &options)?;
        let is_fixed = |body: &LoadedBody| body.builder.kind() == BodyKind::Fixed;
        if !scene.bodies.iter().any(is_fixed) && scene.config.gravity != Vec3::ZERO {
            let floor = floor(&scene.bodies);
            scene.bodies.push(floor);
        }
        let script = FileScript::new(&scene)?;
        Ok(Self {
            name: name(path),
            scene,
            script,
        })
    }

    fn provided(&self) -> ProvidedScene {
        let script = self.script.clone();
        let mut config = script.config();
        config.stepping = Stepping::FreeRunning;
        let after = ResetAfter {
            seconds: RESET_SECONDS,
            still_seconds: Some(FILE_STILL_SECONDS),
        };
        ProvidedScene {
            config,
            script: reset_script(Box::new(script), after),
        }
    }
}

/// The parts of the file that the scene has not, a line for each.
impl fmt::Display for FileScene {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let notes = self.scene.report.notes();
        notes.iter().try_for_each(|note| writeln!(f, "{note}"))
    }
}

/// A name for the scene of a file, which no scene of the demo has.
fn name(path: &str) -> SceneName {
    let file = path.rsplit(['/', '\\']).next().unwrap_or(path);
    let plain = |sign: char| match sign.is_ascii_alphanumeric() || ".-_".contains(sign) {
        true => sign,
        false => '-',
    };
    let name: String = file.chars().take(50).map(plain).collect();
    let name = format!("file/{name}").parse();
    name.expect("letters, digits and few signs, less than 64 of them")
}

/// A floor under the lowest body.
fn floor(bodies: &[LoadedBody]) -> LoadedBody {
    let lowest = |body: &LoadedBody| {
        let height = body.builder.state().map_or(0.0, |state| state.parts()[1]);
        height - body.builder.shape().bounding_radius().metres() as f32
    };
    let lowest = bodies.iter().map(lowest).fold(f32::MAX, f32::min);
    let slab = Shape::cuboid(20.0, 0.5, 20.0);
    LoadedBody {
        name: "floor".to_owned(),
        builder: BodyDesc::fixed(slab).at(0.0, lowest - 0.5, 0.0),
        tick: 0,
        frame_position: Vec3::ZERO,
        frame_rotation: Quat::IDENTITY,
    }
}

/// When a scene begins anew, in seconds of its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct ResetAfter {
    /// Since the last beginning.
    seconds: u32,
    /// Since nothing is seen to move; `None` for a scene that stands still until a member moves something.
    still_seconds: Option<u32>,
}

/// A script without end: its first commands, its controller, and resets.
fn reset_script(mut script: Box<dyn Script>, after: ResetAfter) -> SceneScript {
    let mut controller = script.controller();
    let mut resets: Option<Resets> = None;
    SceneScript::new(move |scene: &Scene, out: &mut Vec<Command>| {
        let tick = scene.tick();
        match &mut resets {
            None => {
                script.commands(Tick::ZERO, out);
                resets = Some(Resets::new(out, scene, after));
            }
            Some(resets) => {
                let motion = |id| scene.observation(id).map(|observation| observation.motion);
                if resets.is_due(scene) {
                    resets.reset(scene, out);
                } else if let Some(controller) = &mut controller {
                    controller.before_step(tick, &motion, out);
                }
            }
        }
    })
}

/// The places of the script's bodies at its begin.
struct Resets {
    began: BTreeMap<BodyId, (BodyKind, BodyState)>,
    /// Ticks from one reset to the next.
    period: u64,
    /// Ticks of stillness before a reset.
    still_period: Option<u64>,
    /// Tick of the last reset.
    last: Tick,
    /// The last tick at which something was seen to move.
    moved: Tick,
}

/// Speed in m/s of the fastest body of a scene that counts as still: slower motion is hardly seen.
const STILL_SPEED: f32 = 0.1;

impl Resets {
    fn new(commands: &[Command], scene: &Scene, after: ResetAfter) -> Self {
        let began = commands.iter().filter_map(|command| match command {
            Command::AddBody { desc, motion } => Some((desc.id, (desc.kind, *motion))),
            _ => None,
        });
        let step_ns = scene.config().integrator.rate.step_ns();
        let ticks = |seconds: u32| (u64::from(seconds) * 1_000_000_000 / step_ns).max(1);
        Self {
            began: began.collect(),
            period: ticks(after.seconds),
            still_period: after.still_seconds.map(ticks),
            last: scene.tick(),
            moved: scene.tick(),
        }
    }

    /// Notes whether the scene moves; true if it is to begin anew.
    fn is_due(&mut self, scene: &Scene) -> bool {
        let tick = scene.tick();
        let moves = |seen: &Observation| {
            let velocity = Vec3::from_slice(&seen.motion.parts()[7..10]);
            velocity.length() > STILL_SPEED
        };
        if scene.observations().iter().any(moves) {
            self.moved = tick;
        }
        let since = |then: Tick| tick.value().saturating_sub(then.value());
        let is_still = self
            .still_period
            .is_some_and(|period| since(self.moved) >= period);
        is_still || since(self.last) >= self.period
    }

    fn reset(&mut self, scene: &Scene, out: &mut Vec<Command>) {
        self.last = scene.tick();
        self.moved = scene.tick();
        for body in scene.bodies() {
            let id = body.id;
            match self.began.get(&id) {
                None => out.push(Command::RemoveBody { id }),
                Some((BodyKind::Dynamic, motion)) => out.extend(put_back(id, motion)),
                // The controller moves kinematic bodies; fixed ones have not moved.
                Some((BodyKind::Fixed | BodyKind::Kinematic, _)) => {}
            }
        }
    }
}

fn put_back(id: BodyId, motion: &BodyState) -> [Command; 2] {
    let parts = motion.parts();
    let vector = |from: usize| Vec3::from_slice(&parts[from..from + 3]);
    [
        Command::SetPose {
            id,
            position: vector(0),
            rotation: Quat::from_slice(&parts[3..7]),
        },
        Command::SetVelocity {
            id,
            linear: vector(7),
            angular: vector(10),
        },
    ]
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::{BodyDesc, ShapeId};
    use rhumb_sims::{BallPit, Cubes};

    use super::*;

    #[test]
    fn the_name_of_a_file_is_one_of_a_scene() {
        assert_eq!(name("robots/a b.urdf").as_str(), "file/a-b.urdf");
        assert_eq!(name("").as_str(), "file/");
        assert!(name(&"ä".repeat(90)).as_str().len() < 64);
    }

    #[test]
    fn what_would_fall_for_ever_gets_a_floor() {
        let folder = std::env::temp_dir().join(format!("rhumb-demo-file-{}", process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join("ball.json");
        let ball = |kind: &str| {
            format!(
                "{{\"bodies\": [{{\"dynamic\": {kind}, \"shape\": {{\"ball\": {{\"radius\": 0.5}}}}, \"position\": [0, 3, 0], \"mood\": 1}}]}}"
            )
        };
        for (dynamic, bodies) in [("true", 2), ("false", 1)] {
            std::fs::write(&path, ball(dynamic)).unwrap();
            let scene = FileScene::read(path.to_str().unwrap()).unwrap();
            assert_eq!(scene.scene.bodies.len(), bodies);
            assert_eq!(scene.name.as_str(), "file/ball.json");
            assert!(scene.to_string().contains("mood of body 0"), "{scene}");
            assert_eq!(scene.provided().config.stepping, Stepping::FreeRunning);
        }
        std::fs::remove_dir_all(folder).unwrap();
    }

    const fn every(seconds: u32) -> ResetAfter {
        ResetAfter {
            seconds,
            still_seconds: None,
        }
    }

    fn run(script: &mut SceneScript, scene: &mut Scene) {
        for command in script.commands(scene) {
            scene.apply(&command).unwrap();
        }
    }

    fn states(scene: &Scene) -> Vec<(BodyId, BodyState)> {
        let dynamic = scene.bodies().filter(|body| body.kind == BodyKind::Dynamic);
        let state = |id| scene.observation(id).unwrap().motion;
        dynamic.map(|body| (body.id, state(body.id))).collect()
    }

    #[test]
    fn a_reset_puts_the_scripts_bodies_back_and_removes_all_others() {
        let first = Box::new(BallPit::new(20, 1, 3));
        let mut scene = Scene::new(first.config()).unwrap();
        let mut script = reset_script(first, every(1));
        run(&mut script, &mut scene);
        let began = states(&scene);
        assert_eq!(began.len(), 20);
        scene.step().unwrap();
        let other = BodyId::new(90_000, 0);
        let desc = BodyDesc::plain(other, BodyKind::Dynamic, ShapeId(11));
        let motion = began[0].1;
        scene.apply(&Command::AddBody { desc, motion }).unwrap();
        for _ in 1..60 {
            run(&mut script, &mut scene);
            scene.step().unwrap();
        }
        assert_ne!(states(&scene), began);
        assert!(scene.body(other).is_some());
        run(&mut script, &mut scene);
        assert_eq!(states(&scene), began);
        assert!(scene.body(other).is_none());
        scene.step().unwrap();
        run(&mut script, &mut scene);
        assert_ne!(states(&scene), began, "the next reset is later");
    }

    #[test]
    fn a_scene_that_stands_still_begins_anew() {
        let pit = Box::new(BallPit::new(20, 1, 3));
        let mut scene = Scene::new(pit.config()).unwrap();
        let after = ResetAfter {
            seconds: 3_600,
            still_seconds: Some(2),
        };
        let mut script = reset_script(pit, after);
        run(&mut script, &mut scene);
        let began = states(&scene);
        let speed = |state: &BodyState| Vec3::from_slice(&state.parts()[7..10]).length();
        let mut still = 0;
        for _ in 0..3_600 {
            scene.step().unwrap();
            let fastest = states(&scene)
                .iter()
                .map(|(_, state)| speed(state))
                .fold(0.0, f32::max);
            still = if fastest > STILL_SPEED { 0 } else { still + 1 };
            run(&mut script, &mut scene);
            if states(&scene) == began {
                assert_eq!(
                    still, 120,
                    "two seconds after the last ball was seen to move"
                );
                return;
            }
        }
        panic!("the balls lie still and are not dropped again");
    }

    #[test]
    fn a_player_moves_only_when_a_member_pushes_it() {
        let cubes = Box::new(Cubes::new(2, 1).driven_by_a_member());
        let mut scene = Scene::new(cubes.config()).unwrap();
        let mut script = reset_script(cubes, every(60));
        for _ in 0..600 {
            run(&mut script, &mut scene);
            scene.step().unwrap();
        }
        let player = scene.observation(Cubes::PLAYER).unwrap().motion;
        let velocity = Vec3::from_slice(&player.parts()[7..10]);
        assert!(velocity.length() < 0.1, "{player:?}");
        let impulse = Vec3::X * 20.0;
        let id = Cubes::PLAYER;
        scene.apply(&Command::Impulse { id, impulse }).unwrap();
        run(&mut script, &mut scene);
        scene.step().unwrap();
        let pushed = scene.observation(Cubes::PLAYER).unwrap().motion;
        assert!(pushed.parts()[7] > 1.0, "{pushed:?}");
    }
}
