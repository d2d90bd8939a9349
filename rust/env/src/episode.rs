//! One episode: reset onto the orbit, steps, reward, end.

use octoarm_arm::{Arm, ParameterError};

use crate::config::{CheckedConfig, EpisodeConfig};
use crate::control::control_step;
use crate::limit_cycle::{EpisodeState, LimitCycle, Start, check_phase, check_step};
use crate::outcome::Outcome;
use crate::swing::Swing;
use crate::task::{Stage, Task};

/// An arm that follows a target.
#[derive(Clone, Debug)]
pub struct Episode {
    task: LimitCycle,
    arm: Arm,
}

impl Episode {
    /// An episode that waits for its first [`Episode::reset`], and ends only if the arm leaves its
    /// domain.
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range.
    pub fn new(config: EpisodeConfig) -> Result<Self, ParameterError> {
        Self::with_limit(config.checked()?, None)
    }

    /// An [`Episode`] that ends after `max_episode_steps`.
    ///
    /// # Errors
    /// As [`Episode::new`].
    pub fn with_limit(
        config: CheckedConfig,
        max_episode_steps: Option<u64>,
    ) -> Result<Self, ParameterError> {
        let swings = Swing::shared(&config)?;
        let task = LimitCycle::new(config, swings, max_episode_steps)?;
        Ok(Self { arm: task.swing().arm.clone(), task })
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &CheckedConfig {
        self.task.config()
    }

    /// The swing of the present body, from whose snapshots episodes begin.
    #[must_use]
    pub fn swing(&self) -> &Swing {
        self.task.swing()
    }

    /// The arm.
    #[must_use]
    pub fn arm(&self) -> &Arm {
        &self.arm
    }

    /// Base angle of an action of 1 \[degrees\].
    #[must_use]
    pub fn action_range(&self) -> f64 {
        self.task.action_range()
    }

    /// Bounds of the observed spring lengths \[m\]: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> (f64, f64) {
        self.config().observation_bounds()
    }

    /// Starts the generator of resets anew.
    pub fn seed(&mut self, seed: u64) {
        self.task.seed(seed);
    }

    /// Begins an episode at a random phase of the swing.
    pub fn reset(&mut self) -> Outcome {
        let start = self.task.draw(None);
        self.begin(start)
    }

    /// Begins an episode at the snapshot nearest to a phase of the target in turns, 0 to 1. The body is
    /// drawn, where there are several.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for a phase outside [0, 1].
    pub fn reset_to_phase(&mut self, phase: f64) -> Result<Outcome, ParameterError> {
        check_phase(phase)?;
        let start = self.task.draw(Some(phase));
        Ok(self.begin(start))
    }

    fn begin(&mut self, start: Start) -> Outcome {
        self.arm.place(self.task.body(start), self.task.first_state(start));
        self.task.begin(start);
        self.see();
        let outcome = self.task.first_outcome(self.arm.base_degrees());
        self.told(outcome)
    }

    /// The outcome with what lies between the agent and the body.
    fn told(&self, mut outcome: Outcome) -> Outcome {
        self.task.tell(&|| self.arm.lengths(), &mut outcome);
        outcome
    }

    /// The last action; after a reset, the one that the swing was under.
    #[must_use]
    pub fn action(&self) -> [f64; 2] {
        self.task.action()
    }

    /// Where the episode stands, as if it began there.
    #[must_use]
    pub fn outcome(&self) -> Outcome {
        self.task.first_outcome(self.arm.base_degrees())
    }

    /// Whether the episode goes on: it was reset, and is not over.
    #[must_use]
    pub fn running(&self) -> bool {
        self.task.stage() == Stage::Running
    }

    /// Whether the episode is over: the arm left its domain, or its time is.
    #[must_use]
    pub fn ended(&self) -> bool {
        self.task.stage() == Stage::Over
    }

    /// Steps since the reset.
    #[must_use]
    pub fn elapsed(&self) -> u64 {
        self.task.elapsed()
    }

    /// Sets the steps since the reset, of which `max_episode_steps` ends the episode.
    pub fn set_elapsed(&mut self, steps: u64) {
        self.task.set_elapsed(steps);
    }

    /// The teacher's action now: what the clock commands, as a fraction of the action range.
    #[must_use]
    pub fn teacher_action(&self) -> [f64; 2] {
        self.task.teacher_action()
    }

    /// One control period under an action, each entry in [−1, 1].
    ///
    /// If the arm leaves its domain the outcome carries the failure, the arm keeps its last valid
    /// state, and only a reset goes on.
    ///
    /// # Errors
    /// [`ParameterError::OutOfRange`] for an action outside its bounds, [`ParameterError::NotRunning`]
    /// without a reset; nothing is changed then.
    pub fn step(&mut self, action: [f64; 2]) -> Result<Outcome, ParameterError> {
        let action = check_step(action, self.running())?;
        let command = self.task.command(action);
        let steps = self.task.physics_steps();
        let failure = control_step(&mut self.arm, command, steps, || Ok(()))?;
        self.see();
        let outcome = self.task.after(action, self.arm.base_degrees(), failure);
        Ok(self.told(outcome))
    }

    /// The agent's next look at the springs.
    fn see(&mut self) {
        if self.task.disturbed() {
            self.task.see(&mut self.arm.lengths());
        }
    }

    /// What the agent sees of the spring lengths \[m\], 4 for each compartment: the lengths themselves,
    /// unless the settings ask for noise, delay or dropout.
    #[must_use]
    pub fn observation(&self) -> Vec<f64> {
        let mut lengths = self.arm.lengths();
        self.task.show(&mut lengths);
        lengths
    }

    /// Saves everything the episode needs to go on.
    #[must_use]
    pub fn state(&self) -> EpisodeState {
        self.task.state(self.arm.state())
    }

    /// Goes on exactly where an episode of the same settings was saved.
    ///
    /// # Errors
    /// [`ParameterError`] for a state that does not fit; nothing is changed then.
    pub fn set_state(&mut self, state: &EpisodeState) -> Result<(), ParameterError> {
        let (body, standing) = self.task.saved(state)?;
        let mut arm = body.clone();
        arm.set_state(standing)?;
        self.arm = arm;
        self.task.set_state(state);
        Ok(())
    }
}
