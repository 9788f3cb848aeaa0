//! Where the iteration begins.
//!
//! A start near the solution saves the way from the prior, which takes an iteration for every decade of `|A x - z|^2` that lies between:
//!
//! ```text
//! min_x  1/2 |A x - z|^2 + omega/2 sum_j |S_j^-1/2 (F_j(x) - S_j) S_j^-1/2|^2,    S_j = F_j(prior)
//! ```
//!
//! One Newton system; `omega` grows until no condition is much violated. Slacks are made of the absolute eigenvalues of `F_j`, so they
//! need not equal `F_j(x)`, and the barrier of what is outside and of what the log loses.

use super::interior_point::Iterate;
use nalgebra::DVector;

/// First `omega`, in nats.
const OMEGA: f64 = 10.0;

/// Factor by which it grows.
const STIFFER: f64 = 1e3;

/// Values of `omega` at most.
const TRIES: usize = 6;

/// Smallest eigenvalue of an `F_j(x)` that the iteration begins with, in units of the prior's.
const DEEPEST: f64 = -0.5;

/// Barrier of the squares outside: their share of the penalty per row of the cones.
const OUTSIDE: f64 = 3.0;

/// The same of `|A x - z|^2`.
const LOST: f64 = 0.015;

/// Barrier near the solution at least (nats).
const LEAST: f64 = 1e-3;

/// Barrier at a start that is given, as a share of the one that would hold the gradient.
const GIVEN: f64 = 1e-3;

impl Iterate<'_> {
    /// Begin near the solution without conditions; the number of systems solved, as an error where rounding leaves no start.
    pub(super) fn begin_near(&mut self) -> Result<usize, usize> {
        let prior = self.x.clone();
        self.blocks.iter_mut().for_each(|block| block.begin(&prior));
        let (mut omega, mut systems) = (1.0, 0);
        for stiffer in std::iter::once(OMEGA).chain(std::iter::repeat_n(STIFFER, TRIES - 1)) {
            omega *= stiffer;
            self.x.copy_from(&prior);
            self.blocks.iter_mut().for_each(|block| block.scale_multiplier(stiffer));
            if !self.factor() {
                return Err(systems);
            }
            self.linearise();
            let Some(system) = self.factored() else { return Err(systems) };
            systems += 1;
            let gradient = self.quadratic.a.tr_mul(&self.error());
            self.x -= self.solved(&system, &gradient);
            let smallest = self.blocks.iter().map(|block| block.smallest(&self.x));
            if smallest.fold(f64::INFINITY, f64::min) > DEEPEST {
                break;
            }
        }
        let x = &self.x;
        let outside: f64 = self.blocks.iter_mut().map(|block| block.begin_around(x)).sum();
        let lost = self.error().norm_squared();
        let barrier = LEAST.max(OUTSIDE * omega * outside / self.order()).max(LOST * lost / self.order());
        self.blocks.iter_mut().for_each(|block| block.weigh_multiplier(barrier));
        if self.factor() { Ok(systems) } else { Err(systems) }
    }

    /// Begin at the start that is given, with multipliers of a share of the barrier that would hold the gradient.
    pub(super) fn begin(&mut self) -> bool {
        let x = &self.x;
        self.blocks.iter_mut().for_each(|block| block.begin(x));
        if !self.factor() {
            return false;
        }
        let gradient = self.gradient();
        let mut squares = DVector::zeros(gradient.len());
        self.blocks.iter().for_each(|block| block.add_squares(&mut squares));
        let pull = gradient.zip_map(&squares, |g, s| if s > 0.0 { g.abs() / s.sqrt() } else { 0.0 });
        let barrier = GIVEN * pull.amax().max(1.0);
        self.blocks.iter_mut().for_each(|block| block.weigh_multiplier(barrier));
        self.factor()
    }
}
