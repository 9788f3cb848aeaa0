//! 3-vectors on lanes, and their turn about z.

use crate::ground::lanes::{Lanes, Set};
use std::ops::{Add, Sub};

/// A vector in some frame.
///
/// It is aligned, and with it all that contains one: a vector register that is stored across a line of the cache takes twice as long.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub struct Vector<V: Set> {
    /// Component along x.
    pub x: Lanes<V>,
    /// Component along y.
    pub y: Lanes<V>,
    /// Component along z.
    pub z: Lanes<V>,
}

impl<V: Set> Vector<V> {
    /// From its components.
    #[inline(always)]
    pub fn new(x: Lanes<V>, y: Lanes<V>, z: Lanes<V>) -> Self {
        Self { x, y, z }
    }

    /// The null vector.
    #[inline(always)]
    pub fn zero() -> Self {
        Self::new(Lanes::zero(), Lanes::zero(), Lanes::zero())
    }

    /// The same vector in each lane.
    #[inline(always)]
    pub fn splat(v: [f64; 3]) -> Self {
        Self::new(Lanes::splat(v[0]), Lanes::splat(v[1]), Lanes::splat(v[2]))
    }

    /// Scalar product.
    #[inline(always)]
    pub fn dot(self, b: Self) -> Lanes<V> {
        self.z.mul_add(b.z, self.y.mul_add(b.y, self.x * b.x))
    }

    /// Vector product.
    #[inline(always)]
    pub fn cross(self, b: Self) -> Self {
        Self::new(
            self.y.mul_sub(b.z, self.z * b.y),
            self.z.mul_sub(b.x, self.x * b.z),
            self.x.mul_sub(b.y, self.y * b.x),
        )
    }

    /// Components after `Rot(z, theta)` of the frame, from the sine and cosine of theta.
    #[inline(always)]
    pub fn into_turned(self, sine: Lanes<V>, cosine: Lanes<V>) -> Self {
        Self::new(self.x.mul_add(cosine, self.y * sine), self.y.mul_sub(cosine, self.x * sine), self.z)
    }

    /// Back: `Rot(z, theta) v`.
    #[inline(always)]
    pub fn out_of_turned(self, sine: Lanes<V>, cosine: Lanes<V>) -> Self {
        Self::new(self.x.mul_sub(cosine, self.y * sine), self.y.mul_add(cosine, self.x * sine), self.z)
    }
}

impl<V: Set> Add for Vector<V> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        Self::new(self.x + b.x, self.y + b.y, self.z + b.z)
    }
}

impl<V: Set> Sub for Vector<V> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        Self::new(self.x - b.x, self.y - b.y, self.z - b.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::Plain;
    use proptest::prelude::*;

    fn close(a: Vector<Plain<1>>, b: Vector<Plain<1>>) -> bool {
        let e = a - b;
        e.dot(e).lane(0).sqrt() < 1e-12
    }

    proptest! {
        #[test]
        fn turns_are_rotations(v in prop::array::uniform3(-3.0..3.0_f64), angle in -7.0..7.0_f64) {
            let v = Vector::<Plain<1>>::splat(v);
            let (s, c) = Lanes::splat(angle).sin_cos();
            prop_assert!(close(v.into_turned(s, c).out_of_turned(s, c), v));
        }

        #[test]
        fn the_vector_product_is_normal_to_both(a in prop::array::uniform3(-3.0..3.0_f64), b in prop::array::uniform3(-3.0..3.0_f64)) {
            let (a, b) = (Vector::<Plain<1>>::splat(a), Vector::splat(b));
            prop_assert!(a.cross(b).dot(a).lane(0).abs() < 1e-12);
            prop_assert!(a.cross(b).dot(b).lane(0).abs() < 1e-12);
        }
    }
}
