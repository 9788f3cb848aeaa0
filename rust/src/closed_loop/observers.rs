//! Observers of a simulation's records: whole trajectories, or the cost of each candidate alone.

use crate::ground::dispatch::WIDEST;

/// One record of a group of lanes: entry `j * lanes + l` is joint `j` of lane `l`.
#[derive(Debug, Clone, Copy)]
pub struct Record<'a> {
    /// Lane of the group that these begin with.
    pub first: usize,
    /// Lanes recorded together.
    pub lanes: usize,
    /// Positions.
    pub q: &'a [f64],
    /// Velocities.
    pub dq: &'a [f64],
    /// Accelerations.
    pub ddq: &'a [f64],
    /// Torques of the drives.
    pub tau: &'a [f64],
}

/// Takes the records of a group of lanes. Called through a pointer, so that the kernel is compiled once for all of them.
pub trait Observer: Send {
    /// Takes record `k`.
    fn record(&mut self, k: usize, record: &Record<'_>);
}

/// Whole trajectories of the lanes, each `(records, n)` row-major.
#[derive(Debug, Clone, Default)]
pub struct Trajectories {
    /// Whether positions, velocities, accelerations and torques are recorded.
    wanted: [bool; 4],
    /// Per lane; what is not wanted is empty.
    pub lanes: Vec<Trajectory>,
}

/// One trajectory, `(records, n)` row-major.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trajectory {
    /// Positions.
    pub q: Vec<f64>,
    /// Velocities.
    pub dq: Vec<f64>,
    /// Accelerations.
    pub ddq: Vec<f64>,
    /// Torques of the drives.
    pub tau: Vec<f64>,
}

impl Trajectories {
    /// Memory for `lanes` trajectories.
    pub fn new(lanes: usize, records: usize, n: usize) -> Self {
        Self::of([true; 4], lanes, records, n)
    }

    /// The same for some of positions, velocities, accelerations and torques.
    pub fn of(wanted: [bool; 4], lanes: usize, records: usize, n: usize) -> Self {
        let one = || {
            let [q, dq, ddq, tau] =
                wanted.map(|wanted| Vec::with_capacity(if wanted { records * n } else { 0 }));
            Trajectory { q, dq, ddq, tau }
        };
        Self { wanted, lanes: (0..lanes).map(|_| one()).collect() }
    }
}

impl Observer for Trajectories {
    fn record(&mut self, _k: usize, record: &Record<'_>) {
        for (l, lane) in self.lanes.iter_mut().skip(record.first).take(record.lanes).enumerate() {
            let all = [
                (&mut lane.q, record.q),
                (&mut lane.dq, record.dq),
                (&mut lane.ddq, record.ddq),
                (&mut lane.tau, record.tau),
            ];
            for ((out, values), _) in all.into_iter().zip(self.wanted).filter(|(_, wanted)| *wanted) {
                out.extend(values.chunks_exact(record.lanes).map(|joint| joint[l]));
            }
        }
    }
}

/// Positions of each lane, `(records, n)` row-major.
#[derive(Debug, Clone)]
pub struct Positions {
    /// One list per lane.
    pub lanes: Vec<Vec<f64>>,
}

impl Observer for Positions {
    fn record(&mut self, _k: usize, record: &Record<'_>) {
        for (l, lane) in self.lanes.iter_mut().skip(record.first).take(record.lanes).enumerate() {
            lane.extend(record.q.chunks_exact(record.lanes).map(|joint| joint[l]));
        }
    }
}

/// Measured motion and torques that a cost compares with, `(records, n)` row-major each.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// Positions.
    pub q: &'a [f64],
    /// Torques of the drives.
    pub tau: &'a [f64],
    /// Weight of a squared position error, one per joint.
    pub weight_q: &'a [f64],
    /// Weight of a squared torque error, one per joint.
    pub weight_tau: &'a [f64],
}

/// Sum of weighted squared errors of each lane: no memory per record.
#[derive(Debug, Clone, Copy)]
pub struct Cost<'a> {
    measured: Measured<'a>,
    n: usize,
    /// Sum of each lane.
    pub sums: [f64; WIDEST],
}

impl<'a> Cost<'a> {
    /// Nothing summed yet.
    pub fn new(measured: Measured<'a>, n: usize) -> Self {
        Self { measured, n, sums: [0.0; WIDEST] }
    }
}

impl Observer for Cost<'_> {
    fn record(&mut self, k: usize, record: &Record<'_>) {
        let Measured { q, tau, weight_q, weight_tau } = self.measured;
        let here = k * self.n..(k + 1) * self.n;
        let (lanes, sums) = (record.lanes, &mut self.sums[record.first..record.first + record.lanes]);
        let simulated = record.q.chunks_exact(lanes).zip(record.tau.chunks_exact(lanes));
        let measured = q[here.clone()].iter().zip(&tau[here]);
        let weights = weight_q.iter().zip(weight_tau);
        for (((of_q, of_tau), (q, tau)), (weight_q, weight_tau)) in simulated.zip(measured).zip(weights) {
            for (sum, (of_q, of_tau)) in sums.iter_mut().zip(of_q.iter().zip(of_tau)) {
                let (e, f) = (of_q - q, of_tau - tau);
                *sum += weight_q * e * e + weight_tau * f * f;
            }
        }
    }
}
