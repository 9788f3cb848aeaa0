//! Robots, closed loops and filters that several tests share.

pub mod arms;
pub mod bodies;
pub mod filters;
pub mod loops;
