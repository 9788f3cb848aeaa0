//! Which instruction set kernels are compiled for, chosen when a program runs: the widest that the processor has, or another by request.

use std::sync::atomic::{AtomicU8, Ordering};
use thiserror::Error;

/// Sets of instructions that kernels are compiled for, from the narrowest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Isa {
    /// What every processor of its kind has: one number at a time and, on x86-64, multiplications and additions that round one by one.
    Portable = 1,
    /// Four lanes with fused multiplications: AVX2 and FMA on x86-64.
    Avx2 = 2,
    /// Eight lanes where they pay: AVX-512 (F, VL, DQ, BW and CD).
    Avx512 = 3,
}

/// A set that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum IsaError {
    /// No set is called so.
    #[error("must be auto, portable, avx2 or avx512, got {got:?}")]
    Unknown {
        /// What was asked for.
        got: String,
    },
    /// The processor does not have it.
    #[error("asks for {asked}, and this processor has no more than {has}")]
    Missing {
        /// What was asked for.
        asked: &'static str,
        /// The widest there is.
        has: &'static str,
    },
}

impl Isa {
    /// All, from the narrowest.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Portable => "portable",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// The widest set of this processor.
    #[cfg(target_arch = "x86_64")]
    pub fn widest() -> Self {
        use std::arch::is_x86_feature_detected as has;
        let avx512 =
            has!("avx512f") && has!("avx512vl") && has!("avx512dq") && has!("avx512bw") && has!("avx512cd");
        match pulp::x86::V3::try_new() {
            Some(_) if avx512 => Self::Avx512,
            Some(_) => Self::Avx2,
            None => Self::Portable,
        }
    }

    /// The widest set of this processor.
    #[cfg(not(target_arch = "x86_64"))]
    pub fn widest() -> Self {
        Self::Portable
    }

    /// The sets of this processor, from the narrowest.
    pub fn available() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|&isa| isa <= Self::widest())
    }

    /// The set that kernels run on.
    #[inline]
    pub fn chosen() -> Self {
        match CHOSEN.load(Ordering::Relaxed) {
            1 => Self::Portable,
            2 => Self::Avx2,
            3 => Self::Avx512,
            _ => {
                let widest = Self::widest();
                CHOSEN.store(widest as u8, Ordering::Relaxed);
                widest
            }
        }
    }
}

/// Chosen instruction set, 0 before the first use. What is stored never names a set that the processor lacks.
static CHOSEN: AtomicU8 = AtomicU8::new(0);

/// Lets all kernels that start from now on run on a set, by its name; `auto` is the widest there is.
pub fn choose(name: &str) -> Result<Isa, IsaError> {
    let widest = Isa::widest();
    let isa = match name {
        "auto" => widest,
        _ => Isa::ALL
            .into_iter()
            .find(|isa| isa.name() == name)
            .ok_or_else(|| IsaError::Unknown { got: name.to_owned() })?,
    };
    if isa > widest {
        return Err(IsaError::Missing { asked: isa.name(), has: widest.name() });
    }
    CHOSEN.store(isa as u8, Ordering::Relaxed);
    Ok(isa)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_chosen_by_name_and_only_where_they_exist() {
        assert_eq!(choose("auto"), Ok(Isa::widest()));
        assert_eq!(Isa::chosen(), Isa::widest());
        let error = choose("sse9").unwrap_err();
        assert_eq!(error.to_string(), "must be auto, portable, avx2 or avx512, got \"sse9\"");
        for isa in Isa::ALL {
            if isa > Isa::widest() {
                assert_eq!(
                    choose(isa.name()).unwrap_err(),
                    IsaError::Missing { asked: isa.name(), has: Isa::widest().name() }
                );
            }
        }
        assert_eq!(Isa::available().last(), Some(Isa::widest()));
    }
}
