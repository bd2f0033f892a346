//! Criterion benches of scenes: publishing, sessions, joining, adding.

mod support;

use std::cell::LazyCell;
use std::time::Duration;

use criterion::{BatchSize, Criterion, SamplingMode};
use rhumb_bench::setup::{
    AddLoad, HandOverLoad, JoinLoad, ObservedRun, PublishCost, SCENARIOS, SleepLoad, TIERS,
};
use rhumb_reckoning::Tolerance;

use support::{Group, ProcessorTime, bodies, criterion, quick};

/// Members of a scene whose ticks are handed over.
const MEMBERS: [usize; 3] = [1, 8, 32];

fn main() {
    let mut criterion = criterion();
    publishing(&mut criterion);
    asleep(&mut criterion);
    hand_over(&mut criterion);
    joining(&mut criterion);
    adding(&mut criterion);
    criterion.final_summary();
}

/// Work on all measured ticks of a run, for streams of these tiers.
type Work = fn(&ObservedRun, &[Tolerance]) -> PublishCost;

/// A mean tick of each scene's run: choosing updates alone, then with their encoding.
fn publishing(criterion: &mut Criterion<ProcessorTime>) {
    let works: [(&str, Work); 2] = [
        ("choose", ObservedRun::choose),
        ("publish", ObservedRun::publish),
    ];
    for scenario in &SCENARIOS {
        let run = LazyCell::new(|| {
            let run = ObservedRun::record(scenario, bodies(), &mut || ());
            run.expect("the scene runs")
        });
        for (name, work) in works {
            let mut group = slow(criterion, name);
            for tiers in TIERS {
                let id = format!("{}-{}", scenario.name, streams(tiers.len()));
                group.bench_function(id, |bencher| {
                    bencher.iter_custom(|iterations| {
                        let ticks = (0..iterations).map(|_| work(&run, tiers).tick);
                        ticks.sum::<Duration>()
                    });
                });
            }
            group.finish();
        }
    }
}

fn streams(count: usize) -> String {
    match count {
        1 => "one-tier".to_owned(),
        4 => "four-tiers".to_owned(),
        more => format!("{more}-tiers"),
    }
}

fn asleep(criterion: &mut Criterion<ProcessorTime>) {
    let mut load = LazyCell::new(|| SleepLoad::new(bodies()));
    let mut group = quick(criterion, "publish");
    group.bench_function("asleep-one-tier", |bencher| bencher.iter(|| load.publish()));
    group.finish();
}

/// A tick through the server's sessions and those of all members.
fn hand_over(criterion: &mut Criterion<ProcessorTime>) {
    let mut group = quick(criterion, "hand-over");
    for members in MEMBERS {
        let mut load = LazyCell::new(|| {
            let load = HandOverLoad::new(members);
            assert!(load.received() > 0, "the last member has the ball");
            load
        });
        let id = format!("members-{members}");
        group.bench_function(id, |bencher| bencher.iter(|| load.tick()));
    }
    group.finish();
}

fn joining(criterion: &mut Criterion<ProcessorTime>) {
    let load = LazyCell::new(|| JoinLoad::new(bodies()).expect("the scene takes its bodies"));
    let mut group = slow(criterion, "join");
    group.bench_function("moving-bodies", |bencher| {
        // One client at a time: it leaves before the next one joins.
        bencher.iter_batched(
            || (),
            |()| load.join().expect("the scene admits a member"),
            BatchSize::PerIteration,
        );
    });
    group.finish();
}

fn adding(criterion: &mut Criterion<ProcessorTime>) {
    let mut group = slow(criterion, "add");
    group.bench_function("bodies", |bencher| {
        let fresh = || AddLoad::new(bodies()).expect("the server makes a scene");
        let add = |load: &mut AddLoad| {
            let shown = load.add().expect("the scene takes the bodies");
            assert_eq!(shown, bodies() as usize, "the view has all of them");
        };
        bencher.iter_batched_ref(fresh, add, BatchSize::PerIteration);
    });
    group.finish();
}

/// A group of work that takes a good part of a second: ten samples.
fn slow<'c>(criterion: &'c mut Criterion<ProcessorTime>, name: &str) -> Group<'c> {
    let mut group = criterion.benchmark_group(name);
    group
        .sample_size(10)
        .sampling_mode(SamplingMode::Flat)
        .warm_up_time(Duration::from_millis(1))
        .measurement_time(Duration::from_millis(3_000));
    group
}
