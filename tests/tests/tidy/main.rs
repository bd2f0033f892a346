//! Checks the source rules in every file of the repository.
//!
//! The tests read the sources as text. Each rule reports all violations at once. Comments and strings are ignored by
//! rules about code.

mod citations;
mod code;
mod documents;
mod house;
mod imports;
mod reasons;
mod rules;
mod words;
