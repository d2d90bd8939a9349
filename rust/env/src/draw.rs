//! Numbers and choices from a generator.

use rand_core::Rng;
use rand_pcg::Pcg64;

/// A number in \[0, 1), uniform.
pub fn share(generator: &mut Pcg64) -> f64 {
    (generator.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// One of so many, uniform to 2⁻⁶⁴ times their number.
pub(crate) fn choose(generator: &mut Pcg64, count: usize) -> usize {
    // The high half of a 128-bit product.
    ((u128::from(generator.next_u64()) * count as u128) >> 64) as usize
}
