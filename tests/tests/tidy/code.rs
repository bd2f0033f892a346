//! Removes comments and strings from Rust sources, and finds their functions.
//!
//! It knows only as much of the language as that needs. Line numbers stay the same.

/// The text with comments, strings and characters replaced by blanks.
pub(crate) fn without_text(text: &str) -> String {
    let bytes = text.as_bytes();
    let mut out = bytes.to_vec();
    let mut place = 0;
    while place < bytes.len() {
        let end = match text_end(bytes, place) {
            Some(end) => end,
            None => {
                place += 1;
                continue;
            }
        };
        for byte in &mut out[place..end] {
            if *byte != b'\n' {
                *byte = b' ';
            }
        }
        place = end;
    }
    String::from_utf8_lossy(&out).into_owned()
}

/// End of the comment, string or character literal that begins here.
fn text_end(bytes: &[u8], place: usize) -> Option<usize> {
    let rest = &bytes[place..];
    let starts_name = place == 0 || !is_name(bytes[place - 1]);
    match rest {
        [b'/', b'/', ..] => Some(place + until(rest, b"\n")),
        [b'/', b'*', ..] => Some(place + comment_len(rest)),
        [b'r', b'"' | b'#', ..] | [b'b', b'r', ..] if starts_name => {
            raw_len(rest).map(|len| place + len)
        }
        [b'"', ..] => Some(place + 1 + quoted_len(&rest[1..], b'"')),
        // A lifetime has no second quote after one character.
        [b'\'', b'\\', ..] => Some(place + 1 + quoted_len(&rest[1..], b'\'')),
        [b'\'', first, ..] => {
            let width = 1 + first.leading_ones().saturating_sub(1) as usize;
            (rest.get(1 + width) == Some(&b'\'')).then_some(place + width + 2)
        }
        _ => None,
    }
}

const fn is_name(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || byte == b'_'
}

fn until(rest: &[u8], end: &[u8]) -> usize {
    let found = rest.windows(end.len()).position(|window| window == end);
    found.unwrap_or(rest.len())
}

fn comment_len(rest: &[u8]) -> usize {
    let (mut depth, mut place) = (0_usize, 0);
    while place < rest.len() {
        match &rest[place..] {
            [b'/', b'*', ..] => (depth, place) = (depth + 1, place + 2),
            [b'*', b'/', ..] => (depth, place) = (depth - 1, place + 2),
            _ => place += 1,
        }
        if depth == 0 {
            break;
        }
    }
    place
}

/// Length up to and including the quote that no backslash precedes.
fn quoted_len(rest: &[u8], quote: u8) -> usize {
    let mut place = 0;
    while place < rest.len() {
        match rest[place] {
            b'\\' => place += 2,
            byte if byte == quote => return place + 1,
            _ => place += 1,
        }
    }
    rest.len()
}

fn raw_len(rest: &[u8]) -> Option<usize> {
    let start = rest
        .iter()
        .take_while(|byte| matches!(byte, b'b' | b'r'))
        .count();
    let hashes = rest[start..]
        .iter()
        .take_while(|byte| **byte == b'#')
        .count();
    let open = start + hashes;
    (rest.get(open) == Some(&b'"')).then(|| {
        let mut end = vec![b'"'];
        end.resize(1 + hashes, b'#');
        open + 1 + until(&rest[open + 1..], &end) + end.len()
    })
}

/// Name, first line (counted from one) and length in lines of a function.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Function {
    pub(crate) name: String,
    pub(crate) line: usize,
    pub(crate) lines: usize,
}

/// Every function with a body.
pub(crate) fn functions(code: &str) -> Vec<Function> {
    let bytes = code.as_bytes();
    let starts = code.match_indices("fn ").map(|(start, _)| start);
    let starts = starts.filter(|start| *start == 0 || !is_name(bytes[start - 1]));
    starts.filter_map(|start| function(code, start)).collect()
}

fn function(code: &str, start: usize) -> Option<Function> {
    let rest = code[start + 3..].trim_start();
    let name: String = rest
        .chars()
        .take_while(|c| c.is_alphanumeric() || *c == '_')
        .collect();
    let body = body(&code.as_bytes()[start..])?;
    (!name.is_empty()).then(|| Function {
        name,
        line: 1 + code[..start].matches('\n').count(),
        lines: 1 + code[start..start + body].matches('\n').count(),
    })
}

/// End of the body after a signature; `None` when there is none.
fn body(rest: &[u8]) -> Option<usize> {
    let (mut braces, mut brackets) = (0_usize, 0_usize);
    for (place, byte) in rest.iter().enumerate() {
        match byte {
            b'(' | b'[' => brackets += 1,
            b')' | b']' => brackets = brackets.checked_sub(1)?,
            b';' if braces == 0 && brackets == 0 => return None,
            b'{' => braces += 1,
            b'}' => {
                braces = braces.checked_sub(1)?;
                if braces == 0 {
                    return Some(place);
                }
            }
            _ => {}
        }
    }
    None
}

/// The code before the unit tests.
pub(crate) fn without_tests(code: &str) -> &str {
    let mut marks = code.match_indices("#[cfg(test)]\n");
    let tests = marks.find(|(start, mark)| {
        let next = code[start + mark.len()..].lines().next();
        next.is_some_and(|line| line.contains("mod tests {"))
    });
    &code[..tests.map_or(code.len(), |(start, _)| start)]
}

#[test]
fn comments_and_strings_are_blanked_and_code_is_not() {
    let text =
        "a /* b /* c */ d */ e // f\n\"g\\\"h\" r#\"i\"j\"# 'k' '\\'' l: &'m str; for_r\"n\"";
    let kept: String = without_text(text).split_whitespace().collect();
    assert_eq!(kept, "ael:&'mstr;for_r");
}

#[test]
fn functions_are_found_with_their_lengths() {
    let code = "trait T { fn a(); }\nfn b(x: [u8; 2]) -> T\nwhere\n    T: X,\n{\n    if x {}\n}\nfn c() {}\n";
    let functions = functions(code);
    let found: Vec<_> = functions
        .iter()
        .map(|f| (f.name.as_str(), f.line, f.lines))
        .collect();
    assert_eq!(found, [("b", 2, 6), ("c", 8, 1)]);
}
