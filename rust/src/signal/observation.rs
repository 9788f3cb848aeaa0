//! Observation matrix `W` of a log (6): regressor columns, filtered and decimated in parallel, a block at a time.
//!
//! Zero-phase filters need a whole column at once, so the blocks are columns, not samples: the columns of one link,
//! in its rows, are formed, filtered side by side in lanes and thinned out before the next link's are. A matrix
//! of all samples and columns (186 MB on the TX40's log) never exists.
//!
//! Rows are joint by joint: row `j * n_kept + k` is joint `j` at kept sample `k`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::ground::parallel;
use crate::model::motion::State;
use crate::model::regressor::{check_load, drive_lanes, gather_load};
use crate::model::walk::{Entries, Walk};
use crate::robot::Robot;
use crate::robot::parameters::{INERTIAL, Layout, Owner};
use crate::signal::filter::{
    Row, Stage, StageError, Workspace, check_stages, output_length, zero_phase_lanes,
};
use thiserror::Error;

/// Number of columns filtered in parallel: two vector registers hide the latency of the recursion.
const COLUMNS: usize = 8;

/// Inputs that [`observation`] refuses.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ObservationError {
    /// Arrays or columns that do not fit the robot.
    #[error(transparent)]
    Shape(#[from] crate::ground::arrays::ShapeError),
    /// A filter that the record does not allow.
    #[error(transparent)]
    Stage(#[from] StageError),
}

/// A log: row-major `(n_samples, n_dof)` arrays of one robot, joint side.
#[derive(Debug, Clone, Copy)]
pub struct Log<'a> {
    /// Positions (rad or m).
    pub q: &'a [f64],
    /// Velocities.
    pub dq: &'a [f64],
    /// Accelerations.
    pub ddq: &'a [f64],
    /// Torques of links and rotors (N.m or N), which the columns of load friction need; empty without it.
    pub load: &'a [f64],
}

/// One column of `W` in one row of joints: where it is formed and where it goes.
#[derive(Debug, Clone, Copy)]
struct Series {
    row: usize,
    column: usize,
    place: usize,
}

/// The series that are formed together.
#[derive(Debug, Clone)]
struct Block {
    /// The link they belong to; `None` for rotors and friction.
    link: Option<usize>,
    series: Vec<Series>,
}

/// `W` restricted to `columns` (standard parameters, in that order), column-major, `n_dof * n_kept` rows.
pub fn observation(
    robot: &Robot,
    log: Log<'_>,
    columns: &[usize],
    stages: &[Stage],
    threads: usize,
) -> Result<Vec<f64>, ObservationError> {
    if let Some(followers) = robot.followers() {
        let [q, dq, ddq] = [(log.q, true), (log.dq, false), (log.ddq, false)]
            .map(|(values, position)| followers.spread(values, position));
        let log = Log { q: &q, dq: &dq, ddq: &ddq, load: &[] };
        // Filters are linear: the rows of the joints are filtered, and then added up.
        let all = observation_of_joints(robot, log, columns, stages, threads)?;
        let kept = output_length(q.len() / robot.n_joints(), stages);
        let mut w = vec![0.0; robot.n_dof() * kept * columns.len()];
        followers.gather(&all, kept, &mut w);
        return Ok(w);
    }
    observation_of_joints(robot, log, columns, stages, threads)
}

/// The same with the rows of all joints.
fn observation_of_joints(
    robot: &Robot,
    log: Log<'_>,
    columns: &[usize],
    stages: &[Stage],
    threads: usize,
) -> Result<Vec<f64>, ObservationError> {
    let n = robot.n_joints();
    let samples = log.q.len() / n;
    for (what, array) in [("q", log.q), ("dq", log.dq), ("ddq", log.ddq)] {
        crate::ground::arrays::check_length(what, array, samples * n)?;
    }
    check_load(robot, log.load, samples * n)?;
    let count = Layout::of(robot).count();
    if let Some(&column) = columns.iter().find(|&&column| column >= count) {
        return Err(crate::ground::arrays::ShapeError::Column { column, count }.into());
    }
    if let Some((_, &column)) = columns.iter().enumerate().find(|&(k, column)| columns[..k].contains(column))
    {
        return Err(crate::ground::arrays::ShapeError::Twice { column }.into());
    }
    check_stages(samples, stages)?;
    let kept = output_length(samples, stages);
    let mut w = vec![0.0; n * kept * columns.len()];
    let blocks = blocks(robot, columns);
    // The longest blocks first: two threads end at about the same time.
    let results = parallel::map_with(blocks.len(), threads, Memory::default, |memory, b| {
        dispatch(FormAndFilter { robot, log, samples, block: &blocks[b], stages, memory })
    });
    for (block, filtered) in blocks.iter().zip(&results) {
        for (s, series) in block.series.iter().enumerate() {
            let start = series.place * n * kept + series.row * kept;
            let group = &filtered[s / COLUMNS];
            for (out, row) in w[start..start + kept].iter_mut().zip(group) {
                *out = row.0[s % COLUMNS];
            }
        }
    }
    Ok(w)
}

/// The blocks of the columns asked for, largest first.
fn blocks(robot: &Robot, columns: &[usize]) -> Vec<Block> {
    let layout = Layout::of(robot);
    let mut drive = Vec::new();
    let mut links: Vec<Vec<Series>> = vec![Vec::new(); robot.n_joints()];
    for (place, &column) in columns.iter().enumerate() {
        match layout.owner(column) {
            Owner::Joint { joint, local } if local < INERTIAL => {
                let rows = (0..=joint).filter(|&row| robot.carries(row, joint));
                links[joint].extend(rows.map(|row| Series { row, column: local, place }));
            }
            Owner::Joint { joint, .. } => {
                drive.push(Series { row: joint, column, place });
                let coupled = robot.coupled().iter().find(|coupled| coupled.motor == joint);
                if let (Some(coupled), true) =
                    (coupled, column == layout.joint(joint) + crate::robot::parameters::IA)
                {
                    drive.extend(coupled.others.iter().map(|&(row, _)| Series { row, column, place }));
                }
            }
            Owner::Coupled { index, .. } => {
                let coupled = &robot.coupled()[index];
                drive.push(Series { row: coupled.motor, column, place });
                drive.extend(coupled.others.iter().map(|&(row, _)| Series { row, column, place }));
            }
            Owner::Term { index } => {
                drive.push(Series { row: robot.friction().terms[index].joint, column, place });
            }
        }
    }
    let mut blocks: Vec<Block> =
        links.into_iter().enumerate().map(|(j, series)| Block { link: Some(j), series }).collect();
    blocks.push(Block { link: None, series: drive });
    blocks.retain(|block| !block.series.is_empty());
    blocks.sort_by_key(|block| std::cmp::Reverse(block.series.len()));
    blocks
}

/// Buffers that a thread uses again for its next block: fresh memory costs more than the arithmetic in it.
#[derive(Default)]
struct Memory {
    groups: Vec<Vec<Row<COLUMNS>>>,
    filter: Workspace<COLUMNS>,
}

struct FormAndFilter<'a> {
    robot: &'a Robot,
    log: Log<'a>,
    samples: usize,
    block: &'a Block,
    stages: &'a [Stage],
    memory: &'a mut Memory,
}

/// Entries go to the columns that were asked for.
struct Asked<'a> {
    place: &'a [usize],
    width: usize,
    groups: &'a mut [Vec<Row<COLUMNS>>],
    first: usize,
    valid: usize,
}

impl<V: Set> Entries<V> for Asked<'_> {
    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, value: Lanes<V>) {
        let s = self.place[row * self.width + column];
        if s != usize::MAX {
            let group = &mut self.groups[s / COLUMNS][self.first..self.first + self.valid];
            let numbers = value.to_array();
            for (l, sample) in group.iter_mut().enumerate() {
                sample.0[s % COLUMNS] = numbers[l];
            }
        }
    }
}

impl Kernel for FormAndFilter<'_> {
    type Output = Vec<Vec<Row<COLUMNS>>>;

    #[inline(always)]
    fn run<V: Set>(self) -> Self::Output {
        let Self { robot, log, samples, block, stages, memory: Memory { groups, filter } } = self;
        let n = robot.n_joints();
        let count = block.series.len().div_ceil(COLUMNS);
        if groups.len() < count {
            groups.resize_with(count, || vec![Row::ZERO; samples]);
        }
        let groups = &mut groups[..count];
        // Where a (row, column) of this block goes, so that the walk only stores what was asked for.
        let width = block.link.map_or(Layout::of(robot).count(), |_| INERTIAL);
        let mut place = vec![usize::MAX; n * width];
        for (s, series) in block.series.iter().enumerate() {
            place[series.row * width + series.column] = s;
        }
        let geometry = robot.geometry();
        let (mut walk, mut state) = (Walk::<V>::new(geometry), State::zero());
        let mut load = [Lanes::zero(); MAX_DOF];
        for first in (0..samples).step_by(V::L) {
            state.load(n, first, log.q, log.dq, log.ddq);
            let valid = V::L.min(samples - first);
            let mut entries = Asked { place: &place, width, groups, first, valid };
            if let Some(j) = block.link {
                walk.start(geometry, &state.q);
                walk.reach(geometry, j.min(MAX_DOF - 1), &state);
                walk.link_rows::<false>(geometry, j, 0, &mut entries);
            } else {
                gather_load(log.load, n, first, &mut load);
                drive_lanes(robot, &state, &load, &mut entries);
            }
        }
        let mut results = Vec::with_capacity(count);
        for group in groups {
            let kept = zero_phase_lanes(group, stages, filter);
            results.push(group[..kept].to_vec());
        }
        results
    }
}

/// Filters and decimates the columns of a row-major `(n_samples, width)` array; the result is row-major too.
pub fn decimate(
    signals: &[f64],
    width: usize,
    stages: &[Stage],
    threads: usize,
) -> Result<Vec<f64>, ObservationError> {
    let samples = signals.len() / width.max(1);
    check_stages(samples, stages)?;
    let kept = output_length(samples, stages);
    let groups = parallel::map(width.div_ceil(COLUMNS), threads, |g| {
        let valid = COLUMNS.min(width - g * COLUMNS);
        let mut group: Vec<Row<COLUMNS>> = signals
            .chunks_exact(width)
            .map(|row| Row(std::array::from_fn(|c| row[g * COLUMNS + c.min(valid - 1)])))
            .collect();
        dispatch(Filter { group: &mut group, stages });
        group
    });
    let mut out = vec![0.0; kept * width];
    for (k, row) in out.chunks_exact_mut(width.max(1)).enumerate() {
        for (c, value) in row.iter_mut().enumerate() {
            *value = groups[c / COLUMNS][k].0[c % COLUMNS];
        }
    }
    Ok(out)
}

struct Filter<'a> {
    group: &'a mut [Row<COLUMNS>],
    stages: &'a [Stage],
}

impl Kernel for Filter<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Set>(self) {
        zero_phase_lanes(self.group, self.stages, &mut Workspace::new());
    }
}
