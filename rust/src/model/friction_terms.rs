//! Columns of the further terms, friction and springs ([`crate::robot::friction_terms`]), on lanes.

use crate::ground::lanes::{Lanes, Set};
use crate::robot::Robot;
use crate::robot::friction_terms::{Cylinder, Law, Term};

/// Column of a term that depends on position and speed alone, `s` the sign of its Coulomb friction. `Load` gives `s`: its caller knows
/// the torque.
#[inline(always)]
pub fn column<V: Set>(
    robot: &Robot,
    term: &Term,
    q: Lanes<V>,
    dq: Lanes<V>,
    s: impl FnOnce() -> Lanes<V>,
) -> Lanes<V> {
    let one = Lanes::splat(1.0);
    match &term.law {
        Law::Rest => match robot.friction().dead_zone[term.joint] {
            zone if zone > 0.0 => one - one.where_above(dq.abs(), Lanes::splat(zone)),
            _ => Lanes::zero(),
        },
        Law::Atan { velocity } => dq.scale(1.0 / velocity).atan(),
        Law::Stribeck { velocity } => {
            let u = dq.scale(1.0 / velocity);
            s() * (u * u).exp_minus()
        }
        Law::Root => s() * dq.abs().sqrt(),
        Law::Forward => dq.max(Lanes::zero()),
        // Its state follows from a path, which a sample alone does not have.
        Law::Dahl { .. } => Lanes::zero(),
        Law::Load => s(),
        Law::Table(table) => dq.map(|dq| table.at(dq)),
        Law::Spring => q,
        Law::Sine => q.sin_cos().0,
        Law::Cosine => q.sin_cos().1,
        Law::Cylinder(cylinder) => {
            let [sine, _, length] = triangle(cylinder, q);
            sine / length
        }
        Law::CylinderRate(cylinder) => {
            let [sine, _, length] = triangle(cylinder, q);
            sine - (sine / length).scale(cylinder.rest)
        }
    }
}

/// Derivative of the column of a term with respect to the position.
#[inline(always)]
pub fn position_slope<V: Set>(term: &Term, q: Lanes<V>) -> Lanes<V> {
    match &term.law {
        Law::Spring => Lanes::splat(1.0),
        Law::Sine => q.sin_cos().1,
        Law::Cosine => -q.sin_cos().0,
        Law::Cylinder(cylinder) => bend(cylinder, q),
        Law::CylinderRate(cylinder) => {
            let [_, cosine, _] = triangle(cylinder, q);
            cosine - bend(cylinder, q).scale(cylinder.rest)
        }
        _ => Lanes::zero(),
    }
}

/// `a b sin(q + phi)`, `a b cos(q + phi)`, and the length `l` of a cylinder.
#[inline(always)]
fn triangle<V: Set>(cylinder: &Cylinder, q: Lanes<V>) -> [Lanes<V>; 3] {
    let &Cylinder { a, b, phi, .. } = cylinder;
    let (sine, cosine) = (q + Lanes::splat(phi)).sin_cos();
    let (sine, cosine) = (sine.scale(a * b), cosine.scale(a * b));
    [sine, cosine, (Lanes::splat(a.mul_add(a, b * b)) - (cosine + cosine)).sqrt()]
}

/// `d^2 l/dq^2`.
#[inline(always)]
fn bend<V: Set>(cylinder: &Cylinder, q: Lanes<V>) -> Lanes<V> {
    let [sine, cosine, length] = triangle(cylinder, q);
    let slope = sine / length;
    (cosine - slope * slope) / length
}
