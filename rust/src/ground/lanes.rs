//! `Lanes<V>`: samples or candidates side by side, as the set `V` holds them (`sets.rs`).
//!
//! The equations are written once, over [`Lanes`]. [`dispatch`](super::dispatch::dispatch) compiles a kernel for the instruction sets that
//! matter and chooses one at run time. Every function a kernel calls on its hot path is `#[inline(always)]`, or it would be compiled
//! for the oldest processor.
//!
//! Four and eight lanes are held in the vector registers themselves: left to itself the compiler takes arrays apart and puts only
//! some of them together again.

use super::sets::Held;
pub use super::sets::{Fused, Plain, Set};

use std::fmt;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Numbers that go through the same operations.
#[derive(Clone, Copy)]
pub struct Lanes<V: Set>(V::Numbers);

/// Operations of the set as methods of its lanes.
macro_rules! methods {
    ($($(#[$doc:meta])* fn $name:ident($($argument:ident),*);)*) => {$(
        $(#[$doc])*
        #[inline(always)]
        #[must_use]
        pub fn $name(self $(, $argument: Self)*) -> Self {
            Self(V::$name(self.0 $(, $argument.0)*))
        }
    )*};
}

impl<V: Set> Lanes<V> {
    methods! {
        /// `self * b + c`, rounded once where the processor can.
        fn mul_add(b, c);
        /// `self * b - c`, rounded once where the processor can.
        fn mul_sub(b, c);
        /// `c - self * b`, rounded once where the processor can.
        fn neg_mul_add(b, c);
        /// Absolute values.
        fn abs();
        /// Square roots.
        fn sqrt();
        /// The smaller of each pair; the second where one is NaN.
        fn min(b);
        /// The larger of each pair; the second where one is NaN.
        fn max(b);
        /// The numbers with the signs of `b`.
        fn copysign(b);
        /// The numbers where `b > c`, otherwise zero.
        fn where_above(b, c);
        /// The numbers where `c > 0`, otherwise `b`.
        fn or_where_not_above(b, c);
        /// The numbers, their sign turned where the lowest bit but one of `bits` is set.
        fn turned_by(bits);
        /// `b` where the lowest bit of `bits` is set, otherwise the numbers.
        fn chosen_by(b, bits);
        /// `2^k` of the integers `k` in the low bits.
        fn power_of_two();
    }

    /// The same number in each lane.
    #[inline(always)]
    pub(crate) fn splat(value: f64) -> Self {
        Self(V::splat(value))
    }

    /// Zero in each lane.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self::splat(0.0)
    }

    /// A number for each lane.
    #[inline(always)]
    pub(crate) fn each(number: impl FnMut(usize) -> f64) -> Self {
        Self(V::held(V::of(number)))
    }

    /// The numbers, lane by lane.
    #[inline(always)]
    pub fn to_array(self) -> V::Of<f64> {
        V::array(self.0)
    }

    /// The number of one lane.
    #[inline(always)]
    pub fn lane(self, l: usize) -> f64 {
        self.to_array()[l]
    }

    /// Sets the number of one lane.
    #[inline(always)]
    pub(crate) fn set_lane(&mut self, l: usize, value: f64) {
        let mut numbers = self.to_array();
        numbers[l] = value;
        self.0 = V::held(numbers);
    }

    /// The first numbers of a slice.
    #[inline(always)]
    pub(crate) fn from_slice(values: &[f64]) -> Self {
        let mut numbers = V::of(|_| 0.0);
        numbers.as_mut().copy_from_slice(&values[..V::L]);
        Self(V::held(numbers))
    }

    /// Writes the numbers to the start of a slice.
    #[inline(always)]
    pub(crate) fn store(self, out: &mut [f64]) {
        out[..V::L].copy_from_slice(self.to_array().as_ref());
    }

    /// Entry `column` of rows `row`, `row + 1`, ... of a row-major array; the last row stands in past the end.
    #[inline(always)]
    pub(crate) fn gather(rows: &[f64], width: usize, row: usize, column: usize) -> Self {
        let last = rows.len() / width - 1;
        Self::each(|l| rows[(row + l).min(last) * width + column])
    }

    /// Entry `k` of row `l` of a row-major array of `values.len()` columns is lane `l` of `values[k]`, as far as there are rows.
    #[inline(always)]
    pub(crate) fn scatter(values: &[Self], rows: &mut [f64], width: usize) {
        for (k, value) in values.iter().enumerate() {
            let numbers = value.to_array();
            for l in 0..V::L {
                if let Some(out) = rows.get_mut(l * width + k) {
                    *out = numbers[l];
                }
            }
        }
    }

    /// Four values lane by lane.
    #[inline(always)]
    pub(crate) fn turned(values: [Self; 4]) -> V::Of<[f64; 4]> {
        V::turned([values[0].0, values[1].0, values[2].0, values[3].0])
    }

    /// Is every lane above `bound`? NaN is not.
    #[inline(always)]
    pub fn all_above(self, bound: f64) -> bool {
        V::all_above(self.0, bound)
    }

    /// `f` of each lane.
    #[inline(always)]
    #[must_use]
    pub fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let numbers = self.to_array();
        Self::each(|l| f(numbers[l]))
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
pub(crate) fn side_by_side<V: Set>(values: &[Lanes<V>], first: usize) -> Lanes<V::Wide> {
    Lanes::each(|k| values[first + k].lane(0))
}

/// Back: the lanes of a register into entries `first`, `first + 1`, ... of an array of single lanes.
#[inline(always)]
pub(crate) fn spread<V: Set>(lanes: Lanes<V::Wide>, values: &mut [Lanes<V>], first: usize) {
    let numbers = lanes.to_array();
    for k in 0..<V::Wide as Held>::L {
        values[first + k] = Lanes::splat(numbers[k]);
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident) => {
        impl<V: Set> $trait for Lanes<V> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self(V::$method(self.0, other.0))
            }
        }
    };
}
operator!(Add, add);
operator!(Sub, sub);
operator!(Mul, mul);
operator!(Div, div);

impl<V: Set> Neg for Lanes<V> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(V::neg(self.0))
    }
}

impl<V: Set> AddAssign for Lanes<V> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<V: Set> SubAssign for Lanes<V> {
    #[inline(always)]
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

impl<V: Set> PartialEq for Lanes<V> {
    fn eq(&self, other: &Self) -> bool {
        self.to_array().as_ref() == other.to_array().as_ref()
    }
}

impl<V: Set> fmt::Debug for Lanes<V> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.to_array().as_ref())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::dispatch::{Kernel, run_on};
    use crate::ground::isa::Isa;

    #[test]
    fn lanes_do_not_see_each_other() {
        let x = Lanes::<Plain<4>>::from_slice(&[0.1, -2.0, 3.0, 40.0]);
        let (s, c) = x.sin_cos();
        for l in 0..4 {
            let (sl, cl) = Lanes::<Plain<1>>::splat(x.lane(l)).sin_cos();
            assert_eq!(
                (s.lane(l).to_bits(), c.lane(l).to_bits()),
                (sl.lane(0).to_bits(), cl.lane(0).to_bits())
            );
        }
    }

    struct Turned;
    impl Kernel for Turned {
        type Output = Vec<[f64; 4]>;
        #[inline(always)]
        fn run<V: Set>(self) -> Self::Output {
            let value = |k: f64| Lanes::<V>::each(|l| 10.0 * k + l as f64);
            Lanes::turned([value(0.0), value(1.0), value(2.0), value(3.0)]).as_ref().to_vec()
        }
    }

    #[test]
    fn turning_is_a_transposition() {
        let everywhere = Isa::available().map(|isa| run_on(isa, Turned));
        for turned in everywhere.chain([Turned.run::<Plain<4>>(), Turned.run::<Fused<2>>()]) {
            for (l, row) in turned.iter().enumerate() {
                assert_eq!(*row, std::array::from_fn(|k| 10.0 * k as f64 + l as f64));
            }
        }
    }

    /// Every operation on these numbers, and whether all of the first are above 1.
    struct Operations<'a>(&'a [[f64; 8]; 3]);
    impl Kernel for Operations<'_> {
        type Output = (Vec<Vec<f64>>, Vec<bool>);
        #[inline(always)]
        fn run<V: Set>(self) -> Self::Output {
            let (mut results, mut above) = (vec![Vec::new(); 20], Vec::new());
            for first in (0..8).step_by(V::L) {
                let [a, b, c] = self.0.map(|numbers| Lanes::<V>::from_slice(&numbers[first..]));
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
                    a.abs().sqrt(),
                    a.atan(),
                    a.abs().exp_minus(),
                ];
                for (result, lanes) in results.iter_mut().zip(all) {
                    result.extend(lanes.to_array().as_ref());
                }
                above.push(a.all_above(1.0));
            }
            (results, above)
        }
    }

    const NUMBERS: [[f64; 8]; 3] = [
        [0.3, -2.0, 30.0, -1e3, 1.5, 2.5, 3.5, 4.5],
        [-0.7, 1.1, 0.25, -3.0, 1.5, -2.5, 1e-3, 7.0],
        [0.1, 1.1, -0.4, 2.0, 1.6, 0.0, -0.0, 7.5],
    ];

    /// Bits, and NaN as one of them.
    fn bits(results: &[Vec<f64>]) -> Vec<Vec<u64>> {
        results.iter().map(|values| values.iter().map(|value| value.to_bits()).collect()).collect()
    }

    #[test]
    fn every_set_gives_what_single_numbers_give() {
        let (single, _) = Operations(&NUMBERS).run::<Fused<1>>();
        for isa in Isa::available().filter(|&isa| isa > Isa::Portable) {
            assert_eq!(bits(&run_on(isa, Operations(&NUMBERS)).0), bits(&single), "{isa:?}");
        }
        let (unfused, _) = Operations(&NUMBERS).run::<Plain<1>>();
        assert_eq!(bits(&run_on(Isa::Portable, Operations(&NUMBERS)).0), bits(&unfused));
        assert_eq!(bits(&Operations(&NUMBERS).run::<Plain<4>>().0), bits(&unfused));
        // Infinities, zeros with a sign and what is not a number take the same ways.
        let special = [
            [f64::NAN, 1.0, f64::INFINITY, -0.0, 0.0, f64::NAN, -f64::INFINITY, 5e-324],
            [1.0, f64::NAN, f64::INFINITY, 0.0, -0.0, f64::NAN, 3.0, -1.0],
            [0.0, f64::NAN, 1.0, -0.0, 0.0, 1.0, f64::NAN, -2.0],
        ];
        let ordered = [4, 8, 9, 10, 11, 12, 13];
        let (single, _) = Operations(&special).run::<Fused<1>>();
        for isa in Isa::available() {
            let (results, _) = run_on(isa, Operations(&special));
            for operation in ordered {
                assert_eq!(
                    bits(&results)[operation],
                    bits(&single)[operation],
                    "{isa:?}, operation {operation}"
                );
            }
        }
    }

    #[test]
    fn operations_are_those_of_the_library() {
        let [a, b, c] = NUMBERS;
        for isa in Isa::available() {
            let (results, above) = run_on(isa, Operations(&NUMBERS));
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
                    a[l].abs().sqrt(),
                    a[l].atan(),
                    (-a[l].abs()).exp().max((-700.0_f64).exp()),
                ];
                for (operation, (result, want)) in results.iter().zip(want).enumerate() {
                    let got = result[l];
                    assert!(
                        (got - want).abs() <= 1e-15 * (1.0 + want.abs()),
                        "{isa:?}, operation {operation}: {got} {want}"
                    );
                }
            }
            let want: &[bool] = match isa {
                Isa::Portable => &[false, false, true, false, true, true, true, true],
                Isa::Avx2 => &[false, true],
                Isa::Avx512 => &[false],
            };
            assert_eq!(above, want);
        }
        assert!(!Lanes::<Plain<4>>::from_slice(&[2.0, 2.0, f64::NAN, 2.0]).all_above(1.0));
    }

    #[test]
    fn gather_repeats_the_last_row_past_the_end() {
        let rows = [1.0, 10.0, 2.0, 20.0, 3.0, 30.0];
        assert_eq!(Lanes::<Plain<4>>::gather(&rows, 2, 1, 1).to_array(), [20.0, 30.0, 30.0, 30.0]);
    }
}
