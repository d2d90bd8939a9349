//! What a client of a world can do and see.

use octoarm_env::{EpisodeConfig, Outcome, Reading, Word};

use crate::protocol::tensor::{DoubleArray, Int64Array};
use crate::protocol::tensor_spec::{Value, value};
use crate::protocol::{ActionObservationSpecs, DataType, StepRequest, TensorSpec};
use crate::reply::{Answer, Refusal};
use crate::tensor::doubles_of;

/// Number of the one action.
const ACTION: u64 = 1;

/// What can be observed; its number on the wire is its place here, from 1.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Observation {
    /// The spring lengths.
    SpringLengths,
    /// What an outcome holds.
    Word(Word),
    /// The last spring lengths of the arms whose episode ended in this step and began anew within it.
    FinalSpringLengths,
    /// What the last outcome of those arms holds.
    Final(Word),
}

impl Observation {
    /// All of them, in the order of their numbers; `finals` are there where a step that ends an
    /// episode begins the next one.
    pub(crate) fn all(finals: bool) -> impl Iterator<Item = Self> {
        let [reward, terminated, truncated] = Outcome::RESULT;
        let words = [reward].into_iter().chain(Outcome::INFO).chain([terminated, truncated]);
        let all = std::iter::once(Self::SpringLengths).chain(words.map(Self::Word));
        let last = std::iter::once(Self::FinalSpringLengths).chain(Outcome::INFO.map(Self::Final));
        all.chain(last.filter(move |_| finals))
    }

    /// The name, as in Gymnasium's `info` where it is there.
    fn name(self) -> String {
        match self {
            Self::SpringLengths => "spring_lengths".to_owned(),
            Self::Word(word) => word.name.to_owned(),
            Self::FinalSpringLengths => "final_spring_lengths".to_owned(),
            Self::Final(word) => format!("final_{}", word.name),
        }
    }

    fn data_type(self) -> DataType {
        match self {
            Self::Word(word) | Self::Final(word) => match word.reading {
                Reading::Flag(_) => DataType::Bool,
                Reading::Index(_) => DataType::Int64,
                Reading::Text(_) => DataType::String,
                Reading::Number(_) | Reading::Angles(_) => DataType::Double,
            },
            Self::SpringLengths | Self::FinalSpringLengths => DataType::Double,
        }
    }

    fn bounds(self, config: &EpisodeConfig, amplitude: f64) -> [Option<f64>; 2] {
        match self {
            Self::SpringLengths | Self::FinalSpringLengths => {
                let (low, high) = config.observation_bounds();
                [Some(low), Some(high)]
            }
            Self::Word(word) | Self::Final(word) => (word.bounds)(config, amplitude),
        }
    }
}

/// The shapes of a world's tensors, and its specs as they are sent.
#[derive(Clone, Debug)]
pub(crate) struct Specs {
    /// Spring lengths of an arm.
    lengths: i32,
    /// Episodes of a batch.
    batch: Option<i32>,
    /// Whether a step that ends an episode begins the next one.
    finals: bool,
    /// As they are sent.
    pub(crate) message: ActionObservationSpecs,
}

/// A bound, of the type of what it bounds.
fn bound(value: f64, data_type: DataType) -> Value {
    let payload = match data_type {
        DataType::Int64 => value::Payload::Int64s(Int64Array { array: vec![value as i64] }),
        _ => value::Payload::Doubles(DoubleArray { array: vec![value] }),
    };
    Value { payload: Some(payload) }
}

impl Specs {
    /// Of a world of these settings, whose target has the given amplitude.
    pub(crate) fn new(
        config: &EpisodeConfig,
        amplitude: f64,
        num_envs: Option<usize>,
        finals: bool,
    ) -> Self {
        let mut specs = Self {
            lengths: 4 * config.arm.compartments as i32,
            batch: num_envs.map(|count| count as i32),
            finals,
            message: ActionObservationSpecs::default(),
        };
        for (observation, uid) in Observation::all(finals).zip(1..) {
            let [min, max] = observation.bounds(config, amplitude);
            let data_type = observation.data_type();
            let spec = TensorSpec {
                name: observation.name(),
                // As many rows as episodes ended: any number.
                shape: specs.shape(observation, -1),
                dtype: data_type as i32,
                min: min.map(|value| bound(value, data_type)),
                max: max.map(|value| bound(value, data_type)),
            };
            specs.message.observations.insert(uid, spec);
        }
        let action = TensorSpec {
            name: "action".to_owned(),
            shape: specs.action_shape(),
            dtype: DataType::Double as i32,
            min: Some(bound(-1.0, DataType::Double)),
            max: Some(bound(1.0, DataType::Double)),
        };
        specs.message.actions.insert(ACTION, action);
        specs
    }

    /// A shape for one arm, with the batch's size before it if there is one.
    fn rows(&self, shape: &[i32]) -> Vec<i32> {
        self.batch.iter().chain(shape).copied().collect()
    }

    fn action_shape(&self) -> Vec<i32> {
        self.rows(&[2])
    }

    /// An observation's shape, when so many episodes ended.
    pub(crate) fn shape(&self, observation: Observation, ended: i32) -> Vec<i32> {
        let of_one: &[i32] = match observation {
            Observation::SpringLengths | Observation::FinalSpringLengths => &[self.lengths],
            Observation::Word(word) | Observation::Final(word) => match word.reading {
                Reading::Angles(_) => &[2],
                _ => &[],
            },
        };
        match observation {
            Observation::SpringLengths | Observation::Word(_) => self.rows(of_one),
            Observation::FinalSpringLengths | Observation::Final(_) => [&[ended], of_one].concat(),
        }
    }

    /// Number of episodes of a batch.
    pub(crate) fn num_envs(&self) -> Option<usize> {
        self.batch.map(|count| count as usize)
    }

    /// The observation of a number on the wire.
    fn observation(&self, uid: u64) -> Answer<Observation> {
        let place = usize::try_from(uid).ok().and_then(|uid| uid.checked_sub(1));
        place.and_then(|place| Observation::all(self.finals).nth(place)).ok_or_else(|| {
            Refusal::invalid(format!(
                "observation {uid} is unknown; known are 1 to {}",
                Observation::all(self.finals).count()
            ))
        })
    }

    /// What a step is to bring, each once, with its number on the wire.
    pub(crate) fn wanted(&self, request: &StepRequest) -> Answer<Vec<(u64, Observation)>> {
        let mut wanted = Vec::with_capacity(request.requested_observations.len().min(16));
        for uid in &request.requested_observations {
            let observation = self.observation(*uid)?;
            if wanted.iter().all(|(known, _)| known != uid) {
                wanted.push((*uid, observation));
            }
        }
        Ok(wanted)
    }

    /// The action of every arm, if the request has any.
    pub(crate) fn actions(&self, request: &StepRequest) -> Answer<Option<Vec<[f64; 2]>>> {
        let mut actions = None;
        for (uid, tensor) in &request.actions {
            if *uid != ACTION {
                let message = format!("action {uid} is unknown; known is {ACTION}");
                return Err(Refusal::invalid(message));
            }
            let flat = doubles_of("action", tensor, &self.action_shape())?;
            actions = Some(flat.as_chunks::<2>().0.to_vec());
        }
        Ok(actions)
    }
}
