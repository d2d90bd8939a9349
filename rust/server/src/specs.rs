//! What a client of a world can do and see.

use octoarm_env::EpisodeConfig;

use crate::protocol::tensor::DoubleArray;
use crate::protocol::tensor_spec::{Value, value};
use crate::protocol::{ActionObservationSpecs, DataType, TensorSpec};
use crate::reply::{Answer, Refusal};

/// Number of the one action.
pub(crate) const ACTION: u64 = 1;

/// What can be observed; its number on the wire is its place here, from 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Observation {
    SpringLengths,
    Reward,
    BaseAngles,
    Target,
    TrackingError,
    RewardTracking,
    RewardActionChange,
    Failure,
    Terminated,
    Truncated,
}

use Observation as O;

impl Observation {
    pub(crate) const ALL: [Self; 10] = [
        O::SpringLengths,
        O::Reward,
        O::BaseAngles,
        O::Target,
        O::TrackingError,
        O::RewardTracking,
        O::RewardActionChange,
        O::Failure,
        O::Terminated,
        O::Truncated,
    ];

    /// The observation of a number on the wire.
    pub(crate) fn of(uid: u64) -> Answer<Self> {
        let place = usize::try_from(uid).ok().and_then(|uid| uid.checked_sub(1));
        place.and_then(|place| Self::ALL.get(place)).copied().ok_or_else(|| {
            Refusal::invalid(format!(
                "observation {uid} is unknown; known are 1 to {}",
                Self::ALL.len()
            ))
        })
    }

    /// The number on the wire.
    pub(crate) fn uid(self) -> u64 {
        self as u64 + 1
    }

    /// The name, as in Gymnasium's `info` where it is there.
    fn name(self) -> &'static str {
        match self {
            O::SpringLengths => "spring_lengths",
            O::Reward => "reward",
            O::BaseAngles => "base_angles",
            O::Target => "target",
            O::TrackingError => "tracking_error",
            O::RewardTracking => "reward_tracking",
            O::RewardActionChange => "reward_action_change",
            O::Terminated => "terminated",
            O::Truncated => "truncated",
            O::Failure => "failure",
        }
    }

    fn data_type(self) -> DataType {
        match self {
            O::Terminated | O::Truncated => DataType::Bool,
            O::Failure => DataType::String,
            _ => DataType::Double,
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
    /// As they are sent.
    pub(crate) message: ActionObservationSpecs,
}

fn bound(value: f64) -> Value {
    Value { payload: Some(value::Payload::Doubles(DoubleArray { array: vec![value] })) }
}

impl Specs {
    /// Of a world of these settings, whose target has the given amplitude.
    pub(crate) fn new(config: &EpisodeConfig, amplitude: f64, num_envs: Option<usize>) -> Self {
        let mut specs = Self {
            lengths: 4 * config.arm.compartments as i32,
            batch: num_envs.map(|count| count as i32),
            message: ActionObservationSpecs::default(),
        };
        let (low, high) = octoarm_arm::domain::SPRING_LENGTH;
        let length = config.arm.rest_length;
        // Between its samples the target is a cubic, with weights that add up to at most 1.25.
        let target = 1.25 * amplitude;
        // Each of the two entries of an action changes by at most 2.
        let change = -8.0 * config.action_change_weight;
        for observation in O::ALL {
            let (min, max) = match observation {
                O::SpringLengths => (Some(low * length), Some(high * length)),
                O::Reward => (Some(change), Some(config.tracking_weight)),
                O::Target => (Some(-target), Some(target)),
                O::TrackingError => (Some(0.0), None),
                O::RewardTracking => (Some(0.0), Some(config.tracking_weight)),
                O::RewardActionChange => (Some(change), Some(0.0)),
                O::BaseAngles | O::Terminated | O::Truncated | O::Failure => (None, None),
            };
            let spec = TensorSpec {
                name: observation.name().to_owned(),
                shape: specs.shape(observation),
                dtype: observation.data_type() as i32,
                min: min.map(bound),
                max: max.map(bound),
            };
            specs.message.observations.insert(observation.uid(), spec);
        }
        let action = TensorSpec {
            name: "action".to_owned(),
            shape: specs.action_shape(),
            dtype: DataType::Double as i32,
            min: Some(bound(-1.0)),
            max: Some(bound(1.0)),
        };
        specs.message.actions.insert(ACTION, action);
        specs
    }

    /// A shape for one arm, with the batch's size before it if there is one.
    fn rows(&self, shape: &[i32]) -> Vec<i32> {
        self.batch.iter().chain(shape).copied().collect()
    }

    /// The action's shape.
    pub(crate) fn action_shape(&self) -> Vec<i32> {
        self.rows(&[2])
    }

    /// An observation's shape.
    pub(crate) fn shape(&self, observation: Observation) -> Vec<i32> {
        match observation {
            O::SpringLengths => self.rows(&[self.lengths]),
            O::BaseAngles | O::Target => self.rows(&[2]),
            _ => self.rows(&[]),
        }
    }
}
