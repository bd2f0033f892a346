//! The options of a new member, out of JSON.

use rhumb_protocol::message::{SessionKey, Token};
use rhumb_protocol::scene::SceneName;

use crate::argument::Argument;
use crate::failure::Failure;
use crate::join_argument::{JoinArguments, session_key};

/// The options of a new member.
#[derive(Debug)]
pub(crate) struct MemberOptions {
    pub(crate) scene: SceneName,
    pub(crate) token: Option<Token>,
    /// The key of a session that may resume.
    pub(crate) key: Option<SessionKey>,
    pub(crate) join: JoinArguments,
}

impl MemberOptions {
    pub(crate) fn read(from: &Argument<'_>) -> Result<Self, Failure> {
        let scene = from.field("scene")?;
        let token = from.optional("token").map(|from| {
            let token = from.text()?.parse();
            token.map_err(|why| from.refused(why))
        });
        let key = from.optional("key").map(|from| session_key(&from));
        Ok(Self {
            scene: scene.text()?.parse().map_err(|why| scene.refused(why))?,
            token: token.transpose()?,
            key: key.transpose()?,
            join: JoinArguments::read(&from.field("join")?)?,
        })
    }
}
