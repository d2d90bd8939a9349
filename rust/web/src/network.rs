//! A trained network as the page loads it: normalisation, layers, and how its action is meant.

use nalgebra::{DMatrix, DVector};
use octoarm_arm::{ParameterError, read_json};
use serde::Deserialize;

/// How the arrays that follow are to be read; `rust/web/page/agents.py` writes it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    /// Numbers that enter each layer, and at the end the entries of an action.
    sizes: Vec<usize>,
    /// Limit of a normalised length.
    clip: f64,
    /// Physics steps from one action to the next.
    steps: u32,
    /// Base angle of an action of 1 \[degrees\].
    action_range: f64,
    /// Name and amplitude \[degrees\] of the cycle that it was trained on.
    target: String,
    amplitude: f64,
}

/// A network of tanh layers, from spring lengths \[m\] to the base's next angles \[degrees\].
#[derive(Clone, Debug)]
pub struct Network {
    header: Header,
    mean: Vec<f64>,
    scale: Vec<f64>,
    layers: Vec<(DMatrix<f32>, DVector<f32>)>,
}

/// Takes so many bytes off the front.
fn take<'bytes>(bytes: &mut &'bytes [u8], count: usize) -> Result<&'bytes [u8], ParameterError> {
    let (taken, left) = bytes
        .split_at_checked(count)
        .ok_or_else(|| ParameterError::Format("agent: the file is incomplete".to_owned()))?;
    *bytes = left;
    Ok(taken)
}

/// Takes numbers of 32 bits off the front.
fn singles(bytes: &mut &[u8], count: usize) -> Result<Vec<f32>, ParameterError> {
    let (numbers, _) = take(bytes, count.saturating_mul(4))?.as_chunks();
    Ok(numbers.iter().map(|number| f32::from_le_bytes(*number)).collect())
}

/// Takes numbers of 64 bits off the front.
fn doubles(bytes: &mut &[u8], count: usize) -> Result<Vec<f64>, ParameterError> {
    let (numbers, _) = take(bytes, count.saturating_mul(8))?.as_chunks();
    Ok(numbers.iter().map(|number| f64::from_le_bytes(*number)).collect())
}

impl Network {
    /// A network from its file: the length of the header as 32 bits, the header in JSON, then mean and
    /// scale of the lengths in double precision, and weights and bias of every layer in single
    /// precision, little-endian, weights row by row.
    ///
    /// # Errors
    /// [`ParameterError`] for what is no such file.
    pub fn from_bytes(mut bytes: &[u8]) -> Result<Self, ParameterError> {
        let bytes = &mut bytes;
        let (length, _) = take(bytes, 4)?.as_chunks();
        let length = u32::from_le_bytes(length[0]) as usize;
        let text = std::str::from_utf8(take(bytes, length)?)
            .map_err(|error| ParameterError::Format(format!("agent: {error}")))?;
        let header: Header = read_json(text)?;
        if header.sizes.len() < 2 || header.steps == 0 {
            return Err(ParameterError::Format("agent: expected a layer and a step".to_owned()));
        }
        let springs = header.sizes[0];
        let (mean, scale) = (doubles(bytes, springs)?, doubles(bytes, springs)?);
        let mut layers = Vec::new();
        for pair in header.sizes.windows(2) {
            let (inputs, outputs) = (pair[0], pair[1]);
            let weights = singles(bytes, inputs.saturating_mul(outputs))?;
            let bias = singles(bytes, outputs)?;
            layers.push((
                DMatrix::from_row_slice(outputs, inputs, &weights),
                DVector::from_vec(bias),
            ));
        }
        if header.sizes.last() != Some(&2) || !bytes.is_empty() {
            return Err(ParameterError::Format("agent: expected two outputs, no more".to_owned()));
        }
        Ok(Self { header, mean, scale, layers })
    }

    /// Number of spring lengths that it takes.
    #[must_use]
    pub fn springs(&self) -> usize {
        self.mean.len()
    }

    /// Physics steps from one action to the next.
    #[must_use]
    pub fn steps(&self) -> u32 {
        self.header.steps
    }

    /// Name of the cycle that it was trained on.
    #[must_use]
    pub fn target(&self) -> &str {
        &self.header.target
    }

    /// Amplitude of that cycle \[degrees\].
    #[must_use]
    pub fn amplitude(&self) -> f64 {
        self.header.amplitude
    }

    /// Where the base shall be at the end of the control period \[degrees\].
    ///
    /// # Panics
    /// If there are not [`Network::springs`] lengths.
    #[must_use]
    pub fn command(&self, lengths: &[f64]) -> [f64; 2] {
        assert_eq!(lengths.len(), self.springs(), "a length for every spring");
        let clip = self.header.clip;
        let normalised = lengths
            .iter()
            .zip(self.mean.iter().zip(&self.scale))
            .map(|(length, (mean, scale))| ((length - mean) * scale).clamp(-clip, clip) as f32);
        let mut values = DVector::from_iterator(lengths.len(), normalised);
        let last = self.layers.len() - 1;
        for (index, (weights, bias)) in self.layers.iter().enumerate() {
            values = weights * values + bias;
            if index < last {
                values.apply(|value| *value = value.tanh());
            }
        }
        [values[0], values[1]]
            .map(|value| f64::from(value.clamp(-1.0, 1.0)) * self.header.action_range)
    }
}
