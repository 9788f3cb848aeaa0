//! Sine, cosine and hyperbolic tangent on lanes, without branches and without a library: the same bits on any number of lanes.

use super::lanes::{Lanes, Set};
use std::f64::consts::FRAC_2_PI;

/// Largest angle (rad) for which [`Lanes::small_sin_cos`] has all digits.
const SMALL_ANGLE: f64 = 0.0625;
/// Rounding constant 1.5 * 2^52: its sum with a number has the nearest integer in the low bits.
const ROUND: f64 = 6_755_399_441_055_744.0;

impl<V: Set> Lanes<V> {
    /// The same with plain coefficients.
    #[inline(always)]
    fn polynomial<const N: usize>(self, coefficients: [f64; N]) -> Self {
        let mut sum = Self::splat(coefficients[0]);
        for &coefficient in &coefficients[1..] {
            sum = sum.mul_add(self, Self::splat(coefficient));
        }
        sum
    }

    /// Sine and cosine without branches: three-part reduction by pi/2 and the minimax polynomials of
    /// fdlibm on [-pi/4, pi/4]. Within 2 units of the last place below 1e5 rad, which a joint does not leave.
    #[inline(always)]
    pub fn sin_cos(self) -> (Self, Self) {
        const PI_2_A: f64 = 1.570_796_326_734_125_6;
        const PI_2_B: f64 = 6.077_100_506_303_966e-11;
        const PI_2_C: f64 = 2.022_266_248_711_166_5e-21;
        let one = Self::splat(1.0);
        let quadrant = self.mul_add(Self::splat(FRAC_2_PI), Self::splat(ROUND));
        let k = quadrant - Self::splat(ROUND);
        let r = k.mul_add(Self::splat(-PI_2_A), self);
        let r = k.mul_add(Self::splat(-PI_2_B), r);
        let r = k.mul_add(Self::splat(-PI_2_C), r);
        let z = r * r;
        let s = z.polynomial([
            1.589_690_995_211_55e-10,
            -2.505_076_025_340_686_3e-8,
            2.755_731_370_707_006_8e-6,
            -1.984_126_982_985_795e-4,
            8.333_333_333_322_49e-3,
            -1.666_666_666_666_663_2e-1,
        ]);
        let s = (z * r).mul_add(s, r);
        let c = z.polynomial([
            -1.135_964_755_778_819_5e-11,
            2.087_572_321_298_175e-9,
            -2.755_731_435_139_066_3e-7,
            2.480_158_728_947_673e-5,
            -1.388_888_888_887_411e-3,
            4.166_666_666_666_66e-2,
        ]);
        let half = z.scale(0.5);
        let w = one - half;
        let c = w + (z * z).mul_add(c, (one - w) - half);
        // Odd quadrants exchange sine and cosine, the second bit turns the sign: masks keep it free of branches.
        let next = quadrant + one;
        (s.chosen_by(c, quadrant).turned_by(quadrant), c.chosen_by(s, quadrant).turned_by(next))
    }

    /// Sine, and cosine less one, of angles below [`SMALL_ANGLE`]; errors below 1e-16.
    #[inline(always)]
    fn small_sin_cos(self) -> (Self, Self) {
        let z = self * self;
        let s = z.polynomial([-1.0 / 5_040.0, 1.0 / 120.0, -1.0 / 6.0]);
        let c = z.polynomial([1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5]);
        ((self * z).mul_add(s, self), z * c)
    }

    /// Sine and cosine of `q + theta` from an anchor near it: a position, and sine and cosine there.
    #[inline(always)]
    pub(crate) fn sin_cos_near([from, s, c]: [Self; 3], q: Self, theta: Self) -> (Self, Self) {
        let way = q - from;
        let (sine, cosine_less_one) = way.small_sin_cos();
        let near_s = c.mul_add(sine, s.mul_add(cosine_less_one, s));
        let near_c = s.neg_mul_add(sine, c.mul_add(cosine_less_one, c));
        let room = Self::splat(SMALL_ANGLE) - way.abs();
        if room.all_above(0.0) {
            return (near_s, near_c);
        }
        // Lane by lane, so that none sees its neighbours.
        let (far_s, far_c) = (q + theta).sin_cos();
        (near_s.or_where_not_above(far_s, room), near_c.or_where_not_above(far_c, room))
    }

    /// `exp(self) - 1` of numbers from 0 to 700, within 2 units of the last place.
    #[inline(always)]
    fn exp_minus_one(self) -> Self {
        const LN_2_A: f64 = 6.931_471_803_691_238e-1; // its last bits are zero: times k it is exact
        const LN_2_B: f64 = 1.908_214_929_270_587_7e-10;
        let rounded = self.mul_add(Self::splat(std::f64::consts::LOG2_E), Self::splat(ROUND));
        let k = rounded - Self::splat(ROUND);
        let r = k.mul_add(Self::splat(-LN_2_A), self);
        let r = k.mul_add(Self::splat(-LN_2_B), r);
        let p = r.polynomial([
            1.0 / 6_227_020_800.0,
            1.0 / 479_001_600.0,
            1.0 / 39_916_800.0,
            1.0 / 3_628_800.0,
            1.0 / 362_880.0,
            1.0 / 40_320.0,
            1.0 / 5_040.0,
            1.0 / 720.0,
            1.0 / 120.0,
            1.0 / 24.0,
            1.0 / 6.0,
            0.5,
        ]);
        let p = (r * r).mul_add(p, r);
        let power = rounded.power_of_two();
        power.mul_add(p, power - Self::splat(1.0))
    }

    /// Hyperbolic tangent, within 3 units of the last place: `E / (E + 2)` with `E = exp(2 x) - 1`, which keeps its digits near zero.
    #[inline(always)]
    pub fn tanh(self) -> Self {
        if self.abs().all_above(20.0) {
            return Self::splat(1.0).copysign(self); // what the rest would give, to the bit
        }
        // tanh is 1 to the last bit beyond 19.1. On the positive side, so that both sides have the same digits.
        let e = self.abs().min(Self::splat(20.0)).scale(2.0).exp_minus_one();
        (e / (e + Self::splat(2.0))).copysign(self)
    }

    /// `exp(-self)` of numbers that are not negative, within 3 units of the last place; beyond 700 it stays at `exp(-700)`.
    #[inline(always)]
    #[must_use]
    pub fn exp_minus(self) -> Self {
        let one = Self::splat(1.0);
        one / (self.min(Self::splat(700.0)).exp_minus_one() + one)
    }

    /// Arc tangent without branches, within 3 units of the last place.
    #[inline(always)]
    #[must_use]
    pub fn atan(self) -> Self {
        // atan(x) = pi/2 - atan(1/x) beyond 1; atan(x) = 2 atan(x / (1 + sqrt(1 + x^2))) twice brings x below 0.2.
        let one = Self::splat(1.0);
        let x = self.abs();
        let inverse = one / x.max(Self::splat(f64::MIN_POSITIVE));
        let large = x - one;
        let y = inverse.or_where_not_above(x, large);
        let half = |x: Self| x / (one + (x * x + one).sqrt());
        let z = half(half(y));
        let w = z * z;
        let mut sum = Self::zero();
        for k in (0..12).rev() {
            let coefficient = if k % 2 == 0 { 1.0 } else { -1.0 } / f64::from(2 * k + 1);
            sum = sum.mul_add(w, Self::splat(coefficient));
        }
        let a = (z * sum).scale(4.0);
        let turned = Self::splat(std::f64::consts::FRAC_PI_2) - a;
        turned.or_where_not_above(a, large).copysign(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::{Fused, Plain};

    #[test]
    fn arc_tangent_and_exponential_have_their_digits() {
        for k in -400..400 {
            let x = 1.07_f64.powi(k) * if k % 2 == 0 { 1.0 } else { -1.0 };
            let got = Lanes::<Plain<4>>::splat(x).atan().lane(0);
            assert!((got - x.atan()).abs() <= 1e-15 * x.atan().abs(), "{x}: {got} {}", x.atan());
        }
        for k in 0..7000 {
            let x = f64::from(k) * 0.1;
            let got = Lanes::<Plain<2>>::splat(x).exp_minus().lane(1);
            assert!((got - (-x).exp()).abs() <= 2e-15 * (-x).exp(), "{x}: {got}");
        }
        assert_eq!(Lanes::<Plain<1>>::splat(0.0).atan().lane(0), 0.0);
        assert!(Lanes::<Plain<1>>::splat(f64::NAN).atan().lane(0).is_nan());
        assert!(
            (Lanes::<Plain<1>>::splat(f64::INFINITY).atan().lane(0) - std::f64::consts::FRAC_PI_2).abs()
                < 1e-15
        );
    }

    #[test]
    fn sine_and_cosine_are_those_of_the_library() {
        for k in -200_000..200_000_i32 {
            let x = f64::from(k) * 0.003_141_3 + 1e-9 * f64::from(k % 7);
            let (s, c) = Lanes::<Plain<1>>::splat(x).sin_cos();
            let (sf, cf) = Lanes::<Fused<1>>::splat(x).sin_cos();
            for (got, want) in
                [(s.lane(0), x.sin()), (c.lane(0), x.cos()), (sf.lane(0), x.sin()), (cf.lane(0), x.cos())]
            {
                assert!((got - want).abs() < 3e-16, "{x}: {got} {want}");
            }
        }
    }

    #[test]
    fn small_angles_have_all_digits() {
        for k in -1000..=1000_i32 {
            let x = SMALL_ANGLE * f64::from(k) / 1000.0;
            let (s, c) = Lanes::<Plain<1>>::splat(x).small_sin_cos();
            assert!((s.lane(0) - x.sin()).abs() < 1e-16, "{x}");
            assert!((c.lane(0) + 2.0 * (x / 2.0).sin().powi(2)).abs() < 1e-16, "{x}");
        }
    }
}
