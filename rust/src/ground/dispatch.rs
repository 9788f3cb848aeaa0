//! A kernel is compiled for the instruction sets that matter, and one of them is chosen at run time (`isa.rs`).
//!
//! Every function that a kernel calls on its hot path is `#[inline(always)]`, or it would be compiled for the oldest processor.

// That a processor has AVX2 and FMA, or AVX-512, is known at run time; the compiler cannot see it.
#![allow(unsafe_code)]

use super::arrays::MAX_DOF;
use super::isa::Isa;
#[cfg(target_arch = "x86_64")]
use super::sets::{Avx2, Avx512};
use super::sets::{Fused, Plain, Set};

/// A computation that can run on any number of lanes.
pub trait Kernel: Sized {
    /// Result of the computation.
    type Output;

    /// Runs on the lanes of a set. Implementations are `#[inline(always)]`.
    fn run<V: Set>(self) -> Self::Output;

    /// The same, compiled for processors with AVX2 and FMA.
    ///
    /// A method of the kernel, not a function of this module: the compiler puts it beside the kernel's type, so that the kernels of
    /// different modules are compiled side by side, and only those that have changed.
    ///
    /// # Safety
    ///
    /// The processor must have AVX2 and FMA, as [`Isa::chosen`] has found out.
    #[cfg(target_arch = "x86_64")]
    #[doc(hidden)]
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt,f16c,movbe")]
    unsafe fn run_on_vectors<V: Set>(self) -> Self::Output {
        self.run::<V>()
    }

    /// The same, compiled for processors with AVX-512.
    ///
    /// # Safety
    ///
    /// The processor must have AVX-512, likewise.
    #[cfg(target_arch = "x86_64")]
    #[doc(hidden)]
    #[target_feature(
        enable = "avx512f,avx512vl,avx512dq,avx512bw,avx512cd,avx2,fma,bmi1,bmi2,lzcnt,popcnt,f16c,movbe"
    )]
    unsafe fn run_on_wide_vectors(self) -> Self::Output {
        self.run::<Avx512>()
    }

    /// The same for any processor.
    #[doc(hidden)]
    #[inline(never)]
    fn run_anywhere(self) -> Self::Output {
        self.run::<Plain<1>>()
    }
}

/// Number of lanes that fill the vector registers of most processors.
pub const WIDTH: usize = 4;
/// Largest number of lanes.
pub const WIDEST: usize = 8;

const _: () = assert!(MAX_DOF.is_multiple_of(WIDTH), "joints are taken side by side in whole registers");

/// Lanes of [`dispatch_widest`] on this processor.
pub fn widest() -> usize {
    if Isa::chosen() == Isa::Avx512 { WIDEST } else { WIDTH }
}

/// Runs a kernel on [`WIDTH`] lanes with the instruction set that is chosen, or on one lane where there is none: without vector
/// registers lanes gain nothing, and would take long to compile.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if Isa::chosen() >= Isa::Avx2 {
        // SAFETY: a set is chosen only where the processor has it.
        return unsafe { kernel.run_on_vectors::<Avx2>() };
    }
    #[cfg(target_arch = "aarch64")]
    return kernel.run::<Fused<WIDTH>>();
    #[cfg(not(target_arch = "aarch64"))]
    kernel.run_anywhere()
}

/// The same on [`widest`] lanes. Where that is eight the kernel is compiled once more, so it is for the few that gain by it.
pub fn dispatch_widest<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if Isa::chosen() == Isa::Avx512 {
        // SAFETY: a set is chosen only where the processor has it.
        return unsafe { kernel.run_on_wide_vectors() };
    }
    dispatch(kernel)
}

/// The same on a single lane.
pub fn dispatch_single<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if Isa::chosen() >= Isa::Avx2 {
        // SAFETY: a set is chosen only where the processor has it.
        return unsafe { kernel.run_on_vectors::<Fused<1>>() };
    }
    #[cfg(target_arch = "aarch64")]
    return kernel.run::<Fused<1>>();
    #[cfg(not(target_arch = "aarch64"))]
    kernel.run_anywhere()
}

/// Runs a kernel on a set, whichever is chosen.
///
/// # Panics
///
/// Where the processor does not have it.
#[cfg(test)]
pub(crate) fn run_on<K: Kernel>(isa: Isa, kernel: K) -> K::Output {
    assert!(isa <= Isa::widest());
    match isa {
        // SAFETY: the processor has the set.
        #[cfg(target_arch = "x86_64")]
        Isa::Avx512 => unsafe { kernel.run_on_wide_vectors() },
        // SAFETY: likewise.
        #[cfg(target_arch = "x86_64")]
        Isa::Avx2 => unsafe { kernel.run_on_vectors::<Avx2>() },
        _ => kernel.run_anywhere(),
    }
}
