//! `Lanes<L>`: `L` samples or candidates side by side. The only place that knows about SIMD.
//!
//! The equations are written once, over [`Lanes`]; arrays of `f64` that the compiler keeps in vector registers.
//! [`dispatch`] compiles a [`Kernel`] for the instruction sets that matter and chooses one at run time. Every
//! function a kernel calls on its hot path is `#[inline(always)]`, or it would be compiled for the oldest processor.
//!
//! `FUSED` says whether `a * b + c` rounds once. It follows the processor, not the number of lanes or threads,
//! so that one machine gives one result.

use pulp::Arch;
use std::f64::consts::FRAC_2_PI;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// `L` numbers that go through the same operations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lanes<const L: usize, const FUSED: bool = false>(pub [f64; L]);

/// A computation that can run on any number of lanes.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Runs on `L` lanes. Implementations are `#[inline(always)]`.
    fn run<const L: usize, const FUSED: bool>(self) -> Self::Output;
}

/// Lanes that fill the vector registers of most processors without spilling them.
pub const WIDTH: usize = 4;

struct Vectorised<K, const FUSED: bool>(K);

impl<K: Kernel, const FUSED: bool> pulp::NullaryFnOnce for Vectorised<K, FUSED> {
    type Output = K::Output;
    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.run::<WIDTH, FUSED>()
    }
}

/// Runs a kernel with the best instruction set of this processor.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if let Arch::V3(simd) = Arch::new() {
        return simd.vectorize(Vectorised::<K, true>(kernel));
    }
    #[cfg(target_arch = "aarch64")]
    return Vectorised::<K, true>(kernel).0.run::<WIDTH, true>();
    #[cfg(not(target_arch = "aarch64"))]
    kernel.run::<WIDTH, false>()
}

impl<const L: usize, const F: bool> Lanes<L, F> {
    /// The same number in each lane.
    #[inline(always)]
    pub fn splat(value: f64) -> Self {
        Self([value; L])
    }

    /// Zero in each lane.
    #[inline(always)]
    pub fn zero() -> Self {
        Self([0.0; L])
    }

    /// Entry `column` of rows `row`, `row + 1`, ... of a row-major array; the last row stands in past the end.
    #[inline(always)]
    pub fn gather(rows: &[f64], width: usize, row: usize, column: usize) -> Self {
        let last = rows.len() / width - 1;
        Self(std::array::from_fn(|l| rows[(row + l).min(last) * width + column]))
    }

    /// `f` of each lane.
    #[inline(always)]
    #[must_use]
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self(std::array::from_fn(|l| f(self.0[l])))
    }

    /// `self * b + c`, rounded once where the processor can.
    #[inline(always)]
    #[must_use]
    pub fn mul_add(self, b: Self, c: Self) -> Self {
        Self(std::array::from_fn(|l| {
            if F { self.0[l].mul_add(b.0[l], c.0[l]) } else { self.0[l] * b.0[l] + c.0[l] }
        }))
    }

    /// `self * b` times a plain number.
    #[inline(always)]
    #[must_use]
    pub fn scale(self, factor: f64) -> Self {
        self.map(|x| x * factor)
    }

    /// Sine and cosine without branches: three-part reduction by pi/2 and the minimax polynomials of
    /// fdlibm on [-pi/4, pi/4]. Within 2 units of the last place below 1e5 rad, which a joint does not leave.
    #[inline(always)]
    pub fn sin_cos(self) -> (Self, Self) {
        const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 * 2^52: adding it leaves the nearest integer in the low bits
        const PI_2_A: f64 = 1.570_796_326_734_125_6;
        const PI_2_B: f64 = 6.077_100_506_303_966e-11;
        const PI_2_C: f64 = 2.022_266_248_711_166_5e-21;
        let mut sine = [0.0; L];
        let mut cosine = [0.0; L];
        for l in 0..L {
            let x = self.0[l];
            let shifted = fused::<F>(x, FRAC_2_PI, ROUND);
            let quadrant = shifted.to_bits();
            let k = shifted - ROUND;
            let r = fused::<F>(-k, PI_2_C, fused::<F>(-k, PI_2_B, fused::<F>(-k, PI_2_A, x)));
            let z = r * r;
            let s = fused::<F>(z, 1.589_690_995_211_55e-10, -2.505_076_025_340_686_3e-8);
            let s = fused::<F>(z, s, 2.755_731_370_707_006_8e-6);
            let s = fused::<F>(z, s, -1.984_126_982_985_795e-4);
            let s = fused::<F>(z, s, 8.333_333_333_322_49e-3);
            let s = fused::<F>(z, s, -1.666_666_666_666_663_2e-1);
            let s = fused::<F>(z * r, s, r);
            let c = fused::<F>(z, -1.135_964_755_778_819_5e-11, 2.087_572_321_298_175e-9);
            let c = fused::<F>(z, c, -2.755_731_435_139_066_3e-7);
            let c = fused::<F>(z, c, 2.480_158_728_947_673e-5);
            let c = fused::<F>(z, c, -1.388_888_888_887_411e-3);
            let c = fused::<F>(z, c, 4.166_666_666_666_66e-2);
            let half = 0.5 * z;
            let w = 1.0 - half;
            let c = w + fused::<F>(z * z, c, (1.0 - w) - half);
            // Odd quadrants exchange sine and cosine, the second bit turns the sign: masks keep it free of branches.
            let swap = (quadrant & 1).wrapping_neg();
            let (sb, cb) = (s.to_bits(), c.to_bits());
            let sine_bits = (sb & !swap) | (cb & swap);
            let cosine_bits = (cb & !swap) | (sb & swap);
            sine[l] = f64::from_bits(sine_bits ^ ((quadrant & 2) << 62));
            cosine[l] = f64::from_bits(cosine_bits ^ ((quadrant.wrapping_add(1) & 2) << 62));
        }
        (Self(sine), Self(cosine))
    }
}

#[inline(always)]
fn fused<const F: bool>(a: f64, b: f64, c: f64) -> f64 {
    if F { a.mul_add(b, c) } else { a * b + c }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $op:tt) => {
        impl<const L: usize, const F: bool> $trait for Lanes<L, F> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(std::array::from_fn(|l| self.0[l] $op other.0[l]))
            }
        }
    };
}
operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

impl<const L: usize, const F: bool> Neg for Lanes<L, F> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|x| -x)
    }
}

impl<const L: usize, const F: bool> AddAssign for Lanes<L, F> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const L: usize, const F: bool> SubAssign for Lanes<L, F> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        for k in -200_000..200_000_i32 {
            let x = f64::from(k) * 0.003_141_3 + 1e-9 * f64::from(k % 7);
            let (s, c) = Lanes::<1, false>([x]).sin_cos();
            let (sf, cf) = Lanes::<1, true>([x]).sin_cos();
            for (got, want) in [(s.0[0], x.sin()), (c.0[0], x.cos()), (sf.0[0], x.sin()), (cf.0[0], x.cos())]
            {
                assert!((got - want).abs() < 3e-16, "{x}: {got} {want}");
            }
        }
    }

    #[test]
    fn lanes_do_not_see_each_other() {
        let x = Lanes::<4, false>([0.1, -2.0, 3.0, 40.0]);
        let (s, c) = x.sin_cos();
        for l in 0..4 {
            let (sl, cl) = Lanes::<1, false>([x.0[l]]).sin_cos();
            assert_eq!((s.0[l].to_bits(), c.0[l].to_bits()), (sl.0[0].to_bits(), cl.0[0].to_bits()));
        }
    }

    #[test]
    fn gather_repeats_the_last_row_past_the_end() {
        let rows = [1.0, 10.0, 2.0, 20.0, 3.0, 30.0];
        assert_eq!(Lanes::<4>::gather(&rows, 2, 1, 1).0, [20.0, 30.0, 30.0, 30.0]);
    }
}
