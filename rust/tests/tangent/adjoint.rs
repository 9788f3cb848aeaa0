//! Gradients of contractions of the regressor against dual numbers.

use crate::common::arms::{frictions, robot};
use crate::common::partials::partials;
use didim::robot::parameters::Layout;
use didim::robot::{Friction, Robot};
use didim::tangent::adjoint::{Gradient, contraction_gradient};

/// Torque of joint `i` with a row as parameters, differentiated: positions and velocities by dual numbers, accelerations by
/// the regressor's linearity in them.
fn expected(robot: &Robot, q: &[f64], dq: &[f64], ddq: &[f64], g: &[f64]) -> [Vec<f64>; 3] {
    let (n, p) = (robot.n_dof(), Layout::of(robot).count());
    let mut want = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
    for (i, row) in g.chunks_exact(p).enumerate() {
        let at = partials(robot, row, q, dq, ddq);
        for j in 0..n {
            want[0][j] += at.position[i][j];
            want[1][j] += at.velocity[i][j];
            let mut more = ddq.to_vec();
            more[j] += 1.0;
            want[2][j] += partials(robot, row, q, dq, &more).tau[i] - at.tau[i];
        }
    }
    want
}

#[test]
fn the_gradient_is_that_of_the_inverse_models_with_the_rows_as_parameters() {
    for friction in frictions() {
        let robot = robot(friction);
        let (n, samples) = (4, 7);
        let p = Layout::of(&robot).count();
        let wave = |a: f64, count: usize| -> Vec<f64> {
            (0..count).map(|k| (a * (k * k) as f64 + a).sin()).collect()
        };
        let (q, dq, ddq) = (wave(0.7, n * samples), wave(1.1, n * samples), wave(1.7, n * samples));
        let g = wave(0.37, n * p * samples);
        let [mut gq, mut gdq, mut gddq] = [(); 3].map(|()| vec![0.0; n * samples]);
        let out = Gradient { q: &mut gq, dq: &mut gdq, ddq: &mut gddq };
        contraction_gradient(&robot, &q, &dq, &ddq, &g, out).unwrap();
        for s in 0..samples {
            let at = s * n..(s + 1) * n;
            let rows = &g[s * n * p..(s + 1) * n * p];
            let want = expected(&robot, &q[at.clone()], &dq[at.clone()], &ddq[at.clone()], rows);
            for (kind, (got, want)) in [&gq, &gdq, &gddq].into_iter().zip(&want).enumerate() {
                for (j, (got, want)) in got[at.clone()].iter().zip(want).enumerate() {
                    assert!(
                        (got - want).abs() < 1e-11 * (1.0 + want.abs()),
                        "sample {s}, derivative {kind}, joint {j}: {got} {want}, {:?}",
                        robot.friction()
                    );
                }
            }
        }
    }
}

#[test]
fn arrays_that_do_not_fit_are_named() {
    let robot = robot(Friction::sign(4));
    let [mut a, mut b, mut c] = [(); 3].map(|()| vec![0.0; 4]);
    let mut message = |dq: &[f64], g: &[f64], short: usize| {
        let out = Gradient { q: &mut a, dq: &mut b, ddq: &mut c[short..] };
        contraction_gradient(&robot, &[0.0; 4], dq, &[0.0; 4], g, out).unwrap_err().to_string()
    };
    let g = vec![0.0; 4 * Layout::of(&robot).count()];
    assert_eq!(message(&[0.0; 3], &g, 0), "dq has 3 numbers where 4 are needed");
    assert_eq!(
        message(&[0.0; 4], &g[1..], 0),
        format!("g has {} numbers where {} are needed", g.len() - 1, g.len())
    );
    assert_eq!(message(&[0.0; 4], &g, 1), "the gradient of ddq has 3 numbers where 4 are needed");
}
