//! Any error, as the result of `main` for people.
//!
//! A `main` that returns an error prints its `Debug`, which is for programmers. That of this one is its sentence.

use std::error::Error;
use std::fmt;

/// Any error, for `main`: its `Debug` is its sentence, followed by those of its causes.
///
/// ```
/// fn main() -> Result<(), rhumb_client::MainError> {
///     let address = std::env::args().nth(1).unwrap_or_default();
/// #   let address = "1";
///     let count: u32 = address.parse()?;
///     (count > 0).then_some(()).ok_or("the number is missing")?;
///     Ok(())
/// }
/// ```
pub struct MainError(Box<dyn Error + Send + Sync>);

impl<E: Into<Box<dyn Error + Send + Sync>>> From<E> for MainError {
    fn from(error: E) -> Self {
        Self(error.into())
    }
}

impl fmt::Debug for MainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)?;
        let mut cause = self.0.source();
        while let Some(error) = cause {
            write!(f, "\n  because: {error}")?;
            cause = error.source();
        }
        Ok(())
    }
}

impl fmt::Display for MainError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ClientError;

    #[derive(Debug)]
    struct Outer(ClientError);

    impl fmt::Display for Outer {
        fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("the run ended")
        }
    }

    impl Error for Outer {
        fn source(&self) -> Option<&(dyn Error + 'static)> {
            Some(&self.0)
        }
    }

    #[test]
    fn what_main_prints_is_the_sentence_and_its_causes() {
        let error = MainError::from(ClientError::SceneDeleted);
        assert_eq!(format!("{error:?}"), "another member deleted the scene");
        let error = MainError::from(Outer(ClientError::SceneDeleted));
        let text = "the run ended\n  because: another member deleted the scene";
        assert_eq!(format!("{error:?}"), text);
        assert_eq!(format!("{:?}", MainError::from("no address")), "no address");
    }
}
