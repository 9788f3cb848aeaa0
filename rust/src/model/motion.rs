//! Motion of the links, frame by frame from the base: the forward pass shared by the inverse model and its regressor.
//!
//! All vectors are in the link's own frame. Gravity enters as an acceleration of the base, `a_0 = -g`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::Lanes;
use crate::ground::spatial::Vector;
use crate::robot::{JointKind, Robot};

/// Positions, velocities and accelerations of the joints on lanes.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))] // as `Vector`
pub struct State<const L: usize, const F: bool> {
    /// Positions (rad or m).
    pub q: [Lanes<L, F>; MAX_DOF],
    /// Velocities.
    pub dq: [Lanes<L, F>; MAX_DOF],
    /// Accelerations.
    pub ddq: [Lanes<L, F>; MAX_DOF],
}

impl<const L: usize, const F: bool> State<L, F> {
    /// At rest at zero.
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        Self { q: zero, dq: zero, ddq: zero }
    }

    /// Takes rows `row` to `row + L - 1` of row-major `(n_samples, n_dof)` arrays.
    #[inline(always)]
    pub fn load(&mut self, n: usize, row: usize, q: &[f64], dq: &[f64], ddq: &[f64]) {
        let (n, last) = (n.min(MAX_DOF), q.len() / n - 1);
        for (values, rows) in [(&mut self.q, q), (&mut self.dq, dq), (&mut self.ddq, ddq)] {
            // The last row stands in past the end.
            let mut block = [[0.0; MAX_DOF]; L];
            for l in 0..L {
                block[l][..n].copy_from_slice(&rows[(row + l).min(last) * n..][..n]);
            }
            for j in 0..n {
                values[j] = Lanes(std::array::from_fn(|l| block[l][j]));
            }
        }
    }

    /// The same as a state of its own.
    #[inline(always)]
    pub fn gather(n: usize, row: usize, q: &[f64], dq: &[f64], ddq: &[f64]) -> Self {
        let mut state = Self::zero();
        state.load(n, row, q, dq, ddq);
        state
    }
}

/// Where frame `j` is seen from frame `j-1`: the turn about z and the translation `(d, 0, r)` before it.
#[derive(Debug, Clone, Copy)]
pub struct Placement<const L: usize, const F: bool> {
    /// Sine of the angle about z.
    pub sine: Lanes<L, F>,
    /// Its cosine.
    pub cosine: Lanes<L, F>,
    /// Translation along the twisted z axis (m); along x it is the joint's constant `d`.
    pub r: Lanes<L, F>,
}

impl<const L: usize, const F: bool> Placement<L, F> {
    /// Of joint `j` at position `q`.
    #[inline(always)]
    pub fn of(robot: &Robot, j: usize, q: Lanes<L, F>) -> Self {
        let joint = &robot.joints()[j];
        match joint.kind {
            JointKind::Revolute => {
                let (sine, cosine) = (q + Lanes::splat(joint.theta)).sin_cos();
                Self { sine, cosine, r: Lanes::splat(joint.r) }
            }
            JointKind::Prismatic => {
                let (sine, cosine) = Lanes::<L, F>::splat(joint.theta).sin_cos();
                Self { sine, cosine, r: q + Lanes::splat(joint.r) }
            }
        }
    }
}

/// Motion of one link.
#[derive(Debug, Clone, Copy)]
pub struct Motion<const L: usize, const F: bool> {
    /// Angular velocity.
    pub omega: Vector<L, F>,
    /// Angular acceleration.
    pub domega: Vector<L, F>,
    /// Acceleration of the origin, less gravity.
    pub a: Vector<L, F>,
}

impl<const L: usize, const F: bool> Motion<L, F> {
    /// Of the base.
    #[inline(always)]
    pub fn base(robot: &Robot) -> Self {
        let [x, y, z] = robot.gravity();
        Self { omega: Vector::zero(), domega: Vector::zero(), a: Vector::splat([-x, -y, -z]) }
    }

    /// Of link `j`, from that of link `j-1`.
    #[inline(always)]
    #[must_use]
    pub fn next(
        &self,
        robot: &Robot,
        j: usize,
        at: &Placement<L, F>,
        dq: Lanes<L, F>,
        ddq: Lanes<L, F>,
    ) -> Self {
        let joint = &robot.joints()[j];
        let twist = robot.twists()[j];
        let omega = self.omega.into_twisted(twist);
        let domega = self.domega.into_twisted(twist);
        let mut a = self.a.into_twisted(twist);
        let angular = Angular::of(omega, domega);
        if joint.d != 0.0 {
            let d = Lanes::splat(joint.d);
            let u = angular.column(0);
            a = Vector::new(u.x.mul_add(d, a.x), u.y.mul_add(d, a.y), u.z.mul_add(d, a.z));
        }
        if joint.r != 0.0 || joint.kind == JointKind::Prismatic {
            let u = angular.column(2);
            a = Vector::new(u.x.mul_add(at.r, a.x), u.y.mul_add(at.r, a.y), u.z.mul_add(at.r, a.z));
        }
        let mut omega = omega.into_turned(at.sine, at.cosine);
        let mut domega = domega.into_turned(at.sine, at.cosine);
        let mut a = a.into_turned(at.sine, at.cosine);
        match joint.kind {
            JointKind::Revolute => {
                domega.x = omega.y.mul_add(dq, domega.x);
                domega.y = omega.x.neg_mul_add(dq, domega.y);
                domega.z += ddq;
                omega.z += dq;
            }
            JointKind::Prismatic => {
                let twice = dq + dq;
                a.x = omega.y.mul_add(twice, a.x);
                a.y = omega.x.neg_mul_add(twice, a.y);
                a.z += ddq;
            }
        }
        Self { omega, domega, a }
    }
}

/// The matrix `[domega x] + [omega x][omega x]` that turns a place on the link into its acceleration, and its products.
#[derive(Debug, Clone, Copy)]
pub struct Angular<const L: usize, const F: bool> {
    columns: [Vector<L, F>; 3],
    /// `xx yy zz xy xz yz` of the angular velocity.
    pub products: [Lanes<L, F>; 6],
}

impl<const L: usize, const F: bool> Angular<L, F> {
    /// From angular velocity and acceleration.
    #[inline(always)]
    pub fn of(w: Vector<L, F>, dw: Vector<L, F>) -> Self {
        let (xx, yy, zz) = (w.x * w.x, w.y * w.y, w.z * w.z);
        let (xy, xz, yz) = (w.x * w.y, w.x * w.z, w.y * w.z);
        Self {
            columns: [
                Vector::new(-(yy + zz), xy + dw.z, xz - dw.y),
                Vector::new(xy - dw.z, -(xx + zz), yz + dw.x),
                Vector::new(xz + dw.y, yz - dw.x, -(xx + yy)),
            ],
            products: [xx, yy, zz, xy, xz, yz],
        }
    }

    /// Of a link that does not turn.
    #[inline(always)]
    pub fn none() -> Self {
        Self { columns: [Vector::zero(); 3], products: [Lanes::zero(); 6] }
    }

    /// Of a link that turns about z only.
    #[inline(always)]
    pub fn about_z(w: Lanes<L, F>, dw: Lanes<L, F>) -> Self {
        let (zero, square) = (Lanes::zero(), w * w);
        Self {
            columns: [Vector::new(-square, dw, zero), Vector::new(-dw, -square, zero), Vector::zero()],
            products: [zero, zero, square, zero, zero, zero],
        }
    }

    /// Acceleration of the point at `t`, of whose components only some can be other than zero.
    #[inline(always)]
    pub fn displaced(&self, mut a: Vector<L, F>, nonzero: &[bool; 3], t: &Vector<L, F>) -> Vector<L, F> {
        let [u1, u2, u3] = self.columns;
        if nonzero[0] {
            a = Vector::new(u1.x.mul_add(t.x, a.x), u1.y.mul_add(t.x, a.y), u1.z.mul_add(t.x, a.z));
        }
        if nonzero[1] {
            a = Vector::new(u2.x.mul_add(t.y, a.x), u2.y.mul_add(t.y, a.y), u2.z.mul_add(t.y, a.z));
        }
        if nonzero[2] {
            a = Vector::new(u3.x.mul_add(t.z, a.x), u3.y.mul_add(t.z, a.y), u3.z.mul_add(t.z, a.z));
        }
        a
    }

    /// Acceleration that a unit step along axis `k` adds.
    #[inline(always)]
    pub fn column(&self, k: usize) -> Vector<L, F> {
        self.columns[k]
    }
}

/// Motion of a link per unit speed of an earlier joint, seen at the link's origin: how that joint feels the link's wrench.
#[derive(Debug, Clone, Copy)]
pub struct Axis<const L: usize, const F: bool> {
    /// Angular part.
    pub u: Vector<L, F>,
    /// Linear part.
    pub w: Vector<L, F>,
}

impl<const L: usize, const F: bool> Axis<L, F> {
    /// Of the joint itself, in its own frame.
    #[inline(always)]
    pub fn own(kind: JointKind) -> Self {
        let z = Vector::splat([0.0, 0.0, 1.0]);
        match kind {
            JointKind::Revolute => Self { u: z, w: Vector::zero() },
            JointKind::Prismatic => Self { u: Vector::zero(), w: z },
        }
    }

    /// The same axis seen from frame `j`, one further out.
    #[inline(always)]
    #[must_use]
    pub fn next(&self, robot: &Robot, j: usize, at: &Placement<L, F>) -> Self {
        let joint = &robot.joints()[j];
        let twist = robot.twists()[j];
        let u = self.u.into_twisted(twist);
        let mut w = self.w.into_twisted(twist);
        // w + u x (d, 0, r)
        if joint.d != 0.0 {
            let d = Lanes::splat(joint.d);
            w.y = u.z.mul_add(d, w.y);
            w.z = u.y.neg_mul_add(d, w.z);
        }
        if joint.r != 0.0 || joint.kind == JointKind::Prismatic {
            w.x = u.y.mul_add(at.r, w.x);
            w.y = u.x.neg_mul_add(at.r, w.y);
        }
        Self { u: u.into_turned(at.sine, at.cosine), w: w.into_turned(at.sine, at.cosine) }
    }
}
