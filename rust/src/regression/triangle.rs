//! `R` of a QR factorisation, block of rows by block of rows: a long matrix is never copied whole.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::qr::no_pivoting::factor;
use faer::{Mat, MatMut, MatRef, Par, Spec};

/// Rows that are brought to triangular form at once: about 2 MB of a 60-column matrix.
pub(super) const BLOCK: usize = 4096;

/// The triangle of `[W y]` with the columns of `W` divided by `norms`, block of rows by block of rows.
pub(super) fn triangle_of_rows(w: MatRef<'_, f64>, y: &[f64], norms: &[f64]) -> Mat<f64> {
    let (rows, columns) = w.shape();
    let width = columns + 1;
    let mut stacked = Mat::<f64>::zeros(width + BLOCK.min(rows), width);
    let mut memory = QrMemory::new(stacked.nrows(), width);
    for start in (0..rows).step_by(BLOCK) {
        let count = BLOCK.min(rows - start);
        // Under the triangle so far: the reflections, then old rows, give way to the next rows.
        for column in 0..columns {
            let scale = 1.0 / norms[column];
            for row in 0..count {
                stacked[(width + row, column)] = w[(start + row, column)] * scale;
            }
        }
        for row in 0..count {
            stacked[(width + row, columns)] = y[start + row];
        }
        memory.triangularise(stacked.as_mut().subrows_mut(0, width + count));
    }
    stacked.truncate(width, width);
    stacked
}

/// The triangle of the same rows without one of the columns.
pub(super) fn without_column(triangle: &Mat<f64>, removed: usize) -> Mat<f64> {
    let n = triangle.ncols() - 1;
    // One row more than columns, since the removed column leaves its row behind.
    let mut rest = Mat::from_fn(n + 1, n, |i, j| triangle[(i, j + usize::from(j >= removed))]);
    QrMemory::new(n + 1, n).triangularise(rest.as_mut());
    rest.truncate(n, n);
    rest
}

/// Memory of faer's QR, reused from block to block.
struct QrMemory {
    reflections: Mat<f64>,
    stack: MemBuffer,
}

impl QrMemory {
    /// For matrices of at most `rows` rows, and `columns` columns.
    fn new(rows: usize, columns: usize) -> Self {
        let block = factor::recommended_block_size::<f64>(rows, columns);
        let scratch = factor::qr_in_place_scratch::<f64>(rows, columns, block, Par::Seq, Spec::default());
        Self { reflections: Mat::zeros(block, columns), stack: MemBuffer::new(scratch) }
    }

    /// Overwrites `a` by its triangle, with zeros below in the square part.
    fn triangularise(&mut self, mut a: MatMut<'_, f64>) {
        factor::qr_in_place(
            a.as_mut(),
            self.reflections.as_mut(),
            Par::Seq,
            MemStack::new(&mut self.stack),
            Spec::default(),
        );
        for column in 0..a.ncols() {
            for row in column + 1..a.ncols() {
                a[(row, column)] = 0.0;
            }
        }
    }
}
