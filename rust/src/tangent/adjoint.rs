//! Gradient of a weighted sum of the regressor's entries with respect to positions, velocities and accelerations.
//!
//! A criterion of a motion that is a function of its regressor `W` (2) changes by `sum G : dW`, with `G` its derivative with
//! respect to the entries. `sum_p G_ip W_ip` is the torque of joint `i` with the row `G_i` as standard parameters, so the sum is
//! `n` inverse dynamic models (1) that share one motion. They are walked outwards once; the derivatives are carried inwards,
//! in reverse order, at a small multiple of the cost of the sum itself. Identity that tests it: the derivatives of the inverse
//! model with the rows as parameters, `rust/tests/common/partials.rs`.

use crate::ground::arrays::{MAX_DOF, ShapeError, check_length};
use crate::ground::dispatch::{Kernel, dispatch};
use crate::ground::lanes::{Lanes, Set};
use crate::ground::spatial::Vector;
use crate::model::motion::State;
use crate::robot::parameters::{INERTIAL, Layout};
use crate::robot::{JointKind, Robot};
use crate::tangent::drives::drives;
use crate::tangent::twists::{into_placed, out_of_placed};

/// Arrays for the derivatives, each row-major `(n_samples, n_dof)`.
#[derive(Debug)]
pub struct Gradient<'a> {
    /// With respect to positions.
    pub q: &'a mut [f64],
    /// With respect to velocities.
    pub dq: &'a mut [f64],
    /// With respect to accelerations.
    pub ddq: &'a mut [f64],
}

/// Derivatives of `sum G : W` of each sample; `g` is row-major `(n_samples, n_dof, n_parameters)`.
///
/// Where the sign of a velocity jumps, its derivative is taken as zero.
pub fn contraction_gradient(
    robot: &Robot,
    q: &[f64],
    dq: &[f64],
    ddq: &[f64],
    g: &[f64],
    out: Gradient<'_>,
) -> Result<(), ShapeError> {
    check_length("dq", dq, q.len())?;
    check_length("ddq", ddq, q.len())?;
    check_length("g", g, q.len() * Layout::of(robot).count())?;
    for (what, array) in
        [("the gradient of q", &*out.q), ("the gradient of dq", &*out.dq), ("the gradient of ddq", &*out.ddq)]
    {
        check_length(what, array, q.len())?;
    }
    if !q.is_empty() {
        let Some(followers) = robot.followers() else {
            dispatch(Batch { robot, q, dq, ddq, g, out });
            return Ok(());
        };
        let [q, dq, ddq] = [(q, true), (dq, false), (ddq, false)].map(|(v, at)| followers.spread(v, at));
        let p = Layout::of(robot).count();
        let mut rows = Vec::with_capacity(q.len() * p);
        for sample in g.chunks_exact(robot.n_dof() * p) {
            for j in 0..robot.n_joints() {
                rows.extend((0..p).map(|c| {
                    followers.leaders(j).iter().map(|&(a, factor)| factor * sample[a * p + c]).sum::<f64>()
                }));
            }
        }
        let mut all = [(); 3].map(|()| vec![0.0; q.len()]);
        let [q_bar, dq_bar, ddq_bar] = &mut all;
        let found = Gradient { q: q_bar, dq: dq_bar, ddq: ddq_bar };
        dispatch(Batch { robot, q: &q, dq: &dq, ddq: &ddq, g: &rows, out: found });
        for (all, out) in all.iter().zip([out.q, out.dq, out.ddq]) {
            followers.gather(all, 1, out);
        }
    }
    Ok(())
}

struct Batch<'a> {
    robot: &'a Robot,
    q: &'a [f64],
    dq: &'a [f64],
    ddq: &'a [f64],
    g: &'a [f64],
    out: Gradient<'a>,
}

impl Kernel for Batch<'_> {
    type Output = ();
    #[inline(always)]
    fn run<V: Set>(self) {
        let n = self.robot.n_joints();
        let layout = Layout::of(self.robot);
        let width = n * layout.count();
        let (mut chain, mut found) = (Chain::<V>::new(self.robot), State::zero());
        let blocks = self.out.q.chunks_mut(n * V::L).zip(self.out.dq.chunks_mut(n * V::L));
        for (block, ((q, dq), ddq)) in blocks.zip(self.out.ddq.chunks_mut(n * V::L)).enumerate() {
            let mut state = State::<V>::zero();
            state.load(n, block * V::L, self.q, self.dq, self.ddq);
            let weights = Weights { g: &self.g[block * V::L * width..], width, layout };
            chain.outwards(self.robot, &state);
            chain.inwards(self.robot, &state, &weights, &mut found);
            drives(self.robot, &state, &weights, &mut found);
            Lanes::scatter(&found.q[..n], q, n);
            Lanes::scatter(&found.dq[..n], dq, n);
            Lanes::scatter(&found.ddq[..n], ddq, n);
        }
    }
}

/// The rows `G` of a block of samples.
pub(super) struct Weights<'a> {
    g: &'a [f64],
    /// Entries of a sample.
    width: usize,
    /// Places of the parameters.
    pub(super) layout: Layout<'a>,
}

impl Weights<'_> {
    /// Entry of a row and a column; past the end the last sample stands in.
    #[inline(always)]
    pub(super) fn at<V: Set>(&self, row: usize, column: usize) -> Lanes<V> {
        Lanes::gather(self.g, self.width, 0, row * self.layout.count() + column)
    }
}

/// A link's motion, or the derivatives of the sum with respect to it.
#[derive(Debug, Clone, Copy)]
struct Motion<V: Set> {
    omega: Vector<V>,
    domega: Vector<V>,
    a: Vector<V>,
}

impl<V: Set> Motion<V> {
    #[inline(always)]
    fn none() -> Self {
        Self { omega: Vector::zero(), domega: Vector::zero(), a: Vector::zero() }
    }
}

/// An earlier joint's axis as a link feels it: angular and linear part of the motion per unit speed.
#[derive(Debug, Clone, Copy)]
struct Axis<V: Set> {
    u: Vector<V>,
    w: Vector<V>,
}

/// Values of the outward pass that the inward pass needs.
struct Chain<V: Set> {
    base: Motion<V>,
    sine: [Lanes<V>; MAX_DOF],
    cosine: [Lanes<V>; MAX_DOF],
    /// Displacement of each origin after the twist, `(d, 0, r)` in a chain.
    arm: [Vector<V>; MAX_DOF],
    /// Motion of the link before, in the frame of the link: without the joint's own speed.
    carried: [Motion<V>; MAX_DOF],
    /// Axes of the joints that carry link `j`, seen from there.
    axes: Vec<[Axis<V>; MAX_DOF]>,
    /// Derivatives with respect to the motion of link `j`, once the joints that it carries have added theirs.
    bars: [Motion<V>; MAX_DOF],
    /// The same with respect to the axes seen from link `j`.
    axes_bar: Vec<[Axis<V>; MAX_DOF]>,
}

impl<V: Set> Chain<V> {
    #[inline(always)]
    fn new(robot: &Robot) -> Self {
        let zero = [Lanes::zero(); MAX_DOF];
        let axis = Axis { u: Vector::zero(), w: Vector::zero() };
        let [x, y, z] = robot.gravity();
        Self {
            base: Motion { a: Vector::splat([-x, -y, -z]), ..Motion::none() },
            sine: zero,
            cosine: zero,
            arm: [Vector::zero(); MAX_DOF],
            carried: [Motion::none(); MAX_DOF],
            axes: vec![[axis; MAX_DOF]; robot.n_joints()],
            bars: [Motion::none(); MAX_DOF],
            axes_bar: vec![[axis; MAX_DOF]; robot.n_joints()],
        }
    }

    /// Motion of link `j`: what is carried, and the joint's own speed and acceleration.
    #[inline(always)]
    fn motion(&self, robot: &Robot, j: usize, state: &State<V>) -> Motion<V> {
        let Motion { mut omega, mut domega, mut a } = self.carried[j];
        let (dq, ddq) = (state.dq[j], state.ddq[j]);
        match robot.joints()[j].kind {
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
        Motion { omega, domega, a }
    }

    #[inline(always)]
    fn outwards(&mut self, robot: &Robot, state: &State<V>) {
        for j in 0..robot.n_joints().min(MAX_DOF) {
            let (joint, placement) = (&robot.joints()[j], &robot.placements()[j]);
            let parent = robot.mounts()[j].parent;
            let before = parent.map_or(self.base, |parent| self.motion(robot, parent, state));
            let revolute = joint.kind == JointKind::Revolute;
            let theta = Lanes::splat(joint.theta);
            let (s, c) = (if revolute { state.q[j] + theta } else { theta }).sin_cos();
            let mut arm = Vector::splat(placement.arm);
            if !revolute {
                arm.z += state.q[j];
            }
            (self.sine[j], self.cosine[j], self.arm[j]) = (s, c, arm);
            let (omega, domega) =
                (into_placed(before.omega, placement), into_placed(before.domega, placement));
            let a = into_placed(before.a, placement) + (domega.cross(arm) + omega.cross(omega.cross(arm)));
            self.carried[j] = Motion {
                omega: omega.into_turned(s, c),
                domega: domega.into_turned(s, c),
                a: a.into_turned(s, c),
            };
            let (inner, outer) = self.axes.split_at_mut(j);
            for i in (0..j).filter(|&i| robot.carries(i, j)) {
                let Some(parent) = parent else { break };
                let Axis { u, w } = inner[parent][i];
                let (u, w) = (into_placed(u, placement), into_placed(w, placement));
                outer[0][i] = Axis { u: u.into_turned(s, c), w: (w + u.cross(arm)).into_turned(s, c) };
            }
            let z = Vector::splat([0.0, 0.0, 1.0]);
            outer[0][j] =
                if revolute { Axis { u: z, w: Vector::zero() } } else { Axis { u: Vector::zero(), w: z } };
        }
    }

    /// Derivatives of the links' part of the sum, into `found`.
    #[inline(always)]
    fn inwards(&mut self, robot: &Robot, state: &State<V>, weights: &Weights<'_>, found: &mut State<V>) {
        let n = robot.n_joints().min(MAX_DOF);
        self.bars = [Motion::none(); MAX_DOF];
        for bars in &mut self.axes_bar {
            bars[..n].fill(Axis { u: Vector::zero(), w: Vector::zero() });
        }
        for j in (0..n).rev() {
            let motion = self.motion(robot, j, state);
            let first = weights.layout.joint(j);
            for i in (0..=j).filter(|&i| robot.carries(i, j)) {
                let row: [Lanes<V>; INERTIAL] = std::array::from_fn(|k| weights.at(i, first + k));
                body(&row, &motion, &self.axes[j][i], &mut self.bars[j], &mut self.axes_bar[j][i]);
            }
            let bar = self.through_joint(robot, j, state, self.bars[j], found);
            if let Some(parent) = robot.mounts()[j].parent {
                let before = &mut self.bars[parent];
                before.omega = before.omega + bar.omega;
                before.domega = before.domega + bar.domega;
                before.a = before.a + bar.a;
            }
        }
    }

    /// From link `j` to its parent: derivatives with respect to the joint, and what is left for the links further in.
    #[inline(always)]
    fn through_joint(
        &mut self,
        robot: &Robot,
        j: usize,
        state: &State<V>,
        mut bar: Motion<V>,
        found: &mut State<V>,
    ) -> Motion<V> {
        let (s, c, arm, carried) = (self.sine[j], self.cosine[j], self.arm[j], self.carried[j]);
        let (placement, parent) = (&robot.placements()[j], robot.mounts()[j].parent);
        let revolute = robot.joints()[j].kind == JointKind::Revolute;
        // The joint's own speed and acceleration.
        let (felt, speed) = if revolute {
            found.ddq[j] = bar.domega.z;
            (bar.domega, state.dq[j])
        } else {
            found.ddq[j] = bar.a.z;
            (bar.a.times(2.0), state.dq[j])
        };
        let across = felt.x.mul_sub(carried.omega.y, felt.y * carried.omega.x);
        found.dq[j] = if revolute { across + bar.omega.z } else { across };
        bar.omega.x = felt.y.neg_mul_add(speed, bar.omega.x);
        bar.omega.y = felt.x.mul_add(speed, bar.omega.y);
        // The turn about z.
        let mut turn = turned_by(bar.omega, carried.omega)
            + (turned_by(bar.domega, carried.domega) + turned_by(bar.a, carried.a));
        let omega_bar = bar.omega.out_of_turned(s, c);
        let domega_bar = bar.domega.out_of_turned(s, c);
        let a_bar = bar.a.out_of_turned(s, c);
        // The displacement of the origin: `a + domega x arm + omega x (omega x arm)`.
        let (omega, domega) = (carried.omega.out_of_turned(s, c), carried.domega.out_of_turned(s, c));
        let along = a_bar.dot(omega);
        let mut slide = a_bar.cross(domega).z + omega.z.mul_sub(along, a_bar.z * omega.dot(omega));
        let omega_bar = omega_bar + centripetal(a_bar, omega, arm);
        let domega_bar = domega_bar + arm.cross(a_bar);
        for i in (0..j).filter(|&i| robot.carries(i, j)) {
            let (axis, seen) = (self.axes_bar[j][i], self.axes[j][i]);
            turn += turned_by(axis.u, seen.u) + turned_by(axis.w, seen.w);
            let w_bar = axis.w.out_of_turned(s, c);
            let u_bar = axis.u.out_of_turned(s, c) + arm.cross(w_bar);
            if !revolute {
                slide += w_bar.cross(seen.u.out_of_turned(s, c)).z;
            }
            if let Some(parent) = parent {
                let before = &mut self.axes_bar[parent][i];
                before.u = before.u + out_of_placed(u_bar, placement);
                before.w = before.w + out_of_placed(w_bar, placement);
            }
        }
        found.q[j] = if revolute { turn } else { slide };
        Motion {
            omega: out_of_placed(omega_bar, placement),
            domega: out_of_placed(domega_bar, placement),
            a: out_of_placed(a_bar, placement),
        }
    }
}

impl<V: Set> Vector<V> {
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        Self::new(self.x.scale(factor), self.y.scale(factor), self.z.scale(factor))
    }

    #[inline(always)]
    fn by(self, factor: Lanes<V>) -> Self {
        Self::new(self.x * factor, self.y * factor, self.z * factor)
    }
}

/// Derivative along the angle of a vector seen from a frame that turns about z.
#[inline(always)]
fn turned_by<V: Set>(bar: Vector<V>, v: Vector<V>) -> Lanes<V> {
    bar.x.mul_sub(v.y, bar.y * v.x)
}

/// Derivative of `w . (omega x (omega x h))` with respect to `omega`.
#[inline(always)]
fn centripetal<V: Set>(w: Vector<V>, omega: Vector<V>, h: Vector<V>) -> Vector<V> {
    let (oh, ow, wh) = (omega.dot(h), omega.dot(w), w.dot(h));
    (w.by(oh) + h.by(ow)) - omega.by(wh + wh)
}

/// The wrench of a body with the ten parameters `x` along an axis: adds its derivatives.
#[inline(always)]
fn body<V: Set>(
    x: &[Lanes<V>; INERTIAL],
    motion: &Motion<V>,
    axis: &Axis<V>,
    bar: &mut Motion<V>,
    axis_bar: &mut Axis<V>,
) {
    let [xx, xy, xz, yy, yz, zz, hx, hy, hz, m] = *x;
    let inertia = |v: Vector<V>| {
        Vector::new(
            xz.mul_add(v.z, xy.mul_add(v.y, xx * v.x)),
            yz.mul_add(v.z, yy.mul_add(v.y, xy * v.x)),
            zz.mul_add(v.z, yz.mul_add(v.y, xz * v.x)),
        )
    };
    let h = Vector::new(hx, hy, hz);
    let Motion { omega, domega, a } = *motion;
    let Axis { u, w } = *axis;
    let momentum = inertia(omega);
    axis_bar.u = axis_bar.u + (inertia(domega) + (omega.cross(momentum) + h.cross(a)));
    axis_bar.w = axis_bar.w + (domega.cross(h) + (omega.cross(omega.cross(h)) + a.by(m)));
    bar.domega = bar.domega + (inertia(u) + h.cross(w));
    bar.omega = bar.omega + ((momentum.cross(u) + inertia(u.cross(omega))) + centripetal(w, omega, h));
    bar.a = bar.a + (u.cross(h) + w.by(m));
}
