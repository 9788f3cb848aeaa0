//! Candidates in groups, as many side by side as there are lanes, and groups on threads.
//!
//! None sees another, so the bits of a candidate depend on neither number. Tested in `rust/tests/closed_loop/simulate.rs`.

use crate::closed_loop::observers::Observer;
use crate::closed_loop::simulate::run_group;
use crate::closed_loop::simulation::{Candidate, Integrator, Outcome, Simulation, SimulationError, check};
use crate::ground::cancel::Cancel;
use crate::ground::dispatch::{WIDTH, widest};
use crate::ground::parallel;

/// Runs candidates in groups of lanes on at most `threads` threads; each group gets an observer of its own.
///
/// `observer(lanes)` makes one for a group of so many candidates. The result has a group's outcomes and its observer, in the order
/// of the candidates.
pub fn simulate<O: Observer>(
    simulation: Simulation<'_>,
    candidates: &[Candidate<'_>],
    threads: usize,
    cancel: &Cancel<'_>,
    observer: impl Fn(usize) -> O + Sync,
) -> Result<Vec<(Vec<Outcome>, O)>, SimulationError> {
    check(&simulation, candidates)?;
    // Lanes that would run empty are worth less than threads that would: eight only where four leave no thread idle, and where there is
    // a kernel of eight.
    let width = match candidates.len() {
        1 => 1,
        few if few <= WIDTH * threads => WIDTH,
        _ if simulation.integrator == Integrator::Additive => WIDTH,
        _ => widest(),
    };
    Ok(parallel::map(candidates.len().div_ceil(width), threads, |g| {
        let group = &candidates[g * width..(g * width + width).min(candidates.len())];
        let mut observer = observer(group.len());
        let outcomes = run_group(simulation, group, cancel, &mut observer);
        (outcomes, observer)
    }))
}
