//! Many episodes at once, over a batch of arms.
//!
//! Every episode has the very bits that [`crate::Episode`] gives, whatever stands beside it and
//! however many threads there are.

use octoarm_arm::{Arm, ArmLanes, ArmState, ParameterError, memory};
use serde::{Deserialize, Serialize};

use crate::arm_batch::{ArmBatch, check_len};
use crate::config::CheckedConfig;
use crate::limit_cycle::{EpisodeState, LimitCycle};
use crate::outcome::Outcome;
use crate::swing::Swing;
use crate::task::{Stage, Task};
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
pub struct Last<O = Outcome> {
    /// Last spring lengths \[m\].
    pub observation: Vec<f64>,
    /// Outcome of the last step.
    pub outcome: O,
}

/// A step of all episodes that is made in parts ([`EpisodeBatch::begin_step`]).
#[derive(Clone, Debug)]
pub struct PartialStep<A = [f64; 2], O = Outcome> {
    actions: Vec<A>,
    observations: Vec<f64>,
    outcomes: Vec<Option<O>>,
    lasts: Vec<Option<Last<O>>>,
    /// Groups that have made it.
    groups: usize,
}

impl<A, O> PartialStep<A, O> {
    /// What the step brought, after its last part.
    #[must_use]
    pub fn finish(self) -> BatchStep<O> {
        let outcomes = self.outcomes.into_iter().flatten().collect();
        BatchStep { observations: self.observations, outcomes, lasts: self.lasts }
    }
}

/// What a step of all episodes brought.
#[derive(Clone, Debug)]
pub struct BatchStep<O = Outcome> {
    /// Spring lengths \[m\], [`EpisodeBatch::observation_len`] for each episode.
    pub observations: Vec<f64>,
    /// Outcome that each episode's observation belongs to.
    pub outcomes: Vec<O>,
    /// The ends of episodes that were replaced, with [`Autoreset::SameStep`]; an entry an episode.
    pub lasts: Vec<Option<Last<O>>>,
}

impl<O> BatchStep<O> {
    /// What the step itself brought every episode: the outcome whose reward and end count.
    pub fn steps(&self) -> impl Iterator<Item = &O> {
        let lasts = self.lasts.iter().map(|last| last.as_ref().map(|last| &last.outcome));
        lasts.zip(&self.outcomes).map(|(last, outcome)| last.unwrap_or(outcome))
    }
}

/// What a reset brought, an entry an episode.
#[derive(Clone, Debug)]
pub struct BatchReset<O = Outcome> {
    /// Spring lengths \[m\] of all episodes, reset or not.
    pub observations: Vec<f64>,
    /// Outcome of each episode that was reset.
    pub outcomes: Vec<Option<O>>,
}

/// Everything a batch needs to go on exactly where it was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BatchState<S = EpisodeState> {
    episodes: Vec<S>,
}

/// Many arms, each in an episode of its own: by default such that follow a target.
#[derive(Debug)]
pub struct EpisodeBatch<T: Task = LimitCycle> {
    arms: ArmBatch,
    tasks: Vec<T>,
    autoreset: Autoreset,
}

/// The episodes of a group of arms, and where they write.
struct GroupStep<'a, T: Task> {
    tasks: &'a mut [T],
    actions: &'a [T::Action],
    observations: &'a mut [f64],
    outcomes: &'a mut [Option<T::Outcome>],
    lasts: &'a mut [Option<Last<T::Outcome>>],
}

/// Begins episodes in lanes, and tells where they stand.
fn begin<T: Task>(
    lanes: &mut ArmLanes,
    tasks: &mut [T],
    outcomes: &mut [Option<T::Outcome>],
    starts: &[(usize, T::Start)],
) {
    if starts.is_empty() {
        return;
    }
    let arms: Vec<(usize, &Arm, &ArmState)> = starts
        .iter()
        .map(|(lane, start)| {
            let task = &tasks[*lane];
            (*lane, task.body(*start), task.first_state(*start))
        })
        .collect();
    lanes.place(&arms);
    for (lane, start) in starts {
        tasks[*lane].begin(*start);
        outcomes[*lane] = Some(tasks[*lane].standing(lanes, *lane));
    }
}

/// The lengths of an arm's springs \[m\].
fn lengths_of(lanes: &ArmLanes, lane: usize) -> Vec<f64> {
    let mut lengths = vec![0.0; lanes.observation_len()];
    lanes.lengths_into(lane, &mut lengths);
    lengths
}

/// What the agents see after a step, or, in the mask, after a reset; the others' rows stay as they were.
fn observe<T: Task>(
    lanes: &ArmLanes,
    tasks: &mut [T],
    observations: &mut [f64],
    outcomes: &mut [Option<T::Outcome>],
    mask: Option<&[bool]>,
) {
    let width = observations.len() / tasks.len();
    let rows = observations.chunks_exact_mut(width);
    for (lane, (row, task)) in rows.zip(tasks).enumerate() {
        lanes.lengths_into(lane, row);
        if mask.is_none_or(|mask| mask[lane]) {
            task.see(row);
            if let Some(outcome) = &mut outcomes[lane] {
                task.tell(&|| lengths_of(lanes, lane), outcome);
            }
        } else {
            task.show(row);
        }
    }
}

impl<T: Task> GroupStep<'_, T> {
    /// A step of the whole group.
    fn run(self, lanes: &mut ArmLanes, autoreset: Autoreset) {
        let Self { tasks, actions, observations, outcomes, lasts } = self;
        let mut steps = [0; WIDTH];
        let mut starts = Vec::new();
        for (lane, task) in tasks.iter_mut().enumerate() {
            if task.stage() == Stage::Over {
                starts.push((lane, task.draw(None)));
            } else {
                steps[lane] = task.physics_steps();
            }
        }
        begin(lanes, tasks, outcomes, &starts);
        let failures = T::advance(lanes, tasks, actions, &steps);

        let mut starts = Vec::new();
        for (lane, task) in tasks.iter_mut().enumerate() {
            if steps[lane] == 0 {
                continue;
            }
            let mut outcome = task.finish(&actions[lane], lanes, lane, failures[lane]);
            outcomes[lane] = Some(outcome.clone());
            if task.stage() == Stage::Over && autoreset == Autoreset::SameStep {
                let mut observation = vec![0.0; task.observation_len(lanes.observation_len())];
                lanes.lengths_into(lane, &mut observation);
                task.see(&mut observation);
                task.tell(&|| lengths_of(lanes, lane), &mut outcome);
                lasts[lane] = Some(Last { observation, outcome });
                starts.push((lane, task.draw(None)));
            }
        }
        begin(lanes, tasks, outcomes, &starts);
        observe(lanes, tasks, observations, outcomes, None);
    }
}

impl EpisodeBatch {
    /// Episodes that wait for their first [`EpisodeBatch::reset`], one for each configuration; clones
    /// of one share what is computed from it.
    ///
    /// An episode is truncated after `max_episode_steps` steps. At most `threads` share the work, the
    /// calling one included, as in [`ArmBatch::new`].
    ///
    /// # Errors
    /// [`ParameterError`] that names the setting, its value and its range; different numbers of
    /// compartments are refused too, and more episodes than fit into memory.
    pub fn new(
        configs: &[CheckedConfig],
        max_episode_steps: Option<u64>,
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        let what = format!("num_envs = {}", configs.len());
        if configs.is_empty() {
            return Err(ParameterError::out_of_range("num_envs", 0, "of positive numbers"));
        }
        let mut places: Vec<usize> = memory::reserved(&what, Some(configs.len()))?;
        let mut known: Vec<CheckedConfig> = Vec::new();
        for config in configs {
            // Environments are mostly alike, and mostly like the one before.
            let place = known.iter().rposition(|other| other.is(config));
            places.push(place.unwrap_or(known.len()));
            if place.is_none() {
                known.push(config.clone());
            }
        }
        let swings = Swing::shared_by(&known, &Workers::new(threads)?)?;
        let known = known.into_iter().zip(swings);
        let known: Vec<LimitCycle> = known
            .map(|(config, swings)| LimitCycle::new(config, swings, max_episode_steps))
            .collect::<Result<_, _>>()?;
        let mut tasks: Vec<LimitCycle> = memory::reserved(&what, Some(configs.len()))?;
        tasks.extend(places.iter().map(|&place| known[place].clone()));
        let mut resting: Vec<&Arm> = memory::reserved(&what, Some(tasks.len()))?;
        resting.extend(tasks.iter().map(|task| &task.swing().arm));
        let arms = ArmBatch::new(&resting, threads)?;
        Ok(Self { arms, tasks, autoreset })
    }

    /// Bounds of the observed spring lengths \[m\] of every episode: the domain's own.
    #[must_use]
    pub fn observation_bounds(&self) -> Vec<(f64, f64)> {
        self.tasks.iter().map(|task| task.config().observation_bounds()).collect()
    }

    /// Base angles of an action of 1 \[degrees\].
    #[must_use]
    pub fn action_ranges(&self) -> Vec<f64> {
        self.tasks.iter().map(LimitCycle::action_range).collect()
    }

    /// The settings of an episode.
    #[must_use]
    pub fn config(&self, index: usize) -> &CheckedConfig {
        self.tasks[index].config()
    }

    /// The swing of an episode's present body, from whose snapshots it begins.
    #[must_use]
    pub fn swing(&self, index: usize) -> &Swing {
        self.tasks[index].swing()
    }

    /// The teachers' actions now.
    #[must_use]
    pub fn teacher_actions(&self) -> Vec<[f64; 2]> {
        self.tasks.iter().map(LimitCycle::teacher_action).collect()
    }
}

impl<T: Task> EpisodeBatch<T> {
    /// Episodes that wait for their first [`EpisodeBatch::reset`], one for each task, with their bodies.
    pub(crate) fn of_tasks(
        tasks: Vec<T>,
        bodies: &[&Arm],
        autoreset: Autoreset,
        threads: Option<usize>,
    ) -> Result<Self, ParameterError> {
        Ok(Self { arms: ArmBatch::new(bodies, threads)?, tasks, autoreset })
    }

    /// Number of episodes.
    #[must_use]
    #[allow(clippy::len_without_is_empty)]
    pub fn len(&self) -> usize {
        self.tasks.len()
    }

    /// The arms, in the order of the episodes.
    #[must_use]
    pub fn arms(&self) -> &ArmBatch {
        &self.arms
    }

    /// Number of numbers that an agent sees: the spring lengths of an arm, and what a task adds.
    #[must_use]
    pub fn observation_len(&self) -> usize {
        self.tasks[0].observation_len(self.arms.observation_len())
    }

    /// What the agents see of the spring lengths \[m\], as [`crate::Episode::observation`], one arm after
    /// the other.
    #[must_use]
    pub fn shown(&self) -> Vec<f64> {
        let (springs, width) = (self.arms.observation_len(), self.observation_len());
        let mut shown = vec![0.0; self.len() * width];
        let lengths = self.arms.lengths();
        let rows = shown.chunks_exact_mut(width).zip(lengths.chunks_exact(springs));
        for ((row, lengths), task) in rows.zip(&self.tasks) {
            row[..springs].copy_from_slice(lengths);
            task.show(row);
        }
        shown
    }

    /// Whether each episode has ended and waits for a reset.
    #[must_use]
    pub fn ended(&self) -> Vec<bool> {
        self.tasks.iter().map(|task| task.stage() == Stage::Over).collect()
    }

    /// Steps of each episode since its reset.
    #[must_use]
    pub fn elapsed(&self) -> Vec<u64> {
        self.tasks.iter().map(Task::elapsed).collect()
    }

    /// The last actions; after a reset, those that the arms were under before it: of a target the swings'
    /// own, of muscles none.
    #[must_use]
    pub fn actions(&self) -> Vec<T::Action> {
        self.tasks.iter().map(Task::action).collect()
    }

    /// Whether every episode was begun by a reset.
    #[must_use]
    pub fn begun(&self) -> bool {
        self.tasks.iter().all(|task| task.stage() != Stage::Waiting)
    }

    /// Where every episode stands, as if it began there.
    #[must_use]
    pub fn outcomes(&self) -> Vec<T::Outcome> {
        let standing = |(index, task): (usize, &T)| {
            let (lanes, lane) = self.arms.place_of(index);
            task.standing(lanes, lane)
        };
        self.tasks.iter().enumerate().map(standing).collect()
    }

    /// What plays in these episodes.
    pub(crate) fn tasks(&self) -> &[T] {
        &self.tasks
    }

    /// Begins new episodes: of all, or of those in the mask. A seed starts an episode's generator
    /// anew; what is not asked for (of a target the phase in turns, 0 to 1) is drawn.
    ///
    /// # Errors
    /// [`ParameterError`] for what cannot be asked, or another number of seeds or entries in the mask
    /// than of episodes; nothing is changed then.
    pub fn reset(
        &mut self,
        mask: Option<&[bool]>,
        seeds: &[Option<u64>],
        ask: Option<T::Ask>,
    ) -> Result<BatchReset<T::Outcome>, ParameterError> {
        check_len("seed", seeds.len(), self.len())?;
        if let Some(mask) = mask {
            check_len("reset_mask", mask.len(), self.len())?;
        }
        ask.map_or(Ok(()), T::check_ask)?;
        let width = self.observation_len();
        let mut observations = self.observations()?;
        let mut outcomes = vec![None; self.len()];
        let mask = mask.map_or_else(|| vec![true; self.len()], <[bool]>::to_vec);
        let groups = self
            .tasks
            .chunks_mut(WIDTH)
            .zip(mask.chunks(WIDTH).zip(seeds.chunks(WIDTH)))
            .zip(observations.chunks_mut(WIDTH * width).zip(outcomes.chunks_mut(WIDTH)));
        self.arms.for_each_group(0, groups, |lanes, ((tasks, (mask, seeds)), (rows, outcomes))| {
            let mut starts = Vec::new();
            for (lane, task) in tasks.iter_mut().enumerate().filter(|(lane, _)| mask[*lane]) {
                if let Some(seed) = seeds[lane] {
                    task.seed(seed);
                }
                starts.push((lane, task.draw(ask)));
            }
            begin(lanes, tasks, outcomes, &starts);
            observe(lanes, tasks, rows, outcomes, Some(mask));
        });
        Ok(BatchReset { observations, outcomes })
    }

    /// One control period of all episodes; each entry of an action is in [−1, 1], of an activation in
    /// [0, 1].
    ///
    /// # Errors
    /// [`ParameterError`] for another number of actions than of episodes, an action outside its
    /// bounds, an episode that was never reset (or, without autoreset, has ended), or too little
    /// memory; nothing is changed then.
    pub fn step(&mut self, actions: &[T::Action]) -> Result<BatchStep<T::Outcome>, ParameterError> {
        let mut step = self.begin_step(actions)?;
        self.advance_step(&mut step, usize::MAX);
        Ok(step.finish())
    }

    /// Checks the actions of a step that [`EpisodeBatch::advance_step`] makes in parts, so that others
    /// can have their turn in between; nothing is changed yet. The parts together are one
    /// [`EpisodeBatch::step`], bit for bit; nothing else may be asked of the batch between them. Where
    /// they are given up half-way, the episodes go on only after a reset of all.
    ///
    /// # Errors
    /// As [`EpisodeBatch::step`].
    pub fn begin_step(
        &self,
        actions: &[T::Action],
    ) -> Result<PartialStep<T::Action, T::Outcome>, ParameterError> {
        check_len("actions", actions.len(), self.len())?;
        let actions = self.tasks[0].check_actions(actions)?;
        for (index, task) in self.tasks.iter().enumerate() {
            let stops = match task.stage() {
                Stage::Waiting => true,
                Stage::Running => false,
                Stage::Over => self.autoreset == Autoreset::Disabled,
            };
            if stops {
                let name = format!("step of environment {index}");
                return Err(ParameterError::NotRunning { name });
            }
        }
        Ok(PartialStep {
            actions,
            observations: self.observations()?,
            outcomes: vec![None; self.len()],
            lasts: vec![None; self.len()],
            groups: 0,
        })
    }

    /// Makes a step's next part: that of at most so many groups of eight episodes. Says whether it was
    /// the last one.
    pub fn advance_step(
        &mut self,
        step: &mut PartialStep<T::Action, T::Outcome>,
        groups: usize,
    ) -> bool {
        let (width, autoreset) = (self.observation_len(), self.autoreset);
        let first = step.groups;
        let pieces = self
            .tasks
            .chunks_mut(WIDTH)
            .zip(step.actions.chunks(WIDTH))
            .zip(step.observations.chunks_mut(WIDTH * width))
            .zip(step.outcomes.chunks_mut(WIDTH).zip(step.lasts.chunks_mut(WIDTH)))
            .skip(first)
            .take(groups)
            .map(|(((tasks, actions), observations), (outcomes, lasts))| GroupStep {
                tasks,
                actions,
                observations,
                outcomes,
                lasts,
            });
        self.arms.for_each_group(first, pieces, |lanes, group| group.run(lanes, autoreset));
        let all = self.tasks.len().div_ceil(WIDTH);
        step.groups = first.saturating_add(groups).min(all);
        step.groups == all
    }

    /// Room for the spring lengths of all arms.
    fn observations(&self) -> Result<Vec<f64>, ParameterError> {
        let what = format!("observations of {} environments", self.len());
        memory::filled(&what, 0.0, self.len().checked_mul(self.observation_len()))
    }

    /// Saves everything the episodes need to go on.
    #[must_use]
    pub fn state(&self) -> BatchState<T::State> {
        let states = self.tasks.iter().zip(self.arms.states());
        BatchState { episodes: states.map(|(task, arm)| task.state(arm)).collect() }
    }

    /// Goes on exactly where a batch of the same settings was saved.
    ///
    /// # Errors
    /// [`ParameterError`] for a state that does not fit; nothing is changed then.
    pub fn set_state(&mut self, state: &BatchState<T::State>) -> Result<(), ParameterError> {
        check_len("state.episodes", state.episodes.len(), self.len())?;
        let mut bodies: Vec<&Arm> = memory::reserved("a state", Some(self.len()))?;
        let mut arms: Vec<&ArmState> = memory::reserved("a state", Some(self.len()))?;
        for (task, episode) in self.tasks.iter().zip(&state.episodes) {
            let (body, arm) = task.saved(episode)?;
            bodies.push(body);
            arms.push(arm);
        }
        self.arms.set_arms(&bodies, arms.into_iter())?;
        for (task, episode) in self.tasks.iter_mut().zip(&state.episodes) {
            task.set_state(episode);
        }
        Ok(())
    }
}
