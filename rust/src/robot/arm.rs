//! Geometry that a kernel knows when it is compiled: none, or the zeros of a common arm.
//!
//! A kernel for any robot goes through the joints in a loop and asks at each what it has to do. For the shapes at the end of this
//! file it is compiled once more from the same source, joint by joint, with the answers written in: without counters and branches, and
//! unused terms are not compiled. Numbers such as lengths are read from the robot in both. An evaluation of four lanes takes
//! 2589 instead of 4011 instructions (callgrind); `rust/tests/closed_loop/shapes.rs` tests that the results are the same to the bit.

use crate::ground::arrays::MAX_DOF;
use std::fmt::Debug;
use std::ops::IndexMut;

/// Code of `alpha = 0`.
pub const ZERO: u8 = 0;
/// Code of `alpha = pi/2`.
pub const PLUS: u8 = 1;
/// Code of `alpha = -pi/2`.
pub const MINUS: u8 = 2;
/// Code of any other `alpha`.
pub const GENERAL: u8 = 3;
/// Code of an `alpha` that is only known at run time.
pub const UNKNOWN: u8 = 4;

/// Code of a step after which only the moment of a wrench has an effect.
pub const MOMENTS: u8 = 0;
/// Code of a step with a rotation and equal origins.
pub const TURNED: u8 = 1;
/// Code of a step with a rotation and a displaced origin.
pub const DISPLACED: u8 = 2;

/// Number of joints of the arms with specialised kernels.
pub const SIX: usize = 6;

/// The form of a step from one frame to the next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent facts on a joint, each a constant of a kernel"
)]
pub struct StepForm {
    /// Does the joint turn (or slide)?
    pub turns: bool,
    /// [`ZERO`], [`PLUS`], [`MINUS`] or [`GENERAL`].
    pub twist: u8,
    /// Which components of the displacement `t` can be other than zero.
    pub shifted: [bool; 3],
    /// Transformation of a wrench on its way inwards: [`MOMENTS`], [`TURNED`] or [`DISPLACED`].
    pub carries: u8,
    /// Does something slide here or further out? Only then what the joint carries has a mass after regrouping.
    pub heavy: bool,
    /// Does the joint before turn, and has nothing been added yet to its link, which then is regrouped?
    pub follows_turning: bool,
    /// Does the joint stand on the base?
    pub root: bool,
    /// Does it stand on another joint than the one numbered before it?
    pub branches: bool,
    /// Does it carry no other joint?
    pub leaf: bool,
    /// Does a joint with a higher number stand on the same link?
    pub joins: bool,
    /// Is `gamma` other than zero? Only with a [`GENERAL`] twist.
    pub bent: bool,
}

/// The parent of a joint that stands on the base, in a table of parents.
pub const BASE: usize = usize::MAX;

impl StepForm {
    /// No step at all.
    pub const STILL: Self = Self {
        turns: true,
        twist: ZERO,
        shifted: [false; 3],
        carries: MOMENTS,
        heavy: false,
        follows_turning: true,
        root: false,
        branches: false,
        leaf: false,
        joins: false,
        bent: false,
    };

    /// Form of a step by itself; [`complete`] adds the properties that depend on the other steps.
    pub const fn of(turns: bool, twist: u8, shifted: [bool; 3]) -> Self {
        Self { turns, twist, shifted, ..Self::STILL }
    }

    const fn displaced(self) -> bool {
        self.shifted[0] || self.shifted[1] || self.shifted[2]
    }
}

/// The forms of `n` steps on the frames of their parents, with what follows from their neighbours.
pub const fn complete<const N: usize>(
    mut forms: [StepForm; N],
    parents: &[usize; N],
    n: usize,
) -> [StepForm; N] {
    // A force matters where it has a lever arm further in, or slides a joint.
    let mut force_matters = [false; N];
    let mut j = 0;
    while j < n {
        let parent = parents[j];
        forms[j].root = parent == BASE;
        forms[j].branches = j > 0 && parent != j - 1;
        if parent == BASE {
            force_matters[j] = !forms[j].turns;
        } else {
            forms[j].carries = if forms[j].displaced() {
                DISPLACED
            } else if force_matters[parent] {
                TURNED
            } else {
                MOMENTS
            };
            force_matters[j] = force_matters[parent] || forms[j].displaced() || !forms[j].turns;
            forms[j].follows_turning = forms[parent].turns;
        }
        j += 1;
    }
    let mut carries = [false; N];
    while j > 0 {
        j -= 1;
        let parent = parents[j];
        forms[j].leaf = !carries[j];
        forms[j].heavy = forms[j].heavy || !forms[j].turns;
        if parent != BASE {
            forms[j].joins = carries[parent];
            forms[j].follows_turning = forms[j].follows_turning && !carries[parent];
            carries[parent] = true;
            forms[parent].heavy = forms[parent].heavy || forms[j].heavy;
        }
    }
    forms
}

/// Geometry of a robot that is known when a kernel is compiled.
pub trait Arm: Copy {
    /// The forms of its steps, [`complete`]; None if they are known only at run time.
    const FORMS: Option<[StepForm; SIX]>;
    /// Are they known?
    const KNOWN: bool = Self::FORMS.is_some();
    /// A matrix of its joints.
    type Square<T: Copy + Debug>: Square<T>;
}

/// A square matrix, row by row; of a symmetric one only entries with `row >= column` are used.
pub trait Square<T>: Clone + Debug + IndexMut<usize, Output = Self::Row> + AsRef<[Self::Row]> {
    /// A row.
    type Row: IndexMut<usize, Output = T>;
    /// Of `n` rows, the same in all entries.
    fn filled(value: T, n: usize) -> Self;
}

/// Of the arms with specialised kernels: without an allocation, and without a look at the number of rows.
impl<T: Copy + Debug> Square<T> for [[T; SIX]; SIX] {
    type Row = [T; SIX];
    #[inline(always)]
    fn filled(value: T, _: usize) -> Self {
        [[value; SIX]; SIX]
    }
}

/// Of any robot: as arrays those of the largest ones would fill the stack of a thread.
impl<T: Copy + Debug> Square<T> for Vec<[T; MAX_DOF]> {
    type Row = [T; MAX_DOF];
    #[inline(always)]
    fn filled(value: T, n: usize) -> Self {
        vec![[value; MAX_DOF]; n]
    }
}

/// Any robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Any;

impl Arm for Any {
    const FORMS: Option<[StepForm; SIX]> = None;
    type Square<T: Copy + Debug> = Vec<[T; MAX_DOF]>;
}

/// A joint of a kernel: where it is, and what of it is known when the kernel is compiled.
pub trait Place: Copy {
    /// The form of its step, where it is known.
    const FORM: Option<StepForm>;
    /// Its index where that is known, otherwise zero.
    const INDEX: usize;
    /// Its index.
    fn index(self) -> usize;
}

/// A joint of any robot.
#[derive(Debug, Clone, Copy)]
pub struct At(pub usize);

impl Place for At {
    const FORM: Option<StepForm> = None;
    const INDEX: usize = 0;
    #[inline(always)]
    fn index(self) -> usize {
        self.0.min(MAX_DOF - 1)
    }
}

/// Joint `J` of a robot of known shape.
#[derive(Debug, Clone, Copy)]
pub struct Known<S, const J: usize>(std::marker::PhantomData<S>);

impl<S, const J: usize> Known<S, J> {
    /// Without a robot.
    pub const HERE: Self = Self(std::marker::PhantomData);
}

impl<S: Arm, const J: usize> Place for Known<S, J> {
    const FORM: Option<StepForm> = match S::FORMS {
        Some(forms) => Some(forms[J]),
        None => None,
    };
    const INDEX: usize = J;
    #[inline(always)]
    fn index(self) -> usize {
        J
    }
}

/// The twist of a place, as far as it is known.
pub const fn twist_of<P: Place>() -> u8 {
    match P::FORM {
        Some(form) => form.twist,
        None => UNKNOWN,
    }
}

/// Transformation of a wrench at a place, or [`UNKNOWN`].
pub const fn carries_of<P: Place>() -> u8 {
    match P::FORM {
        Some(form) => form.carries,
        None => UNKNOWN,
    }
}

/// Elbow arms as the TX40: an upper arm and a forearm, offset at the elbow, and three axes through the wrist.
#[derive(Debug, Clone, Copy)]
pub struct Elbow;

impl Arm for Elbow {
    const FORMS: Option<[StepForm; SIX]> = Some(complete(
        [
            StepForm::of(true, ZERO, [false; 3]),
            StepForm::of(true, MINUS, [false; 3]),
            StepForm::of(true, ZERO, [true, false, true]),
            StepForm::of(true, PLUS, [false, true, false]),
            StepForm::of(true, MINUS, [false; 3]),
            StepForm::of(true, PLUS, [false; 3]),
        ],
        &[BASE, 0, 1, 2, 3, 4],
        SIX,
    ));
    type Square<T: Copy + Debug> = [[T; SIX]; SIX];
}

/// Runs `$body` with the constant `$t` for the twist of `$step`: each kind is compiled by itself, or only the known one.
macro_rules! by_twist {
    ($step:expr, $t:ident => $body:expr) => {
        by_twist!(@any $step, $t => $body)
    };
    ($place:ty, $step:expr, $t:ident => $body:expr) => {
        match const { $crate::robot::arm::twist_of::<$place>() } {
            $crate::robot::arm::ZERO => by_twist!(@one ZERO $t => $body),
            $crate::robot::arm::PLUS => by_twist!(@one PLUS $t => $body),
            $crate::robot::arm::MINUS => by_twist!(@one MINUS $t => $body),
            $crate::robot::arm::GENERAL => by_twist!(@one GENERAL $t => $body),
            _ => by_twist!(@any $step, $t => $body),
        }
    };
    (@any $step:expr, $t:ident => $body:expr) => {
        match $step.form.twist {
            $crate::robot::arm::ZERO => by_twist!(@one ZERO $t => $body),
            $crate::robot::arm::PLUS => by_twist!(@one PLUS $t => $body),
            $crate::robot::arm::MINUS => by_twist!(@one MINUS $t => $body),
            _ => by_twist!(@one GENERAL $t => $body),
        }
    };
    (@one $kind:ident $t:ident => $body:expr) => {{
        const $t: u8 = $crate::robot::arm::$kind;
        $body
    }};
}

/// Runs `$body` for every joint from the first to the last; `$place` is its [`Place`].
macro_rules! outwards {
    ($shape:ty, $n:expr, $place:ident => $body:expr) => {
        if const { <$shape as $crate::robot::arm::Arm>::KNOWN } {
            outwards!(@known $shape, $place $body, 0 1 2 3 4 5);
        } else {
            for j in 0..$n {
                let $place = $crate::robot::arm::At(j);
                $body;
            }
        }
    };
    (@known $shape:ty, $place:ident $body:expr, $($j:literal)*) => {
        $({
            let $place = $crate::robot::arm::Known::<$shape, $j>::HERE;
            $body;
        })*
    };
}

/// The same from the last joint to the first.
macro_rules! inwards {
    ($shape:ty, $n:expr, $place:ident => $body:expr) => {
        if const { <$shape as $crate::robot::arm::Arm>::KNOWN } {
            $crate::robot::arm::outwards!(@known $shape, $place $body, 5 4 3 2 1 0);
        } else {
            for j in (0..$n).rev() {
                let $place = $crate::robot::arm::At(j);
                $body;
            }
        }
    };
}

/// The same statement for several constants.
macro_rules! unrolled {
    ($k:ident in $($value:literal)* => $body:expr) => {
        $({
            const $k: usize = $value;
            $body
        })*
    };
}

/// The same short statement for joints `0` to `n - 1`, written out for the usual six: counters and addresses are a third of what such a
/// loop executes.
macro_rules! for_joints {
    ($j:ident in $n:expr => $body:expr) => {
        if $n == 6 {
            for_joints!(@one $j 0 $body);
            for_joints!(@one $j 1 $body);
            for_joints!(@one $j 2 $body);
            for_joints!(@one $j 3 $body);
            for_joints!(@one $j 4 $body);
            for_joints!(@one $j 5 $body);
        } else {
            for $j in 0..$n {
                $body;
            }
        }
    };
    (@one $j:ident $value:literal $body:expr) => {{
        let $j: usize = $value;
        $body;
    }};
}

pub(crate) use {by_twist, for_joints, inwards, outwards, unrolled};
