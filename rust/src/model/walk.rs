//! The columns of the links: the walk out along the robot that the regressor and the observation matrix share.
//!
//! A column of a link's inertial parameter is the wrench that a unit of it needs; row `i` is that wrench seen along axis `i`.

use crate::ground::arrays::MAX_DOF;
use crate::ground::lanes::{Lanes, Set};
use crate::ground::spatial::Vector;
use crate::model::motion::{Link, State};
use crate::robot::arm::{At, Place, by_twist};
use crate::robot::geometry::{Frames, Geometry, Pose, Step};
use crate::robot::parameters::INERTIAL;

/// Motion of a link per unit speed of an earlier joint, seen at the link's origin: how that joint feels the link's wrench.
#[derive(Debug, Clone, Copy)]
struct Axis<V: Set> {
    /// Angular part.
    u: Vector<V>,
    /// Linear part.
    w: Vector<V>,
}

impl<V: Set> Axis<V> {
    #[inline(always)]
    fn none() -> Self {
        Self { u: Vector::zero(), w: Vector::zero() }
    }

    /// Axis of a joint in its own frame.
    #[inline(always)]
    fn own(turns: bool) -> Self {
        let z = Vector::splat([0.0, 0.0, 1.0]);
        if turns { Self { u: z, w: Vector::zero() } } else { Self { u: Vector::zero(), w: z } }
    }

    /// The same axis seen from the next frame.
    #[inline(always)]
    fn stepped<const T: u8>(&self, step: &Step<'_>, (s, c, t): Pose<'_, V>) -> Self {
        let Self { u, mut w } = *self;
        // w + u x t
        if step.form.shifted[0] {
            w.y = u.z.mul_add(t.x, w.y);
            w.z = u.y.neg_mul_add(t.x, w.z);
        }
        if step.form.shifted[1] {
            w.x = u.z.neg_mul_add(t.y, w.x);
            w.z = u.x.mul_add(t.y, w.z);
        }
        if step.form.shifted[2] {
            w.x = u.y.mul_add(t.z, w.x);
            w.y = u.x.neg_mul_add(t.z, w.y);
        }
        Self { u: u.stepped::<T>(step, s, c), w: w.stepped::<T>(step, s, c) }
    }
}

/// Walks out along the robot, branch by branch; on link `j` it knows the columns of that link.
#[derive(Debug, Clone, Copy)]
pub struct Walk<V: Set> {
    frames: Frames<V>,
    link: Link<V>,
    /// Axes of the joints that carry the link, from the base.
    axes: [Axis<V>; MAX_DOF],
    /// Those joints, the link's own one last.
    path: [usize; MAX_DOF],
    /// How many they are.
    depth: usize,
}

impl<V: Set> Walk<V> {
    /// At the base.
    #[inline(always)]
    pub fn new(geometry: &Geometry) -> Self {
        Self {
            frames: Frames::new(geometry),
            link: Link::base(geometry.gravity),
            axes: [Axis::none(); MAX_DOF],
            path: [0; MAX_DOF],
            depth: 0,
        }
    }

    /// Back to the base, with the joints at `q`.
    #[inline(always)]
    pub fn start(&mut self, geometry: &Geometry, q: &[Lanes<V>; MAX_DOF]) {
        self.frames.place(geometry, q);
        self.begin(geometry);
    }

    #[inline(always)]
    fn begin(&mut self, geometry: &Geometry) {
        self.link.begin(geometry.gravity);
        self.depth = 0;
    }

    /// Goes on to link `j` from the link numbered before it; where that is in another branch, from the base. In a `CHAIN` there is
    /// none.
    #[inline(always)]
    pub fn step<const CHAIN: bool>(&mut self, geometry: &Geometry, j: usize, state: &State<V>) {
        if CHAIN {
            return self.move_on(geometry, j, j, state);
        }
        let mut first = j;
        if geometry.step(At(j)).form.branches {
            self.begin(geometry);
            first = 0;
        }
        self.along(geometry, first, j, state);
    }

    /// Goes from the base to link `j`.
    #[inline(always)]
    pub fn reach(&mut self, geometry: &Geometry, j: usize, state: &State<V>) {
        self.along(geometry, 0, j, state);
    }

    /// Moves on through the joints from `first` on that carry link `j`.
    #[inline(always)]
    fn along(&mut self, geometry: &Geometry, first: usize, j: usize, state: &State<V>) {
        let mut k = first;
        loop {
            if k == j || geometry.carries(k, j) {
                self.move_on(geometry, k, self.depth, state);
            }
            if k == j {
                break;
            }
            k += 1;
        }
    }

    /// Moves on through joint `j`, which `before` others carry.
    #[inline(always)]
    fn move_on(&mut self, geometry: &Geometry, j: usize, before: usize, state: &State<V>) {
        let (place, step) = (At(j), geometry.step(At(j)));
        let j = place.index();
        let pose = self.frames.pose(j);
        self.link.move_on::<_, true>(place, &step, pose, state.dq[j], state.ddq[j]);
        let before = before.min(MAX_DOF - 1);
        by_twist!(step, T => for axis in &mut self.axes[..before] {
            *axis = axis.stepped::<T>(&step, pose);
        });
        self.axes[before] = Axis::own(step.form.turns);
        self.path[before] = j;
        self.depth = before + 1;
    }

    /// Hands over the ten inertial columns of link `j`, on which the walk stands, as columns `first` and following.
    #[inline(always)]
    pub(crate) fn link_rows<const CHAIN: bool>(
        &self,
        geometry: &Geometry,
        j: usize,
        first: usize,
        entries: &mut impl Entries<V>,
    ) {
        let unit = UnitWrenches::of(&self.link);
        let before = if CHAIN { j } else { self.depth.min(MAX_DOF) - 1 };
        for i in 0..before {
            entries.put_link(if CHAIN { i } else { self.path[i] }, first, &self.row(i, &unit));
        }
        entries.put_link(j, first, &Self::own_row(geometry.step(At(j)).form.turns, &unit));
    }

    /// The row of these columns of a joint further in, the `i`-th from the base.
    #[inline(always)]
    fn row(&self, i: usize, unit: &UnitWrenches<'_, V>) -> [Lanes<V>; INERTIAL] {
        let Axis { u, w } = self.axes[i];
        let mut row = [Lanes::zero(); INERTIAL];
        for k in 0..6 {
            row[k] = u.dot(unit.inertia[k]);
        }
        let Link { a, u: angular, .. } = unit.link;
        row[6] = u.z.mul_add(a.y, u.y.neg_mul_add(a.z, w.dot(angular.column(0))));
        row[7] = u.x.mul_add(a.z, u.z.neg_mul_add(a.x, w.dot(angular.column(1))));
        row[8] = u.y.mul_add(a.x, u.x.neg_mul_add(a.y, w.dot(angular.column(2))));
        row[9] = w.dot(*a);
        row
    }

    /// The same of the link's own joint, which turns or not.
    #[inline(always)]
    fn own_row(turns: bool, unit: &UnitWrenches<'_, V>) -> [Lanes<V>; INERTIAL] {
        let mut row = [Lanes::zero(); INERTIAL];
        let Link { a, u: angular, .. } = unit.link;
        if turns {
            for k in 0..6 {
                row[k] = unit.inertia[k].z;
            }
            (row[6], row[7]) = (a.y, -a.x);
        } else {
            for k in 0..3 {
                row[6 + k] = angular.column(k).z;
            }
            row[9] = a.z;
        }
        row
    }
}

/// Moments of unit inertias (`XX XY XZ YY YZ ZZ`), and what forces and moments of the first moments and the mass follow from.
#[derive(Debug, Clone, Copy)]
struct UnitWrenches<'a, V: Set> {
    inertia: [Vector<V>; 6],
    link: &'a Link<V>,
}

impl<'a, V: Set> UnitWrenches<'a, V> {
    #[inline(always)]
    fn of(link: &'a Link<V>) -> Self {
        let [xx, yy, zz, xy, xz, yz] = link.u.products;
        let d = link.domega;
        Self {
            inertia: [
                Vector::new(d.x, xz, -xy),
                Vector::new(d.y - xz, d.x + yz, xx - yy),
                Vector::new(d.z + xy, zz - xx, d.x - yz),
                Vector::new(-yz, d.y, xy),
                Vector::new(yy - zz, d.z - xy, d.y + xz),
                Vector::new(yz, -xz, d.z),
            ],
            link,
        }
    }
}

/// Takes the entries of a regressor. A trait and not a closure: what it does must be inlined into the kernel.
pub(crate) trait Entries<V: Set> {
    /// Takes the entry of `L` samples. Implementations are `#[inline(always)]`.
    fn put(&mut self, row: usize, column: usize, value: Lanes<V>);

    /// Takes neighbouring entries of the inertial parameters of a link.
    #[inline(always)]
    fn put_link(&mut self, row: usize, first: usize, values: &[Lanes<V>; INERTIAL]) {
        for (k, &value) in values.iter().enumerate() {
            self.put(row, first + k, value);
        }
    }

    /// Takes neighbouring entries of a drive.
    #[inline(always)]
    fn put_drive(&mut self, row: usize, first: usize, values: [Lanes<V>; 4]) {
        for (k, value) in values.into_iter().enumerate() {
            self.put(row, first + k, value);
        }
    }
}
