//! The rows of a group as cases of a client.

use crate::case::{Case, CaseRow};

/// The cases of a group.
pub(super) fn table(group: &str, rows: &[CaseRow]) -> Vec<Case> {
    let case = |(number, name, cites, play): &CaseRow| {
        Case::client(&format!("{group}.{number}"), name)
            .cites(cites)
            .play(*play)
    };
    rows.iter().map(case).collect()
}
