//! Primal-dual interior point with Nesterov and Todd's directions, Mehrotra's predictor and corrector, Gondzio's centring.
//!
//! ```text
//! g(x) - sum_j A_j^*(Z_j) = 0,   F_j(x) = S_j,   S_j Z_j = gamma_j I,   g(x) = A^T (A x - z) + sum_j gamma_j A_j^*(Q_j)
//! (A^T A + sum_j <B_ji, B_jk>) dx = -residual + sum_j <B_ji, X_j>
//! ```
//!
//! A log-det term is the barrier of its cone, stopped at `gamma_j` instead of at zero. The step aims at `gamma_j + tau`. The usual
//! choice of `tau` from the complementarity alone jams: the residuals stay while the room for steps vanishes. Here `tau` is at
//! least [`HELD`] times what the predictor leaves of them, in nats: `r^T (A^T A + ...)^-1 r` for the gradient `r` of the
//! Lagrangian, and `min_dx dx^T A^T A dx + sum_j |B_j dx + F_j - S_j|^2`, scaled, for slacks apart from `F`.
//!
//! The first start is near the solution without conditions ([`super::start`]), slacks apart from `F(x)`; where rounding jams it, the
//! iteration begins again at the start given, usually a prior. Newton systems are refined ([`super::newton`]).

use super::block::{Block, block};
use super::cone::Cone;
use super::newton::System;
use super::quadratic::Quadratic;
use nalgebra::{DMatrix, DVector};

/// Iterations from a start at most; usual problems need 20 (`tests/test_consistent_random.py`).
const MAX_ITERATIONS: usize = 60;

/// Complementarity (nats) at the solution.
const COMPLEMENTARITY: f64 = 1e-8;

/// Dual residual at the solution, of unknowns in units of their own curvature (square root of nats).
const STATIONARITY: f64 = 1e-9;

/// Infeasibility at the solution.
const FEASIBILITY: f64 = 1e-12;

/// An iteration that stalls, or gains less than [`GAIN`], within this many times the tolerances has a solution: rounding ends it.
const ROUNDED: f64 = 100.0;

/// Share of the violation that a step leaves at most while rounding does not decide.
const GAIN: f64 = 0.9;

/// Share of the way to the boundary that a step takes.
const INSIDE: f64 = 0.97;

/// After a step shorter than this the next one centres, without second order.
const SHORT: f64 = 0.2;

/// Barrier in units of what the predictor leaves of the residuals, per row of the cones, at least.
const HELD: f64 = 3.0;

/// Centring corrections of a step at most.
const CORRECTIONS: usize = 6;

/// Steps longer than this need no centring correction.
const LONG: f64 = 0.99;

/// Until a step is longer than this, one shorter than [`RAISED`] raises the multipliers: the barrier is too low for the start.
const FREE: f64 = 0.9;

/// Factor by which they are raised.
const RAISE: f64 = 100.0;

/// See [`FREE`].
const RAISED: f64 = 0.05;

/// Largest number of times a step is halved after rounding has led outside.
const HALVINGS: usize = 20;

/// A proof of contradiction holds for unknowns up to so many times those of the iterate.
const FAR: f64 = 1e8;

/// How a solution ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// The conditions hold within the tolerances.
    Solved,
    /// No unknowns meet the constraints; the cone (from 0) that weighs most in the proof.
    Contradictory(usize),
    /// Rounding stops the iteration before the tolerances.
    Stalled,
    /// More iterations than allowed.
    Limit,
}

/// Result of one solution.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// All unknowns.
    pub x: Vec<f64>,
    /// How it ended.
    pub ending: Ending,
    /// Newton systems factored.
    pub iterations: usize,
    /// Multiplier `Z` of each cone, row-major; empty for a cone without unknowns.
    pub multipliers: Vec<Vec<f64>>,
}

/// State of the iteration.
pub(super) struct Iterate<'a> {
    pub(super) quadratic: &'a Quadratic,
    pub(super) z: &'a DVector<f64>,
    pub(super) slope: DVector<f64>,
    pub(super) x: DVector<f64>,
    pub(super) blocks: Vec<Box<dyn Block>>,
    /// Gradient of the Lagrangian.
    pub(super) residual: DVector<f64>,
    pub(super) matrix: DMatrix<f64>,
    /// Reciprocal roots of the diagonal of the matrix.
    pub(super) scale: DVector<f64>,
    /// Dual residual that rounding alone leaves, unknowns scaled.
    rounding: DVector<f64>,
    /// `|A x - z|^2` at the start given: meeting the conditions costs no more, if they can be met.
    most: f64,
}

/// Minimise over cones from a start; the multipliers follow the order of the cones.
pub fn solve(quadratic: &Quadratic, z: &DVector<f64>, cones: &[Cone], start: DVector<f64>) -> Solution {
    let mut near = Iterate::new(quadratic, z, cones, start.clone());
    let systems = near.begin_near();
    let first = near.iterate(systems);
    if matches!(first.ending, Ending::Solved | Ending::Contradictory(_)) {
        return first;
    }
    let mut given = Iterate::new(quadratic, z, cones, start);
    let begun = given.begin().then_some(first.iterations);
    let iterations = first.iterations;
    let second = given.iterate(begun.ok_or(iterations));
    if second.ending == Ending::Stalled && second.iterations == iterations { first } else { second }
}

impl<'a> Iterate<'a> {
    fn new(quadratic: &'a Quadratic, z: &'a DVector<f64>, cones: &[Cone], x: DVector<f64>) -> Self {
        let n = x.len();
        let blocks: Vec<_> = cones.iter().map(block).collect();
        let mut slope = DVector::zeros(n);
        for block in &blocks {
            block.add_slope(&mut slope);
        }
        let (residual, matrix) = (DVector::zeros(n), DMatrix::zeros(n, n));
        let (scale, rounding) = (DVector::repeat(n, 1.0), DVector::zeros(n));
        let mut start = Self { quadratic, z, slope, x, blocks, residual, matrix, scale, rounding, most: 0.0 };
        start.most = start.error().norm_squared();
        start
    }

    /// Iterate from a start to an ending. `begun` is the number of systems solved before, an error where there is no start.
    fn iterate(&mut self, begun: Result<usize, usize>) -> Solution {
        let before = match begun {
            Ok(systems) => systems,
            Err(systems) => return self.solution(Ending::Stalled, systems),
        };
        let (mut ending, mut iterations) = (Ending::Limit, before);
        let (mut violation, mut last_step, mut free) = (f64::INFINITY, 1.0, false);
        while iterations < before + MAX_ITERATIONS {
            self.linearise();
            let last = std::mem::replace(&mut violation, self.violation());
            if violation <= 1.0 || (violation <= ROUNDED && violation > GAIN * last) {
                ending = Ending::Solved;
                break;
            }
            if let Some(cone) = self.contradiction() {
                ending = Ending::Contradictory(cone);
                break;
            }
            iterations += 1;
            let step = self.factored().and_then(|system| self.step(&system, last_step < SHORT));
            let Some(step) = step else {
                ending = Ending::Stalled;
                break;
            };
            last_step = step;
            free |= step > FREE;
            if !free && step < RAISED {
                self.blocks.iter_mut().for_each(|block| block.scale_multiplier(RAISE));
                if !self.factor() {
                    ending = Ending::Stalled;
                    break;
                }
            }
        }
        if ending != Ending::Solved && self.violation() <= ROUNDED {
            ending = Ending::Solved;
        }
        self.solution(ending, iterations)
    }

    pub(super) fn factor(&mut self) -> bool {
        let x = &self.x;
        self.blocks.iter_mut().all(|block| block.factor(x))
    }

    pub(super) fn order(&self) -> f64 {
        self.blocks.iter().map(|block| block.order()).sum::<usize>().max(1) as f64
    }

    pub(super) fn gradient(&self) -> DVector<f64> {
        self.quadratic.transposed(&self.error()) + &self.slope
    }

    pub(super) fn error(&self) -> DVector<f64> {
        self.quadratic.rows(&self.x) - self.z
    }

    /// Residual, matrix and its scale at the iterate.
    pub(super) fn linearise(&mut self) {
        self.residual = self.gradient();
        self.quadratic.curvature(&mut self.matrix);
        for block in &self.blocks {
            block.add_multiplier(-1.0, &mut self.residual);
            block.add_products(&mut self.matrix);
        }
        self.scale = self.matrix.diagonal().map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 1.0 });
        // Rounding of A x - z, whose terms may be far larger than it is.
        let terms = self.quadratic.terms(&self.x) + self.z.abs();
        self.rounding = self.quadratic.sizes() * terms.norm();
        self.blocks.iter().for_each(|block| block.add_multiplier_size(&mut self.rounding));
        self.rounding.component_mul_assign(&self.scale);
        self.rounding *= 4.0 * f64::EPSILON;
        if !self.rounding.iter().all(|rounding| rounding.is_finite()) {
            // Terms too large for floating point allow nothing: the iteration ends without a solution.
            self.rounding.fill(0.0);
        }
    }

    fn largest(&self, measure: impl Fn(&dyn Block) -> f64) -> f64 {
        self.blocks.iter().map(|block| measure(block.as_ref())).fold(0.0, f64::max)
    }

    /// Largest violation of the optimality conditions, in units of the tolerances.
    fn violation(&self) -> f64 {
        let scaled = self.residual.component_mul(&self.scale);
        if !scaled.iter().all(|r| r.is_finite()) {
            return f64::INFINITY;
        }
        let stationarity =
            scaled.zip_map(&self.rounding, |r, rounding| r.abs() / (STATIONARITY + rounding)).amax();
        let complementarity =
            self.largest(|block| block.complementarity() / (COMPLEMENTARITY + block.rounding()));
        let infeasibility = self.largest(|block| block.infeasibility()) / FEASIBILITY;
        stationarity.max(complementarity).max(infeasibility)
    }

    /// Cone that weighs most in a proof that no unknowns meet the constraints: `A^*(Z) = 0` and `tr(K Z) < 0`.
    fn contradiction(&self) -> Option<usize> {
        if self.largest(|block| block.infeasibility()) <= FEASIBILITY {
            return None;
        }
        let products: Vec<f64> = self.blocks.iter().map(|block| block.constant_product()).collect();
        let total: f64 = products.iter().sum();
        let mut sum = DVector::zeros(self.x.len());
        self.blocks.iter().for_each(|block| block.add_multiplier(1.0, &mut sum));
        // Every feasible x has tr(K Z) + sum . x >= 0.
        let reach: f64 = sum.iter().zip(&self.x).map(|(s, x)| s.abs() * FAR * (1.0 + x.abs())).sum();
        if total >= 0.0 || -total <= reach {
            return None;
        }
        (0..products.len()).min_by(|&i, &k| products[i].total_cmp(&products[k]))
    }

    /// Direction of `x` for a right side, with those of the blocks; longest steps.
    fn direction(&mut self, system: &System, right: &DVector<f64>) -> (DVector<f64>, (f64, f64)) {
        let dx = self.solved(system, right);
        let mut longest = (f64::INFINITY, f64::INFINITY);
        for block in &mut self.blocks {
            block.direct(&dx);
            let (primal, dual) = block.longest();
            longest = (longest.0.min(primal), longest.1.min(dual));
        }
        (dx, longest)
    }

    /// Right side of an aim at `gamma + tau`.
    fn aimed(&mut self, tau: f64, corrected: bool) -> DVector<f64> {
        let mut right = -&self.residual;
        self.blocks.iter_mut().for_each(|block| block.aim(tau, corrected, &mut right));
        right
    }

    /// One step; its shorter length, or None where rounding leaves none.
    fn step(&mut self, system: &System, centring: bool) -> Option<f64> {
        let order = self.order();
        let distance = self.blocks.iter().map(|block| block.distance()).sum::<f64>() / order;
        let nats = self.residual.dot(&self.solved(system, &self.residual)) + self.infeasible_nats(system);

        let right = self.aimed(0.0, false);
        let (_, longest) = self.direction(system, &right);
        let left = 1.0 - (0.99 * longest.0.min(longest.1)).min(1.0);
        let least = if centring { 0.5 } else { 0.0 };
        let tau = ((left * left * left.sqrt()).max(least) * distance).max(HELD * left * left * nats / order);

        let right = self.aimed(tau, !centring);
        let (mut dx, mut longest) = self.direction(system, &right);
        for _ in 0..CORRECTIONS {
            let steps = (longest.0.min(1.0), longest.1.min(1.0));
            if steps.0.min(steps.1) > LONG {
                break;
            }
            // Steps that a better centred direction should allow.
            let longer = ((1.08 * steps.0 + 0.08).min(1.0), (1.08 * steps.1 + 0.08).min(1.0));
            let mut right = -&self.residual;
            self.blocks.iter_mut().for_each(|block| block.centre(tau, longer, &mut right));
            let (other_dx, other) = self.direction(system, &right);
            let (primal, dual) = (other.0.min(1.0), other.1.min(1.0));
            let better = primal + dual >= steps.0 + steps.1 + 0.02;
            if !better || primal < LONG * steps.0 || dual < LONG * steps.1 {
                self.blocks.iter_mut().for_each(|block| block.restore());
                break;
            }
            (dx, longest) = (other_dx, other);
        }
        self.advance(&dx, ((INSIDE * longest.0).min(1.0), (INSIDE * longest.1).min(1.0)))
    }

    /// What it costs to bring slacks and `F(x)` together, `min_dx dx^T A^T A dx + sum_j |B_j dx + F_j - S_j|^2` (nats).
    fn infeasible_nats(&self, system: &System) -> f64 {
        let square: f64 = self.blocks.iter().map(|block| block.residual_square()).sum();
        if square == 0.0 {
            return 0.0;
        }
        let mut pull = DVector::zeros(self.x.len());
        self.blocks.iter().for_each(|block| block.add_residual(&mut pull));
        (square - pull.dot(&self.solved(system, &pull))).clamp(0.0, self.most)
    }

    /// Take a step, halved as long as rounding leads outside.
    fn advance(&mut self, dx: &DVector<f64>, mut steps: (f64, f64)) -> Option<f64> {
        let before = self.x.clone();
        for _ in 0..HALVINGS {
            self.x = &before + dx * steps.0;
            self.blocks.iter_mut().for_each(|block| block.advance(steps));
            if self.x.iter().all(|x| x.is_finite()) && self.factor() {
                return Some(steps.0.min(steps.1));
            }
            self.blocks.iter_mut().for_each(|block| block.retreat());
            steps = (0.5 * steps.0, 0.5 * steps.1);
        }
        self.x = before;
        self.factor();
        None
    }

    fn solution(&self, ending: Ending, iterations: usize) -> Solution {
        Solution {
            x: self.x.as_slice().to_vec(),
            ending,
            iterations,
            multipliers: self.blocks.iter().map(|block| block.multiplier()).collect(),
        }
    }
}
