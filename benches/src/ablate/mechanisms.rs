//! The mechanisms of the wire and of choosing: switch, code, requirements.
//!
//! Code and requirements are those that would go with the mechanism, counted in a checkout. Mechanisms may share some.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use crate::output::Failure;
use crate::replay::Feature;

/// One mechanism.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mechanism {
    pub(super) name: &'static str,
    pub(super) switch: Switch,
    /// The feature that users name, if the mechanism is one.
    pub(super) feature: Option<&'static str>,
    /// Files, folders and items, as `Checkout::lines` reads them.
    pub(super) code: &'static [&'static str],
    /// Clauses and requirements of the specification.
    pub(super) requirements: &'static [&'static str],
}

/// The measurement of a mechanism.
#[derive(Clone, Copy, Debug)]
pub(super) enum Switch {
    /// Everything on, against this one off.
    Off(Feature),
    /// The same, with lookahead in both.
    OffWithLookahead(Feature),
    /// Lookahead, against none.
    Lookahead,
    /// It cannot be switched off.
    Fixed,
}

/// All mechanisms, in the order of the table.
pub(super) const MECHANISMS: &[Mechanism] = &[
    Mechanism {
        name: "predictor: rest",
        switch: Switch::Off(Feature::Resting),
        feature: None,
        code: &["protocol/src/stream/mode_decision/mod.rs#fn rest"],
        requirements: &["RECKONING 3.3"],
    },
    Mechanism {
        name: "predictor: ballistic",
        switch: Switch::Off(Feature::Ballistic),
        feature: None,
        code: &[
            "protocol/src/stream/tracks.rs#struct GravityHistory, impl GravityHistory",
            "reckoning/src/predictor.rs#fn pull",
        ],
        requirements: &["RECKONING 2.5", "RECKONING 3.5", "PROTOCOL 6.9"],
    },
    Mechanism {
        name: "predictor: torque-free rotation",
        switch: Switch::Off(Feature::TorqueFree),
        feature: None,
        code: &[
            "reckoning/src/free_motion.rs#type RotationState, struct RotationCursor, impl RotationCursor, struct MomentumFlow, impl MomentumFlow, fn turn, fn precessed, struct TorqueFreeRotation, impl TorqueFreeRotation, struct Inertia, impl Inertia, enum InvalidInertia, impl fmt::Display for InvalidInertia, impl core::error::Error for InvalidInertia",
            "protocol/src/message/scene_event.rs#fn encode_inertia, fn decode_inertia, fn bits",
            "protocol/src/stream/tracks.rs#struct RotationCursors, impl Clone for RotationCursors, impl fmt::Debug for RotationCursors, impl RotationCursors",
        ],
        requirements: &["RECKONING 2.6", "RECKONING 3.7"],
    },
    Mechanism {
        name: "predictor: constant acceleration",
        switch: Switch::Off(Feature::ConstantAcceleration),
        feature: None,
        code: &[
            "reckoning/src/predictor.rs#const ACCELERATION_TICKS, const ACCELERATION_LIMIT, const ACCELERATION_EXPONENT_MAX, const STEP, struct ConstantAcceleration, impl ConstantAcceleration, fn step",
            "protocol/src/packet/keyframe.rs#fn write_acceleration, fn read_acceleration, fn numbers_of_acceleration",
            "protocol/src/stream/mode_decision/candidates.rs#const ACCELERATIONS, const EQUAL_WITHIN, const WORTHWHILE_TICKS, const STEPS_MIN, fn accelerations, fn acceleration",
        ],
        requirements: &[
            "RECKONING 3.9",
            "PROTOCOL 5.5-3",
            "PROTOCOL 5.6-16",
            "PROTOCOL 5.6-17",
        ],
    },
    Mechanism {
        name: "attached bodies",
        switch: Switch::Off(Feature::Attached),
        feature: None,
        code: &[
            "reckoning/src/motion.rs#fn attached_motion, fn relative_to",
            "protocol/src/stream/publisher/body_check.rs#const PARENT_CANDIDATES_MAX, const PARENT_SIZE_RATIO, const PARENT_REACH, struct LargeBody, struct ObservedParent, struct ParentCandidates, impl ParentCandidates, struct ChildCounts, impl ChildCounts",
            "protocol/src/stream/publisher/scan.rs#fn collect_other_parents",
            "protocol/src/packet/payload.rs#fn write_parent, fn read_parent_age",
        ],
        requirements: &[
            "RECKONING 3.8",
            "PROTOCOL 5.6-13",
            "PROTOCOL 5.6-14",
            "PROTOCOL 5.6-15",
            "PROTOCOL 6.2-3",
            "PROTOCOL 6.3-13",
        ],
    },
    Mechanism {
        name: "velocities derived from corrections",
        switch: Switch::Off(Feature::Derived),
        feature: None,
        code: &["reckoning/src/predictor.rs#fn divergence_time"],
        requirements: &["RECKONING 4.4-6", "PROTOCOL 6.2-5"],
    },
    Mechanism {
        name: "sparse corrections",
        switch: Switch::Off(Feature::Sparse),
        feature: None,
        code: &["protocol/src/stream/mode_decision/candidates.rs#fn leave_out_steps"],
        requirements: &[],
    },
    Mechanism {
        name: "coarse velocities",
        switch: Switch::Off(Feature::Coarse),
        feature: None,
        code: &[
            "protocol/src/stream/mod.rs#fn steps",
            "protocol/src/stream/mode_decision/candidates.rs#const VELOCITY_EXPONENTS",
        ],
        requirements: &["PROTOCOL 5.6-8", "RECKONING 4.4-3"],
    },
    Mechanism {
        name: "lookahead",
        switch: Switch::Lookahead,
        feature: Some("lookahead"),
        code: &[
            "protocol/src/stream/observation_history.rs#struct ObservedTicks, impl<'h> ObservedTicks<'h>, struct ObservationWindow, struct Ahead, impl<'h> ObservationWindow<'h>, impl Ahead, fn linear",
        ],
        requirements: &["PROTOCOL 6.3-1", "PROTOCOL 6.3-6", "PROTOCOL 6.4-6"],
    },
    Mechanism {
        name: "mode decision with lookahead",
        switch: Switch::OffWithLookahead(Feature::ModeDecision),
        feature: Some("lookahead"),
        code: &[
            "protocol/src/stream/mode_decision/mod.rs#const FITS, const LINES, fn refined, fn best_of, const SHORTLIST, struct Choice, struct BestCorrections, impl BestCorrections",
        ],
        requirements: &[],
    },
    Mechanism {
        name: "corrections of predictions",
        switch: Switch::Off(Feature::Residuals),
        feature: None,
        code: &[
            "reckoning/src/quantiser.rs",
            "protocol/src/packet/payload.rs#fn numbers, fn each_of_place, fn each_of_velocity, fn each, fn read_residual",
        ],
        requirements: &["RECKONING 4.4", "PROTOCOL 5.6-9", "PROTOCOL 5.6-10"],
    },
    Mechanism {
        name: "rest corrections",
        switch: Switch::Off(Feature::RestCorrections),
        feature: None,
        code: &[
            "reckoning/src/track.rs#struct RestCorrection, const REACH, impl RestCorrection, fn greatest, fn greatest_of, fn rank, fn steps, fn stepped",
            "protocol/src/packet/payload.rs#const REST_STEPS, const LENGTHS, fn resting, fn length, fn rest_step, fn read_rest_correction",
            "protocol/src/stream/publisher/body_check.rs#fn rest_payload",
            "protocol/src/stream/tracks/applying.rs#fn resting",
        ],
        requirements: &["RECKONING 4.7", "PROTOCOL 5.6-12", "PROTOCOL 6.2-7"],
    },
    Mechanism {
        name: "updates only beyond the tolerance",
        switch: Switch::Off(Feature::Prefilter),
        feature: None,
        code: &[
            "reckoning/src/prefilter.rs",
            "protocol/src/stream/publisher/scan.rs#fn scan",
        ],
        requirements: &["PROTOCOL 6.3-7"],
    },
    Mechanism {
        name: "aliases",
        switch: Switch::Off(Feature::Aliases),
        feature: None,
        code: &["protocol/src/stream/aliases.rs"],
        requirements: &["PROTOCOL 6.13", "PROTOCOL 5.6-2"],
    },
    Mechanism {
        name: "several updates in a packet",
        switch: Switch::Off(Feature::Packing),
        feature: None,
        code: &[
            "protocol/src/stream/publisher/packer.rs#fn pack, fn pack_groups, const SPARSE_ALIASES, fn bits_of, fn middle, fn sort_by_alias, fn sort_parents_first, fn sort_by_keys",
        ],
        requirements: &["PROTOCOL 5.9"],
    },
    Mechanism {
        name: "range coder and contexts",
        switch: Switch::Off(Feature::Coder),
        feature: None,
        code: &[
            "protocol/src/wire/range.rs",
            "protocol/src/packet/model.rs",
            "protocol/src/packet/tables.rs",
        ],
        requirements: &["PROTOCOL 5.3", "PROTOCOL 5.4"],
    },
    Mechanism {
        name: "repair symbols",
        switch: Switch::Off(Feature::Fec),
        feature: None,
        code: &[
            "protocol/src/stream/fec.rs",
            "protocol/src/stream/mod.rs#const HALVED, const ANSWERED, struct LossRate, impl LossRate, enum Redundancy, impl Redundancy, fn beyond",
            "protocol/src/stream/subscriber/reading.rs#fn keep, fn read_repair_symbol, fn rebuild, fn read_rebuilt, fn read_again_after, fn packet_in",
            "protocol/src/packet/recovery.rs#const REPAIR_SYMBOL_HEAD_BYTES_MAX, const SOURCE_SYMBOL_HEAD_BYTES, const SOURCE_SYMBOL_BYTES_MAX, struct RepairSymbol, impl RepairSymbol, fn source_symbol_of, fn source_symbol_into, fn packet_of, fn without_zeros, const POLYNOMIAL, struct GaloisTables, const POWERS, fn powers, fn times, fn inverse, fn add_times",
        ],
        requirements: &["PROTOCOL 5.16", "PROTOCOL 6.15"],
    },
    Mechanism {
        name: "repair symbols without a request",
        switch: Switch::Off(Feature::UnsolicitedFec),
        feature: None,
        code: &[
            "protocol/src/stream/losses.rs#const WINDOW, const BEFORE, const PRIOR, const RECEIVERS_PER_EXCEPTION, const RECEIVERS_MAX, struct ReceiverLosses, struct LossSample, struct LossTracker, impl LossTracker, impl ReceiverLosses",
            "protocol/src/stream/fec.rs#fn end_tick",
        ],
        requirements: &["PROTOCOL 6.15-12", "PROTOCOL 6.15-13", "PROTOCOL 6.15-14"],
    },
    Mechanism {
        name: "large ticks in two packets",
        switch: Switch::Off(Feature::SplitTicks),
        feature: None,
        code: &["protocol/src/stream/publisher/packer.rs#fn pack_halves, fn middle"],
        requirements: &[],
    },
    Mechanism {
        name: "state checksums",
        switch: Switch::Off(Feature::Checksums),
        feature: Some("detected faults"),
        code: &[
            "protocol/src/stream/state_checksum.rs",
            "protocol/src/packet/recovery.rs#struct Checksums, impl Checksums",
        ],
        requirements: &["PROTOCOL 5.14", "PROTOCOL 6.12"],
    },
    Mechanism {
        name: "watermarks",
        switch: Switch::Fixed,
        feature: Some("the promise"),
        code: &[
            "protocol/src/stream/mod.rs#struct WatermarkPolicy, impl WatermarkPolicy, struct Silence, impl Silence, fn whole_ticks, fn second",
        ],
        requirements: &["PROTOCOL 5.10", "PROTOCOL 6.4"],
    },
    Mechanism {
        name: "loss reports and refreshes",
        switch: Switch::Fixed,
        feature: Some("the promise"),
        code: &[
            "protocol/src/stream/gaps.rs#struct Missing, struct RefreshId, struct Unread, enum Arrival, struct OwnArrivals, impl OwnArrivals, enum PacketArrival, struct PacketGaps, impl PacketGaps",
            "protocol/src/stream/receiver.rs#const DISORDER, const WAIT_MOST, struct NackScheduler, impl NackScheduler, struct RetryTimer, impl RetryTimer",
            "protocol/src/stream/losses.rs#const REPORT_PAUSE, struct ReplyLimiter, struct Answered, impl ReplyLimiter, fn is_due, struct SentPackets, impl SentPackets",
            "protocol/src/stream/publisher/packer.rs#fn refresh",
            "protocol/src/packet/recovery.rs#const GAP_ORDER, const ALIAS_ORDER, const AGE_ORDER, struct RefreshRecord, struct Refresh, impl Refresh, const HEAD_BYTES_MAX, struct RefreshWriter, impl Default for RefreshWriter, impl RefreshWriter, struct LossReport, impl LossReport",
        ],
        requirements: &[
            "PROTOCOL 5.11",
            "PROTOCOL 5.13",
            "PROTOCOL 6.6",
            "PROTOCOL 6.7",
        ],
    },
    Mechanism {
        name: "bound of each body",
        switch: Switch::Fixed,
        feature: Some("the promise"),
        code: &[
            "protocol/src/stream/subscriber.rs#enum ErrorBound, impl ErrorBound, impl fmt::Display for ErrorBound",
            "protocol/src/stream/subscriber/lifetimes.rs#struct EarlierTracks, struct Body, struct Node, struct EarlierTrack, const EARLIER_TRACKS_MAX, impl EarlierTracks, const SURE",
        ],
        requirements: &["PROTOCOL 6.8"],
    },
    Mechanism {
        name: "tolerance scales",
        switch: Switch::Fixed,
        feature: Some("tolerance scales"),
        code: &["reckoning/src/tolerance.rs#struct ToleranceScale, impl ToleranceScale"],
        requirements: &["RECKONING 4.1-3"],
    },
    Mechanism {
        name: "budgets",
        switch: Switch::Fixed,
        feature: Some("budgets"),
        code: &[
            "protocol/src/stream/mod.rs#struct Budget, impl Budget, impl Wire for Budget, struct TokenBucket, const BILLION, impl TokenBucket",
            "protocol/src/stream/publisher/update_queue.rs",
            "protocol/src/stream/gaps.rs#struct ErrorScaleLog, const KEPT, impl ErrorScaleLog",
            "protocol/src/packet/header.rs#struct ErrorScale, impl ErrorScale",
        ],
        requirements: &["PROTOCOL 5.17", "PROTOCOL 6.16"],
    },
    Mechanism {
        name: "tiers",
        switch: Switch::Fixed,
        feature: Some("tiers"),
        code: &["server/src/tier_controller.rs"],
        requirements: &["PROTOCOL 4.12"],
    },
    Mechanism {
        name: "authority and upstreams",
        switch: Switch::Fixed,
        feature: Some("upstreams"),
        code: &[
            "protocol/src/session/upstream.rs",
            "protocol/src/session/client/upstream.rs",
            "protocol/src/message/request.rs#struct TakeAuthority, struct AuthorityGrant, enum AuthorityError, impl AuthorityGrant, impl AuthorityError, impl fmt::Display for AuthorityError, impl core::error::Error for AuthorityError, fn decode_count, fn encode_bodies, fn decode_bodies, impl Wire for TakeAuthority, impl Wire for AuthorityGrant, impl Wire for AuthorityError",
            "server/src/member.rs#struct UpstreamStatistics, impl UpstreamStatistics, struct AuthorityGroup, struct UpstreamSilence, const LATE_KEPT, impl AuthorityGroup, fn is_from_publisher",
            "server/src/clients.rs#struct AuthorityTable, impl AuthorityTable",
            "server/src/scene_loop/commands.rs#fn handle_upstream_message, fn handle_upstream_datagram, fn handle_upstream, fn grant_authority, fn begin_authority, fn upstream_statistics",
        ],
        requirements: &["PROTOCOL 4.11", "PROTOCOL 6.14"],
    },
    Mechanism {
        name: "full stream",
        switch: Switch::Fixed,
        feature: Some("full streams"),
        code: &[
            "protocol/src/stream/sender.rs#struct FullBody, struct FullPublisher, impl FullPublisher",
            "protocol/src/packet/update.rs#const FULL_RECORD_BYTES, const FULL_HEAD_BYTES_MAX, struct FullRecord, impl FullRecord, struct FullPacket, impl FullPacket",
        ],
        requirements: &["PROTOCOL 5.12", "PROTOCOL 6.10"],
    },
];

/// A checkout of the sources.
#[derive(Debug)]
pub(super) struct Checkout {
    root: PathBuf,
    /// Ids of requirements, such as `6.15-1`, by document.
    requirements: BTreeMap<&'static str, BTreeSet<String>>,
}

/// The documents with requirements.
const DOCUMENTS: [&str; 2] = ["PROTOCOL", "RECKONING"];

impl Checkout {
    /// Reads the requirements.
    pub(super) fn open(root: &Path) -> Result<Self, Failure> {
        let mut requirements = BTreeMap::new();
        for document in DOCUMENTS {
            let path = root.join(format!("spec/{document}.md"));
            let text = fs::read_to_string(&path).map_err(|cause| {
                format!(
                    "lines and requirements are counted in a checkout of the sources, but {} cannot be read: {cause}; \
                     name the checkout by --checkout",
                    path.display()
                )
            })?;
            requirements.insert(document, ids(&text));
        }
        Ok(Self {
            root: root.to_owned(),
            requirements,
        })
    }

    /// Requirements of a clause, such as `PROTOCOL 6.15`, or a single one, such as `PROTOCOL 6.15-1`.
    pub(super) fn requirements(&self, cited: &str) -> Result<u64, Failure> {
        let unknown = || format!("the checkout has no requirement {cited}");
        let (document, clause) = cited.split_once(' ').ok_or_else(unknown)?;
        let known = self.requirements.get(document).ok_or_else(unknown)?;
        let within = |id: &&String| {
            *id == clause
                || id
                    .strip_prefix(clause)
                    .is_some_and(|rest| rest.starts_with('-'))
        };
        match known.iter().filter(within).count() {
            0 => Err(unknown().into()),
            count => Ok(count as u64),
        }
    }

    /// Lines of code at a place: a file, a folder that ends with `/`, or `FILE#ITEM, ITEM` for items of a file, such as
    /// `src/a.rs#fn decode, struct A, impl A`. Tests, comments and blank lines do not count.
    pub(super) fn lines(&self, place: &str) -> Result<u64, Failure> {
        let (file, items) = match place.split_once('#') {
            Some((file, items)) => (file, Some(items)),
            None => (place, None),
        };
        let path = self.root.join(file);
        if file.ends_with('/') {
            return lines_below(&path);
        }
        let text = read(&path)?;
        let code = without_tests(&text);
        let Some(items) = items else {
            return Ok(code_lines(code.lines()));
        };
        let lines = |item: &str| {
            let lines = item_lines(code, item);
            Ok(lines.ok_or_else(|| format!("the checkout has no {file}#{item}"))?)
        };
        items.split(", ").map(lines).sum()
    }
}

fn read(path: &Path) -> Result<String, Failure> {
    let text = fs::read_to_string(path);
    Ok(text.map_err(|cause| format!("cannot read {}: {cause}", path.display()))?)
}

fn lines_below(folder: &Path) -> Result<u64, Failure> {
    let wrong = |cause: std::io::Error| format!("cannot read {}: {cause}", folder.display());
    let mut lines = 0;
    for entry in fs::read_dir(folder).map_err(wrong)? {
        let path = entry.map_err(wrong)?.path();
        if path.is_dir() {
            lines += lines_below(&path)?;
        } else if path.extension().is_some_and(|name| name == "rs") {
            lines += code_lines(without_tests(&read(&path)?).lines());
        }
    }
    Ok(lines)
}

/// Every bracketed id, such as `[6.15-1]`.
fn ids(text: &str) -> BTreeSet<String> {
    let inside = text.split('[').skip(1);
    let inside = inside.filter_map(|after| Some(after.split_once(']')?.0));
    let is_id = |text: &&str| {
        let parts = text.split_once('-').map(|(clause, number)| {
            let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
            clause.contains('.') && clause.split('.').all(digits) && digits(number)
        });
        parts == Some(true)
    };
    inside.filter(is_id).map(str::to_owned).collect()
}

/// The text before the module of unit tests.
fn without_tests(text: &str) -> &str {
    text.split_once("\n#[cfg(test)]\n")
        .map_or(text, |(code, _)| code)
}

fn code_lines<'a>(lines: impl Iterator<Item = &'a str>) -> u64 {
    let is_code = |line: &&str| {
        let line = line.trim_start();
        !line.is_empty() && !line.starts_with("//")
    };
    lines.filter(is_code).count() as u64
}

/// Lines of an item, from its first line to the brace or semicolon that ends it.
fn item_lines(code: &str, item: &str) -> Option<u64> {
    let opens = |line: &&str| {
        let is_code = !line.trim_start().starts_with("//");
        let follows = line.split_once(item).map(|(_, rest)| rest.chars().next());
        let ends = follows.map(|next| next.is_none_or(|c| !(c.is_alphanumeric() || c == '_')));
        is_code && ends == Some(true)
    };
    let from = code.lines().position(|line| opens(&line))?;
    let mut lines = code.lines().skip(from);
    let first = lines.clone().next()?;
    if first.ends_with(';') || first.ends_with('}') {
        return Some(1);
    }
    let indent = first.len() - first.trim_start().len();
    let closes = |line: &str| {
        let ends = ["}", "]", ")"]
            .iter()
            .any(|close| line.trim_start().starts_with(close));
        let finished = line.ends_with('}') || line.ends_with(';');
        line.len() - line.trim_start().len() == indent && ends && finished
    };
    let mut all = Vec::new();
    for line in lines.by_ref() {
        all.push(line);
        if all.len() > 1 && closes(line) {
            return Some(code_lines(all.into_iter()));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    #[test]
    fn every_mechanism_names_code_and_requirements_that_exist() {
        let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        let checkout = Checkout::open(root).unwrap();
        for mechanism in MECHANISMS {
            for place in mechanism.code {
                assert!(checkout.lines(place).unwrap() > 0, "{place}");
            }
            for cited in mechanism.requirements {
                assert!(checkout.requirements(cited).unwrap() > 0, "{cited}");
            }
        }
    }

    #[test]
    fn every_feature_that_can_be_switched_off_has_a_row() {
        for feature in Feature::ALL {
            let switches = |mechanism: &Mechanism| match mechanism.switch {
                Switch::Off(of) | Switch::OffWithLookahead(of) => of == feature,
                Switch::Lookahead | Switch::Fixed => false,
            };
            assert!(MECHANISMS.iter().any(switches), "{}", feature.name());
        }
    }

    const CODE: &str = "\
//! A file.

/// The fn decode_all is not this one.
fn decode(
    text: &str,
) -> u32 {
    // The reason.
    if text.is_empty() {
        1
    } else {
        2
    }
}

const STEPS: [u32; 2] = [
    1, 2,
];
const ONE: u32 = 1;

#[cfg(test)]
mod tests {
    fn decode() {}
}
";

    #[test]
    fn an_item_counts_from_its_first_line_to_its_end() {
        let code = without_tests(CODE);
        for (item, lines) in [
            ("fn decode", Some(9)),
            ("const STEPS", Some(3)),
            ("const ONE", Some(1)),
            ("fn decode_all", None),
            ("mod tests", None),
        ] {
            assert_eq!(item_lines(code, item), lines, "{item}");
        }
        assert_eq!(code_lines(code.lines()), 13);
    }

    #[test]
    fn ids_are_found_in_brackets_only() {
        let found = ids("[6.15-1] One (6.15-2). [6.2-10] Two [a-1] and [2.5].");
        assert_eq!(found.into_iter().collect::<Vec<_>>(), ["6.15-1", "6.2-10"]);
    }

    #[test]
    fn a_clause_counts_its_own_requirements_only() {
        let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        let checkout = Checkout::open(root).unwrap();
        let count = |cited: &str| checkout.requirements(cited).ok();
        assert_eq!(count("PROTOCOL 6.1-1"), Some(1));
        let clause = count("PROTOCOL 6.1").unwrap();
        assert!(count("PROTOCOL 6.15").unwrap() > clause && clause > 1);
        assert_eq!(count(&format!("PROTOCOL 6.{}", 99)), None);
        assert_eq!(count("APP 1.1"), None);
    }

    #[test]
    fn a_folder_without_the_documents_is_no_checkout() {
        let error = Checkout::open(&std::env::temp_dir()).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("--checkout") && message.contains("PROTOCOL.md"));
    }
}
