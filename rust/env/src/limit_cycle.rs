//! The rules of an episode in which the base follows a limit cycle.

use octoarm_arm::{Arm, ArmLanes, ArmState, DomainError, Interval, ParameterError};
use rand_core::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::config::CheckedConfig;
use crate::control::control_step_of_lanes;
use crate::draw::choose;
use crate::outcome::Outcome;
use crate::reward::Reward;
use crate::senses::{DisturbanceInfo, Disturbances, Senses};
use crate::swing::{Snapshot, Swing, Swings};
use crate::task::{Stage, Task, check_entry, check_limit};

/// Everything an episode needs to go on exactly where it was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeState {
    /// State of the arm.
    pub arm: ArmState,
    /// Number of the control instant on the target's clock.
    pub tick: i64,
    /// Base of the undisturbed clock, `[θ, φ, θ̇, φ̇]` \[degrees, degrees/s\].
    #[serde(rename = "clock")]
    pub undisturbed: [f64; 4],
    /// Action of the last step, each entry in \[−1, 1\].
    pub action: [f64; 2],
    /// Whether the episode runs: it was reset and is not over.
    pub running: bool,
    /// Whether the arm has left its domain, or the time is over.
    #[serde(default)]
    pub over: bool,
    /// Number of steps since the reset.
    #[serde(default)]
    pub elapsed: u64,
    /// Generator that draws the phases of the next resets.
    pub generator: Pcg64,
    /// Body of the episode, one of those that were drawn.
    #[serde(default, skip_serializing_if = "is_first")]
    pub body: usize,
    /// Of the disturbances, where there are any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub senses: Option<Senses>,
}

// By reference, as serde calls it.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_first(body: &usize) -> bool {
    *body == 0
}

/// Where an episode begins: with a body, at a snapshot of its swing.
#[derive(Clone, Copy, Debug)]
pub struct Start {
    pub(crate) body: usize,
    pub(crate) snapshot: usize,
}

/// Largest control instant of a saved state: every one up to it is a double.
const LATEST: u64 = 1 << 53;
/// Largest angle or rate of a saved state's clock \[degrees, degrees/s\] and base \[rad, rad/s\].
const WIDEST: f64 = 1e9;

impl EpisodeState {
    /// Checks what is not the arm's; a state may come from anywhere.
    pub(crate) fn check(&self, task: &LimitCycle) -> Result<(), ParameterError> {
        let springs = task.swing().arm.observation_len();
        if self.body >= task.swings.len() {
            let range = format!("[0, {}]", task.swings.len() - 1);
            return Err(ParameterError::out_of_range("body", self.body, range));
        }
        Senses::check(self.senses.as_ref(), &task.disturbances, springs)?;
        if self.tick.unsigned_abs() > LATEST {
            let range = format!("[-{LATEST}, {LATEST}]");
            return Err(ParameterError::out_of_range("tick", self.tick, range));
        }
        for (name, values) in [("clock", self.undisturbed), ("arm.base", self.arm.base)] {
            for (index, value) in values.into_iter().enumerate() {
                Interval::within(WIDEST).check(value, || format!("{name}[{index}]"))?;
            }
        }
        check_action(self.action, |axis| format!("action[{axis}]")).map(|_| ())
    }
}

/// The base follows a limit cycle: an episode apart from the arm that it moves.
#[derive(Clone, Debug)]
pub struct LimitCycle {
    config: CheckedConfig,
    disturbances: Disturbances,
    swings: Swings,
    body: usize,
    reward: Reward,
    action_range: f64,
    physics_steps: u32,
    tick: i64,
    undisturbed: [f64; 4],
    action: [f64; 2],
    stage: Stage,
    elapsed: u64,
    max_episode_steps: Option<u64>,
    generator: Pcg64,
    senses: Option<Senses>,
}

impl LimitCycle {
    /// A task that waits for its first [`LimitCycle::begin`], on the swings of its settings; episodes end
    /// after `max_episode_steps`.
    pub(crate) fn new(
        config: CheckedConfig,
        swings: Swings,
        max_episode_steps: Option<u64>,
    ) -> Result<Self, ParameterError> {
        check_limit(max_episode_steps)?;
        let amplitude = swings[0].orbit.amplitude();
        let reward = config.reward(amplitude);
        // The tracking error is divided by it; a product of two positive numbers may be too small.
        if !reward.width.is_normal() {
            let value = format!("{} of an amplitude of {amplitude} degrees", config.reward_width);
            let range = format!("of widths from {:e} degrees", f64::MIN_POSITIVE);
            return Err(ParameterError::out_of_range("reward_width", value, range));
        }
        Ok(Self {
            reward,
            action_range: config.resolved_action_range(amplitude),
            physics_steps: config.physics_steps(),
            tick: 0,
            undisturbed: [0.0; 4],
            action: [0.0; 2],
            stage: Stage::Waiting,
            elapsed: 0,
            max_episode_steps,
            generator: Pcg64::seed_from_u64(0),
            senses: Senses::of(&config.disturbances()),
            disturbances: config.disturbances(),
            config,
            swings,
            body: 0,
        })
    }

    pub(crate) fn config(&self) -> &CheckedConfig {
        &self.config
    }

    /// The swing of this body.
    pub(crate) fn swing(&self) -> &Swing {
        &self.swings[self.body]
    }

    /// Base angle of an action of 1 \[degrees\].
    pub(crate) fn action_range(&self) -> f64 {
        self.action_range
    }

    pub(crate) fn set_elapsed(&mut self, steps: u64) {
        self.elapsed = steps;
    }

    /// The snapshot nearest to a phase; of all swings the same, since they have one orbit.
    fn nearest(&self, phase: f64) -> usize {
        let turns_a_tick = self.config.control_period / self.swing().orbit.period();
        let distance = |index: &usize| {
            let difference = (*index as f64 * turns_a_tick - phase).rem_euclid(1.0);
            difference.min(1.0 - difference)
        };
        let snapshots = 0..self.swing().snapshots.len();
        snapshots.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// Whether anything lies between the agent and the body.
    pub(crate) fn disturbed(&self) -> bool {
        self.senses.is_some()
    }

    /// What a reset brought.
    pub(crate) fn first_outcome(&self, base: [f64; 2]) -> Outcome {
        self.outcome(self.action, base, None)
    }

    fn as_action(&self, command: [f64; 2]) -> [f64; 2] {
        command.map(|angle| (angle / self.action_range).clamp(-1.0, 1.0))
    }

    /// What the clock commands now, as a fraction of the action range.
    pub(crate) fn teacher_action(&self) -> [f64; 2] {
        self.as_action(self.swing().clock.command(self.tick, self.undisturbed).0)
    }

    /// The angles \[degrees\] that the base is commanded by an action, noise included.
    pub(crate) fn command(&mut self, action: [f64; 2]) -> [f64; 2] {
        let command = action.map(|share| share * self.action_range);
        match &mut self.senses {
            None => command,
            Some(senses) => senses.disturb(&self.disturbances, command),
        }
    }

    /// The clock goes on after a control period under `action`.
    pub(crate) fn after(
        &mut self,
        action: [f64; 2],
        base: [f64; 2],
        failure: Option<DomainError>,
    ) -> Outcome {
        self.undisturbed = self.swing().clock.command(self.tick, self.undisturbed).1;
        self.tick += 1;
        let before = std::mem::replace(&mut self.action, action);
        self.elapsed = self.elapsed.saturating_add(1);
        let mut outcome = self.outcome(before, base, failure);
        outcome.reward = outcome.terms.total();
        outcome.truncated = self.max_episode_steps.is_some_and(|most| self.elapsed >= most);
        if outcome.terminated() || outcome.truncated {
            self.stage = Stage::Over;
        }
        outcome
    }

    fn outcome(&self, before: [f64; 2], base: [f64; 2], failure: Option<DomainError>) -> Outcome {
        let target = self.swing().clock.target(self.tick);
        let (x, y) = (base[0] - target[0], base[1] - target[1]);
        let tracking_error = (x * x + y * y).sqrt();
        let mut terms = self.reward.terms(tracking_error, self.action, before);
        if failure.is_some() {
            terms.tracking = 0.0;
        }
        Outcome {
            reward: 0.0,
            terms,
            base,
            target,
            tracking_error,
            body: self.body,
            failure,
            truncated: false,
            disturbance: None,
        }
    }
}

impl Task for LimitCycle {
    type Action = [f64; 2];
    type Ask = f64;
    type Start = Start;
    type Outcome = Outcome;
    type State = EpisodeState;

    fn stage(&self) -> Stage {
        self.stage
    }

    fn elapsed(&self) -> u64 {
        self.elapsed
    }

    fn action(&self) -> [f64; 2] {
        self.action
    }

    fn seed(&mut self, seed: u64) {
        self.generator = Pcg64::seed_from_u64(seed);
        if let Some(senses) = &mut self.senses {
            senses.seed(seed);
        }
    }

    fn check_ask(phase: f64) -> Result<(), ParameterError> {
        check_phase(phase)
    }

    fn draw(&mut self, phase: Option<f64>) -> Start {
        let snapshots = self.swing().snapshots.len();
        let snapshot = match phase {
            Some(phase) => self.nearest(phase),
            None => choose(&mut self.generator, snapshots),
        };
        let bodies = self.swings.len();
        let body = if bodies > 1 { choose(&mut self.generator, bodies) } else { 0 };
        Start { body, snapshot }
    }

    fn body(&self, start: Start) -> &Arm {
        &self.swings[start.body].arm
    }

    fn first_state(&self, start: Start) -> &ArmState {
        &self.swings[start.body].snapshots[start.snapshot].arm
    }

    fn begin(&mut self, start: Start) {
        let Snapshot { undisturbed, command, .. } =
            self.swings[start.body].snapshots[start.snapshot];
        self.body = start.body;
        self.tick = start.snapshot as i64;
        self.undisturbed = undisturbed;
        self.action = self.as_action(command);
        self.stage = Stage::Running;
        self.elapsed = 0;
        if let Some(senses) = &mut self.senses {
            senses.begin();
        }
    }

    fn check_actions(&self, actions: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, ParameterError> {
        check_actions(actions)
    }

    fn physics_steps(&self) -> u32 {
        self.physics_steps
    }

    fn advance(
        lanes: &mut ArmLanes,
        tasks: &mut [Self],
        actions: &[[f64; 2]],
        steps: &[u32; ArmLanes::WIDTH],
    ) -> [Option<DomainError>; ArmLanes::WIDTH] {
        let mut goals = [[0.0; 2]; ArmLanes::WIDTH];
        for (lane, task) in tasks.iter_mut().enumerate().filter(|(lane, _)| steps[*lane] > 0) {
            goals[lane] = task.command(actions[lane]);
        }
        control_step_of_lanes(lanes, &goals, steps, |_, _| ())
    }

    fn finish(
        &mut self,
        action: &[f64; 2],
        lanes: &ArmLanes,
        lane: usize,
        failure: Option<DomainError>,
    ) -> Outcome {
        self.after(*action, lanes.base_degrees(lane), failure)
    }

    fn standing(&self, lanes: &ArmLanes, lane: usize) -> Outcome {
        self.first_outcome(lanes.base_degrees(lane))
    }

    fn see(&mut self, lengths: &mut [f64]) {
        if let Some(senses) = &mut self.senses {
            senses.see(&self.disturbances, lengths);
        }
    }

    fn tell(&self, lengths: &dyn Fn() -> Vec<f64>, outcome: &mut Outcome) {
        let factors = self.config.factors(self.body);
        outcome.disturbance =
            DisturbanceInfo::of(self.senses.as_ref(), &self.disturbances, factors, lengths);
    }

    fn show(&self, lengths: &mut [f64]) {
        if let Some(senses) = &self.senses {
            senses.show(lengths);
        }
    }

    fn state(&self, arm: ArmState) -> EpisodeState {
        EpisodeState {
            arm,
            tick: self.tick,
            undisturbed: self.undisturbed,
            action: self.action,
            running: self.stage == Stage::Running,
            over: self.stage == Stage::Over,
            elapsed: self.elapsed,
            generator: self.generator.clone(),
            body: self.body,
            senses: self.senses.clone(),
        }
    }

    fn saved<'a>(
        &'a self,
        state: &'a EpisodeState,
    ) -> Result<(&'a Arm, &'a ArmState), ParameterError> {
        state.check(self)?;
        Ok((&self.swings[state.body].arm, &state.arm))
    }

    fn set_state(&mut self, state: &EpisodeState) {
        self.tick = state.tick;
        self.undisturbed = state.undisturbed;
        self.action = state.action;
        self.stage = Stage::saved(state.running, state.over);
        self.elapsed = state.elapsed;
        self.generator = state.generator.clone();
        self.body = state.body;
        self.senses.clone_from(&state.senses);
    }
}

/// Checks a phase in turns.
pub(crate) fn check_phase(phase: f64) -> Result<(), ParameterError> {
    Interval::closed(0.0, 1.0).of("turns").check(phase, || "phase".to_owned())
}

/// Checks an action, and gives it without the rounding past its bounds; `name` gives the name of an
/// entry in the message.
pub(crate) fn check_action(
    action: [f64; 2],
    name: impl Fn(usize) -> String,
) -> Result<[f64; 2], ParameterError> {
    Ok([check_entry(-1.0, action[0], || name(0))?, check_entry(-1.0, action[1], || name(1))?])
}

/// Checks the actions of a batch as the step of one does, and gives them without what rounding in
/// single precision adds to their bounds.
///
/// # Errors
/// [`ParameterError::OutOfRange`] that names the entry, each of which is in [−1, 1].
pub fn check_actions(actions: &[[f64; 2]]) -> Result<Vec<[f64; 2]>, ParameterError> {
    let actions = actions.iter().enumerate();
    actions
        .map(|(index, action)| check_action(*action, |axis| format!("actions[{index}, {axis}]")))
        .collect()
}

/// Checks what a step is asked: an action, each entry in [−1, 1], of an episode that runs. Gives the
/// action, without what rounding in single precision adds to its bounds.
///
/// # Errors
/// [`ParameterError::OutOfRange`] that names the entry, [`ParameterError::NotRunning`].
pub fn check_step(action: [f64; 2], running: bool) -> Result<[f64; 2], ParameterError> {
    let action = check_action(action, |axis| format!("action[{axis}]"))?;
    if running { Ok(action) } else { Err(ParameterError::NotRunning { name: "step".to_owned() }) }
}
