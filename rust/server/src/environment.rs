//! An agent's view of a world: the episodes of one arm or of a batch in the states of the protocol.

use octoarm_arm::ParameterError;
use octoarm_env::{
    Episode, EpisodeBatch, EpisodeConfig, Last, Outcome, PartialStep, Reading, Swing, Word,
};

use crate::protocol::{EnvironmentStateType, StepResponse, Tensor};
use crate::reply::{Answer, Refusal};
use crate::specs::{Observation, Specs};
use crate::tensor;
use crate::world_settings::{NextReset, Seed, WorldSettings, weight};

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

    /// Whether every arm has begun an episode.
    pub(crate) fn begun(&self) -> bool {
        match self {
            Self::Single(episode) => episode.running() || episode.ended(),
            Self::Batch(batch) => batch.begun(),
        }
    }

    /// Where every arm stands, as if its episode began there.
    pub(crate) fn outcomes(&self) -> Vec<Outcome> {
        match self {
            Self::Single(episode) => vec![episode.outcome()],
            Self::Batch(batch) => batch.outcomes(),
        }
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
    /// Whether it was asked for.
    asked: bool,
    /// Whether the generator of phases has a seed.
    seeded: bool,
}

/// What a step has to tell of every arm.
struct Told<'a> {
    /// The spring lengths.
    lengths: &'a dyn Fn() -> Vec<f64>,
    /// The outcome that they belong to.
    outcomes: Vec<&'a Outcome>,
    /// The outcome whose reward and end count, where an episode ended and the next one began.
    results: Vec<&'a Outcome>,
    /// The ends of those episodes.
    lasts: Vec<&'a Last>,
}

impl<'a> Told<'a> {
    /// Of arms whose episodes go on, or have come to an end.
    fn new(lengths: &'a dyn Fn() -> Vec<f64>, outcomes: &'a [Outcome]) -> Self {
        let outcomes: Vec<&Outcome> = outcomes.iter().collect();
        Self { lengths, results: outcomes.clone(), outcomes, lasts: Vec::new() }
    }
}

/// A word of every outcome.
fn read(word: Word, outcomes: &[&Outcome], shape: &[i32]) -> Tensor {
    let outcomes = outcomes.iter().copied();
    match word.reading {
        Reading::Number(read) => tensor::doubles(outcomes.map(read).collect(), shape),
        Reading::Angles(read) => tensor::doubles(outcomes.flat_map(read).collect(), shape),
        Reading::Index(read) => tensor::integers(outcomes.map(read), shape),
        Reading::Flag(read) => tensor::bools(outcomes.map(read).collect(), shape),
        Reading::Text(read) => {
            let texts = outcomes.map(|outcome| read(outcome).unwrap_or_default());
            tensor::strings(texts.collect(), shape)
        }
    }
}

/// A step's answer: the observations that are wanted of what it has to tell.
fn response(
    state: EnvironmentStateType,
    wanted: &[(u64, Observation)],
    specs: &Specs,
    told: &Told<'_>,
) -> StepResponse {
    let is_result = |word: Word| Outcome::RESULT.iter().any(|result| result.name == word.name);
    let tensor = |observation: Observation| {
        let shape = &specs.shape(observation, told.lasts.len() as i32);
        match observation {
            Observation::SpringLengths => tensor::doubles((told.lengths)(), shape),
            Observation::Word(word) if is_result(word) => read(word, &told.results, shape),
            Observation::Word(word) => read(word, &told.outcomes, shape),
            Observation::FinalSpringLengths => {
                let rows = told.lasts.iter().flat_map(|last| last.observation.iter().copied());
                tensor::doubles(rows.collect(), shape)
            }
            Observation::Final(word) => {
                let ends: Vec<&Outcome> = told.lasts.iter().map(|last| &last.outcome).collect();
                read(word, &ends, shape)
            }
        }
    };
    let observations = wanted.iter().map(|(uid, observation)| (*uid, tensor(*observation)));
    StepResponse { state: state as i32, observations: observations.collect() }
}

impl Environment {
    /// Episodes that wait for their first step.
    pub(crate) fn new(settings: WorldSettings) -> Result<Self, ParameterError> {
        let WorldSettings { config, seed, num_envs, max_episode_steps, autoreset, threads } =
            settings;
        let episodes = match num_envs {
            None => Episodes::Single(Box::new(Episode::with_limit(config, max_episode_steps)?)),
            Some(count) => Episodes::Batch(EpisodeBatch::new(
                &vec![config; count],
                max_episode_steps,
                autoreset,
                Some(threads),
            )?),
        };
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
        (self.next.phase, self.next.mask, self.asked) = (None, None, false);
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
            Episodes::Batch(_) => self.next.seed = Some(Seed::First(seed)),
        }
    }

    /// Goes on where a saved state stands.
    pub(crate) fn restored(&mut self) {
        self.running = match &self.episodes {
            Episodes::Single(episode) => episode.running(),
            Episodes::Batch(batch) => batch.begun(),
        };
        (self.next, self.asked) = (NextReset::default(), false);
        self.seeded = true;
    }

    /// Begins an episode.
    pub(crate) fn begin(
        &mut self,
        wanted: &[(u64, Observation)],
        specs: &Specs,
    ) -> Answer<StepResponse> {
        let NextReset { seed, phase, mask } = &self.next;
        let phase = *phase;
        let drawn = if seed.is_some() || self.seeded {
            None
        } else {
            Some(Seed::First(getrandom::u64().map_err(|error| {
                Refusal::new(tonic::Code::Internal, format!("no random seed: {error}"))
            })?))
        };
        let seed = seed.as_ref().or(drawn.as_ref());
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
                let seeds: Vec<Option<u64>> =
                    (0..batch.len()).map(|index| seed.and_then(|seed| seed.of(index))).collect();
                batch.reset(mask.as_deref(), &seeds, phase)?;
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
        wanted: &[(u64, Observation)],
        specs: &Specs,
    ) -> StepResponse {
        let mut outcomes = self.episodes.outcomes();
        let lengths = || match &self.episodes {
            Episodes::Single(episode) => episode.observation(),
            Episodes::Batch(batch) => batch.shown(),
        };
        for outcome in &mut outcomes {
            outcome.truncated = state == EnvironmentStateType::Interrupted;
        }
        response(state, wanted, specs, &Told::new(&lengths, &outcomes))
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
                let lengths = || episode.observation();
                let told = Told::new(&lengths, std::slice::from_ref(&outcome));
                Ok(Some(response(state, wanted, specs, &told)))
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
                let told = Told {
                    lengths: &|| step.observations.clone(),
                    outcomes: step.outcomes.iter().collect(),
                    results: step.steps().collect(),
                    lasts: step.lasts.iter().flatten().collect(),
                };
                Ok(Some(response(EnvironmentStateType::Running, wanted, specs, &told)))
            }
        }
    }
}
