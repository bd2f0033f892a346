//! The bodies of recently sent packets, for refreshes of lost ones.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use crate::limits::HISTORY_PACKETS;

/// Numbers packets and keeps the bodies of the newest ones.
#[derive(Clone, Debug, Default)]
pub(crate) struct SentPackets {
    next: u64,
    /// The bodies of the packets before `next`, oldest first.
    packets: VecDeque<Vec<u32>>,
}

impl SentPackets {
    /// The number of the next packet.
    pub(crate) const fn next(&self) -> u64 {
        self.next
    }

    /// Adds the next packet with its bodies, in rising order.
    pub(crate) fn record(&mut self, bodies: impl Iterator<Item = u32>) {
        let mut entry = if self.packets.len() == HISTORY_PACKETS {
            self.packets.pop_front().unwrap_or_default()
        } else {
            Vec::new()
        };
        entry.clear();
        entry.extend(bodies);
        self.packets.push_back(entry);
        self.next += 1;
    }

    /// The bodies of a packet; `None` if it was never sent or is no longer kept.
    pub(crate) fn bodies(&self, number: u64) -> Option<&[u32]> {
        let age = self.next.checked_sub(number)?;
        let place = (self.packets.len() as u64).checked_sub(age)?;
        self.packets.get(place as usize).map(Vec::as_slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_newest_packets_are_kept() {
        let mut sent_packets = SentPackets::default();
        let sent = HISTORY_PACKETS as u64 + 10;
        for number in 0..sent {
            assert_eq!(sent_packets.next(), number);
            sent_packets.record([number as u32].into_iter());
        }
        assert_eq!(sent_packets.bodies(9), None);
        assert_eq!(sent_packets.bodies(10), Some(&[10][..]));
        assert_eq!(sent_packets.bodies(sent - 1), Some(&[sent as u32 - 1][..]));
        assert_eq!(sent_packets.bodies(sent), None);
    }
}
