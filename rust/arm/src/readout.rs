//! The paper's readout.

use crate::instruction_set::{Supported, compiled_for_each_set};

/// A static linear readout of the spring lengths (Eq. 18, Eq. 26).
#[derive(Clone, Debug, PartialEq)]
pub struct LinearReadout {
    /// One row a spring.
    pub weights: Vec<[f64; 2]>,
    /// Added to the weighted sum \[degrees\].
    pub bias: [f64; 2],
}

impl LinearReadout {
    /// `weightsᵀ lengths + bias` \[degrees\].
    #[must_use]
    pub fn output(&self, lengths: &[f64]) -> [f64; 2] {
        output(Supported::detected(), self, lengths)
    }

    #[inline(always)]
    fn sum(&self, lengths: &[f64]) -> [f64; 2] {
        let mut sum = self.bias;
        for (weight, length) in self.weights.iter().zip(lengths) {
            sum[0] = weight[0].mul_add(*length, sum[0]);
            sum[1] = weight[1].mul_add(*length, sum[1]);
        }
        sum
    }
}

compiled_for_each_set! {
    fn output(readout: &LinearReadout, lengths: &[f64]) -> [f64; 2] {
        readout.sum(lengths)
    }
}
