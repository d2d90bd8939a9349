//! Whatever an agent does within the action bounds of the default environment, the arm stays in its
//! domain: 400,000 random steps and bang-bang actions from 0.5 to 10 Hz.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

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

fn random_steps(target: TargetName, seed: u64, steps: u32) -> Extremes {
    let mut episode =
        Episode::new(EpisodeConfig { target: Target::Named(target), ..EpisodeConfig::default() })
            .unwrap();
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
    // The default environment in two threads, as many as the tests' machine has cores.
    let threads: Vec<_> = (0..2)
        .map(|seed| std::thread::spawn(move || random_steps(TargetName::Quadratic, seed, 200_000)))
        .collect();
    for thread in threads {
        let Extremes { bend, shortest, longest } = thread.join().unwrap();
        println!("random: bend {bend:.3} rad, lengths {shortest:.4} to {longest:.4} m");
        // Far from the domain's limit of 2.6.
        assert!(bend < 1.0, "{bend}");
    }
}

#[test]
fn bang_bang_from_half_a_hertz_to_ten() {
    let mut extremes = Extremes { bend: 0.0, shortest: 1.0, longest: 0.0 };
    let mut episode = Episode::new(EpisodeConfig::default()).unwrap();
    for tenth in (5..=100).step_by(5) {
        let frequency = f64::from(tenth) / 10.0;
        for (lag, sign) in [(0.0, 1.0), (0.0, -1.0), (0.25, 1.0)] {
            episode.reset();
            for step in 0..1000 {
                let turns = f64::from(step) * 0.01 * frequency;
                let square = |turns: f64| if turns.rem_euclid(1.0) < 0.5 { 1.0 } else { -1.0 };
                let outcome = episode.step([square(turns), sign * square(turns + lag)]).unwrap();
                assert!(outcome.failure.is_none(), "{frequency} Hz: {}", outcome.failure.unwrap());
                watch(&episode, &mut extremes);
            }
        }
    }
    println!(
        "bang-bang: bend {:.3} rad, lengths {:.4} to {:.4} m",
        extremes.bend, extremes.shortest, extremes.longest
    );
}
