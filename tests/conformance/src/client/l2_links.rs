//! L2.51: the copy stays correct whatever the network does to datagrams.

use std::collections::VecDeque;

use rhumb_protocol::packet::PacketKind;

use super::l2_stream::busy;
use crate::case::Case;
use crate::outcome::CaseResult;
use crate::peer::datagram::{is_packet, kind};
use crate::seed::Dice;
use crate::trial::Trial;

/// Maps a datagram to the datagrams that are delivered in its place.
type DatagramFilter = Box<dyn FnMut(Vec<u8>) -> Vec<Vec<u8>>>;

/// Number, name of the disturbance, requirements of PROTOCOL, and the disturbance itself.
type LinkRow = (u32, &'static str, &'static str, fn(Dice) -> DatagramFilter);

const LINKS: [LinkRow; 8] = [
    (
        1,
        "each fifth packet is lost",
        "6.6-2, 6.6-5, 6.7-1, 6.7-8, 6.6-14",
        each_fifth_lost,
    ),
    (
        2,
        "three in ten datagrams are lost",
        "6.7-1, 6.7-8, 6.6-6, 6.6-7, 6.6-8, 6.6-9, 6.13-6, 6.13-7, 6.13-11",
        three_in_ten_lost,
    ),
    (
        3,
        "datagrams are lost eight in a row",
        "6.6-2, 6.7-1, 6.7-8",
        eight_in_a_row_lost,
    ),
    (4, "each datagram comes twice", "6.6-4", |_| {
        Box::new(|bytes| vec![bytes.clone(), bytes])
    }),
    (
        5,
        "datagrams come in pairs in reversed order",
        "6.6-2, 6.6-3, 6.6-11",
        in_pairs,
    ),
    (
        6,
        "each datagram comes once in place, and again five datagrams later",
        "6.6-3, 6.6-4, 6.6-12, 6.2-2",
        late_and_again,
    ),
    (
        7,
        "the packets of every third tick come by refreshes only",
        "6.7-3, 6.7-8, 6.2-8, 5.11-1",
        each_third_refreshed,
    ),
    (
        8,
        "each second refresh is lost too",
        "6.7-1, 6.7-8",
        refreshes_lost_too,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    let case = |(number, what, cites, made): LinkRow| {
        let name = format!("a client's copy is bit-exact although {what}");
        Case::client(&format!("L2.51.{number}"), &name)
            .cites(&format!("PROTOCOL 6.1-2, 6.5-1, {cites}"))
            .play(move |trial| {
                let filter = made(trial.dice());
                over(trial, filter)
            })
    };
    LINKS.into_iter().map(case).collect()
}

/// A rotating drum over a link that is disturbed for a while, then ideal.
fn over(trial: &mut Trial<'_>, filter: DatagramFilter) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    interceptor.enter()?;
    interceptor.filter_datagrams(filter);
    interceptor.step(60)?;
    interceptor.stop_tampering();
    interceptor.step(3)?;
    interceptor.must_follow()
}

/// Drops the selected datagrams.
fn losing(mut is_lost: impl FnMut(&[u8]) -> bool + 'static) -> DatagramFilter {
    Box::new(move |bytes| if is_lost(&bytes) { vec![] } else { vec![bytes] })
}

fn each_fifth_lost(_: Dice) -> DatagramFilter {
    let mut count = 0;
    losing(move |bytes| {
        count += usize::from(is_packet(bytes));
        is_packet(bytes) && count % 5 == 0
    })
}

fn three_in_ten_lost(mut dice: Dice) -> DatagramFilter {
    losing(move |_| dice.below(10) < 3)
}

fn eight_in_a_row_lost(_: Dice) -> DatagramFilter {
    let mut count = 0;
    losing(move |_| {
        count += 1;
        count % 24 < 8
    })
}

fn in_pairs(_: Dice) -> DatagramFilter {
    let mut kept: Option<Vec<u8>> = None;
    Box::new(move |bytes| match kept.take() {
        Some(before) => vec![bytes, before],
        None => {
            kept = Some(bytes);
            vec![]
        }
    })
}

fn late_and_again(_: Dice) -> DatagramFilter {
    let mut late: VecDeque<Vec<u8>> = VecDeque::new();
    Box::new(move |bytes| {
        late.push_back(bytes.clone());
        let mut sent = if late.len().is_multiple_of(2) {
            vec![bytes]
        } else {
            vec![]
        };
        if late.len() > 5 {
            sent.extend(late.pop_front());
        }
        sent
    })
}

fn each_third_refreshed(_: Dice) -> DatagramFilter {
    let mut count = 0;
    losing(move |bytes| {
        count += usize::from(is_packet(bytes));
        match kind(bytes) {
            Some(PacketKind::RepairSymbol) => true,
            Some(PacketKind::Refresh) => false,
            _ => count % 3 == 1,
        }
    })
}

fn refreshes_lost_too(_: Dice) -> DatagramFilter {
    let (mut packets, mut refreshes) = (0, 0);
    losing(move |bytes| {
        let is_refresh = kind(bytes) == Some(PacketKind::Refresh);
        packets += usize::from(is_packet(bytes));
        refreshes += usize::from(is_refresh);
        if is_refresh {
            refreshes % 2 == 1
        } else {
            is_packet(bytes) && packets % 4 == 0
        }
    })
}
