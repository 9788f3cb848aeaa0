//! Derivatives of the inverse dynamic model (1) with respect to positions and velocities, by Newton-Euler on dual numbers.
//!
//! Written with rotation-free textbook recursions on standard parameters, apart from the kernels: what it agrees with, it
//! checks. Identity that tests it: its values are those of `didim::model::inverse`, its derivatives differences of them.

// Numbers with 80 derivatives are large; they are passed as numbers are written, and speed is not what they are for.
#![allow(clippy::large_types_passed_by_value)]

use super::dual::Dual;
use didim::ground::arrays::MAX_DOF;
use didim::robot::parameters::{FRICTION, IA, Layout, M, MX, XX};
use didim::robot::{Coupling, JointKind, Placement, Robot};

/// Variables: positions, then velocities.
const N: usize = 2 * MAX_DOF;
type Number = Dual<N>;
type Vector = [Number; 3];

/// Torques, and their derivatives with respect to positions and velocities at constant accelerations, row-major `(n, n)`.
#[derive(Debug, Clone, Copy)]
pub struct Partials {
    /// Joint torques (N.m or N).
    pub tau: [f64; MAX_DOF],
    /// `d tau_i / d q_j`.
    pub position: [[f64; MAX_DOF]; MAX_DOF],
    /// `d tau_i / d dq_j`.
    pub velocity: [[f64; MAX_DOF]; MAX_DOF],
}

fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// A vector of the parent's frame, seen from after `gamma` and the twist.
fn into_placed(v: Vector, placement: &Placement) -> Vector {
    let (ca, sa) = placement.twist.cos_sin();
    let (cg, sg) = placement.gamma.unwrap_or((1.0, 0.0));
    about_x(about_z(v, Number::constant(-sg), Number::constant(cg)), -sa, ca)
}

/// Back.
fn out_of_placed(v: Vector, placement: &Placement) -> Vector {
    let (ca, sa) = placement.twist.cos_sin();
    let (cg, sg) = placement.gamma.unwrap_or((1.0, 0.0));
    about_z(about_x(v, sa, ca), Number::constant(sg), Number::constant(cg))
}

fn scaled(a: Vector, factor: f64) -> Vector {
    a.map(|component| component.scale(factor))
}

/// Turn about z by an angle of sine `s` and cosine `c`, back if `s` is negated.
fn about_z(v: Vector, s: Number, c: Number) -> Vector {
    [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]]
}

/// Turn about x, likewise.
fn about_x(v: Vector, s: f64, c: f64) -> Vector {
    [v[0], v[1].scale(c) - v[2].scale(s), v[1].scale(s) + v[2].scale(c)]
}

/// `sign`, as the friction of joint `j` has it; a step has no slope.
fn sign(robot: &Robot, j: usize, dq: Number) -> Number {
    let (smoothing, dead_zone) = (robot.friction().smoothing[j], robot.friction().dead_zone[j]);
    if dq.v.abs() <= dead_zone && (dead_zone > 0.0 || smoothing == 0.0) {
        Number::constant(0.0)
    } else if smoothing > 0.0 {
        let s = (dq.v / smoothing).tanh();
        dq.chain(s, (1.0 - s * s) / smoothing)
    } else {
        Number::constant(1.0_f64.copysign(dq.v))
    }
}

/// The part of a number on one side of zero.
fn side(a: Number, positive: bool) -> Number {
    if (a.v > 0.0) == positive { a } else { Number::constant(0.0) }
}

/// Partial derivatives of the inverse model at one state, with all standard parameters.
pub fn partials(robot: &Robot, x: &[f64], q: &[f64], dq: &[f64], ddq: &[f64]) -> Partials {
    let Some(followers) = robot.followers() else { return partials_of_joints(robot, x, q, dq, ddq) };
    let [q, dq, ddq] = [(q, true), (dq, false), (ddq, false)].map(|(v, at)| followers.spread(v, at));
    let all = partials_of_joints(robot, x, &q, &dq, &ddq);
    let (n, joints) = (robot.n_dof(), robot.n_joints());
    let mut found = Partials { tau: [0.0; MAX_DOF], ..all };
    followers.gather(&all.tau[..joints], 1, &mut found.tau[..n]);
    for matrix in [&mut found.position, &mut found.velocity] {
        let whole: Vec<f64> = matrix[..joints].iter().flat_map(|row| row[..joints].iter().copied()).collect();
        for (row, values) in matrix.iter_mut().zip(followers.square(&whole).chunks_exact(n)) {
            row[..n].copy_from_slice(values);
        }
    }
    found
}

#[allow(clippy::large_stack_arrays)] // in tests alone
fn partials_of_joints(robot: &Robot, x: &[f64], q: &[f64], dq: &[f64], ddq: &[f64]) -> Partials {
    let n = robot.n_joints();
    let layout = Layout::of(robot);
    let zero = Number::constant(0.0);
    let none = [zero; 3];
    let speed: Vec<Number> = (0..n).map(|j| Number::variable(dq[j], MAX_DOF + j)).collect();
    let mut tau = vec![zero; n];
    let (mut turns, mut arms) = (vec![(zero, zero); n], vec![none; n]);
    let (mut forces, mut moments) = (vec![none; n], vec![none; n]);
    // Motion of each link: angular velocity and acceleration, acceleration of the origin.
    let mut motions = vec![[none; 3]; n];
    for j in 0..n {
        let (joint, placement) = (&robot.joints()[j], &robot.placements()[j]);
        let base = [none, none, robot.gravity().map(|g| Number::constant(-g))];
        let [mut omega, mut domega, mut a] = robot.mounts()[j].parent.map_or(base, |parent| motions[parent]);
        let position = Number::variable(q[j], j);
        let revolute = joint.kind == JointKind::Revolute;
        let (turn, slide) = if revolute { (position, zero) } else { (zero, position) };
        let theta = turn + Number::constant(joint.theta);
        let (s, c) = theta.v.sin_cos();
        let (s, c) = (theta.chain(s, c), theta.chain(c, -s));
        // The origin after the twist, seen again from the parent.
        let mut arm = placement.arm.map(Number::constant);
        arm[2] = arm[2] + slide;
        let arm = out_of_placed(arm, placement);
        (turns[j], arms[j]) = ((s, c), arm);
        // Acceleration of the origin of frame j, then its components there.
        a = add(a, add(cross(domega, arm), cross(omega, cross(omega, arm))));
        let into = |v: Vector| about_z(into_placed(v, placement), -s, c);
        (omega, domega, a) = (into(omega), into(domega), into(a));
        let along = [zero, zero, speed[j]];
        if revolute {
            domega = add(domega, cross(omega, along));
            domega[2] = domega[2] + Number::constant(ddq[j]);
            omega[2] = omega[2] + speed[j];
        } else {
            a = add(a, scaled(cross(omega, along), 2.0));
            a[2] = a[2] + Number::constant(ddq[j]);
        }
        motions[j] = [omega, domega, a];
        let link = &x[layout.joint(j)..layout.joint(j) + layout.per_joint()];
        let [xx, xy, xz, yy, yz, zz] = std::array::from_fn(|k| link[XX + k]);
        let first = std::array::from_fn(|k| Number::constant(link[MX + k]));
        let inertia = |v: Vector| -> Vector {
            [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
                .map(|row| v[0].scale(row[0]) + v[1].scale(row[1]) + v[2].scale(row[2]))
        };
        forces[j] = add(scaled(a, link[M]), add(cross(domega, first), cross(omega, cross(omega, first))));
        moments[j] = add(inertia(domega), add(cross(omega, inertia(omega)), cross(first, a)));
        tau[j] = Number::constant(link[IA] * ddq[j]) + own_friction(robot, j, &link[FRICTION..], speed[j]);
    }
    coupled_drives(robot, x, &speed, ddq, &mut tau);
    for j in (0..n).rev() {
        let revolute = robot.joints()[j].kind == JointKind::Revolute;
        tau[j] = tau[j] + if revolute { moments[j][2] } else { forces[j][2] };
        if let Some(parent) = robot.mounts()[j].parent {
            let (s, c) = turns[j];
            let out = |v: Vector| out_of_placed(about_z(v, s, c), &robot.placements()[j]);
            let force = out(forces[j]);
            moments[parent] = add(moments[parent], add(out(moments[j]), cross(arms[j], force)));
            forces[parent] = add(forces[parent], force);
        }
    }
    let mut found = Partials {
        tau: [0.0; MAX_DOF],
        position: [[0.0; MAX_DOF]; MAX_DOF],
        velocity: [[0.0; MAX_DOF]; MAX_DOF],
    };
    for (i, torque) in tau.iter().enumerate() {
        found.tau[i] = torque.v;
        found.position[i].copy_from_slice(&torque.d[..MAX_DOF]);
        found.velocity[i].copy_from_slice(&torque.d[MAX_DOF..]);
    }
    found
}

fn own_friction(robot: &Robot, j: usize, parameters: &[f64], dq: Number) -> Number {
    let s = sign(robot, j, dq);
    if robot.friction().asymmetric {
        let part = |positive: bool, viscous: f64, coulomb: f64| {
            side(dq, positive).scale(viscous) + side(s, positive).scale(coulomb)
        };
        part(true, parameters[0], parameters[1]) + part(false, parameters[2], parameters[3])
    } else {
        dq.scale(parameters[0]) + s.scale(parameters[1]) + Number::constant(parameters[2])
    }
}

/// Contribution of coupled motors, (22) to (24): rotors, `Fvm` and `Fcm`.
fn coupled_drives(robot: &Robot, x: &[f64], dq: &[Number], ddq: &[f64], tau: &mut [Number]) {
    let layout = Layout::of(robot);
    for (index, coupled) in robot.coupled().iter().enumerate() {
        let m = coupled.motor;
        let (ia, fvm, fcm) =
            (x[layout.joint(m) + IA], x[layout.coupled(index)], x[layout.coupled(index) + 1]);
        let (mut shaft, mut shaft_ddq) = (dq[m], ddq[m]);
        for &(i, c) in &coupled.others {
            shaft = shaft + dq[i].scale(c);
            shaft_ddq += c * ddq[i];
        }
        let (turning, joint_turning) = (sign(robot, m, shaft), sign(robot, m, dq[m]));
        tau[m] = tau[m]
            + Number::constant(ia * (shaft_ddq - ddq[m]))
            + (shaft - dq[m]).scale(fvm)
            + (turning - joint_turning).scale(fcm);
        let along = match robot.friction().coupling {
            Coupling::Shaft => turning,
            Coupling::Printed => joint_turning,
        };
        for &(i, c) in &coupled.others {
            tau[i] = tau[i]
                + Number::constant(ia * c * (shaft_ddq - c * ddq[i]))
                + (shaft - dq[i].scale(c)).scale(c * fvm)
                + along.scale(c * fcm);
        }
    }
}
