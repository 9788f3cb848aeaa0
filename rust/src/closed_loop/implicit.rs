//! The kernel that takes steep friction implicitly, under a type of its own, as [`super::elbow`].

use super::kernels::Run;
use super::simulation::Outcome;
use crate::ground::dispatch::Kernel;
use crate::ground::lanes::Set;
use crate::robot::arm::Arm;

pub(super) struct Implicit<'a, S>(pub Run<'a, S>);

impl<S: Arm> Kernel for Implicit<'_, S> {
    type Output = Vec<Outcome>;
    #[inline(always)]
    fn run<V: Set>(self) -> Vec<Outcome> {
        self.0.integrated::<V, true>()
    }
}
