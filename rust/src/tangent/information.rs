//! Information of a motion about the base parameters: the matrix `sum W' Sigma^-1 W`, and its gradient along the motion.
//!
//! `W` is the regressor (2) restricted to the columns of the base parameters (7) and `Sigma` the covariance of the torques' noise,
//! which is diagonal: a weight `1 / sigma_i^2` per joint. A criterion `f(M)` with derivative `P = df/dM` changes by
//! `P : dM = sum G : dW` with `G = 2 Sigma^-1 W P`, and torques `W x` with a weight each add `weight_i x` to the rows of `G`
//! ([`super::adjoint`]). Identity that tests it: differences of the matrix itself.

use super::adjoint::{Gradient, contraction_gradient};
use crate::ground::arrays::{ShapeError, check_length};
use crate::ground::dispatch::{Kernel, WIDTH, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::model::regressor::regressor;
use crate::robot::Robot;
use crate::robot::parameters::Layout;

/// Samples at a time: their regressors stay in the cache.
pub const BLOCK: usize = 32;

/// A motion, row-major `(n_samples, n_dof)` each.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// Positions (rad or m).
    pub q: &'a [f64],
    /// Velocities.
    pub dq: &'a [f64],
    /// Accelerations.
    pub ddq: &'a [f64],
}

impl<'a> Motion<'a> {
    fn part(&self, first: usize, last: usize) -> Self {
        let at = |values: &'a [f64]| &values[first..last];
        Self { q: at(self.q), dq: at(self.dq), ddq: at(self.ddq) }
    }
}

/// Which columns count, and how precise each joint's torques are.
#[derive(Debug, Clone, Copy)]
pub struct Weighting<'a> {
    /// Columns of the regressor, the base parameters.
    pub columns: &'a [usize],
    /// `1 / sigma^2` of each joint's torque.
    pub joints: &'a [f64],
}

/// Weighted torques in a criterion: it changes by `sum weights : d(W x)`.
#[derive(Debug, Clone, Copy)]
pub struct Torques<'a> {
    /// Row-major `(n_samples, n_dof)`.
    pub weights: &'a [f64],
    /// Standard parameters.
    pub x: &'a [f64],
}

/// Memory for the regressors of a block: in it each row of kept columns fills whole registers.
struct Block {
    /// Entries of a regressor's row.
    p: usize,
    /// Columns, up to the next multiple of the lanes.
    stride: usize,
    w: Vec<f64>,
    kept: Vec<f64>,
}

impl Block {
    fn new(robot: &Robot, columns: usize) -> Self {
        let (n, p) = (robot.n_dof(), Layout::of(robot).count());
        let stride = columns.next_multiple_of(WIDTH);
        Self { p, stride, w: vec![0.0; BLOCK * n * p], kept: vec![0.0; BLOCK * n * stride] }
    }

    /// Regressors of a part of a motion of at most [`BLOCK`] samples; returns the number of rows.
    fn fill(&mut self, robot: &Robot, motion: &Motion<'_>, columns: &[usize]) -> Result<usize, ShapeError> {
        let rows = motion.q.len();
        regressor(robot, motion.q, motion.dq, motion.ddq, &mut self.w[..rows * self.p])?;
        for (kept, row) in self.kept.chunks_exact_mut(self.stride).zip(self.w.chunks_exact(self.p)).take(rows)
        {
            for (kept, &column) in kept.iter_mut().zip(columns) {
                *kept = row[column];
            }
        }
        Ok(rows)
    }
}

fn check(robot: &Robot, motion: &Motion<'_>, weighting: &Weighting<'_>) -> Result<(), ShapeError> {
    check_length("dq", motion.dq, motion.q.len())?;
    check_length("ddq", motion.ddq, motion.q.len())?;
    check_length("weights", weighting.joints, robot.n_dof())?;
    let count = Layout::of(robot).count();
    match weighting.columns.iter().find(|&&column| column >= count) {
        Some(&column) => Err(ShapeError::Column { column, count }),
        None => Ok(()),
    }
}

/// The information matrix, row-major and symmetric, into `matrix`.
pub fn information(
    robot: &Robot,
    motion: Motion<'_>,
    weighting: Weighting<'_>,
    matrix: &mut [f64],
) -> Result<(), ShapeError> {
    check(robot, &motion, &weighting)?;
    let b = weighting.columns.len();
    check_length("the information matrix", matrix, b * b)?;
    let n = robot.n_dof();
    let mut block = Block::new(robot, b);
    let mut sum = vec![0.0; b * block.stride];
    for first in (0..motion.q.len()).step_by(BLOCK * n) {
        let part = motion.part(first, (first + BLOCK * n).min(motion.q.len()));
        let rows = block.fill(robot, &part, weighting.columns)?;
        dispatch(Gram {
            rows: &block.kept[..rows * block.stride],
            n,
            b,
            weights: weighting.joints,
            sum: &mut sum,
        });
    }
    for i in 0..b {
        for j in i..b {
            matrix[i * b + j] = sum[i * block.stride + j];
            matrix[j * b + i] = sum[i * block.stride + j];
        }
    }
    Ok(())
}

/// Adds `rows' weights rows` to the upper triangle of `sum`.
struct Gram<'a> {
    rows: &'a [f64],
    n: usize,
    b: usize,
    weights: &'a [f64],
    sum: &'a mut [f64],
}

impl Kernel for Gram<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Set>(self) {
        let stride = self.sum.len() / self.b.max(1);
        // The same joint of four samples: their zeros are the same, and one pass over the sum serves all four.
        for four in self.rows.chunks(4 * self.n * stride) {
            for joint in 0..self.n {
                let row =
                    |k: usize| four.get((k * self.n + joint) * stride..(k * self.n + joint + 1) * stride);
                let Some(first_row) = row(0) else { break };
                // Rows past the end repeat the first with weight zero.
                let rows: [&[f64]; 4] = std::array::from_fn(|k| row(k).unwrap_or(first_row));
                let weights: [f64; 4] =
                    std::array::from_fn(|k| if row(k).is_some() { self.weights[joint] } else { 0.0 });
                let start = (0..self.b).find(|&c| rows.iter().any(|row| row[c] != 0.0)).unwrap_or(self.b);
                for c in start..self.b {
                    let factors: [Lanes<V>; 4] =
                        std::array::from_fn(|k| Lanes::splat(rows[k][c] * weights[k]));
                    let out = &mut self.sum[c * stride..(c + 1) * stride];
                    for k in (c - c % V::L..stride).step_by(V::L) {
                        let mut sum = Lanes::<V>::from_slice(&out[k..]);
                        for (factor, row) in factors.iter().zip(rows) {
                            sum = Lanes::from_slice(&row[k..]).mul_add(*factor, sum);
                        }
                        sum.store(&mut out[k..]);
                    }
                }
            }
        }
    }
}

/// Derivatives of a criterion along a motion: `derivative` is `df/dM`, row-major and symmetric.
pub fn information_gradient(
    robot: &Robot,
    motion: Motion<'_>,
    weighting: Weighting<'_>,
    derivative: &[f64],
    torques: Option<Torques<'_>>,
    out: &mut Gradient<'_>,
) -> Result<(), ShapeError> {
    check(robot, &motion, &weighting)?;
    let (n, b) = (robot.n_dof(), weighting.columns.len());
    let p = Layout::of(robot).count();
    check_length("the derivative", derivative, b * b)?;
    if let Some(torques) = torques {
        check_length("the weights of the torques", torques.weights, motion.q.len())?;
        check_length("x", torques.x, p)?;
    }
    for (what, array) in
        [("the gradient of q", &*out.q), ("the gradient of dq", &*out.dq), ("the gradient of ddq", &*out.ddq)]
    {
        check_length(what, array, motion.q.len())?;
    }
    let mut block = Block::new(robot, b);
    let stride = block.stride;
    let mut padded = vec![0.0; b * stride];
    for (padded, row) in padded.chunks_exact_mut(stride.max(1)).zip(derivative.chunks_exact(b.max(1))) {
        padded[..b].copy_from_slice(row);
    }
    let mut product = vec![0.0; BLOCK * n * stride];
    let mut g = vec![0.0; BLOCK * n * p];
    for first in (0..motion.q.len()).step_by(BLOCK * n) {
        let last = (first + BLOCK * n).min(motion.q.len());
        let part = motion.part(first, last);
        let rows = block.fill(robot, &part, weighting.columns)?;
        let kept = &block.kept[..rows * stride];
        dispatch(Product {
            rows: kept,
            n,
            b,
            weights: weighting.joints,
            by: &padded,
            out: &mut product[..rows * stride],
        });
        let g = &mut g[..rows * p];
        match torques {
            None => g.fill(0.0),
            Some(Torques { weights, x }) => {
                for (row, &weight) in g.chunks_exact_mut(p).zip(&weights[first..last]) {
                    for (out, x) in row.iter_mut().zip(x) {
                        *out = weight * x;
                    }
                }
            }
        }
        for (row, product) in g.chunks_exact_mut(p).zip(product.chunks_exact(stride.max(1))) {
            for (&column, value) in weighting.columns.iter().zip(product) {
                row[column] += value;
            }
        }
        let here = Gradient {
            q: &mut out.q[first..last],
            dq: &mut out.dq[first..last],
            ddq: &mut out.ddq[first..last],
        };
        contraction_gradient(robot, part.q, part.dq, part.ddq, g, here)?;
    }
    Ok(())
}

/// `2 weights rows by`.
struct Product<'a> {
    rows: &'a [f64],
    n: usize,
    b: usize,
    weights: &'a [f64],
    by: &'a [f64],
    out: &'a mut [f64],
}

impl Kernel for Product<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Set>(self) {
        let stride = self.by.len() / self.b.max(1);
        if stride == 0 {
            return;
        }
        let rows = self.rows.chunks_exact(stride);
        for (index, (row, out)) in rows.zip(self.out.chunks_exact_mut(stride)).enumerate() {
            let weight = 2.0 * self.weights[index % self.n];
            let start = row.iter().position(|&value| value != 0.0).unwrap_or(self.b);
            // Four registers at a time: they stay where they are for the whole sum.
            for k in (0..stride).step_by(4 * V::L) {
                let registers = ((stride - k) / V::L).min(4);
                let mut sums = [Lanes::<V>::zero(); 4];
                for c in start..self.b {
                    let factor = Lanes::splat(row[c] * weight);
                    let by = &self.by[c * stride + k..];
                    for r in 0..registers {
                        sums[r] = Lanes::from_slice(&by[r * V::L..]).mul_add(factor, sums[r]);
                    }
                }
                for r in 0..registers {
                    sums[r].store(&mut out[k + r * V::L..]);
                }
            }
        }
    }
}
