//! What the listeners of a stream lose, and how much redundancy that is worth.
//!
//! Counts of packets only: how long anything took is not known here, so that a slow link is never taken for a lossy one.

use alloc::collections::BTreeMap;

use super::redundancy::{Loss, Redundancy};
use crate::packet::{Echo, Low16};

/// A loss is that of the last packets, of at least so many if there were.
const WINDOW: u64 = 256;
/// What is believed before anything was heard: one packet lost of so many.
const PRIOR: u64 = 32;
/// So many listeners, one more each time, may lose more than what the stream is made for.
const SPARED: usize = 16;

/// One listener, by what its echoes said.
#[derive(Clone, Copy, Debug)]
struct Account {
    /// Where counting began.
    since: Point,
    /// A later point, at which it will begin when it has become old enough.
    middle: Point,
    newest: Point,
}

/// A moment of a stream at a listener.
#[derive(Clone, Copy, Debug)]
struct Point {
    /// Packets that were sent up to it.
    sent: u64,
    /// Packets that were heard.
    heard: u64,
}

/// What the listeners of one stream lose.
#[derive(Clone, Debug, Default)]
pub struct Losses {
    accounts: BTreeMap<u64, Account>,
    redundancy: Redundancy,
}

impl Losses {
    /// A listener begins to hear the stream; its next packet is number `next`.
    pub fn begin(&mut self, listener: u64, next: u64) {
        let point = Point {
            sent: next,
            heard: 0,
        };
        let account = Account {
            since: point,
            middle: point,
            newest: point,
        };
        self.accounts.insert(listener, account);
    }

    /// A listener hears it no more.
    pub fn end(&mut self, listener: u64) {
        self.accounts.remove(&listener);
    }

    /// A listener said how far it heard of a stream whose next packet is number `next`. What it cannot have heard is not
    /// believed.
    pub fn hear(&mut self, listener: u64, echo: &Echo, next: u64) {
        let Some(account) = self.accounts.get_mut(&listener) else {
            return;
        };
        let before = account.newest;
        let sent = echo.next.expand(next);
        let heard = Low16(echo.heard.0).expand(before.heard);
        if sent > next || sent < before.sent || heard < before.heard || heard - before.heard > sent - before.sent + WINDOW {
            return;
        }
        account.newest = Point { sent, heard };
        if sent - account.middle.sent >= WINDOW {
            account.since = account.middle;
            account.middle = account.newest;
        }
    }

    /// How much redundancy a stream is worth whose next packet is number `next`.
    pub fn redundancy(&mut self, next: u64) -> Redundancy {
        let mut losses: alloc::vec::Vec<Loss> =
            self.accounts.values().map(|account| account.loss(next)).collect();
        losses.sort_unstable();
        let spared = losses.len().saturating_sub(1) / SPARED;
        let worst = losses.iter().rev().nth(spared).copied().unwrap_or_default();
        self.redundancy = self.redundancy.for_loss(worst);
        self.redundancy
    }
}

impl Account {
    /// What was lost since counting began, of all that was sent since: who says nothing lost nothing.
    fn loss(&self, next: u64) -> Loss {
        let silent = next.saturating_sub(self.newest.sent);
        let since = if silent >= 2 * WINDOW { return Loss(0) } else { self.since };
        let sent = self.newest.sent - since.sent;
        let lost = sent.saturating_sub(self.newest.heard - since.heard);
        if lost == 0 {
            return Loss(0);
        }
        let share = (lost + 1) * 1_000_000 / (sent + silent + PRIOR);
        Loss(share.min(1_000_000) as u32)
    }
}
