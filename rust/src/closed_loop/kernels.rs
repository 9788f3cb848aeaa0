//! Which kernel runs a group of candidates: by their number, the robot's shape, the integrator and the processor.

use super::elbow::OfElbow;
use super::implicit::Implicit;
use super::observers::Observer;
use super::simulate::Loop;
use super::simulation::{Candidate, Integrator, Outcome, Simulation};
use crate::ground::cancel::Cancel;
use crate::ground::dispatch::{Kernel, WIDTH, dispatch, dispatch_single, dispatch_widest};
use crate::ground::lanes::{Plain, Set};
use crate::robot::arm::{Arm, Elbow};
use crate::robot::geometry::Geometry;

/// Runs up to [`crate::ground::dispatch::WIDEST`] candidates on one thread, side by side as far as there are lanes; a single one by itself.
pub fn run_group(
    simulation: Simulation<'_>,
    candidates: &[Candidate<'_>],
    cancel: &Cancel<'_>,
    observer: &mut dyn Observer,
) -> Vec<Outcome> {
    match (simulation.robot.geometry().known::<Elbow>(), simulation.integrator) {
        (Some(geometry), Integrator::RungeKutta) => {
            run_kernel(candidates.len(), OfElbow(Run { simulation, geometry, candidates, cancel, observer }))
        }
        // Four lanes for any number: a single one of its own, and eight, would be compiled once more each.
        (Some(geometry), Integrator::Additive) => {
            dispatch(Implicit(Run { simulation, geometry, candidates, cancel, observer }))
        }
        (None, _) => run_as_any(simulation, candidates, cancel, observer),
    }
}

/// As [`run_group`], by the kernel of any robot: an arm of a known shape has the same bits.
pub fn run_as_any(
    simulation: Simulation<'_>,
    candidates: &[Candidate<'_>],
    cancel: &Cancel<'_>,
    observer: &mut dyn Observer,
) -> Vec<Outcome> {
    let run = Run { simulation, geometry: *simulation.robot.geometry(), candidates, cancel, observer };
    match simulation.integrator {
        Integrator::RungeKutta => run_kernel(candidates.len(), run),
        Integrator::Additive => dispatch(Implicit(run)),
    }
}

fn run_kernel(candidates: usize, kernel: impl Kernel<Output = Vec<Outcome>>) -> Vec<Outcome> {
    match candidates {
        0 => Vec::new(),
        1 => dispatch_single(kernel),
        2..=WIDTH => dispatch(kernel),
        _ => dispatch_widest(kernel),
    }
}

pub(super) struct Run<'a, S> {
    simulation: Simulation<'a>,
    geometry: Geometry<S>,
    candidates: &'a [Candidate<'a>],
    cancel: &'a Cancel<'a>,
    observer: &'a mut dyn Observer,
}

impl<S: Arm> Kernel for Run<'_, S> {
    type Output = Vec<Outcome>;

    #[inline(always)]
    fn run<V: Set>(self) -> Vec<Outcome> {
        self.integrated::<V, false>()
    }
}

impl<S: Arm> Run<'_, S> {
    /// The run, with friction taken implicitly or not: two kernels, because memory for the one would cost the other a tenth.
    #[inline(always)]
    pub(super) fn integrated<V: Set, const IMPLICIT: bool>(self) -> Vec<Outcome> {
        let Self { simulation, geometry, candidates, cancel, observer } = self;
        if !V::FUSED {
            return portable(simulation, candidates, cancel, observer);
        }
        by_lanes::<V, S, IMPLICIT>(simulation, &geometry, candidates, cancel, observer)
    }
}

/// As [`run_group`], on processors without fused multiplications: one candidate after the other, because lanes gain nothing without
/// vector registers and take long to compile.
pub fn portable(
    simulation: Simulation<'_>,
    candidates: &[Candidate<'_>],
    cancel: &Cancel<'_>,
    observer: &mut dyn Observer,
) -> Vec<Outcome> {
    let geometry = simulation.robot.geometry();
    match simulation.integrator {
        Integrator::RungeKutta => {
            by_lanes::<Plain<1>, _, false>(simulation, geometry, candidates, cancel, observer)
        }
        Integrator::Additive => {
            by_lanes::<Plain<1>, _, true>(simulation, geometry, candidates, cancel, observer)
        }
    }
}

/// As many candidates at a time as there are lanes.
#[inline(always)]
fn by_lanes<V: Set, S: Arm, const IMPLICIT: bool>(
    simulation: Simulation<'_>,
    geometry: &Geometry<S>,
    candidates: &[Candidate<'_>],
    cancel: &Cancel<'_>,
    observer: &mut dyn Observer,
) -> Vec<Outcome> {
    let mut outcomes = Vec::with_capacity(candidates.len());
    for (index, some) in candidates.chunks(V::L).enumerate() {
        let ended = Loop::<V, S>::new(simulation, geometry, some, index * V::L)
            .run::<IMPLICIT>(cancel, &mut *observer);
        outcomes.extend(&ended.as_ref()[..some.len()]);
    }
    outcomes
}
