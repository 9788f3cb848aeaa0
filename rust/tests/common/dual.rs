//! Numbers that carry derivatives: `v + sum d_k e_k` with `e_i e_k = 0`.

use std::ops::{Add, Mul, Neg, Sub};

/// A value and its derivatives with respect to `N` variables.
#[derive(Debug, Clone, Copy)]
pub struct Dual<const N: usize> {
    /// Value.
    pub v: f64,
    /// Derivatives.
    pub d: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// A constant.
    pub fn constant(v: f64) -> Self {
        Self { v, d: [0.0; N] }
    }

    /// Variable `k`.
    pub fn variable(v: f64, k: usize) -> Self {
        let mut this = Self::constant(v);
        this.d[k] = 1.0;
        this
    }

    /// A function with value `v` and slope `slope` here.
    pub fn chain(self, v: f64, slope: f64) -> Self {
        Self { v, d: self.d.map(|d| d * slope) }
    }

    /// Times a plain number.
    pub fn scale(self, factor: f64) -> Self {
        self.chain(self.v * factor, factor)
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Self { v: self.v + b.v, d: std::array::from_fn(|k| self.d[k] + b.d[k]) }
    }
}

impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        self + -b
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    fn neg(self) -> Self {
        self.scale(-1.0)
    }
}

#[allow(clippy::suspicious_arithmetic_impl)] // the product rule is a sum
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    fn mul(self, b: Self) -> Self {
        Self { v: self.v * b.v, d: std::array::from_fn(|k| self.d[k] * b.v + self.v * b.d[k]) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rules_of_derivatives_hold() {
        let (x, y) = (Dual::<2>::variable(0.7, 0), Dual::<2>::variable(-1.3, 1));
        let f = x * y - x.chain(x.v.sin(), x.v.cos()) + y.scale(3.0) * Dual::constant(2.0);
        assert!((f.v - (0.7 * -1.3 - 0.7_f64.sin() - 7.8)).abs() < 1e-15);
        assert!((f.d[0] - (-1.3 - 0.7_f64.cos())).abs() < 1e-15);
        assert!((f.d[1] - 6.7).abs() < 1e-15);
    }
}
