//! Makes physics steps and nothing else: what `count_operations.py` counts.
//!
//! `cargo bench -p octoarm-arm --bench steps -- one|lanes STEPS`
#![allow(clippy::unwrap_used, clippy::print_stderr)]

use octoarm_arm::{Actuator, Arm, ArmLanes, ArmParameters};

fn main() {
    // Cargo adds an option of its own.
    let arguments: Vec<String> = std::env::args().filter(|word| word != "--bench").collect();
    let (kind, steps) = match &arguments[1..] {
        // With all other benchmarks there is nothing to be done.
        [] => return,
        [kind, steps] => (kind.as_str(), steps.parse::<u32>().unwrap()),
        _ => {
            eprintln!("usage: steps one|lanes STEPS");
            std::process::exit(2);
        }
    };
    // Not in equilibrium: to find that takes thousands of evaluations.
    let mut arm = Arm::undeformed(ArmParameters::default(), Actuator::Servo).unwrap();
    let mut lanes = ArmLanes::new(&[&arm; ArmLanes::WIDTH]).unwrap();
    for step in 0..steps {
        let angle = 10.0 * (0.01 * f64::from(step)).sin();
        let command = [angle, 0.5 * angle];
        if kind == "one" {
            arm.step(command).unwrap();
        } else {
            assert!(lanes.step(&[command; ArmLanes::WIDTH], &[true; ArmLanes::WIDTH]));
        }
    }
}
