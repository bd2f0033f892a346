//! A script's controller as the hook of a scene, here and in a server process.

use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::Args;
use rhumb_server::{Hook, Hooks, Scene};
use rhumb_sims::{Controller, Script};

/// Which script is played, and so which controller acts beside the engine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptChoice {
    /// Its name.
    pub scene: String,
    /// Its load.
    pub bodies: u32,
    /// Its seed.
    pub seed: u64,
}

impl ScriptChoice {
    /// The script; none if nothing has this name.
    #[must_use]
    pub fn script(&self) -> Option<Box<dyn Script>> {
        rhumb_sims::by_name(&self.scene, self.bodies, self.seed)
    }
}

impl fmt::Display for ScriptChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} of {} bodies, seed {}",
            self.scene, self.bodies, self.seed
        )
    }
}

/// A controller as a hook.
pub(super) fn hook(mut controller: Box<dyn Controller>) -> Hook {
    Hook::new(move |scene: &Scene, out| {
        let motion = |id| scene.observation(id).map(|seen| seen.motion);
        controller.before_step(scene.tick(), &motion, out);
    })
}

/// A server whose scenes have the controller of a script.
#[derive(Debug, Args)]
pub struct Serve {
    #[command(flatten)]
    server: rhumb_server::cli::Arguments,
    /// Which script's controller acts in the scenes; none without it.
    #[arg(long, requires_all = ["bodies", "seed"])]
    scene: Option<String>,
    /// Its number of bodies.
    #[arg(long)]
    bodies: Option<u32>,
    /// Its seed.
    #[arg(long)]
    seed: Option<u64>,
}

/// Runs a server until it is told to stop; exit code 1 when it cannot start, or when there is no such script.
pub fn serve(arguments: Serve) -> ExitCode {
    end_with_parent();
    let Serve {
        server,
        scene,
        bodies,
        seed,
    } = arguments;
    let (Some(scene), Some(bodies), Some(seed)) = (scene, bodies, seed) else {
        return rhumb_server::cli::main(server);
    };
    let played = ScriptChoice {
        scene,
        bodies,
        seed,
    };
    let Some(script) = played.script() else {
        // Nowhere is left to say that standard error is closed.
        let _ = writeln!(io::stderr(), "error: there is no script of {played}");
        return ExitCode::FAILURE;
    };
    let hooks = Hooks::new(move |_, _| script.controller().map(hook));
    rhumb_server::cli::main_with(server, Some(hooks))
}

/// Has this process end when the one that started it is gone, however that ended.
#[cfg(target_os = "linux")]
fn end_with_parent() {
    use rustix::process::{Signal, set_parent_process_death_signal};
    // Refused, a server outlives a caller that was killed, as on other systems.
    let _ = set_parent_process_death_signal(Some(Signal::TERM));
}

/// Has this process end when the one that started it is gone: not on this system.
#[cfg(not(target_os = "linux"))]
fn end_with_parent() {}
