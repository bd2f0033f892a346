//! No file and no crate imports itself, directly or through others.
//!
//! The test reads `use` declarations and the paths in the code that begin with `crate`, `self`, `super` or a child module.
//! A re-exported name leads to the file that defines it, so a re-export alone is no import. Unit tests are left out.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;

use crate::code::without_tests;
use crate::house::{File, report, root, sources};

/// Files by the path of their module, within one crate.
type Modules<'a> = BTreeMap<Vec<String>, &'a Source>;

/// A source file of a crate, as far as imports are concerned.
struct Source {
    path: String,
    module: Vec<String>,
    /// Without tests and `use` declarations.
    code: String,
    uses: Vec<Use>,
}

/// One imported name.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Use {
    path: Vec<String>,
    /// The name that it has in the importing file.
    name: String,
    is_public: bool,
}

/// The module path of a file below the folder that holds its crate's root.
fn module_of(below: &str) -> Vec<String> {
    let stem = below.strip_suffix(".rs").unwrap_or(below);
    let mut parts: Vec<String> = stem.split('/').map(str::to_owned).collect();
    if matches!(
        parts.last().map(String::as_str),
        Some("mod" | "lib" | "main")
    ) {
        parts.pop();
    }
    parts
}

/// Splits a list at the commas that no brace encloses.
fn split_list(list: &str) -> Vec<&str> {
    let (mut parts, mut depth, mut start) = (Vec::new(), 0_i32, 0);
    for (place, byte) in list.bytes().enumerate() {
        match byte {
            b'{' => depth += 1,
            b'}' => depth -= 1,
            b',' if depth == 0 => {
                parts.push(&list[start..place]);
                start = place + 1;
            }
            _ => {}
        }
    }
    parts.push(&list[start..]);
    parts
}

/// Adds every name of a `use` tree.
fn flatten(prefix: &[String], tree: &str, is_public: bool, uses: &mut Vec<Use>) {
    let tree = tree.trim();
    if tree.is_empty() {
        return;
    }
    if let Some((head, rest)) = tree.split_once('{') {
        let mut path = prefix.to_vec();
        path.extend(
            head.split("::")
                .map(str::trim)
                .filter(|part| !part.is_empty())
                .map(str::to_owned),
        );
        let list = rest.trim_end().strip_suffix('}').unwrap_or(rest);
        for part in split_list(list) {
            flatten(&path, part, is_public, uses);
        }
        return;
    }
    let (tree, alias) = tree
        .split_once(" as ")
        .map_or((tree, None), |(tree, alias)| (tree, Some(alias)));
    let mut path = prefix.to_vec();
    path.extend(
        tree.split("::")
            .map(|part| part.trim().to_owned())
            .filter(|part| !part.is_empty()),
    );
    if path.last().is_some_and(|last| last == "self") && path.len() > 1 {
        path.pop();
    }
    let Some(last) = path.last().cloned() else {
        return;
    };
    let name = alias.map_or(last, |alias| alias.trim().to_owned());
    uses.push(Use {
        path,
        name,
        is_public,
    });
}

/// Every name that a file imports by `use`, and the code without these declarations.
fn declared(code: &str) -> (Vec<Use>, String) {
    let (mut uses, mut rest, mut kept) = (Vec::new(), String::new(), 0);
    for (start, _) in code.match_indices("use ") {
        let line = code[..start].rfind('\n').map_or(0, |end| end + 1);
        let before = code[line..start].trim();
        // The end of `pub enum RemovalCause` is no declaration.
        let is_public = before.starts_with("pub") && !before.contains(' ');
        let is_declaration = before.is_empty() || is_public;
        if let (true, Some(length)) = (is_declaration, code[start..].find(';')) {
            let tree = &code[start + 4..start + length];
            flatten(&[], tree, !before.is_empty(), &mut uses);
            rest.push_str(&code[kept..start]);
            kept = start + length;
        }
    }
    rest.push_str(&code[kept..]);
    (uses, rest)
}

/// Every path in the code itself that begins with one of these: `crate`, `super`, `self`, or a child module.
///
/// The path in a visibility such as `pub(in crate::a)` imports nothing.
fn inline(code: &str, starts: &[String]) -> Vec<Use> {
    let mut uses = Vec::new();
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    for start in starts {
        for (place, _) in code.match_indices(&format!("{start}::")) {
            let before = &code[..place];
            let last = before.chars().next_back();
            let is_begun = before.ends_with("(in ")
                || last.is_some_and(|c| is_name(c) || c == ':' || c == '$');
            let text = &code[place..];
            let end = text
                .find(|c: char| !is_name(c) && c != ':')
                .unwrap_or(text.len());
            if !is_begun && !text[..end].ends_with(':') {
                flatten(&[], &text[..end], false, &mut uses);
            }
        }
    }
    uses
}

/// The path from the crate's root, if it is a path of this crate.
fn absolute(module: &[String], path: &[String], modules: &Modules<'_>) -> Option<Vec<String>> {
    let mut base = module.to_vec();
    let mut rest = path;
    match path.first()?.as_str() {
        "crate" => (base, rest) = (Vec::new(), &path[1..]),
        "self" => rest = &path[1..],
        "super" => {
            while rest.first().is_some_and(|part| part == "super") {
                base.pop()?;
                rest = &rest[1..];
            }
        }
        first => {
            let mut child = base.clone();
            child.push(first.to_owned());
            if !modules.contains_key(&child) {
                return None;
            }
        }
    }
    base.extend_from_slice(rest);
    Some(base)
}

/// The module that defines what an absolute path names.
fn definer(path: &[String], modules: &Modules<'_>, depth: usize) -> Option<Vec<String>> {
    let longest = (0..=path.len())
        .rev()
        .find(|len| modules.contains_key(&path[..*len]))?;
    let (module, rest) = path.split_at(longest);
    let Some(item) = rest.first().filter(|_| depth > 0) else {
        return Some(module.to_vec());
    };
    let source = modules.get(module)?;
    let through = source
        .uses
        .iter()
        .find(|one| one.is_public && one.name == *item);
    match through.and_then(|one| absolute(module, &one.path, modules)) {
        Some(target) => definer(&target, modules, depth - 1),
        None => Some(module.to_vec()),
    }
}

/// The names of the modules directly below a module.
fn children(module: &[String], modules: &Modules<'_>) -> Vec<String> {
    let below = modules.keys().filter_map(|other| other.split_last());
    let children = below.filter(|(_, parent)| *parent == module);
    children.map(|(child, _)| child.clone()).collect()
}

/// True if a name stands in the code.
fn is_used(code: &str, name: &str) -> bool {
    let mut names = code.split(|c: char| !c.is_alphanumeric() && c != '_');
    names.any(|word| word == name)
}

/// From each file to those that it imports, with a name as the reason.
fn imports(sources: &[Source]) -> BTreeMap<String, BTreeMap<String, String>> {
    let modules: Modules<'_> = sources
        .iter()
        .map(|source| (source.module.clone(), source))
        .collect();
    let mut imports: BTreeMap<String, BTreeMap<String, String>> = BTreeMap::new();
    for source in sources {
        let found = imports.entry(source.path.clone()).or_default();
        let mut starts = ["crate", "super", "self"].map(str::to_owned).to_vec();
        starts.extend(children(&source.module, &modules));
        for one in source.uses.iter().chain(&inline(&source.code, &starts)) {
            if one.is_public && !is_used(&source.code, &one.name) {
                continue;
            }
            let Some(path) = absolute(&source.module, &one.path, &modules) else {
                continue;
            };
            let Some(target) = definer(&path, &modules, 8).and_then(|module| modules.get(&module))
            else {
                continue;
            };
            if target.path != source.path {
                found.insert(target.path.clone(), one.path.join("::"));
            }
        }
    }
    imports
}

/// Groups of nodes that reach each other (Tarjan's strongly connected components), of two or more.
fn circles(graph: &BTreeMap<String, BTreeMap<String, String>>) -> Vec<BTreeSet<String>> {
    let reach = |from: &String| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from.clone()]);
        while let Some(node) = open.pop() {
            for next in graph.get(&node).into_iter().flat_map(BTreeMap::keys) {
                if seen.insert(next.clone()) {
                    open.push(next.clone());
                }
            }
        }
        seen
    };
    let reached: BTreeMap<&String, BTreeSet<String>> =
        graph.keys().map(|node| (node, reach(node))).collect();
    let mut circles = BTreeSet::new();
    for (node, seen) in &reached {
        if seen.contains(*node) {
            let back = seen
                .iter()
                .filter(|other| reached.get(other).is_some_and(|seen| seen.contains(*node)));
            circles.insert(back.cloned().collect::<BTreeSet<_>>());
        }
    }
    circles.into_iter().collect()
}

/// The sources of each crate target, by the folder of its root.
fn crates() -> BTreeMap<String, Vec<Source>> {
    let files = sources();
    let roots: Vec<String> = files
        .iter()
        .filter_map(|file| {
            let (folder, name) = file.path.rsplit_once('/')?;
            matches!(name, "lib.rs" | "main.rs").then(|| folder.to_owned())
        })
        .collect();
    let mut crates: BTreeMap<String, Vec<Source>> = BTreeMap::new();
    for file in files
        .iter()
        .filter(|file| !file.path.ends_with("/tests.rs"))
    {
        let within = roots
            .iter()
            .filter(|folder| file.path.starts_with(&format!("{folder}/")));
        if let Some(folder) = within.max_by_key(|folder| folder.len()) {
            crates
                .entry(folder.clone())
                .or_default()
                .push(source(file, folder));
        }
    }
    crates
}

fn source(file: &File, folder: &str) -> Source {
    let code = file.code();
    let (uses, code) = declared(without_tests(&code));
    Source {
        path: file.path.clone(),
        module: module_of(&file.path[folder.len() + 1..]),
        uses,
        code,
    }
}

/// A circle as text: each import that is part of it.
fn described(
    circle: &BTreeSet<String>,
    graph: &BTreeMap<String, BTreeMap<String, String>>,
) -> String {
    let arrows = circle.iter().flat_map(|from| {
        let targets = graph[from].iter().filter(|(to, _)| circle.contains(*to));
        targets.map(move |(to, name)| format!("    {from} -> {to}: {name}"))
    });
    format!(
        "{} files:\n{}",
        circle.len(),
        arrows.collect::<Vec<_>>().join("\n")
    )
}

#[test]
fn no_file_imports_a_file_that_imports_it() {
    let mut violations = Vec::new();
    for sources in crates().values() {
        let graph = imports(sources);
        violations.extend(
            circles(&graph)
                .iter()
                .map(|circle| described(circle, &graph)),
        );
    }
    report("imports between files run one way", &violations);
}

#[test]
fn no_crate_depends_on_a_crate_that_depends_on_it() {
    let mut graph: BTreeMap<String, BTreeMap<String, String>> = BTreeMap::new();
    for folder in crates().keys() {
        let package = folder.trim_end_matches("/src").to_owned();
        let Ok(manifest) = fs::read_to_string(root().join(&package).join("Cargo.toml")) else {
            continue;
        };
        let named = |prefix: &str| {
            let lines = manifest.lines().filter(|line| line.starts_with(prefix));
            lines
                .filter_map(|line| line.split(['.', ' ', '=']).next())
                .map(str::to_owned)
                .collect::<Vec<_>>()
        };
        let name = manifest
            .lines()
            .find_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"'));
        let name = name.expect("a package has a name").to_owned();
        let needs = named("rhumb-").into_iter().filter(|other| *other != name);
        graph
            .entry(name.clone())
            .or_default()
            .extend(needs.map(|other| (other, String::new())));
    }
    assert!(graph.len() > 5, "the crates are found");
    let violations: Vec<_> = circles(&graph)
        .iter()
        .map(|circle| described(circle, &graph))
        .collect();
    report("dependencies between crates run one way", &violations);
}

#[test]
fn a_circle_is_found_through_re_exports_and_nested_lists() {
    let file = |path: &str, code: &str| {
        let (uses, code) = declared(code);
        Source {
            path: path.to_owned(),
            module: module_of(path),
            uses,
            code,
        }
    };
    let sources = [
        file("lib.rs", "mod a;\nmod b;\npub use a::{A, c::C};\n"),
        file("a/mod.rs", "pub mod c;\npub struct A(super::b::B);\n"),
        file("a/c.rs", "pub struct C;\n"),
        file("b.rs", "use crate::{\n    A,\n    C,\n};\npub struct B;\n"),
    ];
    let graph = imports(&sources);
    let named: Vec<_> = graph["b.rs"].keys().cloned().collect();
    assert_eq!(named, ["a/c.rs", "a/mod.rs"]);
    let expected = BTreeSet::from(["a/mod.rs".to_owned(), "b.rs".to_owned()]);
    assert_eq!(circles(&graph), [expected]);
}
