//! The rules of an episode in which the arm's muscles bring its tip to a goal.

use std::collections::BTreeMap;
use std::sync::Arc;

use octoarm_arm::transcendental::exp_negative;
use octoarm_arm::{
    Actuator, Arm, ArmLanes, ArmParameters, ArmState, DomainError, Interval, ParameterError,
    memory, poll, read_json,
};
use rand_core::SeedableRng;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::config::{check_counts, check_period, draw_bodies, draw_factors, length_bounds};
use crate::control::control_step_of_lanes;
use crate::draw::choose;
use crate::episode_batch::{Autoreset, EpisodeBatch};
use crate::outcome::Reading;
use crate::reward::ReachReward;
use crate::senses::{DisturbanceInfo, Disturbances, Senses};
use crate::task::{Stage, Task, check_entry, check_limit};

/// Groups of muscles in a segment: the longitudinal ones of the four sides, and the transverse ones.
pub const MUSCLES: usize = 5;
/// Largest coordinate of a goal \[m\].
const FARTHEST: f64 = 10.0;

/// Everything that `gym.make("OctoArmReach-v0", …)` takes, beside goals, rendering and length.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReachConfig {
    /// Body; by default [`ArmParameters::nakajima2013`].
    pub arm: ArmParameters,
    /// Time from one action to the next \[s\], as in [`crate::EpisodeConfig`]; by default 0.05.
    pub control_period: f64,
    /// Parts along the arm whose muscles act as one, from 1 to the number of compartments; by default 5.
    pub segments: usize,
    /// Force of a fully active muscle at the arm's base \[N\], in (0, 100\]; by default 1. Along the arm
    /// it falls as the cross-section does: the stress is the same.
    pub max_force: f64,
    /// Time constant with which the activation follows the action \[s\], in (0, 10\]; by default 0.1.
    pub activation_time: f64,
    /// Distance from the goal at which it counts as reached \[m\], in (0, 1\]; by default 0.02.
    pub distance_threshold: f64,
    /// Reward of a step; by default [`ReachReward::Sparse`].
    pub reward_type: ReachReward,
    /// Whether the agent sees, after the lengths, how fast they have changed in the last control period
    /// on average \[m/s\]; by default not.
    pub observe_rates: bool,
    /// As in [`crate::EpisodeConfig`].
    pub length_noise: f64,
    /// As in [`crate::EpisodeConfig`].
    pub delay: usize,
    /// As in [`crate::EpisodeConfig`].
    pub dropout: usize,
    /// As in [`crate::EpisodeConfig`].
    pub vary: BTreeMap<String, [f64; 2]>,
    /// As in [`crate::EpisodeConfig`].
    pub bodies: usize,
    /// As in [`crate::EpisodeConfig`].
    pub body_seed: u64,
}

impl Default for ReachConfig {
    fn default() -> Self {
        Self {
            arm: ArmParameters::default(),
            control_period: 0.05,
            segments: 5,
            max_force: 1.0,
            activation_time: 0.1,
            distance_threshold: 0.02,
            reward_type: ReachReward::Sparse,
            observe_rates: false,
            length_noise: 0.0,
            delay: 0,
            dropout: 0,
            vary: BTreeMap::new(),
            bodies: 1,
            body_seed: 0,
        }
    }
}

impl ReachConfig {
    /// Settings from JSON text; what is left out takes its default, and nothing is checked yet.
    ///
    /// # Errors
    /// [`ParameterError::Format`] that names the setting.
    pub fn from_json(text: &str) -> Result<Self, ParameterError> {
        read_json(text)
    }

    /// Checks every setting, and gives the parameters of the bodies that are drawn.
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range.
    pub fn drawn_bodies(&self) -> Result<Vec<ArmParameters>, ParameterError> {
        let above = Interval::above;
        self.arm.validate()?;
        for (name, value, range) in [
            ("max_force", self.max_force, above(0.0, 100.0)),
            ("activation_time", self.activation_time, above(0.0, 10.0)),
            ("distance_threshold", self.distance_threshold, above(0.0, 1.0)),
            ("length_noise", self.length_noise, Interval::closed(0.0, 1.0)),
        ] {
            range.check(value, || name.to_owned())?;
        }
        let most = self.arm.compartments;
        if !(1..=most).contains(&self.segments) {
            let range = format!("[1, {most}] of whole numbers");
            return Err(ParameterError::out_of_range("segments", self.segments, range));
        }
        check_period(self.control_period, self.arm.timestep)?;
        check_counts(self.delay, self.dropout, &self.arm)?;
        draw_bodies(&self.arm, &self.vary, self.bodies, self.body_seed)
    }

    /// Bounds of the observed spring lengths \[m\]: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> (f64, f64) {
        length_bounds(&self.arm)
    }

    /// The reward of a tip so far from the goal \[m\].
    #[must_use]
    pub fn reward(&self, distance: f64) -> f64 {
        match self.reward_type {
            ReachReward::Dense => -distance,
            ReachReward::Sparse if distance <= self.distance_threshold => 0.0,
            ReachReward::Sparse => -1.0,
        }
    }
}

/// The distance between two points \[m\].
#[must_use]
pub fn distance(tip: [f64; 3], goal: [f64; 3]) -> f64 {
    let [x, y, z] = [0, 1, 2].map(|axis| tip[axis] - goal[axis]);
    (x * x + y * y + z * z).sqrt()
}

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
    /// What Gymnasium gives in the info.
    pub const INFO: [(&'static str, Reading<Self>); 4] = [
        ("is_success", Reading::Flag(|outcome| outcome.success)),
        ("distance", Reading::Number(|outcome| outcome.distance)),
        ("body", Reading::Index(|outcome| outcome.body)),
        ("failure", Reading::Text(|outcome| outcome.failure.map(|failure| failure.to_string()))),
    ];

    /// Whether the arm left its domain.
    #[must_use]
    pub fn terminated(&self) -> bool {
        self.failure.is_some()
    }
}

/// Everything an episode needs to go on exactly where it was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReachState {
    arm: ArmState,
    activation: Vec<f64>,
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
    factors: Vec<Vec<f64>>,
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
    stage: Stage,
    elapsed: u64,
    generator: Pcg64,
    senses: Option<Senses>,
    seen: Vec<f64>,
}

impl Shared {
    fn new(
        config: ReachConfig,
        goals: Vec<[f64; 3]>,
        max_episode_steps: Option<u64>,
    ) -> Result<Self, ParameterError> {
        check_limit(max_episode_steps)?;
        let drawn = config.drawn_bodies()?;
        if goals.is_empty() {
            return Err(ParameterError::shape("goals", "(0, 3)", "(G, 3) with at least one"));
        }
        for (index, goal) in goals.iter().enumerate() {
            check_goal(*goal, |axis| format!("goals[{index}, {axis}]"))?;
        }
        let mut bodies = Vec::with_capacity(drawn.len());
        for parameters in drawn {
            poll()?;
            let arm = Arm::new(parameters, Actuator::Direct)?;
            let state = arm.state();
            bodies.push((arm, state));
        }
        let arm = &config.arm;
        let forces = (0..arm.compartments)
            .map(|j| {
                let radius = (arm.rest_radius(j) + arm.rest_radius(j + 1)) / 2.0;
                config.max_force * (radius / arm.base_radius).powi(2)
            })
            .collect();
        Ok(Self {
            disturbances: Disturbances {
                length_noise: config.length_noise,
                action_noise: 0.0,
                delay: config.delay,
                dropout: config.dropout,
                bounds: config.observation_bounds(),
                rest_length: config.arm.rest_length,
            },
            physics_steps: check_period(config.control_period, config.arm.timestep)?,
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

fn check_goal(goal: [f64; 3], name: impl Fn(usize) -> String) -> Result<(), ParameterError> {
    let mut axes = goal.into_iter().enumerate();
    axes.try_for_each(|(axis, value)| {
        Interval::within(FARTHEST).of("m").check(value, || name(axis))
    })
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
        self.stage = Stage::Running;
        self.elapsed = 0;
        self.seen.clear();
        if let Some(senses) = &mut self.senses {
            senses.begin();
        }
    }

    fn check_actions(&self, actions: &[Vec<f64>]) -> Result<Vec<Vec<f64>>, ParameterError> {
        let muscles = self.activation.len();
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
        _: &Vec<f64>,
        lanes: &ArmLanes,
        lane: usize,
        failure: Option<DomainError>,
    ) -> ReachOutcome {
        self.elapsed = self.elapsed.saturating_add(1);
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
        let (found, expected) = (state.activation.len(), self.activation.len());
        if found != expected {
            let shape = |count: usize| format!("({count},)");
            return Err(ParameterError::shape("activation", shape(found), shape(expected)));
        }
        let (low, high) = disturbances.bounds;
        let fastest = (high - low) / config.control_period;
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
                Interval::within(fastest).of("m/s")
            };
            range.check(*value, || format!("seen[{index}]"))?;
        }
        for (index, value) in state.activation.iter().enumerate() {
            Interval::closed(0.0, 1.0).check(*value, || format!("activation[{index}]"))?;
        }
        Ok((body, &state.arm))
    }

    fn set_state(&mut self, state: &ReachState) {
        self.activation.clone_from(&state.activation);
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
        if count == 0 {
            return Err(ParameterError::out_of_range("num_envs", 0, "of positive numbers"));
        }
        let shared = Arc::new(Shared::new(config, goals, max_episode_steps)?);
        let task = Reach {
            body: 0,
            goal: shared.goals[0],
            activation: vec![0.0; MUSCLES * shared.config.segments],
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
