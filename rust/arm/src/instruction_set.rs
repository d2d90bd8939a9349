//! The choice of vector instructions, and the proof that the processor has them.

use std::sync::OnceLock;

/// Vector instructions that a step may be compiled for. The bits are the same for all of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum InstructionSet {
    /// What every processor of the architecture has. Without fused multiply-add in hardware this is
    /// slow: the bits come first.
    Baseline,
    /// AVX2 and FMA.
    Avx2,
    /// AVX-512 (F, DQ, VL, BW) and FMA.
    Avx512,
}

impl InstructionSet {
    /// The best set of this processor, or the one that the environment variable
    /// `OCTOARM_INSTRUCTION_SET` (`baseline`, `avx2`, `avx512`) names, if the processor has it.
    #[must_use]
    pub fn detected() -> Self {
        static DETECTED: OnceLock<InstructionSet> = OnceLock::new();
        *DETECTED.get_or_init(|| {
            let best = Self::best();
            match std::env::var("OCTOARM_INSTRUCTION_SET").as_deref() {
                Ok("baseline") => Self::Baseline,
                Ok("avx2") if best != Self::Baseline => Self::Avx2,
                _ => best,
            }
        })
    }

    /// This set, or the best that the processor has if it lacks this one.
    pub(crate) fn supported(self) -> Supported {
        Supported(self.min(Self::best()))
    }

    /// The best set of this processor.
    #[must_use]
    #[cfg(target_arch = "x86_64")]
    pub fn best() -> Self {
        let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
        let avx512 = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && is_x86_feature_detected!("avx512bw");
        match (avx2, avx512) {
            (true, true) => Self::Avx512,
            (true, false) => Self::Avx2,
            _ => Self::Baseline,
        }
    }

    /// The best set of this processor.
    #[must_use]
    #[cfg(not(target_arch = "x86_64"))]
    pub fn best() -> Self {
        Self::Baseline
    }
}

/// A set that this processor has: only [`InstructionSet::supported`] makes one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Supported(InstructionSet);

impl Supported {
    /// [`InstructionSet::detected`].
    pub(crate) fn detected() -> Self {
        static DETECTED: OnceLock<Supported> = OnceLock::new();
        *DETECTED.get_or_init(|| InstructionSet::detected().supported())
    }

    pub(crate) fn get(self) -> InstructionSet {
        self.0
    }
}

/// Compiles a function of two arguments for every instruction set, and makes one of it that takes the
/// set to use as its first argument. What it calls must be `#[inline(always)]`; `[L]` stands for a
/// number of lanes that it is generic over.
macro_rules! compiled_for_each_set {
    (
        $(#[$documentation:meta])*
        $visibility:vis fn $name:ident $([$lanes:ident])?
        ($one:ident: $One:ty, $two:ident: $Two:ty) -> $Result:ty $body:block
    ) => {
        $(#[$documentation])*
        #[allow(unsafe_code)]
        $visibility fn $name $(<const $lanes: usize>)? (
            instructions: $crate::instruction_set::Supported,
            $one: $One,
            $two: $Two,
        ) -> $Result {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma,avx512f,avx512dq,avx512vl,avx512bw")]
            fn avx512 $(<const $lanes: usize>)? ($one: $One, $two: $Two) -> $Result $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2 $(<const $lanes: usize>)? ($one: $One, $two: $Two) -> $Result $body

            match instructions.get() {
                // SAFETY: a `Supported` set is one that the processor has, and its features are those
                // that the function is compiled for.
                #[cfg(target_arch = "x86_64")]
                $crate::instruction_set::InstructionSet::Avx512 => unsafe { avx512($one, $two) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::instruction_set::InstructionSet::Avx2 => unsafe { avx2($one, $two) },
                _ => $body,
            }
        }
    };
}
pub(crate) use compiled_for_each_set;
