//! From text and samples to the filtered rows of (6).

pub mod filter;
pub mod observation;
pub mod text;
