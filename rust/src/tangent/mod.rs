//! Derivatives: of the inverse model along a state, and of a whole simulation along its parameters.

pub mod closed_loop;
pub mod dual;
pub mod partials;
