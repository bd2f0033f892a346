//! The files of the page, by their paths, and as a folder without a server.
//!
//! Without a server, one file of the page names recordings.

use std::borrow::Cow;
use std::fmt::Write;

/// One file of the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Asset {
    /// Its path, which begins with a slash.
    pub path: &'static str,
    /// Its type.
    pub content_type: &'static str,
    /// Its content.
    pub bytes: &'static [u8],
}

/// The reason why this build has no page, and what to do; `None` if it has one.
pub const UNAVAILABLE: Option<&str> = {
    let reason = env!("RHUMB_VIEWER_UNAVAILABLE");
    if reason.is_empty() {
        None
    } else {
        Some(reason)
    }
};

/// The hash of the import map in `index.html`, the only script that is no file.
const IMPORT_MAP: &str = "'sha256-4MbugE3k0NaS1u+FiIM13Ycz2hB0hAZPvGIOjEi1Z4s='";

/// The rights of the page, for the header of that name: it loads its own files, and connects by WebTransport to
/// `sources`, a list of that header's form.
#[must_use]
pub fn content_security_policy(sources: &str) -> String {
    format!(
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval' {IMPORT_MAP}; \
         style-src 'self'; img-src 'self' data:; connect-src 'self' {sources}; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}

/// The rights of the page without a server: it loads its own files, and connects to nothing.
///
/// It stands in the page, where a policy cannot say who may embed it.
fn static_policy() -> String {
    format!(
        "default-src 'none'; script-src 'self' {IMPORT_MAP}; style-src 'self'; img-src 'self' data:; \
         connect-src 'self'; base-uri 'none'; form-action 'none'"
    )
}

/// The files of `page`, `vendor/three` and the web client, as the build found them.
const ASSETS: &[Asset] = include!(concat!(env!("OUT_DIR"), "/assets.rs"));

/// All files of the page.
#[must_use]
pub const fn assets() -> &'static [Asset] {
    ASSETS
}

/// The file at a path.
#[must_use]
pub fn asset(path: &str) -> Option<&'static Asset> {
    ASSETS.iter().find(|asset| asset.path == path)
}

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

    fn text(path: &str) -> &'static str {
        let file = asset(path).unwrap_or_else(|| panic!("{path} is an asset"));
        std::str::from_utf8(file.bytes).unwrap()
    }

    fn base64(bytes: &[u8]) -> String {
        const DIGITS: &[u8; 64] =
            b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let group = |three: &[u8]| {
            let bits = three
                .iter()
                .chain(&[0, 0])
                .take(3)
                .fold(0_u32, |bits, byte| bits << 8 | u32::from(*byte));
            (0..4)
                .map(|place| match place <= three.len() {
                    true => char::from(DIGITS[(bits >> (18 - 6 * place) & 63) as usize]),
                    false => '=',
                })
                .collect::<String>()
        };
        bytes.chunks(3).map(group).collect()
    }

    #[test]
    fn the_policy_allows_the_import_map_and_no_other_inline_script() {
        let page = text("/");
        let (before, rest) = page.split_once("<script type=\"importmap\">").unwrap();
        let (map, after) = rest.split_once("</script>").unwrap();
        let hash = base64(ring::digest::digest(&ring::digest::SHA256, map.as_bytes()).as_ref());
        assert!(
            content_security_policy("").contains(&format!("'sha256-{hash}'")),
            "{hash}"
        );
        for part in [before, after] {
            let scripts = part.split("<script").skip(1);
            assert!(scripts.into_iter().all(|script| script.contains("src=\"")));
            assert!(!part.contains(" style=") && !part.contains(" onclick="));
        }
    }

    #[test]
    fn every_file_that_the_page_imports_is_embedded() {
        let scripts = assets()
            .iter()
            .filter(|file| file.path.ends_with(".js") && file.path.matches('/').count() == 1);
        let mut imports = 0;
        for script in scripts {
            let lines = text(script.path).lines();
            let names = lines.filter_map(|line| {
                let (_, name) = line.split_once(" from \"")?;
                name.split_once('"')
            });
            for (name, _) in names.filter(|(name, _)| name.starts_with("./")) {
                let path = &name[1..];
                let is_built = path.starts_with("/client/") && UNAVAILABLE.is_some();
                assert!(
                    is_built || asset(path).is_some(),
                    "{} imports {name}",
                    script.path
                );
                imports += 1;
            }
        }
        assert!(imports > 5, "the imports are found");
        for path in [
            "/style.css",
            "/icon.svg",
            "/three/build/three.module.min.js",
            "/fzstd/fzstd.js",
        ] {
            assert!(asset(path).is_some(), "{path}");
        }
    }

    #[test]
    fn nothing_comes_from_outside() {
        for file in assets()
            .iter()
            .filter(|file| !file.path.starts_with("/three/") && !file.path.starts_with("/fzstd/"))
        {
            if file.path.ends_with(".js") || file.path.ends_with(".css") || file.path == "/" {
                let code = text(file.path);
                let urls = [
                    "src=\"http",
                    "href=\"http",
                    "url(http",
                    "from \"http",
                    "import(\"http",
                ];
                assert!(urls.iter().all(|url| !code.contains(url)), "{}", file.path);
            }
        }
    }

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
