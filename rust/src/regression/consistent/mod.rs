//! Least squares under the conditions that a robot meets: pseudo-inertias, rotors and friction that stay positive.
//!
//! ```text
//! min_x  1/2 |A x - z|^2 + sum_j gamma_j [ -log det F_j(x) + tr(Q_j F_j(x)) ],    F_j(x) = K_j + sum_i x_i B_ji >= 0,    C x = d
//! ```
//!
//! `x` are the standard parameters (3). A [`Cone`] is one `F_j`: the pseudo-inertia of a link (4 rows), a rotor, a friction
//! coefficient or a bound (1 row), the viscous friction of a coupled wrist (2 rows). Its term with `gamma_j > 0` is the log-det
//! divergence from a prior (Lee, Wensing, Park 2019), scaled so that the prior has `F_j = I`. Equalities are eliminated first
//! ([`elimination`]); the rest is a primal-dual interior-point method ([`interior_point`]) on small blocks ([`block`]).
//!
//! Two choices make it robust. The dual residual bounds the barrier from below, so infeasibility never exceeds what the steps
//! can remove; and a cone without a term has a tiny one ([`LEAST_WEIGHT`]), so the solution exists, is unique and moves
//! smoothly with the data, on logs that bound nothing too.

pub mod block;
pub mod cone;
pub mod elimination;
pub mod interior_point;
mod newton;
pub mod problem;
pub mod quadratic;
pub mod small;
mod start;

pub use cone::{Cone, ConeError, LEAST_WEIGHT, MAX_ORDER};
pub use interior_point::{Ending, Solution};
pub use problem::{Equality, Problem};
