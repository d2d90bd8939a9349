//! An arm, or a batch of them, as a client steps it: the protocol's states over the episodes.

use std::sync::Arc;

use octoarm_arm::ParameterError;
use octoarm_env::{Autoreset, Episode, EpisodeBatch, Outcome, Reading};

use crate::protocol::{EnvironmentStateType, Tensor};
use crate::reply::{Answer, Refusal};
use crate::specs::{Observation, Specs};
use crate::tensor;
use crate::world_settings::{NextReset, WorldSettings, weight};

/// Time of a physics step of one arm or of eight in lanes, roughly \[µs\].
const MICROSECONDS_A_STEP: f64 = 10.0;

/// The arms.
#[derive(Debug)]
pub(crate) enum Body {
    /// One.
    Single(Box<Episode>),
    /// Many, which begin new episodes by themselves.
    Batch(EpisodeBatch),
}

/// What a step is to do.
#[derive(Debug)]
pub(crate) struct Order {
    /// The actions; without them every arm keeps its last one.
    pub(crate) actions: Option<Vec<[f64; 2]>>,
    /// What is wanted back, with the numbers on the wire.
    pub(crate) observations: Vec<(u64, Observation)>,
}

/// What a step brought.
#[derive(Debug)]
pub(crate) struct Step {
    /// Where the sequence stands.
    pub(crate) state: EnvironmentStateType,
    /// The observations that were ordered, in their order.
    pub(crate) observations: Vec<(u64, Tensor)>,
}

/// An arm or a batch between two requests.
#[derive(Debug)]
pub(crate) struct Arena {
    pub(crate) body: Body,
    /// Whether an episode runs.
    running: bool,
    /// How the next episode begins.
    next: NextReset,
    /// Whether the generator of phases has a seed.
    seeded: bool,
}

/// The observations that are wanted of arms with these lengths and outcomes.
fn observe(
    wanted: &[(u64, Observation)],
    specs: &Specs,
    lengths: &dyn Fn() -> Vec<f64>,
    outcomes: &[Outcome],
) -> Vec<(u64, Tensor)> {
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
    wanted.iter().map(|(uid, observation)| (*uid, tensor(*observation))).collect()
}

impl Arena {
    /// Arms that wait for their first step.
    pub(crate) fn new(settings: &WorldSettings) -> Result<Self, ParameterError> {
        let config = settings.config.clone();
        let body = match settings.num_envs {
            None => {
                Body::Single(Box::new(Episode::with_limit(config, settings.max_episode_steps)?))
            }
            Some(count) => Body::Batch(EpisodeBatch::new(
                &std::iter::repeat_n(Arc::new(config), count).collect::<Vec<_>>(),
                settings.max_episode_steps,
                Autoreset::NextStep,
                Some(settings.threads),
            )?),
        };
        Ok(Self {
            body,
            running: false,
            next: NextReset { seed: settings.seed, phase: None },
            seeded: false,
        })
    }

    /// Roughly how long a step takes \[µs\].
    pub(crate) fn microseconds(&self) -> f64 {
        let (config, groups) = match &self.body {
            Body::Single(episode) => (episode.config(), 1),
            Body::Batch(batch) => (batch.config(0), batch.len().div_ceil(8)),
        };
        let steps = f64::from(config.physics_steps()) * groups as f64;
        steps * weight(config) * MICROSECONDS_A_STEP
    }

    /// Arms.
    pub(crate) fn len(&self) -> usize {
        match &self.body {
            Body::Single(_) => 1,
            Body::Batch(batch) => batch.len(),
        }
    }

    /// Ends the episode; the next step begins one. Where none runs, and nothing is set, nothing
    /// happens.
    pub(crate) fn reset(&mut self, next: NextReset) {
        self.running = false;
        self.next.overlay(next);
    }

    /// The client leaves: its episode is over, and what it wanted of the next one too.
    pub(crate) fn leave(&mut self) {
        self.running = false;
        self.next.phase = None;
        if self.seeded {
            self.next.seed = None;
        }
    }

    /// Whether an episode runs.
    pub(crate) fn running(&self) -> bool {
        self.running
    }

    /// Starts the generator of phases anew, now.
    pub(crate) fn seed(&mut self, seed: u64) {
        match &mut self.body {
            Body::Single(episode) => {
                episode.seed(seed);
                self.seeded = true;
                self.next.seed = None;
            }
            Body::Batch(_) => self.next.seed = Some(seed),
        }
    }

    /// Goes on where a saved state stands.
    pub(crate) fn restored(&mut self) {
        self.running = match &self.body {
            Body::Single(episode) => episode.running(),
            Body::Batch(batch) => batch.begun(),
        };
        self.next = NextReset::default();
        self.seeded = true;
    }

    /// Goes on as a request asks: a control period, or the begin of an episode.
    pub(crate) fn step(&mut self, order: &Order, specs: &Specs) -> Answer<Step> {
        if self.running { self.advance(order, specs) } else { self.begin(order, specs) }
    }

    /// Tells where the episode stands, and that it is interrupted.
    pub(crate) fn interrupt(&mut self, order: &Order, specs: &Specs) -> Step {
        self.running = false;
        self.tell(EnvironmentStateType::Interrupted, order, specs)
    }

    fn begin(&mut self, order: &Order, specs: &Specs) -> Answer<Step> {
        let NextReset { seed, phase } = self.next;
        let seed = match seed {
            Some(seed) => Some(seed),
            None if self.seeded => None,
            None => Some(getrandom::u64().map_err(|error| {
                Refusal::new(tonic::Code::Internal, format!("no random seed: {error}"))
            })?),
        };
        match &mut self.body {
            Body::Single(episode) => {
                if let Some(seed) = seed {
                    episode.seed(seed);
                }
                match phase {
                    None => episode.reset(),
                    Some(phase) => episode.reset_to_phase(phase)?,
                };
            }
            Body::Batch(batch) => {
                let seeds: Vec<Option<u64>> = (0..batch.len() as u64)
                    .map(|index| seed.map(|seed| seed.wrapping_add(index)))
                    .collect();
                batch.reset(None, &seeds, phase)?;
            }
        }
        self.next = NextReset::default();
        self.seeded = true;
        self.running = true;
        Ok(self.tell(EnvironmentStateType::Running, order, specs))
    }

    /// Where every arm stands, with a reward of 0.
    fn tell(&self, state: EnvironmentStateType, order: &Order, specs: &Specs) -> Step {
        let (mut outcomes, lengths): (Vec<Outcome>, Box<dyn Fn() -> Vec<f64>>) = match &self.body {
            Body::Single(episode) => {
                (vec![episode.outcome()], Box::new(|| episode.arm().lengths()))
            }
            Body::Batch(batch) => (batch.outcomes(), Box::new(|| batch.arms().lengths())),
        };
        for outcome in &mut outcomes {
            outcome.truncated = state == EnvironmentStateType::Interrupted;
        }
        Step { state, observations: observe(&order.observations, specs, &lengths, &outcomes) }
    }

    fn advance(&mut self, order: &Order, specs: &Specs) -> Answer<Step> {
        match &mut self.body {
            Body::Single(episode) => {
                let action = match &order.actions {
                    Some(actions) => actions[0],
                    None => episode.action(),
                };
                let outcome = episode.step(action)?;
                self.running = episode.running();
                let state = match (outcome.terminated(), outcome.truncated) {
                    (true, _) => EnvironmentStateType::Terminated,
                    (_, true) => EnvironmentStateType::Interrupted,
                    _ => EnvironmentStateType::Running,
                };
                let lengths = || episode.arm().lengths();
                let observations = observe(&order.observations, specs, &lengths, &[outcome]);
                Ok(Step { state, observations })
            }
            Body::Batch(batch) => {
                let kept;
                let actions = match &order.actions {
                    Some(actions) => actions,
                    None => {
                        kept = batch.actions();
                        &kept
                    }
                };
                let step = batch.step(actions)?;
                let lengths = || step.observations.clone();
                let observations = observe(&order.observations, specs, &lengths, &step.outcomes);
                Ok(Step { state: EnvironmentStateType::Running, observations })
            }
        }
    }
}
