//! Columns of the further terms of friction ([`crate::robot::friction_terms`]), on lanes.

use crate::ground::lanes::{Lanes, Set};
use crate::model::friction::sign;
use crate::robot::Robot;
use crate::robot::friction_terms::{Law, Term};

/// Column of a term that depends on the speed alone. `Load` gives `s(dq)`: its caller knows the torque.
#[inline(always)]
pub fn column<V: Set>(robot: &Robot, term: &Term, dq: Lanes<V>) -> Lanes<V> {
    let s = || sign(robot, term.joint, dq);
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
        Law::Load => s(),
        Law::Table(table) => dq.map(|dq| table.at(dq)),
    }
}
