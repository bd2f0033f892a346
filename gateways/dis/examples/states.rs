//! Prints the datagrams of a short DIS scene as hexadecimal lines.
//!
//! For readers by others. Eight balls are thrown and turn for three seconds, at 60 steps a second; then they leave.
//! `tests/readers.py` compares what other software reads.

use std::io::Write;
use std::time::Duration;

use rhumb_dis::geodesy::{Geodetic, SceneAxes, TangentFrame};
use rhumb_dis::glam::{DQuat, DVec3};
use rhumb_dis::pdu::TimeBase;
use rhumb_dis::published::{Kind, Observed, Publisher, PublisherConfig};

const GRAVITY: DVec3 = DVec3::new(0.0, -9.81, 0.0);

fn ball(number: u64, seconds: f64) -> Observed {
    let start = DVec3::new(number as f64, 10.0 + number as f64, -2.0);
    let spin = DVec3::new(0.5, number as f64, 0.25);
    Observed {
        key: number,
        kind: Kind::default(),
        position: start * seconds + GRAVITY * (0.5 * seconds * seconds),
        rotation: DQuat::from_scaled_axis(spin * seconds),
        velocity: start + GRAVITY * seconds,
        // The even ones need updates.
        acceleration: if number % 2 == 1 {
            GRAVITY
        } else {
            DVec3::ZERO
        },
        spin,
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut publisher = Publisher::new(PublisherConfig {
        exercise: 1,
        site: 2,
        application: 3,
        frame: TangentFrame::new(Geodetic::from_degrees(48.1, 11.6, 520.0)?, SceneAxes::YUp),
        axes: SceneAxes::YUp,
        base: TimeBase::Absolute,
        datagram_bytes: 1400,
        states_per_second: 1000,
    });
    let mut buffer = [0; 1400];
    for step in 0..=180 {
        let seconds = f64::from(step) / 60.0;
        let bodies = (1..9).map(|number| ball(number, seconds));
        let bodies: Vec<_> = bodies.filter(|_| step < 180).collect();
        publisher.handle_bodies(Duration::from_secs_f64(seconds), &bodies);
        while let Some(bytes) = publisher.poll_datagram(&mut buffer) {
            let digits = buffer[..bytes].iter().map(|byte| format!("{byte:02x}"));
            writeln!(std::io::stdout(), "{}", digits.collect::<String>())?;
        }
    }
    Ok(())
}
