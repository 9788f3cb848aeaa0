//! Inertia matrix `M(q)` by composite bodies, rotors and coupled motors included, and where it is positive definite.
//!
//! Link `j` and all that it carries move as one body when only joint `j` accelerates; the wrench that this body needs,
//! seen along the earlier axes, is column `j`. Identities that test it: `M` is symmetric by construction and its columns are
//! those of the inverse model, `tau(q, 0, e_j) - tau(q, 0, 0)`; independently, Pinocchio's `crba`.
//!
//! `x -> M(q, x)` is linear, so the parameters with `M > 0` at given positions are a convex cone: between a vector
//! inside and any other there is a [`largest_safe_step`].

use crate::error::ShapeError;
use crate::inverse::check_length;
use crate::kinematics::Placement;
use crate::lanes::{Kernel, Lanes, dispatch};
use crate::parameters::{IA, Layout, M, MX, XX};
use crate::robot::{JointKind, MAX_DOF, Robot};
use crate::spatial::Vector;
use nalgebra::{DMatrix, SymmetricEigen};

/// A symmetric matrix on lanes; only entries with `row >= column` are used.
pub type Lower<const L: usize, const F: bool> = [[Lanes<L, F>; MAX_DOF]; MAX_DOF];

/// Inertia of a body about the origin of its frame: `XX XY XZ YY YZ ZZ`, first moments, mass.
#[derive(Debug, Clone, Copy)]
struct Body<const L: usize, const F: bool> {
    j: [Lanes<L, F>; 6],
    ms: Vector<L, F>,
    m: Lanes<L, F>,
}

impl<const L: usize, const F: bool> Body<L, F> {
    #[inline(always)]
    fn of_link(x: &[Lanes<L, F>]) -> Self {
        Self {
            j: [x[XX], x[XX + 1], x[XX + 2], x[XX + 3], x[XX + 4], x[XX + 5]],
            ms: Vector::new(x[MX], x[MX + 1], x[MX + 2]),
            m: x[M],
        }
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        for k in 0..6 {
            self.j[k] += other.j[k];
        }
        self.ms = self.ms + other.ms;
        self.m += other.m;
    }

    /// The same body about the origin of the frame before, in that frame.
    #[inline(always)]
    fn carried(&self, robot: &Robot, k: usize, at: &Placement<L, F>) -> Self {
        let joint = &robot.joints()[k];
        // Rot(z, theta): double angles of the part in the plane, a turn of (XZ, YZ).
        let [xx, xy, xz, yy, yz, zz] = self.j;
        let (s, c) = (at.sine, at.cosine);
        let (cc, ss, cs) = (c * c, s * s, c * s);
        let (two_xy_cs, difference) = ((xy + xy) * cs, xx - yy);
        let (xx, yy) =
            (xx.mul_add(cc, yy.mul_add(ss, -two_xy_cs)), xx.mul_add(ss, yy.mul_add(cc, two_xy_cs)));
        let xy = difference.mul_add(cs, xy * (cc - ss));
        let (xz, yz) = (xz.mul_add(c, -(yz * s)), xz.mul_add(s, yz * c));
        let ms = self.ms.out_of_turned(s, c);
        // About the origin at (-d, 0, -r): J + 2 (p.ms) 1 - (p ms' + ms p') + m (p.p 1 - p p').
        let (d, r) = (Lanes::splat(joint.d), at.r);
        let moved = Vector::new(d.mul_add(self.m, ms.x), ms.y, r.mul_add(self.m, ms.z));
        // With a = ms + moved, the terms are p.a 1 - (p a' + a p')/2.
        let a = ms + moved;
        let (da, ra) = (d * a.x, r * a.z);
        let (xx, yy, zz) = (xx + ra, yy + da + ra, zz + da);
        let (xy, xz, yz) =
            (xy - (d * a.y).scale(0.5), xz - d.mul_add(a.z, r * a.x).scale(0.5), yz - (r * a.y).scale(0.5));
        let ms = moved.out_of_twisted(robot.twists()[k]);
        let (ca, sa) = robot.twists()[k].cos_sin();
        let (ca, sa) = (Lanes::splat(ca), Lanes::splat(sa));
        let (cc, ss, cs) = (ca * ca, sa * sa, ca * sa);
        let two_yz_cs = (yz + yz) * cs;
        let j = [
            xx,
            xy * ca - xz * sa,
            xy * sa + xz * ca,
            yy * cc + zz * ss - two_yz_cs,
            (yy - zz) * cs + yz * (cc - ss),
            yy * ss + zz * cc + two_yz_cs,
        ];
        Self { j, ms, m: self.m }
    }
}

/// `M(q)` of `L` positions or candidates, with standard parameters `x` of their own in each lane, into `matrix`.
#[inline(always)]
pub fn inertia_matrix_lanes<const L: usize, const F: bool>(
    robot: &Robot,
    placements: &[Placement<L, F>; MAX_DOF],
    x: &[Lanes<L, F>],
    matrix: &mut Lower<L, F>,
) {
    let n = robot.n_dof();
    let layout = Layout::of(robot);
    let mut body = Body::of_link(&x[layout.joint(n - 1)..]);
    for j in (0..n).rev() {
        let (mut force, mut moment) = match robot.joints()[j].kind {
            JointKind::Revolute => (
                Vector::new(-body.ms.y, body.ms.x, Lanes::zero()),
                Vector::new(body.j[2], body.j[4], body.j[5]),
            ),
            JointKind::Prismatic => (
                Vector::new(Lanes::zero(), Lanes::zero(), body.m),
                Vector::new(body.ms.y, -body.ms.x, Lanes::zero()),
            ),
        };
        for i in (0..=j).rev() {
            matrix[j][i] = match robot.joints()[i].kind {
                JointKind::Revolute => moment.z,
                JointKind::Prismatic => force.z,
            };
            if i > 0 {
                (force, moment) = placements[i].wrench_before(robot, i, force, moment);
            }
        }
        matrix[j][j] += x[layout.joint(j) + IA];
        if j > 0 {
            let carried = body.carried(robot, j, &placements[j]);
            body = Body::of_link(&x[layout.joint(j - 1)..]);
            body.add(&carried);
        }
    }
    add_coupled_rotors(robot, x, matrix);
}

/// Memory for [`inertia_matrix_lanes`].
#[inline(always)]
pub fn no_matrix<const L: usize, const F: bool>() -> Lower<L, F> {
    [[Lanes::zero(); MAX_DOF]; MAX_DOF]
}

/// What coupled rotors put off the diagonal; on it, `Ia` already has them (24).
#[inline(always)]
fn add_coupled_rotors<const L: usize, const F: bool>(
    robot: &Robot,
    x: &[Lanes<L, F>],
    matrix: &mut Lower<L, F>,
) {
    let layout = Layout::of(robot);
    for coupled in robot.coupled() {
        let m = coupled.motor;
        let ia = x[layout.joint(m) + IA];
        for (k, &(i, c)) in coupled.others.iter().enumerate() {
            matrix[m.max(i)][m.min(i)] += ia.scale(c);
            for &(other, factor) in &coupled.others[..k] {
                matrix[other.max(i)][other.min(i)] += ia.scale(c * factor);
            }
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
        let n = self.robot.n_dof();
        let x: Vec<Lanes<L, F>> = self.x.iter().map(|&value| Lanes::splat(value)).collect();
        let (mut placements, mut matrix) = (Placement::<L, F>::nowhere(), no_matrix());
        for (block, out) in self.matrices.chunks_mut(n * n * L).enumerate() {
            let q = std::array::from_fn(|j| {
                if j < n { Lanes::gather(self.q, n, block * L, j) } else { Lanes::zero() }
            });
            Placement::all(self.robot, &q, &mut placements);
            inertia_matrix_lanes(self.robot, &placements, &x, &mut matrix);
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
