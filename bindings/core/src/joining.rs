//! The way into a scene: the server that is meant, and parameters for joining.
//!
//! An address may end with `#` and the fingerprint of its server, so that one text suffices. Lengths are in the coordinates
//! of the application.

use std::num::NonZeroU32;
use std::path::{Path, PathBuf};
use std::time::Duration;

use glam::Vec3;
use rhumb_client::scene::{PublishSchedule, SceneConfig, Sleep, Stepping};
use rhumb_client::{
    Fingerprint, InvalidTicks, JoinMode, JoinOptions, Metres, Rate, Refusals, StreamChoice,
    Tolerance, Trust,
};

use crate::coordinates::Coordinates;
use crate::error::BindingError;

/// The address of a server with its fingerprint, as [`server_of`] reads it.
#[must_use]
pub fn address_with(address: impl std::fmt::Display, fingerprint: Fingerprint) -> String {
    format!("{address}#{fingerprint}")
}

/// The plain address of a server, and what to trust: the certificate with a fingerprint, which the address may end with,
/// or those that the roots in a PEM file sign. A Unix socket has no certificate.
///
/// # Errors
///
/// [`BindingError`] for a text that is no fingerprint, for two fingerprints, for one and roots, and for neither; for
/// either of them beside a Unix socket, where neither would be checked.
pub fn server_of<'a>(
    address: &'a str,
    fingerprint: Option<&str>,
    roots: Option<&Path>,
) -> Result<(&'a str, Trust), BindingError> {
    let needed = |needed| BindingError::Argument {
        argument: "trust",
        needed,
    };
    if address.starts_with("unix:") {
        return match (fingerprint, roots) {
            // It is not asked for: only the user who runs the server can connect.
            (None, None) => Ok((address, Trust::Roots(PathBuf::new()))),
            _ => Err(needed(
                "left out for a Unix socket: it has no certificate, and only the user who runs the server can connect",
            )),
        };
    }
    let (address, own) = match address.rsplit_once('#') {
        Some((address, own)) => (address, Some(own)),
        None => (address, None),
    };
    let fingerprint = match (own, fingerprint) {
        (Some(own), Some(given)) if !own.eq_ignore_ascii_case(given) => {
            return Err(needed(
                "one fingerprint: that of the address and the other one differ",
            ));
        }
        (own, given) => own.or(given),
    };
    let trust = match (fingerprint, roots) {
        (Some(fingerprint), None) => Trust::Fingerprint(fingerprint.parse()?),
        (None, Some(roots)) => Trust::Roots(roots.to_owned()),
        (Some(_), Some(_)) => return Err(needed("a fingerprint or roots, and not both")),
        (None, None) => {
            return Err(needed(
                "given: the fingerprint that the server prints when it starts, also at the end of the address behind a #, \
                 or a PEM file of roots",
            ));
        }
    };
    Ok((address, trust))
}

/// The condition of joining: a new scene, an existing one, or either.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JoinCondition {
    /// Creates the scene unless it exists.
    #[default]
    CreateOrJoin,
    /// Creates the scene, which must not exist.
    Create,
    /// Joins the scene, which must exist.
    Join,
}

/// Parameters for joining a scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JoinParams {
    /// Coordinates of every position, length and force of this client.
    pub coordinates: Coordinates,
    /// The condition of joining: a new scene, an existing one, or either.
    pub condition: JoinCondition,
    /// The most that any point of a copied body may be off, metres in any coordinates.
    pub tolerance_m: f64,
    /// True if the scene is taken by cells, where its server divides it: then the tolerance is of what is in no cell.
    pub cells: bool,
    /// Source of the ticks of a new scene.
    pub stepping: Stepping,
    /// Ticks of a new scene in a second.
    pub ticks_per_second: u32,
    /// Substeps of each tick of a new scene.
    pub substeps: u32,
    /// Published ticks of a new scene are the multiples of this number.
    pub publish_interval: u32,
    /// Gravity of a new scene, units of length per s²; `None`: the earth's, downwards.
    pub gravity: Option<Vec3>,
    /// Conditions under which bodies of a new scene fall asleep, speeds in units of length per second.
    pub sleep: Sleep,
    /// Free running only: ticks by which the view stays behind the server's clock.
    pub delay_ticks: f64,
    /// Free running only: ticks ahead of the server's clock by which bodies under authority are published.
    pub lead_ticks: f64,
    /// Free running only: whether only whole ticks are shown.
    pub whole_ticks: bool,
    /// Free running only: whether corrections are shown as short glides.
    pub smooth: bool,
    /// A refusal of the server is an error of the next call that computes the view, or an event alone.
    pub refusals: Refusals,
    /// Time for which the client tries to resume over another connection; `None`: as the scene suggests.
    pub resume_within: Option<Duration>,
}

impl Default for JoinParams {
    fn default() -> Self {
        let config = SceneConfig::default();
        Self {
            coordinates: Coordinates::Rhumb,
            condition: JoinCondition::CreateOrJoin,
            tolerance_m: 0.05,
            cells: false,
            stepping: config.stepping,
            ticks_per_second: config.integrator.rate.ticks(),
            substeps: config.integrator.substeps.get(),
            publish_interval: config.publish_schedule.publish_interval.get(),
            gravity: None,
            sleep: config.sleep,
            delay_ticks: 0.0,
            lead_ticks: 0.0,
            whole_ticks: false,
            smooth: true,
            refusals: Refusals::default(),
            resume_within: None,
        }
    }
}

impl JoinParams {
    /// The options of the client.
    ///
    /// # Errors
    ///
    /// [`BindingError`] for a tolerance that no stream can have, and for zero ticks, substeps or
    /// publish interval.
    pub fn options(&self) -> Result<JoinOptions, BindingError> {
        let zero = |argument| BindingError::value(argument, 0, "at least 1");
        let mut config = SceneConfig {
            stepping: self.stepping,
            ..SceneConfig::default()
        };
        config.integrator.rate =
            Rate::new(self.ticks_per_second, 1).ok_or_else(|| zero("ticks_per_second"))?;
        config.integrator.substeps =
            NonZeroU32::new(self.substeps).ok_or_else(|| zero("substeps"))?;
        config.publish_schedule = PublishSchedule {
            publish_interval: NonZeroU32::new(self.publish_interval)
                .ok_or_else(|| zero("publish_interval"))?,
            ..config.publish_schedule
        };
        if let Some(gravity) = self.gravity {
            config.gravity = self.coordinates.vector_in(gravity);
        }
        config.sleep = self.coordinates.sleep_in(self.sleep);
        config.check()?;
        for (argument, ticks) in [
            ("delay_ticks", self.delay_ticks),
            ("lead_ticks", self.lead_ticks),
        ] {
            if InvalidTicks::check_delay(ticks).is_err() {
                return Err(BindingError::value(argument, ticks, TICKS_NEEDED));
            }
        }
        let tolerance = tolerance(self.tolerance_m)?;
        Ok(JoinOptions {
            mode: match self.condition {
                JoinCondition::CreateOrJoin => JoinMode::CreateOrJoin(config),
                JoinCondition::Create => JoinMode::Create(config),
                JoinCondition::Join => JoinMode::Join,
            },
            stream: StreamChoice::Within(tolerance),
            cells: self.cells,
            delay_ticks: self.delay_ticks,
            lead_ticks: self.lead_ticks,
            whole_ticks: self.whole_ticks,
            refusals: self.refusals,
            smooth: self.smooth,
            resume_within: self.resume_within,
        })
    }
}

/// The limits of a delay and of a lead.
pub(crate) const TICKS_NEEDED: &str = "0 to 3600";

/// A tolerance, or the error that names it.
pub(crate) fn tolerance(metres: f64) -> Result<Tolerance, BindingError> {
    let checked = Tolerance::from_metres(Metres::new(metres));
    checked.map_err(BindingError::Tolerance)
}

#[cfg(test)]
mod tests {
    use rhumb_client::scene::SleepThresholds;

    use super::*;
    use crate::error::ErrorKind;

    const PRINT: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

    #[test]
    fn an_address_may_carry_its_fingerprint() {
        let text = address_with("127.0.0.1:4433", PRINT.parse().unwrap());
        for (text, fingerprint) in [
            (text.as_str(), None),
            (text.as_str(), Some(PRINT)),
            ("127.0.0.1:4433", Some(PRINT)),
        ] {
            let (address, trust) = server_of(text, fingerprint, None).unwrap();
            assert_eq!(address, "127.0.0.1:4433");
            assert!(matches!(trust, Trust::Fingerprint(print) if print.to_string() == PRINT));
        }
        // The path of a Unix socket may have such a sign.
        let (address, _) = server_of("unix:/tmp/a#b", None, None).unwrap();
        assert_eq!(address, "unix:/tmp/a#b");
        let other = "0".repeat(64);
        let roots = Path::new("roots.pem");
        let (_, trust) = server_of("example.org", None, Some(roots)).unwrap();
        assert!(matches!(trust, Trust::Roots(path) if path == roots));
        for (text, fingerprint, roots, words) in [
            (text.as_str(), Some(other.as_str()), None, "differ"),
            (text.as_str(), None, Some(roots), "not both"),
            ("127.0.0.1:4433", None, None, "behind a #"),
            ("127.0.0.1:4433#", None, None, "64 hexadecimal"),
            ("unix:/tmp/a#b", Some(PRINT), None, "Unix socket"),
            ("unix:/tmp/a", None, Some(roots), "Unix socket"),
        ] {
            let error = server_of(text, fingerprint, roots).unwrap_err();
            assert!(error.to_string().contains(words), "{text}: {error}");
        }
    }

    #[test]
    fn plain_parameters_are_the_clients_defaults() {
        let options = JoinParams::default().options().unwrap();
        let default = JoinOptions::default();
        assert_eq!(options.mode, default.mode);
        assert_eq!(options.stream, default.stream);
        assert_eq!(options.cells, default.cells);
        assert_eq!(options.delay_ticks, default.delay_ticks);
        assert_eq!(options.lead_ticks, default.lead_ticks);
        assert_eq!(options.whole_ticks, default.whole_ticks);
        assert_eq!(options.smooth, default.smooth);
        assert_eq!(options.refusals, default.refusals);
        assert_eq!(options.resume_within, default.resume_within);
    }

    #[test]
    fn wrong_parameters_are_errors() {
        let default = JoinParams::default();
        let wrong = [
            JoinParams {
                tolerance_m: 0.0,
                ..default
            },
            JoinParams {
                tolerance_m: f64::NAN,
                ..default
            },
            JoinParams {
                ticks_per_second: 0,
                ..default
            },
            JoinParams {
                ticks_per_second: u32::MAX,
                ..default
            },
            JoinParams {
                substeps: 0,
                ..default
            },
            JoinParams {
                publish_interval: 0,
                ..default
            },
            JoinParams {
                publish_interval: u32::MAX,
                ..default
            },
            JoinParams {
                gravity: Some(Vec3::NAN),
                ..default
            },
            JoinParams {
                sleep: Sleep::Below(SleepThresholds::by_speed(-1.0, 0.5)),
                ..default
            },
            JoinParams {
                delay_ticks: -1.0,
                ..default
            },
            JoinParams {
                delay_ticks: f64::NAN,
                ..default
            },
            JoinParams {
                lead_ticks: -1.0,
                ..default
            },
            JoinParams {
                delay_ticks: 1e9,
                ..default
            },
        ];
        for params in wrong {
            let error = params.options().expect_err("a wrong parameter");
            assert_eq!(error.kind(), ErrorKind::Invalid, "{params:?}: {error}");
        }
    }

    #[test]
    fn gravity_is_in_the_coordinates_of_the_application() {
        let params = JoinParams {
            coordinates: Coordinates::Unreal,
            gravity: Some(Vec3::new(0.0, 0.0, -981.0)),
            ..JoinParams::default()
        };
        let JoinMode::CreateOrJoin(config) = params.options().unwrap().mode else {
            panic!("the default condition accepts both");
        };
        assert!(config.gravity.distance(Vec3::new(0.0, -9.81, 0.0)) < 1e-5);
    }
}
