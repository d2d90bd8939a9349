//! `a * b + c`, the kernel's most frequent operation: rounded once, or where that is asked for twice.

/// Multiply-add. It is fused, rounded once, on every target, so that results have the same bits
/// everywhere; with one exception that must be asked for. WebAssembly has no fused multiply-add, and
/// emulating it costs some fifty times the rest of a step: there, compiled with
/// `--cfg plain_multiply_add`, product and sum are rounded one after the other, which takes the spring
/// lengths less than 1e-9 m away in 1,000 steps (docs/web.md).
pub(crate) trait MultiplyAdd {
    /// `self * factor + summand`.
    fn madd(self, factor: Self, summand: Self) -> Self;
}

impl MultiplyAdd for f64 {
    #[inline(always)]
    #[allow(clippy::disallowed_methods)]
    fn madd(self, factor: Self, summand: Self) -> Self {
        if cfg!(all(target_arch = "wasm32", plain_multiply_add)) {
            self * factor + summand
        } else {
            self.mul_add(factor, summand)
        }
    }
}
