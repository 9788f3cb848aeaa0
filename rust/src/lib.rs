//! # didim: the numerical core
//!
//! Dynamic parameters of serial robots from logged motion. The core does the arithmetic and knows nothing of Python
//! outside [`python`], the one door.
//!
//! ## The equations
//!
//! | | | |
//! |---|---|---|
//! | (1) | `tau = M(q) ddq + N(q, dq)` | [`inverse`] |
//! | (2) | `tau = IDM(q, dq, ddq) x` | [`regressor`] |
//! | (3) | `x_j = XX XY XZ YY YZ ZZ MX MY MZ M Ia Fv Fc Off` | [`parameters`] |
//! | (4) | `M(q) ddq = tau - N(q, dq)` | [`direct`], [`inertia`] |
//! | (6) | `Y = W_st x + rho`, filtered and decimated in parallel | [`observation`], [`filter`] |
//! | (7) | `Y = W beta + rho`, independent columns only | [`base`] |
//! | (8)-(11) | least squares and its covariance | [`least_squares`] |
//! | (22)-(24) | coupled wrist | [`friction`], [`robot`] |
//!
//! ## Conventions
//!
//! SI units, joint side. Frames follow Khalil and Kleinfinger (modified Denavit-Hartenberg); the inertia matrix of a
//! link is taken about the origin of its frame, and `MX MY MZ` are mass times centre of mass. Gravity is the
//! acceleration of gravity in frame 0. Arrays are row-major, one sample a row. Rows of the observation matrix are
//! joint by joint.
//!
//! ## Words
//!
//! *Standard parameters*: all of (3) and the friction of coupled motors. *Base parameters*: those that motion tells
//! apart, the others regrouped into them. *Regressor*: the torques' derivatives with respect to the standard parameters at
//! one sample. *Observation matrix*: the regressors of a whole log, filtered. *Lanes*: samples or candidates side by side in a register.

pub mod base;
pub mod bodies;
pub mod cancel;
pub mod control;
pub mod direct;
pub mod error;
pub mod filter;
pub mod friction;
pub mod geometry;
pub mod inertia;
pub mod inverse;
pub mod kinematics;
pub mod lanes;
pub mod least_squares;
pub mod observation;
pub mod parallel;
pub mod parameters;
#[cfg(feature = "python")]
pub mod python;
pub mod reference;
pub mod regressor;
pub mod robot;
pub mod runge_kutta;
pub mod schedule;
pub mod sensitivity;
pub mod shape;
pub mod simulate;
pub mod spatial;
pub mod table;
mod unroll;
