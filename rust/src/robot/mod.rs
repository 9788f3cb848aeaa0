//! Robots: joints, transmission, friction, parameters, and the zeros of their geometry.

pub mod arm;
mod description;
mod followers;
pub mod friction_terms;
pub mod geometry;
pub mod parameters;
mod placement;
mod transmission;
mod twist;

pub use description::{Friction, Joint, JointKind, Robot, RobotError};
pub use followers::{Follower, Followers};
pub use placement::{Mount, Placement};
pub use transmission::{CoupledMotor, Coupling};
pub use twist::Twist;
