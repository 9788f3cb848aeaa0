//! Where a joint stands: its parent, and the fixed pose of its frame there.
//!
//! Khalil and Kleinfinger's rows for trees: frame `j` follows the frame of its antecedent `a(j)` by
//! `Trans(shift) Rot(z, gamma) Trans(z, b) Rot(x, alpha) Trans(x, d) Rot(z, theta) Trans(z, r)`. A chain has `gamma = b = 0` and no
//! shift. Any pose has such a row with `b = d = r = 0`: the angles are then Euler's (z, x, z), and `shift` is the translation.

use super::description::{Joint, RobotError};
use super::twist::Twist;

/// The part of a joint's row that chains do without.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mount {
    /// The antecedent (from 0), or the base.
    pub parent: Option<usize>,
    /// Angle about `z` of the antecedent (rad) by which its `x` axis turns to the common normal.
    pub gamma: f64,
    /// Distance along `z` of the antecedent (m) from its origin to the common normal.
    pub b: f64,
    /// Displacement in the frame of the antecedent (m), of a pose that is given as it is.
    pub shift: [f64; 3],
}

impl Mount {
    /// On the frame of a parent as it is.
    pub fn on(parent: Option<usize>) -> Self {
        Self { parent, gamma: 0.0, b: 0.0, shift: [0.0; 3] }
    }

    /// The mounts of `n` joints in a line.
    pub fn chain(n: usize) -> Vec<Self> {
        (0..n).map(|j| Self::on(j.checked_sub(1))).collect()
    }
}

/// The pose of a joint's frame in its parent's at `q = 0`, ready for the kernels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    /// `alpha`.
    pub twist: Twist,
    /// Cosine and sine of `gamma`, where it is not zero.
    pub gamma: Option<(f64, f64)>,
    /// Origin in the parent's frame (m).
    pub shift: [f64; 3],
    /// Origin in the parent's frame after `gamma` and the twist (m), less what slides.
    pub arm: [f64; 3],
    /// The joint's `z` in the parent's frame.
    pub axis: [f64; 3],
}

impl Placement {
    pub(super) fn of(joint: &Joint, mount: &Mount) -> Self {
        let twist = Twist::new(joint.alpha);
        let (c, s) = twist.cos_sin();
        let [x, y, z] = mount.shift;
        let along = [joint.d, -joint.r * s, joint.r * c + mount.b];
        let (gamma, shift, axis, before) = match Twist::new(mount.gamma) {
            Twist::Zero => {
                let shift = [along[0] + x, along[1] + y, along[2] + z];
                (None, shift, [0.0, -s, c], [x, y, z + mount.b])
            }
            turned => {
                let (cg, sg) = turned.cos_sin();
                let turn = |v: [f64; 3]| [cg * v[0] - sg * v[1], sg * v[0] + cg * v[1], v[2]];
                let [u, v, w] = turn(along);
                let before = [cg * x + sg * y, cg * y - sg * x, z + mount.b];
                (Some((cg, sg)), [u + x, v + y, w + z], turn([0.0, -s, c]), before)
            }
        };
        // (d, 0, r), and what stands before the twist.
        let twisted = [before[0], c * before[1] + s * before[2], c * before[2] - s * before[1]];
        Self { twist, gamma, shift, arm: [twisted[0] + joint.d, twisted[1], twisted[2] + joint.r], axis }
    }
}

/// Which joints a joint carries: with parents before children and branch by branch, the joints from itself to before `end`.
///
/// # Errors
///
/// For a parent that does not come before its child, and for joints that are not numbered branch by branch.
pub(super) fn ends(mounts: &[Mount]) -> Result<Vec<usize>, RobotError> {
    let mut ends: Vec<usize> = (1..=mounts.len()).collect();
    for (j, mount) in mounts.iter().enumerate() {
        let numbers = [mount.gamma, mount.b, mount.shift[0], mount.shift[1], mount.shift[2]];
        if numbers.iter().any(|number| !number.is_finite()) {
            return Err(RobotError::NotFinite { what: "the placement", joint: j + 1 });
        }
        let Some(parent) = mount.parent else { continue };
        if parent >= j {
            return Err(RobotError::ParentAfter { joint: j + 1, parent: parent + 1 });
        }
        if ends[parent] != j {
            return Err(RobotError::Scattered { joint: j + 1, parent: parent + 1 });
        }
        let mut carrier = Some(parent);
        while let Some(k) = carrier {
            ends[k] = j + 1;
            carrier = mounts[k].parent;
        }
    }
    Ok(ends)
}
