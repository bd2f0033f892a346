//! A refused request, as plain fields.

use std::fmt;

use rhumb_client::{BodyId, RefusedRequest};

use crate::body_word::body_word;

/// A request that the server refused, and that changed nothing.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RefusalRecord {
    /// The command's number; `None` for a request for authority.
    pub number: Option<u64>,
    /// The body that the request is about, if that is known.
    pub body: Option<BodyId>,
    /// The reason in one or a few words, for programs.
    pub reason: &'static str,
    /// The reason, a plain sentence.
    pub text: String,
}

impl RefusalRecord {
    /// The record of a client's refusal.
    #[must_use]
    pub fn new(refusal: &RefusedRequest) -> Self {
        let (body, reason) = (refusal.body, refusal.reason);
        Self {
            number: refusal.number,
            body,
            reason: reason.word(),
            text: with_word(reason.to_string(), body),
        }
    }
}

impl fmt::Display for RefusalRecord {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the server refused ")?;
        match self.number {
            Some(number) => write!(f, "command {number}")?,
            None => f.write_str("the authority")?,
        }
        if let Some(body) = self.body {
            write!(f, " about body {}", body_word(body))?;
        }
        write!(f, ": {}", self.text)
    }
}

/// A sentence that names a body by its word, as the application knows it.
pub(crate) fn with_word(sentence: String, body: Option<BodyId>) -> String {
    match body {
        Some(id) => sentence.replace(&id.to_string(), &format!("body {}", body_word(id))),
        None => sentence,
    }
}

#[cfg(test)]
mod tests {
    use rhumb_client::RefusalReason;
    use rhumb_client::scene::CommandError;

    use super::*;

    #[test]
    fn a_sentence_names_the_body_by_its_word() {
        let id = BodyId::new(4, 0);
        let refusal = RefusedRequest {
            number: Some(7),
            body: Some(id),
            reason: RefusalReason::Command(CommandError::UnknownBody(id)),
        };
        let record = RefusalRecord::new(&refusal);
        assert_eq!(record.reason, "unknown body");
        let text = "the server refused command 7 about body 5: the scene has no body 5";
        assert_eq!(record.to_string(), text);
    }
}
