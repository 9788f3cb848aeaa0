//! The simulation once more, for elbow arms as the TX40: a type in a file of its own, so that it is compiled beside the one for any arm.

use crate::closed_loop::kernels::Run;
use crate::closed_loop::simulation::Outcome;
use crate::ground::dispatch::Kernel;
use crate::ground::lanes::Set;
use crate::robot::arm::Elbow;

pub(super) struct OfElbow<'a>(pub(super) Run<'a, Elbow>);

impl Kernel for OfElbow<'_> {
    type Output = Vec<Outcome>;

    #[inline(always)]
    fn run<V: Set>(self) -> Vec<Outcome> {
        self.0.run::<V>()
    }
}
