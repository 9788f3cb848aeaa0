//! Robots, closed loops and filters that several tests share.

pub mod arms;
pub mod bodies;
mod dual;
pub mod filters;
pub mod loops;
pub mod partials;
