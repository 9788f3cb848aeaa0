//! `Lanes<L>`: `L` samples or candidates side by side. The only place that knows about SIMD.
//!
//! The equations are written once, over [`Lanes`]. [`dispatch`] compiles a [`Kernel`] for the instruction sets that matter and
//! chooses one at run time. Every function a kernel calls on its hot path is `#[inline(always)]`, or it would be compiled
//! for the oldest processor.
//!
//! `FUSED` says whether `a * b + c` rounds once. It follows the processor, not the number of lanes or threads,
//! so that one machine gives one result. On x86-64 it also says that the processor has AVX2, so that four lanes can be held in
//! a vector register: left to itself the compiler takes arrays apart and puts only some of them together again
//! (docs/performance.md). For that reason only [`dispatch`] and [`dispatch_on`] start fused lanes.

// Vector instructions need `unsafe` for what the compiler cannot see: that `FUSED` was granted by the processor at run time.
#![allow(unsafe_code)]

use super::dispatch::WIDTH;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64 as x86;

/// `L` numbers that go through the same operations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lanes<const L: usize, const FUSED: bool = false>(pub(crate) [f64; L]);

/// An operation on lanes: on x86-64 by the vector instruction, elsewhere (and on a single lane) number by number.
macro_rules! lane_wise {
    ($(#[$doc:meta])* $visibility:vis fn $name:ident(self as $first:ident $(, $argument:ident)*) $scalar:expr; $vector:expr) => {
        $(#[$doc])*
        #[inline(always)]
        #[must_use]
        $visibility fn $name(self $(, $argument: Self)*) -> Self {
            #[cfg(target_arch = "x86_64")]
            if F && L % 4 == 0 {
                let mut out = [0.0; L];
                for k in (0..L).step_by(4) {
                    // SAFETY: fused lanes exist only where `dispatch_on` has found AVX2 and FMA; k + 4 <= L.
                    unsafe {
                        let $first = x86::_mm256_loadu_pd(self.0.as_ptr().add(k));
                        $(let $argument = x86::_mm256_loadu_pd($argument.0.as_ptr().add(k));)*
                        x86::_mm256_storeu_pd(out.as_mut_ptr().add(k), $vector);
                    }
                }
                return Self(out);
            }
            Self(std::array::from_fn(|l| {
                let $first = self.0[l];
                $(let $argument = $argument.0[l];)*
                $scalar
            }))
        }
    };
}

/// The bit of the sign.
const SIGN: u64 = 1 << 63;
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn sign_bits() -> x86::__m256d {
    // SAFETY: as the caller.
    unsafe { x86::_mm256_set1_pd(-0.0) }
}

/// Bits of each number, moved up.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn shifted<const BY: i32>(a: x86::__m256d) -> x86::__m256d {
    // SAFETY: as the caller.
    unsafe { x86::_mm256_castsi256_pd(x86::_mm256_slli_epi64::<BY>(x86::_mm256_castpd_si256(a))) }
}

impl<const L: usize, const F: bool> Lanes<L, F> {
    lane_wise!(fn add_lanes(self as a, b) a + b; x86::_mm256_add_pd(a, b));
    lane_wise!(fn sub_lanes(self as a, b) a - b; x86::_mm256_sub_pd(a, b));
    lane_wise!(fn mul_lanes(self as a, b) a * b; x86::_mm256_mul_pd(a, b));
    lane_wise!(fn div_lanes(self as a, b) a / b; x86::_mm256_div_pd(a, b));
    lane_wise!(fn neg_lanes(self as a) -a; x86::_mm256_xor_pd(a, sign_bits()));
    lane_wise!(fn fused(self as a, b, c) fused::<F>(a, b, c); x86::_mm256_fmadd_pd(a, b, c));
    lane_wise!(
        /// `a * b - c`, rounded once where the processor can.
        pub fn mul_sub(self as a, b, c) fused::<F>(a, b, -c); x86::_mm256_fmsub_pd(a, b, c));
    lane_wise!(
        /// `c - a * b`, rounded once where the processor can.
        pub fn neg_mul_add(self as a, b, c) fused::<F>(-a, b, c); x86::_mm256_fnmadd_pd(a, b, c));
    lane_wise!(
        /// Absolute values.
        pub fn abs(self as a) a.abs(); x86::_mm256_andnot_pd(sign_bits(), a));
    lane_wise!(
        /// The smaller of each pair; the second where one is NaN.
        pub fn min(self as a, b) if a < b { a } else { b }; x86::_mm256_min_pd(a, b));
    lane_wise!(
        /// The larger of each pair; the second where one is NaN.
        pub fn max(self as a, b) if a > b { a } else { b }; x86::_mm256_max_pd(a, b));
    lane_wise!(
        /// `a` with the sign of `b`.
        pub fn copysign(self as a, b) a.copysign(b);
        x86::_mm256_or_pd(x86::_mm256_andnot_pd(sign_bits(), a), x86::_mm256_and_pd(sign_bits(), b)));
    lane_wise!(
        /// `a` where `b > c`, otherwise zero.
        pub fn where_above(self as a, b, c) if b > c { a } else { 0.0 };
        x86::_mm256_and_pd(a, x86::_mm256_cmp_pd::<{ x86::_CMP_GT_OQ }>(b, c)));
    lane_wise!(
        /// `a` where `c > 0`, otherwise `b`.
        pub fn or_where_not_above(self as a, b, c) if c > 0.0 { a } else { b };
        x86::_mm256_blendv_pd(b, a, x86::_mm256_cmp_pd::<{ x86::_CMP_GT_OQ }>(c, x86::_mm256_setzero_pd())));
    lane_wise!(
        /// `a` with its sign turned where the lowest bit but one of `bits` is set.
        pub(super) fn turned_by(self as a, bits) f64::from_bits(a.to_bits() ^ ((bits.to_bits() << 62) & SIGN));
        x86::_mm256_xor_pd(a, x86::_mm256_and_pd(shifted::<62>(bits), sign_bits())));
    lane_wise!(
        /// `b` where the lowest bit of `bits` is set, otherwise `a`.
        pub(super) fn chosen_by(self as a, b, bits) if bits.to_bits() & 1 == 1 { b } else { a };
        x86::_mm256_blendv_pd(a, b, shifted::<63>(bits)));
    lane_wise!(
    /// `2^k` of the integer `k` that [`ROUND`] has left in the low bits of `bits`.
    pub(super) fn power_of_two(self as bits) f64::from_bits(bits.to_bits().wrapping_add(1023) << 52);
    x86::_mm256_castsi256_pd(x86::_mm256_slli_epi64::<52>(x86::_mm256_add_epi64(
        x86::_mm256_castpd_si256(bits),
        x86::_mm256_set1_epi64x(1023),
    ))));

    /// The same number in each lane.
    #[inline(always)]
    pub(crate) fn splat(value: f64) -> Self {
        Self([value; L])
    }

    /// Zero in each lane.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self([0.0; L])
    }

    /// The numbers, lane by lane.
    #[inline(always)]
    pub fn to_array(self) -> [f64; L] {
        self.0
    }

    /// The first `L` numbers of a slice.
    #[inline(always)]
    pub(crate) fn from_slice(values: &[f64]) -> Self {
        let mut lanes = Self::zero();
        lanes.0.copy_from_slice(&values[..L]);
        lanes
    }

    /// Entry `column` of rows `row`, `row + 1`, ... of a row-major array; the last row stands in past the end.
    #[inline(always)]
    pub(crate) fn gather(rows: &[f64], width: usize, row: usize, column: usize) -> Self {
        let last = rows.len() / width - 1;
        Self(std::array::from_fn(|l| rows[(row + l).min(last) * width + column]))
    }

    /// Entry `k` of row `l` of a row-major array of `values.len()` columns is lane `l` of `values[k]`, as far as there are rows.
    #[inline(always)]
    pub(crate) fn scatter(values: &[Self], rows: &mut [f64], width: usize) {
        for (l, row) in rows.chunks_mut(width).enumerate().take(L) {
            for (out, value) in row.iter_mut().zip(values) {
                *out = value.0[l];
            }
        }
    }

    /// Four values lane by lane.
    #[inline(always)]
    pub(crate) fn turned(values: [Self; 4]) -> [[f64; 4]; L] {
        let mut out = [[0.0; 4]; L];
        #[cfg(target_arch = "x86_64")]
        if F && L.is_multiple_of(4) {
            let [a, b, c, d] = values;
            for k in (0..L).step_by(4) {
                // SAFETY: as in `lane_wise`; k + 4 <= L rows of four.
                unsafe {
                    let a = x86::_mm256_loadu_pd(a.0.as_ptr().add(k));
                    let b = x86::_mm256_loadu_pd(b.0.as_ptr().add(k));
                    let c = x86::_mm256_loadu_pd(c.0.as_ptr().add(k));
                    let d = x86::_mm256_loadu_pd(d.0.as_ptr().add(k));
                    // Pairs of a and b, of c and d; then halves put together.
                    let (ab, ab_odd) = (x86::_mm256_unpacklo_pd(a, b), x86::_mm256_unpackhi_pd(a, b));
                    let (cd, cd_odd) = (x86::_mm256_unpacklo_pd(c, d), x86::_mm256_unpackhi_pd(c, d));
                    let rows = out.as_mut_ptr().add(k).cast::<f64>();
                    x86::_mm256_storeu_pd(rows, x86::_mm256_permute2f128_pd::<0x20>(ab, cd));
                    x86::_mm256_storeu_pd(rows.add(4), x86::_mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd));
                    x86::_mm256_storeu_pd(rows.add(8), x86::_mm256_permute2f128_pd::<0x31>(ab, cd));
                    x86::_mm256_storeu_pd(rows.add(12), x86::_mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd));
                }
            }
            return out;
        }
        for l in 0..L {
            out[l] = [values[0].0[l], values[1].0[l], values[2].0[l], values[3].0[l]];
        }
        out
    }

    /// Is every lane above `bound`? NaN is not.
    #[inline(always)]
    pub fn all_above(self, bound: f64) -> bool {
        #[cfg(target_arch = "x86_64")]
        if F && L.is_multiple_of(4) {
            let mut all = 15;
            for k in (0..L).step_by(4) {
                // SAFETY: as in `lane_wise`.
                all &= unsafe {
                    let a = x86::_mm256_loadu_pd(self.0.as_ptr().add(k));
                    x86::_mm256_movemask_pd(x86::_mm256_cmp_pd::<{ x86::_CMP_GT_OQ }>(
                        a,
                        x86::_mm256_set1_pd(bound),
                    ))
                };
            }
            return all == 15;
        }
        self.0.iter().all(|&a| a > bound)
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
        self.fused(b, c)
    }

    /// Times a plain number.
    #[inline(always)]
    #[must_use]
    pub fn scale(self, factor: f64) -> Self {
        self * Self::splat(factor)
    }

    /// The polynomial in `self` of these coefficients, from the highest to the lowest, by Horner's rule.
    #[inline(always)]
    pub(crate) fn horner<const N: usize>(self, coefficients: [Self; N]) -> Self {
        let mut sum = coefficients[0];
        for &coefficient in &coefficients[1..] {
            sum = sum.mul_add(self, coefficient);
        }
        sum
    }
}

/// Entries `first`, `first + 1`, ... of an array of single lanes as the lanes of one register.
#[inline(always)]
pub(crate) fn side_by_side<const L: usize, const F: bool>(
    values: &[Lanes<L, F>],
    first: usize,
) -> Lanes<WIDTH, F> {
    Lanes(std::array::from_fn(|k| values[first + k].0[0]))
}

/// Back: the lanes of a register into entries `first`, `first + 1`, ... of an array of single lanes.
#[inline(always)]
pub(crate) fn spread<const L: usize, const F: bool>(
    lanes: Lanes<WIDTH, F>,
    values: &mut [Lanes<L, F>],
    first: usize,
) {
    for k in 0..WIDTH {
        values[first + k] = Lanes::splat(lanes.0[k]);
    }
}

#[inline(always)]
fn fused<const F: bool>(a: f64, b: f64, c: f64) -> f64 {
    if F { a.mul_add(b, c) } else { a * b + c }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $by:ident) => {
        impl<const L: usize, const F: bool> $trait for Lanes<L, F> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.$by(other)
            }
        }
    };
}
operator!(Add, add, add_lanes);
operator!(Sub, sub, sub_lanes);
operator!(Mul, mul, mul_lanes);
operator!(Div, div, div_lanes);

impl<const L: usize, const F: bool> Neg for Lanes<L, F> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.neg_lanes()
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
    use crate::ground::dispatch::{Kernel, dispatch, dispatch_on};

    #[test]
    fn lanes_do_not_see_each_other() {
        let x = Lanes::<4, false>([0.1, -2.0, 3.0, 40.0]);
        let (s, c) = x.sin_cos();
        for l in 0..4 {
            let (sl, cl) = Lanes::<1, false>([x.0[l]]).sin_cos();
            assert_eq!((s.0[l].to_bits(), c.0[l].to_bits()), (sl.0[0].to_bits(), cl.0[0].to_bits()));
        }
    }

    struct Turned;
    impl Kernel for Turned {
        type Output = [[f64; 4]; 4];
        #[inline(always)]
        fn run<const L: usize, const F: bool>(self) -> Self::Output {
            let value = |k: f64| Lanes::<L, F>(std::array::from_fn(|l| 10.0 * k + l as f64));
            let turned = Lanes::turned([value(0.0), value(1.0), value(2.0), value(3.0)]);
            std::array::from_fn(|l| turned[l])
        }
    }

    #[test]
    fn turning_is_a_transposition() {
        for turned in [dispatch(Turned), Turned.run::<4, false>()] {
            for l in 0..4 {
                assert_eq!(turned[l], std::array::from_fn(|k| 10.0 * k as f64 + l as f64));
            }
        }
    }

    /// Every operation on these numbers, and whether all of the first are above 1.
    struct Operations([[f64; 8]; 3]);
    impl Kernel for Operations {
        type Output = (Vec<Vec<f64>>, Vec<bool>);
        #[inline(always)]
        fn run<const L: usize, const F: bool>(self) -> Self::Output {
            let (mut results, mut above) = (vec![Vec::new(); 17], Vec::new());
            for first in (0..8).step_by(L) {
                let [a, b, c] = self.0.map(|numbers| Lanes::<L, F>::from_slice(&numbers[first..]));
                let all = [
                    a + b,
                    a - b,
                    a * b,
                    a / b,
                    -a,
                    a.mul_add(b, c),
                    a.mul_sub(b, c),
                    a.neg_mul_add(b, c),
                    a.abs(),
                    a.min(b),
                    a.max(b),
                    a.copysign(b),
                    a.where_above(b, c),
                    a.or_where_not_above(b, c),
                    a.sin_cos().0,
                    a.sin_cos().1,
                    a.tanh(),
                ];
                for (result, lanes) in results.iter_mut().zip(all) {
                    result.extend(lanes.to_array());
                }
                above.push(a.all_above(1.0));
            }
            (results, above)
        }
    }

    #[test]
    fn vectors_give_what_single_numbers_give() {
        let numbers = [
            [0.3, -2.0, 30.0, -1e3, 1.5, 2.5, 3.5, 4.5],
            [-0.7, 1.1, 0.25, -3.0, 1.5, -2.5, 1e-3, 7.0],
            [0.1, 1.1, -0.4, 2.0, 1.6, 0.0, -0.0, 7.5],
        ];
        let (vectors, above) = dispatch(Operations(numbers));
        let (single, above_single) = dispatch_on::<1, _>(Operations(numbers));
        for (operation, (vector, single)) in vectors.iter().zip(&single).enumerate() {
            for l in 0..8 {
                assert_eq!(vector[l].to_bits(), single[l].to_bits(), "operation {operation}, number {l}");
            }
        }
        // Without fused operations, the oldest processor's way: the same but for rounding.
        let (unfused, above_unfused) = Operations(numbers).run::<4, false>();
        for (operation, (vector, unfused)) in vectors.iter().zip(&unfused).enumerate() {
            for l in 0..8 {
                let (got, want) = (unfused[l], vector[l]);
                assert!(
                    (got - want).abs() <= 1e-15 * (1.0 + want.abs()),
                    "operation {operation}: {got} {want}"
                );
            }
        }
        let [a, b, c] = numbers;
        for l in 0..8 {
            let want = [
                a[l] + b[l],
                a[l] - b[l],
                a[l] * b[l],
                a[l] / b[l],
                -a[l],
                a[l] * b[l] + c[l],
                a[l] * b[l] - c[l],
                c[l] - a[l] * b[l],
                a[l].abs(),
                a[l].min(b[l]),
                a[l].max(b[l]),
                a[l].copysign(b[l]),
                if b[l] > c[l] { a[l] } else { 0.0 },
                if c[l] > 0.0 { a[l] } else { b[l] },
                a[l].sin(),
                a[l].cos(),
                a[l].tanh(),
            ];
            for (operation, (result, want)) in vectors.iter().zip(want).enumerate() {
                let got = result[l];
                assert!(
                    (got - want).abs() <= 1e-15 * (1.0 + want.abs()),
                    "operation {operation}: {got} {want}"
                );
            }
        }
        assert_eq!(above, [false, true]);
        assert_eq!(above_unfused, above);
        assert_eq!(above_single, [false, false, true, false, true, true, true, true]);
        assert!(!Lanes::<4>([2.0, 2.0, f64::NAN, 2.0]).all_above(1.0));
    }

    #[test]
    fn gather_repeats_the_last_row_past_the_end() {
        let rows = [1.0, 10.0, 2.0, 20.0, 3.0, 30.0];
        assert_eq!(Lanes::<4>::gather(&rows, 2, 1, 1).0, [20.0, 30.0, 30.0, 30.0]);
    }
}
