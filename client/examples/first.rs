//! Drops a ball on a floor in this process: the README's first program.
//!
//! It prints the ball's height and its error bound after each tick.

use std::io::{Write, stdout};

use rhumb_client::scene::{BodyDesc, Shape};
use rhumb_client::{Client, MainError, PipelineDepth};

fn main() -> Result<(), MainError> {
    let mut client = Client::local().join("drop")?;
    client.add_body(BodyDesc::fixed(Shape::cuboid(10.0, 0.5, 10.0)).at(0.0, -0.5, 0.0))?;
    let ball = client.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
    for _ in 0..180 {
        let tick = client.advance(PipelineDepth::LOCKSTEP)?;
        let height = client.view().position(ball).ok_or("the ball is gone")?.y;
        let bound = client.error_bound(ball).ok_or("the ball is gone")?;
        writeln!(stdout(), "{tick}: {height:.3} m, {bound}")?;
    }
    Ok(())
}
