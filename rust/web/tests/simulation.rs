//! The page's whole story, natively: drag, teach, fit, let go, push.

use octoarm_arm::{Actuator, Arm, ArmParameters};
use octoarm_env::{Orbit, TargetName};
use octoarm_web::{Driver, Network, Simulation};

fn taught(noise: f64) -> Simulation {
    let mut simulation = Simulation::new(ArmParameters::default()).expect("arm");
    simulation.begin_lesson(TargetName::Quadratic, 90.0).expect("lesson");
    simulation.advance(20_000).expect("teacher");
    assert_eq!(simulation.lesson_steps(), 16_000);
    // 0.035 degrees by the same fit in NumPy.
    let error = simulation.fit(noise).expect("readout");
    assert!((0.03..0.04).contains(&error), "{error}");
    simulation.let_go().expect("loop");
    simulation
}

/// Largest distance over the next steps, in parts of the amplitude.
fn farthest(simulation: &mut Simulation, steps: usize) -> f64 {
    (0..steps).fold(0.0, |most: f64, _| {
        simulation.advance(1).expect("step");
        most.max(simulation.distance())
    })
}

#[test]
fn a_taught_arm_holds_the_cycle_and_comes_back_after_a_push() {
    let mut simulation = taught(1e-6);
    assert!(farthest(&mut simulation, 5_000) < 0.01);
    simulation.push([40.0, -40.0]).expect("push");
    assert!(farthest(&mut simulation, 200) > 0.1);
    simulation.advance(3_000).expect("recovery");
    assert!(farthest(&mut simulation, 1_000) < 0.01);
    assert_eq!(simulation.driver(), Driver::Readout);
}

#[test]
fn the_teacher_and_the_loop_are_those_of_the_arm() {
    let mut simulation = taught(1e-6);
    let readout = simulation.readout().expect("readout").clone();
    simulation.advance(500).expect("loop");
    let mut arm = Arm::new(ArmParameters::default(), Actuator::Direct).expect("arm");
    let signal = Orbit::teacher_signal(TargetName::Quadratic, 90.0, 20_000).expect("signal");
    for command in signal {
        arm.step(command).expect("step");
    }
    let (mut outputs, mut lengths) = (vec![[0.0; 2]; 500], vec![0.0; 500 * 80]);
    arm.run_closed_loop(&readout, None, &mut outputs, &mut lengths).expect("loop");
    assert_eq!(simulation.lengths(), &lengths[499 * 80..]);
}

#[test]
fn a_hand_leads_the_base_and_no_jump_of_it_breaks_the_arm() {
    for body in ArmParameters::PRESETS {
        let body = ArmParameters::preset(body).expect("body");
        let mut simulation = Simulation::new(body).expect("arm");
        for goal in [[60.0, 0.0], [-60.0, 60.0], [0.0, -60.0], [20.0, 30.0]] {
            simulation.drag(goal).expect("drag");
            simulation.advance(600).expect("step");
        }
        let [theta, phi] = simulation.arm().base_degrees();
        assert!((theta - 20.0).abs() < 0.1 && (phi - 30.0).abs() < 0.1, "{theta} {phi}");
    }
}

#[test]
fn noise_on_the_lengths_shakes_the_loop() {
    let mut simulation = taught(1e-6);
    let quiet = farthest(&mut simulation, 1_000);
    simulation.set_noise(0.0, 3e-5).expect("noise");
    assert!(farthest(&mut simulation, 1_000) > 10.0 * quiet);
}

#[test]
fn another_body_goes_on_where_the_one_before_was() {
    let mut simulation = taught(1e-6);
    let before = simulation.arm().state();
    let stiffer =
        ArmParameters { longitudinal_stiffness: 200.0.into(), ..ArmParameters::default() };
    simulation.set_body(stiffer.clone()).expect("body");
    assert_eq!(simulation.arm().state(), before);
    assert_eq!(simulation.driver(), Driver::Readout);
    assert_eq!(simulation.lesson_steps(), 0);
    simulation.advance(10).expect("steps");
    let shorter = ArmParameters { compartments: 10, ..stiffer };
    simulation.set_body(shorter).expect("body");
    assert_eq!((simulation.driver(), simulation.lengths().len()), (Driver::Hand, 40));
    assert!(simulation.let_go().is_err());
}

#[test]
fn what_cannot_be_is_told_and_changes_nothing() {
    let mut simulation = Simulation::new(ArmParameters::default()).expect("arm");
    let before = simulation.arm().state();
    let messages = [
        simulation.drag([200.0, 0.0]).expect_err("angle").to_string(),
        simulation.begin_lesson(TargetName::Lissajous, 0.0).expect_err("amplitude").to_string(),
        simulation.set_noise(-1.0, 0.0).expect_err("noise").to_string(),
        simulation.push([0.0, f64::NAN]).expect_err("push").to_string(),
        simulation.let_go().expect_err("readout").to_string(),
        simulation.fit(1e-6).expect_err("lesson").to_string(),
        Simulation::new(ArmParameters { timestep: 2e-3, ..ArmParameters::default() })
            .expect_err("timestep")
            .to_string(),
        Network::from_bytes(&[1, 2, 3]).expect_err("agent").to_string(),
    ];
    let begins = [
        "theta = 200 is outside the allowed range [-180, 180] degrees",
        "amplitude = 0 is outside the allowed range (0, 180] degrees",
        "command_noise = -1 is outside the allowed range [0, 90] degrees",
        "push[1] = NaN is outside the allowed range",
        "readout = none is outside",
        "lesson = 0 is outside",
        "timestep = 0.002 is outside",
        "agent: the file is incomplete",
    ];
    for (message, begin) in messages.iter().zip(begins) {
        assert!(message.starts_with(begin), "{message}");
    }
    assert_eq!(simulation.arm().state(), before);
}

#[test]
fn an_arm_that_leaves_its_domain_waits_in_a_hand() {
    // A base that jumps throws an arm with inertia.
    let mut simulation = Simulation::new(ArmParameters::inertial()).expect("arm");
    simulation.begin_lesson(TargetName::Quadratic, 90.0).expect("lesson");
    simulation.advance(5_000).expect("teacher");
    simulation.fit(1e-6).expect("readout");
    simulation.let_go().expect("loop");
    simulation.set_noise(30.0, 0.0).expect("noise");
    let failure = (0..5_000).find_map(|_| simulation.advance(1).err());
    let message = failure.expect("no such arm bears that").to_string();
    assert!(message.starts_with("the arm left its domain"), "{message}");
    assert_eq!(simulation.driver(), Driver::Hand);
    simulation.reset().expect("rest");
    simulation.advance(100).expect("a hand holds it");
    assert!(simulation.arm().base_degrees().iter().all(|angle| angle.abs() < 1e-9));
}
