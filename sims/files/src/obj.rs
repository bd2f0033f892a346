//! OBJ files: all parts of a file as one mesh.
//!
//! `tobj` reads the text. What it does not read and the format allows is written plainly and tried again; what is wrong
//! is named with its line.

use std::io::Cursor;

use glam::DVec3;

use crate::report::Problem;

/// All parts of a file.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Surface {
    pub(crate) points: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// Reads a mesh.
pub(crate) fn read(bytes: &[u8]) -> Result<Surface, Problem> {
    parsed(bytes).or_else(|_| {
        let text = plain(&String::from_utf8_lossy(bytes));
        parsed(text.as_bytes()).map_err(|cause| Problem::Mesh(wrong_line(&text).unwrap_or(cause)))
    })
}

fn parsed(bytes: &[u8]) -> Result<Surface, String> {
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    // Materials are about drawing alone.
    let none = |_: &std::path::Path| Err(tobj::LoadError::OpenFileFailed);
    let read = tobj::load_obj_buf(&mut Cursor::new(bytes), &options, none);
    let (models, _) = read.map_err(|error| error.to_string())?;
    let mut all = Surface::default();
    for model in &models {
        let first = all.points.len() as u32;
        let (points, _) = model.mesh.positions.as_chunks::<3>();
        let points = points.iter();
        all.points
            .extend(points.map(|at| DVec3::from_array(at.map(f64::from))));
        let (corners, _) = model.mesh.indices.as_chunks::<3>();
        let corners = corners.iter();
        all.triangles
            .extend(corners.map(|at| at.map(|one| one.saturating_add(first))));
    }
    Ok(all)
}

/// A text with continued lines in one, and points without colours; lines keep their numbers.
fn plain(text: &str) -> String {
    let mut whole = String::with_capacity(text.len());
    let mut held = String::new();
    let mut continued = 0;
    for line in text.lines() {
        if let Some(part) = line.trim_end().strip_suffix('\\') {
            held.push_str(part);
            held.push(' ');
            continued += 1;
            continue;
        }
        held.push_str(line);
        let mut words = held.split_whitespace();
        if words.next() == Some("v") {
            whole.push('v');
            for word in words.take(3) {
                whole.push(' ');
                whole.push_str(word);
            }
        } else {
            whole.push_str(&held);
        }
        held.clear();
        whole.extend(std::iter::repeat_n('\n', continued + 1));
        continued = 0;
    }
    whole.push_str(&held);
    whole
}

/// The first line that is wrong, and why.
fn wrong_line(text: &str) -> Option<String> {
    let is_point = |line: &&str| line.split_whitespace().next() == Some("v");
    let count = text.lines().filter(is_point).count() as i64;
    let mut seen = 0;
    for (at, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        let kind = words.next();
        seen += i64::from(kind == Some("v"));
        let wrong = match kind {
            Some("v" | "vn") => {
                let numbers = words.by_ref().map(str::parse::<f32>);
                let numbers: Vec<_> = numbers.take(3).collect();
                let is_right = numbers.len() == 3 && numbers.iter().all(Result::is_ok);
                (!is_right).then(|| "three numbers are missing".to_owned())
            }
            Some("f") => words.find_map(|word| wrong_corner(word, seen, count)),
            _ => None,
        };
        if let Some(wrong) = wrong {
            let line: String = line.trim().chars().take(40).collect();
            return Some(format!("line {} \"{line}\": {wrong}", at + 1));
        }
    }
    None
}

fn wrong_corner(word: &str, seen: i64, count: i64) -> Option<String> {
    let number = word.split('/').next().unwrap_or_default();
    match number.parse::<i64>() {
        Ok(number) if (1..=count).contains(&number) || (-seen..0).contains(&number) => None,
        Ok(number) => Some(format!("there is no point {number}, and there are {count}")),
        Err(_) => Some(format!("\"{number}\" is no number of a point")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn continued_lines_and_colours_of_some_points_are_read() {
        for text in [
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 \\\n4\n",
            "v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3 4\n",
            "v 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nv 0 \\\n0 1\nf -4 -3 -2 -1\n",
        ] {
            let Surface { points, triangles } = read(text.as_bytes()).expect(text);
            assert_eq!((points.len(), triangles.len()), (4, 2), "{text}");
            assert_eq!(points[3], DVec3::Z);
        }
    }

    #[test]
    fn a_wrong_line_is_named() {
        for (text, words) in [
            (
                "v 0 0 0\n\nv 1 2\n",
                "line 3 \"v 1 2\": three numbers are missing",
            ),
            (
                "v 0 0 \\\nx\n",
                "line 1 \"v 0 0 x\": three numbers are missing",
            ),
            (
                "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
                "line 4 \"f 1 2 9\": there is no point 9, and there are 3",
            ),
            (
                "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -9\n",
                "line 4 \"f 1 2 -9\": there is no point -9, and there are 3",
            ),
            (
                "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 a 2\n",
                "line 4 \"f 1 a 2\": \"a\" is no number of a point",
            ),
        ] {
            assert_eq!(read(text.as_bytes()), Err(Problem::Mesh(words.to_owned())));
        }
    }
}
