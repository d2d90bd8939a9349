//! The same inputs give the same bits: again, after a restart, on every instruction set.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::{arm_bits, bits, congruential};
use octoarm_arm::{
    Actuator, Arm, ArmParameters, ArmState, BaseCoupling, InstructionSet, LinearReadout,
    ReferenceArea, VolumeForce,
};

const ACTUATORS: [Actuator; 2] = [Actuator::Direct, Actuator::Servo];

/// Random commands \[degrees\], a linear congruential generator's: for the servo new every 10 ms, for
/// the direct base small enough to stay in the domain.
fn commands(actuator: Actuator, steps: usize, seed: u64) -> Vec<[f64; 2]> {
    let mut x = seed;
    let mut uniform = || congruential(&mut x);
    let mut now = [0.0; 2];
    (0..steps)
        .map(|step| {
            match actuator {
                Actuator::Direct => now = [0.05 * uniform(), 0.05 * uniform()],
                Actuator::Servo if step % 10 == 0 => now = [60.0 * uniform(), 60.0 * uniform()],
                Actuator::Servo => {}
            }
            now
        })
        .collect()
}

/// Sets the arm in motion, with muscles at work.
fn moving(actuator: Actuator) -> Arm {
    let mut arm = Arm::undeformed(ArmParameters::default(), actuator).unwrap();
    let push: Vec<f64> = (0..80).map(|i| 0.03 * f64::from(i % 7) - 0.1).collect();
    let spread: Vec<f64> = (0..80).map(|i| 0.04 * f64::from(i % 5) - 0.1).collect();
    arm.set_muscles(&push, &spread).unwrap();
    for command in commands(actuator, 300, 11) {
        arm.step(command).unwrap();
    }
    arm
}

/// Steps two arms side by side and compares everything after every step.
fn assert_same_future(one: &mut Arm, two: &mut Arm, commands: &[[f64; 2]]) {
    assert_eq!(arm_bits(one), arm_bits(two), "before the first step");
    for (step, command) in commands.iter().enumerate() {
        one.step(*command).unwrap();
        two.step(*command).unwrap();
        assert_eq!(arm_bits(one), arm_bits(two), "step {step}");
    }
}

#[test]
fn the_same_run_twice() {
    for actuator in ACTUATORS {
        let (mut one, mut two) = (moving(actuator), moving(actuator));
        assert_same_future(&mut one, &mut two, &commands(actuator, 500, 2));
    }
    let parameters = ArmParameters { gravity: [1.0, 2.0, 9.0], ..ArmParameters::default() };
    let one = Arm::new(parameters.clone(), Actuator::Servo).unwrap();
    let two = Arm::new(parameters, Actuator::Servo).unwrap();
    assert_eq!(arm_bits(&one), arm_bits(&two));
}

#[test]
fn other_commands_give_other_bits() {
    let (mut one, mut two) = (moving(Actuator::Servo), moving(Actuator::Servo));
    one.step([1.0, 0.0]).unwrap();
    two.step([1.0 + 1e-12, 0.0]).unwrap();
    assert_ne!(arm_bits(&one), arm_bits(&two));
}

#[test]
fn a_clone_goes_the_same_way_and_leaves_the_original_alone() {
    for actuator in ACTUATORS {
        let mut arm = moving(actuator);
        let before = arm_bits(&arm);
        let mut clone = arm.clone();
        for command in commands(actuator, 100, 3) {
            clone.step(command).unwrap();
        }
        assert_eq!(arm_bits(&arm), before);
        let mut clone = arm.clone();
        assert_same_future(&mut arm, &mut clone, &commands(actuator, 500, 4));
    }
}

#[test]
fn a_restored_state_has_the_same_future() {
    for actuator in ACTUATORS {
        let mut arm = moving(actuator);
        let text = serde_json::to_string(&arm.state()).unwrap();
        let state: ArmState = serde_json::from_str(&text).unwrap();
        assert_eq!(state, arm.state());
        // Into an arm that was elsewhere, and without muscle inputs.
        let mut other = Arm::undeformed(ArmParameters::default(), actuator).unwrap();
        for command in commands(actuator, 50, 5) {
            other.step(command).unwrap();
        }
        other.set_state(&state).unwrap();
        assert_eq!(other.muscles(), arm.muscles());
        assert_same_future(&mut arm, &mut other, &commands(actuator, 500, 6));
        // A state without muscle inputs takes them away, and is written without them.
        arm.reset_undeformed();
        let text = serde_json::to_string(&arm.state()).unwrap();
        assert!(!text.contains("muscles"), "{text}");
        other.set_state(&serde_json::from_str(&text).unwrap()).unwrap();
        assert_same_future(&mut arm, &mut other, &commands(actuator, 500, 6));
    }
}

#[test]
fn a_state_from_the_past_can_be_run_again() {
    for actuator in ACTUATORS {
        let mut arm = moving(actuator);
        let start = arm.state();
        let drive = commands(actuator, 500, 7);
        let (mut first, mut second) = (vec![0.0; 500 * 80], vec![0.0; 500 * 80]);
        arm.run(&drive, &mut first).unwrap();
        arm.set_state(&start).unwrap();
        arm.run(&drive, &mut second).unwrap();
        assert_eq!(bits(&first), bits(&second));
    }
}

#[test]
fn one_call_for_many_steps_is_many_steps() {
    let drive = commands(Actuator::Servo, 200, 8);
    let (mut many, mut one) = (moving(Actuator::Servo), moving(Actuator::Servo));
    let mut lengths = vec![0.0; 200 * 80];
    one.run(&drive, &mut lengths).unwrap();
    for (command, row) in drive.iter().zip(lengths.chunks_exact(80)) {
        many.step(*command).unwrap();
        assert_eq!(bits(&many.lengths()), bits(row));
    }
    assert_eq!(arm_bits(&one), arm_bits(&many));
}

#[test]
fn the_closed_loop_is_steps_commanded_by_the_readout() {
    let readout = LinearReadout {
        weights: (0..80).map(|i| [f64::from(i - 40) * 20.0, f64::from(i % 9) * 10.0]).collect(),
        bias: [1.0, -8.0],
    };
    let push = commands(Actuator::Servo, 200, 9);
    let (mut one, mut many) = (moving(Actuator::Servo), moving(Actuator::Servo));
    let (mut outputs, mut lengths) = (vec![[0.0; 2]; 200], vec![0.0; 200 * 80]);
    one.run_closed_loop(&readout, Some(&push), &mut outputs, &mut lengths).unwrap();
    for ((push, output), row) in push.iter().zip(&outputs).zip(lengths.chunks_exact(80)) {
        let said = readout.output(&many.lengths());
        assert_eq!(bits(&said), bits(output));
        many.step([said[0] + push[0], said[1] + push[1]]).unwrap();
        assert_eq!(bits(&many.lengths()), bits(row));
    }
    assert_eq!(arm_bits(&one), arm_bits(&many));
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    for actuator in ACTUATORS {
        for compartments in [20, 13] {
            let parameters = ArmParameters {
                compartments,
                volume_force: VolumeForce::Total,
                plane_mass: 0.01.into(),
                plane_inertia: 1e-6.into(),
                ..ArmParameters::default()
            };
            let arm = Arm::undeformed(parameters, actuator).unwrap();
            let mut arms = [InstructionSet::Baseline, InstructionSet::Avx2, InstructionSet::Avx512]
                .map(|set| arm.clone().with_instruction_set(set));
            for (step, command) in commands(actuator, 500, 10).into_iter().enumerate() {
                for arm in &mut arms {
                    arm.step(command).unwrap();
                }
                let [baseline, avx2, avx512] = arms.each_ref().map(arm_bits);
                assert_eq!(baseline, avx2, "AVX2, {actuator:?}, step {step}");
                assert_eq!(baseline, avx512, "AVX-512, {actuator:?}, step {step}");
            }
        }
    }
}

/// What a fixed drive of one second leaves: bits of three lengths after it (a base that turns about
/// both axes, and muscles), and FNV-1a over the bits of all 80 lengths after each of the 1,000 steps:
/// the arm forgets, so that a last bit that differed early need not show at the end.
struct Bits {
    coupling: BaseCoupling,
    lengths: [(usize, u64); 3],
    all_lengths: u64,
}

const BITS: [Bits; 2] = [
    Bits {
        coupling: BaseCoupling::Inertial,
        lengths: [
            (0, 0x3f91_7016_4b0a_b6b4),
            (41, 0x3f95_b1f3_7d3c_8ccf),
            (79, 0x3f94_8c78_65fa_43fa),
        ],
        all_lengths: 0xb65f_8848_2c6f_9ac9,
    },
    Bits {
        coupling: BaseCoupling::Gravity,
        lengths: [
            (0, 0x3f94_d7dd_7912_f03d),
            (41, 0x3f95_3a05_9146_e692),
            (79, 0x3f94_7f4d_ee1e_0327),
        ],
        all_lengths: 0xc577_3d36_819e_e0ed,
    },
];

/// They may change when the arithmetic is changed on purpose (another order of summation, another
/// polynomial). Then check the new kernel against the reference, take the numbers from the failure
/// message, and say in the changelog that runs no longer repeat those of earlier versions.
/// A change that was not meant to touch the arithmetic must not change them; nor may another
/// compiler, operating system or processor.
#[test]
fn the_bits_of_this_version() {
    for Bits { coupling, lengths, all_lengths } in BITS {
        // Every open parameter is written out, so that a recalibration of the defaults does not
        // change them.
        let parameters = ArmParameters {
            base_coupling: coupling,
            longitudinal_mass_share: 1.0,
            water_density: 1000.0,
            arm_density: 1303.0,
            gravity: [0.0, 0.0, 9.81],
            area_scale: 1.0,
            reference_area: ReferenceArea::Wetted,
            volume_force: VolumeForce::Applied,
            lift_scale: 1.0,
            plane_mass: 0.0.into(),
            plane_inertia: 0.0.into(),
            compartments: 20,
            timestep: 1e-3,
            servo_frequency: 12.0,
            ..ArmParameters::default()
        };
        let mut arm = Arm::undeformed(parameters, Actuator::Servo).unwrap();
        let push: Vec<f64> = (0..80).map(|i| 0.03 * f64::from(i % 7) - 0.1).collect();
        let spread: Vec<f64> = (0..80).map(|i| 0.04 * f64::from(i % 5) - 0.1).collect();
        arm.set_muscles(&push, &spread).unwrap();
        let mut hash = 0xcbf2_9ce4_8422_2325_u64;
        for command in commands(Actuator::Servo, 1000, 12) {
            arm.step(command).unwrap();
            for byte in arm.lengths().iter().flat_map(|length| length.to_le_bytes()) {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        }
        let last = arm.lengths();
        let found = lengths.map(|(index, _)| (index, last[index].to_bits()));
        assert_eq!(
            found,
            lengths,
            "{coupling:?}: found {found:#x?}, which are {:?} m",
            found.map(|(i, _)| last[i])
        );
        assert_eq!(hash, all_lengths, "{coupling:?}: found {hash:#018x}; the last lengths agree");
    }
}
