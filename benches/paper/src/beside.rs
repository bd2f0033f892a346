//! Simulated work of a caller besides physics.

use std::hint::spin_loop;

use rhumb_protocol::Span;
use rhumb_transport::Clock;

/// Spins for a span of wall-clock time: occupies the core, but not caches or memory.
pub(crate) fn work(clock: &Clock, span: Span) {
    let end = clock.now() + span;
    while clock.now() < end {
        spin_loop();
    }
}

/// Leaves all cores to the servers for a span.
pub(crate) fn pause(clock: &Clock, span: Span) {
    let end = clock.now() + span;
    // A parked thread may wake early.
    while clock.now() < end {
        std::thread::park_timeout(clock.until(end));
    }
}
