//! The project uses the field's words, and one type name for one type.
//!
//! Proved by splitting every name and sentence of the sources and documents into words. Decision records and the changelog
//! tell history, so old words may stand there.

use std::collections::BTreeMap;

use crate::house::{File, files, report, sources};

/// Words that earlier versions used where the field has its own. ARCHITECTURE.md's glossary has today's words.
const RETIRED: &[&str] = &[
    "abreast",
    "amended",
    "arrears",
    "believed",
    "believes",
    "foreseen",
    "foresight",
    "footing",
    "forge",
    "forged",
    "happening",
    "happenings",
    "heard",
    "hearing",
    "hindsight",
    "lattice",
    "manner",
    "manners",
    "namings",
    "newcomer",
    "newcomers",
    "nobody",
    "outlook",
    "parities",
    "parity",
    "patience",
    "pretend",
    "pretended",
    "prospect",
    "purse",
    "quartet",
    "reassurance",
    "reassure",
    "restorer",
    "rude",
    "saying",
    "sayings",
    "seated",
    "shelf",
    "shove",
    "sitter",
    "snapped",
    "somebody",
    "spoken",
    "told",
    "tongue",
    "usher",
    "verbatim",
    "vouch",
    "vouched",
    "vouches",
    "vouching",
    "whoever",
    "whom",
    "wish",
    "wishes",
    "withheld",
    "witness",
    "witnesses",
];

/// Files that may hold a retired word: history, this list, and JSON that measurements left.
const HISTORY: [&str; 4] = [
    "CHANGELOG.md",
    "docs/decisions/",
    "docs/results/data/",
    "tests/tests/tidy/words.rs",
];

/// Splits a name or a sentence into words of lower case: `FecDecoder::add_known` has four.
fn words(text: &str) -> Vec<String> {
    let (mut words, mut word) = (Vec::new(), String::new());
    let mut was_lower = false;
    for letter in text.chars() {
        let begins = !letter.is_ascii_alphabetic() || letter.is_ascii_uppercase() && was_lower;
        if begins && !word.is_empty() {
            words.push(core::mem::take(&mut word));
        }
        if letter.is_ascii_alphabetic() {
            word.push(letter.to_ascii_lowercase());
        }
        was_lower = letter.is_ascii_lowercase();
    }
    if !word.is_empty() {
        words.push(word);
    }
    words
}

#[test]
fn no_retired_word_stands_anywhere() {
    // The engine's own field for the point of a hit.
    let is_engines =
        |file: &File, word: &str| word == "witness" && file.is_in(&["solids/src/queries.rs"]);
    let is_read = |file: &File| {
        let endings = [
            ".rs", ".py", ".pyi", ".md", ".json", ".proto", ".mjs", ".toml", ".c", ".cpp", ".h",
            ".hpp", ".cs",
        ];
        endings.iter().any(|ending| file.path.ends_with(ending)) && !file.is_in(&HISTORY)
    };
    let mut violations = Vec::new();
    for file in files().into_iter().filter(is_read) {
        for (number, line) in file.text.lines().enumerate() {
            let found = words(line)
                .into_iter()
                .filter(|word| RETIRED.contains(&word.as_str()) && !is_engines(&file, word));
            violations.extend(found.map(|word| format!("{}:{}: {word}", file.path, number + 1)));
        }
    }
    report("a retired word has its replacement", &violations);
}

/// The names of the types that a source defines.
fn defined(code: &str) -> Vec<String> {
    let mut names = Vec::new();
    for line in code.lines() {
        let mut tokens = line
            .split_whitespace()
            .skip_while(|token| token.starts_with("pub"))
            .peekable();
        let is_type = tokens
            .next()
            .is_some_and(|token| matches!(token, "struct" | "enum" | "trait" | "union"));
        let name = tokens.next().unwrap_or_default();
        let end = name
            .find(|c: char| !c.is_alphanumeric())
            .unwrap_or(name.len());
        if is_type && end > 0 {
            names.push(name[..end].to_owned());
        }
    }
    names
}

/// True for a file with what is compiled where a system or a build lacks something, instead of the module with the same names.
fn stands_in(file: &File) -> bool {
    file.is_in(&[
        "service/src/dispatcher/no_process.rs",
        "service/src/recording/mod.rs",
    ])
}

#[test]
fn a_type_name_has_one_definition_in_the_product() {
    let product = [
        "reckoning/src/",
        "protocol/src/",
        "transport/",
        "server/src/",
        "service/src/",
        "client/",
        "gateways/app/src/",
        "bindings/",
    ];
    let mut places: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in sources()
        .into_iter()
        .filter(|file| file.is_in(&product) && !file.is_test() && !stands_in(file))
    {
        for name in defined(&file.code()) {
            places.entry(name).or_default().push(file.path.clone());
        }
    }
    let twice = places.into_iter().filter(|(_, files)| files.len() > 1);
    let violations: Vec<_> = twice
        .map(|(name, files)| format!("{name}: {}", files.join(", ")))
        .collect();
    report("a type name has one definition", &violations);
}

#[test]
fn names_are_split_into_words() {
    let found = words("FecDecoder::add_known(x) // It's FEC");
    assert_eq!(
        found,
        ["fec", "decoder", "add", "known", "x", "it", "s", "fec"]
    );
    let code = "pub(crate) struct A<T> {\n    pub enum Ab {\nstruct Ac;\nlet structure = 1;\n";
    assert_eq!(defined(code), ["A", "Ab", "Ac"]);
}
