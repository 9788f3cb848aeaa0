//! Inertia matrix `M(q)` by composite bodies, rotors and coupled motors included, and where it is positive definite.
//!
//! Link `j` and all that it carries move as one body when only joint `j` accelerates; the wrench that this body needs,
//! seen along the axes that carry it, is column `j`; between branches there are at most rotors. Identities that test it: `M` is symmetric by construction and its columns are
//! those of the inverse model, `tau(q, 0, e_j) - tau(q, 0, 0)`; independently, Pinocchio's `crba`.
//!
//! `x -> M(q, x)` is linear, so the parameters with `M > 0` at given positions are a convex cone: between a vector
//! inside and any other there is a [`largest_safe_step`].

use crate::ground::arrays::MAX_DOF;
use crate::ground::arrays::ShapeError;
use crate::ground::arrays::check_length;
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::model::bodies::Body;
use crate::model::links::Links;
use crate::robot::Robot;
use crate::robot::arm::{Any, Arm, At, Square};
use crate::robot::geometry::{Frames, Geometry};
use crate::robot::parameters::Layout;
use nalgebra::{DMatrix, SymmetricEigen};

/// `M(q)` of `L` positions or candidates into `matrix`, whose entries between branches are those of the rotors already.
#[inline(always)]
pub(super) fn inertia_matrix_lanes<V: Set, S: Arm, M: Square<Lanes<V>>>(
    geometry: &Geometry<S>,
    bodies: &[Body<V>; MAX_DOF],
    rotors: &M,
    frames: &Frames<V>,
    composites: &mut [Body<V>; MAX_DOF],
    matrix: &mut M,
) {
    for j in (0..geometry.n()).rev() {
        let step = &geometry.step(At(j));
        let body = if step.form.leaf { &bodies[j] } else { &composites[j] };
        let mut wrench = body.unit_wrench(step.form.turns);
        let mut i = j;
        loop {
            let step = &geometry.step(At(i));
            matrix[j][i] = rotors[j][i] + wrench.felt(step.form.turns);
            if step.form.root {
                break;
            }
            wrench = wrench.moved_in(At(i), step, frames.pose(i));
            i = step.before(At(i));
        }
        if !step.form.root {
            let parent = step.before(At(j));
            let link = if step.form.joins { &composites[parent] } else { &bodies[parent] };
            composites[parent] = body.moved_in(At(j), step, frames.pose(j), link);
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
    fn run<V: Set>(self) {
        let geometry = self.robot.geometry();
        let n = geometry.n();
        let links = Links::<V>::of_one(self.robot, geometry, self.x);
        let rotors: <Any as Arm>::Square<_> = links.rotors(self.robot);
        let (mut frames, mut q) = (Frames::new(geometry), [Lanes::zero(); MAX_DOF]);
        let (mut composites, mut matrix) = ([Body::none(); MAX_DOF], rotors.clone());
        for (block, out) in self.matrices.chunks_mut(n * n * V::L).enumerate() {
            for j in 0..n {
                q[j] = Lanes::gather(self.q, n, block * V::L, j);
            }
            frames.place(geometry, &q);
            inertia_matrix_lanes(geometry, &links.bodies, &rotors, &frames, &mut composites, &mut matrix);
            for i in 0..n {
                for j in 0..n {
                    Lanes::scatter(&[matrix[i.max(j)][i.min(j)]], &mut out[i * n + j..], n * n);
                }
            }
        }
    }
}

/// `M(q)` (kg.m^2, kg.m, kg; joint side) of a batch: `q` is row-major `(n_samples, n_dof)`, the result `(n_samples, n_dof, n_dof)`.
pub fn inertia_matrix(robot: &Robot, q: &[f64], x: &[f64], matrices: &mut [f64]) -> Result<(), ShapeError> {
    check_length("x", x, Layout::of(robot).count())?;
    check_length("matrices", matrices, q.len() * robot.n_dof())?;
    if q.is_empty() {
        return Ok(());
    }
    if let Some(followers) = robot.followers() {
        let (n, joints) = (robot.n_dof(), robot.n_joints());
        let q = followers.spread(q, true);
        let mut all = vec![0.0; q.len() * joints];
        dispatch(Batch { robot, q: &q, x, matrices: &mut all });
        for (all, out) in all.chunks_exact(joints * joints).zip(matrices.chunks_exact_mut(n * n)) {
            out.copy_from_slice(&followers.square(all));
        }
    } else {
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
