//! Robots: joints, transmission, friction, parameters, and the zeros of their geometry.

pub mod arm;
mod description;
mod followers;
pub mod friction_terms;
pub mod geometry;
pub mod parameters;
mod placement;
mod twist;

pub use description::{CoupledMotor, Coupling, Friction, Joint, JointKind, Robot, RobotError};
pub use followers::{Follower, Followers};
pub use placement::{Mount, Placement};
pub use twist::Twist;
