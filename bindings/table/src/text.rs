//! Names, numbers and comments of all languages, and the files that are made.

/// Columns of a comment.
const WIDTH: usize = 120;

/// Words with `_` between them.
#[must_use]
pub fn snake(words: &str) -> String {
    words.replace([' ', '-'], "_")
}

/// Words of a name in capitals, such as `SetPose`, with `_` between them.
#[must_use]
pub fn snake_of_pascal(name: &str) -> String {
    let mut snake = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !snake.is_empty() {
            snake.push('_');
        }
        snake.extend(letter.to_lowercase());
    }
    snake
}

/// Words that each begin with a capital.
#[must_use]
pub fn pascal(words: &str) -> String {
    words.split([' ', '_', '-']).map(capital).collect()
}

/// Words that each but the first begin with a capital.
#[must_use]
pub fn camel(words: &str) -> String {
    let name = pascal(words);
    name[..1].to_lowercase() + &name[1..]
}

/// A text with a capital.
#[must_use]
pub fn capital(text: &str) -> String {
    let mut letters = text.chars();
    let first = letters
        .next()
        .map(|letter| letter.to_uppercase().to_string());
    first.unwrap_or_default() + letters.as_str()
}

/// The beginning of a text.
#[must_use]
pub fn bare(text: &str) -> &str {
    text.get(..80).unwrap_or(text)
}

/// A template with the values of its names, which stand in it as `@name@`.
#[must_use]
pub fn fill(template: &str, values: &[(&str, &str)]) -> String {
    let mut filled = template.to_owned();
    for (name, value) in values {
        filled = filled.replace(&format!("@{name}@"), value);
    }
    filled
}

/// Lines of at most so many columns.
#[must_use]
pub fn wrapped(text: &str, columns: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split(' ') {
        let line = lines.last_mut().expect("a line");
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > columns {
            lines.push(word.to_owned());
        } else {
            let gap = if line.is_empty() { "" } else { " " };
            line.extend([gap, word]);
        }
    }
    lines
}

/// Lines of a comment, each after `start`, wrapped.
#[must_use]
pub fn comment(start: &str, text: &str) -> String {
    let columns = WIDTH - start.chars().count() - 1;
    let lines = text
        .split('\n')
        .flat_map(|paragraph| wrapped(paragraph, columns));
    lines
        .map(|line| format!("{start} {line}").trim_end().to_owned() + "\n")
        .collect()
}

/// A number as a sentence has it.
#[must_use]
pub fn number(value: f64) -> String {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    for (known, written) in [(PI, "π"), (FRAC_PI_2, "π/2"), (FRAC_PI_4, "π/4")] {
        if (value.abs() - known).abs() < 1e-6 {
            let sign = if value < 0.0 { "-" } else { "" };
            return format!("{sign}{written}");
        }
    }
    let written = value.to_string();
    let (whole, rest) = written.split_at(written.find('.').unwrap_or(written.len()));
    let mut grouped = String::new();
    for (place, digit) in whole.chars().enumerate() {
        let left = whole.len() - place;
        if place > 0 && left.is_multiple_of(3) && !grouped.ends_with('-') {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    grouped + rest
}

/// A file, or what stands in one between two lines that name it.
#[derive(Debug)]
pub struct MadePart {
    /// The name between `>>> ` and `, made by bindings/table`; none of a whole file.
    pub name: Option<&'static str>,
    /// The text.
    pub text: String,
}

impl MadePart {
    /// The text between the two lines of this name.
    #[must_use]
    pub const fn named(name: &'static str, text: String) -> Self {
        Self {
            name: Some(name),
            text,
        }
    }

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
