//! What a step or a reset brings beside the spring lengths, and the words for it.

use octoarm_arm::DomainError;

use crate::config::EpisodeConfig;
use crate::reward::RewardTerms;
use crate::senses::DisturbanceInfo;

/// What a step or a reset brought, beside the spring lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// Reward of the step, the sum of the terms; 0 of a reset.
    pub reward: f64,
    /// Terms of the reward as the body stands.
    pub terms: RewardTerms,
    /// Base angles θ, φ \[degrees\].
    pub base: [f64; 2],
    /// The target at this instant \[degrees\].
    pub target: [f64; 2],
    /// Distance between base and target \[degrees\].
    pub tracking_error: f64,
    /// Body of the episode, one of those that were drawn.
    pub body: usize,
    /// Reason for which the episode ended, if the arm left its domain.
    pub failure: Option<DomainError>,
    /// Whether the episode ended because its time is over.
    pub truncated: bool,
    /// What lies between the agent and the body, where anything does.
    pub disturbance: Option<Box<DisturbanceInfo>>,
}

/// How a word of an outcome is read.
#[derive(Debug)]
pub enum Reading<O = Outcome> {
    /// A number.
    Number(fn(&O) -> f64),
    /// Two angles \[degrees\].
    Angles(fn(&O) -> [f64; 2]),
    /// A place \[m\].
    Point(fn(&O) -> [f64; 3]),
    /// A count, from 0.
    Index(fn(&O) -> usize),
    /// A flag.
    Flag(fn(&O) -> bool),
    /// A text, which is mostly not there.
    Text(fn(&O) -> Option<String>),
}

// By hand, since derived they would ask the outcome for as much.
impl<O> Clone for Reading<O> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<O> Copy for Reading<O> {}

/// A word for a part of an outcome: the one list of them, for Python's `info` and the server alike.
#[derive(Debug)]
pub struct Word<O: Words = Outcome> {
    /// Key in Python's `info`, and name of the observation on a server.
    pub name: &'static str,
    /// Part of the outcome that the word stands for.
    pub reading: Reading<O>,
    /// The smallest and the largest value, where there are any, of an episode of these settings.
    pub bounds: O::Bounds,
}

impl<O: Words> Clone for Word<O> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<O: Words> Copy for Word<O> {}

/// What can be told of an outcome.
pub trait Words: Clone + std::fmt::Debug + 'static {
    /// Bounds from the settings of an episode.
    type Bounds: Copy + std::fmt::Debug + 'static;

    /// What Gymnasium gives beside the info: reward, and the two ends.
    fn result() -> &'static [Word<Self>; 3];

    /// What is in the observation beside what is seen of the springs.
    fn seen() -> &'static [Word<Self>];

    /// What Gymnasium gives in the info.
    fn info() -> &'static [Word<Self>];
}

impl Words for Outcome {
    /// Of a target that has the given amplitude \[degrees\].
    type Bounds = fn(&EpisodeConfig, f64) -> [Option<f64>; 2];

    fn result() -> &'static [Word; 3] {
        &Self::RESULT
    }

    fn seen() -> &'static [Word] {
        &[]
    }

    fn info() -> &'static [Word] {
        &Self::INFO
    }
}

/// Each of the two entries of an action changes by at most 2.
fn least_change(config: &EpisodeConfig) -> Option<f64> {
    Some(-8.0 * config.action_change_weight)
}

const UNBOUNDED: fn(&EpisodeConfig, f64) -> [Option<f64>; 2] = |_, _| [None, None];

impl Outcome {
    /// Whether the arm left its domain.
    #[must_use]
    pub fn terminated(&self) -> bool {
        self.failure.is_some()
    }

    /// What Gymnasium gives beside the info.
    pub const RESULT: [Word; 3] = [
        Word {
            name: "reward",
            reading: Reading::Number(|outcome| outcome.reward),
            bounds: |config, _| [least_change(config), Some(config.tracking_weight)],
        },
        Word { name: "terminated", reading: Reading::Flag(Self::terminated), bounds: UNBOUNDED },
        Word {
            name: "truncated",
            reading: Reading::Flag(|outcome| outcome.truncated),
            bounds: UNBOUNDED,
        },
    ];

    /// What Gymnasium gives in the info.
    pub const INFO: [Word; 7] = [
        Word {
            name: "base_angles",
            reading: Reading::Angles(|outcome| outcome.base),
            bounds: UNBOUNDED,
        },
        Word {
            name: "target",
            reading: Reading::Angles(|outcome| outcome.target),
            // Between its samples the target is a cubic, with weights that add up to at most 1.25.
            bounds: |_, amplitude| [Some(-1.25 * amplitude), Some(1.25 * amplitude)],
        },
        Word {
            name: "tracking_error",
            reading: Reading::Number(|outcome| outcome.tracking_error),
            bounds: |_, _| [Some(0.0), None],
        },
        Word {
            name: "reward_tracking",
            reading: Reading::Number(|outcome| outcome.terms.tracking),
            bounds: |config, _| [Some(0.0), Some(config.tracking_weight)],
        },
        Word {
            name: "reward_action_change",
            reading: Reading::Number(|outcome| outcome.terms.action_change),
            bounds: |config, _| [least_change(config), Some(0.0)],
        },
        Word {
            name: "body",
            reading: Reading::Index(|outcome| outcome.body),
            bounds: |config, _| [Some(0.0), Some(config.bodies as f64 - 1.0)],
        },
        Word {
            name: "failure",
            reading: Reading::Text(|outcome| outcome.failure.map(|failure| failure.to_string())),
            bounds: UNBOUNDED,
        },
    ];
}
