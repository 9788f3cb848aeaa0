//! Independent units of work on several threads, each result in its own slot.
//!
//! A unit knows its index and nothing of the others, so the results have the same bits for any number of threads.
//!
//! Threads stay and wait for the next call: to start one takes as long as a tenth of a batch of a simplex.

use rayon_core::{ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, Mutex, PoisonError};

/// Threads that this machine offers.
pub fn available_threads() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// `[work(0), work(1), ..., work(n - 1)]`, computed on at most `threads` threads.
///
/// Units are handed out one by one, so that units of uneven length keep every thread busy; the longest should come first. One
/// thread, or one unit, asks no other thread at all. A panic in `work` reaches the caller.
pub fn map<R: Send>(n: usize, threads: usize, work: impl Fn(usize) -> R + Sync) -> Vec<R> {
    map_with(n, threads, || (), |(), index| work(index))
}

/// The same with memory that a thread uses from unit to unit; what a unit finds there must not matter.
pub fn map_with<R: Send, M>(
    n: usize,
    threads: usize,
    memory: impl Fn() -> M + Sync,
    work: impl Fn(&mut M, usize) -> R + Sync,
) -> Vec<R> {
    let threads = threads.min(n);
    if threads <= 1 {
        let mut memory = memory();
        return (0..n).map(|index| work(&mut memory, index)).collect();
    }
    let mut slots: Vec<Option<R>> = (0..n).map(|_| None).collect();
    let queue = Mutex::new(slots.iter_mut().enumerate());
    let worker = || {
        let mut memory = memory();
        loop {
            // The lock is released before the work starts.
            let next = queue.lock().unwrap_or_else(PoisonError::into_inner).next();
            let Some((index, slot)) = next else { break };
            *slot = Some(work(&mut memory, index));
        }
    };
    match pool(threads - 1) {
        Some(pool) => pool.in_place_scope(|scope| {
            for _ in 1..threads {
                scope.spawn(|_| worker());
            }
            worker();
        }),
        None => worker(),
    }
    // The scope has ended: every slot is filled, or a panic is on its way to the caller.
    slots.into_iter().flatten().collect()
}

/// At least so many waiting threads; none where the system gives no more.
fn pool(threads: usize) -> Option<Arc<ThreadPool>> {
    /// The pool, and the process that it belongs to: a forked one has none of its parent's threads.
    static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);
    let process = std::process::id();
    let mut known = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((owner, pool)) = &*known
        && *owner == process
        && pool.current_num_threads() >= threads
    {
        return Some(Arc::clone(pool));
    }
    let new = Arc::new(ThreadPoolBuilder::new().num_threads(threads).build().ok()?);
    if let Some((owner, old)) = known.replace((process, Arc::clone(&new)))
        && owner != process
    {
        // Nobody would answer when its threads are told to end.
        std::mem::forget(old);
    }
    Some(new)
}
