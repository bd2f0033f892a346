//! Where to aim when a law does not know what pushes a body.
//!
//! A body that is pushed leaves its law ever faster. Put ahead of where it is, and said to be faster, it catches up first
//! and overtakes later, so that one saying holds up to 2.4 times as long.

use glam::DVec3;
use rhumb_reckoning::Predictor;

use super::{Aim, Chooser, Subject, Way};

/// A body is led where it leaves its law by the tolerance in fewer ticks than the first, and in more than the second.
const LEADING: [f64; 2] = [32.0, 1.0];
/// How far from a steady push its last two ticks may be, as a share of it.
const UNSTEADY: f64 = 0.1;
/// How far ahead a body is put that leaves its law ever faster, and by how much it may overtake, as shares of the
/// tolerance.
const LEADS: [(f64, f64); 4] = [(0.0, 0.5), (0.4, 0.0), (0.4, 0.3), (0.8, 0.0)];

impl Chooser<'_> {
    /// Where to aim by a law that does not know of a steady push: ahead of the body, and faster than it is, so that it
    /// catches up first and overtakes later.
    pub(super) fn leads(&self, subject: &Subject<'_>, way: &Way<'_>) -> [Option<Aim>; LEADS.len()] {
        let [line, square] = way.stray.linear;
        let curve = square.length();
        let tolerance = self.allowance(subject).position;
        let [least, most] = LEADING.map(|ticks| tolerance / (ticks * ticks));
        let integrator = self.tracks.integrator();
        // What is pushed steadily by an engine that steps so strays by α·h + β·h² with α = β / substeps.
        let steady = square / f64::from(integrator.substeps.get());
        let is_steady = line.distance(steady) < UNSTEADY * curve;
        if way.predictor == Predictor::Rest || !is_steady || !(curve > least && curve < most) {
            return [None; LEADS.len()];
        }
        let step = integrator.rate.step().seconds();
        LEADS.map(|(ahead, faster)| {
            let pace = 2.0 * libm::sqrt(tolerance * faster * curve) / step;
            Some(Aim {
                pose: [square * (tolerance * ahead / curve), DVec3::ZERO],
                linear: square * (pace / curve),
            })
        })
    }
}
