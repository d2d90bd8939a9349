//! Arms in lanes have the very bits that they have alone.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::{arm_bits, congruential, state_bits, uneven};
use octoarm_arm::{
    Actuator, Arm, ArmLanes, ArmParameters, BaseCoupling, InstructionSet, ReferenceArea,
    VolumeForce,
};

const SETS: [InstructionSet; 3] =
    [InstructionSet::Baseline, InstructionSet::Avx2, InstructionSet::Avx512];

/// Eight different bodies, every other on a servo, with muscles at work.
fn bodies(compartments: usize) -> Vec<Arm> {
    (0..8_u8)
        .map(|index| {
            let share = f64::from(index) / 8.0;
            let parameters = ArmParameters {
                base_coupling: if index % 4 < 2 {
                    BaseCoupling::Gravity
                } else {
                    BaseCoupling::Inertial
                },
                longitudinal_mass_share: 1.0 - 0.5 * share,
                compartments,
                arm_density: 1100.0 + 300.0 * share,
                area_scale: 5.0 + 50.0 * share,
                timestep: if index == 3 { 0.5e-3 } else { 1e-3 },
                gravity: [3.0 * share, -2.0 * share, 9.81],
                servo_frequency: 8.0 + 4.0 * share,
                plane_mass: (0.05 * share).into(),
                plane_inertia: (1e-6 * share).into(),
                longitudinal_stiffness: (196.0 + 20.0 * share).into(),
                lift_scale: 1.0 - 2.0 * share,
                volume_force: if index % 3 == 0 {
                    VolumeForce::Total
                } else {
                    VolumeForce::Applied
                },
                reference_area: if index % 2 == 0 {
                    ReferenceArea::Wetted
                } else {
                    ReferenceArea::Planform
                },
                ..ArmParameters::default()
            };
            // Some with a number for each compartment.
            let parameters =
                if index % 3 == 1 { uneven(&parameters, index as u64) } else { parameters };
            let actuator = if index % 2 == 0 { Actuator::Servo } else { Actuator::Direct };
            let mut arm = Arm::undeformed(parameters, actuator).unwrap();
            let count = arm.observation_len();
            let push: Vec<f64> = (0..count).map(|i| 0.03 * share * (i % 7) as f64).collect();
            let spread: Vec<f64> = (0..count).map(|i| 0.02 * share * (i % 5) as f64).collect();
            arm.set_muscles(&push, &spread).unwrap();
            arm
        })
        .collect()
}

fn assert_same(lanes: &ArmLanes, lane: usize, arm: &Arm, step: usize) {
    let mut lengths = vec![0.0; arm.observation_len()];
    lanes.lengths_into(lane, &mut lengths);
    assert_eq!(state_bits(&lanes.state(lane), &lengths), arm_bits(arm), "lane {lane}, step {step}");
    assert_eq!(lanes.base_degrees(lane), arm.base_degrees());
}

#[test]
fn arms_side_by_side_are_the_arms_alone_on_every_instruction_set() {
    for set in SETS {
        for (compartments, count) in [(20, 8), (7, 3), (7, 1)] {
            let mut arms: Vec<Arm> = bodies(compartments)
                .into_iter()
                .take(count)
                .map(|arm| arm.with_instruction_set(set))
                .collect();
            let mut lanes = ArmLanes::new(&arms.iter().collect::<Vec<_>>()).unwrap();
            let mut x = 5;
            let mut commands = [[0.0; 2]; ArmLanes::WIDTH];
            for step in 0..400 {
                for (lane, command) in commands.iter_mut().enumerate() {
                    if lane % 2 == 1 {
                        *command =
                            [command[0] + 0.02 * congruential(&mut x), 0.02 * congruential(&mut x)];
                    } else if step % 10 == 0 {
                        *command = [40.0 * congruential(&mut x), 40.0 * congruential(&mut x)];
                    }
                }
                // An arm that waits now and then.
                let mut active = [true; ArmLanes::WIDTH];
                active[step % 11 % 8] = step % 3 != 0;
                assert!(lanes.step(&commands, &active));
                for (lane, arm) in arms.iter_mut().enumerate() {
                    if active[lane] {
                        arm.step(commands[lane]).unwrap();
                    }
                    assert_same(&lanes, lane, arm, step);
                }
            }
        }
    }
}

#[test]
fn a_lane_takes_another_body() {
    for set in SETS {
        for count in [8, 3, 1] {
            let pool: Vec<Arm> =
                bodies(7).into_iter().map(|arm| arm.with_instruction_set(set)).collect();
            let mut arms: Vec<Arm> = pool[..count].to_vec();
            let mut lanes = ArmLanes::new(&arms.iter().collect::<Vec<_>>()).unwrap();
            let mut x = 3;
            for round in 0..6_usize {
                // Another body in every other lane, one at work beside those that stay.
                let changed: Vec<usize> =
                    (0..count).filter(|lane| (lane + round) % 2 == 0).collect();
                for lane in &changed {
                    arms[*lane] = pool[(lane + 3 * round) % 8].clone();
                }
                let states: Vec<_> = changed.iter().map(|lane| arms[*lane].state()).collect();
                let placed: Vec<_> = changed
                    .iter()
                    .zip(&states)
                    .map(|(lane, at)| (*lane, &arms[*lane], at))
                    .collect();
                lanes.place(&placed);
                for step in 0..20 {
                    let push = [0.05 * f64::from(step), 0.02 * congruential(&mut x)];
                    assert!(lanes.step(&[push; ArmLanes::WIDTH], &[true; ArmLanes::WIDTH]));
                    for (lane, arm) in arms.iter_mut().enumerate() {
                        arm.step(push).unwrap();
                        assert_same(&lanes, lane, arm, step as usize);
                        assert_eq!(lanes.parameters(lane), arm.parameters());
                        assert_eq!(lanes.actuator(lane), arm.actuator());
                    }
                }
            }
        }
    }
}

#[test]
fn an_arm_that_fails_keeps_its_state_and_disturbs_no_neighbour() {
    let mut arms: Vec<Arm> = (0..8)
        .map(|_| Arm::undeformed(ArmParameters::inertial(), Actuator::Direct).unwrap())
        .collect();
    let mut lanes = ArmLanes::new(&arms.iter().collect::<Vec<_>>()).unwrap();
    let mut failures = 0;
    for step in 0..300 {
        let gentle = [0.01 * (step as f64).sin(), 0.01 * step as f64];
        let mut commands = [gentle; ArmLanes::WIDTH];
        // Lane 2 is thrown about, lane 5 is not even told numbers, in turns.
        commands[2] = if step % 2 == 0 { [60.0, -60.0] } else { [-60.0, 60.0] };
        commands[5] = if step % 50 == 49 { [f64::NAN, f64::INFINITY] } else { gentle };
        let complete = lanes.step(&commands, &[true; ArmLanes::WIDTH]);
        let mut all_made = true;
        for (lane, arm) in arms.iter_mut().enumerate() {
            if let Err(failure) = arm.step(commands[lane]) {
                let ours = lanes.failure(lane).unwrap();
                assert_eq!(ours.to_string(), failure.to_string(), "lane {lane}, step {step}");
                failures += 1;
                all_made = false;
            } else {
                // Of a step that lane 2 failed, say, nothing is said of lane 5.
                assert!(complete || lanes.failure(lane).is_none(), "lane {lane}, step {step}");
            }
            assert_same(&lanes, lane, arm, step);
        }
        assert_eq!(complete, all_made);
    }
    assert!(failures > 6, "{failures}");
}

#[test]
fn states_come_back_exactly() {
    let arms = bodies(20);
    let mut lanes = ArmLanes::new(&arms.iter().collect::<Vec<_>>()).unwrap();
    let commands = [[5.0, -3.0]; ArmLanes::WIDTH];
    let servos: [bool; ArmLanes::WIDTH] = std::array::from_fn(|lane| lane % 2 == 0);
    for _ in 0..50 {
        assert!(lanes.step(&commands, &servos));
    }
    let saved = lanes.clone();
    let states: Vec<_> = (0..8).map(|lane| lanes.state(lane)).collect();
    for _ in 0..50 {
        assert!(lanes.step(&commands, &servos));
    }
    lanes.restore(&[(0, &states[0]), (4, &states[4])]);
    lanes.set_state(2, &states[2]).unwrap();
    for lane in [0, 2, 4] {
        assert_eq!(lanes.state(lane), saved.state(lane));
    }
    assert_ne!(lanes.state(6), saved.state(6));
    let mut bad = states[0].clone();
    bad.coordinates[3][1] = 3.0;
    let message = lanes.set_state(0, &bad).unwrap_err().to_string();
    assert!(message.contains("bend_angle of compartment 4"), "{message}");
    assert_eq!(lanes.state(0), saved.state(0));
}

#[test]
fn what_cannot_stand_side_by_side_is_refused() {
    let arms = bodies(20);
    let many: Vec<&Arm> = arms.iter().chain(&arms).take(9).collect();
    assert!(ArmLanes::new(&many).unwrap_err().to_string().contains("arms = 9"));
    assert!(ArmLanes::new(&[]).unwrap_err().to_string().contains("[1, 8] arms"));
    let short = bodies(5).remove(0);
    let message = ArmLanes::new(&[&arms[0], &short]).unwrap_err().to_string();
    assert!(message.contains("compartments = 5"), "{message}");
}
