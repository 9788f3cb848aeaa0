//! Stopping long work from outside: a flag that the work looks at, and whoever waits may raise.

use std::sync::atomic::{AtomicBool, Ordering};

/// A request to stop, shared by the threads of one call.
#[derive(Default)]
pub struct Cancel<'a> {
    raised: AtomicBool,
    /// Asked now and then by whichever thread works; true raises the flag.
    poll: Option<&'a (dyn Fn() -> bool + Sync)>,
}

impl<'a> Cancel<'a> {
    /// A request that only [`Cancel::raise`] makes.
    pub fn never() -> Self {
        Self::default()
    }

    /// A request that also `poll` makes.
    pub fn when(poll: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { raised: AtomicBool::new(false), poll: Some(poll) }
    }

    /// Asks for a stop.
    pub fn raise(&self) {
        self.raised.store(true, Ordering::Relaxed);
    }

    /// Whether to stop.
    pub fn requested(&self) -> bool {
        if !self.raised.load(Ordering::Relaxed) && self.poll.is_some_and(|poll| poll()) {
            self.raise();
        }
        self.raised.load(Ordering::Relaxed)
    }
}
