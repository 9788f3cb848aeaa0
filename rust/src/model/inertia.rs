//! Inertia matrix `M(q)` by composite bodies, rotors and coupled motors included, and where it is positive definite.
//!
//! Link `j` and all that it carries move as one body when only joint `j` accelerates; the wrench that this body needs,
//! seen along the earlier axes, is column `j`. Identities that test it: `M` is symmetric by construction and its columns are
//! those of the inverse model, `tau(q, 0, e_j) - tau(q, 0, 0)`; independently, Pinocchio's `crba`.
//!
//! `x -> M(q, x)` is linear, so the parameters with `M > 0` at given positions are a convex cone: between a vector
//! inside and any other there is a [`largest_safe_step`].

use crate::ground::arrays::MAX_DOF;
use crate::ground::arrays::ShapeError;
use crate::ground::arrays::check_length;
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::Lanes;
use crate::model::links::{Links, Lower};
use crate::robot::Robot;
use crate::robot::arm::At;
use crate::robot::geometry::{Frames, Geometry};
use crate::robot::parameters::Layout;
use nalgebra::{DMatrix, SymmetricEigen};

/// `M(q)` of `L` positions or candidates into `matrix`.
#[inline(always)]
fn inertia_matrix_lanes<const L: usize, const F: bool>(
    geometry: &Geometry,
    links: &Links<L, F>,
    frames: &Frames<L, F>,
    matrix: &mut Lower<L, F>,
) {
    let n = geometry.n();
    let mut body = links.bodies[n - 1];
    for j in (0..n).rev() {
        let mut wrench = body.unit_wrench(geometry.step(At(j)).form.turns);
        for i in (0..=j).rev() {
            let step = &geometry.step(At(i));
            matrix[j][i] = links.rotors[j][i] + wrench.felt(step.form.turns);
            if i > 0 {
                wrench = wrench.moved_in(At(i), step, frames.pose(i));
            }
        }
        if j > 0 {
            body = body.moved_in(At(j), &geometry.step(At(j)), frames.pose(j), &links.bodies[j - 1]);
        }
    }
}

struct Batch<'a> {
    robot: &'a Robot,
    q: &'a [f64],
    x: &'a [f64],
    matrices: &'a mut [f64],
}

impl Kernel for Batch<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const L: usize, const F: bool>(self) {
        let geometry = Geometry::of(self.robot);
        let n = geometry.n();
        let links = Links::<L, F>::of_one(self.robot, &geometry, self.x);
        let (mut frames, mut q) = (Frames::new(&geometry), [Lanes::zero(); MAX_DOF]);
        let mut matrix = [[Lanes::zero(); MAX_DOF]; MAX_DOF];
        for (block, out) in self.matrices.chunks_mut(n * n * L).enumerate() {
            for j in 0..n {
                q[j] = Lanes::gather(self.q, n, block * L, j);
            }
            frames.place(&geometry, &q);
            inertia_matrix_lanes(&geometry, &links, &frames, &mut matrix);
            for (l, sample) in out.chunks_mut(n * n).enumerate() {
                for i in 0..n {
                    for j in 0..n {
                        sample[i * n + j] = matrix[i.max(j)][i.min(j)].0[l];
                    }
                }
            }
        }
    }
}

/// `M(q)` (kg.m^2, kg.m, kg; joint side) of a batch: `q` is row-major `(n_samples, n_dof)`, the result `(n_samples, n_dof, n_dof)`.
pub fn inertia_matrix(robot: &Robot, q: &[f64], x: &[f64], matrices: &mut [f64]) -> Result<(), ShapeError> {
    check_length("x", x, Layout::of(robot).count())?;
    check_length("matrices", matrices, q.len() * robot.n_dof())?;
    if !q.is_empty() {
        dispatch(Batch { robot, q, x, matrices });
    }
    Ok(())
}

/// The smallest eigenvalue of `M(q)` in a batch, and the sample it belongs to; None for an empty batch.
pub fn smallest_eigenvalue(robot: &Robot, q: &[f64], x: &[f64]) -> Result<Option<(usize, f64)>, ShapeError> {
    let n = robot.n_dof();
    let mut matrices = vec![0.0; q.len() * n];
    inertia_matrix(robot, q, x, &mut matrices)?;
    let smallest = matrices
        .chunks_exact(n * n)
        .map(|matrix| SymmetricEigen::new(DMatrix::from_row_slice(n, n, matrix)).eigenvalues.min())
        .enumerate()
        .min_by(|a, b| a.1.total_cmp(&b.1));
    Ok(smallest)
}

/// The largest step `a` in (0, 1] with `M(q, x + a (target - x)) >= margin M(q, x)` at every position of a batch.
///
/// With `M(x) = G G'`, the matrix at the step is `G (1 + a E) G'`, where `E = G^-1 (M(target) - M(x)) G^-T`; its smallest
/// eigenvalue `e < 0` allows `a = (1 - margin) / -e`. `x` must itself be inside: otherwise the step is 0.
pub fn largest_safe_step(
    robot: &Robot,
    q: &[f64],
    x: &[f64],
    target: &[f64],
    margin: f64,
) -> Result<f64, ShapeError> {
    let n = robot.n_dof();
    let (mut here, mut there) = (vec![0.0; q.len() * n], vec![0.0; q.len() * n]);
    inertia_matrix(robot, q, x, &mut here)?;
    inertia_matrix(robot, q, target, &mut there)?;
    let mut step: f64 = 1.0;
    for (here, there) in here.chunks_exact(n * n).zip(there.chunks_exact(n * n)) {
        let (here, there) = (DMatrix::from_row_slice(n, n, here), DMatrix::from_row_slice(n, n, there));
        let Some(cholesky) = here.clone().cholesky() else { return Ok(0.0) };
        let factor = cholesky.l();
        let change = there - here;
        let Some(half) = factor.solve_lower_triangular(&change) else { return Ok(0.0) };
        let Some(whole) = factor.solve_lower_triangular(&half.transpose()) else { return Ok(0.0) };
        let smallest = SymmetricEigen::new(whole).eigenvalues.min();
        if smallest < 0.0 {
            step = step.min((1.0 - margin) / -smallest);
        }
    }
    Ok(step)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::inverse::inverse_dynamics;
    use crate::model::links::tests::{parameters, polar, robot};

    /// Positions of all joints, within two rad or m.
    fn positions(n: usize, samples: usize) -> Vec<f64> {
        (0..samples * n).map(|k| (1.3 * k as f64 + 0.4).sin() * 2.0).collect()
    }

    #[test]
    fn columns_are_those_of_the_inverse_model() {
        let (o, i) = (false, true);
        for slides in [
            vec![o],
            vec![i],
            vec![o, i, o],
            vec![i, i, i],
            vec![o; 6],
            vec![i, o, o, i, o, o],
            vec![o, o, i, o, o, i, o, o],
        ] {
            let robot = robot(&slides);
            let (n, samples, x) = (slides.len(), 6, parameters(&robot));
            let (q, still) = (positions(n, samples), vec![0.0; samples * n]);
            let torques = |ddq: &[f64]| {
                let mut tau = still.clone();
                inverse_dynamics(&robot, &q, &still, ddq, &x, &mut tau).unwrap();
                tau
            };
            let at_rest = torques(&still);
            let mut matrices = vec![0.0; samples * n * n];
            inertia_matrix(&robot, &q, &x, &mut matrices).unwrap();
            for j in 0..n {
                let unit: Vec<f64> = (0..samples * n).map(|k| if k % n == j { 1.0 } else { 0.0 }).collect();
                for (row, (tau, rest)) in torques(&unit).iter().zip(&at_rest).enumerate() {
                    let (got, want) = (matrices[row * n + j], tau - rest);
                    assert!(
                        (got - want).abs() < 1e-11 * (1.0 + tau.abs()),
                        "{slides:?} {row} {j}: {got} {want}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_smallest_eigenvalue_is_that_of_its_sample() {
        let q = [0.3, 0.5, 0.1, 1.0, -0.2, -2.0, 0.0, 3.0, 0.7, 0.2];
        // 4 - 0.4 q^2 is smallest at q = 3; the other is 1.6 everywhere.
        let (robot, x) = polar([4.0, -0.4, 2.0]);
        let (sample, value) = smallest_eigenvalue(&robot, &q, &x).unwrap().unwrap();
        assert!(sample == 3 && (value - 0.4).abs() < 1e-14, "{sample} {value}");
        // Here it is the slider's own, and with a negative rotor below zero.
        let (robot, x) = polar([4.0, 0.5, -0.75]);
        let (_, value) = smallest_eigenvalue(&robot, &q, &x).unwrap().unwrap();
        assert!((value + 0.25).abs() < 1e-14, "{value}");
        assert_eq!(smallest_eigenvalue(&robot, &[], &x).unwrap(), None);
    }

    #[test]
    fn a_safe_step_ends_where_the_closed_form_has_the_margin() {
        let q = [0.3, 0.5, 0.1, -2.0, -0.2, 1.0];
        let (robot, x) = polar([4.0, 2.0, 5.0]);
        let step = |target: [f64; 3]| largest_safe_step(&robot, &q, &x, &polar(target).1, 0.1).unwrap();
        // At q = 2: 4 + 4 (2 - 5 a) = 0.1 (4 + 8).
        assert!((step([4.0, -3.0, 5.0]) - 0.54).abs() < 1e-14);
        // The slider: 7 - 28 a = 0.7.
        assert!((step([4.0, 2.0, -23.0]) - 0.225).abs() < 1e-14);
        assert_eq!(step([5.0, 2.5, 4.0]), 1.0);
        let outside = polar([4.0, -3.0, 5.0]).1;
        assert_eq!(largest_safe_step(&robot, &q, &outside, &x, 0.1).unwrap(), 0.0);
    }

    #[test]
    fn a_safe_step_ends_where_any_robot_has_the_margin() {
        for slides in [vec![false; 3], vec![false, true, false], vec![true, false, false, true]] {
            let robot = robot(&slides);
            let (q, x) = (positions(slides.len(), 9), parameters(&robot));
            let target: Vec<f64> = x.iter().enumerate().map(|(k, x)| x * (k as f64 + 0.5).cos()).collect();
            for margin in [0.0, 0.3] {
                let step = largest_safe_step(&robot, &q, &x, &target, margin).unwrap();
                assert!(step > 0.0 && step < 1.0, "{slides:?}: {step}");
                // M is linear in the parameters: what is left above the margin is M of these.
                let left = |a: f64| {
                    let above: Vec<f64> =
                        x.iter().zip(&target).map(|(x, t)| x + a * (t - x) - margin * x).collect();
                    smallest_eigenvalue(&robot, &q, &above).unwrap().unwrap().1
                };
                assert!(left(step).abs() < 1e-12, "{slides:?}: {}", left(step));
                assert!(left(0.99 * step) > 1e-6 && left(1.01 * step) < -1e-6, "{slides:?}");
            }
        }
    }

    #[test]
    fn arrays_that_do_not_fit_are_named() {
        let (robot, x) = polar([4.0, 2.0, 5.0]);
        let message = |q: &[f64], x: &[f64], length: usize| {
            inertia_matrix(&robot, q, x, &mut vec![0.0; length]).unwrap_err().to_string()
        };
        assert_eq!(message(&[0.0; 4], &x[1..], 8), "x has 27 numbers where 28 are needed");
        assert_eq!(message(&[0.0; 4], &x, 4), "matrices has 4 numbers where 8 are needed");
        let step = |x: &[f64], target: &[f64]| largest_safe_step(&robot, &[0.0; 4], x, target, 0.1);
        assert_eq!(step(&x, &x[2..]).unwrap_err().to_string(), "x has 26 numbers where 28 are needed");
        assert!(step(&x[1..], &x).is_err());
        assert!(smallest_eigenvalue(&robot, &[0.0; 4], &x[1..]).is_err());
    }
}
