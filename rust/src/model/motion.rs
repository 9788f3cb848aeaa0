//! Motion of the links, frame by frame from the base: the outward pass that the inverse model and its regressor share.
//!
//! All vectors are in the link's own frame. Gravity enters as an acceleration of the base, `a_0 = -g`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::ground::spatial::Vector;
use crate::robot::arm::{Place, by_twist};
use crate::robot::geometry::{Pose, Step};

/// Largest number of joints whose rows are read in one piece: most arms have no more, and longer pieces are slower.
const FEW: usize = 12;

/// Positions, velocities and accelerations of the joints on lanes.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))] // as `Vector`
pub struct State<V: Set> {
    /// Positions (rad or m).
    pub q: [Lanes<V>; MAX_DOF],
    /// Velocities.
    pub dq: [Lanes<V>; MAX_DOF],
    /// Accelerations.
    pub ddq: [Lanes<V>; MAX_DOF],
}

impl<V: Set> State<V> {
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
            // With what follows a row, its length is known, and no entry has to be checked.
            let wide = V::of(|l| rows[(row + l).min(last) * n..].first_chunk::<FEW>());
            if n <= FEW && wide.as_ref().iter().all(Option::is_some) {
                let wide = V::of(|l| wide[l].unwrap_or(&[0.0; FEW]));
                for j in 0..n.min(FEW) {
                    values[j] = Lanes::each(|l| wide[l][j]);
                }
            } else {
                for j in 0..n {
                    values[j] = Lanes::gather(rows, n, row, j);
                }
            }
        }
    }
}

/// How a link moves: seen from its own frame, its points have the accelerations `a + U p`.
#[derive(Debug, Clone, Copy)]
pub struct Link<V: Set> {
    /// Angular velocity.
    omega: Vector<V>,
    /// Angular acceleration.
    pub domega: Vector<V>,
    /// Acceleration of the origin, less gravity.
    pub a: Vector<V>,
    /// `U`.
    pub u: Angular<V>,
}

impl<V: Set> Link<V> {
    /// The base: gravity enters as its acceleration.
    #[inline(always)]
    pub fn base([x, y, z]: [f64; 3]) -> Self {
        let a = Vector::splat([-x, -y, -z]);
        Self { omega: Vector::zero(), domega: Vector::zero(), a, u: Angular::none() }
    }

    /// Back to the base. `U` stays: the first step from there writes it without reading.
    #[inline(always)]
    pub fn begin(&mut self, [x, y, z]: [f64; 3]) {
        (self.omega, self.domega) = (Vector::zero(), Vector::zero());
        self.a = Vector::splat([-x, -y, -z]);
    }

    /// From one link to the next. Without `MOVING`, joint accelerations are zero.
    #[inline(always)]
    pub fn move_on<P: Place, const MOVING: bool>(
        &mut self,
        _place: P,
        step: &Step<'_>,
        (s, c, t): Pose<'_, V>,
        dq: Lanes<V>,
        ddq: Lanes<V>,
    ) {
        let Self { omega, domega, a, u } = self;
        if step.form.root {
            // The base does not turn.
            *a = by_twist!(P, step, T => a.stepped::<T>(step, s, c));
            if step.form.turns {
                omega.z = dq;
            }
            if MOVING {
                *(if step.form.turns { &mut domega.z } else { &mut a.z }) += ddq;
            }
            *u = if step.form.turns { Angular::about_z(omega.z, domega.z) } else { Angular::none() };
            return;
        }
        *a = u.displaced(*a, &step.form.shifted, t);
        (*omega, *domega, *a) = by_twist!(P, step, T =>
            (omega.stepped::<T>(step, s, c), domega.stepped::<T>(step, s, c), a.stepped::<T>(step, s, c)));
        if step.form.turns {
            domega.x = omega.y.mul_add(dq, domega.x);
            domega.y = omega.x.neg_mul_add(dq, domega.y);
            omega.z += dq;
        } else {
            let twice = dq + dq;
            a.x = omega.y.mul_add(twice, a.x);
            a.y = omega.x.neg_mul_add(twice, a.y);
        }
        if MOVING {
            *(if step.form.turns { &mut domega.z } else { &mut a.z }) += ddq;
        }
        *u = Angular::of(*omega, *domega);
    }
}

/// The matrix `[domega x] + [omega x][omega x]` that turns a place on the link into its acceleration, and its products.
#[derive(Debug, Clone, Copy)]
pub struct Angular<V: Set> {
    columns: [Vector<V>; 3],
    /// `xx yy zz xy xz yz` of the angular velocity.
    pub products: [Lanes<V>; 6],
}

impl<V: Set> Angular<V> {
    /// From angular velocity and acceleration.
    #[inline(always)]
    pub fn of(w: Vector<V>, dw: Vector<V>) -> Self {
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

    /// `U` of a link that does not turn.
    #[inline(always)]
    pub fn none() -> Self {
        Self { columns: [Vector::zero(); 3], products: [Lanes::zero(); 6] }
    }

    /// `U` of a link that turns about z only.
    #[inline(always)]
    pub fn about_z(w: Lanes<V>, dw: Lanes<V>) -> Self {
        let (zero, square) = (Lanes::zero(), w * w);
        Self {
            columns: [Vector::new(-square, dw, zero), Vector::new(-dw, -square, zero), Vector::zero()],
            products: [zero, zero, square, zero, zero, zero],
        }
    }

    /// Acceleration of the point at `t`, of whose components only some can be other than zero.
    #[inline(always)]
    pub fn displaced(&self, mut a: Vector<V>, nonzero: &[bool; 3], t: &Vector<V>) -> Vector<V> {
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
    pub fn column(&self, k: usize) -> Vector<V> {
        self.columns[k]
    }
}
