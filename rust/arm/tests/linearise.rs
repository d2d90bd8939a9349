//! The Jacobians of a step, against steps from displaced states.

#![allow(clippy::unwrap_used)]

mod common;

use common::numbers;
use octoarm_arm::{Actuator, Arm, ArmParameters, ArmState, BaseCoupling};

fn swinging(actuator: Actuator, base_coupling: BaseCoupling, uneven: bool) -> Arm {
    let parameters = ArmParameters { compartments: 6, base_coupling, ..ArmParameters::default() };
    let parameters = if uneven { common::uneven(&parameters, 8) } else { parameters };
    let mut arm = Arm::new(parameters, actuator).unwrap();
    for step in 0..400 {
        let phase = f64::from(step) * 0.01;
        arm.step([15.0 * phase.sin(), 12.0 * phase.cos() - 12.0]).unwrap();
    }
    arm
}

fn displaced(state: &ArmState, by: &[f64]) -> ArmState {
    let mut state = state.clone();
    let numbers = state.coordinates.as_flattened_mut().iter_mut();
    let numbers = numbers.chain(state.rates.as_flattened_mut()).chain(&mut state.base);
    numbers.zip(by).for_each(|(number, by)| *number += by);
    state
}

/// Numbers that look random, about as large as the state's own scales.
fn deviation(size: usize) -> Vec<f64> {
    let wave = |index: usize| (1.7 * index as f64 + 0.3).sin();
    let coordinates =
        (0..size).map(|index| wave(index) * [0.02, 1.0, 1.0, 0.015][(index % 7).min(3)]);
    let coordinates: Vec<f64> = coordinates.collect();
    let rates = coordinates.iter().map(|value| -15.0 * value);
    coordinates.iter().copied().chain(rates).chain([0.3, -0.4, 5.0, -7.0]).collect()
}

#[test]
fn the_map_is_that_of_small_deviations() {
    for actuator in [Actuator::Direct, Actuator::Servo] {
        for coupling in [BaseCoupling::Gravity, BaseCoupling::Inertial] {
            let arm = swinging(actuator, coupling, actuator == Actuator::Servo);
            let command = [-11.4, -19.9];
            let map = arm.linearise(command).unwrap();
            let state = arm.state();
            let direction = deviation(6 * 7);
            let turn = [2.0, -3.0];
            let after = |share: f64| {
                let by: Vec<f64> = direction.iter().map(|value| share * value).collect();
                let mut arm = arm.clone();
                arm.set_state(&displaced(&state, &by)).unwrap();
                let lengths = arm.lengths();
                arm.step([0, 1].map(|axis| command[axis] + share * turn[axis])).unwrap();
                (numbers(&arm.state()), lengths)
            };
            let x = nalgebra::DVector::from_vec(direction.clone());
            let u = nalgebra::DVector::from_row_slice(&turn);
            let next = &map.state * &x + &map.command * &u;
            let stretch = &map.lengths * &x;
            // How far the map is from a central difference along the deviation, as a share of the
            // largest entry of the kind.
            let error = |share: f64| {
                let ((ahead, long), (behind, short)) = (after(share), after(-share));
                let far = |ahead: &[f64], behind: &[f64], map: &[f64]| {
                    let largest = map.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
                    let entries = ahead.iter().zip(behind).zip(map);
                    let errors = entries
                        .map(|((ahead, behind), map)| (ahead - behind) / (2.0 * share) - map);
                    errors.fold(0.0, |most: f64, error| most.max(error.abs())) / largest
                };
                let size = 6 * 7;
                let of = |range: std::ops::Range<usize>| {
                    far(&ahead[range.clone()], &behind[range.clone()], &next.as_slice()[range])
                };
                [of(0..size), of(size..2 * size), far(&long, &short, stretch.as_slice())]
            };
            let errors = error(1e-6);
            assert!(
                errors.iter().all(|error| *error < 1e-8),
                "{actuator:?} {coupling:?}: {errors:?}"
            );
        }
    }
}

#[test]
fn a_direct_base_is_where_it_is_told_to_be() {
    let arm = swinging(Actuator::Direct, BaseCoupling::Gravity, false);
    let map = arm.linearise([10.0, 5.0]).unwrap();
    let base = map.state.nrows() - 4;
    for row in 0..2 {
        for column in 0..2 {
            let expected = if row == column { std::f64::consts::PI / 180.0 } else { 0.0 };
            assert!((map.command[(base + row, column)] - expected).abs() < 1e-9);
        }
        assert!(map.state.row(base + row).iter().all(|value| value.abs() < 1e-9));
    }
}

#[test]
fn nothing_moves_and_what_would_leave_the_domain_is_told() {
    let arm = swinging(Actuator::Servo, BaseCoupling::Gravity, false);
    let before = arm.state();
    assert_eq!(arm.linearise([10.0, 5.0]).unwrap(), arm.linearise([10.0, 5.0]).unwrap());
    assert_eq!(arm.state(), before);
    assert!(arm.linearise([f64::NAN, 0.0]).is_err());
}
