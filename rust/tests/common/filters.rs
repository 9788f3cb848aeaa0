//! Stages of zero-phase filters.

use didim::signal::filter::Stage;

/// A stable low-pass section with poles of radius `radius` and unit gain at rest, and its steady state.
fn low_pass(radius: f64, angle: f64) -> ([f64; 6], [f64; 2]) {
    let (a1, a2) = (-2.0 * radius * angle.cos(), radius * radius);
    let gain = (1.0 + a1 + a2) / 4.0;
    let (b0, b1, b2) = (gain, 2.0 * gain, gain);
    // The output of a unit input is 1, so that s2 = b2 - a2 and s1 = b1 - a1 + s2.
    let s2 = b2 - a2;
    ([b0, b1, b2, 1.0, a1, a2], [b1 - a1 + s2, s2])
}

pub fn stage(n_sections: usize, padding: usize, factor: usize, first: usize) -> Stage {
    let (sos, zi) = (0..n_sections).map(|s| low_pass(0.5 + 0.08 * s as f64, 0.3 + 0.1 * s as f64)).unzip();
    Stage { sos, zi, padding, factor, first }
}
