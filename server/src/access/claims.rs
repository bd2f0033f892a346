//! The claims of a token, as its JSON says them.

use std::sync::Arc;

use rhumb_protocol::message::Role;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use serde::{Deserialize, Serialize};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use super::permit::{Permit, Quotas};

/// The audience of tokens unless the operator names another one.
pub(crate) const DEFAULT_AUDIENCE: &str = "rhumb";
/// Seconds that the clocks of the signer and of the server may differ.
const SKEW_SECONDS: i64 = 30;

/// The claims of a token about its client. `aud`, `sub`, `exp` and `nbf` are PASETO's registered claims.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Claims {
    /// The servers that it is for.
    pub(crate) aud: String,
    /// The client.
    pub(crate) sub: String,
    /// When it expires, in the text form of RFC 3339.
    pub(crate) exp: String,
    /// When it begins to be valid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) nbf: Option<String>,
    /// Names of scenes; one that ends in `*` stands for all names that begin so.
    pub(crate) scenes: Vec<String>,
    pub(crate) role: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) bodies: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) commands: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) load: Option<u64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(crate) members: Option<u32>,
}

impl Claims {
    /// The permit for a scene, and the seconds for which it is valid from `now` on, in seconds since 1970.
    pub(crate) fn permit(
        &self,
        audience: &str,
        scene: &SceneName,
        now: i64,
    ) -> Result<(Permit, u64), CloseCode> {
        let role = role_of(&self.role).ok_or(CloseCode::TOKEN_INVALID)?;
        if self.aud != audience || self.sub.is_empty() {
            return Err(CloseCode::TOKEN_INVALID);
        }
        let begins = self.nbf.as_deref().map(seconds).transpose()?;
        if begins.is_some_and(|begins| now < begins - SKEW_SECONDS) {
            return Err(CloseCode::TOKEN_INVALID);
        }
        let left = seconds(&self.exp)?
            .saturating_add(SKEW_SECONDS)
            .saturating_sub(now);
        let left = u64::try_from(left).map_err(|_| CloseCode::TOKEN_EXPIRED)?;
        if left == 0 {
            return Err(CloseCode::TOKEN_EXPIRED);
        }
        if !self.scenes.iter().any(|pattern| names(pattern, scene)) {
            return Err(CloseCode::TOKEN_SCENE);
        }
        let permit = Permit {
            client: Some(Arc::from(self.sub.as_str())),
            role,
            quotas: Quotas {
                bodies: self.bodies,
                commands: self.commands,
                load: self.load,
                members: self.members,
            },
        };
        Ok((permit, left))
    }

    /// The text form of a moment in seconds since 1970; `None` for one that has none.
    pub(crate) fn moment(seconds: i64) -> Option<String> {
        let moment = OffsetDateTime::from_unix_timestamp(seconds).ok()?;
        moment.format(&Rfc3339).ok()
    }

    /// True if a text can be one of `scenes`.
    pub(crate) fn is_pattern(text: &str) -> bool {
        match text.strip_suffix('*') {
            Some("") => true,
            Some(prefix) => prefix.parse::<SceneName>().is_ok(),
            None => text.parse::<SceneName>().is_ok(),
        }
    }
}

/// The role of a name.
pub(crate) fn role_of(name: &str) -> Option<Role> {
    match name {
        "observer" => Some(Role::Observer),
        "controller" => Some(Role::Controller),
        "owner" => Some(Role::Owner),
        _ => None,
    }
}

fn seconds(moment: &str) -> Result<i64, CloseCode> {
    OffsetDateTime::parse(moment, &Rfc3339)
        .map(OffsetDateTime::unix_timestamp)
        .map_err(|_| CloseCode::TOKEN_INVALID)
}

fn names(pattern: &str, scene: &SceneName) -> bool {
    match pattern.strip_suffix('*') {
        Some(prefix) => scene.as_str().starts_with(prefix),
        None => scene.as_str() == pattern,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 2026-01-01, 00:00 UTC.
    const NOW: i64 = 1_767_225_600;

    fn claims() -> Claims {
        Claims {
            aud: "rhumb".into(),
            sub: "anna".into(),
            exp: Claims::moment(NOW + 60).unwrap(),
            nbf: None,
            scenes: vec!["pit".into(), "team/*".into()],
            role: "controller".into(),
            bodies: Some(5),
            commands: None,
            load: None,
            members: None,
        }
    }

    fn verdict(claims: &Claims, scene: &str, now: i64) -> Result<(Permit, u64), CloseCode> {
        claims.permit("rhumb", &scene.parse().unwrap(), now)
    }

    #[test]
    fn a_token_names_scenes_exactly_or_by_their_beginning() {
        for scene in ["pit", "team/a", "team/"] {
            let (permit, left) = verdict(&claims(), scene, NOW).unwrap();
            assert_eq!((permit.role, left), (Role::Controller, 90), "{scene}");
            assert_eq!(permit.quotas.bodies, Some(5));
            assert_eq!(permit.client.as_deref(), Some("anna"));
        }
        for scene in ["pits", "pi", "team", "other"] {
            assert_eq!(
                verdict(&claims(), scene, NOW),
                Err(CloseCode::TOKEN_SCENE),
                "{scene}"
            );
        }
    }

    #[test]
    fn a_token_is_valid_until_30_seconds_after_its_end() {
        assert_eq!(verdict(&claims(), "pit", NOW + 89).unwrap().1, 1);
        for late in [90, 1_000_000] {
            let expired = verdict(&claims(), "pit", NOW + late);
            assert_eq!(expired, Err(CloseCode::TOKEN_EXPIRED));
        }
        let later = Claims {
            nbf: Claims::moment(NOW + 31),
            ..claims()
        };
        assert_eq!(verdict(&later, "pit", NOW), Err(CloseCode::TOKEN_INVALID));
        assert!(verdict(&later, "pit", NOW + 1).is_ok());
    }

    #[test]
    fn a_token_of_another_audience_role_or_time_is_invalid() {
        for wrong in [
            Claims {
                aud: "other".into(),
                ..claims()
            },
            Claims {
                sub: String::new(),
                ..claims()
            },
            Claims {
                role: "king".into(),
                ..claims()
            },
            Claims {
                exp: "tomorrow".into(),
                ..claims()
            },
        ] {
            assert_eq!(verdict(&wrong, "pit", NOW), Err(CloseCode::TOKEN_INVALID));
        }
    }

    #[test]
    fn patterns_are_names_with_an_optional_star_at_the_end() {
        for good in ["*", "pit", "team/*"] {
            assert!(Claims::is_pattern(good), "{good}");
        }
        for bad in ["", "a b", "*a", "a**"] {
            assert!(!Claims::is_pattern(bad), "{bad}");
        }
    }
}
