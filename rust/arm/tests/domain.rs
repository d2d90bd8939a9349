//! Where the model ends, it says so and stays where it was.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

mod common;

use std::f64::consts::FRAC_PI_4;

use common::{SplitMix64, arm_bits, numbers};
use octoarm_arm::{
    Actuator, Arm, ArmParameters, ArmState, COMMAND_LIMIT, Limit, ParameterError, check_command,
    domain,
};

fn random_command(random: &mut SplitMix64, amplitude: f64) -> [f64; 2] {
    [amplitude * random.symmetric(), amplitude * random.symmetric()]
}

fn resting(actuator: Actuator) -> Arm {
    Arm::undeformed(ArmParameters::default(), actuator).unwrap()
}

/// An arm that its base carries along: one that can be thrown about.
fn carried(actuator: Actuator) -> Arm {
    Arm::undeformed(ArmParameters::inertial(), actuator).unwrap()
}

fn assert_finite(arm: &Arm) {
    let all = [numbers(&arm.state()), arm.lengths()].concat();
    assert!(all.iter().all(|value| value.is_finite()));
}

#[test]
fn violent_commands_on_a_direct_base_end_in_a_domain_error() {
    // ±30° mostly fail at the first command; ±2° last 5 to 36 commands and ±1° 62 to 117, so that
    // the arm is well in motion. (±0.5° it bears for good.)
    for (amplitude, most) in [(30.0, 10), (2.0, 100), (1.0, 300)] {
        for seed in 0..20 {
            fail_and_recover(amplitude, most, seed);
        }
    }
}

fn fail_and_recover(amplitude: f64, most: u32, seed: u64) {
    let name = format!("±{amplitude}°, seed {seed}");
    let mut random = SplitMix64(seed);
    let mut arm = carried(Actuator::Direct);
    let mut made = 0;
    let (before, failure) = loop {
        let before = arm_bits(&arm);
        match arm.step(random_command(&mut random, amplitude)) {
            Ok(()) => made += 1,
            Err(failure) => break (before, failure),
        }
        assert!(made < most, "{name}: still in the domain");
    };
    assert_eq!(arm_bits(&arm), before, "{name}: the failing step left a trace");
    assert_finite(&arm);

    // The time at which the failing step would have ended.
    assert_eq!(failure.time, f64::from(made + 1) * 1e-3, "{name}");
    assert!((1..=20).contains(&failure.compartment), "{name}: {failure}");
    assert!(!(failure.low..=failure.high).contains(&failure.value), "{name}: {failure}");
    let message = failure.to_string();
    for part in [
        failure.limit.name().to_owned(),
        format!("compartment {}", failure.compartment),
        format!("t = {:.4} s", failure.time),
    ] {
        assert!(message.contains(&part), "{name}: {message}");
    }

    // Holding the base still, the arm may calm down or fail again, but cleanly.
    let still = arm.base_degrees();
    for _ in 0..100 {
        let before = arm_bits(&arm);
        if arm.step(still).is_err() {
            assert_eq!(arm_bits(&arm), before, "{name}");
        }
        assert_finite(&arm);
    }
    // After a reset it is as new.
    arm.reset_undeformed();
    let mut new = carried(Actuator::Direct);
    for _ in 0..20 {
        arm.step([0.1, -0.1]).unwrap();
        new.step([0.1, -0.1]).unwrap();
    }
    assert_eq!(arm_bits(&arm), arm_bits(&new), "{name}");
}

#[test]
fn commands_that_are_not_finite_are_errors() {
    for actuator in [Actuator::Direct, Actuator::Servo] {
        let mut arm = resting(actuator);
        for _ in 0..20 {
            arm.step([0.1, 0.1]).unwrap();
        }
        let before = arm_bits(&arm);
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for command in [[value, 0.0], [0.0, value], [value, value]] {
                let failure = arm.step(command).expect_err("no angle at all");
                assert_eq!(failure.limit, Limit::NotFinite, "{actuator:?}, {command:?}");
                assert_eq!(arm_bits(&arm), before, "{actuator:?}, {command:?}");
            }
        }
        arm.step([0.1, 0.1]).unwrap();
    }
}

/// Finite angles of any size.
const FAR: [f64; 8] = [f64::MAX, f64::MIN, 1e300, -1e300, 1e154, 1e30, -1e9, 1e5];

#[test]
fn commands_out_of_this_world_end_in_an_error() {
    for actuator in [Actuator::Direct, Actuator::Servo] {
        let mut arm = carried(actuator);
        for _ in 0..20 {
            arm.step([0.1, 0.1]).unwrap();
        }
        let start = arm.state();
        for value in FAR {
            for command in [[value, 0.0], [0.0, value], [value, value]] {
                arm.set_state(&start).unwrap();
                // A direct base fails at once, the servo when it has gathered speed.
                let mut failed = false;
                for _ in 0..100 {
                    let before = arm_bits(&arm);
                    if arm.step(command).is_err() {
                        failed = true;
                        assert_eq!(arm_bits(&arm), before, "{actuator:?}, {command:?}");
                    }
                    assert_finite(&arm);
                }
                assert!(failed, "{actuator:?}, {command:?}");
            }
        }
    }
}

#[test]
fn a_command_can_be_checked_beforehand() {
    for (name, index) in [("theta", 0), ("phi", 1)] {
        for value in [f64::NAN, f64::INFINITY, -1e300, COMMAND_LIMIT * (1.0 + f64::EPSILON)] {
            let mut command = [0.0; 2];
            command[index] = value;
            let message = check_command(command).expect_err("too far").to_string();
            assert!(message.starts_with(&format!("{name} = {value}")), "{message}");
        }
    }
    assert_eq!(check_command([COMMAND_LIMIT, -COMMAND_LIMIT]), Ok(()));
}

#[test]
fn a_run_says_how_far_it_came() {
    let mut arm = resting(Actuator::Direct);
    let mut lengths = vec![-1.0; 5 * 80];
    let commands = [[0.1, 0.0], [0.2, 0.0], [f64::NAN, 0.0], [0.3, 0.0], [0.4, 0.0]];
    let (made, failure) = arm.run(&commands, &mut lengths).expect_err("not a number");
    assert_eq!((made, failure.limit, failure.time), (2, Limit::NotFinite, 0.003));
    assert_eq!(arm.state().steps, 2);
    assert_eq!(lengths[80..160], arm.lengths());
    assert!(lengths[160..].iter().all(|length| *length == -1.0));
}

/// Largest and smallest values that the domain limits.
#[derive(Debug)]
struct Extremes {
    bend: f64,
    height: (f64, f64),
    radius: (f64, f64),
    length: (f64, f64),
}

impl Extremes {
    fn new() -> Self {
        let none = (f64::INFINITY, f64::NEG_INFINITY);
        Self { bend: 0.0, height: none, radius: none, length: none }
    }

    fn note(&mut self, arm: &Arm) {
        let widen = |range: &mut (f64, f64), value: f64| {
            *range = (range.0.min(value), range.1.max(value));
        };
        let p = arm.parameters();
        for (j, q) in arm.state().coordinates.iter().enumerate() {
            self.bend = self.bend.max(q[1].abs()).max(q[2].abs());
            widen(&mut self.height, q[0] / p.rest_height());
            for radius in &q[3..] {
                widen(&mut self.radius, radius / p.rest_radius(j + 1));
            }
        }
        for length in arm.lengths() {
            widen(&mut self.length, length / p.rest_length);
        }
    }
}

#[test]
fn the_servo_keeps_random_commands_in_the_domain() {
    let mut extremes = Extremes::new();
    for seed in 1..=3 {
        let mut random = SplitMix64(seed);
        let mut arm = carried(Actuator::Servo);
        let mut command = [0.0; 2];
        for step in 0..40_000 {
            if step % 10 == 0 {
                command = random_command(&mut random, 60.0);
            }
            arm.step(command).unwrap_or_else(|failure| panic!("seed {seed}: {failure}"));
            extremes.note(&arm);
        }
    }
    println!("{extremes:?}");
    // Measured: bend 1.12 rad, heights 0.863 to 1.278, radii 0.881 to 1.102, lengths 0.552 to 1.743
    // of rest; over twenty other seeds 1.15 rad, 0.895 to 1.312, 0.869 to 1.097, 0.537 to 1.758. The
    // bounds leave room for that and lie well within the domain's.
    let within = |(low, high): (f64, f64), bounds: (f64, f64)| low > bounds.0 && high < bounds.1;
    assert!(extremes.bend < 1.4, "{extremes:?}");
    assert!(within(extremes.height, (0.8, 1.4)), "{extremes:?}");
    assert!(within(extremes.radius, (0.8, 1.2)), "{extremes:?}");
    assert!(within(extremes.length, (0.45, 1.9)), "{extremes:?}");
    const { assert!(domain::BEND_ANGLE > 1.4 && domain::HEIGHT.0 < 0.8 && domain::HEIGHT.1 > 1.4) };
    const { assert!(domain::RADIUS.0 < 0.8 && domain::RADIUS.1 > 1.2) };
    const { assert!(domain::SPRING_LENGTH.0 < 0.45 && domain::SPRING_LENGTH.1 > 1.9) };
}

/// A valid state with one thing wrong.
fn spoilt(arm: &Arm, spoil: impl Fn(&mut ArmState)) -> ArmState {
    let mut state = arm.state();
    spoil(&mut state);
    state
}

#[test]
fn a_state_that_cannot_be_is_refused_and_changes_nothing() {
    let mut arm = resting(Actuator::Servo);
    for _ in 0..100 {
        arm.step([20.0, -10.0]).unwrap();
    }
    let before = arm_bits(&arm);
    let height = arm.parameters().rest_height();
    let cases: Vec<(&str, ArmState)> = vec![
        ("state.coordinates", spoilt(&arm, |s| s.coordinates.truncate(19))),
        ("state.coordinates", spoilt(&arm, |s| s.coordinates.push(s.coordinates[0]))),
        ("state.coordinates", spoilt(&arm, |s| s.coordinates.clear())),
        ("state.rates", spoilt(&arm, |s| s.rates.truncate(1))),
        ("state.rates", spoilt(&arm, |s| s.rates.push([0.0; 7]))),
        ("state.coordinates[3, 2]", spoilt(&arm, |s| s.coordinates[3][2] = f64::NAN)),
        ("state.rates[19, 6]", spoilt(&arm, |s| s.rates[19][6] = f64::INFINITY)),
        ("state.base[1]", spoilt(&arm, |s| s.base[1] = f64::NAN)),
        ("state.base[3]", spoilt(&arm, |s| s.base[3] = f64::NEG_INFINITY)),
        ("state: bend_angle of compartment 5", spoilt(&arm, |s| s.coordinates[4][1] = 2.62)),
        ("state: bend_angle of compartment 20", spoilt(&arm, |s| s.coordinates[19][2] = -2.62)),
        ("state: height of compartment 1", spoilt(&arm, |s| s.coordinates[0][0] = -height)),
        ("state: height of compartment 9", spoilt(&arm, |s| s.coordinates[8][0] = 3.1 * height)),
        ("state: height of compartment 9", spoilt(&arm, |s| s.coordinates[8][0] = 1e300)),
        ("state: radius of compartment 2", spoilt(&arm, |s| s.coordinates[1][5] *= 0.19)),
        ("state: radius of compartment 2", spoilt(&arm, |s| s.coordinates[1][5] *= 3.1)),
        // Bent by 45°, a ceiling joint 0.015 √2 m out stands on its floor joint: no length left.
        (
            "state: spring_length of compartment 1",
            spoilt(&arm, |s| {
                s.coordinates[0] = [0.015, 0.0, FRAC_PI_4, 0.0212, 0.0146, 0.0146, 0.0146];
            }),
        ),
    ];
    for (name, state) in cases {
        let refusal = arm.set_state(&state).expect_err(name);
        let found = match &refusal {
            ParameterError::OutOfRange { name, .. }
            | ParameterError::NotFinite { name, .. }
            | ParameterError::Shape { name, .. } => name,
            other => panic!("{name}: {other}"),
        };
        assert_eq!(found, name, "{refusal}");
        assert_eq!(arm_bits(&arm), before, "{name}: the refused state left a trace");
    }
    // The arm goes on as if nothing had been tried.
    let mut untouched = resting(Actuator::Servo);
    for _ in 0..100 {
        untouched.step([20.0, -10.0]).unwrap();
    }
    for _ in 0..100 {
        arm.step([-20.0, 30.0]).unwrap();
        untouched.step([-20.0, 30.0]).unwrap();
    }
    assert_eq!(arm_bits(&arm), arm_bits(&untouched));
}

#[test]
fn finite_rates_of_any_size_are_a_state_and_then_an_error() {
    for rate in [1e3, 1e30, 1e160, f64::MAX] {
        for index in 0..7 {
            let mut arm = resting(Actuator::Servo);
            let state = spoilt(&arm, |s| s.rates[10][index] = rate);
            arm.set_state(&state).unwrap();
            let before = arm_bits(&arm);
            arm.step([0.0; 2]).expect_err("a speed out of this world");
            assert_eq!(arm_bits(&arm), before);
        }
    }
}

#[test]
fn a_state_may_be_of_any_age() {
    let mut arm = resting(Actuator::Servo);
    let state = spoilt(&arm, |s| s.steps = u64::MAX);
    // Accepted or refused, but without a panic.
    if arm.set_state(&state).is_ok() {
        let _ = arm.step([0.0; 2]);
    }
    assert_finite(&arm);
}

#[test]
fn muscles_of_the_wrong_shape_or_size_are_refused() {
    let mut arm = resting(Actuator::Servo);
    arm.set_muscles(&[0.01; 80], &[0.02; 80]).unwrap();
    let mut not_a_number = [0.0; 80];
    not_a_number[79] = f64::NAN;
    let refused = [
        ("longitudinal has shape (79,)", arm.set_muscles(&[0.0; 79], &[0.0; 80])),
        ("transverse has shape (81,)", arm.set_muscles(&[0.0; 80], &[0.0; 81])),
        (
            "longitudinal[19, 3] = NaN is not a finite number",
            arm.set_muscles(&not_a_number, &[0.0; 80]),
        ),
        (
            "transverse[19, 3] = NaN is not a finite number",
            arm.set_muscles(&[0.0; 80], &not_a_number),
        ),
    ];
    for (start, refusal) in refused {
        let message = refusal.expect_err(start).to_string();
        assert!(message.starts_with(start), "{message}");
    }
    assert_eq!(arm.muscles(), (vec![0.01; 80], vec![0.02; 80]));
    // Muscles that tear the arm apart end in an error.
    arm.set_muscles(&[1e300; 80], &[-1e300; 80]).unwrap();
    let before = arm_bits(&arm);
    arm.step([0.0; 2]).expect_err("torn apart");
    assert_eq!(arm_bits(&arm), before);
}
