//! The equations of motion, (1) to (4), sample by sample.

pub mod bodies;
pub mod direct;
pub mod friction;
pub mod friction_terms;
pub mod inertia;
pub mod inverse;
pub mod links;
pub mod motion;
pub mod regressor;
pub mod remembered;
pub mod steep;
pub mod walk;
