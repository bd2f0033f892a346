//! The rows of a group as cases of a server.

use crate::case::{Case, CaseRow};
use crate::feature::Feature;

/// The cases of a group that need the same features.
pub(super) fn table(
    group: &str,
    needs: &[Feature],
    rows: &[CaseRow],
) -> impl Iterator<Item = Case> + use<> {
    let case = |(number, name, cites, play): &CaseRow| {
        Case::server(&format!("{group}.{number}"), name)
            .cites(cites)
            .needs(needs)
            .play(*play)
    };
    rows.iter().map(case).collect::<Vec<_>>().into_iter()
}
