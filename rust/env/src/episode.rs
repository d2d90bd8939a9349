//! One episode: reset onto the orbit, steps, reward, end.

use std::sync::Arc;

use octoarm_arm::{Arm, ArmState, DomainError, ParameterError, domain};
use rand_core::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::config::EpisodeConfig;
use crate::reward::{Reward, RewardTerms};
use crate::swing::{Swing, control_step};

/// What a step brought, beside the spring lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome {
    /// The terms of the reward; their sum is the reward.
    pub terms: RewardTerms,
    /// Base angles θ, φ \[degrees\].
    pub base: [f64; 2],
    /// The target at this instant \[degrees\].
    pub target: [f64; 2],
    /// Distance between the two \[degrees\].
    pub tracking_error: f64,
    /// Why the episode ended, if the arm left its domain.
    pub failure: Option<DomainError>,
}

/// Everything an episode needs to go on exactly where it was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeState {
    /// The arm.
    pub arm: ArmState,
    /// Control instant on the target's clock.
    pub tick: i64,
    /// The clock's undisturbed base `[θ, φ, θ̇, φ̇]` \[degrees, degrees/s\].
    pub clock: [f64; 4],
    /// The action before.
    pub action: [f64; 2],
    /// Whether the episode runs: it was reset and has not failed.
    pub running: bool,
    /// The generator of the next resets.
    pub generator: Pcg64,
}

/// An arm that follows a target.
#[derive(Clone, Debug)]
pub struct Episode {
    config: Arc<EpisodeConfig>,
    swing: Arc<Swing>,
    reward: Reward,
    action_range: f64,
    physics_steps: u32,
    arm: Arm,
    tick: i64,
    clock: [f64; 4],
    action: [f64; 2],
    running: bool,
    generator: Pcg64,
}

impl Episode {
    /// An episode that waits for its first [`Episode::reset`].
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range.
    pub fn new(config: EpisodeConfig) -> Result<Self, ParameterError> {
        let swing = Swing::shared(&config)?;
        let amplitude = swing.orbit.amplitude();
        Ok(Self {
            reward: config.reward(amplitude),
            action_range: config.resolved_action_range(amplitude),
            physics_steps: config.physics_steps(),
            arm: swing.arm.clone(),
            tick: 0,
            clock: [0.0; 4],
            action: [0.0; 2],
            running: false,
            generator: Pcg64::seed_from_u64(0),
            config: Arc::new(config),
            swing,
        })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &EpisodeConfig {
        &self.config
    }

    /// The swing whose snapshots episodes begin from.
    #[must_use]
    pub fn swing(&self) -> &Swing {
        &self.swing
    }

    /// The arm.
    #[must_use]
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Base angle of an action of 1 \[degrees\].
    #[must_use]
    pub fn action_range(&self) -> f64 {
        self.action_range
    }

    /// Bounds of the observed spring lengths \[m\]: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> (f64, f64) {
        let length = self.config.arm.rest_length;
        (domain::SPRING_LENGTH.0 * length, domain::SPRING_LENGTH.1 * length)
    }

    /// Starts the generator of resets anew.
    pub fn seed(&mut self, seed: u64) {
        self.generator = Pcg64::seed_from_u64(seed);
    }

    /// Begins an episode at a random phase of the swing.
    pub fn reset(&mut self) -> Outcome {
        let count = self.swing.snapshots.len() as u128;
        // The high half of a 128-bit product: uniform to 2⁻⁵⁶ for 256 snapshots.
        let index = ((u128::from(self.generator.next_u64()) * count) >> 64) as usize;
        self.reset_to(index)
    }

    /// Begins an episode at the snapshot nearest to a phase of the target in turns, 0 to 1.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for a phase outside [0, 1].
    pub fn reset_to_phase(&mut self, phase: f64) -> Result<Outcome, ParameterError> {
        if !(0.0..=1.0).contains(&phase) {
            return Err(ParameterError::OutOfRange {
                name: "phase".to_owned(),
                value: phase.to_string(),
                range: "[0, 1] turns".to_owned(),
            });
        }
        let turns_a_tick = self.config.control_period / self.swing.orbit.period();
        let distance = |index: &usize| {
            let difference = (*index as f64 * turns_a_tick - phase).rem_euclid(1.0);
            difference.min(1.0 - difference)
        };
        let nearest = (0..self.swing.snapshots.len())
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
            .unwrap_or(0);
        Ok(self.reset_to(nearest))
    }

    fn reset_to(&mut self, index: usize) -> Outcome {
        let snapshot = &self.swing.snapshots[index];
        // A snapshot was a valid state of this very body.
        let restored = self.arm.set_state(&snapshot.arm);
        debug_assert!(restored.is_ok(), "{restored:?}");
        self.tick = index as i64;
        self.clock = snapshot.clock;
        self.action = self.as_action(snapshot.command);
        self.running = true;
        self.outcome(self.action, None)
    }

    fn as_action(&self, command: [f64; 2]) -> [f64; 2] {
        command.map(|angle| (angle / self.action_range).clamp(-1.0, 1.0))
    }

    /// The teacher's action now: what the clock commands, as a fraction of the action range.
    #[must_use]
    pub fn teacher_action(&self) -> [f64; 2] {
        self.as_action(self.swing.clock.command(self.tick, self.clock).0)
    }

    /// One control period under an action, each entry in [−1, 1].
    ///
    /// If the arm leaves its domain the outcome carries the failure, the arm keeps its last valid
    /// state, and only a reset goes on.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for an action outside its bounds or a step without a reset;
    /// nothing is changed then.
    pub fn step(&mut self, action: [f64; 2]) -> Result<Outcome, ParameterError> {
        for (axis, value) in action.into_iter().enumerate() {
            if !(-1.0..=1.0).contains(&value) {
                return Err(ParameterError::OutOfRange {
                    name: format!("action[{axis}]"),
                    value: value.to_string(),
                    range: "[-1, 1]".to_owned(),
                });
            }
        }
        if !self.running {
            return Err(ParameterError::OutOfRange {
                name: "step".to_owned(),
                value: "a call before reset or after the end of the episode".to_owned(),
                range: "of running episodes: call reset first".to_owned(),
            });
        }
        let command = action.map(|share| share * self.action_range);
        let failure = control_step(&mut self.arm, command, self.physics_steps).err();
        self.clock = self.swing.clock.command(self.tick, self.clock).1;
        self.tick += 1;
        let before = std::mem::replace(&mut self.action, action);
        self.running = failure.is_none();
        Ok(self.outcome(before, failure))
    }

    fn outcome(&self, before: [f64; 2], failure: Option<DomainError>) -> Outcome {
        let base = self.arm.base_degrees();
        let target = self.swing.clock.target(self.tick);
        let (x, y) = (base[0] - target[0], base[1] - target[1]);
        let tracking_error = (x * x + y * y).sqrt();
        let mut terms = self.reward.terms(tracking_error, self.action, before);
        if failure.is_some() {
            terms.tracking = 0.0;
        }
        Outcome { terms, base, target, tracking_error, failure }
    }

    /// Saves everything the episode needs to go on.
    #[must_use]
    pub fn state(&self) -> EpisodeState {
        EpisodeState {
            arm: self.arm.state(),
            tick: self.tick,
            clock: self.clock,
            action: self.action,
            running: self.running,
            generator: self.generator.clone(),
        }
    }

    /// Goes on exactly where an episode of the same settings was saved.
    ///
    /// # Errors
    /// [`ParameterError`] for a state that does not fit; nothing is changed then.
    pub fn set_state(&mut self, state: &EpisodeState) -> Result<(), ParameterError> {
        self.arm.set_state(&state.arm)?;
        self.tick = state.tick;
        self.clock = state.clock;
        self.action = state.action;
        self.running = state.running;
        self.generator = state.generator.clone();
        Ok(())
    }
}
