//! The paper's readout.

use crate::error::ParameterError;
use crate::instruction_set::{Supported, compiled_for_each_set};
use crate::multiply_add::MultiplyAdd;

/// A static linear readout of the spring lengths (Eq. 18, Eq. 26).
#[derive(Clone, Debug, PartialEq)]
pub struct LinearReadout {
    /// Weights of the two outputs \[degrees/m\], a row for every spring, in the order of the
    /// lengths.
    pub weights: Vec<[f64; 2]>,
    /// Bias that is added to the weighted sums \[degrees\].
    pub bias: [f64; 2],
}

impl LinearReadout {
    /// A readout of `springs` spring lengths from rows of weights, one a spring, the last one more
    /// being the bias (which is otherwise 0).
    ///
    /// # Errors
    /// [`ParameterError::Shape`] for another number of rows.
    pub fn from_rows(rows: &[[f64; 2]], springs: usize) -> Result<Self, ParameterError> {
        let (weights, bias) = match rows.len().checked_sub(springs) {
            Some(0) => (rows, [0.0; 2]),
            Some(1) => (&rows[..springs], rows[springs]),
            _ => {
                let found = format!("({}, 2)", rows.len());
                let expected =
                    format!("({springs}, 2) or ({}, 2), the last row being the bias", springs + 1);
                return Err(ParameterError::shape("weights", found, expected));
            }
        };
        Ok(Self { weights: weights.to_vec(), bias })
    }

    /// The outputs θ, φ: `weightsᵀ lengths + bias` \[degrees\]. Lengths \[m\] beyond the weights
    /// are not read.
    #[must_use]
    pub fn output(&self, lengths: &[f64]) -> [f64; 2] {
        output(Supported::detected(), self, lengths)
    }

    #[inline(always)]
    fn sum(&self, lengths: &[f64]) -> [f64; 2] {
        let mut sum = self.bias;
        for (weight, length) in self.weights.iter().zip(lengths) {
            sum[0] = weight[0].madd(*length, sum[0]);
            sum[1] = weight[1].madd(*length, sum[1]);
        }
        sum
    }
}

compiled_for_each_set! {
    fn output(readout: &LinearReadout, lengths: &[f64]) -> [f64; 2] {
        readout.sum(lengths)
    }
}
