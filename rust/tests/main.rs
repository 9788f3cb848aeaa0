//! Tests of what the core does for its callers: identities, closed forms, definitions, and the messages of its errors.
//!
//! They link the library that the package uses, so its kernels are compiled once. Unit tests of private parts stand beside them.

mod closed_loop;
mod common;
mod ground;
mod model;
mod regression;
mod robot;
mod signal;
mod tangent;
