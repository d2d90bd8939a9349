//! Within the action bounds of the default environment the arm stays in its domain, on every target:
//! 400,000 random steps and bang-bang actions from 0.5 to 10 Hz. So does the arm that its base carries
//! along, on a servo at 20 degrees.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use octoarm_arm::{Actuator, ArmParameters};
use octoarm_env::{Episode, EpisodeConfig, Target, TargetName};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64;

struct Extremes {
    bend: f64,
    shortest: f64,
    longest: f64,
}

fn watch(episode: &Episode, extremes: &mut Extremes) {
    let (low, high) = episode.observation_bounds();
    for length in episode.arm().lengths() {
        assert!(length >= low && length <= high, "observation {length} outside [{low}, {high}]");
        extremes.shortest = extremes.shortest.min(length);
        extremes.longest = extremes.longest.max(length);
    }
    for row in episode.arm().state().coordinates {
        extremes.bend = extremes.bend.max(row[1].abs()).max(row[2].abs());
    }
}

fn paper(target: TargetName) -> EpisodeConfig {
    EpisodeConfig { target: Target::Named(target), ..EpisodeConfig::default() }
}

fn carried(amplitude: f64) -> EpisodeConfig {
    EpisodeConfig {
        arm: ArmParameters::inertial(),
        actuator: Actuator::Servo,
        amplitude: Some(amplitude),
        ..EpisodeConfig::default()
    }
}

/// The environments that are to stand everything, by name.
fn environments() -> [(&'static str, EpisodeConfig); 4] {
    [
        ("quadratic", paper(TargetName::Quadratic)),
        ("Van der Pol", paper(TargetName::VanDerPol)),
        ("Lissajous", paper(TargetName::Lissajous)),
        ("carried along", carried(20.0)),
    ]
}

fn random_steps(config: EpisodeConfig, seed: u64, steps: u32) -> Extremes {
    let mut episode = Episode::new(config).unwrap();
    episode.seed(seed);
    episode.reset();
    let mut generator = Pcg64::seed_from_u64(seed);
    let mut uniform = || (generator.next_u64() >> 11) as f64 / (1_u64 << 52) as f64 - 1.0;
    let mut extremes = Extremes { bend: 0.0, shortest: 1.0, longest: 0.0 };
    for step in 0..steps {
        if step % 500 == 499 {
            episode.reset();
        }
        let outcome = episode.step([uniform(), uniform()]).unwrap();
        assert!(outcome.failure.is_none(), "step {step}: {}", outcome.failure.unwrap());
        watch(&episode, &mut extremes);
    }
    extremes
}

#[test]
fn four_hundred_thousand_random_steps() {
    // A hundred thousand in each of the four environments.
    random_steps_everywhere(0, 100_000);
}

/// As many for every target of the paper's arm.
#[test]
#[ignore = "a million and more random steps, a minute or more"]
fn four_hundred_thousand_random_steps_on_every_target() {
    random_steps_everywhere(1, 400_000);
}

fn random_steps_everywhere(seed: u64, steps: u32) {
    let threads: Vec<_> = environments()
        .into_iter()
        .map(|(name, config)| (name, std::thread::spawn(move || random_steps(config, seed, steps))))
        .collect();
    for (name, thread) in threads {
        let Extremes { bend, shortest, longest } = thread.join().unwrap();
        println!("random, {name}: bend {bend:.3} rad, lengths {shortest:.4} to {longest:.4} m");
        // Far from the domain's limit of 2.6.
        assert!(bend < 1.0, "{name}: {bend}");
    }
}

/// Bang-bang actions at one frequency: the second axis lags by a share of a turn, and each axis has a
/// size and a sign. Returns whether the arm stayed in its domain.
fn bang_bang(
    episode: &mut Episode,
    frequency: f64,
    (lag, theta, phi): (f64, f64, f64),
    extremes: &mut Extremes,
) -> bool {
    let square = |turns: f64| if turns.rem_euclid(1.0) < 0.5 { 1.0 } else { -1.0 };
    (0..1000).all(|step| {
        let turns = f64::from(step) * 0.01 * frequency;
        let action = [theta * square(turns), phi * square(turns + lag)];
        let stays = episode.step(action).unwrap().failure.is_none();
        watch(episode, extremes);
        stays
    })
}

const IN_PHASE: (f64, f64, f64) = (0.0, 1.0, 1.0);
const ANTIPHASE: (f64, f64, f64) = (0.0, 1.0, -1.0);
const QUARTER_LAG: (f64, f64, f64) = (0.25, 1.0, 1.0);

#[test]
fn bang_bang_from_half_a_hertz_to_ten() {
    let threads: Vec<_> = environments()
        .into_iter()
        .map(|(name, config)| std::thread::spawn(move || bang_bang_everywhere(name, config)))
        .collect();
    for thread in threads {
        thread.join().unwrap();
    }
}

fn bang_bang_everywhere(name: &str, config: EpisodeConfig) {
    let mut extremes = Extremes { bend: 0.0, shortest: 1.0, longest: 0.0 };
    let mut episode = Episode::new(config).unwrap();
    for tenth in (5..=100).step_by(5) {
        let frequency = f64::from(tenth) / 10.0;
        for pattern in [IN_PHASE, ANTIPHASE, QUARTER_LAG] {
            episode.reset();
            let stays = bang_bang(&mut episode, frequency, pattern, &mut extremes);
            assert!(stays, "{name}: {frequency} Hz, {pattern:?}");
        }
    }
    let Extremes { bend, shortest, longest } = extremes;
    println!("bang-bang, {name}: bend {bend:.3} rad, lengths {shortest:.4} to {longest:.4} m");
}

/// The table in docs/body.md.
#[test]
#[ignore = "a survey of action ranges of the arm that is carried along, five minutes"]
fn survey_of_action_ranges() {
    let one_axis = [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)];
    let lags = [(0.125, 1.0, 1.0), (0.375, 1.0, 1.0)];
    let patterns = [&[IN_PHASE, ANTIPHASE, QUARTER_LAG], &one_axis[..], &lags[..]].concat();
    for range in [24.0, 26.0, 28.0, 30.0, 33.0, 39.0] {
        let config = EpisodeConfig { action_range: Some(range), ..carried(20.0) };
        let mut episode = Episode::new(config).unwrap();
        let mut extremes = Extremes { bend: 0.0, shortest: 1.0, longest: 0.0 };
        let mut failures = 0;
        for tenth in 5..=100 {
            for pattern in &patterns {
                episode.reset_to_phase(f64::from(tenth % 4) * 0.25).unwrap();
                let frequency = f64::from(tenth) / 10.0;
                failures += u32::from(!bang_bang(&mut episode, frequency, *pattern, &mut extremes));
            }
        }
        println!("| {range}° | {:.2} rad | {failures} |", extremes.bend);
    }
}
