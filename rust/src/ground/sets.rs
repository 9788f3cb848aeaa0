//! The forms in which numbers lie side by side, each with its operations. The only place that names instructions.
//!
//! [`Plain`] and [`Fused`] hold them in arrays, for any processor; on x86-64, [`Avx2`] holds four in a register and [`Avx512`]
//! eight. An operation gives the same bits in every form, except that `a * b + c` rounds once in all but [`Plain`]. It stands here once,
//! with its form for a single number, for four and for eight.

// Vector instructions need `unsafe` for what the compiler cannot see: that the processor has them. `dispatch.rs` has found out.
#![allow(unsafe_code)]

use std::ops::{Index, IndexMut};

#[cfg(target_arch = "x86_64")]
use std::arch::x86_64 as x86;

/// Sign bit of a 64-bit float.
const SIGN: u64 = 1 << 63;

/// Numbers side by side, and how they are held.
pub trait Held: Copy + Send + Sync + 'static {
    /// Number of lanes.
    const L: usize;
    /// Whether `a * b + c` rounds once. It follows the processor, not the number of lanes or threads.
    const FUSED: bool;
    /// The numbers.
    type Numbers: Copy + Send + Sync;
    /// Something for each of them.
    type Of<T>: AsRef<[T]> + AsMut<[T]> + Index<usize, Output = T> + IndexMut<usize>;
    /// Four of them, on the same processor, for what a single lane takes side by side.
    type Wide: Set;

    /// Something for each lane.
    fn of<T>(each: impl FnMut(usize) -> T) -> Self::Of<T>;
    /// Numbers from an array.
    fn held(numbers: Self::Of<f64>) -> Self::Numbers;
    /// And back.
    fn array(numbers: Self::Numbers) -> Self::Of<f64>;
    /// The same number in each lane.
    fn splat(value: f64) -> Self::Numbers;
    /// Is every number above `bound`? NaN is not.
    fn all_above(numbers: Self::Numbers, bound: f64) -> bool;
    /// Four values lane by lane.
    fn turned(values: [Self::Numbers; 4]) -> Self::Of<[f64; 4]>;
}

/// `L` numbers in an array, for processors whose multiplications and additions are two operations.
#[derive(Debug, Clone, Copy)]
pub struct Plain<const L: usize>;

/// `L` numbers in an array, for processors that can fuse them.
#[derive(Debug, Clone, Copy)]
pub struct Fused<const L: usize>;

/// Four numbers in a register of AVX2. Only `dispatch.rs` starts a kernel on them.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub struct Avx2;

/// Eight numbers in a register of AVX-512. Likewise.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub struct Avx512;

/// Four numbers, for processors that can fuse.
#[cfg(target_arch = "x86_64")]
pub type Four = Avx2;
/// Four numbers, for processors that can fuse.
#[cfg(not(target_arch = "x86_64"))]
pub type Four = Fused<4>;

macro_rules! held_in_array {
    ($set:ident, $fused:literal, $wide:ty) => {
        impl<const N: usize> Held for $set<N> {
            const L: usize = N;
            const FUSED: bool = $fused;
            type Numbers = [f64; N];
            type Of<T> = [T; N];
            type Wide = $wide;

            #[inline(always)]
            fn of<T>(each: impl FnMut(usize) -> T) -> [T; N] {
                std::array::from_fn(each)
            }

            #[inline(always)]
            fn held(numbers: [f64; N]) -> [f64; N] {
                numbers
            }

            #[inline(always)]
            fn array(numbers: [f64; N]) -> [f64; N] {
                numbers
            }

            #[inline(always)]
            fn splat(value: f64) -> [f64; N] {
                [value; N]
            }

            #[inline(always)]
            fn all_above(numbers: [f64; N], bound: f64) -> bool {
                numbers.iter().all(|&a| a > bound)
            }

            #[inline(always)]
            fn turned(values: [[f64; N]; 4]) -> [[f64; 4]; N] {
                std::array::from_fn(|l| values.map(|value| value[l]))
            }
        }
    };
}
held_in_array!(Plain, false, Plain<4>);
held_in_array!(Fused, true, Four);

#[cfg(target_arch = "x86_64")]
impl Held for Avx2 {
    const L: usize = 4;
    const FUSED: bool = true;
    type Numbers = x86::__m256d;
    type Of<T> = [T; 4];
    type Wide = Self;

    #[inline(always)]
    fn of<T>(each: impl FnMut(usize) -> T) -> [T; 4] {
        std::array::from_fn(each)
    }

    #[inline(always)]
    fn held(numbers: [f64; 4]) -> x86::__m256d {
        // SAFETY: the processor has AVX2, and there are four numbers.
        unsafe { x86::_mm256_loadu_pd(numbers.as_ptr()) }
    }

    #[inline(always)]
    fn array(numbers: x86::__m256d) -> [f64; 4] {
        let mut array = [0.0; 4];
        // SAFETY: likewise.
        unsafe { x86::_mm256_storeu_pd(array.as_mut_ptr(), numbers) };
        array
    }

    #[inline(always)]
    fn splat(value: f64) -> x86::__m256d {
        // SAFETY: the processor has AVX2.
        unsafe { x86::_mm256_set1_pd(value) }
    }

    #[inline(always)]
    fn all_above(numbers: x86::__m256d, bound: f64) -> bool {
        // SAFETY: the processor has AVX2.
        unsafe {
            let above = x86::_mm256_cmp_pd::<{ x86::_CMP_GT_OQ }>(numbers, x86::_mm256_set1_pd(bound));
            x86::_mm256_movemask_pd(above) == 15
        }
    }

    #[inline(always)]
    fn turned([a, b, c, d]: [x86::__m256d; 4]) -> [[f64; 4]; 4] {
        // SAFETY: the processor has AVX2.
        let rows = unsafe {
            // Pairs of a and b, of c and d; then halves put together.
            let (ab, ab_odd) = (x86::_mm256_unpacklo_pd(a, b), x86::_mm256_unpackhi_pd(a, b));
            let (cd, cd_odd) = (x86::_mm256_unpacklo_pd(c, d), x86::_mm256_unpackhi_pd(c, d));
            [
                x86::_mm256_permute2f128_pd::<0x20>(ab, cd),
                x86::_mm256_permute2f128_pd::<0x20>(ab_odd, cd_odd),
                x86::_mm256_permute2f128_pd::<0x31>(ab, cd),
                x86::_mm256_permute2f128_pd::<0x31>(ab_odd, cd_odd),
            ]
        };
        [Self::array(rows[0]), Self::array(rows[1]), Self::array(rows[2]), Self::array(rows[3])]
    }
}

#[cfg(target_arch = "x86_64")]
impl Held for Avx512 {
    const L: usize = 8;
    const FUSED: bool = true;
    type Numbers = x86::__m512d;
    type Of<T> = [T; 8];
    type Wide = Avx2;

    #[inline(always)]
    fn of<T>(each: impl FnMut(usize) -> T) -> [T; 8] {
        std::array::from_fn(each)
    }

    #[inline(always)]
    fn held(numbers: [f64; 8]) -> x86::__m512d {
        // SAFETY: the processor has AVX-512, and there are eight numbers.
        unsafe { x86::_mm512_loadu_pd(numbers.as_ptr()) }
    }

    #[inline(always)]
    fn array(numbers: x86::__m512d) -> [f64; 8] {
        let mut array = [0.0; 8];
        // SAFETY: likewise.
        unsafe { x86::_mm512_storeu_pd(array.as_mut_ptr(), numbers) };
        array
    }

    #[inline(always)]
    fn splat(value: f64) -> x86::__m512d {
        // SAFETY: the processor has AVX-512.
        unsafe { x86::_mm512_set1_pd(value) }
    }

    #[inline(always)]
    fn all_above(numbers: x86::__m512d, bound: f64) -> bool {
        // SAFETY: the processor has AVX-512.
        unsafe { x86::_mm512_cmp_pd_mask::<{ x86::_CMP_GT_OQ }>(numbers, x86::_mm512_set1_pd(bound)) == 255 }
    }

    #[inline(always)]
    fn turned(values: [x86::__m512d; 4]) -> [[f64; 4]; 8] {
        let [a, b, c, d] =
            [Self::array(values[0]), Self::array(values[1]), Self::array(values[2]), Self::array(values[3])];
        std::array::from_fn(|l| [a[l], b[l], c[l], d[l]])
    }
}

/// Helpers for the table of operations below. Unsafe as the instructions they stand for.
#[cfg(target_arch = "x86_64")]
mod bits {
    use super::x86;

    #[inline(always)]
    pub unsafe fn sign4() -> x86::__m256d {
        // SAFETY: as the caller.
        unsafe { x86::_mm256_set1_pd(-0.0) }
    }

    #[inline(always)]
    pub unsafe fn sign8() -> x86::__m512d {
        // SAFETY: as the caller.
        unsafe { x86::_mm512_set1_pd(-0.0) }
    }

    /// Bits of each number, moved up.
    #[inline(always)]
    pub unsafe fn shifted4<const BY: i32>(a: x86::__m256d) -> x86::__m256d {
        // SAFETY: as the caller.
        unsafe { x86::_mm256_castsi256_pd(x86::_mm256_slli_epi64::<BY>(x86::_mm256_castpd_si256(a))) }
    }

    /// Bits of each number, moved up.
    #[inline(always)]
    pub unsafe fn shifted8<const BY: u32>(a: x86::__m512d) -> x86::__m512d {
        // SAFETY: as the caller.
        unsafe { x86::_mm512_castsi512_pd(x86::_mm512_slli_epi64::<BY>(x86::_mm512_castpd_si512(a))) }
    }

    /// Where `a > b`.
    #[inline(always)]
    pub unsafe fn above4(a: x86::__m256d, b: x86::__m256d) -> x86::__m256d {
        // SAFETY: as the caller.
        unsafe { x86::_mm256_cmp_pd::<{ x86::_CMP_GT_OQ }>(a, b) }
    }

    /// Where `a > b`.
    #[inline(always)]
    pub unsafe fn above8(a: x86::__m512d, b: x86::__m512d) -> x86::__mmask8 {
        // SAFETY: as the caller.
        unsafe { x86::_mm512_cmp_pd_mask::<{ x86::_CMP_GT_OQ }>(a, b) }
    }
}

/// Operations lane by lane: the name, a single number (`FUSED` says whether it may round once), four numbers, eight.
macro_rules! operations {
    ($($(#[$doc:meta])* fn $name:ident($($argument:ident),*) $fused:ident $single:expr; $four:expr; $eight:expr;)*) => {
        /// How numbers are held, and what can be done with them.
        pub trait Set: Held {
            $($(#[$doc])* fn $name($($argument: Self::Numbers),*) -> Self::Numbers;)*
        }

        impl<const L: usize> Set for Plain<L> {
            $(#[inline(always)]
            fn $name($($argument: [f64; L]),*) -> [f64; L] {
                #[allow(unused)] // most operations round in one way only
                const $fused: bool = false;
                std::array::from_fn(|l| { $(let $argument = $argument[l];)* $single })
            })*
        }

        impl<const L: usize> Set for Fused<L> {
            $(#[inline(always)]
            fn $name($($argument: [f64; L]),*) -> [f64; L] {
                #[allow(unused)]
                const $fused: bool = true;
                std::array::from_fn(|l| { $(let $argument = $argument[l];)* $single })
            })*
        }

        #[cfg(target_arch = "x86_64")]
        impl Set for Avx2 {
            $(#[inline(always)]
            fn $name($($argument: x86::__m256d),*) -> x86::__m256d {
                // SAFETY: only `dispatch.rs` starts kernels on this set, where it has found AVX2 and FMA.
                unsafe { $four }
            })*
        }

        #[cfg(target_arch = "x86_64")]
        impl Set for Avx512 {
            $(#[inline(always)]
            fn $name($($argument: x86::__m512d),*) -> x86::__m512d {
                // SAFETY: likewise AVX-512.
                unsafe { $eight }
            })*
        }
    };
}

operations! {
    /// Sum.
    fn add(a, b) FUSED a + b; x86::_mm256_add_pd(a, b); x86::_mm512_add_pd(a, b);
    /// Difference.
    fn sub(a, b) FUSED a - b; x86::_mm256_sub_pd(a, b); x86::_mm512_sub_pd(a, b);
    /// Product.
    fn mul(a, b) FUSED a * b; x86::_mm256_mul_pd(a, b); x86::_mm512_mul_pd(a, b);
    /// Quotient.
    fn div(a, b) FUSED a / b; x86::_mm256_div_pd(a, b); x86::_mm512_div_pd(a, b);
    /// The other sign.
    fn neg(a) FUSED -a; x86::_mm256_xor_pd(a, bits::sign4()); x86::_mm512_xor_pd(a, bits::sign8());
    /// Square root.
    fn sqrt(a) FUSED a.sqrt(); x86::_mm256_sqrt_pd(a); x86::_mm512_sqrt_pd(a);
    /// `a * b + c`, rounded once where the processor can.
    fn mul_add(a, b, c) FUSED fused::<FUSED>(a, b, c); x86::_mm256_fmadd_pd(a, b, c); x86::_mm512_fmadd_pd(a, b, c);
    /// `a * b - c`, rounded once where the processor can.
    fn mul_sub(a, b, c) FUSED fused::<FUSED>(a, b, -c); x86::_mm256_fmsub_pd(a, b, c); x86::_mm512_fmsub_pd(a, b, c);
    /// `c - a * b`, rounded once where the processor can.
    fn neg_mul_add(a, b, c) FUSED fused::<FUSED>(-a, b, c);
        x86::_mm256_fnmadd_pd(a, b, c); x86::_mm512_fnmadd_pd(a, b, c);
    /// Absolute values.
    fn abs(a) FUSED a.abs(); x86::_mm256_andnot_pd(bits::sign4(), a); x86::_mm512_andnot_pd(bits::sign8(), a);
    /// The smaller of each pair; the second where one is NaN.
    fn min(a, b) FUSED if a < b { a } else { b }; x86::_mm256_min_pd(a, b); x86::_mm512_min_pd(a, b);
    /// The larger of each pair; the second where one is NaN.
    fn max(a, b) FUSED if a > b { a } else { b }; x86::_mm256_max_pd(a, b); x86::_mm512_max_pd(a, b);
    /// `a` with the sign of `b`.
    fn copysign(a, b) FUSED a.copysign(b);
        x86::_mm256_or_pd(x86::_mm256_andnot_pd(bits::sign4(), a), x86::_mm256_and_pd(bits::sign4(), b));
        x86::_mm512_or_pd(x86::_mm512_andnot_pd(bits::sign8(), a), x86::_mm512_and_pd(bits::sign8(), b));
    /// `a` where `b > c`, otherwise zero.
    fn where_above(a, b, c) FUSED if b > c { a } else { 0.0 };
        x86::_mm256_and_pd(a, bits::above4(b, c)); x86::_mm512_maskz_mov_pd(bits::above8(b, c), a);
    /// `a` where `c > 0`, otherwise `b`.
    fn or_where_not_above(a, b, c) FUSED if c > 0.0 { a } else { b };
        x86::_mm256_blendv_pd(b, a, bits::above4(c, x86::_mm256_setzero_pd()));
        x86::_mm512_mask_blend_pd(bits::above8(c, x86::_mm512_setzero_pd()), b, a);
    /// `a` with its sign turned where the lowest bit but one of `by` is set.
    fn turned_by(a, by) FUSED f64::from_bits(a.to_bits() ^ ((by.to_bits() << 62) & SIGN));
        x86::_mm256_xor_pd(a, x86::_mm256_and_pd(bits::shifted4::<62>(by), bits::sign4()));
        x86::_mm512_xor_pd(a, x86::_mm512_and_pd(bits::shifted8::<62>(by), bits::sign8()));
    /// `b` where the lowest bit of `by` is set, otherwise `a`.
    fn chosen_by(a, b, by) FUSED if by.to_bits() & 1 == 1 { b } else { a };
        x86::_mm256_blendv_pd(a, b, bits::shifted4::<63>(by));
        x86::_mm512_mask_blend_pd(x86::_mm512_test_epi64_mask(x86::_mm512_castpd_si512(by), x86::_mm512_set1_epi64(1)), a, b);
    /// `2^k` of the integer `k` in the low bits of `by`.
    fn power_of_two(by) FUSED f64::from_bits(by.to_bits().wrapping_add(1023) << 52);
        x86::_mm256_castsi256_pd(x86::_mm256_slli_epi64::<52>(
            x86::_mm256_add_epi64(x86::_mm256_castpd_si256(by), x86::_mm256_set1_epi64x(1023))));
        x86::_mm512_castsi512_pd(x86::_mm512_slli_epi64::<52>(
            x86::_mm512_add_epi64(x86::_mm512_castpd_si512(by), x86::_mm512_set1_epi64(1023))));
}

#[inline(always)]
fn fused<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}
