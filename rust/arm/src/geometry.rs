//! Shapes at rest and in motion.

use std::f64::consts::PI;

use crate::parameters::ArmParameters;
use crate::state::ArmState;

/// Volume of a circular truncated cone, `π h / 3 (R_b² + R_b R_t + R_t²)` \[m³\].
#[must_use]
pub fn frustum_volume(floor_radius: f64, ceiling_radius: f64, height: f64) -> f64 {
    PI / 3.0
        * height
        * (floor_radius * floor_radius
            + floor_radius * ceiling_radius
            + ceiling_radius * ceiling_radius)
}

/// Volume of every compartment \[m³\], from the mean radii of its floor and ceiling.
#[must_use]
pub fn volumes(parameters: &ArmParameters, state: &ArmState) -> Vec<f64> {
    let mut floor = parameters.base_radius;
    state
        .coordinates
        .iter()
        .map(|q| {
            let ceiling = (q[3] + q[4] + q[5] + q[6]) / 4.0;
            let volume = frustum_volume(floor, ceiling, q[0]);
            floor = ceiling;
            volume
        })
        .collect()
}
