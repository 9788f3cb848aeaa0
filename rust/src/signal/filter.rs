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
//! Both passes start in the steady state of their first sample (`zi`), on a record lengthened at both ends by its own
//! point reflection (odd extension), as `scipy.signal.sosfiltfilt` does; `tests/test_signals.py` compares the two. The
//! identities tested here: constants and straight lines pass unchanged, the filter is linear, and lanes do not mix.
//!
//! Columns lie `[[f64; L]]`, L side by side: the recursion cannot be vectorised along one column, only across them.
//! Multiplications and additions stay apart, because a fused one is a library call where the processor has none.

/// One zero-phase filter, and which of its samples are kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Second-order sections `[b0, b1, b2, 1, a1, a2]`, in the order in which they are run.
    pub sos: Vec<[f64; 6]>,
    /// Steady state of each section for a unit input (`scipy.signal.sosfilt_zi`).
    pub zi: Vec<[f64; 2]>,
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
    /// A coefficient is NaN or infinite, or a0 is not 1.
    #[error("section {section} of filter stage {stage} must have finite coefficients and a0 = 1")]
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
    sections: Vec<Section>,
    states: Vec<State<L>>,
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
            #[allow(clippy::float_cmp, reason = "a normalised section has exactly 1 there")]
            if !finite || sos[3] != 1.0 {
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

/// Coefficients of one section, without a0 = 1.
#[derive(Clone, Copy)]
struct Section {
    b: [f64; 3],
    a: [f64; 2],
    zi: [f64; 2],
}

impl Section {
    fn new(stage: &Stage, index: usize) -> Self {
        let [b0, b1, b2, _, a1, a2] = stage.sos[index];
        Self { b: [b0, b1, b2], a: [a1, a2], zi: stage.zi[index] }
    }
}

/// The two delayed sums of one section.
type State<const L: usize> = [[f64; L]; 2];

/// One stage without its decimation.
#[inline(always)]
fn filter_both_ways<const L: usize>(x: &mut [Row<L>], stage: &Stage, workspace: &mut Workspace<L>) {
    match stage.sos.len() {
        1 => unrolled::<L, 1>(x, stage, &mut workspace.tail),
        2 => unrolled::<L, 2>(x, stage, &mut workspace.tail),
        3 => unrolled::<L, 3>(x, stage, &mut workspace.tail),
        4 => unrolled::<L, 4>(x, stage, &mut workspace.tail),
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
fn unrolled<const L: usize, const S: usize>(x: &mut [Row<L>], stage: &Stage, tail: &mut Vec<Row<L>>) {
    let sections: [Section; S] = std::array::from_fn(|s| Section::new(stage, s));
    let mut states = [[[0.0; L]; 2]; S];
    both_passes(x, &sections, &mut states, stage.padding, tail);
}

/// Forward over head, record and tail, then backward; the head is never stored, since no kept sample needs it.
#[inline(always)]
fn both_passes<const L: usize>(
    x: &mut [Row<L>],
    sections: &[Section],
    states: &mut [State<L>],
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
fn settle<const L: usize>(states: &mut [State<L>], sections: &[Section], Row(v): Row<L>) {
    for (state, section) in states.iter_mut().zip(sections) {
        for l in 0..L {
            state[0][l] = section.zi[0] * v[l];
            state[1][l] = section.zi[1] * v[l];
        }
    }
}

/// One sample through the whole cascade: the sections of successive samples overlap in the pipeline.
#[inline(always)]
fn step<const L: usize>(states: &mut [State<L>], sections: &[Section], Row(mut v): Row<L>) -> Row<L> {
    for (state, section) in states.iter_mut().zip(sections) {
        let ([b0, b1, b2], [a1, a2]) = (section.b, section.a);
        for l in 0..L {
            let y = b0 * v[l] + state[0][l];
            // Added in this order, the new state waits for y only twice.
            state[0][l] = (b1 * v[l] + state[1][l]) - a1 * y;
            state[1][l] = b2 * v[l] - a2 * y;
            v[l] = y;
        }
    }
    Row(v)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A stable low-pass section with poles of radius `radius` and unit gain at rest, and its steady state.
    fn low_pass(radius: f64, angle: f64) -> ([f64; 6], [f64; 2]) {
        let (a1, a2) = (-2.0 * radius * angle.cos(), radius * radius);
        let gain = (1.0 + a1 + a2) / 4.0;
        let (b0, b1, b2) = (gain, 2.0 * gain, gain);
        // The output of a unit input is 1, so that s2 = b2 - a2 and s1 = b1 - a1 + s2.
        let s2 = b2 - a2;
        ([b0, b1, b2, 1.0, a1, a2], [b1 - a1 + s2, s2])
    }

    pub(crate) fn stage(n_sections: usize, padding: usize, factor: usize, first: usize) -> Stage {
        let (sos, zi) =
            (0..n_sections).map(|s| low_pass(0.5 + 0.08 * s as f64, 0.3 + 0.1 * s as f64)).unzip();
        Stage { sos, zi, padding, factor, first }
    }

    fn filtered<const L: usize>(
        x: &[[f64; L]],
        stages: &[Stage],
        workspace: &mut Workspace<L>,
    ) -> Vec<[f64; L]> {
        let mut rows: Vec<Row<L>> = x.iter().map(|&v| Row(v)).collect();
        let kept = zero_phase_lanes(&mut rows, stages, workspace);
        rows[..kept].iter().map(|row| row.0).collect()
    }

    fn run<const L: usize>(x: &[[f64; L]], stages: &[Stage]) -> Vec<[f64; L]> {
        check_stages(x.len(), stages).expect("stages fit the record");
        filtered(x, stages, &mut Workspace::new())
    }

    /// The definition, one column: extend, filter section by section, turn round, filter again, cut, keep.
    fn by_definition(x: &[f64], stage: &Stage) -> Vec<f64> {
        let (n, pad) = (x.len(), stage.padding);
        let head = (1..=pad).rev().map(|k| 2.0 * x[0] - x[k]);
        let tail = (1..=pad).map(|k| 2.0 * x[n - 1] - x[n - 1 - k]);
        let mut v: Vec<f64> = head.chain(x.iter().copied()).chain(tail).collect();
        for _ in 0..2 {
            let start = v[0];
            for ([b0, b1, b2, _, a1, a2], zi) in stage.sos.iter().zip(&stage.zi) {
                let (mut s1, mut s2) = (zi[0] * start, zi[1] * start);
                for value in &mut v {
                    let y = b0 * *value + s1;
                    s1 = b1 * *value - a1 * y + s2;
                    s2 = b2 * *value - a2 * y;
                    *value = y;
                }
            }
            v.reverse();
        }
        v[pad..pad + n].iter().copied().skip(stage.first).step_by(stage.factor).collect()
    }

    proptest! {
        #[test]
        fn equals_the_definition(
            x in prop::collection::vec(-10.0..10.0_f64, 30..80),
            n_sections in 1_usize..8, padding in 0_usize..29, factor in 1_usize..6, first in 0_usize..5,
        ) {
            let stage = stage(n_sections, padding, factor, first.min(factor - 1));
            let columns: Vec<[f64; 1]> = x.iter().map(|v| [*v]).collect();
            let expected = by_definition(&x, &stage);
            let got = run(&columns, std::slice::from_ref(&stage));
            prop_assert_eq!(got.len(), expected.len());
            prop_assert_eq!(got.len(), output_length(x.len(), std::slice::from_ref(&stage)));
            for (g, e) in got.iter().zip(&expected) {
                prop_assert!((g[0] - e).abs() < 1e-11, "{} {}", g[0], e);
            }
        }

        #[test]
        fn lanes_are_the_same_bits_as_one_lane(
            x in prop::collection::vec(prop::array::uniform4(-10.0..10.0_f64), 40..90),
            n_sections in 1_usize..7,
        ) {
            let stages = [stage(n_sections, 9, 3, 1), stage(2, 5, 2, 0)];
            let together = run(&x, &stages);
            for lane in 0..4 {
                let alone: Vec<[f64; 1]> = x.iter().map(|v| [v[lane]]).collect();
                let column: Vec<[f64; 1]> = together.iter().map(|v| [v[lane]]).collect();
                prop_assert_eq!(run(&alone, &stages), column);
            }
        }

        #[test]
        fn straight_lines_pass_unchanged(
            level in -5.0..5.0_f64, slope in -1.0..1.0_f64, n_sections in 1_usize..7, padding in 60_usize..90,
        ) {
            // The odd extension continues a line; the forward pass lags it and the backward pass leads it by as much,
            // once what the start left behind has died out (padding), so that the line comes back.
            let x: Vec<[f64; 1]> = (0..200).map(|k| [level + slope * f64::from(k)]).collect();
            let stage = Stage { padding, ..stage(n_sections, 0, 1, 0) };
            let y = run(&x, &[stage]);
            for k in 60..140 {
                prop_assert!((y[k][0] - x[k][0]).abs() < 1e-5, "{} {}", y[k][0], x[k][0]);
            }
        }

        #[test]
        fn constants_pass_unchanged(level in -5.0..5.0_f64, n_sections in 1_usize..7, padding in 0_usize..29) {
            let y = run(&[[level, 2.0 * level]; 30], &[stage(n_sections, padding, 1, 0)]);
            for v in y {
                prop_assert!((v[0] - level).abs() < 1e-12 && (v[1] - 2.0 * level).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_workspace_carries_nothing_from_call_to_call() {
        let x: Vec<[f64; 2]> = (0..50).map(|k| [f64::from(k).sin(), f64::from(k).cos()]).collect();
        let mut workspace = Workspace::new();
        for n_sections in [6, 2, 5, 6] {
            let stages = [stage(n_sections, 7, 2, 1)];
            assert_eq!(filtered(&x, &stages, &mut workspace), run(&x, &stages));
        }
    }

    #[test]
    fn nothing_stays_nothing() {
        assert!(filtered::<2>(&[], &[stage(2, 0, 1, 0)], &mut Workspace::new()).is_empty());
    }

    #[test]
    fn impossible_stages_are_told() {
        let message = |n, stage: Stage| check_stages(n, &[stage]).expect_err("impossible").to_string();
        assert_eq!(
            message(9, stage(2, 9, 1, 0)),
            "filter stage 0 needs more than 9 samples to extend the record at its ends, but it gets 9"
        );
        assert!(check_stages(10, &[stage(2, 9, 1, 0)]).is_ok());
        assert!(message(50, stage(2, 9, 2, 2)).contains("not every 2 from 2"));
        assert!(message(50, stage(2, 9, 0, 0)).contains("not every 0 from 0"));
        assert!(message(50, stage(0, 9, 1, 0)).contains("not 0 sections and 0 states"));
        let mut unscaled = stage(2, 9, 1, 0);
        unscaled.sos[1][3] = 2.0;
        assert!(message(50, unscaled).starts_with("section 1 of filter stage 0"));
        let second = check_stages(50, &[stage(2, 9, 10, 0), stage(2, 9, 10, 0)]);
        assert_eq!(second, Err(StageError::TooShort { stage: 1, padding: 9, n_samples: 5 }));
    }
}
