//! Links and what they carry as bodies: second moments, first moments and mass about the origin of a frame.
//!
//! With the second moments `S = integral p p' dm = tr(J)/2 1 - J` in place of the inertia matrix `J`, a body that moves with
//! accelerations `a + U p` of its points needs the force `U h + m a` and the moment `h x a + vex(U S)`, and moving the origin by
//! `t` adds `t h' + h t' + m t t'`.
//!
//! Particles on the axis of a revolute joint move with the link before; where they have been regrouped into it (`links.rs`),
//! `Szz`, `MZ` and `M` are zero.

use crate::ground::lanes::{Lanes, Set};
use crate::ground::spatial::Vector;
use crate::model::motion::Angular;
use crate::robot::arm::{DISPLACED, GENERAL, MOMENTS, PLUS, Place, TURNED, ZERO, by_twist, carries_of};
use crate::robot::geometry::{Pose, Step};
use crate::robot::parameters::{M, MX, XX};

/// A body about the origin of a frame.
#[derive(Debug, Clone, Copy)]
pub struct Body<V: Set> {
    /// Second moments.
    pub xx: Lanes<V>,
    xy: Lanes<V>,
    /// Second moment.
    pub yy: Lanes<V>,
    xz: Lanes<V>,
    yz: Lanes<V>,
    zz: Lanes<V>,
    /// First moments.
    pub h: Vector<V>,
    /// Mass.
    pub m: Lanes<V>,
}

impl<V: Set> Body<V> {
    /// Nothing.
    #[inline(always)]
    pub fn none() -> Self {
        let o = Lanes::zero();
        Self { xx: o, xy: o, yy: o, xz: o, yz: o, zz: o, h: Vector::zero(), m: o }
    }

    /// From the ten inertial parameters of a link.
    #[inline(always)]
    pub(super) fn of_link(x: &[Lanes<V>]) -> Self {
        let [xx, xy, xz, yy, yz, zz] = [x[XX], x[XX + 1], x[XX + 2], x[XX + 3], x[XX + 4], x[XX + 5]];
        Self {
            xx: (yy + zz - xx).scale(0.5),
            yy: (xx + zz - yy).scale(0.5),
            zz: (xx + yy - zz).scale(0.5),
            xy: -xy,
            xz: -xz,
            yz: -yz,
            h: Vector::new(x[MX], x[MX + 1], x[MX + 2]),
            m: x[M],
        }
    }

    /// Both together.
    #[inline(always)]
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        Self {
            xx: self.xx + other.xx,
            xy: self.xy + other.xy,
            yy: self.yy + other.yy,
            xz: self.xz + other.xz,
            yz: self.yz + other.yz,
            zz: self.zz + other.zz,
            h: self.h + other.h,
            m: self.m + other.m,
        }
    }

    /// Both together, where this one has been regrouped: nothing of it stands on its axis.
    #[inline(always)]
    #[must_use]
    pub fn regrouped_with(&self, other: &Self) -> Self {
        Self {
            xx: self.xx + other.xx,
            xy: self.xy + other.xy,
            yy: self.yy + other.yy,
            xz: self.xz + other.xz,
            yz: self.yz + other.yz,
            zz: other.zz,
            h: Vector::new(self.h.x + other.h.x, self.h.y + other.h.y, other.h.z),
            m: other.m,
        }
    }

    /// Takes away what moves with the link before, and returns it.
    #[inline(always)]
    pub(super) fn take_axis(&mut self) -> Self {
        let axis = Self {
            zz: self.zz,
            h: Vector::new(Lanes::zero(), Lanes::zero(), self.h.z),
            m: self.m,
            ..Self::none()
        };
        (self.zz, self.h.z, self.m) = (Lanes::zero(), Lanes::zero(), Lanes::zero());
        axis
    }

    /// The same body about the origin of the frame before, in that frame, together with the link there.
    #[inline(always)]
    #[must_use]
    pub fn moved_in<P: Place>(
        &self,
        _place: P,
        step: &Step<'_>,
        (s, c, t): Pose<'_, V>,
        link: &Self,
    ) -> Self {
        let moved = by_twist!(P, step, T => self.unstepped::<T>(step, s, c, t, step.form.heavy));
        if step.form.follows_turning { link.regrouped_with(&moved) } else { link.with(&moved) }
    }

    /// The same body about the origin of the frame before, in that frame.
    #[inline(always)]
    #[must_use]
    pub fn unstepped<const T: u8>(
        &self,
        step: &Step<'_>,
        sine: Lanes<V>,
        cosine: Lanes<V>,
        shift: &Vector<V>,
        heavy: bool,
    ) -> Self {
        self.out_of_turned(sine, cosine).untwisted::<T>(step).shifted(step, shift, heavy)
    }

    /// Seen from a frame that has not been turned about z.
    #[inline(always)]
    fn out_of_turned(&self, s: Lanes<V>, c: Lanes<V>) -> Self {
        // R S R' of the part in the plane; its trace stays.
        let p = c.mul_sub(self.xx, s * self.xy);
        let q = c.mul_sub(self.xy, s * self.yy);
        let xx = p.mul_sub(c, q * s);
        let xy = p.mul_add(s, q * c);
        let yy = (self.xx + self.yy) - xx;
        let xz = c.mul_sub(self.xz, s * self.yz);
        let yz = s.mul_add(self.xz, c * self.yz);
        Self { xx, xy, yy, xz, yz, zz: self.zz, h: self.h.out_of_turned(s, c), m: self.m }
    }

    #[inline(always)]
    fn untwisted<const T: u8>(&self, step: &Step<'_>) -> Self {
        let Self { xy, yy, xz, yz, zz, .. } = *self;
        if T == GENERAL {
            let twisted = self.out_of_twisted(step);
            let [c, s] = step.bend();
            return if step.form.bent { twisted.out_of_turned(s, c) } else { twisted };
        }
        let h = self.h.untwisted::<T>(step);
        match T {
            ZERO => *self,
            PLUS => Self { xy: -xz, yy: zz, xz: xy, yz: -yz, zz: yy, h, ..*self },
            _ => Self { xy: xz, yy: zz, xz: -xy, yz: -yz, zz: yy, h, ..*self },
        }
    }

    /// Seen from a frame that has not been turned by alpha about x.
    #[inline(always)]
    fn out_of_twisted(&self, step: &Step<'_>) -> Self {
        let Self { xy, yy, xz, yz, zz, h, .. } = *self;
        let (c, s) = (Lanes::splat(step.cosine), Lanes::splat(step.sine));
        let (p, q) = (c.mul_sub(yy, s * yz), c.mul_sub(yz, s * zz));
        let turned = p.mul_sub(c, q * s);
        Self {
            xy: c.mul_sub(xy, s * xz),
            xz: s.mul_add(xy, c * xz),
            yy: turned,
            yz: p.mul_add(s, q * c),
            zz: (yy + zz) - turned,
            h: Vector::new(h.x, h.y.mul_sub(c, h.z * s), h.z.mul_add(c, h.y * s)),
            ..*self
        }
    }

    /// About an origin at `-t`.
    #[inline(always)]
    fn shifted(mut self, step: &Step<'_>, t: &Vector<V>, heavy: bool) -> Self {
        let before = self.h;
        if heavy {
            let m = self.m;
            self.h =
                Vector::new(t.x.mul_add(m, before.x), t.y.mul_add(m, before.y), t.z.mul_add(m, before.z));
        }
        let after = self.h;
        if step.form.shifted[0] {
            self.xx = t.x.mul_add(before.x + after.x, self.xx);
            self.xy = t.x.mul_add(after.y, self.xy);
            self.xz = t.x.mul_add(after.z, self.xz);
        }
        if step.form.shifted[1] {
            self.xy = t.y.mul_add(before.x, self.xy);
            self.yy = t.y.mul_add(before.y + after.y, self.yy);
            self.yz = t.y.mul_add(after.z, self.yz);
        }
        if step.form.shifted[2] {
            self.xz = t.z.mul_add(before.x, self.xz);
            self.yz = t.z.mul_add(before.y, self.yz);
            self.zz = t.z.mul_add(before.z + after.z, self.zz);
        }
        self
    }

    /// The wrench that accelerates this body with its frame's joint alone.
    #[inline(always)]
    pub fn unit_wrench(&self, turns: bool) -> Wrench<V> {
        let zero = Lanes::zero();
        if turns {
            Wrench {
                force: Vector::new(-self.h.y, self.h.x, zero),
                moment: Vector::new(-self.xz, -self.yz, self.xx + self.yy),
            }
        } else {
            Wrench { force: Vector::new(zero, zero, self.m), moment: Vector::new(self.h.y, -self.h.x, zero) }
        }
    }

    /// The wrench for accelerations `a + U p`.
    #[inline(always)]
    pub fn wrench(&self, u: &Angular<V>, a: Vector<V>) -> Wrench<V> {
        let (u1, u2, u3) = (u.column(0), u.column(1), u.column(2));
        let Self { xx, xy, yy, xz, yz, zz, h, m } = *self;
        let force = Vector::new(
            a.x.mul_add(m, sum([u1.x, u2.x, u3.x], [h.x, h.y, h.z])),
            a.y.mul_add(m, sum([u1.y, u2.y, u3.y], [h.x, h.y, h.z])),
            a.z.mul_add(m, sum([u1.z, u2.z, u3.z], [h.x, h.y, h.z])),
        );
        let rows = [[u1.x, u2.x, u3.x], [u1.y, u2.y, u3.y], [u1.z, u2.z, u3.z]];
        let columns = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let moment = Vector::new(
            sum(rows[2], columns[1]) - sum(rows[1], columns[2]),
            sum(rows[0], columns[2]) - sum(rows[2], columns[0]),
            sum(rows[1], columns[0]) - sum(rows[0], columns[1]),
        );
        Wrench { force, moment: moment + h.cross(a) }
    }

    /// The same for a body that has been regrouped.
    #[inline(always)]
    pub fn regrouped_wrench(&self, u: &Angular<V>, a: Vector<V>) -> Wrench<V> {
        let (u1, u2, u3) = (u.column(0), u.column(1), u.column(2));
        let Self { xx, xy, yy, xz, yz, h, .. } = *self;
        let force = Vector::new(
            u2.x.mul_add(h.y, u1.x * h.x),
            u2.y.mul_add(h.y, u1.y * h.x),
            u2.z.mul_add(h.y, u1.z * h.x),
        );
        // (U S)32 - (U S)23 + hy az, and so on round.
        let x = u1.z.mul_add(xy, u2.z.mul_add(yy, u3.z * yz));
        let x = u1.y.neg_mul_add(xz, u2.y.neg_mul_add(yz, h.y.mul_add(a.z, x)));
        let y = u1.x.mul_add(xz, u2.x * yz);
        let y = u1.z.neg_mul_add(xx, u2.z.neg_mul_add(xy, u3.z.neg_mul_add(xz, h.x.neg_mul_add(a.z, y))));
        let z = u1.y.mul_add(xx, u2.y.mul_add(xy, u3.y * xz));
        let z = u1.x.neg_mul_add(xy, u2.x.neg_mul_add(yy, u3.x.neg_mul_add(yz, z)));
        let z = h.x.mul_add(a.y, h.y.neg_mul_add(a.x, z));
        Wrench { force, moment: Vector::new(x, y, z) }
    }
}

/// Sum of products.
#[inline(always)]
fn sum<V: Set>(a: [Lanes<V>; 3], b: [Lanes<V>; 3]) -> Lanes<V> {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}

/// Force and moment at the origin of a frame, in that frame.
#[derive(Debug, Clone, Copy)]
pub struct Wrench<V: Set> {
    /// Force.
    pub force: Vector<V>,
    /// Moment.
    pub moment: Vector<V>,
}

impl<V: Set> Wrench<V> {
    /// None.
    #[inline(always)]
    pub fn none() -> Self {
        Self { force: Vector::zero(), moment: Vector::zero() }
    }

    /// Component along the frame's own joint: a torque or a force.
    #[inline(always)]
    pub fn felt(&self, turns: bool) -> Lanes<V> {
        if turns { self.moment.z } else { self.force.z }
    }

    /// Both together.
    #[inline(always)]
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        Self { force: self.force + other.force, moment: self.moment + other.moment }
    }

    /// The same wrench at the origin of the frame before, in that frame, where only that is done which matters further in.
    #[inline(always)]
    #[must_use]
    pub fn moved_in<P: Place>(&self, _place: P, step: &Step<'_>, (s, c, t): Pose<'_, V>) -> Self {
        by_twist!(P, step, T => match const { carries_of::<P>() } {
            MOMENTS => self.inwards::<T, MOMENTS>(step, s, c, t),
            TURNED => self.inwards::<T, TURNED>(step, s, c, t),
            DISPLACED => self.inwards::<T, DISPLACED>(step, s, c, t),
            _ => match step.form.carries {
                MOMENTS => self.inwards::<T, MOMENTS>(step, s, c, t),
                TURNED => self.inwards::<T, TURNED>(step, s, c, t),
                _ => self.inwards::<T, DISPLACED>(step, s, c, t),
            },
        })
    }

    /// The same where it is known what of it matters ([`crate::robot::arm::StepForm::carries`]).
    #[inline(always)]
    fn inwards<const T: u8, const C: u8>(
        &self,
        step: &Step<'_>,
        sine: Lanes<V>,
        cosine: Lanes<V>,
        t: &Vector<V>,
    ) -> Self {
        let mut moment = self.moment.unstepped::<T>(step, sine, cosine);
        if C == MOMENTS {
            return Self { force: self.force, moment };
        }
        let force = self.force.unstepped::<T>(step, sine, cosine);
        if C == DISPLACED {
            if step.form.shifted[0] {
                moment.y = t.x.neg_mul_add(force.z, moment.y);
                moment.z = t.x.mul_add(force.y, moment.z);
            }
            if step.form.shifted[1] {
                moment.x = t.y.mul_add(force.z, moment.x);
                moment.z = t.y.neg_mul_add(force.x, moment.z);
            }
            if step.form.shifted[2] {
                moment.x = t.z.neg_mul_add(force.y, moment.x);
                moment.y = t.z.mul_add(force.x, moment.y);
            }
        }
        Self { force, moment }
    }
}
