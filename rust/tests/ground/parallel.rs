//! Threads.

use didim::ground::parallel::{available_threads, map};
use proptest::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

proptest! {
    #[test]
    fn same_bits_for_any_number_of_threads(n in 0_usize..40, threads in 0_usize..9) {
        let run = |threads| map(n, threads, |index| (index as f64).sin().exp());
        prop_assert_eq!(run(threads), run(1));
    }
}

#[test]
fn every_unit_runs_once_and_in_its_slot() {
    let calls = AtomicUsize::new(0);
    let results = map(1000, 4, |index| {
        calls.fetch_add(1, Ordering::Relaxed);
        index + 1
    });
    assert_eq!(calls.into_inner(), 1000);
    assert_eq!(results, (1..=1000).collect::<Vec<_>>());
}

#[test]
#[should_panic(expected = "on purpose")]
fn a_panic_reaches_the_caller() {
    let caller = std::thread::current().id();
    map(8, 2, |_| {
        // The caller's own units wait until the other thread has had one.
        if std::thread::current().id() == caller {
            std::thread::sleep(std::time::Duration::from_millis(5));
        } else {
            panic!("on purpose");
        }
    });
}

#[test]
fn calls_within_and_beside_other_calls_end() {
    let inner = |k: usize| map(5, 3, move |index| k + index).into_iter().sum::<usize>();
    let expected: Vec<usize> = (0..20).map(|k| 5 * k + 10).collect();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| (0..20).for_each(|_| assert_eq!(map(20, 4, inner), expected)));
        }
    });
}

#[test]
fn a_panic_leaves_the_threads_for_the_next_call() {
    for _ in 0..3 {
        assert!(std::panic::catch_unwind(|| map(8, 4, |index| assert!(index < 7, "on purpose"))).is_err());
        assert_eq!(map(8, 4, |index| index).len(), 8);
    }
}

#[test]
fn there_is_a_thread() {
    assert!(available_threads() >= 1);
}
