//! What several tests need: states and commands that look random, arms in them, and all of an arm as
//! bits.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used)]

use octoarm_arm::{Actuator, Arm, ArmParameters, ArmState, PerCompartment};

/// An arm of this body in this state.
pub fn arm_in(parameters: &ArmParameters, actuator: Actuator, state: &ArmState) -> Arm {
    let mut arm = Arm::undeformed(parameters.clone(), actuator).unwrap();
    arm.set_state(state).unwrap();
    arm
}

/// All numbers of a state, as [`octoarm_arm::Linearisation`] orders them.
pub fn numbers(state: &ArmState) -> Vec<f64> {
    let [coordinates, rates] = [&state.coordinates, &state.rates].map(|rows| rows.as_flattened());
    [coordinates, rates, &state.base].concat()
}

/// Numbers as bits: `==` would take −0 for 0.
pub fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// All that can differ of a state with these lengths, as bits.
pub fn state_bits(state: &ArmState, lengths: &[f64]) -> Vec<u64> {
    [bits(&numbers(state)), vec![state.steps], bits(lengths)].concat()
}

/// All that can differ of an arm, as bits.
pub fn arm_bits(arm: &Arm) -> Vec<u64> {
    state_bits(&arm.state(), &arm.lengths())
}

/// A linear congruential generator's next number in [−1, 1).
pub fn congruential(x: &mut u64) -> f64 {
    *x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*x >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

/// A reproducible random state. At `scale` 1 and the default shape: heights ± 2 mm, angles
/// ± 0.15 rad, radii ± 0.4 mm at the base and less towards the tip (both in proportion to the rest
/// values), rates ± 0.02 m/s and ± 1 rad/s, base angles ± 0.5 rad, base rates ± 1 rad/s.
pub fn random_state(parameters: &ArmParameters, seed: u64, scale: f64) -> ArmState {
    let mut generator = SplitMix64(seed);
    let mut around = |centre: f64, spread: f64| centre + scale * spread * generator.symmetric();
    let mut state = ArmState::undeformed(parameters);
    for (q, rate) in state.coordinates.iter_mut().zip(&mut state.rates) {
        q[0] = around(q[0], 0.1 * parameters.rest_length);
        q[1] = around(q[1], 0.15);
        q[2] = around(q[2], 0.15);
        for radius in &mut q[3..] {
            *radius = around(*radius, *radius * 0.4 / 15.0);
        }
        for (k, value) in rate.iter_mut().enumerate() {
            *value = around(0.0, if k == 1 || k == 2 { 1.0 } else { 0.02 });
        }
    }
    for (k, value) in state.base.iter_mut().enumerate() {
        *value = around(0.0, if k < 2 { 0.5 } else { 1.0 });
    }
    state
}

/// Steele, Lea and Flood's SplitMix64 generator, from its seed.
pub struct SplitMix64(pub u64);

impl SplitMix64 {
    /// Uniform in [−1, 1).
    pub fn symmetric(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }
}

/// The body with stiffness, damping and masses that differ from compartment to compartment.
pub fn uneven(parameters: &ArmParameters, seed: u64) -> ArmParameters {
    let mut x = seed.wrapping_add(11);
    let mut list = |nominal: f64, low: f64, high: f64| -> PerCompartment {
        let share = |x: &mut u64| 0.5 + 0.5 * congruential(x);
        (0..parameters.compartments)
            .map(|_| nominal * (low + (high - low) * share(&mut x)))
            .collect::<Vec<_>>()
            .into()
    };
    ArmParameters {
        longitudinal_stiffness: list(196.0, 0.6, 1.2),
        transverse_stiffness: list(1570.0, 0.6, 1.2),
        longitudinal_damping: list(1.0, 0.5, 1.1),
        transverse_damping: list(1.0, 0.5, 1.1),
        longitudinal_mass: list(1.25e-3, 1.0, 1.5),
        transverse_mass: list(1.25e-3, 1.0, 1.5),
        plane_mass: list(0.01, 0.0, 1.0),
        plane_inertia: list(1e-6, 0.0, 1.0),
        ..parameters.clone()
    }
}
