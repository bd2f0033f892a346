//! `rhumb-conformance`: tests implementations over a real connection.
//!
//! Every verdict comes from observed packets and messages, never from what a peer claims about itself. This module
//! takes part in no session. Where a case needs the meaning of a stream, it decodes it with the project's own
//! subscriber, which the golden vectors verify.
//!
//! # How a case is written
//!
//! A case is one promise of one side, in a file of its group: `server/l1_session.rs` and so on. Each such file has
//! `pub(super) fn cases() -> Vec<Case>`, and each case is written as
//!
//! ```ignore
//! Case::server("L1.1.1", "a hello is answered by a welcome")
//!     .cites("PROTOCOL 3.1-1, 3.1-4")
//!     .play(|trial| {
//!         let mut client = trial.client()?;       // a connection with its control stream, and a scene of its own
//!         let welcome = client.hello()?;          // sends `Hello` and waits for `Welcome`
//!         ensure(welcome.version == 1, "the version is one that was offered")
//!     })
//! ```
//!
//! - The **id** is level, group and number; it never changes and is never reused. Groups of servers are numbered from
//!   1, those of clients from 51, those of pairs from 71, those of decoders from 81. In a family made from vectors,
//!   the last part of the id is the key of the vector ([`Case::keyed`]).
//! - The **name** is the promise. `cites` names the requirements under test; `coverage` compares them with the
//!   documents.
//! - `play` receives a [`Trial`] and returns a [`CaseResult`]: `Ok(())`, or the first [`Stop`]: *fail* (the peer broke
//!   a promise), *lax* (the peer ignores a SHOULD), *unsupported*, *inconclusive* (the runner could not run the case).
//!   The `?` operator does most of the work: if an answer that a [`RawClient`] waits for does not come, the case fails
//!   and the report includes its log.
//! - How a connection **closes** is judged separately: [`RawClient::must_be_closed`] fails the case only when the peer
//!   keeps the connection open or vanishes without a close; another code is recorded as the closing verdict of the
//!   case.
//! - `needs` lists optional features ([`Feature`]). If the server is declared to lack one (`--without`), the case is
//!   skipped; cases of their own test that such a server refuses it.
//! - Nothing sleeps. To prove that a message has no effect, a case uses a barrier: [`RawClient::barrier`] sends `Ping`
//!   and returns all messages received before its `Pong`. Every other wait lasts at most `--timeout`.
//! - A case has a scene of its own ([`Trial::scene`]), which is deleted afterwards. A case that would disturb others
//!   is marked [`Case::alone`]; a case that waits for a timer of the peer is marked [`Case::slow`] and starts first.
//! - In a client case the suite plays the server byte by byte ([`RawServer`]): see `client/`.

#![forbid(unsafe_code)]

pub mod case;
pub mod cli;
mod client;
pub mod conditions;
pub mod coverage;
mod decoder;
mod feature;
pub mod fnv;
pub mod grammar;
mod local_server;
mod log;
pub mod matrix;
pub mod mutants;
pub mod outcome;
mod pair;
mod peer;
pub mod report;
pub mod requirements;
mod role;
pub mod run;
pub mod schedule;
pub mod seed;
mod server;
mod shown_token;
pub mod suite;
pub mod testee;
pub mod trace;
pub mod trial;
pub mod truths;
pub mod vectors;

pub use case::Case;
pub use cli::{Arguments, main};
pub use feature::Feature;
pub use local_server::LocalServer;
pub use outcome::{CaseOutcome, CaseResult, Closing, Stop, Verdict, ensure};
pub use peer::{
    Decoder, Delivery, Interceptor, LaneAction, LivePair, LossyClient, RawClient, RawServer,
    Setting, compare, compare_recorded,
};
pub use role::Role;
pub use trial::Trial;
