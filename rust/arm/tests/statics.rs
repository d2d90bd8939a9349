//! The arm at rest: the springs carry the weight beyond them.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::uneven;
use octoarm_arm::{Actuator, Arm, ArmParameters, ParameterError, VolumeForce};

/// Tension that the passive springs of compartment `j` and their volume force (Eq. 7) hold at rest,
/// along the strut, summed over the four \[N\].
fn axial_tension(arm: &Arm, j: usize) -> f64 {
    let p = arm.parameters();
    let state = arm.state();
    let [h, alpha, beta, r1, r2, r3, r4] = state.coordinates[j];
    let radii = [r1, r2, r3, r4];
    // The joint's height over the floor: h + r z·R_x(α) R_y(β) u.
    let heights = [
        h - r1 * alpha.cos() * beta.sin(),
        h + r2 * alpha.sin(),
        h + r3 * alpha.cos() * beta.sin(),
        h - r4 * alpha.sin(),
    ];
    let excess = state.volumes(p)[j] - p.rest_volume(j);
    let lengths = &arm.lengths()[4 * j..4 * j + 4];
    (0..4)
        .map(|i| {
            let across = match p.volume_force {
                VolumeForce::Applied => 0.0,
                VolumeForce::Total => {
                    p.transverse_stiffness.at(j) * (radii[i] - p.rest_radius(j + 1))
                }
            };
            let volume_force = -p.longitudinal_volume_gain * across.abs() * excess;
            let tension =
                p.longitudinal_stiffness.at(j) * (lengths[i] - p.rest_length) - volume_force;
            tension * heights[i] / lengths[i]
        })
        .sum()
}

/// Weight less buoyancy of all planes from `j` on, along the strut of compartment `j` \[N\].
fn axial_load(arm: &Arm, j: usize) -> f64 {
    let p = arm.parameters();
    let centres = arm.positions();
    let volume: f64 = arm.state().volumes(p)[j..].iter().sum();
    let along: f64 =
        (0..3).map(|axis| p.gravity[axis] * (centres[j + 1][axis] - centres[j][axis])).sum::<f64>()
            / arm.state().coordinates[j][0];
    (p.arm_density - p.water_density) * volume * along
}

/// Largest change of a coordinate (metres and radians alike).
fn moved(arm: &Arm, from: &[[f64; 7]]) -> f64 {
    arm.state()
        .coordinates
        .iter()
        .flatten()
        .zip(from.iter().flatten())
        .fold(0.0, |most, (now, then)| most.max((now - then).abs()))
}

fn bodies() -> Vec<(&'static str, ArmParameters)> {
    let hanging = ArmParameters::default();
    vec![
        ("hanging", hanging.clone()),
        ("upright", ArmParameters { gravity: [0.0, 0.0, -9.81], ..hanging.clone() }),
        ("buoyant", ArmParameters { arm_density: 900.0, ..hanging.clone() }),
        ("total", ArmParameters { volume_force: VolumeForce::Total, ..hanging.clone() }),
        ("sideways", ArmParameters { gravity: [2.0, 0.0, 0.0], ..hanging.clone() }),
        ("askew", ArmParameters { gravity: [-1.0, 1.5, 6.0], ..hanging.clone() }),
        (
            "askew, total",
            ArmParameters {
                gravity: [-1.0, 1.5, 6.0],
                volume_force: VolumeForce::Total,
                plane_mass: 0.01.into(),
                ..hanging.clone()
            },
        ),
        ("uneven", uneven(&hanging, 5)),
        ("short", ArmParameters { compartments: 9, ..hanging }),
    ]
}

#[test]
fn every_compartment_carries_the_weight_beyond_it() {
    for (name, parameters) in bodies() {
        let arm = Arm::new(parameters, Actuator::Direct).unwrap();
        let count = arm.parameters().compartments;
        // Virtual work on the struts, valid in any posture. Newton's method ends in the rounding of
        // the lengths, K_l · 3e-18 m · 80 springs; 3e-15 N of up to 0.47 N was measured.
        for j in 0..count {
            let (tension, load) = (axial_tension(&arm, j), axial_load(&arm, j));
            assert!((tension - load).abs() < 1e-13, "{name}, {j}: {tension} N holds {load} N");
        }
        // The middle of an arm that lies across gravity carries something too.
        assert!(axial_load(&arm, count / 2).abs() > 3e-3, "{name}");
    }
}

#[test]
fn lengths_of_the_hanging_arm_fall_towards_the_tip() {
    let arm = Arm::new(ArmParameters::default(), Actuator::Direct).unwrap();
    let lengths = arm.lengths();
    let mut before = f64::INFINITY;
    for row in lengths.chunks_exact(4) {
        // An arm that hangs straight stretches its four springs alike, but for Newton's last bits.
        assert!(row.iter().all(|length| (length - row[0]).abs() < 1e-16), "{row:?}");
        assert!(row[0] > 0.02 && row[0] < before, "{lengths:?}");
        before = row[0];
    }
}

#[test]
fn the_rings_balance_the_slant_of_the_springs_and_the_volume_force() {
    let arm = Arm::new(ArmParameters::default(), Actuator::Direct).unwrap();
    let p = arm.parameters();
    let state = arm.state();
    let lengths = arm.lengths();
    let volumes = state.volumes(p);
    // Inward pull on the upper and outward pull on the lower joint of a slanting spring.
    let slant = |j: usize| {
        let floor = if j == 0 { p.base_radius } else { state.coordinates[j - 1][3] };
        let tension = p.longitudinal_stiffness.at(j) * (lengths[4 * j] - p.rest_length);
        tension * (state.coordinates[j][3] - floor) / lengths[4 * j]
    };
    for j in 0..p.compartments {
        let weight = (p.arm_density - p.water_density) * volumes[j] * p.gravity[2];
        let excess = volumes[j] - p.rest_volume(j);
        let volume_force = -p.transverse_volume_gain * weight.abs() * excess;
        let ring = -p.transverse_stiffness.at(j) * (state.coordinates[j][3] - p.rest_radius(j + 1));
        let above = if j + 1 < p.compartments { slant(j + 1) } else { 0.0 };
        let left = ring + volume_force - slant(j) + above;
        // Rounding of K_r (r − r_0): 1570 N/m · 2e-18 m.
        assert!(left.abs() < 1e-13, "plane {}: {left:e} N", j + 1);
        // The hanging arm is stretched, so its volume is too large and the force presses inward.
        assert!(excess > 0.0 && volume_force < 0.0, "plane {}", j + 1);
    }
}

#[test]
fn the_equilibrium_stays_put() {
    for (name, parameters) in bodies() {
        let mut arm = Arm::new(parameters, Actuator::Direct).unwrap();
        let start = arm.state().coordinates;
        for _ in 0..1000 {
            arm.step([0.0; 2]).unwrap();
        }
        // 5e-16 measured: the rounding of the equilibrium, damped or (upright, the arm is top-heavy
        // and will buckle after 20 s) not yet grown.
        let most = moved(&arm, &start);
        assert!(most < 1e-12, "{name}: {most:e}");
    }
}

#[test]
fn the_undeformed_arm_has_every_spring_at_rest_length() {
    for (name, parameters) in bodies() {
        let rest_length = parameters.rest_length;
        let mut arm = Arm::undeformed(parameters, Actuator::Direct).unwrap();
        for _ in 0..2 {
            for length in arm.lengths() {
                // The height is a rounded square root, the length another.
                assert!((length / rest_length - 1.0).abs() <= 2.0 * f64::EPSILON, "{name}");
            }
            assert!(arm.energy().elastic < 1e-30, "{name}: {:?}", arm.energy());
            // Back there after a swing, with nothing left of it.
            for _ in 0..50 {
                arm.step([0.1, 0.0]).unwrap();
            }
            arm.set_muscles(&vec![0.1; arm.observation_len()], &vec![0.1; arm.observation_len()])
                .unwrap();
            arm.reset_undeformed();
            assert_eq!(arm.muscles().0, vec![0.0; arm.observation_len()]);
            assert_eq!((arm.time(), arm.base()), (0.0, [0.0; 4]));
        }
    }
}

#[test]
fn a_released_arm_settles_at_the_equilibrium() {
    // With light planes and little water an arm settles soon; its posture is the same.
    let hanging = ArmParameters {
        plane_mass: 0.0.into(),
        area_scale: 1.0,
        lift_scale: 1.0,
        ..Default::default()
    };
    // Sideways only a short arm: the whole one swings for minutes, its dampers hardly feel bending.
    let bodies = [
        ("hanging", hanging.clone()),
        ("total", ArmParameters { volume_force: VolumeForce::Total, ..hanging.clone() }),
        ("sideways", ArmParameters { gravity: [2.0, 0.0, 0.0], compartments: 4, ..hanging }),
    ];
    for (name, parameters) in bodies {
        let rest = Arm::new(parameters.clone(), Actuator::Direct).unwrap();
        let mut arm = Arm::undeformed(parameters, Actuator::Direct).unwrap();
        let target = rest.state().coordinates;
        assert!(moved(&arm, &target) > 1e-4, "{name}: nowhere to go");
        for _ in 0..20_000 {
            arm.step([0.0; 2]).unwrap();
        }
        let left = moved(&arm, &target);
        // The slowest mode falls by e in 0.8 s: after 20 s nothing but rounding is left
        // (3e-15 measured). Two independent ways, Newton's and time's, to one posture.
        assert!(left < 1e-12, "{name}: {left:e}");
    }
}

#[test]
fn the_reset_arm_is_at_the_equilibrium_again() {
    let mut arm = Arm::new(ArmParameters::default(), Actuator::Servo).unwrap();
    let start = arm.state();
    for _ in 0..200 {
        arm.step([20.0, -10.0]).unwrap();
    }
    arm.set_muscles(&[0.05; 80], &[0.05; 80]).unwrap();
    arm.reset().unwrap();
    assert_eq!(arm.state(), start);
    assert_eq!(arm.muscles(), (vec![0.0; 80], vec![0.0; 80]));
}

#[test]
fn an_absurd_load_is_an_error_or_an_equilibrium() {
    let loads = [
        ([0.0, 0.0, 100.0], 1303.0),
        ([0.0, 0.0, -100.0], 1303.0),
        ([100.0, 0.0, 0.0], 1303.0),
        ([0.0, 0.0, -1e3], 1e5),
        ([0.0, 0.0, 1e3], 1e5),
        ([1e3, 30.0, 100.0], 1e5),
        ([1e3, 1e3, 1e3], 0.0),
    ];
    let mut found = 0;
    for (gravity, arm_density) in loads {
        for compartments in [3, 12] {
            let parameters =
                ArmParameters { gravity, arm_density, compartments, ..ArmParameters::default() };
            match Arm::new(parameters.clone(), Actuator::Direct) {
                Ok(mut arm) => {
                    found += 1;
                    let state = arm.state();
                    assert_eq!(arm.set_state(&state), Ok(()), "{parameters:?}");
                    arm.step([0.0; 2]).unwrap();
                }
                Err(ParameterError::NoEquilibrium { reason }) => {
                    assert!(!reason.is_empty(), "{parameters:?}");
                    // There is still an arm without an equilibrium; a refused reset leaves it alone.
                    let mut arm = Arm::undeformed(parameters, Actuator::Direct).unwrap();
                    let state = arm.state();
                    assert!(arm.reset().is_err());
                    assert_eq!(arm.state(), state);
                }
                Err(other) => panic!("{parameters:?}: {other}"),
            }
        }
    }
    assert!((1..14).contains(&found), "{found} of 14");
}

#[test]
fn an_equilibrium_outside_the_domain_is_none() {
    // The first strut at 4.5 times its height: the arm could not make a step from there.
    let parameters = ArmParameters {
        gravity: [0.0, 0.0, 1000.0],
        arm_density: 1303.0,
        ..ArmParameters::default()
    };
    let message = Arm::new(parameters, Actuator::Direct).unwrap_err().to_string();
    assert!(message.contains("height of compartment 1"), "{message}");
}

#[test]
fn a_search_that_is_told_to_stop_stops() {
    let parameters = ArmParameters { compartments: 200, ..ArmParameters::default() };
    let work = || Arm::new(parameters, Actuator::Direct).err();
    let result = octoarm_arm::interruptible(|| true, work);
    assert_eq!(result, Some(octoarm_arm::ParameterError::Interrupted));
    assert_eq!(octoarm_arm::poll(), Ok(()));
}
