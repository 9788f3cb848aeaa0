//! A kernel is compiled for the instruction sets that matter, and one of them is chosen at run time.
//!
//! Every function that a kernel calls on its hot path is `#[inline(always)]`, or it would be compiled for the oldest processor.

use super::arrays::MAX_DOF;

/// A computation that can run on any number of lanes.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Runs on `L` lanes. Implementations are `#[inline(always)]`.
    fn run<const L: usize, const FUSED: bool>(self) -> Self::Output;
}

/// Lanes that fill the vector registers of most processors without spilling them.
pub const WIDTH: usize = 4;

const _: () = assert!(MAX_DOF.is_multiple_of(WIDTH), "joints are taken side by side in whole registers");

struct Vectorised<K, const L: usize, const FUSED: bool>(K);

impl<K: Kernel, const L: usize, const FUSED: bool> pulp::NullaryFnOnce for Vectorised<K, L, FUSED> {
    type Output = K::Output;
    #[inline(always)]
    fn call(self) -> K::Output {
        self.0.run::<L, FUSED>()
    }
}

/// Runs a kernel on `L` lanes with the best instruction set of this processor, or on one lane where there is none: without vector
/// registers lanes gain nothing, and would take long to compile.
pub fn dispatch_on<const L: usize, K: Kernel>(kernel: K) -> K::Output {
    // Asked for by name: `pulp::Arch` would become another one with any dependency that turns on `pulp/x86-v4`.
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        return simd.vectorize(Vectorised::<K, L, true>(kernel));
    }
    #[cfg(target_arch = "aarch64")]
    return kernel.run::<L, true>();
    #[cfg(not(target_arch = "aarch64"))]
    kernel.run::<1, false>()
}

/// Runs a kernel on [`WIDTH`] lanes.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    dispatch_on::<WIDTH, K>(kernel)
}
