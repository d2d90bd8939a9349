//! The rules of an episode in which the arm's muscles bring its tip to a goal.

use std::sync::Arc;

use octoarm_arm::transcendental::exp_negative;
use octoarm_arm::{Arm, ArmLanes, ArmState, DomainError, Interval, ParameterError, memory};
use rand_core::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::config::{Factors, draw_factors};
use crate::control::control_step_of_lanes;
use crate::draw::choose;
use crate::episode_batch::{Autoreset, EpisodeBatch};
use crate::goals::{FARTHEST, check_goal};
use crate::outcome::{Reading, Word, Words};
use crate::reach_bodies::ReachBodies;
use crate::reach_config::{MUSCLES, ReachConfig, ReachReward, distance};
use crate::senses::{DisturbanceInfo, Disturbances, Senses};
use crate::task::{Stage, Task, check_entry, check_limit};

/// What a step or a reset brought, beside the spring lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct ReachOutcome {
    /// Reward of the step; 0 of a reset.
    pub reward: f64,
    /// Centre of the arm's last plane \[m\].
    pub tip: [f64; 3],
    /// Where it should be \[m\].
    pub goal: [f64; 3],
    /// Distance between the two \[m\].
    pub distance: f64,
    /// Whether that is within the threshold.
    pub success: bool,
    /// Body of the episode, one of those that were drawn.
    pub body: usize,
    /// Reason for which the episode ended, if the arm left its domain.
    pub failure: Option<DomainError>,
    /// Whether the episode ended because its time is over.
    pub truncated: bool,
    /// What lies between the agent and the body, where anything does.
    pub disturbance: Option<Box<DisturbanceInfo>>,
}

impl ReachOutcome {
    /// Whether the arm left its domain.
    #[must_use]
    pub fn terminated(&self) -> bool {
        self.failure.is_some()
    }
}

/// No bounds but those of the type.
const UNBOUNDED: fn(&ReachConfig) -> [Option<f64>; 2] = |_| [None, None];

impl Words for ReachOutcome {
    type Bounds = fn(&ReachConfig) -> [Option<f64>; 2];

    fn result() -> &'static [Word<Self>; 3] {
        const RESULT: [Word<ReachOutcome>; 3] = [
            Word {
                name: "reward",
                reading: Reading::Number(|outcome| outcome.reward),
                bounds: |config| match config.reward_type {
                    ReachReward::Sparse => [Some(-1.0), Some(0.0)],
                    ReachReward::Dense => [None, Some(0.0)],
                },
            },
            Word {
                name: "terminated",
                reading: Reading::Flag(ReachOutcome::terminated),
                bounds: UNBOUNDED,
            },
            Word {
                name: "truncated",
                reading: Reading::Flag(|outcome| outcome.truncated),
                bounds: UNBOUNDED,
            },
        ];
        &RESULT
    }

    fn seen() -> &'static [Word<Self>] {
        const SEEN: [Word<ReachOutcome>; 2] = [
            Word {
                name: "achieved_goal",
                reading: Reading::Point(|outcome| outcome.tip),
                // Every spring stays within the domain.
                bounds: |config| {
                    let farthest = config.observation_bounds().1 * config.arm.compartments as f64;
                    [Some(-farthest), Some(farthest)]
                },
            },
            Word {
                name: "desired_goal",
                reading: Reading::Point(|outcome| outcome.goal),
                bounds: |_| [Some(-FARTHEST), Some(FARTHEST)],
            },
        ];
        &SEEN
    }

    fn info() -> &'static [Word<Self>] {
        const INFO: [Word<ReachOutcome>; 4] = [
            Word {
                name: "is_success",
                reading: Reading::Flag(|outcome| outcome.success),
                bounds: UNBOUNDED,
            },
            Word {
                name: "distance",
                reading: Reading::Number(|outcome| outcome.distance),
                bounds: |_| [Some(0.0), None],
            },
            Word {
                name: "body",
                reading: Reading::Index(|outcome| outcome.body),
                bounds: |config| [Some(0.0), Some(config.bodies as f64 - 1.0)],
            },
            Word {
                name: "failure",
                reading: Reading::Text(|outcome| {
                    outcome.failure.map(|failure| failure.to_string())
                }),
                bounds: UNBOUNDED,
            },
        ];
        &INFO
    }
}

/// Everything an episode needs to go on exactly where it was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReachState {
    arm: ArmState,
    activation: Vec<f64>,
    /// Of the last step; after a reset, 0.
    action: Vec<f64>,
    goal: [f64; 3],
    running: bool,
    over: bool,
    elapsed: u64,
    generator: Pcg64,
    body: usize,
    senses: Option<Senses>,
    /// What the agent has seen, where it sees rates.
    seen: Vec<f64>,
}

/// What all episodes of the same settings share.
#[derive(Debug)]
struct Shared {
    config: ReachConfig,
    disturbances: Disturbances,
    goals: Vec<[f64; 3]>,
    max_episode_steps: Option<u64>,
    /// The bodies at rest, and the states that they are in.
    bodies: Vec<(Arm, ArmState)>,
    /// Factors that they were drawn with.
    factors: Vec<Factors>,
    physics_steps: u32,
    /// Share of its way to the action that the activation makes in a physics step.
    pace: f64,
    /// Force of a fully active muscle of every compartment \[N\].
    forces: Vec<f64>,
}

/// Where an episode begins.
#[derive(Clone, Copy, Debug)]
pub struct ReachStart {
    body: usize,
    goal: [f64; 3],
}

/// The tip is brought to a goal by the muscles, the base being fixed: an episode apart from its arm.
#[derive(Clone, Debug)]
pub struct Reach {
    shared: Arc<Shared>,
    body: usize,
    goal: [f64; 3],
    activation: Vec<f64>,
    /// Of the last step; after a reset, 0.
    action: Vec<f64>,
    stage: Stage,
    elapsed: u64,
    generator: Pcg64,
    senses: Option<Senses>,
    seen: Vec<f64>,
}

impl Shared {
    fn new(bodies: ReachBodies, max_episode_steps: Option<u64>) -> Result<Self, ParameterError> {
        check_limit(max_episode_steps)?;
        let ReachBodies { config, goals, arms: bodies, .. } = bodies.finish()?;
        let arm = &config.arm;
        let forces = (0..arm.compartments)
            .map(|j| {
                let radius = (arm.rest_radius(j) + arm.rest_radius(j + 1)) / 2.0;
                config.max_force * (radius / arm.base_radius).powi(2)
            })
            .collect();
        Ok(Self {
            disturbances: config.disturbances(),
            physics_steps: config.physics_steps(),
            pace: 1.0 - exp_negative(config.arm.timestep / config.activation_time),
            goals,
            max_episode_steps,
            bodies,
            factors: draw_factors(&config.vary, config.bodies, config.body_seed),
            forces,
            config,
        })
    }
}

impl Reach {
    fn outcome(&self, lanes: &ArmLanes, lane: usize, failure: Option<DomainError>) -> ReachOutcome {
        let tip = lanes.state(lane).positions().last().copied().unwrap_or_default();
        let distance = distance(tip, self.goal);
        ReachOutcome {
            reward: 0.0,
            tip,
            goal: self.goal,
            distance,
            success: distance <= self.shared.config.distance_threshold,
            body: self.body,
            failure,
            truncated: false,
            disturbance: None,
        }
    }

    /// The activations, [`MUSCLES`] of every segment, follow an action through a physics step, and the
    /// muscles pull by them: ξ_c and δ_c \[N\] of all springs go to the rows.
    fn pull(&mut self, action: &[f64], longitudinal: &mut Vec<f64>, transverse: &mut Vec<f64>) {
        let Shared { config, forces, pace, .. } = &*self.shared;
        for (active, wanted) in self.activation.iter_mut().zip(action) {
            *active += pace * (wanted - *active);
        }
        longitudinal.clear();
        transverse.clear();
        for (j, force) in forces.iter().enumerate() {
            let first = MUSCLES * (j * config.segments / forces.len());
            let muscles = &self.activation[first..first + MUSCLES];
            // ξ_c and δ_c push; muscles pull.
            longitudinal.extend(muscles[..4].iter().map(|active| -force * active));
            transverse.extend([-force * muscles[4]; 4]);
        }
    }
}

/// Checks the actions of a batch of arms with so many muscles each.
///
/// # Errors
/// [`ParameterError`] that names the entry, its value and its range.
pub fn check_activations(
    actions: &[Vec<f64>],
    muscles: usize,
) -> Result<Vec<Vec<f64>>, ParameterError> {
    let of_one = |(index, action): (usize, &Vec<f64>)| {
        if action.len() != muscles {
            let shape = |count: usize| format!("({count},)");
            let (name, found) = (format!("actions[{index}]"), shape(action.len()));
            return Err(ParameterError::shape(&name, found, shape(muscles)));
        }
        let entries = action.iter().enumerate();
        entries
            .map(|(muscle, value)| {
                check_entry(0.0, *value, || format!("actions[{index}, {muscle}]"))
            })
            .collect()
    };
    actions.iter().enumerate().map(of_one).collect()
}

impl Task for Reach {
    type Action = Vec<f64>;
    type Ask = [f64; 3];
    type Start = ReachStart;
    type Outcome = ReachOutcome;
    type State = ReachState;

    fn stage(&self) -> Stage {
        self.stage
    }

    fn elapsed(&self) -> u64 {
        self.elapsed
    }

    fn action(&self) -> Vec<f64> {
        self.action.clone()
    }

    fn seed(&mut self, seed: u64) {
        self.generator = Pcg64::seed_from_u64(seed);
        if let Some(senses) = &mut self.senses {
            senses.seed(seed);
        }
    }

    fn check_ask(goal: [f64; 3]) -> Result<(), ParameterError> {
        check_goal(goal, |axis| format!("goal[{axis}]"))
    }

    /// The goal is drawn first: so it does not depend on whether bodies vary.
    fn draw(&mut self, goal: Option<[f64; 3]>) -> ReachStart {
        let goals = &self.shared.goals;
        let goal = goal.unwrap_or_else(|| goals[choose(&mut self.generator, goals.len())]);
        let bodies = self.shared.bodies.len();
        let body = if bodies > 1 { choose(&mut self.generator, bodies) } else { 0 };
        ReachStart { body, goal }
    }

    fn body(&self, start: ReachStart) -> &Arm {
        &self.shared.bodies[start.body].0
    }

    fn first_state(&self, start: ReachStart) -> &ArmState {
        &self.shared.bodies[start.body].1
    }

    fn begin(&mut self, start: ReachStart) {
        self.body = start.body;
        self.goal = start.goal;
        self.activation.fill(0.0);
        self.action.fill(0.0);
        self.stage = Stage::Running;
        self.elapsed = 0;
        self.seen.clear();
        if let Some(senses) = &mut self.senses {
            senses.begin();
        }
    }

    fn check_actions(&self, actions: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, ParameterError> {
        check_activations(actions, self.activation.len())
    }

    fn physics_steps(&self) -> u32 {
        self.shared.physics_steps
    }

    fn advance(
        lanes: &mut ArmLanes,
        tasks: &mut [Self],
        actions: &[Vec<f64>],
        steps: &[u32; ArmLanes::WIDTH],
    ) -> [Option<DomainError>; ArmLanes::WIDTH] {
        let (mut longitudinal, mut transverse) = (Vec::new(), Vec::new());
        let hold = [[0.0; 2]; ArmLanes::WIDTH];
        control_step_of_lanes(lanes, &hold, steps, |lanes, lane| {
            tasks[lane].pull(&actions[lane], &mut longitudinal, &mut transverse);
            let pulled = lanes.set_muscles(lane, &longitudinal, &transverse);
            debug_assert!(pulled.is_ok(), "finite forces of all springs");
        })
    }

    fn finish(
        &mut self,
        action: &Vec<f64>,
        lanes: &ArmLanes,
        lane: usize,
        failure: Option<DomainError>,
    ) -> ReachOutcome {
        self.elapsed = self.elapsed.saturating_add(1);
        self.action.clone_from(action);
        let mut outcome = self.outcome(lanes, lane, failure);
        outcome.reward = self.shared.config.reward(outcome.distance);
        outcome.truncated = self.shared.max_episode_steps.is_some_and(|most| self.elapsed >= most);
        if outcome.terminated() || outcome.truncated {
            self.stage = Stage::Over;
        }
        outcome
    }

    fn standing(&self, lanes: &ArmLanes, lane: usize) -> ReachOutcome {
        self.outcome(lanes, lane, None)
    }

    fn observation_len(&self, springs: usize) -> usize {
        if self.shared.config.observe_rates { 2 * springs } else { springs }
    }

    fn see(&mut self, row: &mut [f64]) {
        let Shared { config, disturbances, .. } = &*self.shared;
        let (lengths, rates) = row.split_at_mut(4 * config.arm.compartments);
        if let Some(senses) = &mut self.senses {
            senses.see(disturbances, lengths);
        }
        if config.observe_rates {
            // Of an episode that has just begun nothing was seen before.
            rates.fill(0.0);
            for ((rate, now), before) in rates.iter_mut().zip(&*lengths).zip(&self.seen) {
                *rate = (now - before) / config.control_period;
            }
            self.seen.clear();
            self.seen.extend_from_slice(row);
        }
    }

    fn tell(&self, lengths: &dyn Fn() -> Vec<f64>, outcome: &mut ReachOutcome) {
        let Shared { disturbances, factors, .. } = &*self.shared;
        let senses = self.senses.as_ref();
        outcome.disturbance =
            DisturbanceInfo::of(senses, disturbances, &factors[self.body], lengths);
    }

    fn show(&self, row: &mut [f64]) {
        let (lengths, rates) = row.split_at_mut(4 * self.shared.config.arm.compartments);
        if let Some(senses) = &self.senses {
            senses.show(lengths);
        }
        match self.seen.get(lengths.len()..) {
            Some(seen) if !seen.is_empty() => rates.copy_from_slice(seen),
            _ => rates.fill(0.0),
        }
    }

    fn state(&self, arm: ArmState) -> ReachState {
        ReachState {
            arm,
            activation: self.activation.clone(),
            action: self.action.clone(),
            goal: self.goal,
            running: self.stage == Stage::Running,
            over: self.stage == Stage::Over,
            elapsed: self.elapsed,
            generator: self.generator.clone(),
            body: self.body,
            senses: self.senses.clone(),
            seen: self.seen.clone(),
        }
    }

    fn saved<'a>(
        &'a self,
        state: &'a ReachState,
    ) -> Result<(&'a Arm, &'a ArmState), ParameterError> {
        let Shared { bodies, disturbances, config, .. } = &*self.shared;
        let Some((body, _)) = bodies.get(state.body) else {
            let range = format!("[0, {}]", bodies.len() - 1);
            return Err(ParameterError::out_of_range("body", state.body, range));
        };
        Senses::check(state.senses.as_ref(), disturbances, 4 * config.arm.compartments)?;
        Self::check_ask(state.goal)?;
        for (name, found) in [("activation", &state.activation), ("action", &state.action)] {
            let (found, expected) = (found.len(), self.activation.len());
            if found != expected {
                let shape = |count: usize| format!("({count},)");
                return Err(ParameterError::shape(name, shape(found), shape(expected)));
            }
        }
        let (low, high) = disturbances.bounds;
        let springs = 4 * config.arm.compartments;
        let width = if config.observe_rates { 2 * springs } else { 0 };
        if ![0, width].contains(&state.seen.len()) {
            let shape = |count: usize| format!("({count},)");
            return Err(ParameterError::shape("seen", shape(state.seen.len()), shape(width)));
        }
        for (index, value) in state.seen.iter().enumerate() {
            let range = if index < springs {
                Interval::closed(low, high).of("m")
            } else {
                Interval::within(config.fastest()).of("m/s")
            };
            range.check(*value, || format!("seen[{index}]"))?;
        }
        for (name, values) in [("activation", &state.activation), ("action", &state.action)] {
            for (index, value) in values.iter().enumerate() {
                Interval::closed(0.0, 1.0).check(*value, || format!("{name}[{index}]"))?;
            }
        }
        Ok((body, &state.arm))
    }

    fn set_state(&mut self, state: &ReachState) {
        self.activation.clone_from(&state.activation);
        self.action.clone_from(&state.action);
        self.goal = state.goal;
        self.stage = Stage::saved(state.running, state.over);
        self.elapsed = state.elapsed;
        self.generator = state.generator.clone();
        self.body = state.body;
        self.senses.clone_from(&state.senses);
        self.seen.clone_from(&state.seen);
    }
}

impl EpisodeBatch<Reach> {
    /// So many episodes that wait for their first reset, whose goals are drawn from these \[m\]; the rest
    /// is as in [`EpisodeBatch::new`].
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range; more episodes than fit into
    /// memory.
    pub fn reaching(
        config: ReachConfig,
        goals: Vec<[f64; 3]>,
        count: usize,
        max_episode_steps: Option<u64>,
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        let bodies = ReachBodies::new(config, goals)?;
        Self::reaching_with(bodies, count, max_episode_steps, autoreset, threads)
    }

    /// As [`EpisodeBatch::reaching`], with bodies that may be made already.
    ///
    /// # Errors
    /// As [`EpisodeBatch::reaching`].
    pub fn reaching_with(
        bodies: ReachBodies,
        count: usize,
        max_episode_steps: Option<u64>,
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        if count == 0 {
            return Err(ParameterError::out_of_range("num_envs", 0, "of positive numbers"));
        }
        let shared = Arc::new(Shared::new(bodies, max_episode_steps)?);
        let task = Reach {
            body: 0,
            goal: shared.goals[0],
            activation: vec![0.0; shared.config.muscles()],
            action: vec![0.0; shared.config.muscles()],
            stage: Stage::Waiting,
            elapsed: 0,
            generator: Pcg64::seed_from_u64(0),
            senses: Senses::of(&shared.disturbances),
            seen: Vec::new(),
            shared: Arc::clone(&shared),
        };
        let what = format!("num_envs = {count}");
        let mut tasks = memory::reserved(&what, Some(count))?;
        let mut bodies: Vec<&Arm> = memory::reserved(&what, Some(count))?;
        tasks.resize(count, task);
        bodies.resize(count, &shared.bodies[0].0);
        Self::of_tasks(tasks, &bodies, autoreset, threads)
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &ReachConfig {
        &self.tasks()[0].shared.config
    }

    /// The activations of an arm's muscles, [`MUSCLES`] of every segment from the base on.
    #[must_use]
    pub fn activations(&self, index: usize) -> &[f64] {
        &self.tasks()[index].activation
    }
}
