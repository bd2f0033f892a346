//! The state stream: said once, followed by many.
mod choose;
mod field;
mod full;
mod gaps;
mod history;
mod observation;
mod publisher;
mod subscriber;
mod tracks;

pub use full::FullPublisher;
pub use observation::{Activity, Observation};
pub use publisher::{Publisher, PublisherStatistics};
pub use subscriber::{Bound, StreamStart, Subscriber, SubscriberStatistics};
pub use tracks::Manner;
