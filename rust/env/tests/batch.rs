//! Episodes in a batch have the bits of single ones: in every autoreset mode, whatever stands beside
//! them, however many threads there are, with failures and truncations inside.
#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

use octoarm_arm::{Actuator, Arm, ArmParameters, LinearReadout};
use octoarm_env::{
    ArmBatch, Autoreset, BatchState, CheckedConfig, Episode, EpisodeBatch, EpisodeConfig, Outcome,
    Target, TargetName,
};

const MOST_STEPS: u64 = 60;

/// Episodes of all kinds; those driven `direct` at 1 ms fail under wild actions.
fn configs(count: usize) -> Vec<EpisodeConfig> {
    let targets = [TargetName::Quadratic, TargetName::VanDerPol, TargetName::Lissajous];
    (0..count)
        .map(|index| EpisodeConfig {
            target: Target::Named(targets[index % 3]),
            amplitude: Some(if index % 2 == 0 { 15.0 } else { 20.0 }),
            actuator: if index % 3 == 2 { Actuator::Direct } else { Actuator::Servo },
            control_period: if index % 3 == 2 { 0.001 } else { 0.01 },
            arm: ArmParameters {
                area_scale: if index % 7 == 6 { 1.5 } else { 1.0 },
                ..ArmParameters::inertial()
            },
            ..EpisodeConfig::default()
        })
        .collect()
}

/// Bang-bang for the arms that are to fail, smooth noise for the others.
fn actions(configs: &[EpisodeConfig], step: u32) -> Vec<[f64; 2]> {
    configs
        .iter()
        .enumerate()
        .map(|(index, config)| match config.actuator {
            // Each in a rhythm of its own, so that neighbours fail at different times.
            Actuator::Direct => {
                let sign =
                    if (step / (1 + index as u32 / 3)).is_multiple_of(2) { 1.0 } else { -1.0 };
                [sign, -sign]
            }
            Actuator::Servo => {
                let angle = 0.17 * f64::from(step) + index as f64;
                [0.9 * angle.sin(), 0.8 * (1.3 * angle).cos()]
            }
        })
        .collect()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// A single episode under the same rules.
struct Single {
    episode: Episode,
    elapsed: u64,
    ended: bool,
}

#[derive(Debug, PartialEq)]
struct Seen {
    lengths: Vec<u64>,
    reward: f64,
    ends: (bool, bool),
    outcome: Outcome,
    last: Option<(Vec<u64>, Outcome)>,
}

impl Single {
    fn seen(&self, reward: f64, ends: (bool, bool), outcome: Outcome) -> Seen {
        Seen { lengths: bits(&self.episode.arm().lengths()), reward, ends, outcome, last: None }
    }

    fn reset(&mut self) -> Outcome {
        (self.elapsed, self.ended) = (0, false);
        self.episode.reset()
    }

    fn step(&mut self, action: [f64; 2], autoreset: Autoreset) -> Seen {
        if self.ended {
            let outcome = self.reset();
            return self.seen(0.0, (false, false), outcome);
        }
        let outcome = self.episode.step(action).unwrap();
        self.elapsed += 1;
        let ends = (outcome.failure.is_some(), self.elapsed >= MOST_STEPS);
        self.ended = ends.0 || ends.1;
        let mut seen = self.seen(outcome.terms.total(), ends, outcome.clone());
        if self.ended && autoreset == Autoreset::SameStep {
            seen.last = Some((seen.lengths, outcome));
            seen.outcome = self.reset();
            seen.lengths = bits(&self.episode.arm().lengths());
        }
        seen
    }
}

fn shared(configs: Vec<EpisodeConfig>) -> Vec<CheckedConfig> {
    configs.into_iter().map(|config| config.checked().unwrap()).collect()
}

fn batch(count: usize, autoreset: Autoreset, threads: usize) -> EpisodeBatch {
    EpisodeBatch::new(&shared(configs(count)), Some(MOST_STEPS), autoreset, Some(threads)).unwrap()
}

fn seen(batch: &mut EpisodeBatch, actions: &[[f64; 2]]) -> Vec<Seen> {
    let width = batch.observation_len();
    let step = batch.step(actions).unwrap();
    let ends: Vec<&Outcome> = step.steps().collect();
    (0..batch.len())
        .map(|index| Seen {
            lengths: bits(&step.observations[index * width..(index + 1) * width]),
            reward: ends[index].reward,
            ends: (ends[index].terminated(), ends[index].truncated),
            outcome: step.outcomes[index].clone(),
            last: step.lasts[index]
                .as_ref()
                .map(|last| (bits(&last.observation), last.outcome.clone())),
        })
        .collect()
}

#[test]
fn a_batch_is_its_episodes() {
    for autoreset in [Autoreset::NextStep, Autoreset::SameStep, Autoreset::Disabled] {
        let configs = configs(17);
        let seeds: Vec<Option<u64>> = (0..17).map(Some).collect();
        let mut singles: Vec<Single> = configs
            .iter()
            .zip(0..)
            .map(|(config, seed)| {
                let mut episode =
                    Episode::with_limit(config.clone().checked().unwrap(), Some(MOST_STEPS))
                        .unwrap();
                episode.seed(seed);
                Single { episode, elapsed: 0, ended: false }
            })
            .collect();
        let mut batches = [batch(17, autoreset, 1), batch(17, autoreset, 2)];
        for batch in &mut batches {
            batch.reset(None, &seeds, None).unwrap();
        }
        for single in &mut singles {
            single.reset();
        }
        let (mut failed, mut truncated) = (0, 0);
        for step in 0..200 {
            let actions = actions(&configs, step);
            if autoreset == Autoreset::Disabled && singles.iter().any(|single| single.ended) {
                let mask: Vec<bool> = singles.iter().map(|single| single.ended).collect();
                for batch in &mut batches {
                    let message = batch.step(&actions).unwrap_err().to_string();
                    assert!(message.contains("call reset first"), "{message}");
                    let reset = batch.reset(Some(&mask), &[None; 17], None).unwrap();
                    for (index, outcome) in reset.outcomes.iter().enumerate() {
                        assert_eq!(outcome.is_some(), mask[index]);
                    }
                }
                for single in singles.iter_mut().filter(|single| single.ended) {
                    single.reset();
                }
            }
            let [one, two] = &mut batches;
            let (one, two) = (seen(one, &actions), seen(two, &actions));
            assert_eq!(one, two, "{autoreset:?}, step {step}: threads");
            for (index, (single, ours)) in singles.iter_mut().zip(&one).enumerate() {
                let alone = single.step(actions[index], autoreset);
                assert_eq!(*ours, alone, "{autoreset:?}, step {step}, episode {index}");
                failed += u32::from(alone.ends.0);
                truncated += u32::from(alone.ends.1);
            }
        }
        assert!(failed >= 6 && truncated >= 30, "{autoreset:?}: {failed}, {truncated}");
    }
}

#[test]
fn a_step_in_parts_is_a_step() {
    let configs = configs(27);
    let mut batches = [batch(27, Autoreset::NextStep, 2), batch(27, Autoreset::NextStep, 2)];
    for batch in &mut batches {
        batch.reset(None, &[Some(3); 27], None).unwrap();
    }
    let [whole, parts] = &mut batches;
    for step in 0..40 {
        let actions = actions(&configs, step);
        let expected = whole.step(&actions).unwrap();
        let mut part = parts.begin_step(&actions).unwrap();
        let made: Vec<bool> = (0..3).map(|groups| parts.advance_step(&mut part, groups)).collect();
        assert_eq!(made, [false, false, false]);
        assert!(parts.advance_step(&mut part, 1));
        let found = part.finish();
        assert_eq!(bits(&found.observations), bits(&expected.observations), "step {step}");
        assert_eq!((found.outcomes, found.lasts), (expected.outcomes, expected.lasts));
        assert_eq!(whole.state(), parts.state());
    }
}

/// Threads of this process that help batches; none where the system does not tell.
fn helpers() -> usize {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return 0 };
    let names =
        tasks.filter_map(|task| std::fs::read_to_string(task.ok()?.path().join("comm")).ok());
    names.filter(|name| name.starts_with("octoarm-")).count()
}

#[test]
fn all_batches_share_their_threads() {
    let mut batches: Vec<EpisodeBatch> =
        (0..10).map(|_| batch(17, Autoreset::NextStep, 64)).collect();
    for batch in &mut batches {
        batch.reset(None, &[Some(1); 17], None).unwrap();
        batch.step(&[[0.0; 2]; 17]).unwrap();
        assert_eq!(batch.arms().threads(), 64);
    }
    let processors = std::thread::available_parallelism().unwrap().get();
    assert!(helpers() <= processors, "{} threads help", helpers());
}

#[test]
fn a_saved_batch_goes_on_with_the_same_bits() {
    let configs = configs(11);
    let mut batch = batch(11, Autoreset::NextStep, 2);
    batch.reset(None, &[Some(7); 11], None).unwrap();
    for step in 0..70 {
        batch.step(&actions(&configs, step)).unwrap();
    }
    let text = serde_json::to_string(&batch.state()).unwrap();
    let state: BatchState = serde_json::from_str(&text).unwrap();
    assert_eq!(state, batch.state());
    let mut other = self::batch(11, Autoreset::NextStep, 1);
    other.set_state(&state).unwrap();
    for step in 70..140 {
        let actions = actions(&configs, step);
        assert_eq!(seen(&mut batch, &actions), seen(&mut other, &actions), "step {step}");
    }
    // A state that does not fit changes nothing.
    let before = other.state();
    let text = text.replacen("\"coordinates\":[[", "\"coordinates\":[[9", 1);
    let message = other.set_state(&serde_json::from_str(&text).unwrap()).unwrap_err().to_string();
    assert!(message.contains("height of compartment 1"), "{message}");
    assert_eq!(other.state(), before);
    let small = self::batch(3, Autoreset::NextStep, 1).state();
    assert!(other.set_state(&small).unwrap_err().to_string().contains("(3,), expected (11,)"));
}

#[test]
fn bad_input_is_named_and_changes_nothing() {
    let new = |configs, most, threads| {
        EpisodeBatch::new(&shared(configs), most, Autoreset::NextStep, threads)
            .unwrap_err()
            .to_string()
    };
    assert!(new(Vec::new(), None, None).contains("num_envs = 0"));
    assert!(new(configs(1), Some(0), None).contains("max_episode_steps = 0"));
    assert!(new(configs(1), None, Some(0)).contains("threads = 0"));
    let mut mixed = configs(2);
    mixed[1].arm.compartments = 9;
    assert!(new(mixed, None, None).contains("compartments = 9"));

    let mut batch = batch(3, Autoreset::NextStep, 1);
    let still = [[0.0; 2]; 3];
    assert!(batch.step(&still).unwrap_err().to_string().contains("step of environment 0"));
    batch.reset(None, &[None; 3], Some(0.25)).unwrap();
    let before = batch.state();
    for (action, name) in [
        ([f64::NAN, 0.0], "actions[1, 0] = NaN"),
        ([0.0, f64::INFINITY], "actions[1, 1] = inf"),
        ([0.0, -1.5], "actions[1, 1] = -1.5"),
        ([0.0, 1.000_002], "actions[1, 1] = 1.000002"),
    ] {
        let message = batch.step(&[[0.0; 2], action, [0.0; 2]]).unwrap_err().to_string();
        assert!(message.contains(name), "{message}");
    }
    assert!(batch.step(&still[..2]).unwrap_err().to_string().contains("(2,), expected (3,)"));
    assert!(batch.reset(Some(&[true; 2]), &[None; 3], None).is_err());
    assert!(batch.reset(None, &[Some(1); 4], None).is_err());
    assert!(batch.reset(None, &[Some(1); 3], Some(f64::NAN)).is_err());
    assert_eq!(batch.state(), before);
}

fn drive(arm: usize, steps: usize) -> Vec<[f64; 2]> {
    (0..steps)
        .map(|step| {
            let angle = 0.004 * step as f64 * (1.0 + 0.1 * arm as f64);
            [15.0 * angle.sin(), 10.0 * (1.7 * angle).sin()]
        })
        .collect()
}

#[test]
fn a_batch_of_arms_is_its_arms_in_open_and_closed_loop() {
    let steps = 300;
    let mut arms: Vec<Arm> = (0..11)
        .map(|index| {
            let area_scale = 1.0 + 0.1 * index as f64;
            let parameters = ArmParameters { area_scale, ..ArmParameters::inertial() };
            let actuator = if index % 2 == 0 { Actuator::Direct } else { Actuator::Servo };
            Arm::undeformed(parameters, actuator).unwrap()
        })
        .collect();
    let width = arms[0].observation_len();
    let mut drives: Vec<Vec<[f64; 2]>> = (0..arms.len()).map(|arm| drive(arm, steps)).collect();
    // One arm is torn out of its domain half way.
    for (step, command) in drives[4].iter_mut().enumerate().skip(150) {
        *command = if step % 2 == 0 { [90.0, 90.0] } else { [-90.0, -90.0] };
    }
    let readout = LinearReadout {
        weights: (0..width).map(|i| [(i % 7) as f64 - 3.0, (i % 5) as f64 - 2.0]).collect(),
        bias: [0.1, -0.2],
    };
    for threads in [1, 2] {
        let mut batch = ArmBatch::new(&arms.iter().collect::<Vec<_>>(), Some(threads)).unwrap();
        let mut lengths = vec![0.0; arms.len() * steps * width];
        let mut stops = vec![None; arms.len()];
        let commands: Vec<&[[f64; 2]]> = drives.iter().map(Vec::as_slice).collect();
        batch.run(
            &commands,
            0..steps,
            1,
            lengths.chunks_exact_mut(steps * width).collect(),
            &mut stops,
        );
        for (index, arm) in arms.iter().enumerate() {
            let mut arm = arm.clone();
            let mut alone = vec![0.0; steps * width];
            let stop = arm.run(&drives[index], &mut alone).err();
            assert_eq!(stop.is_some(), index == 4);
            assert_eq!(stops[index], stop);
            let made = stop.map_or(steps, |(step, _)| step) * width;
            let ours = &lengths[index * steps * width..(index + 1) * steps * width];
            assert_eq!(bits(&ours[..made]), bits(&alone[..made]), "arm {index}");
            // Then it stands still.
            for row in ours[made..].chunks_exact(width) {
                assert_eq!(bits(row), bits(&ours[made - width..made]));
            }
            assert_eq!(batch.state(index), arm.state());
        }
        let mut outputs = vec![[0.0; 2]; arms.len() * steps];
        let readouts = vec![&readout; arms.len()];
        let rest: Vec<_> = arms.iter().map(Arm::state).collect();
        batch.set_states(rest.iter()).unwrap();
        let push: Vec<Vec<[f64; 2]>> = (0..arms.len()).map(|arm| drive(arm + 3, steps)).collect();
        let push: Vec<&[[f64; 2]]> = push.iter().map(Vec::as_slice).collect();
        let mut stops = vec![None; arms.len()];
        batch.run_closed_loop(
            &readouts,
            Some(&push),
            0..steps,
            1,
            outputs.chunks_exact_mut(steps).collect(),
            lengths.chunks_exact_mut(steps * width).collect(),
            &mut stops,
        );
        for (index, arm) in arms.iter().enumerate() {
            let mut arm = arm.clone();
            let (mut said, mut alone) = (vec![[0.0; 2]; steps], vec![0.0; steps * width]);
            arm.run_closed_loop(&readout, Some(push[index]), &mut said, &mut alone).unwrap();
            assert_eq!(outputs[index * steps..(index + 1) * steps], said);
            let ours = &lengths[index * steps * width..(index + 1) * steps * width];
            assert_eq!(bits(ours), bits(&alone));
        }
    }
    let other = Arm::undeformed(
        ArmParameters { compartments: 3, ..ArmParameters::default() },
        Actuator::Servo,
    );
    arms.push(other.unwrap());
    let message = ArmBatch::new(&arms.iter().collect::<Vec<_>>(), None).unwrap_err().to_string();
    assert!(message.contains("compartments = 3"), "{message}");
    assert!(ArmBatch::new(&[], None).is_err());
}
