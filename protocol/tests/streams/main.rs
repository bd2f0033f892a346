//! Publishers, subscribers and sessions, without a clock or a socket.

mod acceleration;
mod corrections_x4;
mod fec;
mod forgetting;
mod future;
mod largest_packet;
mod overdue_datagrams;
mod reading;
mod sleepers;
mod stream;
mod terms;
