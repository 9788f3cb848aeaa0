//! Derivatives: of the inverse model along a state, of what a motion tells along the motion, and of a whole simulation along its
//! parameters.

pub mod adjoint;
pub mod closed_loop;
mod drives;
pub mod dual;
pub mod information;
pub mod partials;
mod twists;
