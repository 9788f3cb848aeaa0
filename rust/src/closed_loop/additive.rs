//! An additive Runge-Kutta method of third order that takes the steep part of friction implicitly: ARK3(2)4L[2]SA of Kennedy and
//! Carpenter (2003, Applied Numerical Mathematics 44, 139-181), four evaluations of the model a step as the classical method.
//!
//! With `M` the inertia matrix at the start of a step, the accelerations `a` are split into `-M^-1 F(dq)`, `F` the Coulomb and viscous friction
//! of joints and coupled motors, and the rest. The order holds for any such split, but where stiff friction holds a joint at rest; what is
//! steep at reversals is in the first part, whose method is L-stable. A stage of it solves `M (dq - dq*) + h g F(dq) = 0`: the minimum of a
//! convex function, found by Newton's method with secant steps where that goes too far. Everything else, the model included, is evaluated as
//! [`super::runge_kutta`] does. Tested in `rust/tests/closed_loop/additive.rs`: order three, and reversals in steps that the
//! classical method cannot take.

use super::runge_kutta::{PerJoint, Point};
use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::model::direct::Direct;
use crate::model::steep::Steep;
use crate::robot::arm::{Arm, Square, for_joints};

/// Diagonal coefficient `g` of the implicit method.
const DIAGONAL: f64 = 1_767_732_205_903.0 / 4_055_673_282_236.0;
/// Coefficients of the implicit method; the last row has the weights of both methods.
const IMPLICIT: [[f64; 4]; 4] = [
    [0.0; 4],
    [DIAGONAL, DIAGONAL, 0.0, 0.0],
    [2_746_238_789_719.0 / 10_658_868_560_708.0, -640_167_445_237.0 / 6_845_629_431_997.0, DIAGONAL, 0.0],
    [
        1_471_266_399_579.0 / 7_840_856_788_654.0,
        -4_482_444_167_858.0 / 7_529_755_066_697.0,
        11_266_239_266_428.0 / 11_593_286_722_821.0,
        DIAGONAL,
    ],
];
/// Coefficients of the explicit method.
const EXPLICIT: [[f64; 3]; 4] = [
    [0.0; 3],
    [1_767_732_205_903.0 / 2_027_836_641_118.0, 0.0, 0.0],
    [5_535_828_885_825.0 / 10_492_691_773_637.0, 788_022_342_437.0 / 10_882_634_858_940.0, 0.0],
    [
        6_485_989_280_629.0 / 16_251_701_735_622.0,
        -4_246_266_847_089.0 / 9_704_473_918_619.0,
        10_755_448_449_292.0 / 10_357_097_424_841.0,
    ],
];
/// Stage times, as shares of the step.
const NODES: [f64; 4] = [0.0, 1_767_732_205_903.0 / 2_027_836_641_118.0, 0.6, 1.0];
/// Slope of friction at rest times a stage, as a multiple of the inertia, from which a joint is held by it. With 10 the reversals of the TX40
/// with a smoothing of 1e-3 rad/s are met worse, by steps of 0.25 ms; joints of an SO-101 that stick have 90 to 300, by 1 ms.
const STEEP: f64 = 40.0;
/// Speed, in smoothing velocities, up to which a joint rests.
const SLOW: f64 = 4.0;
/// Slope of friction there, as a share of that at velocity zero.
const RESTS: f64 = 1.3e-3;
/// Stiffness of what holds a joint, as a multiple of its inertia: the others move with it to this share.
const GRIP: f64 = 1e9;
/// Newton step, as a share of the smoothing velocity, that is the last: the error after it is its square.
const SMALL: f64 = 1e-4;
/// Residual of the accelerations, as a share of the smoothing velocities, below which a stage has converged.
const NOTHING: f64 = 1e-9;
/// Upper bound of the Newton steps of a stage: more mean invalid numbers.
const MOST: usize = 60;

/// One step.
#[derive(Debug)]
pub struct Additive<'a, V: Set, S: Arm> {
    start: Point<V>,
    /// Velocities of the stages.
    speed: [PerJoint<V>; 4],
    /// Their accelerations, and the part of steep friction in them.
    whole: [PerJoint<V>; 4],
    steep: [PerJoint<V>; 4],
    growth: [PerJoint<V>; 4],
    /// `M` at the start of the step.
    inertia: S::Square<Lanes<V>>,
    /// Velocities at the end of a stage without its own steep part.
    without: PerJoint<V>,
    /// Memory for the matrix of a Newton step, and below for its residual, the step, where the last one began and which way it went; between
    /// stages for other numbers. Arrays have room for the largest robots: to make them anew takes longer than a step of six joints.
    matrix: S::Square<Lanes<V>>,
    rest: PerJoint<V>,
    step: PerJoint<V>,
    from: PerJoint<V>,
    way: PerJoint<V>,
    friction: Steep<'a, V>,
    /// 1 in lanes whose `M` was positive definite there.
    sound: Lanes<V>,
}

impl<'a, V: Set, S: Arm> Additive<'a, V, S> {
    /// Before the first step of these candidates.
    #[inline(always)]
    pub fn new(n: usize, friction: Steep<'a, V>) -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        let point = Point { q: zero, dq: zero, z: zero };
        Self {
            start: point,
            speed: [zero; 4],
            whole: [zero; 4],
            steep: [zero; 4],
            growth: [zero; 4],
            inertia: Square::filled(Lanes::zero(), n),
            without: zero,
            matrix: Square::filled(Lanes::zero(), n),
            rest: zero,
            step: zero,
            from: zero,
            way: zero,
            friction,
            sound: Lanes::zero(),
        }
    }

    /// Time of a stage; those at the ends lie just inside the step, as those of [`super::runge_kutta::Stages::time`].
    #[inline(always)]
    pub fn time(stage: usize, t: f64, h: f64) -> f64 {
        t + h * [1e-9, NODES[1], NODES[2], 1.0 - 1e-9][stage]
    }

    /// Takes the derivatives at a stage and moves on to the next, or to the end of the step. `direct` has solved the state `here`.
    #[inline(always)]
    pub fn advance(
        &mut self,
        n: usize,
        stage: usize,
        h: f64,
        direct: &Direct<V, S>,
        dz: &PerJoint<V>,
        here: &mut Point<V>,
    ) {
        if stage == 0 {
            direct.inertia(n, &mut self.inertia);
            let mut smallest = direct.pivots[0];
            for pivot in &direct.pivots[1..n] {
                smallest = smallest.min(*pivot);
            }
            self.sound = Lanes::splat(1.0).where_above(smallest, Lanes::zero());
            let Self { start, steep, friction, rest, matrix, .. } = self;
            for_joints!(j in n => {
                (start.q[j], start.dq[j], start.z[j]) = (here.q[j], here.dq[j], here.z[j]);
                rest[j] = Lanes::zero();
            });
            friction.add::<true>(n, 1.0, &here.dq, rest, matrix);
            direct.respond(n, rest);
            for_joints!(j in n => steep[0][j] = -rest[j]);
        }
        let Self { speed, whole, growth, .. } = self;
        for_joints!(j in n => {
            (speed[stage][j], whole[stage][j], growth[stage][j]) = (here.dq[j], direct.ddq[j], dz[j]);
        });
        if stage == 3 {
            let weights = IMPLICIT[3].map(|weight| Lanes::splat(h * weight));
            let Self { start, speed, whole, growth, .. } = self;
            for_joints!(j in n => {
                (here.q[j], here.dq[j], here.z[j]) = (start.q[j], start.dq[j], start.z[j]);
                for (l, &weight) in weights.iter().enumerate() {
                    here.q[j] = weight.mul_add(speed[l][j], here.q[j]);
                    here.dq[j] = weight.mul_add(whole[l][j], here.dq[j]);
                    here.z[j] = weight.mul_add(growth[l][j], here.z[j]);
                }
            });
            self.hold(n, h * DIAGONAL, &mut here.dq);
            return;
        }
        let next = stage + 1;
        let way = Lanes::splat(h * DIAGONAL);
        let Self { start, speed, whole, steep, growth, inertia, friction, without, .. } = self;
        for_joints!(j in n => {
            (here.q[j], without[j], here.z[j]) = (start.q[j], start.dq[j], start.z[j]);
            for l in 0..next {
                let explicit = Lanes::splat(h * EXPLICIT[next][l]);
                let more = Lanes::splat(h * (IMPLICIT[next][l] - EXPLICIT[next][l]));
                here.q[j] = explicit.mul_add(speed[l][j], here.q[j]);
                here.z[j] = explicit.mul_add(growth[l][j], here.z[j]);
                without[j] = more.mul_add(steep[l][j], explicit.mul_add(whole[l][j], without[j]));
            }
            // Friction as it was: right to the bit where the robot slides on.
            let slides = way.mul_add(steep[stage][j], without[j]);
            // Where it may hold the joint: as slow as it was, and at rest where it would turn around.
            let before = speed[stage][j];
            let stiff = inertia[j][j].neg_mul_add(Lanes::splat(STEEP), friction.slope(j) * way);
            let near = before.abs().neg_mul_add(Lanes::splat(friction.steepness[j]), Lanes::splat(SLOW));
            let onwards = slides.or_where_not_above(Lanes::zero(), slides * before);
            let held = before.or_where_not_above(onwards, near);
            here.dq[j] = held.or_where_not_above(slides, stiff);
        });
        self.slow_down(n, h * DIAGONAL, &mut here.dq);
        let per_way = Lanes::splat(1.0 / (h * DIAGONAL));
        for_joints!(j in n => self.steep[next][j] = (here.dq[j] - self.without[j]) * per_way);
    }
}

impl<V: Set, S: Arm> Additive<'_, V, S> {
    /// Gives joints that friction holds at the end of a step, whose velocities are `dq`, those of the last stage.
    ///
    /// There friction balances the other torques. The velocities by the weights differ from it by what is turned around in the next step if
    /// friction is steep, and under a load a joint at rest would creep. What holds a joint acts on it alone, so the others move with it.
    #[inline(always)]
    fn hold(&mut self, n: usize, w: f64, dq: &mut PerJoint<V>) {
        let Self { inertia, matrix, friction, speed, rest, step: still, from: steep, way: held, .. } = self;
        let (nothing, last) = (Lanes::zero(), &speed[3]);
        // So near zero that only the direction counts.
        for_joints!(j in n => still[j] = last[j].scale(1e-9));
        for speeds in [&*still, last] {
            for_joints!(j in n => for_joints!(k in n => if k <= j {
                matrix[j][k] = nothing;
            }));
            friction.add::<false>(n, w, speeds, rest, matrix);
            for_joints!(j in n => (steep[j], held[j]) = (held[j], matrix[j][j]));
        }
        let mut most = -Lanes::splat(1.0);
        for_joints!(j in n => {
            let rests = steep[j].neg_mul_add(Lanes::splat(RESTS), held[j]);
            held[j] = inertia[j][j].neg_mul_add(Lanes::splat(STEEP), steep[j]).min(rests);
            most = held[j].max(most);
        });
        if (-most).all_above(0.0) {
            return;
        }
        for_joints!(j in n => {
            for_joints!(k in n => if k <= j {
                matrix[j][k] = inertia[j][k];
            });
            let grip = inertia[j][j].scale(GRIP).or_where_not_above(nothing, held[j]);
            rest[j] = grip * (dq[j] - last[j]);
            matrix[j][j] += grip;
        });
        solve(n, matrix, rest);
        for_joints!(j in n => {
            let other = (dq[j] + rest[j]).or_where_not_above(dq[j], most);
            dq[j] = last[j].or_where_not_above(other, held[j]);
        });
    }

    /// Changes velocities `dq`, a guess, until `M (dq - dq*) + w F(dq) = 0`. A lane that has found them waits for the others.
    #[inline(always)]
    fn slow_down(&mut self, n: usize, w: f64, dq: &mut PerJoint<V>) {
        let (nothing, one) = (Lanes::zero(), Lanes::splat(1.0));
        let Self { inertia, matrix, friction, without, rest, step, from, way, .. } = self;
        // The last step: where from, which way, its share, and the slope at its start along it, which is negative.
        let (mut share, mut slope) = (nothing, nothing);
        for_joints!(j in n => (from[j], way[j]) = (dq[j], nothing));
        // 1 where a lane still moves.
        let mut moves = self.sound;
        for _ in 0..MOST {
            for_joints!(j in n => (rest[j], step[j]) = (nothing, dq[j] - without[j]));
            for_joints!(j in n => for_joints!(k in n => {
                rest[j] = inertia[j.max(k)][j.min(k)].mul_add(step[k], rest[j]);
                if k <= j {
                    matrix[j][k] = inertia[j][k];
                }
            }));
            friction.add::<true>(n, w, dq, rest, matrix);
            let mut beyond = -one;
            for_joints!(j in n => {
                let size = rest[j].scale(friction.steepness[j]).abs();
                beyond = inertia[j][j].neg_mul_add(Lanes::splat(NOTHING), size).max(beyond);
            });
            moves = moves.where_above(beyond, nothing);
            if (one - moves).all_above(0.5) {
                break;
            }
            let mut along = nothing;
            for_joints!(j in n => along = rest[j].mul_add(way[j], along));
            // Beyond the minimum along the last way, and half as steep as at its start: back to where the secant vanishes.
            let retreats = one.where_above(along + slope.scale(0.5), nothing);
            let back = share * slope / (slope - along);
            for_joints!(j in n => step[j] = rest[j]);
            solve(n, matrix, step);
            let mut slope_here = nothing;
            for_joints!(j in n => slope_here = rest[j].mul_add(step[j], slope_here));
            share = back.or_where_not_above(one, retreats);
            slope = slope.or_where_not_above(slope_here, retreats);
            let mut large = nothing;
            for_joints!(j in n => {
                from[j] = from[j].or_where_not_above(dq[j], retreats);
                way[j] = way[j].or_where_not_above(step[j], retreats);
                dq[j] = share.mul_add(way[j], from[j]).or_where_not_above(dq[j], moves);
                large = step[j].scale(friction.steepness[j]).abs().max(large);
            });
            // It moves on where it went back, or where the step was large.
            moves = one.where_above(large, Lanes::splat(SMALL)).max(retreats).where_above(moves, nothing);
            if (one - moves).all_above(0.5) {
                break;
            }
        }
    }
}

/// Puts `-W^-1 r` in the place of `r`, by `W = L' D L`, which takes the place of `W`.
#[inline(always)]
pub(super) fn solve<V: Set>(n: usize, w: &mut impl Square<Lanes<V>>, r: &mut PerJoint<V>) {
    for_joints!(j in n => r[j] = -r[j]);
    for_joints!(last in n => {
        let k = n - 1 - last;
        let inverse = Lanes::splat(1.0) / w[k][k];
        for_joints!(j in n => if j < k {
            let factor = w[k][j] * inverse;
            for_joints!(i in n => if i <= j {
                w[j][i] = factor.neg_mul_add(w[k][i], w[j][i]);
            });
            r[j] = factor.neg_mul_add(r[k], r[j]);
            w[j][k] = factor; // in the upper half, which is free
        });
        r[k] = r[k] * inverse;
    });
    for_joints!(j in n => for_joints!(i in n => if i < j {
        r[j] = w[i][j].neg_mul_add(r[i], r[j]);
    }));
}
