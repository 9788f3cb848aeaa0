//! The constrained problem: known answers, and that it never jams.

use didim::regression::consistent::small::{Small, cholesky, eigen, inverse_lower, smallest_eigenvalue};
use didim::regression::consistent::{Cone, Ending, Equality, Problem, Solution};
use proptest::prelude::*;

fn scalar(indices: &[usize], basis: &[f64], constant: f64, weight: f64) -> Cone {
    Cone {
        order: 1,
        indices: indices.to_vec(),
        basis: basis.to_vec(),
        constant: vec![constant],
        weight,
        slope: vec![1.0],
    }
}

fn identity(n: usize) -> Vec<f64> {
    (0..n * n).map(|k| if k % (n + 1) == 0 { 1.0 } else { 0.0 }).collect()
}

fn solved(n: usize, cones: &[Cone], equalities: &[Equality], z: &[f64], start: &[f64]) -> Solution {
    let problem = Problem::new(n, cones, equalities, 1e-9).unwrap();
    problem.solve(&identity(n), &[z.to_vec()], start, 1).unwrap().remove(0)
}

#[test]
fn a_bound_is_met_or_without_effect() {
    let solution = solved(
        2,
        &[scalar(&[0], &[1.0], 0.0, 0.0), scalar(&[1], &[1.0], 0.0, 0.0)],
        &[],
        &[-3.0, 2.0],
        &[1.0; 2],
    );
    assert_eq!(solution.ending, Ending::Solved);
    assert!(solution.x[0] > 0.0 && solution.x[0] < 1e-8, "{:?}", solution.x);
    assert!((solution.x[1] - 2.0).abs() < 1e-8);
    // The multiplier is the gradient that the bound holds.
    assert!((solution.multipliers[0][0] - 3.0).abs() < 1e-6);
}

#[test]
fn a_log_det_term_has_its_closed_form() {
    // x - z - g / x + g = 0.
    let (z, g) = (-2.0, 0.5);
    let solution = solved(1, &[scalar(&[0], &[1.0], 0.0, g)], &[], &[z], &[1.0]);
    let b: f64 = z - g;
    let expected = 0.5 * (b + (b * b + 4.0 * g).sqrt());
    assert!((solution.x[0] - expected).abs() < 1e-9, "{} {expected}", solution.x[0]);
}

#[test]
fn what_a_strong_log_says_least_about_is_found_too() {
    // The sum is known 1e9 times better than the difference: their squares differ by more than rounding of the matrix leaves.
    let cones = [scalar(&[0], &[1.0], 0.0, 0.0), scalar(&[1], &[1.0], 0.0, 0.0)];
    let problem = Problem::new(2, &cones, &[], 1e-9).unwrap();
    let rows = [1e9, 1e9, 1.0, -1.0];
    for (z, expected) in
        [([3e9, 1.0], [2.0, 1.0]), ([3e9, -4.0], [0.0, 3.0]), ([5e11, 300.0], [400.0, 100.0])]
    {
        let solution = problem.solve(&rows, &[z.to_vec()], &[1.0; 2], 1).unwrap().remove(0);
        assert_eq!(solution.ending, Ending::Solved);
        assert!(solution.iterations <= 20, "{}", solution.iterations);
        for (x, expected) in solution.x.iter().zip(expected) {
            assert!((x - expected).abs() < 1e-6, "{:?}", solution.x);
        }
    }
}

#[test]
fn a_start_outside_is_moved_inside() {
    let bounds = [scalar(&[0], &[1.0], -5.0, 0.0), scalar(&[0], &[-1.0], 7.0, 0.0)];
    let solution = solved(1, &bounds, &[], &[0.0], &[-100.0]);
    assert_eq!(solution.ending, Ending::Solved);
    assert!((solution.x[0] - 5.0).abs() < 1e-7);
}

#[test]
fn numbers_whose_squares_leave_floating_point_are_not_solved_by_their_rounding() {
    for size in [1e30, 1e120, 1e160, 1e200, 1e300] {
        for sign in [1.0, -1.0] {
            let solution = solved(2, &[scalar(&[0], &[1.0], 0.0, 0.0)], &[], &[sign * size, 1.0], &[1.0; 2]);
            let nearest = if sign > 0.0 { size } else { 0.0 };
            let met =
                (solution.x[0] - nearest).abs() <= 1e-6 * size && (solution.x[1] - 1.0).abs() <= 1e-6 * size;
            assert!(met || solution.ending != Ending::Solved, "{size:e}: {solution:?}");
        }
    }
}

#[test]
fn contradictions_are_told_with_their_cone() {
    let bounds =
        [scalar(&[1], &[1.0], 0.0, 0.0), scalar(&[0], &[1.0], -7.0, 0.0), scalar(&[0], &[-1.0], 5.0, 0.0)];
    let solution = solved(2, &bounds, &[], &[0.0; 2], &[6.0, 1.0]);
    assert!(matches!(solution.ending, Ending::Contradictory(1)), "{:?}", solution.ending);
    let fixed = Equality { coefficients: vec![1.0, 0.0], value: -1.0 };
    let solution =
        solved(2, &[scalar(&[0], &[1.0], 0.0, 0.0)], std::slice::from_ref(&fixed), &[0.0; 2], &[1.0; 2]);
    assert_eq!(solution.ending, Ending::Contradictory(0));
    let other = Equality { coefficients: vec![2.0, 0.0], value: -1.0 };
    let error = Problem::new(2, &[], &[fixed, other], 1e-9).unwrap_err();
    assert_eq!(error.to_string(), "equality 1 contradicts those before it");
}

#[test]
fn equalities_are_met_and_may_repeat() {
    let row = |a: f64, b: f64, c: f64, value| Equality { coefficients: vec![a, b, c], value };
    let equalities = [row(1.0, 1.0, 0.0, 3.0), row(0.0, 1.0, 2.0, 1.0), row(1.0, 2.0, 2.0, 4.0)];
    let cones: Vec<_> = (0..3).map(|k| scalar(&[k], &[1.0], 10.0, 0.0)).collect();
    let z = [0.5, -1.0, 4.0];
    let solution = solved(3, &cones, &equalities, &z, &[0.0; 3]);
    let x = &solution.x;
    assert!((x[0] + x[1] - 3.0).abs() < 1e-12 && (x[1] + 2.0 * x[2] - 1.0).abs() < 1e-12);
    // The way to z is orthogonal to the line (2, -2, 1) of the equalities.
    let along: f64 = [2.0, -2.0, 1.0].iter().zip(x.iter().zip(&z)).map(|(d, (x, z))| d * (x - z)).sum();
    assert!(along.abs() < 1e-6, "{along}");
}

#[test]
fn a_dropped_unknown_leaves_its_cone() {
    let dropped = Equality { coefficients: vec![1.0, 0.0], value: 0.0 };
    let solution = solved(2, &[scalar(&[0], &[1.0], 0.0, 0.0)], &[dropped], &[5.0, 2.0], &[1.0; 2]);
    assert_eq!(solution.ending, Ending::Solved);
    assert_eq!(solution.x[0], 0.0);
    assert!((solution.x[1] - 2.0).abs() < 1e-12 && solution.multipliers[0].is_empty());
}

#[test]
fn wrong_problems_are_errors() {
    let message = |cones: &[Cone]| Problem::new(1, cones, &[], 1e-9).unwrap_err().to_string();
    let good = scalar(&[0], &[1.0], 0.0, 0.0);
    assert!(message(&[Cone { order: 7, ..good.clone() }]).contains("7 rows"));
    assert!(message(&[Cone { basis: vec![], ..good.clone() }]).contains("basis has 0 numbers, 1 are needed"));
    assert!(message(&[scalar(&[3], &[1.0], 0.0, 0.0)]).contains("unknown 3 of 1"));
    assert!(message(&[scalar(&[0], &[f64::NAN], 0.0, 0.0)]).contains("not a finite number"));
    assert!(message(&[scalar(&[0], &[1.0], 0.0, -1.0)]).contains("negative weight"));
    let problem = Problem::new(1, &[good], &[], 1e-9).unwrap();
    assert!(problem.solve(&[1.0, 1.0], &[vec![1.0]], &[1.0], 1).is_err());
    assert!(problem.solve(&[1.0], &[vec![f64::NAN]], &[1.0], 1).is_err());
}

/// Conditions of the solution from its numbers alone: gradient, multipliers, products.
fn conditions(cones: &[Cone], a: &[f64], z: &[f64], solution: &Solution) -> (f64, f64) {
    let (n, x) = (solution.x.len(), &solution.x);
    let (mut gradient, mut terms) = (vec![0.0; n], vec![1.0; n]);
    for (row, z) in a.chunks_exact(n).zip(z) {
        let error: f64 = row.iter().zip(x).map(|(a, x)| a * x).sum::<f64>() - z;
        for k in 0..n {
            gradient[k] += row[k] * error;
            terms[k] += (row[k] * error).abs();
        }
    }
    let mut product = 0.0_f64;
    for (cone, multiplier) in cones.iter().zip(&solution.multipliers) {
        let (order, square) = (cone.order, cone.order * cone.order);
        let mut f = cone.constant.clone();
        let mut size: f64 = f.iter().map(|entry| entry.abs()).sum();
        for (&index, basis) in cone.indices.iter().zip(cone.basis.chunks_exact(square)) {
            size += basis.iter().map(|b| (x[index] * b).abs()).sum::<f64>();
            f.iter_mut().zip(basis).for_each(|(f, b)| *f += x[index] * b);
            let pull: f64 = basis
                .iter()
                .zip(multiplier.iter().zip(&cone.slope))
                .map(|(b, (m, s))| b * (cone.weight * s - m))
                .sum();
            gradient[index] += pull;
            terms[index] += pull.abs();
        }
        let (f, multiplier) = (
            nalgebra::DMatrix::from_row_slice(order, order, &f),
            nalgebra::DMatrix::from_row_slice(order, order, multiplier),
        );
        // F itself is known to the rounding of its terms only.
        let rounding = 4.0 * f64::EPSILON * size;
        let one = nalgebra::DMatrix::identity(order, order);
        let root = (f + &one * rounding).cholesky().unwrap().l();
        let (one, rounding) = (one * cone.weight, 2.0 * rounding * multiplier.norm());
        product = product.max((root.transpose() * multiplier * root - one).amax() - rounding);
    }
    (gradient.iter().zip(&terms).map(|(g, t)| g.abs() / t).fold(0.0, f64::max), product)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn random_problems_meet_their_conditions(
        seed in prop::collection::vec(-1.0_f64..1.0, 400),
        orders in prop::collection::vec(1_usize..5, 1..6),
        weight in prop::sample::select(vec![1e-7, 1e-3, 1.0]),
    ) {
        let mut numbers = seed.into_iter().cycle();
        let n = 8;
        let cones: Vec<Cone> = orders.iter().enumerate().map(|(place, &order)| {
            let square = order * order;
            let mut basis = vec![];
            for _ in 0..4 {
                let raw: Vec<f64> = (0..square).map(|_| numbers.next().unwrap()).collect();
                basis.extend((0..square).map(|k| raw[k] + raw[(k % order) * order + k / order]));
            }
            let start = place % 5;
            let slope = identity(order);
            Cone { order, indices: (start..start + 4).collect(), basis, constant: identity(order), weight, slope }
        }).collect();
        // Eight weak rows hold what neither the others nor a cone holds.
        let mut a: Vec<f64> = (0..6 * n).map(|_| numbers.next().unwrap()).collect();
        a.extend(identity(n).iter().map(|entry| 0.01 * entry));
        let mut side = |k| (0..14).map(|_| numbers.next().unwrap() * 10.0_f64.powi(k)).collect();
        let z: Vec<Vec<f64>> = (0..5).map(&mut side).collect();
        let problem = Problem::new(n, &cones, &[], 1e-7).unwrap();
        let solutions = problem.solve(&a, &z, &[0.0; 8], 1).unwrap();
        for (solution, z) in solutions.iter().zip(&z) {
            prop_assert_eq!(solution.ending, Ending::Solved);
            let (gradient, product) = conditions(&cones, &a, z, solution);
            prop_assert!(gradient < 1e-5 && product < 2e-8, "{} {}", gradient, product);
        }
        // The same bits on any number of threads.
        prop_assert_eq!(&problem.solve(&a, &z, &[0.0; 8], 3).unwrap(), &solutions);
    }

    #[test]
    fn small_matrices_factor(entries in prop::collection::vec(-1.0_f64..1.0, 16), ridge in 1e-6_f64..1.0) {
        let raw = Small::<4>::from_row_slice(&entries);
        let matrix = raw * raw.transpose() + Small::<4>::identity() * ridge;
        let root = cholesky(&matrix).unwrap();
        prop_assert!((root * root.transpose() - matrix).amax() < 1e-12);
        prop_assert!((inverse_lower(&root) * root - Small::<4>::identity()).amax() < 1e-6);
        let (values, vectors) = eigen(&matrix);
        let again = vectors * didim::regression::consistent::small::diagonal(&values) * vectors.transpose();
        prop_assert!((again - matrix).amax() < 1e-12);
        let smallest = values.into_iter().fold(f64::INFINITY, f64::min);
        prop_assert!((smallest_eigenvalue(&matrix) - smallest).abs() < 1e-13);
        prop_assert!(cholesky(&(matrix - Small::<4>::identity() * (smallest + 1e-3))).is_none());
    }
}
