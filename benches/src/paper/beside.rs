//! What a simulator does beside physics.

use std::hint::spin_loop;

use rhumb_protocol::Span;
use rhumb_transport::Clock;

/// Works for so long, by the clock: takes its core, and leaves caches and memory alone.
pub(super) fn work(clock: &Clock, span: Span) {
    let end = clock.now() + span;
    while clock.now() < end {
        spin_loop();
    }
}

/// Leaves all cores to the servers for so long.
pub(super) fn pause(clock: &Clock, span: Span) {
    let end = clock.now() + span;
    // A parked thread may be woken early.
    while clock.now() < end {
        std::thread::park_timeout(clock.until(end));
    }
}
