//! An agent's view of a world: the episodes of one arm or of a batch in the states of the protocol.

use std::ops::Range;

use octoarm_arm::ParameterError;
use octoarm_env::{EpisodeBatch, Last, Outcome, PartialStep, ReachOutcome, Task, Words};
use octoarm_protocol::{EnvironmentStateType, StepResponse, Tensor};

use crate::episodes::{Episodes, read};
use crate::next_reset::{NextReset, Seed};
use crate::reply::{Answer, Refusal};
use crate::specs::{Part, Specs, words};
use crate::tensor;
use crate::world_settings::WorldSettings;

/// A control period that is made in parts.
#[derive(Debug)]
pub(crate) struct Advance {
    /// Of all arms, one after the other.
    actions: Option<Vec<f64>>,
    /// Of a batch that has begun it.
    cycle: Option<PartialStep>,
    reach: Option<PartialStep<Vec<f64>, ReachOutcome>>,
}

impl Advance {
    /// Under an action for every arm; without actions each keeps its last one.
    pub(crate) fn new(actions: Option<Vec<f64>>) -> Self {
        Self { actions, cycle: None, reach: None }
    }
}

/// Makes the next part of a step of a batch: at most so many groups. Says whether it was the last one.
fn advance<T: Task>(
    batch: &mut EpisodeBatch<T>,
    step: &mut Option<PartialStep<T::Action, T::Outcome>>,
    actions: impl FnOnce() -> Option<Vec<T::Action>>,
    groups: usize,
) -> Answer<bool> {
    let step = match step {
        Some(step) => step,
        None => step.insert(batch.begin_step(&actions().unwrap_or_else(|| batch.actions()))?),
    };
    Ok(batch.advance_step(step, groups))
}

/// Episodes, and what the protocol adds to them.
#[derive(Debug)]
pub(crate) struct Environment {
    pub(crate) episodes: Episodes,
    /// Whether an episode runs.
    running: bool,
    /// How the next episode begins.
    next: NextReset,
    /// Whether it was asked for.
    asked: bool,
    /// Whether the generator of phases has a seed.
    seeded: bool,
}

/// What a step has to tell of every arm.
struct Told<'a, O> {
    /// What is seen of the springs: their lengths, and what follows from them.
    seen: &'a dyn Fn() -> Vec<f64>,
    /// The outcome that they belong to.
    outcomes: Vec<&'a O>,
    /// The outcome whose reward and end count, where an episode ended and the next one began.
    results: Vec<&'a O>,
    /// The ends of those episodes.
    lasts: Vec<&'a Last<O>>,
}

impl<'a, O> Told<'a, O> {
    /// Of arms whose episodes go on, or have come to an end.
    fn new(seen: &'a dyn Fn() -> Vec<f64>, outcomes: &'a [O]) -> Self {
        let outcomes: Vec<&O> = outcomes.iter().collect();
        Self { seen, results: outcomes.clone(), outcomes, lasts: Vec::new() }
    }
}

/// These columns of rows that are so wide.
fn columns(rows: Vec<f64>, width: usize, columns: Range<usize>) -> Vec<f64> {
    if rows.is_empty() || columns.len() == width {
        return rows;
    }
    rows.chunks_exact(width).flat_map(|row| &row[columns.clone()]).copied().collect()
}

/// A step's answer: the observations that are wanted of what it has to tell.
fn response<O: Words>(
    state: EnvironmentStateType,
    wanted: &[usize],
    specs: &Specs,
    told: &Told<'_, O>,
) -> StepResponse {
    let tensor = |place: usize| -> Option<Tensor> {
        let (observation, shape) = specs.shape(place, told.lasts.len() as i32);
        let shape = &shape;
        let lasts = || told.lasts.iter().copied();
        let columns_of = |part: fn(usize, usize) -> Range<usize>| {
            let springs = shape[shape.len() - 1] as usize;
            let rows = match observation.last {
                false => (told.seen)(),
                true => lasts().flat_map(|last| last.observation.iter().copied()).collect(),
            };
            let count = if observation.last { told.lasts.len() } else { told.outcomes.len() };
            let width = rows.len() / count.max(1);
            tensor::doubles(columns(rows, width, part(springs, width)), shape)
        };
        match observation.part {
            Part::SpringLengths => Some(columns_of(|springs, _| 0..springs)),
            Part::LengthRates => Some(columns_of(|springs, width| springs..width)),
            Part::Word(word) => {
                let ends: Vec<&O>;
                let outcomes = match (observation.last, observation.result) {
                    (false, true) => &told.results,
                    (false, false) => &told.outcomes,
                    (true, _) => {
                        ends = lasts().map(|last| &last.outcome).collect();
                        &ends
                    }
                };
                words().nth(word).map(|word| read(word, outcomes, shape))
            }
        }
    };
    let observations =
        wanted.iter().filter_map(|place| tensor(*place).map(|tensor| (*place as u64 + 1, tensor)));
    StepResponse { state: state as i32, observations: observations.collect() }
}

/// The answer of a batch, or of an arm of its own, to a step that is made.
fn stepped<A, O: Words>(
    step: PartialStep<A, O>,
    state: impl FnOnce(&O) -> EnvironmentStateType,
    wanted: &[usize],
    specs: &Specs,
) -> StepResponse {
    let step = step.finish();
    let told = Told {
        seen: &|| step.observations.clone(),
        outcomes: step.outcomes.iter().collect(),
        results: step.steps().collect(),
        lasts: step.lasts.iter().flatten().collect(),
    };
    response(state(&step.outcomes[0]), wanted, specs, &told)
}

/// The state after a step of one arm.
fn state_after(terminated: bool, truncated: bool) -> EnvironmentStateType {
    match (terminated, truncated) {
        (true, _) => EnvironmentStateType::Terminated,
        (_, true) => EnvironmentStateType::Interrupted,
        _ => EnvironmentStateType::Running,
    }
}

impl Environment {
    /// Episodes that wait for their first step.
    pub(crate) fn new(settings: WorldSettings) -> Result<Self, ParameterError> {
        let seed = settings.seed;
        let episodes = Episodes::new(settings)?;
        let next = NextReset { seed: seed.map(Seed::First), ..NextReset::default() };
        Ok(Self { episodes, running: false, next, asked: false, seeded: false })
    }

    /// Whether an episode runs.
    pub(crate) fn running(&self) -> bool {
        self.running
    }

    /// Ends the episode; the next step begins one. Where none runs, and nothing is set, nothing
    /// happens.
    pub(crate) fn reset(&mut self, next: NextReset) {
        self.running = false;
        self.next.overlay(next, self.asked);
        self.asked = true;
    }

    /// The agent leaves: its episode is over, and what it wanted of the next one too.
    pub(crate) fn leave(&mut self) {
        self.running = false;
        self.next = NextReset { seed: self.next.seed.take(), ..NextReset::default() };
        self.asked = false;
        if self.seeded {
            self.next.seed = None;
        }
    }

    /// Starts the generator of phases anew, now.
    pub(crate) fn seed(&mut self, seed: u64) {
        match &mut self.episodes {
            Episodes::Single(episode) => {
                episode.seed(seed);
                self.seeded = true;
                self.next.seed = None;
            }
            _ => self.next.seed = Some(Seed::First(seed)),
        }
    }

    /// Goes on where a saved state stands.
    pub(crate) fn restored(&mut self) {
        self.running = self.episodes.running();
        (self.next, self.asked) = (NextReset::default(), false);
        self.seeded = true;
    }

    /// Begins an episode.
    pub(crate) fn begin(&mut self, wanted: &[usize], specs: &Specs) -> Answer<StepResponse> {
        let NextReset { seed, phase, goal, mask } = &self.next;
        let (phase, goal) = (*phase, *goal);
        let drawn = if seed.is_some() || self.seeded {
            None
        } else {
            Some(Seed::First(getrandom::u64().map_err(|error| {
                Refusal::new(tonic::Code::Internal, format!("no random seed: {error}"))
            })?))
        };
        let seed = seed.as_ref().or(drawn.as_ref());
        let seeds = |count: usize| -> Vec<Option<u64>> {
            (0..count).map(|index| seed.and_then(|seed| seed.of(index))).collect()
        };
        match &mut self.episodes {
            Episodes::Single(episode) => {
                if let Some(seed) = seed.and_then(|seed| seed.of(0)) {
                    episode.seed(seed);
                }
                match phase {
                    None => episode.reset(),
                    Some(phase) => episode.reset_to_phase(phase)?,
                };
            }
            Episodes::Batch(batch) => {
                batch.reset(mask.as_deref(), &seeds(batch.len()), phase)?;
            }
            Episodes::Reach { batch, .. } => {
                batch.reset(mask.as_deref(), &seeds(batch.len()), goal)?;
            }
        }
        (self.next, self.asked) = (NextReset::default(), false);
        self.seeded = true;
        self.running = true;
        Ok(self.tell(EnvironmentStateType::Running, wanted, specs))
    }

    /// Where every arm stands, with a reward of 0.
    pub(crate) fn tell(
        &self,
        state: EnvironmentStateType,
        wanted: &[usize],
        specs: &Specs,
    ) -> StepResponse {
        let truncated = state == EnvironmentStateType::Interrupted;
        let cycle = |mut outcomes: Vec<Outcome>, seen: &dyn Fn() -> Vec<f64>| {
            outcomes.iter_mut().for_each(|outcome| outcome.truncated = truncated);
            response(state, wanted, specs, &Told::new(seen, &outcomes))
        };
        match &self.episodes {
            Episodes::Single(episode) => cycle(vec![episode.outcome()], &|| episode.observation()),
            Episodes::Batch(batch) => cycle(batch.outcomes(), &|| batch.shown()),
            Episodes::Reach { batch, .. } => {
                let mut outcomes = batch.outcomes();
                outcomes.iter_mut().for_each(|outcome| outcome.truncated = truncated);
                response(state, wanted, specs, &Told::new(&|| batch.shown(), &outcomes))
            }
        }
    }

    /// Makes the next part of a control period; the answer comes with the last one.
    pub(crate) fn advance(
        &mut self,
        advance: &mut Advance,
        alone: bool,
        wanted: &[usize],
        specs: &Specs,
    ) -> Answer<Option<StepResponse>> {
        let groups = self.episodes.groups_a_part(alone);
        let Advance { actions, cycle, reach } = advance;
        match &mut self.episodes {
            Episodes::Single(episode) => {
                let action = actions.as_ref().and_then(|actions| actions.as_chunks().0.first());
                let outcome = episode.step(action.copied().unwrap_or(episode.action()))?;
                self.running = episode.running();
                let state = state_after(outcome.terminated(), outcome.truncated);
                let seen = || episode.observation();
                let told = Told::new(&seen, std::slice::from_ref(&outcome));
                Ok(Some(response(state, wanted, specs, &told)))
            }
            Episodes::Batch(batch) => {
                let actions = || actions.take().map(|actions| actions.as_chunks().0.to_vec());
                if !self::advance(batch, cycle, actions, groups)? {
                    return Ok(None);
                }
                let running = |_: &Outcome| EnvironmentStateType::Running;
                Ok(cycle.take().map(|step| stepped(step, running, wanted, specs)))
            }
            Episodes::Reach { batch, single } => {
                let width = batch.settings().muscles();
                let actions = || {
                    let rows =
                        |all: Vec<f64>| all.chunks_exact(width).map(<[f64]>::to_vec).collect();
                    actions.take().map(rows)
                };
                if !self::advance(batch, reach, actions, groups)? {
                    return Ok(None);
                }
                let state = |outcome: &ReachOutcome| match single {
                    true => state_after(outcome.terminated(), outcome.truncated),
                    false => EnvironmentStateType::Running,
                };
                let response = reach.take().map(|step| stepped(step, state, wanted, specs));
                self.running = self.episodes.running();
                Ok(response)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_are_cut_from_rows() {
        let rows = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        assert_eq!(columns(rows.clone(), 3, 0..2), [1.0, 2.0, 4.0, 5.0]);
        assert_eq!(columns(rows.clone(), 3, 2..3), [3.0, 6.0]);
        assert_eq!(columns(rows.clone(), 3, 0..3), rows);
        // No episode has ended.
        assert!(columns(Vec::new(), 0, 0..2).is_empty());
    }
}
