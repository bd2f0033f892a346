//! `rhumb-server page`: writes the page with recordings, for any web host.

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

use clap::Args;

/// The folder of the page, and the recordings that it plays.
#[derive(Debug, Args)]
pub(crate) struct PageArguments {
    /// Folder for the page: a new one, or an empty one.
    #[arg(long = "static", value_name = "DIR")]
    folder: PathBuf,
    /// Recordings that the page plays: .mcap, .rhtrace or .rhtrace.zst.
    #[arg(required = true, value_name = "FILE")]
    recordings: Vec<PathBuf>,
}

/// The folder of the recordings, in that of the page.
const RECORDINGS: &str = "recordings";
/// Beginnings of the files that the page plays: MCAP, .rhtrace, and what zstd has packed.
const MAGICS: [&[u8]; 3] = [b"\x89MCAP0\r\n", b"RHTRACE1", b"\x28\xb5\x2f\xfd"];

/// Reason why the page was not written.
#[derive(Debug)]
pub(crate) enum PageError {
    /// The folder has files already.
    NotEmpty(PathBuf),
    /// The file is no recording that the page plays.
    NotARecording(PathBuf),
    /// Two recordings have this name.
    SameName(OsString),
    /// A file or folder could not be read or written.
    Io(PathBuf, io::Error),
}

/// Writes the page, and says how to look at it. What it refuses leaves nothing behind.
pub(crate) fn run(arguments: &PageArguments, out: &mut impl Write) -> Result<(), PageError> {
    let PageArguments { folder, recordings } = arguments;
    let at = |path: &Path| {
        let path = path.to_owned();
        move |cause| PageError::Io(path, cause)
    };
    if folder.exists() && fs::read_dir(folder).map_err(at(folder))?.next().is_some() {
        return Err(PageError::NotEmpty(folder.clone()));
    }
    let mut names = BTreeSet::new();
    for recording in recordings {
        check(recording)?;
        let name = recording.file_name().unwrap_or_default();
        if !names.insert(name) {
            return Err(PageError::SameName(name.to_owned()));
        }
    }
    let paths: Vec<String> = recordings.iter().map(|path| address(path)).collect();
    let mut written = 0;
    for (path, bytes) in rhumb_viewer::static_files(&paths) {
        let path = folder.join(path);
        let parent = path.parent().unwrap_or(folder);
        fs::create_dir_all(parent).map_err(at(parent))?;
        fs::write(&path, &bytes).map_err(at(&path))?;
        written += bytes.len() as u64;
    }
    let kept = folder.join(RECORDINGS);
    fs::create_dir_all(&kept).map_err(at(&kept))?;
    for recording in recordings {
        let path = kept.join(recording.file_name().unwrap_or_default());
        written += fs::copy(recording, &path).map_err(at(recording))?;
    }
    let shown = folder.display();
    let said = writeln!(
        out,
        "wrote the page to {shown}, {:.1} MB; any web host serves it: python3 -m http.server --directory {shown}",
        written as f64 / 1e6
    );
    said.map_err(at(folder))
}

/// Refuses a file that the page could not play.
fn check(path: &Path) -> Result<(), PageError> {
    let failed = |cause| PageError::Io(path.to_owned(), cause);
    let mut head = Vec::new();
    let file = File::open(path).map_err(failed)?;
    file.take(8).read_to_end(&mut head).map_err(failed)?;
    match MAGICS.iter().any(|magic| head.starts_with(magic)) {
        true => Ok(()),
        false => Err(PageError::NotARecording(path.to_owned())),
    }
}

/// The address of a recording, from the page's folder.
fn address(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    let mut address = format!("{RECORDINGS}/");
    for byte in name.as_encoded_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => {
                address.push(char::from(*byte));
            }
            _ => address += &format!("%{byte:02X}"),
        }
    }
    address
}

impl fmt::Display for PageError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotEmpty(folder) => write!(
                f,
                "{} has files already: name a new folder, or empty it",
                folder.display()
            ),
            Self::NotARecording(path) => write!(
                f,
                "{} is no recording that the page plays: it is neither an MCAP file nor an .rhtrace",
                path.display()
            ),
            Self::SameName(name) => write!(
                f,
                "two recordings are named {}: rename one of them",
                name.to_string_lossy()
            ),
            Self::Io(path, cause) => write!(f, "{}: {cause}", path.display()),
        }
    }
}

impl std::error::Error for PageError {}

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder of this test alone, empty.
    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("rhumb-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn write(folder: &Path, recordings: &[&Path]) -> Result<String, PageError> {
        let arguments = PageArguments {
            folder: folder.to_owned(),
            recordings: recordings.iter().map(|&path| path.to_owned()).collect(),
        };
        let mut out = Vec::new();
        run(&arguments, &mut out)?;
        Ok(String::from_utf8(out).unwrap())
    }

    #[test]
    fn the_page_and_its_recordings_are_written_and_nothing_is_overwritten() {
        let work = folder("static-page");
        let recording = work.join("a b.mcap");
        fs::write(&recording, b"\x89MCAP0\r\nrest").unwrap();
        let page = work.join("page");
        let said = write(&page, &[&recording]).unwrap();
        assert!(said.contains("http.server"), "{said}");
        let index = fs::read_to_string(page.join("index.html")).unwrap();
        assert!(index.contains("recordings/a%20b.mcap"));
        let copied = fs::read(page.join("recordings/a b.mcap")).unwrap();
        assert_eq!(copied, fs::read(&recording).unwrap());
        assert!(page.join("three/build/three.module.min.js").exists());
        assert!(!page.join("client").exists());
        let again = write(&page, &[&recording]).unwrap_err();
        assert!(again.to_string().contains("has files already"), "{again}");
        fs::remove_dir_all(work).unwrap();
    }

    #[test]
    fn a_refused_page_leaves_nothing_behind() {
        let work = folder("static-page-refused");
        let (text, trace) = (work.join("a.txt"), work.join("x.rhtrace"));
        fs::write(&text, "no recording").unwrap();
        fs::write(&trace, b"RHTRACE1").unwrap();
        fs::create_dir(work.join("other")).unwrap();
        let same = work.join("other/x.rhtrace");
        fs::write(&same, b"RHTRACE1").unwrap();
        let page = work.join("page");
        for (recordings, words) in [
            (vec![text.as_path()], "neither an MCAP file nor an .rhtrace"),
            (
                vec![trace.as_path(), same.as_path()],
                "two recordings are named",
            ),
            (vec![Path::new("/nowhere/a.mcap")], "/nowhere/a.mcap"),
        ] {
            let error = write(&page, &recordings).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
            assert!(!page.exists());
        }
        fs::remove_dir_all(work).unwrap();
    }
}
