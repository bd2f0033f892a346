//! Opens the page in the browser of the desktop, if there is one.

use std::process::{Command, Stdio};

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
