//! Drops a ball on a floor, and prints its position and its error bound.
//!
//! Start `rhumb-server --open` first; it prints the address and the fingerprint, which are the arguments of this example.

use std::io::Write;

use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{Client, MainError, PipelineDepth, Trust};

fn main() -> Result<(), MainError> {
    let mut arguments = std::env::args().skip(1);
    let address = arguments
        .next()
        .ok_or("the server's host:port is missing")?;
    let fingerprint = arguments.next().ok_or("its fingerprint is missing")?;
    let trust = Trust::Fingerprint(fingerprint.parse()?);
    let mut client = Client::connect(&address, trust)?.join("drop")?;
    client.add_body(BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0))?;
    let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
    for _ in 0..180 {
        let tick = client.advance(PipelineDepth::LOCKSTEP)?;
        let (at, bound) = (client.view().position(ball), client.error_bound(ball));
        writeln!(std::io::stdout(), "{tick}: {at:?}, {bound:?}")?;
    }
    Ok(client.delete()?)
}
