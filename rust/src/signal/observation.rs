//! Observation matrix `W` of a log (6): regressor columns, filtered and decimated in parallel, a block at a time.
//!
//! Zero-phase filters need a whole column at once, so the blocks are columns, not samples: the columns of one link,
//! in its rows, are formed, filtered side by side in lanes and thinned out before the next link's are. A matrix
//! of all samples and columns (186 MB on the TX40's log) never exists.
//!
//! Rows are joint by joint: row `j * n_kept + k` is joint `j` at kept sample `k`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::Lanes;
use crate::ground::parallel;
use crate::model::motion::State;
use crate::model::regressor::{check_load, drive_lanes, gather_load};
use crate::model::walk::{Entries, Walk};
use crate::robot::Robot;
use crate::robot::geometry::Geometry;
use crate::robot::parameters::{INERTIAL, Layout, Owner};
use crate::signal::filter::{
    Row, Stage, StageError, Workspace, check_stages, output_length, zero_phase_lanes,
};
use thiserror::Error;

/// Columns filtered side by side: two vector registers hide the latency of the recursion.
const COLUMNS: usize = 8;

/// What [`observation`] cannot do.
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
    let n = robot.n_dof();
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
    let mut links: Vec<Vec<Series>> = vec![Vec::new(); robot.n_dof()];
    for (place, &column) in columns.iter().enumerate() {
        match layout.owner(column) {
            Owner::Joint { joint, local } if local < INERTIAL => {
                links[joint].extend((0..=joint).map(|row| Series { row, column: local, place }));
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

/// What a thread uses again for its next block: fresh memory costs more than what is done in it.
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

impl<const L: usize, const F: bool> Entries<L, F> for Asked<'_> {
    #[inline(always)]
    fn put(&mut self, row: usize, column: usize, value: Lanes<L, F>) {
        let s = self.place[row * self.width + column];
        if s != usize::MAX {
            let group = &mut self.groups[s / COLUMNS][self.first..self.first + self.valid];
            for (l, sample) in group.iter_mut().enumerate() {
                sample.0[s % COLUMNS] = value.0[l];
            }
        }
    }
}

impl Kernel for FormAndFilter<'_> {
    type Output = Vec<Vec<Row<COLUMNS>>>;

    #[inline(always)]
    fn run<const L: usize, const F: bool>(self) -> Self::Output {
        let Self { robot, log, samples, block, stages, memory: Memory { groups, filter } } = self;
        let n = robot.n_dof();
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
        let geometry = Geometry::of(robot);
        let (mut walk, mut state) = (Walk::<L, F>::new(&geometry), State::zero());
        for first in (0..samples).step_by(L) {
            state.load(n, first, log.q, log.dq, log.ddq);
            let valid = L.min(samples - first);
            let mut entries = Asked { place: &place, width, groups, first, valid };
            if let Some(j) = block.link {
                walk.start(&geometry, &state.q);
                for k in 0..=j.min(MAX_DOF - 1) {
                    walk.step(&geometry, k, &state);
                }
                walk.link_rows(&geometry, j, 0, &mut entries);
            } else {
                let load = gather_load(log.load, n, first);
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
    fn run<const L: usize, const F: bool>(self) {
        zero_phase_lanes(self.group, self.stages, &mut Workspace::new());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::links::tests::robot;
    use crate::model::regressor::regressor;
    use crate::robot::Friction;
    use crate::signal::filter::tests::stage;

    const SAMPLES: usize = 57;

    /// Sliding and turning joints, the last motor coupled; friction of either shape.
    fn robots() -> [Robot; 3] {
        let six = robot(&[false, true, false, false, false, false]);
        let friction = Friction { asymmetric: true, ..six.friction().clone() };
        let asymmetric =
            Robot::new(six.joints().to_vec(), six.gravity(), six.transmission(), friction).unwrap();
        [robot(&[true]), six, asymmetric]
    }

    fn motion(robot: &Robot) -> [Vec<f64>; 3] {
        let count = SAMPLES * robot.n_dof();
        [1.1, 0.7, 1.7].map(|a| (0..count).map(|k| (a * k as f64 + a).sin() * 2.0).collect())
    }

    fn log(motion: &[Vec<f64>; 3]) -> Log<'_> {
        let [q, dq, ddq] = motion;
        Log { q, dq, ddq, load: &[] }
    }

    fn filtered(column: Vec<f64>, stages: &[Stage]) -> Vec<f64> {
        let mut column: Vec<Row<1>> = column.into_iter().map(|value| Row([value])).collect();
        let kept = zero_phase_lanes(&mut column, stages, &mut Workspace::new());
        column[..kept].iter().map(|row| row.0[0]).collect()
    }

    /// The definition: the whole regressor, then each column of each joint through the filter.
    fn by_definition(robot: &Robot, log: Log<'_>, columns: &[usize], stages: &[Stage]) -> Vec<f64> {
        let (n, p) = (robot.n_dof(), Layout::of(robot).count());
        let mut w = vec![0.0; SAMPLES * n * p];
        regressor(robot, log.q, log.dq, log.ddq, &mut w).unwrap();
        let series = |column: usize, j: usize| (0..SAMPLES).map(|k| w[(k * n + j) * p + column]).collect();
        let rows = columns.iter().flat_map(|&column| (0..n).map(move |j| (column, j)));
        rows.flat_map(|(column, j)| filtered(series(column, j), stages)).collect()
    }

    #[test]
    fn columns_are_those_of_the_regressor_filtered() {
        let kept = [stage(2, 9, 3, 1), stage(5, 4, 2, 0)];
        for robot in robots() {
            let motion = motion(&robot);
            let count = Layout::of(&robot).count();
            let all: Vec<usize> = (0..count).collect();
            // Some only, in any order, and those of the drives alone.
            let some: Vec<usize> = all.iter().rev().copied().filter(|k| k % 3 != 1).collect();
            let drives: Vec<usize> = all.iter().copied().filter(|k| k % 14 >= INERTIAL).collect();
            for columns in [&all, &some, &drives, &vec![]] {
                for stages in [&kept[..0], &kept[1..], &kept] {
                    let got = observation(&robot, log(&motion), columns, stages, 1).unwrap();
                    let want = by_definition(&robot, log(&motion), columns, stages);
                    assert_eq!(got.len(), columns.len() * robot.n_dof() * output_length(SAMPLES, stages));
                    assert_eq!(got.len(), want.len());
                    for (got, want) in got.iter().zip(&want) {
                        assert!((got - want).abs() < 1e-12 * (1.0 + want.abs()), "{got} {want}");
                    }
                }
            }
        }
    }

    #[test]
    fn threads_do_not_change_a_bit() {
        let [_, robot, _] = robots();
        let motion = motion(&robot);
        let columns: Vec<usize> = (0..Layout::of(&robot).count()).collect();
        let run =
            |threads| observation(&robot, log(&motion), &columns, &[stage(4, 9, 3, 1)], threads).unwrap();
        let one = run(1);
        for threads in [2, 3, 8] {
            assert_eq!(run(threads), one);
        }
    }

    #[test]
    fn decimation_is_the_filter_of_each_column() {
        let stages = [stage(3, 7, 2, 1), stage(1, 3, 3, 0)];
        for width in [1, 8, 11] {
            let signals: Vec<f64> = (0..SAMPLES * width).map(|k| (0.37 * (k * k) as f64).sin()).collect();
            let columns: Vec<Vec<f64>> = (0..width)
                .map(|c| filtered(signals.iter().skip(c).step_by(width).copied().collect(), &stages))
                .collect();
            let want: Vec<f64> =
                (0..columns[0].len()).flat_map(|k| columns.iter().map(move |column| column[k])).collect();
            for threads in [1, 2] {
                assert_eq!(decimate(&signals, width, &stages, threads).unwrap(), want);
            }
        }
        assert!(decimate(&[], 0, &[], 1).unwrap().is_empty());
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let [robot, ..] = robots();
        let motion = motion(&robot);
        let log = log(&motion);
        let message = |log: Log<'_>, columns: &[usize], stages: &[Stage]| {
            observation(&robot, log, columns, stages, 1).unwrap_err().to_string()
        };
        let short = Log { dq: &log.dq[1..], ..log };
        assert_eq!(message(short, &[0], &[]), "dq has 56 numbers where 57 are needed");
        let long = Log { q: &log.q[2..], ..log };
        assert_eq!(message(long, &[0], &[]), "dq has 57 numbers where 55 are needed");
        assert_eq!(
            message(log, &[3, 14], &[]),
            "column 14 does not exist: the robot has 14 standard parameters"
        );
        assert!(message(log, &[0], &[stage(1, SAMPLES, 1, 0)]).contains("needs more than 57 samples"));
        let error = decimate(log.q, 1, &[stage(1, 2, 40, 0), stage(1, 2, 1, 0)], 1).unwrap_err();
        assert!(error.to_string().contains("filter stage 1 needs more than 2 samples"), "{error}");
    }
}
