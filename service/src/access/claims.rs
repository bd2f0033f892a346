//! The claims of a token, as its JSON says them.

use std::fmt;
use std::sync::Arc;

use rhumb_protocol::message::Role;
use rhumb_protocol::scene::SceneName;
use rhumb_protocol::session::CloseCode;
use rhumb_scene::{Permit, Quotas};
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// The audience of tokens unless the operator names another one.
pub(crate) const DEFAULT_AUDIENCE: &str = "rhumb";
/// Seconds that the clocks of the signer and of the server may differ.
const SKEW_SECONDS: i64 = 30;

/// The claims of a token about its client. `aud`, `sub`, `exp` and `nbf` are PASETO's registered claims.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Claims {
    /// The servers that it is for.
    pub(crate) aud: String,
    /// The client.
    pub(crate) sub: String,
    /// When it expires, in the text form of RFC 3339.
    pub(crate) exp: String,
    /// When it begins to be valid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) nbf: Option<String>,
    /// Names of scenes; one that ends in `*` stands for all names that begin so.
    pub(crate) scenes: Vec<String>,
    pub(crate) role: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) bodies: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) commands: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) load: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) members: Option<u32>,
    /// Scenes of the client's tenant at one time.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) tenant_scenes: Option<u32>,
}

/// Reason why a client is not admitted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum TokenError {
    /// It shows no token.
    Absent,
    /// The token is none, or no key of this server has signed it.
    NotSigned,
    /// The claims are no JSON object.
    NotAnObject,
    /// A claim is missing.
    Missing(&'static str),
    /// A claim's value is not of its kind.
    Malformed {
        /// The claim.
        claim: &'static str,
        /// The rule for its value.
        expected: &'static str,
        /// Its value, as JSON.
        found: String,
    },
    /// The claim `aud` names other servers.
    Audience {
        /// The servers.
        found: String,
        /// The audience of this server.
        expected: String,
    },
    /// The claim `nbf` lies ahead.
    NotYet(String),
    /// The claim `exp` lies behind.
    Expired(String),
    /// The claim `scenes` does not name the scene.
    OtherScene(SceneName),
    /// The key that signed the token may not sign for the scene.
    OtherKey {
        /// The scene.
        scene: SceneName,
        /// Names of the scenes for which it signs.
        of_key: String,
    },
}

impl TokenError {
    /// The code with which the connection is closed.
    pub(crate) const fn code(&self) -> CloseCode {
        match self {
            Self::Absent => CloseCode::TOKEN_MISSING,
            Self::Expired(_) => CloseCode::TOKEN_EXPIRED,
            Self::OtherScene(_) | Self::OtherKey { .. } => CloseCode::TOKEN_SCENE,
            _ => CloseCode::TOKEN_INVALID,
        }
    }
}

impl fmt::Display for TokenError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Absent => f.write_str("the client shows no token"),
            Self::NotSigned => f.write_str("this is no token that the key has signed"),
            Self::NotAnObject => f.write_str("the claims of the token are no JSON object"),
            Self::Missing(claim) => write!(f, "the token has no claim {claim}"),
            Self::Malformed {
                claim,
                expected,
                found,
            } => write!(
                f,
                "the token's claim {claim} is {found}, and must be {expected}"
            ),
            Self::Audience { found, expected } => write!(
                f,
                "the token's claim aud is {found:?}, and the audience of this server is {expected:?}"
            ),
            Self::NotYet(nbf) => write!(f, "the token is not valid before its claim nbf, {nbf}"),
            Self::Expired(exp) => write!(f, "the token has expired: its claim exp is {exp}"),
            Self::OtherScene(scene) => {
                write!(
                    f,
                    "the token's claim scenes does not name the scene {scene}"
                )
            }
            Self::OtherKey { scene, of_key } => write!(
                f,
                "the key that signed the token signs for the scenes {of_key} alone, as --token-key says, and not for {scene}"
            ),
        }
    }
}

impl std::error::Error for TokenError {}

/// Longest value that an error shows, characters.
const SHOWN_MAX: usize = 60;

fn malformed(claim: &'static str, expected: &'static str, found: &Value) -> TokenError {
    let mut found: String = found.to_string();
    if let Some((end, _)) = found.char_indices().nth(SHOWN_MAX) {
        found.truncate(end);
        found.push('…');
    }
    TokenError::Malformed {
        claim,
        expected,
        found,
    }
}

/// A claim of a kind; `None` where it is not there, or null.
fn optional<T: DeserializeOwned>(
    claims: &Map<String, Value>,
    claim: &'static str,
    expected: &'static str,
) -> Result<Option<T>, TokenError> {
    match claims.get(claim) {
        None | Some(Value::Null) => Ok(None),
        Some(found) => {
            let value = T::deserialize(found);
            value
                .map(Some)
                .map_err(|_| malformed(claim, expected, found))
        }
    }
}

fn required<T: DeserializeOwned>(
    claims: &Map<String, Value>,
    claim: &'static str,
    expected: &'static str,
) -> Result<T, TokenError> {
    optional(claims, claim, expected)?.ok_or(TokenError::Missing(claim))
}

/// The rule for moments.
const MOMENT: &str = "a moment as RFC 3339 writes it, such as \"2026-12-31T00:00:00Z\"";
/// The rule for quotas.
const COUNT: &str = "a whole number from 0";

impl Claims {
    /// Reads the claims of a token. Claims of other names are left to others.
    pub(crate) fn parse(payload: &str) -> Result<Self, TokenError> {
        let value = serde_json::from_str(payload);
        let Ok(Value::Object(of)) = value else {
            return Err(TokenError::NotAnObject);
        };
        let claims = Self {
            aud: required(&of, "aud", "a text")?,
            sub: required(&of, "sub", "a text")?,
            exp: required(&of, "exp", MOMENT)?,
            nbf: optional(&of, "nbf", MOMENT)?,
            scenes: required(&of, "scenes", "a list of texts")?,
            role: required(&of, "role", "\"observer\", \"controller\" or \"owner\"")?,
            bodies: optional(&of, "bodies", COUNT)?,
            commands: optional(&of, "commands", COUNT)?,
            load: optional(&of, "load", COUNT)?,
            members: optional(&of, "members", COUNT)?,
            tenant_scenes: optional(&of, "tenant_scenes", COUNT)?,
        };
        claims.check()?;
        Ok(claims)
    }

    /// Every claim has a meaning.
    fn check(&self) -> Result<(), TokenError> {
        let wrong = |claim, expected, text: &str| Err(malformed(claim, expected, &text.into()));
        if self.sub.is_empty() || self.sub.contains(char::is_control) {
            return wrong(
                "sub",
                "the name of a client, without control characters",
                &self.sub,
            );
        }
        if role_of(&self.role).is_none() {
            let roles = "\"observer\", \"controller\" or \"owner\"";
            return wrong("role", roles, &self.role);
        }
        if seconds(&self.exp).is_none() {
            return wrong("exp", MOMENT, &self.exp);
        }
        if let Some(nbf) = self.nbf.as_deref().filter(|nbf| seconds(nbf).is_none()) {
            return wrong("nbf", MOMENT, nbf);
        }
        match self.scenes.iter().find(|scene| !Self::is_pattern(scene)) {
            Some(scene) => wrong("scenes", "names of scenes, which may end in *", scene),
            None => Ok(()),
        }
    }

    /// The seconds for which the token is valid from `now` on, in seconds since 1970.
    pub(crate) fn seconds_left(&self, audience: &str, now: i64) -> Result<u64, TokenError> {
        self.check()?;
        if self.aud != audience {
            return Err(TokenError::Audience {
                found: self.aud.clone(),
                expected: audience.to_owned(),
            });
        }
        if let Some(nbf) = &self.nbf
            && seconds(nbf).is_some_and(|begins| now < begins - SKEW_SECONDS)
        {
            return Err(TokenError::NotYet(nbf.clone()));
        }
        let left = self.seconds_to_end(now);
        left.ok_or_else(|| TokenError::Expired(self.exp.clone()))
    }

    /// The seconds until it ends, other clocks allowed for; `None` if it has ended.
    pub(crate) fn seconds_to_end(&self, now: i64) -> Option<u64> {
        let ends = seconds(&self.exp).unwrap_or(i64::MIN);
        let left = ends.saturating_add(SKEW_SECONDS).saturating_sub(now);
        u64::try_from(left).ok().filter(|left| *left > 0)
    }

    /// The permit for a scene, and the seconds for which it is valid.
    pub(crate) fn permit(
        &self,
        audience: &str,
        scene: &SceneName,
        now: i64,
    ) -> Result<(Permit, u64), TokenError> {
        let left = self.seconds_left(audience, now)?;
        if !self.scenes.iter().any(|pattern| names(pattern, scene)) {
            return Err(TokenError::OtherScene(scene.clone()));
        }
        let role = role_of(&self.role).ok_or(TokenError::Missing("role"))?;
        let permit = Permit {
            client: Some(Arc::from(self.sub.as_str())),
            role,
            quotas: Quotas {
                bodies: self.bodies,
                commands: self.commands,
                load: self.load,
                members: self.members,
                scenes: self.tenant_scenes,
            },
            owns: false,
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

fn seconds(moment: &str) -> Option<i64> {
    let moment = OffsetDateTime::parse(moment, &Rfc3339);
    moment.map(OffsetDateTime::unix_timestamp).ok()
}

/// True if a pattern, a name or the beginning of names and a `*`, stands for the scene.
pub(super) fn names(pattern: &str, scene: &SceneName) -> bool {
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
            tenant_scenes: None,
        }
    }

    fn verdict(claims: &Claims, scene: &str, now: i64) -> Result<(Permit, u64), CloseCode> {
        let permit = claims.permit("rhumb", &scene.parse().unwrap(), now);
        permit.map_err(|error| error.code())
    }

    #[test]
    fn a_malformed_claim_is_refused_by_its_name() {
        let whole = serde_json::to_value(claims()).unwrap();
        assert_eq!(Claims::parse(&whole.to_string()), Ok(claims()));
        for (claim, wrong) in [
            ("aud", serde_json::json!(["rhumb"])),
            ("sub", serde_json::json!("")),
            ("sub", serde_json::json!(7)),
            ("exp", serde_json::json!(1_767_225_600)),
            ("exp", serde_json::json!("tomorrow")),
            ("nbf", serde_json::json!("now")),
            ("scenes", serde_json::json!("pit")),
            ("scenes", serde_json::json!(["pit", "a b"])),
            ("role", serde_json::json!("king")),
            ("bodies", serde_json::json!("5")),
            ("commands", serde_json::json!(-1)),
            ("load", serde_json::json!(1.5)),
            ("members", serde_json::json!(4_294_967_296_u64)),
            ("tenant_scenes", serde_json::json!([])),
        ] {
            let mut spoiled = whole.clone();
            spoiled[claim] = wrong;
            let error = Claims::parse(&spoiled.to_string()).unwrap_err();
            let said = error.to_string();
            assert!(said.contains(&format!("claim {claim} is ")), "{said}");
            assert_eq!(error.code(), CloseCode::TOKEN_INVALID);
        }
        for claim in ["aud", "sub", "exp", "scenes", "role"] {
            let mut short = whole.clone();
            short.as_object_mut().unwrap().remove(claim);
            let missing = Claims::parse(&short.to_string());
            assert_eq!(missing, Err(TokenError::Missing(claim)));
        }
        assert_eq!(Claims::parse("[]"), Err(TokenError::NotAnObject));
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
