//! Sines and cosines of the universal joints.

use super::rows::{Block, Row, WIDTH};
use crate::transcendental::sin_cos;

/// Sines and cosines of α and β.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct Angles {
    pub(crate) sin_alpha: Row,
    pub(crate) cos_alpha: Row,
    pub(crate) sin_beta: Row,
    pub(crate) cos_beta: Row,
}

impl Angles {
    pub(crate) const ZERO: Self = Self {
        sin_alpha: [0.0; WIDTH],
        cos_alpha: [1.0; WIDTH],
        sin_beta: [0.0; WIDTH],
        cos_beta: [1.0; WIDTH],
    };
}

#[inline(always)]
pub(crate) fn angles(coordinates: &Block, out: &mut Angles) {
    for k in 0..WIDTH {
        (out.sin_alpha[k], out.cos_alpha[k]) = sin_cos(coordinates.0[1][k]);
        (out.sin_beta[k], out.cos_beta[k]) = sin_cos(coordinates.0[2][k]);
    }
}
