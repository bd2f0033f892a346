//! Costs of a body's stages from truth to view, nanoseconds.
//!
//! Ten thousand bodies that fly, each struck at intervals, at the 5 cm tier (`rhumb_bench::cost::decoding`). Times are
//! per pass over all bodies. `predict` and `view` process every body. `encode` tests every body and sends about a
//! tenth. `decode` reads that tenth, whose bodies had no aliases before; `decode in the midst` reads twenty ticks in
//! mid-run.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use rhumb_bench::cost::decoding::{
    DecodeLoad, RenderLoad, first_observations, publisher, subscriber,
};
use rhumb_reckoning::{BodyId, Tick};

const BODIES: u32 = 10_000;

fn stages(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("10,000 bodies");
    group.throughput(Throughput::Elements(u64::from(BODIES)));
    group.bench_function("predict", |bencher| {
        let subscriber = subscriber(BODIES);
        bencher.iter(|| {
            for index in 0..BODIES {
                black_box(subscriber.predicted_motion(BodyId::new(index, 0), Tick::new(30)));
            }
        });
    });
    group.bench_function("encode", |bencher| {
        let observation_history = first_observations(BODIES);
        bencher.iter_batched_ref(
            || publisher(BODIES),
            |publisher| {
                let mut out = Vec::new();
                publisher.publish(&observation_history, 0, &mut out);
                out
            },
            BatchSize::LargeInput,
        );
    });
    group.bench_function("view", |bencher| {
        let mut show = RenderLoad::new(BODIES);
        bencher.iter(|| show.refresh());
    });
    let loads = [
        ("decode", DecodeLoad::new(BODIES)),
        ("decode in the midst", DecodeLoad::in_mid_run(BODIES)),
    ];
    for (name, load) in loads {
        group.throughput(Throughput::Elements(load.updates));
        group.bench_function(name, |bencher| {
            bencher.iter_batched_ref(
                || load.subscriber.clone(),
                |subscriber| load.decode(subscriber),
                BatchSize::LargeInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, stages);
criterion_main!(benches);
