//! `cargo bench`: the kernels that a fit spends its time in, on the TX40's geometry. Speed as ratios to peers is
//! for `docs/performance.md`; these numbers are for before and after a change on one machine.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use didim::base::base_parameters;
use didim::cancel::Cancel;
use didim::control::{Controller, Law, Timing};
use didim::direct::direct_dynamics;
use didim::inverse::inverse_dynamics;
use didim::observation::{Log, observation};
use didim::parameters::Layout;
use didim::reference::{Fourier, Reference};
use didim::regressor::regressor;
use didim::robot::{Friction, Joint, JointKind, Robot};
use didim::schedule::{Plan, Schedule};
use didim::simulate::{Candidate, Cost, Measured, Simulation, run_group};
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
    let mut out = vec![0.0; SAMPLES * 6];
    group.bench_function("direct dynamics", |bencher| {
        bencher.iter(|| {
            direct_dynamics(&robot, &q, &dq, &tau, &x, black_box(&mut out)).expect("shapes fit");
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

/// One second of the closed loop in steps of 1 ms; the time is that of a step and lane.
fn closed_loop(criterion: &mut Criterion) {
    let robot = tx40();
    let robot = Robot::new(
        robot.joints().to_vec(),
        robot.gravity(),
        robot.transmission(),
        Friction { smoothing: vec![0.01; 6], ..Friction::sign(6) },
    )
    .expect("as before");
    let p = Layout::of(&robot).count();
    let x: Vec<f64> = (0..p).map(|k| if k % 14 == 5 || k % 14 == 10 { 1.0 } else { 0.01 }).collect();
    let amplitude = [0.5; 6];
    let series = Fourier { period: 1.0, offset: &[0.0; 6], sine: &amplitude, cosine: &[0.0; 6] };
    let reference = Reference::fourier(6, series, 1.0, 1000).expect("a reference");
    let law = Law {
        position: 1000.0,
        velocity: 50.0,
        integral: 0.0,
        acceleration: 0.0,
        reference_velocity: 1.0,
        integrated_position: 1.0,
        integrated_velocity: 0.0,
        limit: f64::INFINITY,
        gain: 1.0,
    };
    let controller = Controller::new(vec![law; 6], Timing::Continuous, None).expect("a controller");
    let plan = Plan {
        rate: 1000.0,
        records: 1001,
        period: None,
        coarse: 1e-3,
        fine: &[1e-3; 6],
        slow: &[0.0; 6],
        motion: None,
    };
    let schedule = Schedule::new(&robot, &reference, plan).expect("a schedule");
    let simulation = Simulation {
        robot: &robot,
        reference: &reference,
        controller: &controller,
        schedule: &schedule,
        external: None,
        start: None,
        divergence: 100.0,
    };
    let zeros = vec![0.0; 6006];
    let measured = Measured { q: &zeros, tau: &zeros, weight_q: &[1.0; 6], weight_tau: &[0.0; 6] };
    let candidate = Candidate { x: &x, scale: &[1.0; 6] };
    let candidates = [candidate; 8];
    let mut group = criterion.benchmark_group("tx40, closed loop, one step and lane");
    let mut time = |lanes: usize, run: &mut dyn FnMut(&mut Cost<'_>)| {
        group.throughput(Throughput::Elements(1000 * lanes as u64));
        group.bench_function(format!("{lanes} lanes"), |bencher| {
            bencher.iter(|| run(black_box(&mut Cost::new(measured, 6))));
        });
    };
    let never = Cancel::never();
    time(1, &mut |cost| drop(run_group::<1>(simulation, &candidates[..1], &never, cost)));
    time(4, &mut |cost| drop(run_group::<4>(simulation, &candidates[..4], &never, cost)));
    time(8, &mut |cost| drop(run_group::<8>(simulation, &candidates, &never, cost)));
    group.finish();
}

criterion_group!(benches, kernels, closed_loop);
criterion_main!(benches);
