//! Steps a lockstep scene on, and prints each tick with a ball's bound.
//!
//! Arguments: the server's address, its fingerprint, the scene. It ends when its output is closed, or by an error.

use std::io::{self, Write};

use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{Client, MainError, PipelineDepth, Trust};

fn main() -> Result<(), MainError> {
    let mut arguments = std::env::args().skip(1);
    let mut next = |what: &'static str| arguments.next().ok_or(what);
    let address = next("the server's address is missing")?;
    let fingerprint = next("its fingerprint is missing")?;
    let scene = next("the scene is missing")?;
    let trust = Trust::Fingerprint(fingerprint.parse()?);
    let mut client = Client::connect(&address, trust)?.join(&scene)?;
    let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
    loop {
        let tick = client.advance(PipelineDepth::LOCKSTEP)?.value();
        let bound = client.error_bound(ball).ok_or("the ball is gone")?;
        writeln!(io::stdout(), "{tick} {}", bound.metres())?;
    }
}
