//! Derivatives of the inverse model along a state, and of what a motion tells along the motion.

pub mod adjoint;
mod drives;
pub mod information;
mod twists;
