//! Symmetric matrices of at most six rows: Cholesky factor, inverse of a triangle, eigenvalues.
//!
//! The size is a constant, so nothing is allocated.

use nalgebra::SMatrix;

/// A square matrix of fixed size.
pub type Small<const M: usize> = SMatrix<f64, M, M>;

/// Sweeps of the cyclic Jacobi method at most; six give full accuracy at these sizes.
const SWEEPS: usize = 12;

/// Squares beside the diagonal, as a share of those on it, at which the sweeps end.
const DIAGONAL: f64 = 1e-30;

/// `(a + a^T) / 2`.
pub fn symmetric<const M: usize>(a: &Small<M>) -> Small<M> {
    (a + a.transpose()) * 0.5
}

/// Diagonal matrix.
pub fn diagonal<const M: usize>(values: &[f64; M]) -> Small<M> {
    Small::<M>::from_fn(|i, k| if i == k { values[i] } else { 0.0 })
}

/// Lower triangle `l` with `l l^T = a`; None unless `a` is positive definite in floating point.
pub fn cholesky<const M: usize>(a: &Small<M>) -> Option<Small<M>> {
    let mut l = Small::<M>::zeros();
    for j in 0..M {
        let mut pivot = a[(j, j)];
        for k in 0..j {
            pivot -= l[(j, k)] * l[(j, k)];
        }
        if !(pivot.is_finite() && pivot > 0.0) {
            return None;
        }
        let pivot = pivot.sqrt();
        l[(j, j)] = pivot;
        for i in j + 1..M {
            let mut sum = a[(i, j)];
            for k in 0..j {
                sum -= l[(i, k)] * l[(j, k)];
            }
            l[(i, j)] = sum / pivot;
        }
    }
    Some(l)
}

/// Inverse of a lower triangle with a positive diagonal.
pub fn inverse_lower<const M: usize>(l: &Small<M>) -> Small<M> {
    let mut inverse = Small::<M>::zeros();
    for j in 0..M {
        inverse[(j, j)] = 1.0 / l[(j, j)];
        for i in j + 1..M {
            let mut sum = 0.0;
            for k in j..i {
                sum -= l[(i, k)] * inverse[(k, j)];
            }
            inverse[(i, j)] = sum / l[(i, i)];
        }
    }
    inverse
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by cyclic Jacobi rotations.
pub fn eigen<const M: usize>(a: &Small<M>) -> ([f64; M], Small<M>) {
    let mut vectors = Small::<M>::identity();
    let values = rotated(a, |p, q, c, s| {
        for k in 0..M {
            let (kp, kq) = (vectors[(k, p)], vectors[(k, q)]);
            vectors[(k, p)] = c * kp - s * kq;
            vectors[(k, q)] = s * kp + c * kq;
        }
    });
    (values, vectors)
}

/// Smallest eigenvalue of a symmetric matrix.
pub fn smallest_eigenvalue<const M: usize>(a: &Small<M>) -> f64 {
    rotated(a, |_, _, _, _| ()).into_iter().fold(f64::INFINITY, f64::min)
}

/// Diagonal after the rotations, each of which `each(p, q, cosine, sine)` sees.
fn rotated<const M: usize>(a: &Small<M>, mut each: impl FnMut(usize, usize, f64, f64)) -> [f64; M] {
    let mut a = *a;
    for _ in 0..SWEEPS {
        let (mut beside, mut on) = (0.0, 0.0);
        for i in 0..M {
            on += a[(i, i)] * a[(i, i)];
            for j in 0..i {
                beside += a[(i, j)] * a[(i, j)];
            }
        }
        if beside <= DIAGONAL * on {
            break;
        }
        for p in 0..M {
            for q in p + 1..M {
                if a[(p, q)] != 0.0 {
                    let (c, s) = rotate(&mut a, p, q);
                    each(p, q, c, s);
                }
            }
        }
    }
    std::array::from_fn(|k| a[(k, k)])
}

/// One Jacobi rotation, after which `a[(p, q)]` is zero; its cosine and sine.
fn rotate<const M: usize>(a: &mut Small<M>, p: usize, q: usize) -> (f64, f64) {
    let theta = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
    let t = theta.signum() / (theta.abs() + theta.mul_add(theta, 1.0).sqrt());
    let c = 1.0 / t.mul_add(t, 1.0).sqrt();
    let s = t * c;
    for k in 0..M {
        let (kp, kq) = (a[(k, p)], a[(k, q)]);
        a[(k, p)] = c * kp - s * kq;
        a[(k, q)] = s * kp + c * kq;
    }
    for k in 0..M {
        let (pk, qk) = (a[(p, k)], a[(q, k)]);
        a[(p, k)] = c * pk - s * qk;
        a[(q, k)] = s * pk + c * qk;
    }
    (c, s)
}
