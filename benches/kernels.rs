//! `cargo bench`: the kernels that a fit spends its time in, on the TX40's geometry. Speed as ratios to peers is
//! for `docs/performance.md`; these numbers are for before and after a change on one machine.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use didim::base::base_parameters;
use didim::inverse::inverse_dynamics;
use didim::observation::{Log, observation};
use didim::parameters::Layout;
use didim::regressor::regressor;
use didim::robot::{Friction, Joint, JointKind, Robot};
use std::f64::consts::{FRAC_PI_2, PI};
use std::hint::black_box;

const SAMPLES: usize = 4096;

/// Table I, with the coupled wrist.
fn tx40() -> Robot {
    let rows = [
        (0.0, 0.0, 0.0, 0.0),
        (-FRAC_PI_2, 0.0, -FRAC_PI_2, 0.0),
        (0.0, 0.225, FRAC_PI_2, 0.035),
        (FRAC_PI_2, 0.0, 0.0, 0.225),
        (-FRAC_PI_2, 0.0, 0.0, 0.0),
        (FRAC_PI_2, 0.0, PI, 0.0),
    ];
    let joints = rows
        .iter()
        .map(|&(alpha, d, theta, r)| Joint { kind: JointKind::Revolute, alpha, d, theta, r })
        .collect();
    let coupling: Vec<Vec<f64>> =
        (0..6).map(|m| (0..6).map(|j| f64::from(u8::from(m == j || (m, j) == (5, 4)))).collect()).collect();
    Robot::new(joints, [0.0, 0.0, -9.81], &coupling, Friction::sign(6)).expect("Table I is a robot")
}

fn kernels(criterion: &mut Criterion) {
    let robot = tx40();
    let motion = |scale: f64| -> Vec<f64> {
        (0..SAMPLES * 6).map(|k| scale * ((k / 6) as f64 * 0.01 + (k % 6) as f64).sin()).collect()
    };
    let (q, dq, ddq) = (motion(1.0), motion(2.0), motion(5.0));
    let p = Layout::of(&robot).count();
    let x: Vec<f64> = (0..p).map(|k| 0.1 + k as f64 * 0.01).collect();
    let columns = base_parameters(&robot).expect("the TX40 has base parameters").kept;

    let mut group = criterion.benchmark_group("tx40");
    group.throughput(Throughput::Elements(SAMPLES as u64));
    let mut tau = vec![0.0; SAMPLES * 6];
    group.bench_function("inverse dynamics", |bencher| {
        bencher.iter(|| {
            inverse_dynamics(&robot, &q, &dq, &ddq, &x, black_box(&mut tau)).expect("shapes fit");
        });
    });
    // 64 samples of the regressor fill 264 kB: a buffer that stays in the second-level cache.
    let few = 64 * 6;
    let mut w = vec![0.0; few * p];
    group.throughput(Throughput::Elements(64));
    group.bench_function("regressor", |bencher| {
        bencher.iter(|| {
            regressor(&robot, &q[..few], &dq[..few], &ddq[..few], black_box(&mut w)).expect("shapes fit");
        });
    });
    group.throughput(Throughput::Elements(SAMPLES as u64));
    group.bench_function("observation matrix, 60 columns, no filter, 1 thread", |bencher| {
        let log = Log { q: &q, dq: &dq, ddq: &ddq };
        bencher.iter(|| observation(&robot, black_box(log), &columns, &[], 1).expect("shapes fit"));
    });
    group.finish();
}

criterion_group!(benches, kernels);
criterion_main!(benches);
