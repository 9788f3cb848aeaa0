//! The observation matrix (6) against the regressor, filtered column by column.

use crate::common::bodies::{robot, with_friction};
use crate::common::filters::stage;
use didim::model::regressor::regressor;
use didim::robot::Friction;
use didim::robot::Robot;
use didim::robot::parameters::{INERTIAL, Layout};
use didim::signal::filter::{Row, Stage, Workspace, output_length, zero_phase_lanes};
use didim::signal::observation::{Log, decimate, observation};

const SAMPLES: usize = 57;

/// Sliding and turning joints, the last motor coupled; friction of either shape.
fn robots() -> [Robot; 3] {
    let six = robot(&[false, true, false, false, false, false]);
    let friction = Friction { asymmetric: true, ..six.friction().clone() };
    let asymmetric = with_friction(&six, friction);
    [robot(&[true]), six, asymmetric]
}

fn motion(robot: &Robot) -> [Vec<f64>; 3] {
    let count = SAMPLES * robot.n_dof();
    [1.1, 0.7, 1.7].map(|a| (0..count).map(|k| (a * k as f64 + a).sin() * 2.0).collect())
}

fn log(motion: &[Vec<f64>; 3]) -> Log<'_> {
    let [q, dq, ddq] = motion;
    Log { q, dq, ddq, load: &[] }
}

fn filtered(column: Vec<f64>, stages: &[Stage]) -> Vec<f64> {
    let mut column: Vec<Row<1>> = column.into_iter().map(|value| Row([value])).collect();
    let kept = zero_phase_lanes(&mut column, stages, &mut Workspace::new());
    column[..kept].iter().map(|row| row.0[0]).collect()
}

/// The definition: the whole regressor, then each column of each joint through the filter.
fn by_definition(robot: &Robot, log: Log<'_>, columns: &[usize], stages: &[Stage]) -> Vec<f64> {
    let (n, p) = (robot.n_dof(), Layout::of(robot).count());
    let mut w = vec![0.0; SAMPLES * n * p];
    regressor(robot, log.q, log.dq, log.ddq, &mut w).unwrap();
    let series = |column: usize, j: usize| (0..SAMPLES).map(|k| w[(k * n + j) * p + column]).collect();
    let rows = columns.iter().flat_map(|&column| (0..n).map(move |j| (column, j)));
    rows.flat_map(|(column, j)| filtered(series(column, j), stages)).collect()
}

#[test]
fn columns_are_those_of_the_regressor_filtered() {
    let kept = [stage(2, 9, 3, 1), stage(5, 4, 2, 0)];
    for robot in robots() {
        let motion = motion(&robot);
        let count = Layout::of(&robot).count();
        let all: Vec<usize> = (0..count).collect();
        // Some only, in any order, and those of the drives alone.
        let some: Vec<usize> = all.iter().rev().copied().filter(|k| k % 3 != 1).collect();
        let drives: Vec<usize> = all.iter().copied().filter(|k| k % 14 >= INERTIAL).collect();
        for columns in [&all, &some, &drives, &vec![]] {
            for stages in [&kept[..0], &kept[1..], &kept] {
                let got = observation(&robot, log(&motion), columns, stages, 1).unwrap();
                let want = by_definition(&robot, log(&motion), columns, stages);
                assert_eq!(got.len(), columns.len() * robot.n_dof() * output_length(SAMPLES, stages));
                assert_eq!(got.len(), want.len());
                for (got, want) in got.iter().zip(&want) {
                    assert!((got - want).abs() < 1e-12 * (1.0 + want.abs()), "{got} {want}");
                }
            }
        }
    }
}

#[test]
fn threads_do_not_change_a_bit() {
    let [_, robot, _] = robots();
    let motion = motion(&robot);
    let columns: Vec<usize> = (0..Layout::of(&robot).count()).collect();
    let run = |threads| observation(&robot, log(&motion), &columns, &[stage(4, 9, 3, 1)], threads).unwrap();
    let one = run(1);
    for threads in [2, 3, 8] {
        assert_eq!(run(threads), one);
    }
}

#[test]
fn decimation_is_the_filter_of_each_column() {
    let stages = [stage(3, 7, 2, 1), stage(1, 3, 3, 0)];
    for width in [1, 8, 11] {
        let signals: Vec<f64> = (0..SAMPLES * width).map(|k| (0.37 * (k * k) as f64).sin()).collect();
        let columns: Vec<Vec<f64>> = (0..width)
            .map(|c| filtered(signals.iter().skip(c).step_by(width).copied().collect(), &stages))
            .collect();
        let want: Vec<f64> =
            (0..columns[0].len()).flat_map(|k| columns.iter().map(move |column| column[k])).collect();
        for threads in [1, 2] {
            assert_eq!(decimate(&signals, width, &stages, threads).unwrap(), want);
        }
    }
    assert!(decimate(&[], 0, &[], 1).unwrap().is_empty());
}

#[test]
fn what_does_not_fit_is_named() {
    let [robot, ..] = robots();
    let motion = motion(&robot);
    let log = log(&motion);
    let message = |log: Log<'_>, columns: &[usize], stages: &[Stage]| {
        observation(&robot, log, columns, stages, 1).unwrap_err().to_string()
    };
    let short = Log { dq: &log.dq[1..], ..log };
    assert_eq!(message(short, &[0], &[]), "dq has 56 numbers where 57 are needed");
    let long = Log { q: &log.q[2..], ..log };
    assert_eq!(message(long, &[0], &[]), "dq has 57 numbers where 55 are needed");
    assert_eq!(message(log, &[3, 14], &[]), "column 14 does not exist: the robot has 14 standard parameters");
    assert!(message(log, &[0], &[stage(1, SAMPLES, 1, 0)]).contains("needs more than 57 samples"));
    let error = decimate(log.q, 1, &[stage(1, 2, 40, 0), stage(1, 2, 1, 0)], 1).unwrap_err();
    assert!(error.to_string().contains("filter stage 1 needs more than 2 samples"), "{error}");
}
