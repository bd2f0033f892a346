//! The page without a server: its files, of which one names recordings.

use std::borrow::Cow;
use std::fmt::Write;

use crate::asset::{Asset, asset, assets, static_policy};

/// Files that only a page with a server needs.
const OF_A_SERVER: [&str; 2] = ["/client/", "/live.js"];

/// The files of a page that plays recordings and asks no server of ours, with their paths from the page's folder. It works at
/// any address of any web host.
///
/// `recordings`: paths of the recordings from the page's folder, as an address names them.
#[must_use]
pub fn static_files(recordings: &[String]) -> Vec<(&'static str, Cow<'static, [u8]>)> {
    let is_needed = |file: &&Asset| {
        let mut left_out = OF_A_SERVER.iter();
        !left_out.any(|path| file.path.starts_with(path)) && file.path != "/"
    };
    let files = assets()
        .iter()
        .filter(is_needed)
        .map(|file| (&file.path[1..], Cow::Borrowed(file.bytes)));
    let index = Cow::Owned(index(recordings).into_bytes());
    std::iter::once(("index.html", index))
        .chain(files)
        .collect()
}

/// The page's HTML, with its policy and its recordings in the head.
fn index(recordings: &[String]) -> String {
    let page = asset("/").map_or("", |page| std::str::from_utf8(page.bytes).unwrap_or(""));
    let mut names = String::from("[");
    for (number, path) in recordings.iter().enumerate() {
        let comma = if number == 0 { "" } else { "," };
        // Writing to a text does not fail.
        let _ = write!(names, "{comma}&quot;{}&quot;", escaped(path));
    }
    names.push(']');
    let head = format!(
        "<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"{}\">\n\
         <meta name=\"rhumb-recordings\" content=\"{names}\">",
        static_policy()
    );
    page.replacen("<meta charset=\"utf-8\">", &head, 1)
}

/// A text of a JSON string in an attribute. Paths of addresses have no quotes; what has any is not let out of either.
fn escaped(path: &str) -> String {
    path.replace(['"', '\\', '<', '>', '&'], "")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(recordings: &[&str]) -> Vec<(&'static str, String)> {
        let recordings: Vec<_> = recordings.iter().map(|&path| path.to_owned()).collect();
        let text = |bytes: Cow<'_, [u8]>| String::from_utf8(bytes.into_owned()).unwrap();
        static_files(&recordings)
            .into_iter()
            .map(|(path, bytes)| (path, text(bytes)))
            .collect()
    }

    #[test]
    fn the_page_names_its_recordings_and_its_policy_before_any_script() {
        let files = texts(&["recordings/a%20b.mcap", "recordings/c.mcap"]);
        let (path, index) = &files[0];
        assert_eq!(*path, "index.html");
        let named = "content=\"[&quot;recordings/a%20b.mcap&quot;,&quot;recordings/c.mcap&quot;]\"";
        assert!(index.contains(named), "{index}");
        let policy = index.find("Content-Security-Policy").unwrap();
        assert!(policy < index.find("<script").unwrap());
        assert!(policy < index.find("<link").unwrap());
        assert!(!index.contains("wasm") && !index.contains("https:"));
    }

    #[test]
    fn every_path_is_relative_and_every_static_import_is_there() {
        let files = texts(&["a.mcap"]);
        let own = |path: &str| path.matches('/').count() == 0 && path.ends_with(".js");
        for (path, text) in &files {
            assert!(!path.starts_with('/') && !path.contains(".wasm"), "{path}");
            if !own(path) {
                continue;
            }
            for (_, rest) in text
                .lines()
                .filter_map(|line| line.split_once(" from \"./"))
            {
                let (name, _) = rest.split_once('"').unwrap();
                assert!(
                    files.iter().any(|(other, _)| *other == name),
                    "{path}: {name}"
                );
            }
        }
        let (_, index) = &files[0];
        for attribute in ["src=\"/", "href=\"/", "src=\"http", "href=\"http"] {
            assert!(!index.contains(attribute), "{attribute}");
        }
    }

    #[test]
    fn a_path_does_not_leave_its_attribute() {
        let files = texts(&["a\"><script>.mcap"]);
        let (_, index) = &files[0];
        assert!(index.contains("[&quot;ascript.mcap&quot;]"));
    }
}
