//! Many episodes at once: eight arms in the lanes of a group, the groups shared by threads.
//!
//! Every episode has the very bits that [`crate::Episode`] gives, whatever stands beside it and
//! however many threads there are.

use std::sync::Arc;

use octoarm_arm::{Arm, ArmLanes, ArmState, DomainError, ParameterError, domain, memory, poll};
use serde::{Deserialize, Serialize};

use crate::config::EpisodeConfig;
use crate::control::command_at;
use crate::swing::Swing;
use crate::task::{EpisodeState, Outcome, Task, check_action, not_running};
use crate::workers::Workers;

const WIDTH: usize = ArmLanes::WIDTH;

/// What happens when an episode has ended (Gymnasium's `AutoresetMode`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Autoreset {
    /// The next step ignores the action and begins a new episode.
    NextStep,
    /// The step that ends the episode begins the next one.
    SameStep,
    /// Only a reset begins a new one; a step before that is an error.
    Disabled,
}

/// The end of an episode whose place was taken by the next one within the same step.
#[derive(Clone, Debug, PartialEq)]
pub struct Last {
    /// The last spring lengths \[m\].
    pub observation: Vec<f64>,
    /// What the last step brought.
    pub outcome: Outcome,
}

/// What a step of all episodes brought, an entry an episode.
#[derive(Clone, Debug)]
pub struct BatchStep {
    /// Spring lengths \[m\], [`EpisodeBatch::observation_len`] an episode.
    pub observations: Vec<f64>,
    /// Rewards; 0 where the step began a new episode.
    pub rewards: Vec<f64>,
    /// Whether the arm left its domain.
    pub terminated: Vec<bool>,
    /// Whether the episode's time is over.
    pub truncated: Vec<bool>,
    /// What the observations belong to.
    pub outcomes: Vec<Outcome>,
    /// The ends of episodes that were replaced, with [`Autoreset::SameStep`].
    pub lasts: Vec<Option<Last>>,
}

/// What a reset brought, an entry an episode.
#[derive(Clone, Debug)]
pub struct BatchReset {
    /// Spring lengths \[m\] of all episodes, reset or not.
    pub observations: Vec<f64>,
    /// Of those that were reset.
    pub outcomes: Vec<Option<Outcome>>,
}

/// An episode's place in the batch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Seat {
    /// Steps since the reset.
    elapsed: u64,
    /// Whether there was a reset at all.
    begun: bool,
    /// Whether the episode has ended and waits for a reset.
    ended: bool,
}

impl Seat {
    const EMPTY: Self = Self { elapsed: 0, begun: false, ended: false };
    const BEGUN: Self = Self { elapsed: 0, begun: true, ended: false };
}

/// Everything a batch needs to go on exactly where it was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatchState {
    episodes: Vec<EpisodeState>,
    seats: Vec<Seat>,
}

/// Up to eight episodes.
#[derive(Debug)]
struct Group {
    lanes: ArmLanes,
    tasks: Vec<Task>,
    seats: Vec<Seat>,
}

/// Where a group writes, and what it is told.
struct Errand<'a> {
    group: &'a mut Group,
    actions: &'a [[f64; 2]],
    observations: &'a mut [f64],
    rewards: &'a mut [f64],
    terminated: &'a mut [bool],
    truncated: &'a mut [bool],
    outcomes: &'a mut [Option<Outcome>],
    lasts: &'a mut [Option<Last>],
}

/// Many arms that each follow a target of their own.
#[derive(Debug)]
pub struct EpisodeBatch {
    groups: Vec<Group>,
    count: usize,
    max_episode_steps: Option<u64>,
    autoreset: Autoreset,
    workers: Workers,
}

impl Group {
    fn new(tasks: Vec<Task>) -> Result<Self, ParameterError> {
        let arms: Vec<&Arm> = tasks.iter().map(|task| &task.swing().arm).collect();
        let lanes = ArmLanes::new(&arms)?;
        Ok(Self { lanes, seats: vec![Seat::EMPTY; tasks.len()], tasks })
    }

    /// Begins episodes at snapshots, given as (lane, snapshot).
    fn begin(&mut self, starts: &[(usize, usize)]) {
        if starts.is_empty() {
            return;
        }
        let states: Vec<(usize, &ArmState)> = starts
            .iter()
            .map(|(lane, snapshot)| (*lane, self.tasks[*lane].start(*snapshot)))
            .collect();
        self.lanes.restore(&states);
        for (lane, snapshot) in starts {
            self.tasks[*lane].begin(*snapshot);
            self.seats[*lane] = Seat::BEGUN;
        }
    }

    /// One control period of the active lanes; says why a lane did not come to its end.
    fn advance(
        &mut self,
        actions: &[[f64; 2]],
        active: &[bool; WIDTH],
    ) -> [Option<DomainError>; WIDTH] {
        let mut failures = [None; WIDTH];
        let mut starts = [[0.0; 2]; WIDTH];
        let mut goals = [[0.0; 2]; WIDTH];
        let mut steps = [0; WIDTH];
        for (lane, task) in self.tasks.iter().enumerate() {
            if active[lane] {
                starts[lane] = self.lanes.base_degrees(lane);
                goals[lane] = task.command(actions[lane]);
                steps[lane] = task.physics_steps();
            }
        }
        let mut commands = [[0.0; 2]; WIDTH];
        for step in 1..=steps.into_iter().max().unwrap_or(0) {
            let mut moves = [false; WIDTH];
            for lane in 0..self.tasks.len() {
                moves[lane] = step <= steps[lane] && failures[lane].is_none();
                let actuator = self.lanes.actuator(lane);
                commands[lane] = command_at(actuator, starts[lane], goals[lane], step, steps[lane]);
            }
            if !self.lanes.step(&commands, &moves) {
                for lane in 0..self.tasks.len() {
                    // A lane that has failed before does not move any more.
                    if moves[lane] {
                        failures[lane] = self.lanes.failure(lane);
                    }
                }
            }
        }
        failures
    }
}

impl Errand<'_> {
    /// A step of the whole group.
    fn run(self, autoreset: Autoreset, max_episode_steps: Option<u64>, width: usize) {
        let Self { group, actions, observations, rewards, terminated, truncated, outcomes, lasts } =
            self;
        let count = group.tasks.len();
        let mut active = [false; WIDTH];
        let mut starts = Vec::new();
        for lane in 0..count {
            active[lane] = !group.seats[lane].ended;
            if !active[lane] {
                starts.push((lane, group.tasks[lane].draw()));
            }
        }
        group.begin(&starts);
        let failures = group.advance(actions, &active);

        let mut starts = Vec::new();
        for lane in 0..count {
            let base = group.lanes.base_degrees(lane);
            let task = &mut group.tasks[lane];
            if !active[lane] {
                outcomes[lane] = Some(task.first_outcome(base));
                continue;
            }
            let outcome = task.finish(actions[lane], base, failures[lane]);
            let seat = &mut group.seats[lane];
            seat.elapsed = seat.elapsed.saturating_add(1);
            rewards[lane] = outcome.terms.total();
            terminated[lane] = outcome.failure.is_some();
            truncated[lane] = max_episode_steps.is_some_and(|most| seat.elapsed >= most);
            seat.ended = terminated[lane] || truncated[lane];
            outcomes[lane] = Some(outcome);
            if seat.ended && autoreset == Autoreset::SameStep {
                let mut observation = vec![0.0; width];
                group.lanes.lengths_into(lane, &mut observation);
                lasts[lane] = Some(Last { observation, outcome });
                starts.push((lane, task.draw()));
            }
        }
        group.begin(&starts);
        for (lane, _) in starts {
            let base = group.lanes.base_degrees(lane);
            outcomes[lane] = Some(group.tasks[lane].first_outcome(base));
        }
        for (lane, row) in observations.chunks_exact_mut(width).enumerate() {
            group.lanes.lengths_into(lane, row);
        }
    }
}

impl EpisodeBatch {
    /// Episodes that wait for their first [`EpisodeBatch::reset`], one for each configuration; those
    /// with the same `Arc` share what is computed from it.
    ///
    /// An episode is truncated after `max_episode_steps` steps. `threads` share the work, the calling
    /// one included; without a number, as many as the processor runs at once.
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range; different numbers of
    /// compartments are refused too.
    pub fn new(
        configs: &[Arc<EpisodeConfig>],
        max_episode_steps: Option<u64>,
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        let compartments = configs.first().map(|config| config.arm.compartments);
        if let Some(other) =
            configs.iter().find(|other| Some(other.arm.compartments) != compartments)
        {
            return Err(ParameterError::OutOfRange {
                name: "arm.compartments".to_owned(),
                value: other.arm.compartments.to_string(),
                range: "of one number for all environments".to_owned(),
            });
        }
        let mut tasks = Self::room(configs.len(), compartments.unwrap_or(0))?;
        let mut known: Vec<Task> = Vec::new();
        for config in configs {
            // Environments are mostly alike, and mostly like the one before.
            let same = |task: &&Task| Arc::ptr_eq(task.config(), config);
            let task = match known.iter().rev().find(same) {
                Some(task) => task.clone(),
                None => {
                    known.push(Task::new(Arc::clone(config))?);
                    known[known.len() - 1].clone()
                }
            };
            tasks.push(task);
        }
        Self::of(tasks, max_episode_steps, autoreset, threads)
    }

    /// [`EpisodeBatch::new`] with one configuration for `count` episodes, which share it.
    ///
    /// # Errors
    /// As [`EpisodeBatch::new`].
    pub fn uniform(
        config: EpisodeConfig,
        count: usize,
        max_episode_steps: Option<u64>,
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        let mut tasks = Self::room(count, config.arm.compartments)?;
        tasks.resize(count, Task::new(Arc::new(config))?);
        Self::of(tasks, max_episode_steps, autoreset, threads)
    }

    /// Room for the tasks of `count` episodes, if there is enough for their arms too.
    fn room(count: usize, compartments: usize) -> Result<Vec<Task>, ParameterError> {
        let what = format!("num_envs = {count}");
        let groups = count.div_ceil(WIDTH);
        memory::check_room::<u8>(&what, groups.checked_mul(ArmLanes::bytes(compartments)))?;
        memory::reserved(&what, Some(count))
    }

    fn of(
        tasks: Vec<Task>,
        max_episode_steps: Option<u64>,
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        let refuse = |name: &str| {
            Err(ParameterError::OutOfRange {
                name: name.to_owned(),
                value: "0".to_owned(),
                range: "of positive numbers".to_owned(),
            })
        };
        let workers = Workers::new(threads)?;
        if max_episode_steps == Some(0) {
            return refuse("max_episode_steps");
        }
        let count = tasks.len();
        if count == 0 {
            return refuse("num_envs");
        }
        let mut groups = Vec::with_capacity(count.div_ceil(WIDTH));
        let mut tasks = tasks.into_iter();
        while groups.len() * WIDTH < count {
            poll()?;
            groups.push(Group::new(tasks.by_ref().take(WIDTH).collect())?);
        }
        Ok(Self { groups, count, max_episode_steps, autoreset, workers })
    }

    /// Number of episodes.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.count
    }

    /// Number of threads that share a step.
    #[must_use]
    pub fn threads(&self) -> usize {
        self.workers.threads()
    }

    /// Number of spring lengths of an arm.
    #[must_use]
    pub fn observation_len(&self) -> usize {
        self.groups[0].lanes.observation_len()
    }

    fn tasks(&self) -> impl Iterator<Item = &Task> {
        self.groups.iter().flat_map(|group| &group.tasks)
    }

    /// Bounds of the observed spring lengths \[m\] of every episode: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> Vec<(f64, f64)> {
        let (low, high) = domain::SPRING_LENGTH;
        self.tasks()
            .map(|task| task.config().arm.rest_length)
            .map(|length| (low * length, high * length))
            .collect()
    }

    /// Base angles of an action of 1 \[degrees\].
    #[must_use]
    pub fn action_ranges(&self) -> Vec<f64> {
        self.tasks().map(Task::action_range).collect()
    }

    /// The settings of an episode.
    #[must_use]
    pub fn config(&self, index: usize) -> &EpisodeConfig {
        self.groups[index / WIDTH].tasks[index % WIDTH].config()
    }

    /// The swing whose snapshots an episode begins from.
    #[must_use]
    pub fn swing(&self, index: usize) -> &Swing {
        self.groups[index / WIDTH].tasks[index % WIDTH].swing()
    }

    /// The last actions; after a reset, those that the swings were under.
    #[must_use]
    pub fn actions(&self) -> Vec<[f64; 2]> {
        self.tasks().map(Task::action).collect()
    }

    /// The teachers' actions now.
    #[must_use]
    pub fn teacher_actions(&self) -> Vec<[f64; 2]> {
        self.tasks().map(Task::teacher_action).collect()
    }

    /// Whether each episode has ended and waits for a reset.
    #[must_use]
    pub fn ended(&self) -> Vec<bool> {
        self.groups.iter().flat_map(|group| group.seats.iter().map(|seat| seat.ended)).collect()
    }

    /// Whether every episode was begun by a reset.
    #[must_use]
    pub fn begun(&self) -> bool {
        self.groups.iter().all(|group| group.seats.iter().all(|seat| seat.begun))
    }

    /// Where every episode stands, as if it began there.
    #[must_use]
    pub fn outcomes(&self) -> Vec<Outcome> {
        self.groups
            .iter()
            .flat_map(|group| {
                group
                    .tasks
                    .iter()
                    .enumerate()
                    .map(|(lane, task)| task.first_outcome(group.lanes.base_degrees(lane)))
            })
            .collect()
    }

    /// Spring lengths \[m\] of all arms, [`EpisodeBatch::observation_len`] an arm.
    #[must_use]
    pub fn lengths(&self) -> Vec<f64> {
        let width = self.observation_len();
        let mut lengths = vec![0.0; self.count * width];
        for (index, row) in lengths.chunks_exact_mut(width).enumerate() {
            self.groups[index / WIDTH].lanes.lengths_into(index % WIDTH, row);
        }
        lengths
    }

    /// An arm's complete state.
    #[must_use]
    pub fn arm_state(&self, index: usize) -> ArmState {
        self.groups[index / WIDTH].lanes.state(index % WIDTH)
    }

    /// Begins new episodes: of all, or of those in the mask. A seed starts an episode's generator
    /// anew; without a phase (in turns of the target, 0 to 1) it is drawn.
    ///
    /// # Errors
    /// [`ParameterError`] for a phase outside [0, 1] or another number of seeds or entries in the mask
    /// than of episodes; nothing is changed then.
    pub fn reset(
        &mut self,
        mask: Option<&[bool]>,
        seeds: &[Option<u64>],
        phase: Option<f64>,
    ) -> Result<BatchReset, ParameterError> {
        self.check_len("seed", seeds.len())?;
        if let Some(mask) = mask {
            self.check_len("reset_mask", mask.len())?;
        }
        if let Some(phase) = phase {
            self.groups[0].tasks[0].nearest(phase)?;
        }
        let width = self.observation_len();
        let mut observations = self.observations()?;
        let mut outcomes = vec![None; self.count];
        for (index, group) in self.groups.iter_mut().enumerate() {
            let first = index * WIDTH;
            let mut starts = Vec::new();
            for (lane, task) in group.tasks.iter_mut().enumerate() {
                if mask.is_some_and(|mask| !mask[first + lane]) {
                    continue;
                }
                if let Some(seed) = seeds[first + lane] {
                    task.seed(seed);
                }
                starts.push(match phase {
                    None => (lane, task.draw()),
                    Some(phase) => (lane, task.nearest(phase)?),
                });
            }
            group.begin(&starts);
            for (lane, _) in starts {
                let base = group.lanes.base_degrees(lane);
                outcomes[first + lane] = Some(group.tasks[lane].first_outcome(base));
            }
            for lane in 0..group.tasks.len() {
                let begin = (first + lane) * width;
                group.lanes.lengths_into(lane, &mut observations[begin..begin + width]);
            }
        }
        Ok(BatchReset { observations, outcomes })
    }

    /// One control period of all episodes, each entry of an action in [−1, 1].
    ///
    /// # Errors
    /// [`ParameterError`] for another number of actions than of episodes, an action outside its
    /// bounds, an episode that was never reset (or, without autoreset, has ended), or too little
    /// memory; nothing is changed then.
    pub fn step(&mut self, actions: &[[f64; 2]]) -> Result<BatchStep, ParameterError> {
        self.check_len("actions", actions.len())?;
        let actions: Vec<[f64; 2]> = actions
            .iter()
            .enumerate()
            .map(|(index, action)| {
                check_action(*action, |axis| format!("actions[{index}, {axis}]"))
            })
            .collect::<Result<_, _>>()?;
        let seats = self.groups.iter().flat_map(|group| &group.seats);
        for (index, seat) in seats.enumerate() {
            if !seat.begun || (seat.ended && self.autoreset == Autoreset::Disabled) {
                return Err(not_running(format!("step of environment {index}")));
            }
        }
        let (count, width) = (self.count, self.observation_len());
        let mut observations = self.observations()?;
        let mut rewards = vec![0.0; count];
        let mut terminated = vec![false; count];
        let mut truncated = vec![false; count];
        let mut outcomes = vec![None; count];
        let mut lasts = vec![None; count];
        let errands: Vec<Errand<'_>> = self
            .groups
            .iter_mut()
            .zip(actions.chunks(WIDTH))
            .zip(observations.chunks_mut(WIDTH * width))
            .zip(rewards.chunks_mut(WIDTH))
            .zip(terminated.chunks_mut(WIDTH).zip(truncated.chunks_mut(WIDTH)))
            .zip(outcomes.chunks_mut(WIDTH).zip(lasts.chunks_mut(WIDTH)))
            .map(|(((((group, actions), observations), rewards), ends), reports)| Errand {
                group,
                actions,
                observations,
                rewards,
                terminated: ends.0,
                truncated: ends.1,
                outcomes: reports.0,
                lasts: reports.1,
            })
            .collect();
        let (autoreset, most) = (self.autoreset, self.max_episode_steps);
        self.workers.for_each(errands, |errand| errand.run(autoreset, most, width));
        let outcomes = outcomes.into_iter().flatten().collect();
        Ok(BatchStep { observations, rewards, terminated, truncated, outcomes, lasts })
    }

    /// Room for the spring lengths of all arms.
    fn observations(&self) -> Result<Vec<f64>, ParameterError> {
        let what = format!("observations of {} environments", self.count);
        memory::filled(&what, 0.0, self.count.checked_mul(self.observation_len()))
    }

    fn check_len(&self, name: &str, found: usize) -> Result<(), ParameterError> {
        if found == self.count {
            return Ok(());
        }
        Err(ParameterError::Shape {
            name: name.to_owned(),
            found: format!("({found},)"),
            expected: format!("({},)", self.count),
        })
    }

    /// Saves everything the episodes need to go on.
    #[must_use]
    pub fn state(&self) -> BatchState {
        let mut state = BatchState { episodes: Vec::new(), seats: Vec::new() };
        for group in &self.groups {
            for (lane, task) in group.tasks.iter().enumerate() {
                state.episodes.push(task.state(group.lanes.state(lane)));
            }
            state.seats.extend(&group.seats);
        }
        state
    }

    /// Goes on exactly where a batch of the same settings was saved.
    ///
    /// # Errors
    /// [`ParameterError`] for a state that does not fit; nothing is changed then.
    pub fn set_state(&mut self, state: &BatchState) -> Result<(), ParameterError> {
        self.check_len("state.episodes", state.episodes.len())?;
        self.check_len("state.seats", state.seats.len())?;
        state.episodes.iter().try_for_each(EpisodeState::check)?;
        let before: Vec<ArmState> = (0..self.count).map(|index| self.arm_state(index)).collect();
        let restored = state.episodes.iter().enumerate().try_for_each(|(index, episode)| {
            self.groups[index / WIDTH].lanes.set_state(index % WIDTH, &episode.arm)
        });
        if let Err(error) = restored {
            for (index, state) in before.iter().enumerate() {
                self.groups[index / WIDTH].lanes.restore(&[(index % WIDTH, state)]);
            }
            return Err(error);
        }
        for (index, (episode, seat)) in state.episodes.iter().zip(&state.seats).enumerate() {
            let group = &mut self.groups[index / WIDTH];
            group.tasks[index % WIDTH].set_state(episode);
            group.seats[index % WIDTH] = *seat;
        }
        Ok(())
    }
}
