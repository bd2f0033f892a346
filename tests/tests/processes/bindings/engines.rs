//! The book's code for Unreal and Unity, with stand-ins for the engines.

use tempfile::TempDir;

use super::c::{Compiled, Linked};
use super::csharp::Assembly;
use super::root;
use crate::SERVER;

/// The only code block of the page in a language.
fn block(language: &str) -> String {
    let page = root().join("docs/book/src/how-to/engines.md");
    let page = std::fs::read_to_string(page).expect("the page");
    let opened = format!("```{language}\n");
    let mut blocks = page.split(&opened).skip(1);
    let block = blocks.next().and_then(|rest| rest.split("```").next());
    assert!(blocks.next().is_none(), "one block of {language}");
    block.expect("a block that ends").to_owned()
}

#[test]
fn the_unreal_code_of_the_book_shows_a_body_in_unreals_axes() {
    let folder = TempDir::new().expect("a folder for the header");
    std::fs::write(folder.path().join("book.hpp"), block("cpp")).expect("the header");
    let program = Compiled::with_headers("tests/unreal.cpp", Linked::Shared, folder.path());
    if let Some(program) = program {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server);
        assert_eq!(out, "the crate fell and turned as in Unreal\n");
    }
}

#[test]
fn the_unity_code_of_the_book_shows_a_body_in_unitys_axes() {
    let folder = TempDir::new().expect("a folder for the source");
    let source = folder.path().join("RhumbWorld.cs");
    std::fs::write(&source, block("cs")).expect("the source");
    if let Some(program) = Assembly::with_sources("tests/Unity.cs", &[&source]) {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server, &[]);
        assert_eq!(out, "the crate fell and turned as in Unity\n");
    }
}
