//! Criterion benches of a stream: prediction, prefilter, codec, view.

mod support;

use std::cell::LazyCell;
use std::hint::black_box;

use criterion::{BatchSize, Criterion, Throughput};
use rhumb_bench::setup::decoding::{
    DecodeLoad, Lanes, PacketLoad, PredictorLoad, PrefilterLoad, RenderLoad, config, track,
};
use rhumb_reckoning::{Grid, Metres, Predictor, Tolerance};

use support::{ProcessorTime, bodies, criterion, quick};

/// Bodies of setups whose work does not depend on their number.
const FEW: u32 = 1_000;

fn main() {
    let mut criterion = criterion();
    prediction(&mut criterion);
    prefilter(&mut criterion);
    codec(&mut criterion);
    subscriber(&mut criterion);
    view(&mut criterion);
    criterion.final_summary();
}

const fn name(predictor: Predictor) -> &'static str {
    match predictor {
        Predictor::Rest => "rest",
        Predictor::Uniform => "uniform",
        Predictor::Ballistic => "ballistic",
        Predictor::TorqueFree => "torque-free",
        Predictor::BallisticTorqueFree => "ballistic-torque-free",
        Predictor::Accelerated(_) => "constant-acceleration",
    }
}

/// One prediction after the other, by predictor; and of views, four at once.
fn prediction(criterion: &mut Criterion<ProcessorTime>) {
    let mut group = quick(criterion, "prediction");
    group.throughput(Throughput::Elements(u64::from(FEW)));
    for predictor in Predictor::ALL {
        let load = PredictorLoad::new(FEW, predictor);
        group.bench_function(name(predictor), |bencher| bencher.iter(|| load.predict()));
    }
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let lanes = Lanes::of((0..FEW).map(track), config().integrator, grid);
    group.bench_function("four-lanes", |bencher| bencher.iter(|| lanes.predict()));
    group.finish();
}

fn prefilter(criterion: &mut Criterion<ProcessorTime>) {
    let mut group = quick(criterion, "prefilter");
    group.throughput(Throughput::Elements(u64::from(FEW)));
    let moving = PrefilterLoad::moving(FEW);
    let resting = PrefilterLoad::resting(FEW);
    for (name, mut load) in [("moving", moving), ("resting", resting)] {
        assert_eq!(load.test(), 0, "{name} bodies within tolerance are decided");
        group.bench_function(name, |bencher| bencher.iter(|| load.test()));
    }
    group.finish();
}

/// Packets of a run in mid-run, without the tracks behind them.
fn codec(criterion: &mut Criterion<ProcessorTime>) {
    let load = LazyCell::new(|| PacketLoad::new(bodies()));
    let mut group = quick(criterion, "codec");
    group.bench_function("encode", |bencher| bencher.iter(|| load.encode()));
    let mut updates = Vec::new();
    group.bench_function("decode", |bencher| {
        bencher.iter(|| load.decode(black_box(&mut updates)));
    });
    group.finish();
}

/// Makes the load of this number of bodies.
type MakeLoad = fn(u32) -> DecodeLoad;

/// Decoding with the tracks: a subscriber that has just joined, and one in mid-run.
fn subscriber(criterion: &mut Criterion<ProcessorTime>) {
    let mut group = quick(criterion, "subscriber");
    let loads: [(&str, MakeLoad); 2] = [
        ("first-updates", DecodeLoad::new),
        ("mid-run", DecodeLoad::in_mid_run),
    ];
    for (name, make) in loads {
        let load = LazyCell::new(|| make(bodies()));
        group.bench_function(name, |bencher| {
            let fresh = || load.subscriber.clone();
            bencher.iter_batched_ref(
                fresh,
                |subscriber| load.decode(subscriber),
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}

/// A view of bodies that all move.
fn view(criterion: &mut Criterion<ProcessorTime>) {
    let mut load = LazyCell::new(|| RenderLoad::new(bodies()));
    let mut group = quick(criterion, "view");
    group.bench_function("moving-bodies", |bencher| bencher.iter(|| load.refresh()));
    group.finish();
}
