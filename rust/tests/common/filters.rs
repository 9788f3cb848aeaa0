//! Stages of zero-phase filters.

use didim::signal::filter::Stage;

/// A stable low-pass section with poles of radius `radius` and unit gain at rest, and its steady state.
fn low_pass(radius: f64, angle: f64) -> (Vec<f64>, Vec<f64>) {
    let (a1, a2) = (-2.0 * radius * angle.cos(), radius * radius);
    let gain = (1.0 + a1 + a2) / 4.0;
    let (b0, b1, b2) = (gain, 2.0 * gain, gain);
    // The output of a unit input is 1, so that s2 = b2 - a2 and s1 = b1 - a1 + s2.
    let s2 = b2 - a2;
    (vec![b0, b1, b2, 1.0, a1, a2], vec![b1 - a1 + s2, s2])
}

pub fn stage(n_sections: usize, padding: usize, factor: usize, first: usize) -> Stage {
    let (sos, zi) = (0..n_sections).map(|s| low_pass(0.5 + 0.08 * s as f64, 0.3 + 0.1 * s as f64)).unzip();
    Stage { sos, zi, padding, factor, first }
}

/// The same filter as one section: the product of the sections, and its steady state.
pub fn transfer_function(stage: &Stage) -> Stage {
    let times = |x: &[f64], y: &[f64]| {
        let mut product = vec![0.0; x.len() + y.len() - 1];
        for (i, x) in x.iter().enumerate() {
            for (j, y) in y.iter().enumerate() {
                product[i + j] += x * y;
            }
        }
        product
    };
    let whole = |from: usize| {
        stage.sos.iter().fold(vec![1.0], |product, section| times(&product, &section[from..from + 3]))
    };
    let (b, a) = (whole(0), whole(3));
    let zi = (1..b.len()).map(|k| (k..b.len()).map(|i| b[i] - a[i]).sum()).collect();
    Stage { sos: vec![[b, a].concat()], zi: vec![zi], ..*stage }
}
