//! The closed loop, (4) with a controller that follows a reference.

pub mod additive;
pub mod control;
mod elbow;
pub mod groups;
mod implicit;
mod kernels;
pub mod law;
pub mod memory;
pub mod observers;
pub mod point_to_point;
pub mod reference;
pub mod runge_kutta;
pub mod sampled;
pub mod schedule;
pub mod servo;
pub mod set_point;
pub mod simulate;
pub mod simulation;
