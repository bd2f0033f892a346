//! The house rules, held against every file of the house.
//!
//! Proved by reading the sources as text. Each rule reports all that breaks it at once. What is said in comments and
//! strings counts for no rule about code.

mod citations;
mod code;
mod documents;
mod house;
mod rules;
