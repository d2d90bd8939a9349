//! What a turning base does to the arm, in the paper's reading and in the world.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use common::{SplitMix64, arm_in, random_state};
use octoarm_arm::{Actuator, Arm, ArmParameters, BaseCoupling};

fn pair(parameters: &ArmParameters) -> [ArmParameters; 2] {
    [BaseCoupling::Gravity, BaseCoupling::Inertial]
        .map(|base_coupling| ArmParameters { base_coupling, ..parameters.clone() })
}

fn paper() -> ArmParameters {
    ArmParameters::preset("nakajima2013").unwrap()
}

#[test]
fn with_a_still_base_both_couplings_have_the_same_bits() {
    let [mut gravity, mut inertial] = pair(&paper()).map(|parameters| {
        let mut state = random_state(&parameters, 5, 0.3);
        state.base = [0.4, -0.3, 0.0, 0.0];

        arm_in(&parameters, Actuator::Direct, &state)
    });
    // Degrees and radians do not give the angle back to the bit; the first step moves the base by it.
    let command = gravity.base_degrees();
    let radians = command.map(f64::to_radians);
    for arm in [&mut gravity, &mut inertial] {
        let mut state = arm.state();
        state.base = [radians[0], radians[1], 0.0, 0.0];
        arm.set_state(&state).unwrap();
    }
    for _ in 0..500 {
        gravity.step(command).unwrap();
        inertial.step(command).unwrap();
    }
    let bits = |arm: &Arm| arm.lengths().iter().map(|length| length.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&gravity), bits(&inertial));
}

#[test]
fn without_gravity_a_turning_base_moves_nothing_in_its_frame() {
    let parameters = ArmParameters { gravity: [0.0; 3], ..paper() };
    let [mut gravity, mut inertial] =
        pair(&parameters).map(|parameters| Arm::new(parameters, Actuator::Direct).unwrap());
    let rest = gravity.lengths();
    for step in 0..500_u32 {
        let command = [20.0 * (0.02 * f64::from(step)).sin(), 0.1 * f64::from(step)];
        gravity.step(command).unwrap();
        inertial.step(command).unwrap();
    }
    assert_eq!(gravity.lengths(), rest);
    let moved =
        inertial.lengths().iter().zip(&rest).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(moved > 1e-5, "{moved:e}");
    // The picture turns all the same: the arm points where its base points.
    let tip = gravity.positions()[20];
    let [theta, phi] = gravity.base_degrees().map(f64::to_radians);
    let axis = [phi.sin(), -theta.sin() * phi.cos(), theta.cos() * phi.cos()];
    let along: f64 = tip.iter().zip(axis).map(|(a, b)| a * b).sum();
    let length = tip.iter().map(|x| x * x).sum::<f64>().sqrt();
    assert!((along / length - 1.0).abs() < 1e-12 && length > 0.3);
}

#[test]
fn noise_of_a_thousand_degrees_stays_in_the_domain() {
    for seed in 0..3 {
        let mut arm = Arm::new(paper(), Actuator::Direct).unwrap();
        let mut noise = SplitMix64(seed);
        for step in 0..10_000 {
            let command = [1000.0 * noise.symmetric(), 1000.0 * noise.symmetric()];
            arm.step(command).unwrap_or_else(|error| panic!("seed {seed}, step {step}: {error}"));
        }
    }
}

#[test]
fn a_state_is_restored_to_the_bit() {
    for parameters in pair(&paper()) {
        let mut arm = Arm::new(parameters.clone(), Actuator::Direct).unwrap();
        let command = |step: u32| [30.0 * (0.01 * f64::from(step)).sin(), -0.05 * f64::from(step)];
        (0..200).for_each(|step| arm.step(command(step)).unwrap());
        let mut again = Arm::undeformed(parameters, Actuator::Direct).unwrap();
        again.set_state(&arm.state()).unwrap();
        (200..400).for_each(|step| {
            arm.step(command(step)).unwrap();
            again.step(command(step)).unwrap();
        });
        assert_eq!(arm.state(), again.state());
    }
}
