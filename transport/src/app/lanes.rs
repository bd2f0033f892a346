//! Datagrams that wait to be sent: a lane for each address, in turn.
//!
//! Sends nothing and reads no clock. Each address has a pace of its own, so that who is told much holds nobody up. What
//! waits for one is bounded: for what is too much the oldest of the same address goes, which newer ones supersede.

use core::net::SocketAddr;
use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use tokio::time::Instant;

use super::pace::{self, Pace};
use crate::piece::PIECE_COST_BYTES;

/// What waits, for anybody.
#[derive(Debug)]
pub(super) struct Lanes {
    lanes: BTreeMap<SocketAddr, Lane>,
    /// The address of each lane, once: who has its turn next is in front.
    turns: VecDeque<SocketAddr>,
    /// Of each lane; none: as fast as they come.
    datagrams_per_ms: Option<u32>,
}

/// What waits for one address. It stays as long as its pace remembers something.
#[derive(Debug)]
struct Lane {
    waiting: VecDeque<Bytes>,
    waiting_bytes: usize,
    pace: Option<Pace>,
}

/// What came of one more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Pushed {
    /// Whether nothing waited for its address.
    pub(super) is_first: bool,
    /// How many older ones of its address had to go.
    pub(super) dropped: usize,
}

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// Send this.
    Datagram(SocketAddr, Bytes),
    /// Something waits, and nothing of it may leave before.
    NotBefore(Instant),
    Nothing,
}

/// Bytes that may wait for one address: a frame of ten thousand bodies, and more.
const LANE_BYTES_MAX: usize = 2 << 20;

impl Lanes {
    pub(super) const fn new(datagrams_per_ms: Option<u32>) -> Self {
        Self {
            lanes: BTreeMap::new(),
            turns: VecDeque::new(),
            datagrams_per_ms,
        }
    }

    /// Appends one to the lane of its address.
    pub(super) fn push(&mut self, to: SocketAddr, bytes: Bytes) -> Pushed {
        let lane = self.lanes.entry(to).or_insert_with(|| {
            self.turns.push_back(to);
            Lane {
                waiting: VecDeque::new(),
                waiting_bytes: 0,
                pace: self.datagrams_per_ms.map(pace::of_datagrams),
            }
        });
        let is_first = lane.waiting.is_empty();
        let dropped = lane.push(bytes);
        Pushed { is_first, dropped }
    }

    /// Takes the next one that may leave now.
    pub(super) fn take(&mut self, now: Instant) -> Next {
        let mut soonest: Option<Instant> = None;
        for _ in 0..self.turns.len() {
            let Some(to) = self.turns.pop_front() else {
                break;
            };
            let Some(lane) = self.lanes.get_mut(&to) else {
                continue;
            };
            if lane.is_over(now) {
                self.lanes.remove(&to);
                continue;
            }
            self.turns.push_back(to);
            match lane.take(now) {
                Ok(Some(bytes)) => return Next::Datagram(to, bytes),
                Ok(None) => {}
                Err(at) => soonest = Some(soonest.map_or(at, |soonest| soonest.min(at))),
            }
        }
        soonest.map_or(Next::Nothing, Next::NotBefore)
    }
}

impl Lane {
    /// Appends one, and says how many had to go for it.
    fn push(&mut self, bytes: Bytes) -> usize {
        self.waiting_bytes += cost(&bytes);
        let mut dropped = 0;
        while self.waiting_bytes > LANE_BYTES_MAX
            && let Some(oldest) = self.waiting.pop_front()
        {
            self.waiting_bytes -= cost(&oldest);
            dropped += 1;
        }
        self.waiting.push_back(bytes);
        dropped
    }

    /// The oldest, if any waits, or the moment from which on it may leave.
    fn take(&mut self, now: Instant) -> Result<Option<Bytes>, Instant> {
        if self.waiting.is_empty() {
            return Ok(None);
        }
        if let Some(pace) = &mut self.pace {
            pace.try_spend(now, 1)?;
        }
        let oldest = self.waiting.pop_front();
        self.waiting_bytes -= oldest.as_ref().map_or(0, cost);
        Ok(oldest)
    }

    /// Whether it is as one that never was.
    fn is_over(&self, now: Instant) -> bool {
        self.waiting.is_empty() && self.pace.as_ref().is_none_or(|pace| pace.is_over(now))
    }
}

fn cost(bytes: &Bytes) -> usize {
    bytes.len() + PIECE_COST_BYTES
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    fn address(port: u16) -> SocketAddr {
        SocketAddr::from(([127, 0, 0, 1], port))
    }

    fn datagram(number: usize) -> Bytes {
        Bytes::copy_from_slice(&number.to_be_bytes())
    }

    #[test]
    fn who_waits_has_its_turn_whatever_waits_for_others() {
        let mut lanes = Lanes::new(None);
        for number in 0..100 {
            lanes.push(address(1), datagram(number));
        }
        lanes.push(address(2), datagram(0));
        lanes.push(address(3), datagram(0));
        let now = Instant::now();
        let first: Vec<_> = (0..4).map(|_| lanes.take(now)).collect();
        let of = |port, number| Next::Datagram(address(port), datagram(number));
        assert_eq!(first, [of(1, 0), of(2, 0), of(3, 0), of(1, 1)]);
    }

    #[test]
    fn a_full_lane_drops_its_own_oldest() {
        let mut lanes = Lanes::new(Some(1));
        lanes.push(address(2), datagram(7));
        let fit = LANE_BYTES_MAX / cost(&datagram(0));
        let pushed = (0..fit + 3).map(|number| lanes.push(address(1), datagram(number)));
        assert_eq!(pushed.map(|pushed| pushed.dropped).sum::<usize>(), 3);
        let now = Instant::now();
        assert_eq!(lanes.take(now), Next::Datagram(address(2), datagram(7)));
        assert_eq!(lanes.take(now), Next::Datagram(address(1), datagram(3)));
    }

    #[test]
    fn an_address_is_forgotten_when_nothing_waits_and_its_pace_is_over() {
        let mut lanes = Lanes::new(Some(1));
        let now = Instant::now();
        let pushed = lanes.push(address(1), datagram(0));
        assert!(pushed.is_first);
        assert_eq!(lanes.take(now), Next::Datagram(address(1), datagram(0)));
        assert_eq!(lanes.take(now), Next::Nothing);
        assert!(lanes.push(address(1), datagram(1)).is_first);
        let later = now + Duration::from_millis(1);
        assert_eq!(lanes.take(now), Next::NotBefore(later));
        assert_eq!(lanes.take(later), Next::Datagram(address(1), datagram(1)));
        let latest = later + Duration::from_millis(1);
        assert_eq!(lanes.take(latest), Next::Nothing);
        assert!(lanes.lanes.is_empty() && lanes.turns.is_empty());
    }
}
