//! The episodes of a world, of one arm or of many, whatever their task.

use octoarm_arm::{ArmParameters, ArmState, ParameterError};
use octoarm_env::{
    Episode, EpisodeBatch, Outcome, Reach, ReachOutcome, Reading, Swing, Word, Words,
};
use octoarm_protocol::Tensor;

use crate::specs::{TaskSpecs, words};
use crate::task_settings::{TaskName, TaskSettings};
use crate::tensor;
use crate::world_settings::{WorldSettings, weight};

/// Time of a physics step of one arm or of eight in lanes, roughly \[µs\].
const MICROSECONDS_A_STEP: f64 = 10.0;

/// Roughly the time that a part of a long step takes \[µs\].
const MICROSECONDS_A_PART: f64 = 500.0;
/// The same where nobody waits.
const MICROSECONDS_ALONE: f64 = 4.0 * MICROSECONDS_A_PART;

/// The episodes of a world.
#[derive(Debug)]
pub(crate) enum Episodes {
    /// Episodes of one arm that follows a limit cycle.
    Single(Box<Episode>),
    /// Such of many arms, which begin new ones by themselves.
    Batch(EpisodeBatch),
    /// Episodes of arms that reach: of a world with one arm, or of a batch.
    Reach {
        /// The episodes; of a world with one arm there is one, and only a reset begins the next.
        batch: Box<EpisodeBatch<Reach>>,
        /// Whether the world has one arm and is no batch.
        single: bool,
    },
}

use Episodes as E;

impl Episodes {
    /// Episodes that wait for their first reset.
    pub(crate) fn new(settings: WorldSettings) -> Result<Self, ParameterError> {
        let WorldSettings { task, num_envs, max_episode_steps, autoreset, threads, .. } = settings;
        Ok(match (task, num_envs) {
            (TaskSettings::LimitCycle(config), None) => {
                E::Single(Box::new(Episode::with_limit(config, max_episode_steps)?))
            }
            (TaskSettings::LimitCycle(config), Some(count)) => E::Batch(EpisodeBatch::new(
                &vec![config; count],
                max_episode_steps,
                autoreset,
                Some(threads),
            )?),
            (TaskSettings::Reach(bodies), count) => {
                let single = count.is_none();
                let autoreset = if single { octoarm_env::Autoreset::Disabled } else { autoreset };
                let count = count.unwrap_or(1);
                let threads = Some(threads);
                let batch = EpisodeBatch::reaching_with(
                    *bodies,
                    count,
                    max_episode_steps,
                    autoreset,
                    threads,
                )?;
                E::Reach { batch: Box::new(batch), single }
            }
        })
    }

    /// What the arms do.
    pub(crate) fn task(&self) -> TaskName {
        match self {
            E::Single(_) | E::Batch(_) => TaskName::LimitCycle,
            E::Reach { .. } => TaskName::Reach,
        }
    }

    /// What a client of one arm can do and see.
    pub(crate) fn specs(&self) -> TaskSpecs {
        let springs = 4 * self.body().compartments;
        let cycle = |config: &octoarm_env::EpisodeConfig, swing: &Swing| {
            let amplitude = swing.orbit.amplitude();
            let bounds = |bounds: <Outcome as Words>::Bounds| bounds(config, amplitude);
            TaskSpecs::new::<Outcome>(
                springs,
                config.observation_bounds(),
                (2, [-1.0, 1.0]),
                bounds,
            )
        };
        match self {
            E::Single(episode) => cycle(episode.config(), episode.swing()),
            E::Batch(batch) => cycle(batch.config(0), batch.swing(0)),
            E::Reach { batch, .. } => {
                let config = batch.settings();
                let (lengths, action) =
                    (config.observation_bounds(), (config.muscles(), [0.0, 1.0]));
                let specs = TaskSpecs::new::<ReachOutcome>(springs, lengths, action, |bounds| {
                    bounds(config)
                });
                if config.observe_rates {
                    specs.with_rates(springs, config.fastest())
                } else {
                    specs
                }
            }
        }
    }

    /// The settings of every episode, as JSON text.
    pub(crate) fn settings(&self) -> Result<String, ParameterError> {
        match self {
            E::Single(episode) => episode.config().to_json(),
            E::Batch(batch) => batch.config(0).to_json(),
            E::Reach { batch, .. } => batch.settings().to_json(),
        }
    }

    /// The body, before it varies.
    pub(crate) fn body(&self) -> &ArmParameters {
        match self {
            E::Single(episode) => &episode.config().arm,
            E::Batch(batch) => &batch.config(0).arm,
            E::Reach { batch, .. } => &batch.settings().arm,
        }
    }

    /// Physics steps from one action to the next.
    fn physics_steps(&self) -> u32 {
        match self {
            E::Single(episode) => episode.config().physics_steps(),
            E::Batch(batch) => batch.config(0).physics_steps(),
            E::Reach { batch, .. } => batch.settings().physics_steps(),
        }
    }

    /// Whether the world has one arm and is no batch.
    pub(crate) fn single(&self) -> bool {
        matches!(self, E::Single(_) | E::Reach { single: true, .. })
    }

    /// Number of arms.
    pub(crate) fn len(&self) -> usize {
        match self {
            E::Single(_) => 1,
            E::Batch(batch) => batch.len(),
            E::Reach { batch, .. } => batch.len(),
        }
    }

    /// A shape for one arm, with the batch's size before it if there is one.
    pub(crate) fn rows(&self, shape: &[i32]) -> Vec<i32> {
        if self.single() { shape.to_vec() } else { [&[self.len() as i32], shape].concat() }
    }

    /// Whether every arm has begun an episode.
    pub(crate) fn begun(&self) -> bool {
        match self {
            E::Single(episode) => episode.running() || episode.ended(),
            E::Batch(batch) => batch.begun(),
            E::Reach { batch, .. } => batch.begun(),
        }
    }

    /// Whether each arm's episode is over.
    pub(crate) fn ended(&self) -> Vec<bool> {
        match self {
            E::Single(episode) => vec![episode.ended()],
            E::Batch(batch) => batch.ended(),
            E::Reach { batch, .. } => batch.ended(),
        }
    }

    /// Whether the world's episode goes on: that of one arm, or those of a batch, which has no end.
    pub(crate) fn running(&self) -> bool {
        self.begun() && !(self.single() && self.ended()[0])
    }

    /// The arms' states.
    pub(crate) fn states(&self) -> Vec<ArmState> {
        match self {
            E::Single(episode) => vec![episode.state().arm],
            E::Batch(batch) => batch.arms().states(),
            E::Reach { batch, .. } => batch.arms().states(),
        }
    }

    /// A word for all arms as they stand, by its place among the [`words`] of the task.
    pub(crate) fn word(&self, place: usize) -> Option<Tensor> {
        fn of<O: Words>(place: usize, outcomes: &[O], episodes: &Episodes) -> Option<Tensor> {
            let outcomes: Vec<&O> = outcomes.iter().collect();
            let word = words().nth(place)?;
            Some(read(word, &outcomes, &episodes.rows(&shape_of(word))))
        }
        match self {
            E::Single(episode) => of(place, &[episode.outcome()], self),
            E::Batch(batch) => of(place, &batch.outcomes(), self),
            E::Reach { batch, .. } => of(place, &batch.outcomes(), self),
        }
    }

    /// What the arms stand at as a step tells it, but for texts: the words' names, and their places.
    pub(crate) fn standing_words(&self) -> Vec<(&'static str, usize)> {
        fn of<O: Words>() -> Vec<(&'static str, usize)> {
            let standing = |word: &Word<O>| {
                !matches!(word.reading, Reading::Text(_))
                    && O::result().iter().all(|result| result.name != word.name)
            };
            let all = words::<O>().enumerate().filter(|(_, word)| standing(word));
            all.map(|(place, word)| (word.name, place)).collect()
        }
        match self.task() {
            TaskName::LimitCycle => of::<Outcome>(),
            TaskName::Reach => of::<ReachOutcome>(),
        }
    }

    /// The swing that episodes along a target begin from.
    pub(crate) fn swing(&self) -> Option<&Swing> {
        match self {
            E::Single(episode) => Some(episode.swing()),
            E::Batch(batch) => Some(batch.swing(0)),
            E::Reach { .. } => None,
        }
    }

    /// Roughly how long a step takes, of one arm or of eight in lanes \[µs\].
    fn group_microseconds(&self) -> f64 {
        f64::from(self.physics_steps()) * weight(self.body()) * MICROSECONDS_A_STEP
    }

    /// Roughly how long a step takes \[µs\].
    pub(crate) fn microseconds(&self) -> f64 {
        self.group_microseconds() * self.len().div_ceil(8) as f64
    }

    /// Groups of arms whose steps are a part that others can wait for; `alone`, where nobody waits yet, whose
    /// threads rarely wait for each other.
    pub(crate) fn groups_a_part(&self, alone: bool) -> usize {
        let threads = match self {
            E::Single(_) => 1,
            E::Batch(batch) => batch.arms().threads(),
            E::Reach { batch, .. } => batch.arms().threads(),
        };
        let microseconds = if alone { MICROSECONDS_ALONE } else { MICROSECONDS_A_PART };
        threads * (microseconds / self.group_microseconds()).ceil().max(1.0) as usize
    }
}

/// The shape of a word, of one arm.
fn shape_of<O: Words>(word: &Word<O>) -> Vec<i32> {
    match word.reading {
        Reading::Angles(_) => vec![2],
        Reading::Point(_) => vec![3],
        _ => Vec::new(),
    }
}

/// A word of every outcome.
pub(crate) fn read<O: Words>(word: &Word<O>, outcomes: &[&O], shape: &[i32]) -> Tensor {
    let outcomes = outcomes.iter().copied();
    match word.reading {
        Reading::Number(read) => tensor::doubles(outcomes.map(read).collect(), shape),
        Reading::Angles(read) => tensor::doubles(outcomes.flat_map(read).collect(), shape),
        Reading::Point(read) => tensor::doubles(outcomes.flat_map(read).collect(), shape),
        Reading::Index(read) => tensor::integers(outcomes.map(read), shape),
        Reading::Flag(read) => tensor::bools(outcomes.map(read).collect(), shape),
        Reading::Text(read) => {
            let texts = outcomes.map(|outcome| read(outcome).unwrap_or_default());
            tensor::strings(texts.collect(), shape)
        }
    }
}
