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
#[should_panic(expected = "a scoped thread panicked")]
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
fn there_is_a_thread() {
    assert!(available_threads() >= 1);
}
