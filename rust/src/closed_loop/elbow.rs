//! Simulation kernel specialised for TX40-like (elbow) arms: a separate type and file, so that both kernels compile in parallel.

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
