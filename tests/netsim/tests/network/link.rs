//! Simulated links follow their configuration and are repeatable.
//!
//! Thousands of packets per promise; bounds are five standard deviations or more, with fixed seeds.

use bytes::Bytes;
use proptest::prelude::*;
use rhumb_netsim::{Lane, Link, LinkConfig, Probability};
use rhumb_protocol::{Instant, Span};

const MS: u64 = 1_000_000;

fn at_ms(ms: u64) -> Instant {
    Instant::from_nanos(ms * MS)
}

fn numbered(number: u32) -> Bytes {
    Bytes::copy_from_slice(&number.to_be_bytes())
}

fn number_of(bytes: &Bytes) -> u32 {
    u32::from_be_bytes(bytes[..4].try_into().expect("four bytes"))
}

/// Pushes `count` numbered packets, one a millisecond, and returns all arrivals with their moments.
fn carry(config: LinkConfig, seed: u64, lane: Lane, count: u32) -> Vec<(u64, u32)> {
    let mut link = Link::new(config, seed);
    let mut arrived = Vec::new();
    for number in 0..count {
        let now = at_ms(number.into());
        take(&mut link, now, &mut arrived);
        link.push(now, numbered(number), lane);
    }
    take(&mut link, Instant::from_nanos(u64::MAX), &mut arrived);
    arrived
}

/// Advances the link through its own moments, up to now.
fn take(link: &mut Link, now: Instant, arrived: &mut Vec<(u64, u32)>) {
    while let Some(at) = link.next_at().filter(|&at| at <= now) {
        while let Some((_, bytes)) = link.pop(at) {
            arrived.push((at.as_nanos(), number_of(&bytes)));
        }
    }
}

fn config(text: &str) -> LinkConfig {
    text.parse().expect("good config")
}

fn numbers(arrived: &[(u64, u32)]) -> Vec<u32> {
    arrived.iter().map(|&(_, number)| number).collect()
}

#[test]
fn a_perfect_link_delivers_at_once() {
    let arrived = carry(LinkConfig::PERFECT, 1, Lane::State, 1_000);
    let expected: Vec<_> = (0..1_000)
        .map(|number| (u64::from(number) * MS, number))
        .collect();
    assert_eq!(arrived, expected);
}

#[test]
fn delay_is_half_a_round_trip() {
    let arrived = carry(config("rtt=100ms"), 1, Lane::State, 100);
    assert!(
        arrived
            .iter()
            .all(|&(at, number)| at == (u64::from(number) + 50) * MS)
    );
}

#[test]
fn jitter_stays_within_its_span_and_keeps_order() {
    let arrived = carry(config("delay=5ms,jitter=10ms"), 2, Lane::State, 10_000);
    assert!(arrived.is_sorted_by_key(|&(_, number)| number));
    let taken: Vec<_> = arrived
        .iter()
        .map(|&(at, number)| at - u64::from(number) * MS)
        .collect();
    assert!(taken.iter().all(|&ns| (5 * MS..=15 * MS).contains(&ns)));
    assert!(taken.iter().any(|&ns| ns < 10 * MS) && taken.iter().any(|&ns| ns > 14 * MS));
}

#[test]
fn even_and_bursty_loss_have_the_configured_share() {
    for (text, tolerance) in [
        ("loss=5%", 500),
        ("loss=5%,burst=3", 1_000),
        ("loss=50%", 1_200),
        ("loss=30%,burst=8", 3_500),
    ] {
        let config = config(text);
        let arrived = carry(config, 3, Lane::State, 100_000).len() as i64;
        let expected = 100_000 - i64::from(config.loss.as_millionths() / 10);
        assert!(
            (arrived - expected).abs() < tolerance,
            "{text}: {arrived} of {expected} arrived"
        );
    }
}

#[test]
fn bursts_have_the_configured_mean_length() {
    let arrived = carry(config("loss=5%,burst=6"), 4, Lane::State, 200_000);
    let gaps: Vec<_> = arrived
        .windows(2)
        .map(|pair| pair[1].1 - pair[0].1 - 1)
        .filter(|&gap| gap > 0)
        .collect();
    let mean = f64::from(gaps.iter().sum::<u32>()) / gaps.len() as f64;
    assert!((5.0..7.0).contains(&mean), "mean burst {mean}");
}

#[test]
fn total_loss_loses_all_state_and_delays_control() {
    let mut link = Link::new(config("loss=100%"), 5);
    link.push(Instant::ZERO, numbered(0), Lane::State);
    link.push(Instant::ZERO, numbered(1), Lane::Control);
    assert_eq!(link.pop(at_ms(5_000)), None);
    link.set_config(LinkConfig::PERFECT);
    assert_eq!(link.pop(at_ms(10_000)), Some((Lane::Control, numbered(1))));
    assert_eq!(link.next_at(), None);
}

#[test]
fn duplicates_have_the_configured_share() {
    let arrived = carry(config("dup=10%"), 6, Lane::State, 50_000).len();
    assert!((54_500..55_500).contains(&arrived), "{arrived}");
}

#[test]
fn reordered_packets_are_overtaken_but_not_lost() {
    let arrived = numbers(&carry(
        config("delay=10ms,reorder=10%"),
        7,
        Lane::State,
        10_000,
    ));
    assert_eq!(arrived.len(), 10_000);
    let overtaken = arrived.windows(2).filter(|pair| pair[1] < pair[0]).count();
    assert!((500..1_200).contains(&overtaken), "{overtaken}");
}

#[test]
fn the_rate_is_honoured_and_its_queue_bounded() {
    // 8,000 bytes a second; 100 packets of 100 bytes at once, of which the queue takes 50.
    let mut link = Link::new(config("rate=64kbit,queue=5kB"), 8);
    for _ in 0..100 {
        link.push(Instant::ZERO, Bytes::from(vec![0; 100]), Lane::State);
    }
    let mut arrivals = Vec::new();
    while let Some(at) = link.next_at() {
        while link.pop(at).is_some() {
            arrivals.push(at.as_nanos());
        }
    }
    assert_eq!(arrivals.len(), 50);
    assert_eq!(link.counts(Lane::State).overflowed.pieces, 50);
    assert!(
        arrivals
            .iter()
            .enumerate()
            .all(|(place, &at)| at == (place as u64 + 1) * 12_500_000)
    );
}

#[test]
fn the_counters_add_up() {
    let mut link = Link::new(config("loss=20%,dup=5%"), 9);
    for number in 0..1_000 {
        link.push(Instant::ZERO, numbered(number), Lane::State);
    }
    while link.pop(at_ms(1)).is_some() {}
    let counts = link.counts(Lane::State);
    assert_eq!((counts.pushed.pieces, counts.pushed.bytes), (1_000, 4_000));
    assert_eq!(
        counts.delivered.pieces,
        1_000 - counts.lost.pieces + counts.duplicated.pieces
    );
}

proptest! {
    #[test]
    fn the_control_lane_carries_everything_in_order(
        seed: u64, rtt in 0_u64..500, jitter in 0_u64..250, loss in 0_u32..=50, burst in 1_u32..20,
        reorder in 0_u32..=30, dup in 0_u32..=50,
    ) {
        let burst = burst.max(1);
        let config = LinkConfig {
            delay: Span::from_millis(rtt / 2),
            jitter: Span::from_millis(jitter),
            loss: Probability::from_percent(loss),
            burst,
            duplicates: Probability::from_percent(dup),
            reorder: Probability::from_percent(reorder),
            ..LinkConfig::PERFECT
        };
        let arrived = carry(config, seed, Lane::Control, 200);
        prop_assert_eq!(numbers(&arrived), (0..200).collect::<Vec<_>>());
        prop_assert!(arrived.is_sorted());
        prop_assert!(arrived.iter().all(|&(at, number)| at >= (u64::from(number) + rtt / 2) * MS));
    }

    #[test]
    fn the_same_seed_gives_the_same_run(seed: u64) {
        let config = config("rtt=80ms,loss=20%,burst=4,jitter=30ms,dup=10%,reorder=10%,rate=1mbit");
        for lane in [Lane::State, Lane::Control] {
            let first = carry(config, seed, lane, 300);
            prop_assert_eq!(&first, &carry(config, seed, lane, 300));
            prop_assert_ne!(&first, &carry(config, !seed, lane, 300));
        }
    }
}
