//! Tests of DIS beyond one file.
//!
//! Vectors of the models, another codec, and a member of a scene over sockets.

mod gateway;
mod oracle;
mod vectors;
