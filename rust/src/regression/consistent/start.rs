//! Where the iteration begins.
//!
//! A start near the solution without conditions saves the way from the prior, which takes an iteration for every decade of
//! `|A x - z|^2` that lies between:
//!
//! ```text
//! min_x  1/2 |A x - z|^2 + omega/2 sum_j |S_j^-1/2 (F_j(x) - S_j) S_j^-1/2|^2,    S_j = F_j(prior)
//! ```
//!
//! This takes one Newton system. Slacks are made of the absolute eigenvalues of `F_j`, so they need not equal `F_j(x)`. The
//! barrier per row of the cones is the sum of the costs (nats) of moving each negative eigenvalue to zero alone, in the metric of the
//! log, or a share of `|A x - z|^2` where that is more: each decade that it is too low costs an iteration before the steps are free.

use super::interior_point::Iterate;
use nalgebra::DVector;

/// `omega`, in nats.
const OMEGA: f64 = 100.0;

/// Barrier as a share of `|A x - z|^2` per row of the cones.
const LOST: f64 = 0.015;

/// Barrier near the solution at least (nats).
const LEAST: f64 = 1e-2;

/// Barrier at a start that is given, as a share of the one that would hold the gradient.
const GIVEN: f64 = 1e-3;

impl Iterate<'_> {
    /// Begin near the solution without conditions; the number of systems solved, as an error where rounding leaves no start.
    pub(super) fn begin_near(&mut self) -> Result<usize, usize> {
        let prior = self.x.clone();
        self.blocks.iter_mut().for_each(|block| block.begin(&prior));
        self.blocks.iter_mut().for_each(|block| block.scale_multiplier(OMEGA));
        if !self.factor() {
            return Err(0);
        }
        self.linearise();
        let Some(system) = self.factored() else { return Err(0) };
        let gradient = self.quadratic.transposed(&self.error());
        self.x -= self.solved(&system, &gradient);

        let mut outside = Vec::new();
        self.blocks.iter().for_each(|block| block.outside(&self.x, &mut outside));
        let cost: f64 = outside
            .iter()
            .map(|(value, slope)| 0.5 * value * value / slope.dot(&self.preconditioned(&system, slope)))
            .sum();
        let lost = self.error().norm_squared();
        let barrier = LEAST.max(cost / self.order()).max(LOST * lost / self.order());
        let x = &self.x;
        self.blocks.iter_mut().for_each(|block| {
            block.begin_around(x);
            block.weigh_multiplier(barrier);
        });
        if self.factor() { Ok(1) } else { Err(1) }
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
