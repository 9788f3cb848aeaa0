//! Zero-phase filters on columns side by side, and decimation: the parallel filter of equation (6).
//!
//! A stage runs a cascade of second-order sections forward and backward over every column and keeps each
//! `factor`-th sample. One section, in the transposed direct form II, is
//!
//! ```text
//! y[k]  = b0 x[k] + s1
//! s1'   = b1 x[k] - a1 y[k] + s2
//! s2'   = b2 x[k] - a2 y[k]
//! ```
//!
//! A transfer function is one section of higher order, with as many states.
//!
//! Both passes start in the steady state of their first sample (`zi`), on a record lengthened at both ends by its own
//! point reflection (odd extension), as `scipy.signal.sosfiltfilt` does; `tests/test_signals.py` compares the two. The
//! identities tested here: constants and straight lines pass unchanged, the filter is linear, and lanes do not mix.
//!
//! Columns lie `[[f64; L]]`, L side by side: the recursion cannot be vectorised along one column, only across them.
//! Multiplications and additions stay apart, because a fused one is a library call where the processor has none.

/// Order of a section that stands for a whole transfer function.
pub const HIGHEST_ORDER: usize = 10;

/// One zero-phase filter, and which of its samples are kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Second-order sections `[b0, b1, b2, 1, a1, a2]`, in the order in which they are run, or one section of up to
    /// [`HIGHEST_ORDER`], `[b0, b1, ..., 1, a1, ...]`.
    pub sos: Vec<Vec<f64>>,
    /// Steady state of each section for a unit input (`scipy.signal.sosfilt_zi`), as many numbers as its order.
    pub zi: Vec<Vec<f64>>,
    /// Samples of odd extension at each end.
    pub padding: usize,
    /// Every `factor`-th sample is kept; 1 keeps all.
    pub factor: usize,
    /// Index of the first sample that is kept, below `factor`.
    pub first: usize,
}

/// A stage that cannot be run on the record it is given.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StageError {
    /// The record is too short to be extended.
    #[error(
        "filter stage {stage} needs more than {padding} samples to extend the record at its ends, but it gets {n_samples}"
    )]
    TooShort {
        /// Stage, counted from 0.
        stage: usize,
        /// Its padding.
        padding: usize,
        /// Samples that reach it.
        n_samples: usize,
    },
    /// `factor` or `first` make no sense, or keep nothing.
    #[error(
        "filter stage {stage} must keep every 1st, 2nd, ... sample from one below that step on, not every {factor} from {first}"
    )]
    Decimation {
        /// Stage, counted from 0.
        stage: usize,
        /// Its factor.
        factor: usize,
        /// Its first sample.
        first: usize,
    },
    /// `sos` and `zi` are of different length, or there are none.
    #[error(
        "filter stage {stage} must have one initial state per section, and at least one section, not {sections} sections and {states} states"
    )]
    Sections {
        /// Stage, counted from 0.
        stage: usize,
        /// Its sections.
        sections: usize,
        /// Its initial states.
        states: usize,
    },
    /// A coefficient is NaN or infinite, a0 is not 1, or there are more or fewer than those of the orders that are run.
    #[error(
        "section {section} of filter stage {stage} must have finite coefficients and a0 = 1, and be of order 2, or alone and of order 1 to 10"
    )]
    Coefficients {
        /// Stage, counted from 0.
        stage: usize,
        /// Section, counted from 0.
        section: usize,
    },
}

/// A sample of `L` columns, a line of the cache for eight.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(64))]
pub struct Row<const L: usize>(pub [f64; L]);

impl<const L: usize> Row<L> {
    /// Zeros.
    pub const ZERO: Self = Self([0.0; L]);
}

/// Memory that [`zero_phase_lanes`] reuses from call to call.
#[derive(Clone, Default)]
pub struct Workspace<const L: usize> {
    /// Odd extension after the last sample, filtered forward.
    tail: Vec<Row<L>>,
    /// Sections and states of a cascade that is too long for local variables.
    sections: Vec<Section<2>>,
    states: Vec<State<L, 2>>,
}

impl<const L: usize> Workspace<L> {
    /// An empty workspace; it grows on first use.
    pub fn new() -> Self {
        Self { tail: Vec::new(), sections: Vec::new(), states: Vec::new() }
    }
}

/// Number of samples that all `stages` leave of `n_samples`.
pub fn output_length(n_samples: usize, stages: &[Stage]) -> usize {
    stages.iter().fold(n_samples, |n, stage| n.saturating_sub(stage.first).div_ceil(stage.factor))
}

/// Whether `stages` can be run on `n_samples` samples: [`zero_phase_lanes`] relies on it.
pub fn check_stages(n_samples: usize, stages: &[Stage]) -> Result<(), StageError> {
    let mut n_samples = n_samples;
    for (index, stage) in stages.iter().enumerate() {
        let (factor, first) = (stage.factor, stage.first);
        if first >= factor {
            return Err(StageError::Decimation { stage: index, factor, first });
        }
        let (sections, states) = (stage.sos.len(), stage.zi.len());
        if sections == 0 || sections != states {
            return Err(StageError::Sections { stage: index, sections, states });
        }
        for (section, (sos, zi)) in stage.sos.iter().zip(&stage.zi).enumerate() {
            let finite = sos.iter().chain(zi).all(|c| c.is_finite());
            let order = zi.len();
            let known = order == 2 || (sections == 1 && (1..=HIGHEST_ORDER).contains(&order));
            #[allow(clippy::float_cmp, reason = "a normalised section has exactly 1 there")]
            if !finite || !known || sos.len() != 2 * (order + 1) || sos[order + 1] != 1.0 {
                return Err(StageError::Coefficients { stage: index, section });
            }
        }
        // The first kept sample must exist too.
        if n_samples <= stage.padding.max(first) {
            return Err(StageError::TooShort { stage: index, padding: stage.padding.max(first), n_samples });
        }
        n_samples = (n_samples - first).div_ceil(factor);
    }
    Ok(())
}

/// Runs `stages` on `L` columns side by side; afterwards `x` begins with the samples that are kept. Returns how many.
///
/// The stages must have passed [`check_stages`] for `x.len()` samples.
#[inline(always)]
pub fn zero_phase_lanes<const L: usize>(
    x: &mut [Row<L>],
    stages: &[Stage],
    workspace: &mut Workspace<L>,
) -> usize {
    let mut length = x.len();
    for stage in stages {
        filter_both_ways(&mut x[..length], stage, workspace);
        if stage.factor > 1 || stage.first > 0 {
            length = (length - stage.first).div_ceil(stage.factor);
            for k in 0..length {
                x[k] = x[stage.first + k * stage.factor];
            }
        }
    }
    length
}

/// Coefficients of one section of at most order `N`, without a0 = 1; those of higher orders are zero.
#[derive(Clone, Copy)]
struct Section<const N: usize> {
    b0: f64,
    b: [f64; N],
    a: [f64; N],
    zi: [f64; N],
}

impl<const N: usize> Section<N> {
    fn new(stage: &Stage, index: usize) -> Self {
        let (sos, zi) = (&stage.sos[index], &stage.zi[index]);
        let own = |from: usize, k: usize| if k < zi.len() { sos[from + k] } else { 0.0 };
        Self {
            b0: sos[0],
            b: std::array::from_fn(|k| own(1, k)),
            a: std::array::from_fn(|k| own(zi.len() + 2, k)),
            zi: std::array::from_fn(|k| zi.get(k).copied().unwrap_or(0.0)),
        }
    }
}

/// The delayed sums of one section.
type State<const L: usize, const N: usize> = [[f64; L]; N];

/// One stage without its decimation.
#[inline(always)]
fn filter_both_ways<const L: usize>(x: &mut [Row<L>], stage: &Stage, workspace: &mut Workspace<L>) {
    match stage.sos.len() {
        1 if stage.zi[0].len() != 2 => unrolled::<L, 1, HIGHEST_ORDER>(x, stage, &mut workspace.tail),
        1 => unrolled::<L, 1, 2>(x, stage, &mut workspace.tail),
        2 => unrolled::<L, 2, 2>(x, stage, &mut workspace.tail),
        3 => unrolled::<L, 3, 2>(x, stage, &mut workspace.tail),
        4 => unrolled::<L, 4, 2>(x, stage, &mut workspace.tail),
        n_sections => {
            let Workspace { tail, sections, states } = workspace;
            sections.clear();
            sections.extend((0..n_sections).map(|s| Section::new(stage, s)));
            states.clear();
            states.resize(n_sections, [[0.0; L]; 2]);
            both_passes(x, sections, states, stage.padding, tail);
        }
    }
}

/// A cascade whose length the compiler knows: its loops unroll and its states stay in registers.
#[inline(always)]
fn unrolled<const L: usize, const S: usize, const N: usize>(
    x: &mut [Row<L>],
    stage: &Stage,
    tail: &mut Vec<Row<L>>,
) {
    let sections: [Section<N>; S] = std::array::from_fn(|s| Section::new(stage, s));
    let mut states = [[[0.0; L]; N]; S];
    both_passes(x, &sections, &mut states, stage.padding, tail);
}

/// Forward over head, record and tail, then backward; the head is never stored, since no kept sample needs it.
#[inline(always)]
fn both_passes<const L: usize, const N: usize>(
    x: &mut [Row<L>],
    sections: &[Section<N>],
    states: &mut [State<L, N>],
    padding: usize,
    tail: &mut Vec<Row<L>>,
) {
    let (Some(&first), Some(&last)) = (x.first(), x.last()) else {
        return;
    };
    let end = x.len() - 1;
    tail.clear();
    tail.extend(x[end - padding..end].iter().rev().map(|v| reflect(last, *v)));

    settle(states, sections, if padding > 0 { reflect(first, x[padding]) } else { first });
    for v in x[1..=padding].iter().rev() {
        step(states, sections, reflect(first, *v));
    }
    for v in x.iter_mut().chain(tail.iter_mut()) {
        *v = step(states, sections, *v);
    }

    settle(states, sections, *tail.last().unwrap_or(&x[end]));
    for v in tail.iter().rev() {
        step(states, sections, *v);
    }
    for v in x.iter_mut().rev() {
        *v = step(states, sections, *v);
    }
}

/// Point reflection of `v` at `centre`.
#[inline(always)]
fn reflect<const L: usize>(centre: Row<L>, v: Row<L>) -> Row<L> {
    Row(std::array::from_fn(|l| 2.0 * centre.0[l] - v.0[l]))
}

/// The steady state of a constant input `v`.
#[inline(always)]
fn settle<const L: usize, const N: usize>(
    states: &mut [State<L, N>],
    sections: &[Section<N>],
    Row(v): Row<L>,
) {
    for (state, section) in states.iter_mut().zip(sections) {
        for (sum, zi) in state.iter_mut().zip(section.zi) {
            for l in 0..L {
                sum[l] = zi * v[l];
            }
        }
    }
}

/// One sample through the whole cascade: the sections of successive samples overlap in the pipeline.
#[inline(always)]
fn step<const L: usize, const N: usize>(
    states: &mut [State<L, N>],
    sections: &[Section<N>],
    Row(mut v): Row<L>,
) -> Row<L> {
    for (state, section) in states.iter_mut().zip(sections) {
        let Section { b0, b, a, .. } = *section;
        for l in 0..L {
            let y = b0 * v[l] + state[0][l];
            // Added in this order, the new state waits for y only twice.
            for k in 0..N - 1 {
                state[k][l] = (b[k] * v[l] + state[k + 1][l]) - a[k] * y;
            }
            state[N - 1][l] = b[N - 1] * v[l] - a[N - 1] * y;
            v[l] = y;
        }
    }
    Row(v)
}
