//! What the water does to the arm: it takes energy, and only from an arm that moves.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;
mod reference;

use common::{arm_in, random_state};
use octoarm_arm::{Actuator, Arm, ArmParameters, ArmState, BaseMotion, ParameterError};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use reference::{BaseSample, Reference};

/// Neither weight nor volume forces: the water's forces are drag and lift alone.
fn swimmer() -> ArmParameters {
    ArmParameters {
        arm_density: 1000.0,
        longitudinal_volume_gain: 0.0,
        transverse_volume_gain: 0.0,
        ..ArmParameters::default()
    }
}

fn dry(parameters: &ArmParameters) -> ArmParameters {
    ArmParameters { water_density: 0.0, arm_density: 0.0, ..parameters.clone() }
}

/// A swing about a still, upright base.
fn swinging(parameters: &ArmParameters, seed: u64) -> ArmState {
    let mut state = random_state(parameters, seed, 1.0);
    state.base = [0.0; 4];
    state
}

/// Power of the water's forces \[W\] in the fast kernel. The water changes the accelerations by
/// d = M⁻¹ Q, so its power u·Q is u·M d, and the kinetic energy ½ u·M u gives
/// T(u + d s) − T(u − d s) = 2 s u·M d.
fn power_from_accelerations(parameters: &ArmParameters, state: &ArmState) -> f64 {
    let still = BaseMotion::default();
    let wet = arm_in(parameters, Actuator::Direct, state).accelerations(&still);
    let dry = arm_in(&dry(parameters), Actuator::Direct, state).accelerations(&still);
    let kinetic = |factor: f64| {
        let mut pushed = state.clone();
        for (j, rates) in pushed.rates.iter_mut().enumerate() {
            for (k, rate) in rates.iter_mut().enumerate() {
                *rate += factor * (wet[j][k] - dry[j][k]);
            }
        }
        arm_in(parameters, Actuator::Direct, &pushed).energy().kinetic
    };
    let time = 1e-2;
    (kinetic(time) - kinetic(-time)) / (2.0 * time)
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 64,
        rng_seed: RngSeed::Fixed(2),
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn water_only_takes_energy(
        seed in any::<u64>(),
        lift_scale in -10.0..10.0_f64,
        area_scale in 0.5..50.0_f64,
    ) {
        let parameters = ArmParameters { lift_scale, area_scale, ..swimmer() };
        let state = swinging(&parameters, seed);
        let slow =
            Reference::new(&parameters, &state).hydrodynamic_power(&BaseSample::default());
        let fast = power_from_accelerations(&parameters, &state);
        prop_assert!(slow < 0.0, "{slow} W");
        // Rounding in differences of accelerations and of energies: 6e-13 measured.
        prop_assert!((fast / slow - 1.0).abs() < 1e-11, "{fast} W, {slow} W");

        // Lift is at right angles to the velocity: it moves the arm, but gives no power.
        let drag_alone = ArmParameters { lift_scale: 0.0, ..parameters };
        let without = Reference::new(&drag_alone, &state)
            .hydrodynamic_power(&BaseSample::default());
        prop_assert!((without / slow - 1.0).abs() < 1e-12, "{without} W, {slow} W");
    }
}

#[test]
fn a_still_arm_feels_only_weight_and_buoyancy() {
    for seed in 0..20 {
        let wet = ArmParameters::default();
        // As heavy in air as the other in water.
        let dry = ArmParameters { water_density: 0.0, arm_density: 110.0, ..wet.clone() };
        let mut state = swinging(&wet, seed);
        state.rates.fill([0.0; 7]);
        let still = BaseMotion::default();
        let (mut wet, mut dry) =
            (arm_in(&wet, Actuator::Direct, &state), arm_in(&dry, Actuator::Direct, &state));
        assert_eq!(wet.accelerations(&still), dry.accelerations(&still), "seed {seed}");
    }
}

#[test]
fn water_forces_grow_with_the_square_of_the_velocity() {
    let parameters = swimmer();
    let state = swinging(&parameters, 5);
    let forces = |factor: f64| {
        let mut state = state.clone();
        for rate in state.rates.iter_mut().flatten() {
            *rate *= factor;
        }
        let still = BaseMotion::default();
        let wet = arm_in(&parameters, Actuator::Direct, &state).accelerations(&still);
        let dry = arm_in(&dry(&parameters), Actuator::Direct, &state).accelerations(&still);
        let difference =
            |(w, d): (&[f64; 7], &[f64; 7])| -> [f64; 7] { std::array::from_fn(|k| w[k] - d[k]) };
        wet.iter().zip(&dry).map(difference).collect::<Vec<_>>()
    };
    let (slow, fast, back) = (forces(1.0), forces(2.0), forces(-1.0));
    let most = slow.iter().flatten().fold(0.0_f64, |most, a| most.max(a.abs()));
    for ((slow, fast), back) in
        slow.iter().flatten().zip(fast.iter().flatten()).zip(back.iter().flatten())
    {
        // Rounding of the dry accelerations, some 1e4: 9e-12 of the water's share measured.
        assert!((fast - 4.0 * slow).abs() < 1e-10 * most, "{slow} {fast}, of {most}");
        assert!((back + slow).abs() < 1e-10 * most, "{slow} {back}, of {most}");
    }
}

#[test]
fn the_energy_that_a_swing_loses_went_into_the_water() {
    // Without dampers the water is the only loss: the energy falls by the integral of its power.
    let parameters = ArmParameters {
        longitudinal_damping: 0.0.into(),
        transverse_damping: 0.0.into(),
        timestep: 6.25e-5,
        ..swimmer()
    };
    for seed in 0..3 {
        let mut arm = arm_in(&parameters, Actuator::Direct, &swinging(&parameters, seed));
        let total = |arm: &Arm| arm.energy().kinetic + arm.energy().elastic;
        let power = |arm: &Arm| {
            Reference::new(&parameters, &arm.state()).hydrodynamic_power(&BaseSample::default())
        };
        let before = total(&arm);
        let mut taken = 0.0;
        for _ in 0..800 {
            let start = power(&arm);
            arm.step([0.0; 2]).unwrap();
            taken -= 0.5 * (start + power(&arm)) * parameters.timestep;
        }
        let lost = before - total(&arm);
        assert!(taken > 0.05 * before, "seed {seed}: {taken} J of {before} J");
        // The trapezoidal rule over the fastest modes (ω dt = 0.05): 2e-6 measured.
        assert!((lost / taken - 1.0).abs() < 1e-5, "seed {seed}: {lost} J, {taken} J");
    }
}

#[test]
fn a_drag_that_would_push_is_refused() {
    let refused = |drag_coefficients: [f64; 5]| {
        let parameters = ArmParameters { drag_coefficients, ..ArmParameters::default() };
        match parameters.validate() {
            Ok(()) => false,
            Err(ParameterError::OutOfRange { name, .. }) => {
                assert_eq!(name, "drag_coefficients");
                true
            }
            Err(other) => panic!("{other}"),
        }
    };
    // Below zero everywhere, at 0, at 90, between, and only in a narrow dip at 45.
    assert!(refused([0.0, 0.0, 0.0, 0.0, -1e-9]));
    assert!(refused([0.0, 0.0, 0.0, 0.01, -0.01]));
    assert!(refused([0.0, 0.0, 0.0, -0.01, 0.89]));
    assert!(refused([0.0, 0.0, 1e-3, -0.06, 0.5]));
    assert!(refused([0.0, 0.0, 0.1, -9.0, 202.499]));
    // At or above zero: none at all, touching zero at 0 and at 90, below only beyond 90 (as
    // Table 1's polynomial is above 123).
    assert!(!refused([0.0; 5]));
    assert!(!refused([0.0, 0.0, 0.0, 0.01, 0.0]));
    assert!(!refused([0.0, 0.0, 0.0, -0.01, 0.9]));
    assert!(!refused([0.0, 0.0, 0.0, -0.01, 0.95]));
    assert!(!refused(ArmParameters::default().drag_coefficients));
}

#[test]
fn a_drag_that_would_push_in_a_narrow_range_is_refused() {
    // 0.1 (x − 45.05)² − 1e-4: below zero from 45.018 to 45.082 degrees.
    let drag_coefficients = [0.0, 0.0, 0.1, -9.01, 202.950_15];
    let parameters = ArmParameters { drag_coefficients, ..ArmParameters::default() };
    assert!(parameters.validate().is_err());
}
