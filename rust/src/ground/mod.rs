//! Foundations of the core: numbers side by side, vectors, threads, and requests to stop.

pub mod arrays;
pub mod cancel;
pub mod dispatch;
pub mod elementary;
pub mod isa;
pub mod lanes;
pub mod parallel;
pub mod sets;
pub mod spatial;
