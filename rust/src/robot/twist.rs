//! `alpha` of a joint, with right angles exact.

use std::f64::consts::FRAC_PI_2;

/// Largest distance (rad) from a multiple of 90 degrees at which an angle counts as that multiple.
const RIGHT_ANGLE_TOLERANCE: f64 = 1e-12;

/// `alpha` as the kernels see it: right angles need no multiplication.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Twist {
    /// `alpha = 0`.
    Zero,
    /// `alpha = pi`.
    Half,
    /// `alpha = pi/2`.
    Plus,
    /// `alpha = -pi/2`.
    Minus,
    /// Any other angle: its cosine and sine.
    General(f64, f64),
}

impl Twist {
    pub(super) fn new(alpha: f64) -> Self {
        let quarter = (alpha / FRAC_PI_2).round();
        if (alpha - quarter * FRAC_PI_2).abs() > RIGHT_ANGLE_TOLERANCE {
            return Self::General(alpha.cos(), alpha.sin());
        }
        #[allow(clippy::cast_possible_truncation)]
        match (quarter as i64).rem_euclid(4) {
            0 => Self::Zero,
            1 => Self::Plus,
            2 => Self::Half,
            _ => Self::Minus,
        }
    }

    /// Cosine and sine, exact at right angles.
    pub fn cos_sin(self) -> (f64, f64) {
        match self {
            Self::Zero => (1.0, 0.0),
            Self::Half => (-1.0, 0.0),
            Self::Plus => (0.0, 1.0),
            Self::Minus => (0.0, -1.0),
            Self::General(c, s) => (c, s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn right_angles_are_exact() {
        assert_eq!(Twist::new(-FRAC_PI_2), Twist::Minus);
        assert_eq!(Twist::new(3.0 * FRAC_PI_2), Twist::Minus);
        assert_eq!(Twist::new(std::f64::consts::PI), Twist::Half);
        assert!(matches!(Twist::new(0.3), Twist::General(..)));
    }
}
