//! An agent's view of a world: the episodes of one arm or of a batch in the states of the protocol.

use octoarm_arm::ParameterError;
use octoarm_env::{
    Autoreset, Episode, EpisodeBatch, EpisodeConfig, Outcome, PartialStep, Reading, Swing,
};

use crate::protocol::{EnvironmentStateType, StepResponse};
use crate::reply::{Answer, Refusal};
use crate::specs::{Observation, Specs};
use crate::tensor;
use crate::world_settings::{NextReset, WorldSettings, weight};

/// Time of a physics step of one arm or of eight in lanes, roughly \[µs\].
const MICROSECONDS_A_STEP: f64 = 10.0;

/// Roughly the time that a part of a long step takes \[µs\].
const MICROSECONDS_A_PART: f64 = 500.0;

/// A control period that is made in parts.
#[derive(Debug)]
pub(crate) struct Advance {
    actions: Option<Vec<[f64; 2]>>,
    /// Of a batch that has begun it.
    step: Option<PartialStep>,
}

impl Advance {
    /// Under an action for every arm; without actions each keeps its last one.
    pub(crate) fn new(actions: Option<Vec<[f64; 2]>>) -> Self {
        Self { actions, step: None }
    }
}

/// The episodes of a world.
#[derive(Debug)]
pub(crate) enum Episodes {
    /// Episodes of one arm.
    Single(Box<Episode>),
    /// Episodes of many arms, which begin new ones by themselves.
    Batch(EpisodeBatch),
}

impl Episodes {
    /// The settings of every episode.
    pub(crate) fn config(&self) -> &EpisodeConfig {
        match self {
            Self::Single(episode) => episode.config(),
            Self::Batch(batch) => batch.config(0),
        }
    }

    /// The swing that episodes begin from.
    pub(crate) fn swing(&self) -> &Swing {
        match self {
            Self::Single(episode) => episode.swing(),
            Self::Batch(batch) => batch.swing(0),
        }
    }

    /// Number of arms.
    pub(crate) fn len(&self) -> usize {
        match self {
            Self::Single(_) => 1,
            Self::Batch(batch) => batch.len(),
        }
    }

    /// Roughly how long a step takes, of one arm or of eight in lanes \[µs\].
    fn group_microseconds(&self) -> f64 {
        let steps = f64::from(self.config().physics_steps());
        steps * weight(self.config()) * MICROSECONDS_A_STEP
    }

    /// Roughly how long a step takes \[µs\].
    pub(crate) fn microseconds(&self) -> f64 {
        let groups = match self {
            Self::Single(_) => 1,
            Self::Batch(batch) => batch.len().div_ceil(8),
        };
        self.group_microseconds() * groups as f64
    }

    /// Groups of arms whose steps are a part that others can wait for.
    fn groups_a_part(&self) -> usize {
        let threads = match self {
            Self::Single(_) => 1,
            Self::Batch(batch) => batch.arms().threads(),
        };
        threads * (MICROSECONDS_A_PART / self.group_microseconds()).ceil().max(1.0) as usize
    }
}

/// Episodes, and what the protocol adds to them.
#[derive(Debug)]
pub(crate) struct Environment {
    pub(crate) episodes: Episodes,
    /// Whether an episode runs.
    running: bool,
    /// How the next episode begins.
    next: NextReset,
    /// Whether the generator of phases has a seed.
    seeded: bool,
}

/// A step's answer: the observations that are wanted of arms with these lengths and outcomes.
fn response(
    state: EnvironmentStateType,
    wanted: &[(u64, Observation)],
    specs: &Specs,
    lengths: &dyn Fn() -> Vec<f64>,
    outcomes: &[Outcome],
) -> StepResponse {
    let tensor = |observation: Observation| {
        let shape = &specs.shape(observation);
        let outcomes = outcomes.iter();
        match observation {
            Observation::SpringLengths => tensor::doubles(lengths(), shape),
            Observation::Word(word) => match word.reading {
                Reading::Number(read) => tensor::doubles(outcomes.map(read).collect(), shape),
                Reading::Angles(read) => tensor::doubles(outcomes.flat_map(read).collect(), shape),
                Reading::Flag(read) => tensor::bools(outcomes.map(read).collect(), shape),
                Reading::Text(read) => {
                    let texts = outcomes.map(|outcome| read(outcome).unwrap_or_default());
                    tensor::strings(texts.collect(), shape)
                }
            },
        }
    };
    let observations = wanted.iter().map(|(uid, observation)| (*uid, tensor(*observation)));
    StepResponse { state: state as i32, observations: observations.collect() }
}

impl Environment {
    /// Episodes that wait for their first step.
    pub(crate) fn new(settings: WorldSettings) -> Result<Self, ParameterError> {
        let WorldSettings { config, seed, num_envs, max_episode_steps, threads } = settings;
        let episodes = match num_envs {
            None => Episodes::Single(Box::new(Episode::with_limit(config, max_episode_steps)?)),
            Some(count) => Episodes::Batch(EpisodeBatch::new(
                &vec![config; count],
                max_episode_steps,
                Autoreset::NextStep,
                Some(threads),
            )?),
        };
        let next = NextReset { seed, phase: None };
        Ok(Self { episodes, running: false, next, seeded: false })
    }

    /// Whether an episode runs.
    pub(crate) fn running(&self) -> bool {
        self.running
    }

    /// Ends the episode; the next step begins one. Where none runs, and nothing is set, nothing
    /// happens.
    pub(crate) fn reset(&mut self, next: NextReset) {
        self.running = false;
        self.next.overlay(next);
    }

    /// The agent leaves: its episode is over, and what it wanted of the next one too.
    pub(crate) fn leave(&mut self) {
        self.running = false;
        self.next.phase = None;
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
            Episodes::Batch(_) => self.next.seed = Some(seed),
        }
    }

    /// Goes on where a saved state stands.
    pub(crate) fn restored(&mut self) {
        self.running = match &self.episodes {
            Episodes::Single(episode) => episode.running(),
            Episodes::Batch(batch) => batch.begun(),
        };
        self.next = NextReset::default();
        self.seeded = true;
    }

    /// Begins an episode.
    pub(crate) fn begin(
        &mut self,
        wanted: &[(u64, Observation)],
        specs: &Specs,
    ) -> Answer<StepResponse> {
        let NextReset { seed, phase } = self.next;
        let seed = match seed {
            Some(seed) => Some(seed),
            None if self.seeded => None,
            None => Some(getrandom::u64().map_err(|error| {
                Refusal::new(tonic::Code::Internal, format!("no random seed: {error}"))
            })?),
        };
        match &mut self.episodes {
            Episodes::Single(episode) => {
                if let Some(seed) = seed {
                    episode.seed(seed);
                }
                match phase {
                    None => episode.reset(),
                    Some(phase) => episode.reset_to_phase(phase)?,
                };
            }
            Episodes::Batch(batch) => {
                let seeds: Vec<Option<u64>> = (0..batch.len() as u64)
                    .map(|index| seed.map(|seed| seed.wrapping_add(index)))
                    .collect();
                batch.reset(None, &seeds, phase)?;
            }
        }
        self.next = NextReset::default();
        self.seeded = true;
        self.running = true;
        Ok(self.tell(EnvironmentStateType::Running, wanted, specs))
    }

    /// Where every arm stands, with a reward of 0.
    pub(crate) fn tell(
        &self,
        state: EnvironmentStateType,
        wanted: &[(u64, Observation)],
        specs: &Specs,
    ) -> StepResponse {
        let (mut outcomes, lengths): (_, Box<dyn Fn() -> Vec<f64>>) = match &self.episodes {
            Episodes::Single(episode) => {
                (vec![episode.outcome()], Box::new(|| episode.arm().lengths()))
            }
            Episodes::Batch(batch) => (batch.outcomes(), Box::new(|| batch.arms().lengths())),
        };
        for outcome in &mut outcomes {
            outcome.truncated = state == EnvironmentStateType::Interrupted;
        }
        response(state, wanted, specs, &lengths, &outcomes)
    }

    /// Makes the next part of a control period; the answer comes with the last one.
    pub(crate) fn advance(
        &mut self,
        advance: &mut Advance,
        wanted: &[(u64, Observation)],
        specs: &Specs,
    ) -> Answer<Option<StepResponse>> {
        let groups = self.episodes.groups_a_part();
        match &mut self.episodes {
            Episodes::Single(episode) => {
                let actions = advance.actions.as_deref();
                let action = actions.map_or(episode.action(), |actions| actions[0]);
                let outcome = episode.step(action)?;
                self.running = episode.running();
                let state = match (outcome.terminated(), outcome.truncated) {
                    (true, _) => EnvironmentStateType::Terminated,
                    (_, true) => EnvironmentStateType::Interrupted,
                    _ => EnvironmentStateType::Running,
                };
                Ok(Some(response(state, wanted, specs, &|| episode.arm().lengths(), &[outcome])))
            }
            Episodes::Batch(batch) => {
                let mut step = match advance.step.take() {
                    Some(step) => step,
                    None => {
                        let actions = advance.actions.take();
                        batch.begin_step(&actions.unwrap_or_else(|| batch.actions()))?
                    }
                };
                if !batch.advance_step(&mut step, groups) {
                    advance.step = Some(step);
                    return Ok(None);
                }
                let step = step.finish();
                let lengths = || step.observations.clone();
                let state = EnvironmentStateType::Running;
                Ok(Some(response(state, wanted, specs, &lengths, &step.outcomes)))
            }
        }
    }
}
