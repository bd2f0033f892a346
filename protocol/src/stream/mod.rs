//! The state stream: encoded once for all of its subscribers; its settings.
//!
//! Settings are data; the publisher and the subscriber act on them. Budget and watermarks count ticks of the scene
//! alone: they do not depend on links or receivers, and are the same in a lockstep scene. One rule for every stream's
//! silence: a watermark after the shortest silence, then each time the silence has doubled, and at most the longest
//! pause apart.

mod aliases;
mod fec;
mod gaps;
mod losses;
mod mode_decision;
mod observation_history;
mod publisher;
mod receiver;
mod sender;
mod state_checksum;
mod subscriber;
mod tracks;

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{Integrator, Rate, Tick, Ticks, Tolerance};

use crate::limits::{
    BUDGET_BURST_MAX, BUDGET_MAX, BUDGET_MIN, DATAGRAM_BYTES_MAX, SILENCE_MS_MAX,
    UPSTREAM_WATERMARK_MS,
};
use crate::packet::{LargestPacket, StreamId};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

pub use losses::{Recipient, RefreshReplies};
pub use observation_history::{Activity, LOOKAHEAD_MAX, Observation, ObservationHistory};
pub use publisher::{OverBudget, Publisher};
pub use receiver::StreamReceiver;
pub(crate) use receiver::{DISORDER, RetryTimer, SILENCE_MOST};
pub use sender::{RestingBodies, StreamSender};
pub use subscriber::{
    ErrorBound, FreeTrack, FreeTracksX4, Replacement, ShownTrack, Subscriber, SubscriberStatistics,
};
pub use tracks::PredictionParameters;

/// The config of a stream.
#[derive(Clone, Copy, Debug)]
pub struct StreamConfig {
    /// The tolerance of every body with the usual scale.
    pub tolerance: Tolerance,
    /// The integrator and rate of the scene.
    pub integrator: Integrator,
    /// The stream publishes at ticks that are multiples of this number.
    pub publish_interval: NonZeroU32,
    /// The present gravity, m/s², world frame.
    pub gravity: Vec3,
    /// The largest packet that the publisher makes.
    pub largest_packet: LargestPacket,
    /// The features that the publisher may use.
    pub features: Features,
}

impl StreamConfig {
    /// Sixty ticks a second, each published, without gravity: the config of unit tests.
    #[cfg(test)]
    const PLAIN: Self = Self {
        tolerance: Tolerance::NORMAL,
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        },
        publish_interval: NonZeroU32::MIN,
        gravity: Vec3::ZERO,
        largest_packet: LargestPacket::DEFAULT,
        features: Features::ALL,
    };

    /// The start of a subscriber that receives the stream from its first tick.
    #[must_use]
    pub const fn start(&self, stream: StreamId, tick: Tick) -> StreamStart {
        StreamStart {
            stream,
            largest_packet: self.largest_packet,
            tolerance: self.tolerance,
            integrator: self.integrator,
            publish_interval: self.publish_interval,
            gravity: self.gravity,
            tick,
            next: 0,
            scene_events: 0,
        }
    }
}

/// Switches of a publisher's choices. They change what it sends, never how a packet is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Features {
    /// Predicts rest for a body that is awake and still.
    pub resting: bool,
    /// Predicts ballistic motion for falling bodies.
    pub ballistic: bool,
    /// Predicts torque-free rotation for bodies with unequal moments of inertia.
    pub torque_free: bool,
    /// Attaches bodies to others.
    pub attached: bool,
    /// Omits velocities that follow from two poses, where that is cheaper.
    pub derived: bool,
    /// Omits the parts of a correction that the tolerance does not need.
    pub sparse: bool,
    /// Encodes velocities in coarser steps, where that is cheaper.
    pub coarse: bool,
    /// Predicts constant acceleration.
    pub accelerated: bool,
    /// Chooses corrections by mode decision, with the observations of the lookahead.
    pub mode_decision: bool,
    /// Encodes motions as corrections of the prediction.
    pub residuals: bool,
    /// Skips bodies that the prefilter finds within tolerance.
    pub prefilter: bool,
    /// Packs several bodies into a packet. Off, a tick may take more packets than are kept for refreshes; measure that
    /// without loss.
    pub packing: bool,
    /// Sends repair symbols to recover lost packets.
    pub redundancy: bool,
    /// Sends repair symbols without a request where packets are lost.
    pub unsolicited: bool,
    /// Splits large ticks in two packets where packets are lost.
    pub halves: bool,
    /// Encodes exact rest poses as corrections of the prediction.
    pub rest_corrections: bool,
    /// Gives short aliases to the bodies that are updated often. Off, the alias of a body is its index.
    pub aliases: bool,
    /// Sends checksums over all tracks.
    pub checksums: bool,
}

impl Features {
    /// All features.
    pub const ALL: Self = Self {
        resting: true,
        ballistic: true,
        torque_free: true,
        attached: true,
        derived: true,
        sparse: true,
        coarse: true,
        accelerated: true,
        mode_decision: true,
        residuals: true,
        prefilter: true,
        packing: true,
        redundancy: true,
        unsolicited: true,
        halves: true,
        rest_corrections: true,
        aliases: true,
        checksums: true,
    };

    /// The exponents of velocity steps to try: `doubled`, or only the finest.
    fn steps<const N: usize>(&self, doubled: [u32; N]) -> impl Iterator<Item = u32> {
        let coarse = self.coarse;
        doubled
            .into_iter()
            .filter(move |times| coarse || *times == 0)
    }
}

impl Default for Features {
    fn default() -> Self {
        Self::ALL
    }
}

/// The bytes that a stream's packets may take: a rate per second of the scene's time, and a burst.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Budget {
    bytes_per_second: u32,
    burst: u32,
}

impl Budget {
    /// A budget of this rate and burst, in bytes; `None` outside the limits (PROTOCOL 7).
    #[must_use]
    pub fn new(bytes_per_second: u32, burst: u32) -> Option<Self> {
        let fits = (BUDGET_MIN..=BUDGET_MAX).contains(&bytes_per_second);
        let bursts = (DATAGRAM_BYTES_MAX as u32..=BUDGET_BURST_MAX).contains(&burst);
        (fits && bursts).then_some(Self {
            bytes_per_second,
            burst,
        })
    }

    /// A budget of this rate with a burst of a quarter of a second, or of a full packet if that is more.
    #[must_use]
    pub fn per_second(bytes: u32) -> Option<Self> {
        let burst = (bytes / 4).clamp(DATAGRAM_BYTES_MAX as u32, BUDGET_BURST_MAX);
        Self::new(bytes, burst)
    }

    /// The rate, bytes per second of the scene's time.
    #[must_use]
    pub const fn bytes_per_second(self) -> u32 {
        self.bytes_per_second
    }

    /// The burst, bytes.
    #[must_use]
    pub const fn burst(self) -> u32 {
        self.burst
    }
}

impl Wire for Budget {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.bytes_per_second));
        to.varint(u64::from(self.burst));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Self::new(from.varint32()?, from.varint32()?).ok_or(Malformed::OutOfRange)
    }
}

/// The unspent part of a budget.
#[derive(Clone, Copy, Debug)]
struct TokenBucket {
    /// Billionths of a byte; negative after packets that had to be sent despite the budget.
    left: i64,
    each_tick: i64,
    most: i64,
}

const BILLION: i64 = 1_000_000_000;

impl TokenBucket {
    /// A full bucket.
    fn new(budget: Budget, rate: Rate) -> Self {
        let most = i64::from(budget.burst) * BILLION;
        Self {
            left: most,
            each_tick: (u64::from(budget.bytes_per_second) * rate.step_ns()) as i64,
            most,
        }
    }

    /// Adds the bytes earned in `passed` ticks.
    fn earn(&mut self, passed: Ticks) {
        let earned = self.each_tick.saturating_mul(i64::from(passed.count()));
        self.left = self.left.saturating_add(earned).min(self.most);
    }

    /// Subtracts bytes that were sent.
    fn spend(&mut self, bytes: usize) {
        self.left = self.left.saturating_sub(bytes as i64 * BILLION);
    }

    /// True if at least half of the burst is unspent.
    const fn is_half_full(&self) -> bool {
        self.left >= self.most / 2
    }

    /// The unspent whole bytes.
    fn left(&self) -> u64 {
        (self.left.max(0) / BILLION) as u64
    }
}

// The bytes earned in a tick of the slowest scene do not overflow.
const _: () = assert!((BUDGET_MAX as i64) <= i64::MAX / BILLION / 4);

/// A tick of at least this many bytes is split into two packets. With a lower value, packets take more bytes and fewer
/// bodies are off.
const HALVED: usize = 180;

/// The least loss rate assumed for answers to a receiver that lost packets.
const ANSWERED: f64 = 0.01;

/// The share of a stream's packets that was lost, in millionths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
struct LossRate(u32);

impl LossRate {
    /// A loss rate in percent.
    #[must_use]
    const fn percent(count: u32) -> Self {
        Self(count * 10_000)
    }
}

/// The rate of a stream's repair symbols.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Redundancy {
    /// Never: a lost packet is answered on request.
    #[default]
    Off,
    /// After every third tick.
    Thin,
    /// After every second tick: the next tick recovers a packet of the tick before.
    Plain,
    /// After every tick.
    Thick,
}

impl Redundancy {
    const ALL: [Self; 4] = [Self::Off, Self::Thin, Self::Plain, Self::Thick];

    /// The loss rate from which on this redundancy is used.
    #[must_use]
    const fn from(self) -> LossRate {
        match self {
            Self::Off => LossRate(0),
            Self::Thin => LossRate::percent(1),
            Self::Plain => LossRate::percent(3),
            Self::Thick => LossRate::percent(10),
        }
    }

    /// The redundancy for a loss rate, given the present one. It rises at once and falls only after the loss is clearly
    /// less.
    #[must_use]
    fn for_loss(self, loss: LossRate) -> Self {
        let served = |eased: bool| {
            let enough = |level: &&Self| {
                let from = level.from().0;
                loss.0 >= if eased { from / 5 * 3 } else { from }
            };
            Self::ALL.iter().rfind(enough).copied().unwrap_or_default()
        };
        served(false).max(self.min(served(true)))
    }

    /// The number of ticks between repair symbols; none without repair symbols.
    const fn ticks(self) -> Option<u32> {
        match self {
            Self::Off => None,
            Self::Thin => Some(3),
            Self::Plain => Some(2),
            Self::Thick => Some(1),
        }
    }

    /// True if a tick of this many bytes is sent in two packets followed by repair symbols of half the length. One lost
    /// datagram of the three is then recovered before the tick is displayed.
    const fn halves(self, bytes: usize) -> bool {
        matches!(self, Self::Plain | Self::Thick) && bytes >= HALVED
    }

    /// The number of repair symbols for this many new packets. It fails to cover the losses in about one of a hundred
    /// cases, and never exceeds the number of packets.
    fn repair_symbols(self, packets: u64) -> u64 {
        if self == Self::Off {
            return 0;
        }
        let packets = packets.min(64);
        (1..packets)
            .find(|repair_symbols| {
                beyond(packets + repair_symbols, *repair_symbols, self.loss()) < 0.015
            })
            .unwrap_or(packets)
    }

    /// The number of repair symbols that answer a request for `wanted`, of which `in_flight` are in flight. Too few
    /// arrive in about one of a hundred cases. Answers are rare, and the receiver has already waited for a round trip.
    fn answers(self, wanted: usize, in_flight: usize) -> usize {
        let least = wanted.saturating_sub(in_flight);
        let most = (3 * wanted).saturating_sub(in_flight);
        let loss = self.loss().max(ANSWERED);
        let enough = |sent: &usize| {
            let all = sent + in_flight;
            beyond(all as u64, (all - wanted) as u64, loss) < 0.01
        };
        (least..most).find(enough).unwrap_or(most)
    }

    /// The loss rate that this redundancy is made for.
    const fn loss(self) -> f64 {
        match self {
            Self::Off => 0.0,
            Self::Thin => 0.02,
            Self::Plain => 0.05,
            Self::Thick => 0.1,
        }
    }
}

/// The probability that more than `most` of `count` packets are lost, each with probability `loss`.
fn beyond(count: u64, most: u64, loss: f64) -> f64 {
    let mut term = 1.0;
    for _ in 0..count {
        term *= 1.0 - loss;
    }
    let mut within = 0.0;
    for lost in 0..=most {
        within += term;
        term *= (count - lost) as f64 / (lost + 1) as f64 * loss / (1.0 - loss);
    }
    1.0 - within
}

/// The bounds of the silence between two watermarks of one stream, in ticks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WatermarkPolicy {
    shortest: u64,
    longest: u64,
}

impl WatermarkPolicy {
    /// Every silent published tick, because members wait for it.
    pub const LOCKSTEP: Self = Self {
        shortest: 1,
        longest: 1,
    };

    /// The first silent tick, then at growing intervals; for a scene that publishes at multiples of `publish_interval`.
    #[must_use]
    pub fn free_running(rate: Rate, publish_interval: NonZeroU32) -> Self {
        let publish_interval = u64::from(publish_interval.get());
        let publications = (whole_ticks(rate, SILENCE_MS_MAX) / publish_interval).max(1);
        Self {
            shortest: 1,
            longest: publications * publish_interval,
        }
    }

    /// The policy of an upstream: a watermark a few ticks later often saves a datagram.
    #[must_use]
    pub fn upstream(rate: Rate) -> Self {
        Self {
            shortest: whole_ticks(rate, UPSTREAM_WATERMARK_MS),
            longest: whole_ticks(rate, SILENCE_MS_MAX),
        }
    }

    /// The pause, in ticks, after the watermark that ended a silence of `silence` ticks.
    pub(crate) fn pause_after(&self, silence: u64) -> u64 {
        silence.clamp(self.shortest, self.longest)
    }
}

/// The present silence of one stream.
#[derive(Debug)]
struct Silence {
    policy: WatermarkPolicy,
    /// The tick of the newest packet.
    since: Tick,
    /// The silence at which the next watermark is due, in ticks.
    watermark_at: u64,
}

impl Silence {
    /// A silence that starts at this tick.
    fn new(policy: WatermarkPolicy, since: Tick) -> Self {
        Self {
            policy,
            since,
            watermark_at: policy.pause_after(0),
        }
    }

    /// Ends the silence with a packet sent at this tick.
    fn end(&mut self, tick: Tick) {
        *self = Self::new(self.policy, tick);
    }

    /// The tick of the next watermark, if the silence lasts until then.
    fn next_watermark(&self) -> Tick {
        Tick::new(self.since.value() + self.watermark_at)
    }

    /// True if a watermark is due at a silent tick.
    fn is_watermark_due(&self, tick: Tick) -> bool {
        tick.value() - self.since.value() >= self.watermark_at
    }

    /// Starts the next pause with a watermark sent at a silent tick.
    fn pause(&mut self, tick: Tick) {
        let silence = tick.value() - self.since.value();
        self.watermark_at = silence + self.policy.pause_after(silence);
    }
}

/// Whole ticks in this many milliseconds, at least one.
pub(crate) fn whole_ticks(rate: Rate, milliseconds: u32) -> u64 {
    let (ticks, seconds) = (u64::from(rate.ticks()), u64::from(rate.seconds()));
    (ticks * u64::from(milliseconds) / (1_000 * seconds)).max(1)
}

/// Whole ticks in a second, at least one.
pub(crate) fn second(rate: Rate) -> Ticks {
    Ticks::new(whole_ticks(rate, 1_000) as u32)
}

/// The start of a subscriber, sent by the server when a member joins or changes its stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamStart {
    /// The id of the stream.
    pub stream: StreamId,
    /// The largest packet that the publisher makes. A larger one is malformed.
    pub largest_packet: LargestPacket,
    /// The tolerance of a body with the usual scale.
    pub tolerance: Tolerance,
    /// The integrator and rate of the scene.
    pub integrator: Integrator,
    /// The stream publishes at ticks that are multiples of this number.
    pub publish_interval: NonZeroU32,
    /// The present gravity, m/s², world frame.
    pub gravity: Vec3,
    /// The tick of the snapshot.
    pub tick: Tick,
    /// Number of the first packet after the snapshot.
    pub next: u64,
    /// Scene events included in the snapshot.
    pub scene_events: u64,
}

/// Counters of a publisher.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PublisherStatistics {
    /// Updates sent.
    pub updates: u64,
    /// Packets sent, without refreshes and watermarks.
    pub packets: u64,
    /// Bytes of these packets.
    pub bytes: u64,
    /// Observations compared with tracks. A body that stays asleep has none.
    pub checked: u64,
    /// Bodies out of tolerance without an update, because the budget did not suffice. Counted at every tick.
    pub over_budget: u64,
}

#[cfg(test)]
mod tests {
    use alloc::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_bytes_spent_never_exceed_the_burst_plus_the_earned_bytes(
            rate in BUDGET_MIN..1_000_000,
            packet_sizes in proptest::collection::vec(0_usize..3_000, 1..400),
        ) {
            let budget = Budget::per_second(rate).unwrap();
            let mut token_bucket = TokenBucket::new(budget, Rate::HZ_60);
            let (mut spent, mut longest) = (0_u64, 0);
            for (ticks, size) in packet_sizes.iter().enumerate() {
                token_bucket.earn(Ticks::new(1));
                if token_bucket.left() > 0 {
                    token_bucket.spend(*size);
                    spent += *size as u64;
                    longest = longest.max(*size);
                }
                let earned = u64::from(rate) * (ticks as u64 + 1) / 60;
                let allowed = u64::from(budget.burst()) + earned + longest as u64 + 1;
                prop_assert!(spent <= allowed, "{} of {}", spent, allowed);
            }
        }
    }

    #[test]
    fn a_budget_round_trips_and_invalid_ones_are_refused() {
        for (rate, burst, fits) in [
            (BUDGET_MIN, 1_150, true),
            (8_000, 2_000, true),
            (BUDGET_MAX, BUDGET_BURST_MAX, true),
            (BUDGET_MIN - 1, 1_150, false),
            (8_000, 1_149, false),
            (BUDGET_MAX + 1, 2_000, false),
            (8_000, BUDGET_BURST_MAX + 1, false),
        ] {
            let mut writer = Writer::new();
            writer.varint(u64::from(rate));
            writer.varint(u64::from(burst));
            let bytes = writer.into_bytes();
            let read = Budget::decode(&mut Reader::new(&bytes));
            assert_eq!(read.is_ok(), fits, "{rate} {burst}");
            assert_eq!(read.ok(), Budget::new(rate, burst));
            if let Ok(budget) = read {
                let mut writer = Writer::new();
                budget.encode(&mut writer);
                assert_eq!(writer.into_bytes(), bytes);
            }
        }
    }

    #[test]
    fn redundancy_rises_at_once_and_falls_only_after_clearly_less_loss() {
        let percent = LossRate::percent;
        assert_eq!(Redundancy::Off.for_loss(percent(5)), Redundancy::Plain);
        assert_eq!(Redundancy::Plain.for_loss(percent(2)), Redundancy::Plain);
        assert_eq!(Redundancy::Thin.for_loss(percent(2)), Redundancy::Thin);
        assert_eq!(Redundancy::Plain.for_loss(percent(1)), Redundancy::Thin);
        assert_eq!(Redundancy::Plain.for_loss(LossRate(0)), Redundancy::Off);
        assert_eq!(Redundancy::Off.for_loss(LossRate(9_999)), Redundancy::Off);
    }

    #[test]
    fn repair_symbols_grow_more_slowly_than_packets() {
        let plain = [1, 2, 3, 6, 10, 20].map(|packets| Redundancy::Plain.repair_symbols(packets));
        assert_eq!(plain, [1, 1, 1, 2, 3, 4]);
        assert_eq!(Redundancy::Off.repair_symbols(10), 0);
        assert_eq!(Redundancy::Thick.repair_symbols(1), 1);
    }

    #[test]
    fn answers_carry_enough_repair_symbols() {
        let answers = |level: Redundancy| [0, 1, 2, 5].map(|wanted| level.answers(wanted, 0));
        assert_eq!(answers(Redundancy::Off), [0, 2, 3, 6]);
        assert_eq!(answers(Redundancy::Plain), [0, 2, 3, 7]);
        assert_eq!(answers(Redundancy::Thick), [0, 2, 4, 8]);
        // Symbols in flight may be lost too.
        let beside = |in_flight| Redundancy::Plain.answers(2, in_flight);
        assert_eq!([0, 1, 2, 3, 4].map(beside), [3, 2, 1, 0, 0]);
    }

    #[test]
    fn long_ticks_are_halved_under_much_loss() {
        assert!(Redundancy::Plain.halves(HALVED) && !Redundancy::Plain.halves(HALVED - 1));
        assert!(!Redundancy::Off.halves(1_000) && !Redundancy::Thin.halves(1_000));
    }

    fn silences(policy: WatermarkPolicy) -> Vec<u64> {
        let mut silence = 0;
        let next = |_| {
            silence += policy.pause_after(silence);
            silence
        };
        (0..11).map(next).collect()
    }

    #[test]
    fn watermarks_of_a_silence_grow_rarer_within_bounds() {
        let every = |ticks| NonZeroU32::new(ticks).unwrap();
        assert_eq!(
            silences(WatermarkPolicy::upstream(Rate::HZ_60)),
            [4, 8, 16, 32, 64, 128, 256, 406, 556, 706, 856]
        );
        assert_eq!(
            silences(WatermarkPolicy::free_running(Rate::HZ_60, every(1))),
            [1, 2, 4, 8, 16, 32, 64, 128, 256, 406, 556]
        );
        let rare = WatermarkPolicy::free_running(Rate::HZ_60, every(400));
        assert_eq!(rare.longest, 400);
        let lockstep = silences(WatermarkPolicy::LOCKSTEP);
        assert!(lockstep.into_iter().eq(1..=11));
    }
}
