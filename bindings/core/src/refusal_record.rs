//! A refused request, as plain fields.

use std::fmt;

use rhumb_client::{BodyId, RefusedRequest};

use crate::packed_id::packed_id;

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
            text: with_words(&reason.to_string()),
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
            write!(f, " about body {}", packed_id(body))?;
        }
        write!(f, ": {}", self.text)
    }
}

/// A sentence that names bodies by their words, as the application knows them, and not by index and generation.
pub(crate) fn with_words(sentence: &str) -> String {
    let mut parts = sentence.split("body ");
    let mut written = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        written.push_str("body ");
        let is_of_id = |c: char| c.is_ascii_digit() || c == '.';
        let (id, rest) = part.split_at(part.find(|c| !is_of_id(c)).unwrap_or(part.len()));
        let id = id.split_once('.').and_then(|(index, generation)| {
            Some(BodyId::new(index.parse().ok()?, generation.parse().ok()?))
        });
        match id {
            Some(id) => {
                written.push_str(&packed_id(id).to_string());
                written.push_str(rest);
            }
            None => written.push_str(part),
        }
    }
    written
}

#[cfg(test)]
mod tests {
    use rhumb_client::RefusalReason;
    use rhumb_client::scene::CommandError;

    use super::*;

    #[test]
    fn a_sentence_names_all_bodies_by_their_words() {
        let (one, other) = (BodyId::new(4, 0), BodyId::new(1, 2));
        let sentence = format!("a joint joins {one} to {other}; a body is 1.5 m long, body 3 not");
        let words = [one, other].map(packed_id);
        let expected = format!(
            "a joint joins body {} to body {}; a body is 1.5 m long, body 3 not",
            words[0], words[1]
        );
        assert_eq!(with_words(&sentence), expected);
        assert_eq!(with_words("the body is"), "the body is");
    }

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
