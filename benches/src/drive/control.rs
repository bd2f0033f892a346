//! A script's controller as a scene hook, here and in a server process.

use std::fmt;
use std::io::{self, Write};
use std::process::ExitCode;

use clap::Args;
use rhumb_server::{Hook, Hooks, Scene};
use rhumb_sims::{Controller, Script};

/// Identifies a script and so its controller.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScriptChoice {
    /// Name of the script.
    pub scene: String,
    /// Number of bodies.
    pub bodies: u32,
    /// Seed of the script.
    pub seed: u64,
}

impl ScriptChoice {
    /// Builds the script; `None` if the name is unknown.
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

/// Wraps a controller as a scene hook.
pub(super) fn hook(mut controller: Box<dyn Controller>) -> Hook {
    Hook::new(move |scene: &Scene, out| {
        let motion = |id| scene.observation(id).map(|observation| observation.motion);
        controller.before_step(scene.tick(), &motion, out);
    })
}

/// Arguments of a server whose scenes run the controller of a script.
#[derive(Debug, Args)]
pub struct Serve {
    #[command(flatten)]
    server: rhumb_server::cli::Arguments,
    /// Script whose controller acts in the scenes; none by default.
    #[arg(long, requires_all = ["bodies", "seed"])]
    scene: Option<String>,
    /// Number of bodies of the script.
    #[arg(long)]
    bodies: Option<u32>,
    /// Seed of the script.
    #[arg(long)]
    seed: Option<u64>,
}

/// Runs a server until it is stopped. Exit code 1 if it cannot start or the script is unknown.
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
    let script_choice = ScriptChoice {
        scene,
        bodies,
        seed,
    };
    let Some(script) = script_choice.script() else {
        // If standard error is closed, no other place is left to report to.
        let _ = writeln!(io::stderr(), "error: no such script: {script_choice}");
        return ExitCode::FAILURE;
    };
    let hooks = Hooks::new(move |_, _| script.controller().map(hook));
    rhumb_server::cli::main_with(server, Some(hooks))
}

/// Ends this process when its parent ends, for any reason.
#[cfg(target_os = "linux")]
fn end_with_parent() {
    use rustix::process::{Signal, set_parent_process_death_signal};
    // If the system refuses, the server outlives a killed parent, as on other systems.
    let _ = set_parent_process_death_signal(Some(Signal::TERM));
}

/// Not available on this system: the process outlives its parent.
#[cfg(not(target_os = "linux"))]
fn end_with_parent() {}
