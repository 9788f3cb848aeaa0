//! Zero-phase filters against their definition.

use crate::common::filters::{stage, transfer_function};
use didim::signal::filter::{
    Row, Stage, StageError, Workspace, check_stages, output_length, zero_phase_lanes,
};
use proptest::prelude::*;

fn filtered<const L: usize>(x: &[[f64; L]], stages: &[Stage], workspace: &mut Workspace<L>) -> Vec<[f64; L]> {
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
        for (section, zi) in stage.sos.iter().zip(&stage.zi) {
            let &[b0, b1, b2, _, a1, a2] = section.as_slice() else { panic!("of second order") };
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
    fn a_transfer_function_is_the_cascade(
        x in prop::collection::vec(prop::array::uniform2(-10.0..10.0_f64), 30..80),
        n_sections in 1_usize..6, padding in 0_usize..29,
    ) {
        let sections = stage(n_sections, padding, 2, 1);
        let (direct, expected) = (run(&x, &[transfer_function(&sections)]), run(&x, &[sections]));
        prop_assert_eq!(direct.len(), expected.len());
        for (d, e) in direct.iter().flatten().zip(expected.iter().flatten()) {
            prop_assert!((d - e).abs() < 1e-7, "{} {}", d, e);
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
    let mut two = transfer_function(&stage(2, 9, 1, 0));
    assert!(check_stages(10, std::slice::from_ref(&two)).is_ok());
    two.sos.push(two.sos[0].clone());
    two.zi.push(two.zi[0].clone());
    assert!(message(50, two).ends_with("of order 2, or alone and of order 1 to 10"));
    assert!(message(50, transfer_function(&stage(6, 9, 1, 0))).starts_with("section 0 of filter stage 0"));
    let second = check_stages(50, &[stage(2, 9, 10, 0), stage(2, 9, 10, 0)]);
    assert_eq!(second, Err(StageError::TooShort { stage: 1, padding: 9, n_samples: 5 }));
}
