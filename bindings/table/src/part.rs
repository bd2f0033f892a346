//! A file that is made, or a part of one.

/// A file, or what stands in one between two lines that name it.
#[derive(Debug)]
pub struct MadePart {
    /// The name between `>>> ` and `, made by bindings/table`; none of a whole file.
    pub name: Option<&'static str>,
    /// The text.
    pub text: String,
}

impl MadePart {
    /// A whole file.
    #[must_use]
    pub fn whole(text: String) -> Vec<Self> {
        vec![Self { name: None, text }]
    }

    /// The text of a file with this part in it.
    ///
    /// # Panics
    ///
    /// When the file lacks the lines between which the part stands.
    #[must_use]
    pub fn placed(&self, file: &str) -> String {
        let Some(name) = self.name else {
            return self.text.clone();
        };
        let begin = file.find(&format!(">>> {name}, made by bindings/table"));
        let end = file.find(&format!("<<< {name}\n"));
        let (Some(begin), Some(end)) = (begin, end) else {
            panic!("the lines of {name} are missing");
        };
        let after = begin + file[begin..].find('\n').unwrap_or_default() + 1;
        let before = file[..end].rfind('\n').unwrap_or_default() + 1;
        [&file[..after], &self.text, &file[before..]].concat()
    }
}
