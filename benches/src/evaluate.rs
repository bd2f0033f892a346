//! `rhumb-bench evaluate`: runs the modes, shows progress, writes what was measured.

use std::process::ExitCode;

use clap::Args;
use rhumb_reckoning::{Metres, Tolerance};
use rhumb_transport::LinkTerms;

use crate::drive::{Cores, Plan, run_side_by_side};
use crate::record::Mode;

/// What to run, and where to write it.
#[derive(Clone, Debug, Args)]
pub struct Evaluate {
    #[arg(long, default_value = "ball-pit")]
    scene: String,
    #[arg(long, value_delimiter = ',', default_value = "500")]
    bodies: Vec<u32>,
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    #[arg(long, default_value_t = 0.05)]
    tolerance: f64,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[arg(long, default_value_t = LinkTerms::PERFECT)]
    link: LinkTerms,
}

/// Runs it.
pub fn evaluate(a: &Evaluate) -> ExitCode {
    for bodies in &a.bodies {
        let plan = Plan {
            scene: a.scene.clone(),
            bodies: *bodies,
            seed: a.seed,
            ticks: (a.seconds * 60.0) as u32,
            tolerance: Tolerance::from_metres(Metres::new(a.tolerance)).expect("x"),
            link: a.link,
            modes: vec![
                Mode::Integrated,
                Mode::Naive,
                Mode::Rhumb,
                Mode::RhumbPipelined,
            ],
            cores: Cores { server: Some(1) },
        };
        let load = match run_side_by_side(&plan, &mut |_| {}) {
            Ok(load) => load,
            Err(e) => {
                eprintln!("{e}");
                return ExitCode::FAILURE;
            }
        };
        for run in &load.runs {
            let down: u64 = run
                .frames
                .iter()
                .map(|f| f.wire_bytes_down + 28 * f.wire_datagrams_down)
                .sum();
            let dg: u64 = run.frames.iter().map(|f| f.wire_datagrams_down).sum();
            let first5: u64 = run
                .frames
                .iter()
                .take(300)
                .map(|f| f.wire_bytes_down + 28 * f.wire_datagrams_down)
                .sum();
            let upd: u64 = run.frames.iter().map(|f| f.updates).sum();
            let upd5: u64 = run.frames.iter().take(300).map(|f| f.updates).sum();
            let state: usize = run
                .passed
                .iter()
                .filter(|p| p.way == crate::record::Way::StateDown)
                .map(|p| p.bytes.len())
                .sum();
            let mut ft: Vec<u64> = run.frames.iter().map(|f| f.frame_ns).collect();
            ft.sort_unstable();
            let max = run
                .frames
                .iter()
                .flat_map(|f| f.errors_m.last())
                .fold(0f32, |a, b| a.max(*b));
            eprintln!(
                "{:16} {:5} down {down:9} first5 {first5:8} dg {dg:6} state {state:8} upd {upd:6} upd5 {upd5} bits/upd {:.1} frame p50 {:.3} ms p99 {:.3} mean {:.3} step p50 {:.3} publish {:.3} breaches {} max {max:.4} truth {:016x} join {:?}",
                run.terms.mode.name(),
                bodies,
                state as f64 * 8.0 / upd.max(1) as f64,
                ft[ft.len() / 2] as f64 / 1e6,
                ft[ft.len() * 99 / 100] as f64 / 1e6,
                ft.iter().sum::<u64>() as f64 / ft.len() as f64 / 1e6,
                run.step_ns_p50 as f64 / 1e6,
                run.publish_ns_total as f64 / run.step_ns_total as f64,
                run.breaches.len(),
                run.truth_digest,
                run.join
            );
        }
    }
    ExitCode::SUCCESS
}
