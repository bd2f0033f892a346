//! The text of a JSON scene: read, or refused in words of the format.
//!
//! A text that is refused is searched for the first field of a body, a joint or the scene that cannot be read alone.

use serde::de::DeserializeOwned;
use serde_json::{Error, Value, json};

use crate::json::{SceneFile, SceneFileBody, title};
use crate::json_joints::SceneFileJoint;
use crate::report::{LoadError, Place, Problem};

/// Reads a text.
pub(crate) fn read(path: &str, text: &str) -> Result<SceneFile, LoadError> {
    let text = text.trim_start_matches('\u{feff}');
    serde_json::from_str(text).map_err(|error| LoadError {
        place: Place {
            file: path.to_owned(),
            line: u32::try_from(error.line()).ok(),
        },
        problem: problem(text, &error),
    })
}

/// The problem of a text that is no scene. `error`: that of reading it whole.
fn problem(text: &str, error: &Error) -> Problem {
    let Ok(whole) = serde_json::from_str::<Value>(text) else {
        return Problem::Syntax(error.to_string());
    };
    let frame = json!({"position": [0, 0, 0]});
    let body = json!({"dynamic": false, "shape": {"ball": {"radius": 1}}, "position": [0, 0, 0]});
    let joint = json!({"bodies": [0, 1], "kind": "fixed", "frames": [frame, frame]});
    let found = of_list::<SceneFileBody>(&whole, ["bodies", "body"], &body)
        .or_else(|| of_list::<SceneFileJoint>(&whole, ["joints", "joint"], &joint))
        .or_else(|| of_fields::<SceneFile>(&whole, &json!({}), "the scene"));
    let (name, cause) = found.unwrap_or_else(|| ("the scene".to_owned(), error.to_string()));
    let cause = plain(&cause);
    Problem::WrongField { name, cause }
}

/// The first wrong field of the things in a list, and its cause. `right`: such a thing with all that it needs.
fn of_list<T: DeserializeOwned>(
    whole: &Value,
    [list, what]: [&str; 2],
    right: &Value,
) -> Option<(String, String)> {
    let all = whole.get(list)?.as_array()?;
    all.iter().enumerate().find_map(|(number, one)| {
        let error = serde_json::from_value::<T>(one.clone()).err()?;
        let name = one.get("name").and_then(Value::as_str);
        let name = title(what, number, name.unwrap_or_default());
        of_fields::<T>(one, right, &name).or_else(|| Some((name, error.to_string())))
    })
}

/// The first field that is wrong, whatever the others are.
fn of_fields<T: DeserializeOwned>(
    one: &Value,
    right: &Value,
    name: &str,
) -> Option<(String, String)> {
    one.as_object()?.iter().find_map(|(field, value)| {
        let mut with = right.as_object()?.clone();
        with.insert(field.clone(), value.clone());
        let error = serde_json::from_value::<T>(Value::Object(with)).err()?;
        Some((format!("{field} of {name}"), error.to_string()))
    })
}

/// A sentence of the parser without the names of types.
fn plain(cause: &str) -> String {
    let word = |word: &str| {
        let bare = word.trim_end_matches([',', '.']);
        let end = &word[bare.len()..];
        let said = match bare {
            "u8" => "a whole number from 0 to 255",
            "u32" | "u64" | "usize" => "a whole number from zero",
            "i8" => "a whole number from -128 to 127",
            "f32" | "f64" => "a number",
            "sequence" => "list",
            "map" => "object",
            "variant" => "word",
            "struct" | "enum" => return None,
            name if name.starts_with("SceneFile") => "an object",
            other => other,
        };
        Some(format!("{said}{end}"))
    };
    let words: Vec<_> = cause.split(' ').filter_map(word).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use crate::files::MemoryFiles;
    use crate::load::load_text;
    use crate::model::LoadOptions;

    fn refused(text: &str) -> String {
        let options = LoadOptions::default();
        let read = load_text(&MemoryFiles::default(), "s.json", text, &options);
        read.expect_err(text).to_string()
    }

    #[test]
    fn a_wrong_field_is_named_with_its_body_in_words_of_the_format() {
        let body = |more: &str| {
            let ball =
                r#"{"dynamic": true, "shape": {"ball": {"radius": 1}}, "position": [0, 0, 0]}"#;
            let own = r#"{"name": "b", "dynamic": true, "position": [0, 0, 0]"#;
            format!(r#"{{"bodies": [{ball}, {own}{more}}}]}}"#)
        };
        let ball = r#", "shape": {"ball": {"radius": 1}}"#;
        for (text, words) in [
            (body(""), "s.json:1: body 1 \"b\": missing field `shape`"),
            (
                body(
                    r#", "shape": {"ball": {"radius": 1}, "cuboid": {"half_extents": [1, 1, 1]}}"#,
                ),
                "s.json:1: shape of body 1 \"b\": ",
            ),
            (
                body(r#", "shape": {"bal": {"radius": 1}}"#),
                "shape of body 1 \"b\": unknown word `bal`, expected one of `ball`",
            ),
            (
                body(&format!(r#"{ball}, "tick": 1.5"#)),
                "tick of body 1 \"b\": invalid type: floating point `1.5`, expected a whole number from zero",
            ),
            (
                body(&format!(r#"{ball}, "linear": [1, 2]"#)),
                "linear of body 1 \"b\": invalid length 2, expected an array of length 3",
            ),
            (r#"{"bodies": [[]]}"#.to_owned(), "body 0: invalid "),
            (
                r#"{"bodies": {}}"#.to_owned(),
                "bodies of the scene: invalid type: object, expected a list",
            ),
            (
                r#"{"substeps": "4"}"#.to_owned(),
                "substeps of the scene: invalid type: string \"4\", expected a whole number from zero",
            ),
            (
                r#"{"joints": [{"name": "j", "bodies": [0, -1], "kind": "fixed", "frames": []}]}"#
                    .to_owned(),
                "bodies of joint 0 \"j\": invalid value: integer `-1`, expected a whole number from zero",
            ),
            (r#"{"bodies": [}"#.to_owned(), "not well formed"),
        ] {
            let sentence = refused(&text);
            assert!(sentence.contains(words), "{sentence}\n{words}");
            let types = ["u32", "usize", "struct", "SceneFile", "sequence"];
            assert!(
                types.iter().all(|name| !sentence.contains(name)),
                "{sentence}"
            );
        }
    }
}
