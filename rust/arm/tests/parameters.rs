//! Parameters: what is refused and in which words, files, and bodies of every length.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;
mod reference;

use common::{arm_in, random_state, uneven};
use octoarm_arm::{
    Actuator, Arm, ArmParameters, BaseCoupling, BaseMotion, ParameterError, PerCompartment,
    ReferenceArea, VolumeForce,
};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use reference::{BaseSample, Reference};
use serde_json::Value;

type Field = fn(&mut ArmParameters) -> &mut f64;

fn same(value: &mut PerCompartment) -> &mut f64 {
    match value {
        PerCompartment::Same(value) => value,
        PerCompartment::Each(values) => panic!("a list: {values:?}"),
    }
}

/// A scalar, its lower limit, whether that limit is itself allowed, and its upper limit.
const SCALARS: [(&str, Field, f64, bool, f64); 20] = [
    ("rest_length", |p| &mut p.rest_length, 0.0, false, 10.0),
    ("base_radius", |p| &mut p.base_radius, 0.0, false, 10.0),
    ("tip_radius", |p| &mut p.tip_radius, 0.0, false, 10.0),
    ("longitudinal_mass", |p| same(&mut p.longitudinal_mass), 0.0, false, 100.0),
    ("transverse_mass", |p| same(&mut p.transverse_mass), 0.0, true, 100.0),
    ("longitudinal_mass_share", |p| &mut p.longitudinal_mass_share, 1.0 / 3.0, true, 1.0),
    ("longitudinal_damping", |p| same(&mut p.longitudinal_damping), 0.0, true, 1e6),
    ("transverse_damping", |p| same(&mut p.transverse_damping), 0.0, true, 1e6),
    ("longitudinal_stiffness", |p| same(&mut p.longitudinal_stiffness), 0.0, false, 1e9),
    ("transverse_stiffness", |p| same(&mut p.transverse_stiffness), 0.0, false, 1e9),
    ("longitudinal_volume_gain", |p| &mut p.longitudinal_volume_gain, 0.0, true, 1e12),
    ("transverse_volume_gain", |p| &mut p.transverse_volume_gain, 0.0, true, 1e12),
    ("water_density", |p| &mut p.water_density, 0.0, true, 1e5),
    ("arm_density", |p| &mut p.arm_density, 0.0, true, 1e5),
    ("area_scale", |p| &mut p.area_scale, 0.0, true, 1e4),
    ("lift_scale", |p| &mut p.lift_scale, -1e4, true, 1e4),
    ("plane_mass", |p| same(&mut p.plane_mass), 0.0, true, 100.0),
    ("plane_inertia", |p| same(&mut p.plane_inertia), 0.0, true, 100.0),
    ("timestep", |p| &mut p.timestep, 0.0, false, 0.1),
    ("servo_frequency", |p| &mut p.servo_frequency, 0.0, false, 1e4),
];
const ARRAYS: [&str; 3] = ["gravity", "drag_coefficients", "lift_coefficients"];
const CHOICES: [(&str, [&str; 2]); 3] = [
    ("base_coupling", ["gravity", "inertial"]),
    ("reference_area", ["wetted", "planform"]),
    ("volume_force", ["applied", "total"]),
];

fn default_json() -> serde_json::Map<String, Value> {
    let text = ArmParameters::default().to_json().unwrap();
    let Value::Object(fields) = serde_json::from_str(&text).unwrap() else { panic!("{text}") };
    fields
}

fn parse(fields: &serde_json::Map<String, Value>) -> Result<ArmParameters, ParameterError> {
    ArmParameters::from_json(&serde_json::to_string(fields).unwrap())
}

/// The name in an out-of-range error.
fn out_of_range(result: Result<(), ParameterError>) -> String {
    match result {
        Err(ParameterError::OutOfRange { name, .. }) => name,
        other => panic!("not out of range: {other:?}"),
    }
}

#[test]
fn these_tests_know_every_field() {
    let mut known: Vec<&str> = SCALARS.iter().map(|scalar| scalar.0).collect();
    known.extend(ARRAYS);
    known.extend(CHOICES.map(|choice| choice.0));
    known.push("compartments");
    known.sort_unstable();
    let mut found: Vec<String> = default_json().keys().cloned().collect();
    found.sort_unstable();
    assert_eq!(found, known, "a new parameter needs its range here");
}

#[test]
fn every_scalar_out_of_range_is_refused_by_name() {
    for (name, field, low, low_allowed, high) in SCALARS {
        let below = low.next_down();
        let mut bad = vec![below, high.next_up(), -1e300, 1e300, f64::MIN, f64::MAX];
        bad.extend([f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
        if !low_allowed {
            bad.push(low);
            bad.push(-0.0);
        }
        for value in bad {
            let mut parameters = ArmParameters::default();
            *field(&mut parameters) = value;
            let refusal = parameters.validate();
            let bracket = if low_allowed { '[' } else { '(' };
            let words =
                format!("{name} = {value} is outside the allowed range {bracket}{low}, {high}]");
            assert_eq!(refusal.as_ref().unwrap_err().to_string(), words);
            assert_eq!(out_of_range(refusal), name);
            // No arm is built of it, and no file with it is read.
            assert!(Arm::undeformed(parameters, Actuator::Direct).is_err(), "{name}");
            if value.is_finite() {
                let mut fields = default_json();
                fields[name] = value.into();
                assert_eq!(out_of_range(parse(&fields).map(drop)), name);
            }
        }
    }
}

#[test]
fn the_limits_themselves_are_allowed() {
    for (name, field, low, low_allowed, high) in SCALARS {
        let mut edges = vec![high];
        if low_allowed {
            edges.push(low);
        }
        for value in edges {
            let mut parameters = ArmParameters::default();
            *field(&mut parameters) = value;
            // One field is tied to others: the taper must be shorter than a spring.
            match parameters.validate() {
                Err(refusal) if name.ends_with("_radius") => {
                    assert_eq!(out_of_range(Err(refusal)), "rest_length");
                }
                validity => assert_eq!(validity, Ok(()), "{name} = {value}"),
            }
        }
    }
}

#[test]
fn every_entry_of_a_list_for_the_compartments_is_checked() {
    let nominal = ArmParameters { compartments: 3, ..ArmParameters::default() };
    for (name, value, _) in nominal.per_compartment() {
        let (_, _, low, low_allowed, high) = SCALARS.into_iter().find(|row| row.0 == name).unwrap();
        let read = |list: Value| {
            let mut fields = default_json();
            fields["compartments"] = 3.into();
            fields[name] = list;
            parse(&fields)
        };
        let fit = value.at(0);
        assert!(read(vec![fit, high, fit].into()).is_ok(), "{name}");
        for index in 0..3 {
            let mut list = vec![fit; 3];
            list[index] = high.next_up();
            let bracket = if low_allowed { '[' } else { '(' };
            let words = format!(
                "{name}[{index}] = {} is outside the allowed range {bracket}{low}, {high}]",
                high.next_up()
            );
            assert_eq!(read(list.into()).unwrap_err().to_string(), words);
        }
        for length in [0, 2, 4, 20] {
            let message = read(vec![fit; length].into()).unwrap_err().to_string();
            assert!(message.starts_with(&format!("{name} has shape ({length},), expected (3,)")));
        }
        for (given, words) in [
            (
                serde_json::json!("soft"),
                "invalid type: string \"soft\", expected a number, or a list",
            ),
            (Value::Null, "invalid type: null, expected a number, or a list"),
            (true.into(), "invalid type: boolean `true`, expected a number, or a list"),
            (serde_json::json!([fit, [fit], fit]), "invalid type: sequence, expected f64"),
        ] {
            let message = read(given).unwrap_err().to_string();
            assert!(message.starts_with(name) && message.contains(words), "{message}");
        }
    }
}

#[test]
fn a_list_of_equal_numbers_is_the_number() {
    let number = ArmParameters { plane_mass: 0.01.into(), ..ArmParameters::default() };
    let fields = serde_json::to_value(&number).unwrap();
    for (name, value, _) in number.per_compartment() {
        let mut fields = fields.clone();
        fields[name] = vec![value.at(0); number.compartments].into();
        let list = ArmParameters::from_json(&fields.to_string()).unwrap();
        assert_ne!(list, number);
        let mut arms =
            [&list, &number].map(|body| Arm::new(body.clone(), Actuator::Servo).unwrap());
        for step in 0..100 {
            arms.iter_mut().for_each(|arm| arm.step([f64::from(step % 7), 10.0]).unwrap());
        }
        assert_eq!(arms[0].state(), arms[1].state(), "{name}");
    }
}

#[test]
fn files_keep_every_entry_of_a_list() {
    let body = uneven(&ArmParameters::default(), 9);
    assert_eq!(ArmParameters::from_json(&body.to_json().unwrap()), Ok(body));
}

#[test]
fn every_entry_of_an_array_is_checked() {
    for name in ARRAYS {
        let length = default_json()[name].as_array().unwrap().len();
        for index in 0..length {
            for value in [-1e300, -1000.0001, 1000.0001, 1e300] {
                let mut fields = default_json();
                fields[name][index] = value.into();
                assert_eq!(out_of_range(parse(&fields).map(drop)), format!("{name}[{index}]"));
            }
        }
        for entries in [length - 1, length + 1] {
            let mut fields = default_json();
            fields[name] = vec![0.0; entries].into();
            let message = parse(&fields).unwrap_err().to_string();
            assert!(message.starts_with(&format!("{name}: ")), "{message}");
        }
    }
    let parameters = ArmParameters { gravity: [0.0, f64::NAN, 0.0], ..Default::default() };
    assert_eq!(out_of_range(parameters.validate()), "gravity[1]");
    let mut parameters = ArmParameters::default();
    parameters.drag_coefficients[4] = f64::NAN;
    assert_eq!(out_of_range(parameters.validate()), "drag_coefficients[4]");
    parameters = ArmParameters::default();
    parameters.lift_coefficients[0] = f64::NAN;
    assert_eq!(out_of_range(parameters.validate()), "lift_coefficients[0]");
}

#[test]
fn the_number_of_compartments_has_limits() {
    let most = ArmParameters::MAX_COMPARTMENTS;
    for compartments in [0, most + 1, usize::MAX] {
        let parameters = ArmParameters { compartments, ..Default::default() };
        let message = parameters.validate().unwrap_err().to_string();
        let words =
            format!("compartments = {compartments} is outside the allowed range [1, {most}]");
        assert_eq!(message, words);
    }
    for text in ["-1", "2.5", "\"20\"", "null", "1e3", "99999999999999999999999"] {
        let refusal = ArmParameters::from_json(&format!("{{\"compartments\": {text}}}"));
        assert!(matches!(refusal, Err(ParameterError::Format(_))), "{text}: {refusal:?}");
    }
    let parameters = ArmParameters { compartments: most, ..Default::default() };
    let mut arm = Arm::undeformed(parameters, Actuator::Servo).unwrap();
    for _ in 0..10 {
        arm.step([5.0, 5.0]).unwrap();
    }
    assert_eq!(arm.lengths().len(), 4 * most);
}

#[test]
fn a_taper_longer_than_the_springs_is_refused() {
    let steep = ArmParameters { base_radius: 0.5, tip_radius: 0.05, ..Default::default() };
    assert_eq!(out_of_range(steep.validate()), "rest_length");
    let widening = ArmParameters { base_radius: 0.05, tip_radius: 0.5, ..Default::default() };
    assert_eq!(out_of_range(widening.validate()), "rest_length");
    // An arm that widens towards its tip is a body like any other.
    let trumpet = ArmParameters { base_radius: 0.0067, tip_radius: 0.015, ..Default::default() };
    assert_eq!(trumpet.validate(), Ok(()));
}

#[test]
fn fields_left_out_take_their_defaults() {
    assert_eq!(ArmParameters::from_json("{}"), Ok(ArmParameters::default()));
    for name in default_json().keys() {
        let mut fields = default_json();
        fields.remove(name);
        assert_eq!(parse(&fields), Ok(ArmParameters::default()), "without {name}");
    }
    let one = ArmParameters::from_json(r#"{"arm_density": 1042}"#).unwrap();
    assert_eq!(one, ArmParameters { arm_density: 1042.0, ..Default::default() });
}

#[test]
fn text_that_is_no_parameters_is_refused() {
    for text in ["", "{", "[1, 2", "null", "3", "\"default\"", "{\"timestep\": \"1 ms\"}", "{} {}"]
    {
        let refusal = ArmParameters::from_json(text);
        assert!(matches!(refusal, Err(ParameterError::Format(_))), "{text}: {refusal:?}");
    }
    for name in default_json().keys() {
        let mut fields = default_json();
        fields[name] = Value::Bool(true);
        assert!(matches!(parse(&fields), Err(ParameterError::Format(_))), "{name}");
        // A name misspelt is a name unknown, and is said.
        let mut fields = default_json();
        let value = fields.remove(name).unwrap();
        fields.insert(format!("{name}s"), value);
        let message = parse(&fields).unwrap_err().to_string();
        assert!(message.contains(&format!("{name}s")), "{message}");
    }
    for (name, choices) in CHOICES {
        for choice in choices {
            let mut fields = default_json();
            fields[name] = choice.into();
            assert!(parse(&fields).is_ok(), "{name}: {choice}");
        }
        let mut fields = default_json();
        fields[name] = "neither".into();
        let message = parse(&fields).unwrap_err().to_string();
        assert!(message.contains("neither") && message.contains(choices[0]), "{message}");
    }
}

#[test]
fn numbers_that_are_not_finite_have_no_json() {
    // JSON has no NaN; `null` in its place does not come back as a number.
    let parameters = ArmParameters { timestep: f64::NAN, ..Default::default() };
    let text = parameters.to_json().unwrap();
    assert!(matches!(ArmParameters::from_json(&text), Err(ParameterError::Format(_))), "{text}");
}

/// Any valid body: every scalar of any magnitude in its range, some on a limit.
fn valid_parameters() -> impl Strategy<Value = ArmParameters> {
    let magnitude = (-12.0..0.0_f64).prop_map(|exponent| 10.0_f64.powf(exponent));
    let share = prop_oneof![8 => magnitude, 1 => Just(0.0), 1 => Just(1.0)];
    let scalars = prop::collection::vec(share, SCALARS.len());
    let gravity = prop::array::uniform3(-1e3..1e3_f64);
    let lift = prop::array::uniform5(-1e3..1e3_f64);
    let drag = prop::array::uniform5(0.0..1e3_f64);
    let choices = (any::<[bool; 3]>(), 1..=ArmParameters::MAX_COMPARTMENTS);
    (scalars, gravity, lift, drag, choices)
        .prop_map(|(scalars, gravity, lift_coefficients, drag_coefficients, choices)| {
            let ([gravity_only, wetted, applied], compartments) = choices;
            let mut parameters = ArmParameters {
                base_coupling: if gravity_only {
                    BaseCoupling::Gravity
                } else {
                    BaseCoupling::Inertial
                },
                gravity,
                lift_coefficients,
                drag_coefficients,
                reference_area: if wetted {
                    ReferenceArea::Wetted
                } else {
                    ReferenceArea::Planform
                },
                volume_force: if applied { VolumeForce::Applied } else { VolumeForce::Total },
                compartments,
                ..ArmParameters::default()
            };
            for ((_, field, low, _, high), share) in SCALARS.into_iter().zip(scalars) {
                *field(&mut parameters) = low + share * (high - low);
            }
            parameters
        })
        .prop_filter("out of range", |parameters| parameters.validate().is_ok())
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 256,
        rng_seed: RngSeed::Fixed(3),
        failure_persistence: None,
        max_global_rejects: 100_000,
        ..ProptestConfig::default()
    })]

    #[test]
    fn json_gives_the_same_bits_back(parameters in valid_parameters()) {
        let text = parameters.to_json().unwrap();
        let back = ArmParameters::from_json(&text).unwrap();
        prop_assert_eq!(&back, &parameters);
        // `==` takes −0 for 0; the text does not.
        prop_assert_eq!(back.to_json().unwrap(), text);
    }

    /// Whatever the body: steps, or an error, or a refusal; no panic, and never a NaN.
    #[test]
    fn no_body_makes_the_arm_panic(parameters in valid_parameters(), command in -90.0..90.0_f64) {
        for actuator in [Actuator::Direct, Actuator::Servo] {
            let mut arm = Arm::undeformed(parameters.clone(), actuator).unwrap();
            for _ in 0..3 {
                let before = arm.state();
                if arm.step([command, -0.5 * command]).is_err() {
                    prop_assert_eq!(arm.state(), before);
                }
                prop_assert!(arm.lengths().iter().all(|length| length.is_finite()));
                prop_assert!(arm.state().validate(parameters.compartments).is_ok());
            }
        }
    }
}

#[test]
fn arms_of_every_length_agree_with_the_reference() {
    // Around the kernel's rows of eight: one and two compartments, a row less one, a row, a row and
    // one, two rows, and several.
    for compartments in [1, 2, 7, 8, 9, 16, 24, 40] {
        let parameters = ArmParameters {
            compartments,
            volume_force: VolumeForce::Total,
            gravity: [1.0, -2.0, 9.0],
            plane_mass: 0.01.into(),
            plane_inertia: 1e-6.into(),
            ..ArmParameters::default()
        };
        let state = random_state(&parameters, compartments as u64, 0.5);
        let mut arm = arm_in(&parameters, Actuator::Servo, &state);
        let count = arm.observation_len();
        assert_eq!(count, 4 * compartments);
        let push: Vec<f64> = (0..count).map(|i| 0.05 * (1.3 * i as f64).sin()).collect();
        let spread: Vec<f64> = (0..count).map(|i| 0.05 * (2.1 * i as f64).cos()).collect();
        arm.set_muscles(&push, &spread).unwrap();
        let mut reference = Reference::new(&parameters, &state);
        for j in 0..compartments {
            for i in 0..4 {
                reference.longitudinal_muscles[j][i] = push[4 * j + i];
                reference.transverse_muscles[j][i] = spread[4 * j + i];
            }
        }
        let sample = |motion: &BaseMotion| BaseSample {
            angle: motion.angle,
            rate: motion.rate,
            acceleration: motion.acceleration,
        };
        let mut worst = 0.0_f64;
        for _ in 0..10 {
            let motion = arm.base_motion([20.0, -15.0]);
            arm.step([20.0, -15.0]).unwrap();
            reference.step(&[sample(&motion[0]), sample(&motion[1]), sample(&motion[2])]);
            for (fast, slow) in arm.lengths().iter().zip(reference.lengths(motion[2].angle)) {
                worst = worst.max((fast - slow).abs());
            }
        }
        // Rounding alone. Most of it is the reference's, whose dense mass matrix grows ill-conditioned
        // with the arm: 1e-17 m for one compartment, 9e-17 for 16, 6e-15 for 40 measured.
        assert!(worst < 1e-13, "{compartments} compartments: {worst:e} m");
        assert_eq!(arm.positions().len(), compartments + 1);
    }
}
