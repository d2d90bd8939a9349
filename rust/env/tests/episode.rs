//! The episode: what the teacher earns, where it starts, how it ends, and that it is repeatable.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use octoarm_arm::{Actuator, ArmParameters};
use octoarm_env::{Episode, EpisodeConfig, Target, TargetName};

const NAMES: [TargetName; 3] =
    [TargetName::Quadratic, TargetName::VanDerPol, TargetName::Lissajous];

fn config(target: TargetName) -> EpisodeConfig {
    EpisodeConfig { target: Target::Named(target), ..EpisodeConfig::default() }
}

fn teacher_return(episode: &mut Episode, steps: u32) -> f64 {
    (0..steps)
        .map(|_| {
            let outcome = episode.step(episode.teacher_action()).unwrap();
            assert!(outcome.failure.is_none());
            outcome.terms.total()
        })
        .sum()
}

#[test]
fn the_teacher_earns_what_can_be_earned() {
    for target in NAMES {
        for actuator in [Actuator::Servo, Actuator::Direct] {
            let mut episode = Episode::new(EpisodeConfig { actuator, ..config(target) }).unwrap();
            for seed in 0..3 {
                episode.seed(seed);
                let start = episode.reset();
                // The clock's servo and the arm's are the same exact solution.
                assert!(start.tracking_error < 1e-9, "{target:?}: {}", start.tracking_error);
                let earned = teacher_return(&mut episode, 500) / 500.0;
                println!("{target:?} {actuator:?} {earned}");
                assert!(earned >= 0.995, "{target:?}, {actuator:?}: {earned}");
            }
        }
    }
}

#[test]
fn the_swing_has_forgotten_its_start() {
    // A target whose period is a whole number of control periods: one turn later the arm must be in
    // the same state.
    let samples: Vec<[f64; 2]> = (0..500)
        .map(|k| {
            let angle = std::f64::consts::TAU * f64::from(k) / 500.0;
            [30.0 * angle.sin(), 20.0 * (angle + 1.0).sin()]
        })
        .collect();
    let episode = Episode::new(EpisodeConfig {
        target: Target::Samples(samples),
        ..EpisodeConfig::default()
    })
    .unwrap();
    let snapshots = &episode.swing().snapshots;
    let mut worst = 0.0_f64;
    for (now, later) in snapshots.iter().zip(&snapshots[50..]) {
        for (a, b) in
            now.arm.coordinates.iter().flatten().zip(later.arm.coordinates.iter().flatten())
        {
            worst = worst.max((a - b).abs());
        }
    }
    println!("one turn apart: {worst:e}");
    assert!(worst < 1e-5, "{worst:e}");
}

#[test]
fn the_same_seed_gives_the_same_bits_and_another_seed_another_phase() {
    let run = |seed: u64| {
        let mut episode = Episode::new(config(TargetName::VanDerPol)).unwrap();
        episode.seed(seed);
        let mut trace = Vec::new();
        for _ in 0..3 {
            episode.reset();
            for step in 0..40 {
                let angle = 0.3 * f64::from(step);
                episode.step([0.9 * angle.sin(), 0.7 * angle.cos()]).unwrap();
                trace.extend(episode.arm().lengths().iter().map(|length| length.to_bits()));
            }
        }
        trace
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5), run(6));
}

#[test]
fn a_saved_episode_goes_on_with_the_same_bits() {
    let mut episode = Episode::new(config(TargetName::Lissajous)).unwrap();
    episode.seed(3);
    episode.reset();
    for _ in 0..20 {
        episode.step([0.4, -0.8]).unwrap();
    }
    let text = serde_json::to_string(&episode.state()).unwrap();
    let mut other = Episode::new(config(TargetName::Lissajous)).unwrap();
    other.set_state(&serde_json::from_str(&text).unwrap()).unwrap();
    for step in 0..60 {
        if step == 30 {
            assert_eq!(episode.reset(), other.reset());
        }
        let action = [0.1 * f64::from(step % 9), -0.5];
        assert_eq!(episode.step(action).unwrap(), other.step(action).unwrap());
        assert_eq!(episode.teacher_action(), other.teacher_action());
        assert_eq!(episode.arm().lengths(), other.arm().lengths());
    }
}

#[test]
fn the_reward_is_bounded_and_its_terms_are_the_formula() {
    let mut episode = Episode::new(EpisodeConfig::default()).unwrap();
    episode.reset();
    let mut before = episode.state().action;
    for step in 0..100 {
        let action = if step % 2 == 0 { [1.0, -1.0] } else { [-1.0, 1.0] };
        let outcome = episode.step(action).unwrap();
        let ratio = outcome.tracking_error / 27.0;
        assert!((outcome.terms.tracking - (-ratio * ratio).exp()).abs() < 1e-14);
        let change = (action[0] - before[0]).powi(2) + (action[1] - before[1]).powi(2);
        assert!((outcome.terms.action_change + 0.01 * change).abs() < 1e-15);
        assert!(outcome.terms.total() <= 1.0 && outcome.terms.total() >= -0.08);
        before = action;
    }
}

#[test]
fn a_failure_ends_the_episode_and_leaves_the_last_valid_state() {
    // The base driven directly, 1 ms a step: violent enough to leave the domain.
    let mut episode = Episode::new(EpisodeConfig {
        arm: ArmParameters::inertial(),
        amplitude: Some(20.0),
        control_period: 0.001,
        ..EpisodeConfig::default()
    })
    .unwrap();
    episode.reset();
    let mut sign = 1.0;
    let failed = (0..1000)
        .find_map(|_| {
            sign = -sign;
            let outcome = episode.step([sign, -sign]).unwrap();
            outcome.failure.map(|failure| (failure, outcome))
        })
        .expect("bang-bang at 500 Hz fails");
    let (failure, outcome) = failed;
    assert!(failure.to_string().contains("compartment"), "{failure}");
    assert_eq!(outcome.terms.tracking, 0.0);
    let (low, high) = episode.observation_bounds();
    assert!(episode.arm().lengths().iter().all(|length| (low..=high).contains(length)));
    assert!(episode.step([0.0; 2]).unwrap_err().to_string().contains("reset"));
    episode.reset();
    assert!(episode.step(episode.teacher_action()).unwrap().failure.is_none());
}

#[test]
fn rounding_in_single_precision_past_a_bound_is_the_bound() {
    let mut exact = Episode::new(config(TargetName::Lissajous)).unwrap();
    exact.reset();
    let mut rounded = exact.clone();
    for step in 0..3 {
        let (plus, minus) = (f64::from(1.0 + f32::EPSILON), f64::from(-1.0 - 2.0 * f32::EPSILON));
        let seen = rounded.step([plus, minus]).unwrap();
        assert_eq!(seen, exact.step([1.0, -1.0]).unwrap(), "step {step}");
    }
    assert_eq!(rounded.state(), exact.state());
}

#[test]
fn bad_actions_are_refused_before_anything_changes() {
    let mut episode = Episode::new(EpisodeConfig::default()).unwrap();
    assert!(episode.step([0.0; 2]).unwrap_err().to_string().contains("reset"));
    episode.reset();
    let before = episode.state();
    for bad in [f64::NAN, f64::INFINITY, 1.000_001, -7.0] {
        let message = episode.step([0.0, bad]).unwrap_err().to_string();
        assert!(message.contains("action[1]") && message.contains("[-1, 1]"), "{message}");
    }
    assert_eq!(episode.state(), before);
    assert!(episode.reset_to_phase(1.5).is_err() && episode.reset_to_phase(f64::NAN).is_err());
}

#[test]
fn a_phase_can_be_asked_for() {
    let mut episode = Episode::new(EpisodeConfig::default()).unwrap();
    for quarter in 0..4 {
        let phase = 0.25 * f64::from(quarter);
        let outcome = episode.reset_to_phase(phase).unwrap();
        let orbit = &episode.swing().orbit;
        let [theta, phi] = orbit.at(phase * orbit.period());
        let distance = (outcome.target[0] - theta).hypot(outcome.target[1] - phi);
        // 256 snapshots over five turns and more: within a hundredth of a turn.
        assert!(distance < 0.01 * std::f64::consts::TAU * 20.0, "{distance}");
    }
}
