//! The isovolumetric forces of Eqs. 7 and 8 push the volume back to where it was.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::{arm_in, random_state};
use octoarm_arm::{Actuator, Arm, ArmParameters, BaseMotion, VolumeForce};

const READINGS: [VolumeForce; 2] = [VolumeForce::Applied, VolumeForce::Total];

fn without_gains(parameters: &ArmParameters) -> ArmParameters {
    ArmParameters {
        longitudinal_volume_gain: 0.0,
        transverse_volume_gain: 0.0,
        ..parameters.clone()
    }
}

/// V − V_0 of every compartment \[m³\].
fn excess(arm: &Arm) -> Vec<f64> {
    let p = arm.parameters();
    arm.state().volumes(p).iter().enumerate().map(|(j, volume)| volume - p.rest_volume(j)).collect()
}

/// One compartment at rest, straight, stretched and widened by the factors given, all four springs
/// driven alike. Its strut and its radii then move independently of each other.
fn one_compartment(
    parameters: &ArmParameters,
    [stretch, widening]: [f64; 2],
    [push, spread]: [f64; 2],
) -> Arm {
    let parameters = ArmParameters { compartments: 1, ..parameters.clone() };
    let mut arm = Arm::undeformed(parameters, Actuator::Direct).unwrap();
    let mut state = arm.state();
    state.coordinates[0][0] *= stretch;
    for radius in &mut state.coordinates[0][3..] {
        *radius *= widening;
    }
    arm.set_state(&state).unwrap();
    arm.set_muscles(&[push; 4], &[spread; 4]).unwrap();
    arm
}

/// Shapes with too much and too little volume, and muscles that push and that pull.
/// All mass in the joints, so that accelerations follow from their forces, and the arm settles soon.
fn massless_planes() -> ArmParameters {
    ArmParameters { plane_mass: 0.0.into(), ..ArmParameters::default() }
}

fn cases() -> Vec<([f64; 2], [f64; 2])> {
    let shapes = [[1.1, 1.0], [0.9, 1.0], [1.0, 1.03], [1.0, 0.97], [1.05, 0.99]];
    let muscles = [[0.0, 0.0], [0.2, 0.0], [-0.2, 0.0], [0.0, 0.3], [0.0, -0.3], [-0.1, 0.2]];
    shapes.into_iter().flat_map(|shape| muscles.map(|muscle| (shape, muscle))).collect()
}

#[test]
fn equation_7_pulls_a_swollen_compartment_together() {
    for volume_force in READINGS {
        let body = ArmParameters { volume_force, transverse_volume_gain: 0.0, ..massless_planes() };
        for (shape, [push, spread]) in cases() {
            let mut with = one_compartment(&body, shape, [push, spread]);
            let mut without = one_compartment(&without_gains(&body), shape, [push, spread]);
            let excess = excess(&with)[0];
            let q = with.state().coordinates[0];
            let ring = match volume_force {
                VolumeForce::Applied => spread,
                VolumeForce::Total => {
                    spread
                        - body.transverse_stiffness.at(0)
                            * (q[3] - with.parameters().rest_radius(1))
                }
            };
            let force = -body.longitudinal_volume_gain * ring.abs() * excess;
            // Four springs push on four joint masses, along the strut.
            let expected = force * q[0] / (with.lengths()[0] * body.joint_mass(0));
            let change = with.accelerations(&BaseMotion::default())[0][0]
                - without.accelerations(&BaseMotion::default())[0][0];
            // Rounding of accelerations of some 100 m/s².
            assert!(
                (change - expected).abs() < 1e-11,
                "{volume_force:?}, {shape:?}, {push}, {spread}: {change} m/s², not {expected}"
            );
            assert!(change * excess <= 0.0, "{volume_force:?}: away from the rest volume");
            assert_eq!(change == 0.0, ring == 0.0, "{volume_force:?}, {shape:?}, {spread}");
        }
    }
}

#[test]
fn equation_8_draws_the_rings_of_a_swollen_compartment_in() {
    for volume_force in READINGS {
        let body = ArmParameters { volume_force, ..ArmParameters::default() };
        let eq_7_alone = ArmParameters { transverse_volume_gain: 0.0, ..body.clone() };
        for (shape, [push, spread]) in cases() {
            let mut with = one_compartment(&body, shape, [push, spread]);
            let mut without = one_compartment(&eq_7_alone, shape, [push, spread]);
            let excess = excess(&with)[0];
            let weight = (body.arm_density - body.water_density)
                * body.gravity[2]
                * with.state().volumes(with.parameters())[0];
            let spring = match volume_force {
                VolumeForce::Applied => -body.longitudinal_volume_gain * spread.abs() * excess,
                VolumeForce::Total => {
                    -body.longitudinal_stiffness.at(0) * (with.lengths()[0] - body.rest_length)
                }
            };
            let force =
                -body.transverse_volume_gain * (4.0 * (push + spring) + weight).abs() * excess;
            let with = with.accelerations(&BaseMotion::default())[0];
            let without = without.accelerations(&BaseMotion::default())[0];
            for radius in 3..7 {
                let change = with[radius] - without[radius];
                // Rounding of accelerations of some 100 m/s².
                assert!(
                    (change - force / body.joint_mass(0)).abs() < 1e-11,
                    "{volume_force:?}, {shape:?}, {push}, {spread}: {change} m/s² of {force} N"
                );
                assert!(change * excess < 0.0, "{volume_force:?}: away from the rest volume");
            }
        }
    }
}

#[test]
fn the_passive_weightless_arm_as_printed_has_no_volume_forces() {
    let dry = ArmParameters { water_density: 0.0, gravity: [0.0; 3], ..ArmParameters::default() };
    for seed in 0..10 {
        let state = random_state(&dry, seed, 1.0);
        let mut with = arm_in(&dry, Actuator::Direct, &state);
        let mut without = arm_in(&without_gains(&dry), Actuator::Direct, &state);
        let still = BaseMotion::default();
        assert_eq!(with.accelerations(&still), without.accelerations(&still));
    }
}

/// Excess volumes of a whole arm after its muscles have acted for ten seconds, in which the slowest
/// mode falls by e twelve times.
fn settled(parameters: &ArmParameters, [push, spread]: [f64; 2]) -> Vec<f64> {
    let mut arm = Arm::undeformed(parameters.clone(), Actuator::Direct).unwrap();
    let count = arm.observation_len();
    arm.set_muscles(&vec![push; count], &vec![spread; count]).unwrap();
    for _ in 0..10_000 {
        arm.step([0.0; 2]).unwrap();
    }
    excess(&arm)
}

/// Ratio of the excess with the volume forces to that without, in every compartment.
fn remaining(body: &ArmParameters, muscles: [f64; 2]) -> Vec<f64> {
    let (with, without) = (settled(body, muscles), settled(&without_gains(body), muscles));
    with.iter().zip(&without).map(|(with, without)| with / without).collect()
}

#[test]
fn less_of_a_volume_change_remains() {
    let applied = ArmParameters::default();
    let total = ArmParameters { volume_force: VolumeForce::Total, ..applied.clone() };
    let applied_weightless = ArmParameters { arm_density: 1000.0, ..applied.clone() };
    // Causes that pull the same way: where weight and a muscle cancel there is no excess to compare.
    let cases = [
        (&applied, [0.0, 0.0]),
        (&applied, [0.1, 0.0]),
        (&applied, [0.0, 0.2]),
        (&applied_weightless, [-0.1, 0.0]),
        (&applied_weightless, [0.1, 0.0]),
        (&applied_weightless, [0.0, -0.2]),
        (&applied_weightless, [0.0, 0.2]),
        (&applied_weightless, [0.05, 0.1]),
        (&total, [0.0, 0.0]),
        (&total, [0.1, 0.0]),
        (&total, [0.0, 0.2]),
    ];
    for (body, muscles) in cases {
        let ratios = remaining(body, muscles);
        // Of the same sign and smaller: 0.52 to 0.997.
        assert!(
            ratios.iter().all(|ratio| (0.0..1.0).contains(ratio)),
            "{:?}, {muscles:?}: {ratios:.3?}",
            body.volume_force
        );
    }
}

#[test]
fn in_the_total_reading_muscles_at_rest_meet_no_volume_force() {
    // The muscle and its own spring cancel in Eq. 8 (in Eq. 7 across the arm): what is left at rest
    // is the load from outside, and a weightless arm has none. Only the slant of the springs, which
    // carry a little from ring to ring, makes a difference: 8e-6 measured.
    let body = ArmParameters {
        volume_force: VolumeForce::Total,
        arm_density: 1000.0,
        ..massless_planes()
    };
    for muscles in [[-0.1, 0.0], [0.0, -0.2], [0.05, 0.1]] {
        let ratios = remaining(&body, muscles);
        assert!(ratios.iter().all(|ratio| (ratio - 1.0).abs() < 1e-4), "{muscles:?}: {ratios:.4?}");
    }
}
