//! The geometry as the kernels walk it: its constants and its zeros, decided once per robot.
//!
//! The step from the frame before, that of the joint's parent, is a turn `Rot(x, alpha) Rot(z, theta)` about an origin displaced by
//! `t = (d, -r sin alpha, r cos alpha)`, seen in the frame before; in trees `Rot(z, gamma)` may stand before these. Most components of `t` are zero and most twists right angles; a
//! kernel asks once per joint ([`crate::robot::arm`]) and then runs through code that has no multiplication by them.

use crate::ground::arrays::MAX_DOF;
use crate::ground::dispatch::WIDTH;
use crate::ground::lanes::{Lanes, Set, side_by_side};
use crate::ground::spatial::Vector;
use crate::robot::arm::{
    Any, Arm, At, BASE, GENERAL, MINUS, PLUS, Place, SIX, StepForm, ZERO, complete, outwards,
};
use crate::robot::{JointKind, Robot, Twist};
use std::marker::PhantomData;
use std::ops::Deref;

/// The step to one frame from the one before: its form, constant where the kernel knows it, and its numbers, which stay where they
/// are.
#[derive(Debug, Clone, Copy)]
pub struct Step<'a> {
    /// Its form.
    pub form: StepForm,
    numbers: &'a Numbers,
}

impl Deref for Step<'_> {
    type Target = Numbers;
    #[inline(always)]
    fn deref(&self) -> &Numbers {
        self.numbers
    }
}

/// Numbers of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Numbers {
    /// Its form.
    form: StepForm,
    /// Cosine of alpha.
    pub cosine: f64,
    /// Its sine.
    pub sine: f64,
    /// Cosine and sine of gamma, of a bent step.
    gamma: [f64; 2],
    /// Angle about z at `q = 0`.
    theta: f64,
    /// `t` at `q = 0`.
    shift: [f64; 3],
    /// Direction in which a joint slides, seen in the frame before.
    axis: [f64; 3],
    /// The joint that this one stands on.
    parent: usize,
    /// One past the last joint that it carries.
    end: usize,
    /// One past the last joint whose row of `L` can have an entry in this joint's column.
    fill: usize,
    /// The first joint whose column can have an entry in this joint's row of `L`.
    first: usize,
}

impl Numbers {
    /// Those of no step at all.
    const STILL: Self = Self {
        form: StepForm::STILL,
        cosine: 1.0,
        sine: 0.0,
        gamma: [1.0, 0.0],
        theta: 0.0,
        shift: [0.0; 3],
        axis: [0.0, 0.0, 1.0],
        parent: 0,
        end: 0,
        fill: 0,
        first: 0,
    };

    fn of(robot: &Robot, j: usize) -> Self {
        let (joint, placement) = (&robot.joints()[j], &robot.placements()[j]);
        let (cosine, sine) = placement.twist.cos_sin();
        let twist = match placement.twist {
            _ if placement.gamma.is_some() => GENERAL,
            Twist::Zero => ZERO,
            Twist::Plus => PLUS,
            Twist::Minus => MINUS,
            Twist::Half | Twist::General(..) => GENERAL,
        };
        let turns = joint.kind == JointKind::Revolute;
        let (shift, axis) = (placement.shift, placement.axis);
        let shifted = std::array::from_fn(|k| shift[k] != 0.0 || (!turns && axis[k] != 0.0));
        let (c, s) = placement.gamma.unwrap_or((1.0, 0.0));
        let parent = robot.mounts()[j].parent;
        let coupled = robot.couples_branches();
        let first = if coupled { 0 } else { (0..=j).find(|&i| robot.carries(i, j)).unwrap_or(j) };
        Self {
            form: StepForm { bent: placement.gamma.is_some(), ..StepForm::of(turns, twist, shifted) },
            cosine,
            sine,
            gamma: [c, s],
            theta: joint.theta,
            shift,
            axis,
            parent: parent.unwrap_or(BASE),
            end: robot.end(j),
            fill: if coupled { robot.n_joints() } else { robot.end(j) },
            first,
        }
    }

    /// Cosine and sine of gamma, on lanes.
    #[inline(always)]
    pub fn bend<V: Set>(&self) -> [Lanes<V>; 2] {
        [Lanes::splat(self.gamma[0]), Lanes::splat(self.gamma[1])]
    }

    /// The joint that this one stands on, unless that is the base. The compiler sees that it is within the arrays.
    #[inline(always)]
    pub fn before<P: Place>(&self, place: P) -> usize {
        if const { P::FORM.is_some() } {
            place.index().saturating_sub(1)
        } else {
            self.parent.min(MAX_DOF - 1)
        }
    }
}

/// The steps of a robot, its order of joints and its gravity, as the kernels read them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Geometry<S = Any> {
    n: usize,
    /// Does each joint stand on the one numbered before it?
    chain: bool,
    steps: [Numbers; MAX_DOF],
    /// Acceleration of gravity in frame 0 (m/s^2).
    pub gravity: [f64; 3],
    shape: PhantomData<S>,
}

impl Default for Geometry {
    /// That of no joint at all.
    #[expect(clippy::large_stack_arrays, reason = "17 kB, once a robot")]
    fn default() -> Self {
        Self { n: 0, chain: true, steps: [Numbers::STILL; MAX_DOF], gravity: [0.0; 3], shape: PhantomData }
    }
}

impl Geometry {
    /// Geometry of a robot, which keeps it ([`Robot::geometry`]).
    pub(super) fn of(robot: &Robot) -> Self {
        let n = robot.n_joints();
        let mut geometry = Self { n, gravity: robot.gravity(), ..Self::default() };
        let (mut forms, mut parents) = ([StepForm::STILL; MAX_DOF], [0; MAX_DOF]);
        for j in 0..n {
            let step = Numbers::of(robot, j);
            (forms[j], parents[j]) = (step.form, step.parent);
            geometry.steps[j] = step;
        }
        let forms = complete(forms, &parents, n);
        for j in 0..n {
            geometry.steps[j].form = forms[j];
            geometry.chain &= !forms[j].branches;
        }
        geometry
    }

    /// The same for kernels that know its shape, if it has that shape.
    pub fn known<S: Arm>(&self) -> Option<Geometry<S>> {
        let same = self.n == SIX && S::FORMS?.iter().zip(&self.steps).all(|(form, step)| *form == step.form);
        let Self { n, chain, steps, gravity, .. } = *self;
        same.then_some(Geometry { n, chain, steps, gravity, shape: PhantomData })
    }
}

impl<S: Arm> Geometry<S> {
    /// Number of joints. The compiler sees that it is within the arrays.
    #[inline(always)]
    pub fn n(&self) -> usize {
        if S::KNOWN { SIX } else { self.n.min(MAX_DOF) }
    }

    /// Does each joint stand on the one numbered before it? Kernels ask once, outside their loops.
    #[inline(always)]
    pub fn is_chain(&self) -> bool {
        S::KNOWN || self.chain
    }

    /// Does joint `i` carry link `j`?
    #[inline(always)]
    pub fn carries(&self, i: usize, j: usize) -> bool {
        i <= j && j < self.steps[i].end
    }

    /// One past the last joint whose row of `L` can have an entry in column `k`, at most `n`.
    #[inline(always)]
    pub fn fill(&self, k: usize) -> usize {
        if S::KNOWN { SIX } else { self.steps[k].fill.min(MAX_DOF) }
    }

    /// One past the last joint that a joint carries, at most `n`.
    #[inline(always)]
    pub fn end<P: Place>(&self, place: P) -> usize {
        if S::KNOWN { SIX } else { self.steps[place.index()].end.min(MAX_DOF) }
    }

    /// The first joint whose column can have an entry in a joint's row of `L`.
    #[inline(always)]
    pub fn first<P: Place>(&self, place: P) -> usize {
        if S::KNOWN { 0 } else { self.steps[place.index()].first }
    }

    /// The step to a joint's frame.
    #[inline(always)]
    pub fn step<P: Place>(&self, place: P) -> Step<'_> {
        let numbers = &self.steps[place.index()];
        Step { form: P::FORM.unwrap_or(numbers.form), numbers }
    }
}

/// Pose of each frame in the one before, on lanes.
#[derive(Debug, Clone, Copy)]
pub struct Frames<V: Set> {
    /// Sine of the angle about z.
    pub sine: [Lanes<V>; MAX_DOF],
    /// Its cosine.
    pub cosine: [Lanes<V>; MAX_DOF],
    /// `t`, of which only [`StepForm::shifted`] components are used.
    pub shift: [Vector<V>; MAX_DOF],
}

/// Positions of the joints, their sines and their cosines, from which [`Frames::follow`] starts.
pub type Anchor<V> = [[Lanes<V>; MAX_DOF]; 3];

/// Pose of a frame in the one before: sine and cosine of the angle about z, and the displacement `t`.
pub type Pose<'a, V> = (Lanes<V>, Lanes<V>, &'a Vector<V>);

impl<V: Set> Frames<V> {
    /// Pose of frame `j` in the one before.
    #[inline(always)]
    pub fn pose(&self, j: usize) -> Pose<'_, V> {
        (self.sine[j], self.cosine[j], &self.shift[j])
    }

    /// At `q = 0`.
    #[inline(always)]
    pub fn new<S: Arm>(geometry: &Geometry<S>) -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        let mut frames = Self { sine: zero, cosine: zero, shift: [Vector::zero(); MAX_DOF] };
        for j in 0..geometry.n() {
            let step = &geometry.steps[j];
            (frames.sine[j], frames.cosine[j]) = Lanes::splat(step.theta).sin_cos();
            frames.shift[j] = Vector::splat(step.shift);
        }
        frames
    }

    /// Moves the joints to `q`.
    #[inline(always)]
    pub fn place<S: Arm>(&mut self, geometry: &Geometry<S>, q: &[Lanes<V>; MAX_DOF]) {
        if V::L == 1 && V::FUSED {
            return self.place_together(geometry, q);
        }
        outwards!(S, geometry.n(), place => {
            let (step, j) = (geometry.step(place), place.index());
            if step.form.turns {
                (self.sine[j], self.cosine[j]) = (q[j] + Lanes::splat(step.theta)).sin_cos();
            } else {
                self.slide(&step, j, q[j]);
            }
        });
    }

    /// The same, and stores the anchor of [`Self::follow`].
    #[inline(always)]
    pub fn anchor<S: Arm>(
        &mut self,
        geometry: &Geometry<S>,
        q: &[Lanes<V>; MAX_DOF],
        anchor: &mut Anchor<V>,
    ) {
        self.place(geometry, q);
        outwards!(S, geometry.n(), place => {
            let j = place.index();
            (anchor[0][j], anchor[1][j], anchor[2][j]) = (q[j], self.sine[j], self.cosine[j]);
        });
    }

    /// Moves the joints to `q`, near the anchor: sums of angles are cheaper than new sines.
    #[inline(always)]
    pub fn follow<S: Arm>(&mut self, geometry: &Geometry<S>, q: &[Lanes<V>; MAX_DOF], anchor: &Anchor<V>) {
        if V::L == 1 && V::FUSED {
            return self.follow_together(geometry, q, anchor);
        }
        outwards!(S, geometry.n(), place => {
            let (step, j) = (geometry.step(place), place.index());
            if step.form.turns {
                let from = [anchor[0][j], anchor[1][j], anchor[2][j]];
                (self.sine[j], self.cosine[j]) = Lanes::sin_cos_near(from, q[j], Lanes::splat(step.theta));
            } else {
                self.slide(&step, j, q[j]);
            }
        });
    }

    /// [`Self::place`] of a single lane: the joints side by side in a register, the same bits.
    #[inline(always)]
    fn place_together<S: Arm>(&mut self, geometry: &Geometry<S>, q: &[Lanes<V>; MAX_DOF]) {
        for first in (0..geometry.n()).step_by(WIDTH) {
            let theta = Lanes::<V::Wide>::each(|k| geometry.steps[first + k].theta);
            let (sine, cosine) = (side_by_side(q, first) + theta).sin_cos();
            self.put_together(geometry, first, q, sine, cosine);
        }
    }

    /// [`Self::follow`], likewise.
    #[inline(always)]
    fn follow_together<S: Arm>(
        &mut self,
        geometry: &Geometry<S>,
        q: &[Lanes<V>; MAX_DOF],
        [q0, s, c]: &Anchor<V>,
    ) {
        for first in (0..geometry.n()).step_by(WIDTH) {
            let theta = Lanes::<V::Wide>::each(|k| geometry.steps[first + k].theta);
            let from = [side_by_side(q0, first), side_by_side(s, first), side_by_side(c, first)];
            let (sine, cosine) = Lanes::sin_cos_near(from, side_by_side(q, first), theta);
            self.put_together(geometry, first, q, sine, cosine);
        }
    }

    #[inline(always)]
    fn put_together<S: Arm>(
        &mut self,
        geometry: &Geometry<S>,
        first: usize,
        q: &[Lanes<V>; MAX_DOF],
        sine: Lanes<V::Wide>,
        cosine: Lanes<V::Wide>,
    ) {
        let (sine, cosine) = (sine.to_array(), cosine.to_array());
        for k in 0..WIDTH.min(geometry.n().saturating_sub(first)) {
            let (j, step) = (first + k, geometry.step(At(first + k)));
            if step.form.turns {
                (self.sine[j], self.cosine[j]) = (Lanes::splat(sine[k]), Lanes::splat(cosine[k]));
            } else {
                self.slide(&step, j, q[j]);
            }
        }
    }

    #[inline(always)]
    fn slide(&mut self, step: &Step<'_>, j: usize, q: Lanes<V>) {
        let [x, y, z] = step.shift;
        let x = if step.form.bent {
            q.mul_add(Lanes::splat(step.axis[0]), Lanes::splat(x))
        } else {
            Lanes::splat(x)
        };
        let y = q.mul_add(Lanes::splat(step.axis[1]), Lanes::splat(y));
        let z = q.mul_add(Lanes::splat(step.axis[2]), Lanes::splat(z));
        self.shift[j] = Vector::new(x, y, z);
    }
}

impl<V: Set> Vector<V> {
    /// Components after the step's twist: `Rot(x, alpha)^T v`.
    #[inline(always)]
    fn twisted<const T: u8>(self, step: &Step<'_>) -> Self {
        match T {
            ZERO => self,
            PLUS => Self::new(self.x, self.z, -self.y),
            MINUS => Self::new(self.x, -self.z, self.y),
            _ => {
                let (c, s) = (Lanes::splat(step.cosine), Lanes::splat(step.sine));
                let v = if step.form.bent { self.into_turned(step.bend()[1], step.bend()[0]) } else { self };
                Self::new(v.x, v.y.mul_add(c, v.z * s), v.z.mul_sub(c, v.y * s))
            }
        }
    }

    /// Back: `Rot(x, alpha) v`.
    #[inline(always)]
    pub fn untwisted<const T: u8>(self, step: &Step<'_>) -> Self {
        match T {
            ZERO => self,
            PLUS => Self::new(self.x, -self.z, self.y),
            MINUS => Self::new(self.x, self.z, -self.y),
            _ => {
                let (c, s) = (Lanes::splat(step.cosine), Lanes::splat(step.sine));
                let v = Self::new(self.x, self.y.mul_sub(c, self.z * s), self.z.mul_add(c, self.y * s));
                if step.form.bent { v.out_of_turned(step.bend()[1], step.bend()[0]) } else { v }
            }
        }
    }

    /// A direction of frame `j-1` in frame `j`.
    #[inline(always)]
    pub fn stepped<const T: u8>(self, step: &Step<'_>, sine: Lanes<V>, cosine: Lanes<V>) -> Self {
        self.twisted::<T>(step).into_turned(sine, cosine)
    }

    /// A direction of frame `j` in frame `j-1`.
    #[inline(always)]
    pub fn unstepped<const T: u8>(self, step: &Step<'_>, sine: Lanes<V>, cosine: Lanes<V>) -> Self {
        self.out_of_turned(sine, cosine).untwisted::<T>(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::lanes::Plain;
    use crate::robot::arm::by_twist;
    use proptest::prelude::*;

    /// `v` by a matrix, row by row.
    fn times(matrix: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
        matrix.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    proptest! {
        #[test]
        fn steps_are_the_rotations_they_stand_for(
            v in prop::array::uniform3(-3.0..3.0_f64), theta in -7.0..7.0_f64, alpha in -7.0..7.0_f64,
        ) {
            let (s, c) = Lanes::<Plain<1>>::splat(theta).sin_cos();
            for (twist, cosine, sine) in [
                (ZERO, 1.0, 0.0), (PLUS, 0.0, 1.0), (MINUS, 0.0, -1.0), (GENERAL, alpha.cos(), alpha.sin()),
            ] {
                let numbers = Numbers { cosine, sine, ..Numbers::STILL };
                let step = Step { form: StepForm::of(true, twist, [false; 3]), numbers: &numbers };
                let vector = Vector::splat(v);
                let (into, back) = by_twist!(step, T => {
                    let into = vector.stepped::<T>(&step, s, c);
                    (into, into.unstepped::<T>(&step, s, c))
                });
                // Rot(z, theta)' Rot(x, alpha)' v
                let untwisted = times([[1.0, 0.0, 0.0], [0.0, cosine, sine], [0.0, -sine, cosine]], v);
                let (st, ct) = theta.sin_cos();
                let want = times([[ct, st, 0.0], [-st, ct, 0.0], [0.0, 0.0, 1.0]], untwisted);
                for (got, want) in [into.x, into.y, into.z].iter().zip(want) {
                    prop_assert!((got.lane(0) - want).abs() < 1e-12);
                }
                for (got, want) in [back.x, back.y, back.z].iter().zip(v) {
                    prop_assert!((got.lane(0) - want).abs() < 1e-12);
                }
            }
        }
    }
}
