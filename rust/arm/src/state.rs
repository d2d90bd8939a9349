//! The arm's complete dynamic state.

use serde::{Deserialize, Serialize};

use crate::error::{ParameterError, check_finite};
use crate::parameters::ArmParameters;

/// Number of coordinates of a compartment: `[h, α, β, r1, r2, r3, r4]`.
pub const COORDINATES: usize = 7;

/// Muscle inputs of a compartment's springs, `[ξ_c1..ξ_c4, δ_c1..δ_c4]` \[N\].
pub type MuscleRow = [f64; 8];

/// Everything that the next step depends on, beside parameters and the command. Restoring a saved
/// state is exact: the steps that follow have the same bits.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmState {
    /// Coordinates `[h, α, β, r1..r4]` of every compartment, base first \[m, rad, rad, m\].
    pub coordinates: Vec<[f64; COORDINATES]>,
    /// Time derivatives of the coordinates \[m/s, rad/s, rad/s, m/s\].
    pub rates: Vec<[f64; COORDINATES]>,
    /// Motion of the base, `[θ, φ, θ̇, φ̇]` \[rad, rad/s\].
    pub base: [f64; 4],
    /// Number of physics steps since the last reset.
    pub steps: u64,
    /// Muscle inputs of every compartment \[N\], base first; empty when none act.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub muscles: Vec<MuscleRow>,
}

impl ArmState {
    /// All springs at rest length, everything at rest, base at θ = φ = 0.
    #[must_use]
    pub fn undeformed(parameters: &ArmParameters) -> Self {
        let height = parameters.rest_height();
        let coordinates = (1..=parameters.compartments)
            .map(|plane| {
                let radius = parameters.rest_radius(plane);
                [height, 0.0, 0.0, radius, radius, radius, radius]
            })
            .collect();
        Self {
            coordinates,
            rates: vec![[0.0; COORDINATES]; parameters.compartments],
            base: [0.0; 4],
            steps: 0,
            muscles: Vec::new(),
        }
    }

    /// Checks that the state fits a body of `compartments` compartments and holds finite numbers.
    ///
    /// # Errors
    /// [`ParameterError::Shape`] or [`ParameterError::NotFinite`], naming the array.
    pub fn validate(&self, compartments: usize) -> Result<(), ParameterError> {
        let check = |name: &str, rows: &mut dyn Iterator<Item = &[f64]>, width: usize| {
            let mut count = 0;
            for (row, values) in rows.enumerate() {
                count += 1;
                for (column, value) in values.iter().enumerate() {
                    check_finite(*value, || format!("state.{name}[{row}, {column}]"))?;
                }
            }
            if count == compartments || (count == 0 && name == "muscles") {
                return Ok(());
            }
            let shape = |rows| format!("({rows}, {width})");
            Err(ParameterError::shape(format!("state.{name}"), shape(count), shape(compartments)))
        };
        check("coordinates", &mut self.coordinates.iter().map(<[f64; 7]>::as_slice), COORDINATES)?;
        check("rates", &mut self.rates.iter().map(<[f64; 7]>::as_slice), COORDINATES)?;
        check("muscles", &mut self.muscles.iter().map(<[f64; 8]>::as_slice), 8)?;
        for (index, value) in self.base.iter().enumerate() {
            check_finite(*value, || format!("state.base[{index}]"))?;
        }
        Ok(())
    }
}
