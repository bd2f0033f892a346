//! Tests of DIS beyond one file: vectors of the models, another codec, a scene's member over sockets.

mod gateway;
mod oracle;
mod vectors;
