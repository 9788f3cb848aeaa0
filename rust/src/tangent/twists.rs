//! Vectors seen from a frame turned by `gamma` about z and `alpha` about x, and back; right angles need no multiplication.

use crate::ground::lanes::{Lanes, Set};
use crate::ground::spatial::Vector;
use crate::robot::{Placement, Twist};

/// Components after `Rot(z, gamma) Rot(x, alpha)` of the frame.
#[inline(always)]
pub(super) fn into_placed<V: Set>(v: Vector<V>, placement: &Placement) -> Vector<V> {
    let v = match placement.gamma {
        Some((c, s)) => v.into_turned(Lanes::splat(s), Lanes::splat(c)),
        None => v,
    };
    into_twisted(v, placement.twist)
}

/// Back: `Rot(z, gamma) Rot(x, alpha) v`.
#[inline(always)]
pub(super) fn out_of_placed<V: Set>(v: Vector<V>, placement: &Placement) -> Vector<V> {
    let v = out_of_twisted(v, placement.twist);
    match placement.gamma {
        Some((c, s)) => v.out_of_turned(Lanes::splat(s), Lanes::splat(c)),
        None => v,
    }
}

/// Components after `Rot(x, alpha)` of the frame: `Rot(x, alpha)^T v`.
#[inline(always)]
fn into_twisted<V: Set>(v: Vector<V>, twist: Twist) -> Vector<V> {
    match twist {
        Twist::Zero => v,
        Twist::Half => Vector::new(v.x, -v.y, -v.z),
        Twist::Plus => Vector::new(v.x, v.z, -v.y),
        Twist::Minus => Vector::new(v.x, -v.z, v.y),
        Twist::General(c, s) => Vector::new(
            v.x,
            v.y.mul_add(Lanes::splat(c), v.z.scale(s)),
            v.z.mul_add(Lanes::splat(c), v.y.scale(-s)),
        ),
    }
}

/// Back: `Rot(x, alpha) v`.
#[inline(always)]
fn out_of_twisted<V: Set>(v: Vector<V>, twist: Twist) -> Vector<V> {
    let back = match twist {
        Twist::Plus => Twist::Minus,
        Twist::Minus => Twist::Plus,
        Twist::General(c, s) => Twist::General(c, -s),
        right => right,
    };
    into_twisted(v, back)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::Plain;

    #[test]
    fn a_turn_and_its_inverse_undo_each_other_and_right_angles_are_turns() {
        let v = Vector::<Plain<1>>::splat([0.3, -1.2, 2.5]);
        let same = |a: Vector<Plain<1>>, b: Vector<Plain<1>>| {
            [(a.x, b.x), (a.y, b.y), (a.z, b.z)].iter().all(|(a, b)| (a.lane(0) - b.lane(0)).abs() < 1e-15)
        };
        for twist in [Twist::Zero, Twist::Half, Twist::Plus, Twist::Minus, Twist::General(0.6, 0.8)] {
            assert!(same(out_of_twisted(into_twisted(v, twist), twist), v));
            let (c, s) = twist.cos_sin();
            assert!(same(into_twisted(v, twist), into_twisted(v, Twist::General(c, s))));
        }
    }
}
