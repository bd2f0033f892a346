//! The free rotation of bodies whose moments differ, as an engine steps it.
//!
//! Such a body's axis of spin wanders, so that no closed form of a few coefficients tells where it points: the
//! engine's own map is iterated (RECKONING 3.7). Nothing here knows where a body is. Invariant: a cursor changes what
//! an answer costs, never its bits.

use alloc::boxed::Box;

use glam::{DQuat, DVec3};

use crate::exact::{conjugate, dot3, normalised, product, scale3, sqrt, turned};
use crate::flow::FlowTerms;
use crate::inertia::Inertia;
use crate::tick::Ticks;

/// A rotation (body → world) and the angular velocity about world axes, rad/s.
pub(crate) type Spin = (DQuat, DVec3);

/// How far a tumbling was computed, so that asking tick by tick costs a step each and not all of them.
///
/// One cursor serves one body of one stream. It begins anew by itself when it is asked for another start or an
/// earlier tick; for laws that do not tumble it is not used.
#[derive(Clone, Debug, Default)]
pub struct Cursor {
    tumble: Option<Box<Tumble>>,
}

impl Cursor {
    /// The spin `elapsed` ticks after `start`: the bits of [`Tumble::after`].
    pub(crate) fn after(
        &mut self,
        start: Spin,
        elapsed: Ticks,
        inertia: &Inertia,
        terms: &FlowTerms,
    ) -> Spin {
        let reached = |tumble: &&mut Box<Tumble>| {
            tumble.elapsed <= elapsed.count() && tumble.begins_with(&start)
        };
        if let Some(tumble) = self.tumble.as_mut().filter(reached) {
            tumble.advance(elapsed, terms);
            return tumble.spin();
        }
        let mut tumble = Tumble::new(start, inertia, terms);
        tumble.advance(elapsed, terms);
        let spin = tumble.spin();
        match &mut self.tumble {
            Some(kept) => **kept = tumble,
            none => *none = Some(Box::new(tumble)),
        }
        spin
    }
}

/// A body on its way, seen from its principal axes: there a turn about the axis of spin does not change the spin.
#[derive(Clone, Debug)]
pub(crate) struct Tumble {
    start: Spin,
    elapsed: u32,
    /// Principal axes → world, of any length.
    axes: DQuat,
    /// Angular velocity about the principal axes, rad/s.
    angular: DVec3,
    moments: DVec3,
    /// What a substep takes off each component of the spin, per product of the two others: seconds.
    exchange: DVec3,
    /// Body → principal axes.
    frame: DQuat,
}

impl Tumble {
    pub(crate) fn new(start: Spin, inertia: &Inertia, terms: &FlowTerms) -> Self {
        let (rotation, angular) = start;
        let frame = inertia.unit_frame();
        let axes = normalised(product(rotation, frame));
        let m = inertia.wide_moments();
        let exchange = DVec3::new((m.z - m.y) / m.x, (m.x - m.z) / m.y, (m.y - m.x) / m.z);
        Self {
            start,
            elapsed: 0,
            axes,
            angular: turned(conjugate(axes), angular),
            moments: m,
            exchange: scale3(exchange, terms.substep),
            frame: conjugate(frame),
        }
    }

    /// The spin `elapsed` ticks after `start`, from the beginning.
    pub(crate) fn after(start: Spin, elapsed: Ticks, inertia: &Inertia, terms: &FlowTerms) -> Spin {
        let mut tumble = Self::new(start, inertia, terms);
        tumble.advance(elapsed, terms);
        tumble.spin()
    }

    /// Whether it began so, to the bit.
    fn begins_with(&self, start: &Spin) -> bool {
        let bits = |(rotation, angular): &Spin| {
            let ([x, y, z, w], [a, b, c]) = (rotation.to_array(), angular.to_array());
            [x, y, z, w, a, b, c].map(f64::to_bits)
        };
        bits(&self.start) == bits(start)
    }

    fn advance(&mut self, elapsed: Ticks, terms: &FlowTerms) {
        while self.elapsed < elapsed.count() {
            for _ in 0..terms.substep_count {
                self.substep(terms);
            }
            self.angular = scale3(self.angular, terms.angular_keep);
            self.elapsed += 1;
        }
    }

    /// One velocity step and one position step of the engine.
    fn substep(&mut self, terms: &FlowTerms) {
        let (w, e) = (self.angular, self.exchange);
        let bent = DVec3::new(
            w.x - e.x * (w.y * w.z),
            w.y - e.y * (w.z * w.x),
            w.z - e.z * (w.x * w.y),
        );
        let (before, after) = (self.momentum(w), self.momentum(bent));
        let (before, after) = (dot3(before, before), dot3(after, after));
        let mut w = if after == 0.0 {
            w
        } else {
            scale3(bent, sqrt(before / after))
        };
        let speed2 = dot3(w, w);
        if speed2 > terms.spin_most * terms.spin_most {
            w = scale3(w, terms.spin_most / sqrt(speed2));
        }
        let (a, t) = (self.axes, scale3(w, terms.half_substep));
        self.angular = w;
        self.axes = DQuat::from_xyzw(
            a.x + (a.w * t.x + a.y * t.z - a.z * t.y),
            a.y + (a.w * t.y - a.x * t.z + a.z * t.x),
            a.z + (a.w * t.z + a.x * t.y - a.y * t.x),
            a.w - (a.x * t.x + a.y * t.y + a.z * t.z),
        );
    }

    fn momentum(&self, w: DVec3) -> DVec3 {
        let m = self.moments;
        DVec3::new(m.x * w.x, m.y * w.y, m.z * w.z)
    }

    /// In the world's axes.
    fn spin(&self) -> Spin {
        let axes = normalised(self.axes);
        let rotation = normalised(product(axes, self.frame));
        (rotation, turned(axes, self.angular))
    }
}
