//! The fast kernel against the plain world-frame reference.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;
mod reference;

use common::{arm_in, random_state, uneven};
use octoarm_arm::{Actuator, ArmParameters, BaseCoupling, BaseMotion, ReferenceArea, VolumeForce};
use reference::{BaseSample, Reference};

/// Rounding differs between the two formulations, nothing else does: a perturbation of 1e-16 stays
/// below 1e-15 m over 1,000 steps. The bound leaves room for other seeds.
const LENGTH_TOLERANCE: f64 = 1e-10;

fn sample(motion: &BaseMotion) -> BaseSample {
    BaseSample { angle: motion.angle, rate: motion.rate, acceleration: motion.acceleration }
}

fn muscles(count: usize, phase: f64) -> Vec<f64> {
    (0..count).map(|i| 0.05 * (1.7 * i as f64 + phase).sin()).collect()
}

fn rows(flat: &[f64]) -> Vec<[f64; 4]> {
    flat.chunks_exact(4).map(|row| [row[0], row[1], row[2], row[3]]).collect()
}

fn bodies() -> Vec<ArmParameters> {
    let plain = ArmParameters::default();
    vec![
        plain.clone(),
        ArmParameters { volume_force: VolumeForce::Total, ..plain.clone() },
        ArmParameters {
            gravity: [3.0, -2.0, 8.0],
            reference_area: ReferenceArea::Planform,
            area_scale: 30.0,
            plane_mass: 0.01.into(),
            plane_inertia: 1e-6.into(),
            compartments: 7,
            ..plain.clone()
        },
        ArmParameters { compartments: 8, volume_force: VolumeForce::Total, ..plain.clone() },
        ArmParameters { compartments: 1, ..plain.clone() },
        ArmParameters { base_coupling: BaseCoupling::Gravity, ..plain.clone() },
        ArmParameters { longitudinal_mass_share: 0.5, ..plain },
        ArmParameters::preset("nakajima2013").unwrap(),
        ArmParameters::preset("inertial").unwrap(),
        uneven(&ArmParameters::default(), 1),
        uneven(&ArmParameters { volume_force: VolumeForce::Total, ..ArmParameters::inertial() }, 2),
        uneven(&ArmParameters { compartments: 7, ..ArmParameters::inertial() }, 3),
    ]
}

#[test]
fn accelerations_agree_in_random_states() {
    for (index, parameters) in bodies().into_iter().enumerate() {
        for seed in 0..20 {
            let state = random_state(&parameters, seed + 100 * index as u64, 1.0);
            let mut arm = arm_in(&parameters, Actuator::Direct, &state);
            let longitudinal = muscles(arm.observation_len(), seed as f64);
            let transverse = muscles(arm.observation_len(), 0.5 + seed as f64);
            arm.set_muscles(&longitudinal, &transverse).unwrap();
            let mut reference = Reference::new(&parameters, &state);
            reference.longitudinal_muscles = rows(&longitudinal);
            reference.transverse_muscles = rows(&transverse);
            let motion = BaseMotion {
                angle: [state.base[0], state.base[1]],
                rate: [state.base[2], state.base[3]],
                acceleration: [20.0, -13.0],
            };
            let fast = arm.accelerations(&motion);
            let slow = reference.accelerations(&sample(&motion));
            // Rounding is relative to the largest acceleration of the arm (some 1e4 rad/s²).
            let scale = slow.iter().flatten().fold(1.0_f64, |most, a| most.max(a.abs()));
            for (j, (fast, slow)) in fast.iter().zip(&slow).enumerate() {
                for k in 0..7 {
                    assert!(
                        (fast[k] - slow[k]).abs() < 1e-11 * scale,
                        "body {index}, seed {seed}, compartment {j}, coordinate {k}: {} {}",
                        fast[k],
                        slow[k]
                    );
                }
            }
        }
    }
}

#[test]
fn lengths_agree_over_a_thousand_steps() {
    for (index, parameters) in bodies().into_iter().enumerate() {
        for actuator in [Actuator::Direct, Actuator::Servo] {
            let state = random_state(&parameters, 7 + index as u64, 0.3);
            let mut arm = arm_in(&parameters, actuator, &state);
            let longitudinal = muscles(arm.observation_len(), 0.1);
            let transverse = muscles(arm.observation_len(), 0.9);
            arm.set_muscles(&longitudinal, &transverse).unwrap();
            let mut reference = Reference::new(&parameters, &state);
            reference.longitudinal_muscles = rows(&longitudinal);
            reference.transverse_muscles = rows(&transverse);
            let mut worst = 0.0_f64;
            for step in 0..1000 {
                let t = f64::from(step) * 1e-3;
                // From where the base is, smoothly into a swing.
                let start = arm.base_degrees();
                let command = match actuator {
                    Actuator::Direct => {
                        [start[0] + 0.12 * (9.0 * t).cos(), start[1] - 0.10 * (7.0 * t).cos()]
                    }
                    Actuator::Servo => [30.0 * (9.0 * t).sin(), 25.0 * (7.0 * t).cos()],
                };
                let motion = arm.base_motion(command);
                arm.step(command).unwrap();
                reference.step(&[sample(&motion[0]), sample(&motion[1]), sample(&motion[2])]);
                let slow = reference.lengths(motion[2].angle);
                for (fast, slow) in arm.lengths().iter().zip(&slow) {
                    worst = worst.max((fast - slow).abs());
                }
            }
            assert!(worst < LENGTH_TOLERANCE, "body {index}, {actuator:?}: {worst:e} m");
        }
    }
}

#[test]
fn joints_are_as_far_apart_as_the_springs_are_long() {
    let parameters = ArmParameters::default();
    let state = random_state(&parameters, 7, 1.0);
    let arm = arm_in(&parameters, Actuator::Direct, &state);
    let (joints, centres, lengths) = (arm.joints(), arm.positions(), arm.lengths());
    assert_eq!(joints.len(), parameters.compartments + 1);
    let distance = |a: [f64; 3], b: [f64; 3]| {
        a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f64>().sqrt()
    };
    for (j, pair) in joints.windows(2).enumerate() {
        for i in 0..4 {
            assert!((distance(pair[0][i], pair[1][i]) - lengths[4 * j + i]).abs() < 1e-15);
            let radius = distance(pair[1][i], centres[j + 1]);
            assert!((radius - state.coordinates[j][3 + i]).abs() < 1e-15);
        }
    }
    assert!(
        joints[0].iter().all(|p| (distance(*p, [0.0; 3]) - parameters.base_radius).abs() < 1e-15)
    );
}

#[test]
fn energies_and_positions_agree() {
    for base_coupling in [BaseCoupling::Gravity, BaseCoupling::Inertial] {
        energies_and_positions_agree_for(&ArmParameters {
            base_coupling,
            longitudinal_mass_share: 0.6,
            plane_mass: 0.01.into(),
            plane_inertia: 1e-6.into(),
            ..Default::default()
        });
        energies_and_positions_agree_for(&uneven(
            &ArmParameters { base_coupling, ..Default::default() },
            4,
        ));
    }
}

fn energies_and_positions_agree_for(parameters: &ArmParameters) {
    let state = random_state(parameters, 3, 1.0);
    let arm = arm_in(parameters, Actuator::Direct, &state);
    let reference = Reference::new(parameters, &state);
    let base = BaseSample {
        angle: [state.base[0], state.base[1]],
        rate: [state.base[2], state.base[3]],
        acceleration: [0.0; 2],
    };
    let energy = arm.energy();
    assert!((energy.kinetic / reference.kinetic_energy(&base) - 1.0).abs() < 1e-12);
    assert!((energy.elastic / reference.elastic_energy() - 1.0).abs() < 1e-12);
    for (fast, slow) in arm.lengths().iter().zip(reference.lengths(base.angle)) {
        assert!((fast - slow).abs() < 1e-15);
    }
}
