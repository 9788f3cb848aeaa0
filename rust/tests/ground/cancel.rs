//! Requests to stop.

use didim::ground::cancel::Cancel;
use std::sync::atomic::{AtomicBool, Ordering};

#[test]
fn a_request_stays() {
    let answer = AtomicBool::new(true);
    let poll = || answer.swap(false, Ordering::Relaxed);
    let cancel = Cancel::when(&poll);
    assert!(cancel.requested());
    assert!(cancel.requested());
    assert!(!Cancel::never().requested());
}
