//! `rhumb-conformance`: tries implementations over the real wire.
//!
//! Every verdict comes from what was seen on the wire, never from what a peer says of itself. Nothing here is part of a
//! session: where a case needs to know what a stream means it reads it by this house's own subscriber, which the vectors
//! hold.
//!
//! # How a case is written
//!
//! A case is one promise of one side, in a file of its group: `server/l1_session.rs` and so on. Each such file has
//! `pub(super) fn cases() -> Vec<Case>`, and each case stands there as
//!
//! ```ignore
//! Case::server("L1.1.1", "a hello is answered by a welcome")
//!     .cites("PROTOCOL 3.1-1, 3.1-4")
//!     .play(|trial| {
//!         let mut guest = trial.guest()?;         // a connection with its control stream, about a scene of its own
//!         let welcome = guest.hello()?;           // says it, and waits for what must come
//!         ensure(welcome.version == 1, "the version is one that was offered")
//!     })
//! ```
//!
//! - The **id** is level, group and number; it never changes and is not used again. Groups of servers are numbered from 1,
//!   those of clients from 51, those of pairs from 71, those of decoders from 81. A family made from vectors has the vector's key as its last part
//!   ([`Case::keyed`]).
//! - The **name** is the promise. `cites` names the requirements that it tries; `coverage` compares them with the documents.
//! - `play` is given a [`Trial`], and says how it went by its [`CaseResult`]: `Ok(())`, or the first [`Stop`]: *fail* (the peer broke a
//!   promise), *lax* (it did otherwise than a SHOULD asks), *unsupported*, *inconclusive* (the runner could not try it).
//!   `?` does most of it: what a [`RawClient`] waits for and does not get is a failure with the trace beside it.
//! - How a connection **closes** is judged apart: [`RawClient::must_be_closed`] fails the case only when the peer stays or
//!   vanishes; another code is noted as the case's closing verdict.
//! - `needs` says what a peer may leave out ([`Feature`]); a server that is said to lack it (`--without`) is not asked, and
//!   has to refuse it, which cases of their own try.
//! - Nothing sleeps. That nothing comes of something is seen by a barrier: [`RawClient::barrier`] says `Ping` and returns all
//!   that came before its `Pong`. Every other wait is `--timeout` at most.
//! - A case has a scene of its own ([`Trial::scene`]), which is deleted behind it. One that would disturb others says
//!   [`Case::alone`]; one that must wait out a clock of the peer's says [`Case::slow`] and begins first.
//! - A case of a client is played by a host of bytes ([`Host`]): see `client/`.

pub mod case;
pub mod cli;
mod client;
pub mod coverage;
mod decoder;
pub mod matrix;
pub mod mutants;
pub mod outcome;
mod pair;
mod peer;
pub mod report;
pub mod run;
mod server;
pub mod suite;
pub mod trace;
pub mod trial;
pub mod truths;

pub use case::{Case, Feature, Role};
pub use cli::{Arguments, main};
pub use outcome::{CaseOutcome, CaseResult, Closing, Stop, Verdict, ensure};
pub use peer::{
    Decoder, Delivery, Host, Interceptor, LaneAction, LivePair, LossyClient, RawClient, Setting,
    compare, compare_recorded,
};
pub use trial::Trial;
