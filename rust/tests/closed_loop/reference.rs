//! References: polynomials, Fourier series, points, and messages.

use didim::closed_loop::point_to_point::PointToPoint;
use didim::closed_loop::reference::{Fourier, Reference, ReferenceError, Target};
use proptest::prelude::*;

fn at(reference: &Reference, t: f64) -> Target {
    let mut target = Target::zero();
    reference.at(t, &mut 0, &mut target);
    target
}

fn horner(c: &[f64], t: f64) -> f64 {
    c.iter().rev().fold(0.0, |sum, c| sum * t + c)
}

fn derivative(c: &[f64]) -> Vec<f64> {
    c.iter().enumerate().skip(1).map(|(k, c)| k as f64 * c).collect()
}

proptest! {
    #[test]
    fn a_polynomial_of_fifth_degree_is_met_everywhere(c in prop::array::uniform6(-2.0..2.0_f64), t in 0.0..0.9_f64) {
        let p = |t: f64| horner(&c, t);
        let dp = |t: f64| horner(&derivative(&c), t);
        let ddp = |t: f64| horner(&derivative(&derivative(&c)), t);
        let times = vec![0.0, 0.2, 0.5, 0.9];
        let knots = |f: &dyn Fn(f64) -> f64| times.iter().map(|&t| f(t)).collect::<Vec<_>>();
        let reference = Reference::from_knots(1, times.clone(), &knots(&p), &knots(&dp), &knots(&ddp)).unwrap();
        let target = at(&reference, t);
        prop_assert!((target.q[0] - p(t)).abs() < 1e-12);
        prop_assert!((target.dq[0] - dp(t)).abs() < 1e-11);
        prop_assert!((target.ddq[0] - ddp(t)).abs() < 1e-9);
    }

    #[test]
    fn samples_of_a_fourth_degree_are_met_at_the_ends_too(c in prop::array::uniform5(-2.0..2.0_f64), k in 0..70_usize) {
        let rate = 100.0;
        let p = |t: f64| horner(&c, t);
        let ddp = |t: f64| horner(&derivative(&derivative(&c)), t);
        let q: Vec<f64> = (0..71_u8).map(|k| p(f64::from(k) / rate)).collect();
        let t = (k as f64 + 0.3) / rate;
        let target = at(&Reference::sampled(1, rate, &q).unwrap(), t);
        prop_assert!((target.q[0] - p(t)).abs() < 1e-12);
        prop_assert!((target.ddq[0] - ddp(t)).abs() < 1e-6);
    }

    #[test]
    fn point_to_point_arrives_within_its_limits(points in prop::collection::vec(-2.0..2.0_f64, 8), v in 0.5..3.0_f64, a in 1.0..9.0_f64) {
        let moves = PointToPoint { points: &points, velocity: &[v, 2.0 * v], acceleration: &[a, a], dwell: 0.1 };
        let reference = Reference::point_to_point(2, moves).unwrap();
        let end = reference.span().1;
        let target = at(&reference, end);
        for j in 0..2 {
            prop_assert!((target.q[j] - points[6 + j]).abs() < 1e-9);
            prop_assert!(target.dq[j].abs() < 1e-9);
        }
        for k in 0..200 {
            let t = end * f64::from(k) / 200.0;
            let target = at(&reference, t);
            prop_assert!(target.dq[0].abs() <= v * (1.0 + 1e-9) && target.dq[1].abs() <= 2.0 * v * (1.0 + 1e-9));
            prop_assert!(target.ddq[..2].iter().all(|x| x.abs() <= a * (1.0 + 1e-9)));
            let near = at(&reference, t + 1e-7);
            prop_assert!((near.q[0] - target.q[0] - 1e-7 * target.dq[0]).abs() < 1e-12);
        }
    }
}

#[test]
fn a_trapezium_takes_the_time_of_the_formula() {
    // 1 m at 0.5 m/s and 2 m/s^2: 0.25 s up, 1.75 s at speed, 0.25 s down.
    let moves = PointToPoint { points: &[0.0, 1.0], velocity: &[0.5], acceleration: &[2.0], dwell: 0.0 };
    let reference = Reference::point_to_point(1, moves).unwrap();
    assert!((reference.span().1 - 2.25).abs() < 1e-14);
    assert_eq!(reference.breaks().len(), 2);
    assert!((at(&reference, 1.0).dq[0] - 0.5).abs() < 1e-15);
    assert!((at(&reference, 0.1).q[0] - 0.01).abs() < 1e-15);
    assert_eq!(at(&reference, 2.2).ddq[0], -2.0);
}

#[test]
fn a_fourier_series_is_met_between_its_knots() {
    let sine = [0.3, 0.0, 0.0, 0.1];
    let cosine = [0.0, 0.2, -0.05, 0.0];
    let series = Fourier { period: 2.0, offset: &[0.5, -1.0], sine: &sine, cosine: &cosine };
    let reference = Reference::fourier(2, series, 4.0, 4000).unwrap();
    let w = std::f64::consts::PI;
    for t in [0.0, 0.123_45, 1.9, 3.999] {
        let target = at(&reference, t);
        let q = [
            0.5 + 0.3 * (w * t).sin() - 0.05 * (2.0 * w * t).cos(),
            -1.0 + 0.2 * (w * t).cos() + 0.1 * (2.0 * w * t).sin(),
        ];
        let ddq1 = -0.2 * w * w * (w * t).cos() - 0.4 * w * w * (2.0 * w * t).sin();
        assert!((target.q[0] - q[0]).abs() < 1e-14 && (target.q[1] - q[1]).abs() < 1e-14);
        assert!((target.ddq[1] - ddq1).abs() < 1e-8, "{} {ddq1}", target.ddq[1]);
    }
}

#[test]
fn wrong_references_say_what_is_wrong() {
    let message = |result: Result<Reference, ReferenceError>| result.unwrap_err().to_string();
    assert!(message(Reference::sampled(1, 10.0, &[0.0; 4])).contains("at least 5 samples, got 4"));
    let knots = Reference::from_knots(1, vec![0.0, 0.0], &[0.0; 2], &[0.0; 2], &[0.0; 2]);
    assert!(message(knots).contains("knot 2"));
    let knots = Reference::from_knots(2, vec![0.0, 1.0], &[0.0, 1.0, f64::NAN, 0.0], &[0.0; 4], &[0.0; 4]);
    assert!(message(knots).contains("position of joint 1 at knot 2"));
    let moves = PointToPoint { points: &[0.0, 1.0], velocity: &[0.0], acceleration: &[1.0], dwell: 0.0 };
    assert!(
        message(Reference::point_to_point(1, moves)).contains("velocity of joint 1 must be positive, got 0")
    );
}

#[test]
fn wrong_lengths_and_counts_are_named() {
    let message = |result: Result<Reference, ReferenceError>| result.unwrap_err().to_string();
    let knots = |n: usize, times: Vec<f64>, count: usize| {
        let zeros = vec![0.0; count];
        message(Reference::from_knots(n, times, &zeros, &zeros, &zeros))
    };
    assert_eq!(knots(0, vec![0.0, 1.0], 0), "a reference has 1 to 128 joints, got 0");
    assert_eq!(knots(129, vec![0.0, 1.0], 258), "a reference has 1 to 128 joints, got 129");
    assert_eq!(knots(1, vec![0.0], 1), "a reference needs at least two different points, got 1");
    assert_eq!(knots(2, vec![0.0, 1.0], 3), "position of the reference needs 4 numbers, got 3");
    assert!(knots(1, vec![0.0, f64::NAN], 2).ends_with("knot 2 does not come after the one before"));
    assert!(knots(1, vec![0.0, f64::INFINITY], 2).contains("knot 2"));
    let series = |offset: &[f64], sine: &[f64], cosine: &[f64]| {
        message(Reference::fourier(2, Fourier { period: 1.0, offset, sine, cosine }, 1.0, 10))
    };
    assert_eq!(series(&[0.0; 2], &[0.0; 4], &[0.0; 2]), "cosine of the reference needs 4 numbers, got 2");
    assert!(series(&[0.0; 2], &[0.0; 3], &[0.0; 3]).starts_with("sine of the reference"));
    assert_eq!(series(&[0.0; 3], &[0.0; 4], &[0.0; 4]), "offset of the reference needs 2 numbers, got 3");
    let moves = |points: &[f64], velocity: &[f64]| {
        message(Reference::point_to_point(
            2,
            PointToPoint { points, velocity, acceleration: &[1.0; 2], dwell: 0.0 },
        ))
    };
    assert!(moves(&[0.0; 2], &[1.0; 2]).ends_with("at least two different points, got 1"));
    assert_eq!(moves(&[0.0; 4], &[1.0]), "velocity of the reference needs 2 numbers, got 1");
    // The same point twice, and no rest: nothing moves and no time passes.
    assert!(moves(&[0.5; 4], &[1.0; 2]).ends_with("at least two different points, got 1"));
}

#[test]
fn a_joint_that_stays_waits_for_the_others() {
    let points = [0.0, 0.7, 1.0, 0.7];
    let moves = PointToPoint { points: &points, velocity: &[0.5; 2], acceleration: &[2.0; 2], dwell: 0.0 };
    let reference = Reference::point_to_point(2, moves).unwrap();
    assert_eq!(reference.span(), (0.0, 2.25));
    for t in [0.0, 0.1, 1.0, 2.2] {
        let target = at(&reference, t);
        assert_eq!((target.q[1], target.dq[1], target.ddq[1]), (0.7, 0.0, 0.0));
    }
}

#[test]
fn a_search_may_start_at_any_piece() {
    let times: Vec<f64> = (0..9).map(f64::from).collect();
    let q: Vec<f64> = times.iter().map(|t| t.sin()).collect();
    let reference = Reference::from_knots(1, times, &q, &[0.0; 9], &[0.0; 9]).unwrap();
    for (t, want) in [(-1.0, 0), (0.5, 0), (3.0, 3), (3.5, 3), (7.9, 7), (8.0, 7), (20.0, 7)] {
        for start in 0..8 {
            let (mut piece, mut target) = (start, Target::zero());
            reference.at(t, &mut piece, &mut target);
            assert_eq!((piece, target), (want, at(&reference, t)), "{t} from {start}");
        }
    }
}
