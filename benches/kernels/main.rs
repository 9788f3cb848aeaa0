//! `cargo bench`: times of the kernels that a fit spends its time in, on the TX40's geometry; `cargo bench -- --instructions`:
//! instructions of the hottest; `cargo bench -- --roofline`: how near they are to the limit of the machine. Speed as ratios to peers is
//! for `docs/performance.md`; times here compare before and after a change on one machine.

mod instructions;
mod roofline;
mod tx40;

use criterion::{Criterion, Throughput};
use didim::model::direct::direct_dynamics;
use didim::regression::base::base_parameters;
use didim::signal::observation::{Log, observation};
use std::error::Error;
use std::hint::black_box;
use tx40::{Batch, ClosedLoop, FEW, SAMPLES, STEPS};

fn kernels(criterion: &mut Criterion) {
    let mut batch = Batch::new();
    let mut group = criterion.benchmark_group("tx40");
    group.throughput(Throughput::Elements(SAMPLES as u64));
    group.bench_function("inverse dynamics", |bencher| bencher.iter(|| batch.inverse_dynamics()));
    let mut out = vec![0.0; SAMPLES * 6];
    group.bench_function("direct dynamics", |bencher| {
        let Batch { robot, q, dq, tau, x, .. } = &batch;
        bencher.iter(|| direct_dynamics(robot, q, dq, tau, x, black_box(&mut out)).expect("shapes fit"));
    });
    group.throughput(Throughput::Elements(FEW as u64));
    group.bench_function("regressor", |bencher| bencher.iter(|| batch.regressor()));
    group.throughput(Throughput::Elements(SAMPLES as u64));
    let columns = base_parameters(&batch.robot).expect("the TX40 has base parameters").kept;
    group.bench_function("observation matrix, 60 columns, no filter, 1 thread", |bencher| {
        let Batch { robot, q, dq, ddq, .. } = &batch;
        let log = Log { q, dq, ddq, load: &[] };
        bencher.iter(|| observation(robot, black_box(log), &columns, &[], 1).expect("shapes fit"));
    });
    group.finish();
}

/// The time is that of a step and lane.
fn closed_loop(criterion: &mut Criterion) {
    let closed_loop = ClosedLoop::new();
    let mut group = criterion.benchmark_group("tx40, closed loop, one step and lane");
    let mut time = |lanes: usize, run: &dyn Fn()| {
        group.throughput(Throughput::Elements((STEPS * lanes) as u64));
        group.bench_function(format!("{lanes} lanes"), |bencher| bencher.iter(run));
    };
    time(1, &|| closed_loop.run::<1>());
    time(4, &|| closed_loop.run::<4>());
    time(8, &|| closed_loop.run::<8>());
    group.finish();
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    if let Some(("--instructions", rest)) = arguments.split_first().map(|(first, rest)| (&**first, rest)) {
        return instructions::main(rest);
    }
    if arguments.first().is_some_and(|first| first == "--roofline") {
        return roofline::main();
    }
    let mut criterion = Criterion::default().configure_from_args();
    kernels(&mut criterion);
    closed_loop(&mut criterion);
    criterion.final_summary();
    Ok(())
}
