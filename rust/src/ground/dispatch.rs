//! A kernel is compiled for the instruction sets that matter, and one of them is chosen at run time.
//!
//! Every function that a kernel calls on its hot path is `#[inline(always)]`, or it would be compiled for the oldest processor.

// That a processor has AVX2 and FMA is known at run time; the compiler cannot see it.
#![allow(unsafe_code)]

use super::arrays::MAX_DOF;

/// A computation that can run on any number of lanes.
pub trait Kernel: Sized {
    /// Result of the computation.
    type Output;

    /// Runs on `L` lanes. Implementations are `#[inline(always)]`.
    fn run<const L: usize, const FUSED: bool>(self) -> Self::Output;

    /// The same, compiled for processors with AVX2 and FMA.
    ///
    /// A method of the kernel, not a function of this module: the compiler puts it beside the kernel's type, so that the kernels of
    /// different modules are compiled side by side, and only those that have changed.
    ///
    /// # Safety
    ///
    /// The processor must have AVX2 and FMA, as [`dispatch_on`] has found out.
    #[cfg(target_arch = "x86_64")]
    #[doc(hidden)]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,f16c,movbe")]
    unsafe fn run_on_vectors<const L: usize>(self) -> Self::Output {
        self.run::<L, true>()
    }

    /// The same for any processor.
    #[doc(hidden)]
    #[inline(never)]
    fn run_anywhere(self) -> Self::Output {
        self.run::<1, false>()
    }
}

/// Lanes that fill the vector registers of most processors without spilling them.
pub const WIDTH: usize = 4;

const _: () = assert!(MAX_DOF.is_multiple_of(WIDTH), "joints are taken side by side in whole registers");

/// Runs a kernel on `L` lanes with the best instruction set of this processor, or on one lane where there is none: without vector
/// registers lanes gain nothing, and would take long to compile.
pub fn dispatch_on<const L: usize, K: Kernel>(kernel: K) -> K::Output {
    // Asked for by name: `pulp::Arch` would become another one with any dependency that turns on `pulp/x86-v4`.
    #[cfg(target_arch = "x86_64")]
    if pulp::x86::V3::try_new().is_some() {
        // SAFETY: V3 is AVX2, FMA and what came before them.
        return unsafe { kernel.run_on_vectors::<L>() };
    }
    #[cfg(target_arch = "aarch64")]
    return kernel.run::<L, true>();
    #[cfg(not(target_arch = "aarch64"))]
    kernel.run_anywhere()
}

/// Runs a kernel on [`WIDTH`] lanes.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    dispatch_on::<WIDTH, K>(kernel)
}
