//! Errors for JavaScript: a code for programs, a sentence for people.

use std::fmt;

use rhumb_protocol::message::Denial;
use rhumb_protocol::session::Misuse;
use rhumb_view::AddError;
use serde_json::Value;

use crate::object::object;

/// An error, as JavaScript sees it.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Failure {
    code: &'static str,
    message: String,
    denial: Option<&'static str>,
}

impl Failure {
    /// An argument that is not what the call takes. `place` names it, as in `body.shape.radius`.
    pub(crate) fn argument(place: &str, wanted: impl fmt::Display) -> Self {
        Self::of("argument", format!("{place}: {wanted}"))
    }

    pub(crate) fn of(code: &'static str, message: impl Into<String>) -> Self {
        Self {
            code,
            message: message.into(),
            denial: None,
        }
    }

    pub(crate) fn denied(denial: Denial) -> Self {
        Self {
            denial: Some(denial_code(denial)),
            ..Self::of("denied", denial.to_string())
        }
    }

    pub(crate) fn to_json(&self) -> Value {
        object!({
            "code": self.code, "message": self.message.as_str(), "denial": self.denial
        })
    }
}

impl From<Misuse> for Failure {
    fn from(misuse: Misuse) -> Self {
        let code = match misuse {
            Misuse::NotNow | Misuse::AuthorityUnanswered => "notNow",
            Misuse::Indices(_) => "noIds",
            Misuse::Invalid(_)
            | Misuse::TooManyAuthorityBodies(_)
            | Misuse::NoAuthority(_)
            | Misuse::State(..)
            | Misuse::NoInside
            | Misuse::JoinedToItself(_)
            | Misuse::Hits(_)
            | Misuse::QueryCost(_) => "argument",
        };
        Self::of(code, misuse.to_string())
    }
}

impl From<AddError> for Failure {
    fn from(error: AddError) -> Self {
        match error {
            AddError::Misuse(misuse) => misuse.into(),
            AddError::TooManyShapes => Self::of("tooManyShapes", error.to_string()),
        }
    }
}

/// The name of a denial, for programs.
pub(crate) const fn denial_code(denial: Denial) -> &'static str {
    match denial {
        Denial::NoSuchScene => "noSuchScene",
        Denial::SceneExists => "sceneExists",
        Denial::InvalidConfig(_) => "invalidConfig",
        Denial::TooManyScenes => "tooManyScenes",
        Denial::TooManyMembers => "tooManyMembers",
        Denial::TooManyStreams => "tooManyStreams",
        Denial::NoIndicesLeft => "noIndicesLeft",
        Denial::NotLockstep => "notLockstep",
        Denial::TooFarAhead => "tooFarAhead",
        Denial::SceneFaulted => "sceneFaulted",
        Denial::Owned => "owned",
        Denial::NotAllowed => "notAllowed",
        Denial::AdvanceNotAllowed => "advanceNotAllowed",
        Denial::OverQuota => "overQuota",
        Denial::Overloaded { .. } => "overloaded",
        Denial::Other(_) => "other",
    }
}
