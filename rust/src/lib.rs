//! # didim: the numerical core
//!
//! Dynamic parameters of serial robots from logged motion. The core does the arithmetic and knows nothing of Python: the
//! binding is a crate of its own, `rust/python`.
//!
//! ## The equations
//!
//! | | | |
//! |---|---|---|
//! | (1) | `tau = M(q) ddq + N(q, dq)` | [`model::inverse`] |
//! | (2) | `tau = IDM(q, dq, ddq) x` | [`model::regressor`] |
//! | (3) | `x_j = XX XY XZ YY YZ ZZ MX MY MZ M Ia Fv Fc Off` | [`robot::parameters`] |
//! | (4) | `M(q) ddq = tau - N(q, dq)` | [`model::direct`], [`model::inertia`] |
//! | (6) | `Y = W_st x + rho`, filtered and decimated in parallel | [`signal::observation`], [`signal::filter`] |
//! | (7) | `Y = W beta + rho`, independent columns only | [`regression::base`] |
//! | (8)-(11) | least squares and its covariance | [`regression::least_squares`] |
//! | (22)-(24) | coupled wrist | [`model::friction`], [`robot`] |
//!
//! ## The map
//!
//! A folder uses only the folders above it in this list.
//!
//! | | |
//! |---|---|
//! | [`ground`] | numbers side by side in registers, vectors, threads, requests to stop |
//! | [`robot`] | a robot checked once; its parameters, and what of its geometry is zero |
//! | [`model`] | inverse, regressor, inertia and direct model, sample by sample |
//! | [`signal`] | text of data files, filters, the observation matrix of a log |
//! | [`regression`] | base parameters and least squares |
//! | [`closed_loop`] | references, controllers, steps, simulations |
//! | [`tangent`] | derivatives of the inverse model, and of the information of a motion |
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

pub mod closed_loop;
pub mod ground;
pub mod model;
pub mod regression;
pub mod robot;
pub mod signal;
pub mod tangent;
