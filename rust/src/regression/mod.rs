//! Linear problems, (7) to (11): base parameters and least squares.

pub mod base;
pub mod consistent;
pub mod least_squares;
mod symbols;
mod triangle;
