//! What a client of a world can do and see.

use octoarm_env::{Reading, Word, Words};
use octoarm_protocol::tensor::{DoubleArray, Int64Array};
use octoarm_protocol::tensor_spec::{Value, value};
use octoarm_protocol::{ActionObservationSpecs, DataType, StepRequest, TensorSpec};

use crate::reply::{Answer, Refusal};
use crate::tensor::doubles_of;

/// Number of the one action.
const ACTION: u64 = 1;

/// What can be observed of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// The spring lengths.
    SpringLengths,
    /// How fast they have changed.
    LengthRates,
    /// What an outcome holds: the place among the [`words`] of the task.
    Word(usize),
}

/// What can be observed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Observation {
    pub(crate) part: Part,
    /// Whether it is of the arms whose episode ended in this step and began anew within it: their last
    /// one.
    pub(crate) last: bool,
    /// Whether it belongs to the step itself, where an episode ended and the next one began.
    pub(crate) result: bool,
}

/// All words of a task's outcomes: the reward, what is in the observation, the info, the two ends.
pub(crate) fn words<O: Words>() -> impl Iterator<Item = &'static Word<O>> {
    let (reward, ends) = O::result().split_at(1);
    reward.iter().chain(O::seen()).chain(O::info()).chain(ends)
}

/// What a part looks like, of one arm.
#[derive(Clone, Debug)]
struct Look {
    part: Part,
    name: &'static str,
    data_type: DataType,
    shape: Vec<i32>,
    bounds: [Option<f64>; 2],
    result: bool,
}

/// What a task takes of, and shows to, the client of one arm.
#[derive(Clone, Debug)]
pub(crate) struct TaskSpecs {
    parts: Vec<Look>,
    /// Length and bounds of an action.
    action: (i32, [f64; 2]),
}

impl TaskSpecs {
    /// Of arms with so many springs, whose lengths \[m\] are within the bounds, of actions of this length
    /// and bounds, and of outcomes whose words have the bounds that are given for each.
    pub(crate) fn new<O: Words>(
        springs: usize,
        (low, high): (f64, f64),
        action: (usize, [f64; 2]),
        bounds: impl Fn(O::Bounds) -> [Option<f64>; 2],
    ) -> Self {
        let mut parts = vec![Look {
            part: Part::SpringLengths,
            name: "spring_lengths",
            data_type: DataType::Double,
            shape: vec![springs as i32],
            bounds: [Some(low), Some(high)],
            result: false,
        }];
        parts.extend(words::<O>().enumerate().map(|(place, word)| {
            let (data_type, shape): (DataType, &[i32]) = match word.reading {
                Reading::Flag(_) => (DataType::Bool, &[]),
                Reading::Index(_) => (DataType::Int64, &[]),
                Reading::Text(_) => (DataType::String, &[]),
                Reading::Number(_) => (DataType::Double, &[]),
                Reading::Angles(_) => (DataType::Double, &[2]),
                Reading::Point(_) => (DataType::Double, &[3]),
            };
            Look {
                part: Part::Word(place),
                name: word.name,
                data_type,
                shape: shape.to_vec(),
                bounds: bounds(word.bounds),
                result: O::result().iter().any(|result| result.name == word.name),
            }
        }));
        Self { parts, action: (action.0 as i32, action.1) }
    }

    /// With the rates of so many springs, of which none is faster \[m/s\].
    pub(crate) fn with_rates(mut self, springs: usize, fastest: f64) -> Self {
        self.parts.push(Look {
            part: Part::LengthRates,
            name: "length_rates",
            data_type: DataType::Double,
            shape: vec![springs as i32],
            bounds: [Some(-fastest), Some(fastest)],
            result: false,
        });
        self
    }
}

/// The shapes of a world's tensors, and its specs as they are sent.
#[derive(Clone, Debug)]
pub(crate) struct Specs {
    /// What can be observed, with its shape of one arm; its number on the wire is its place here, from 1.
    observations: Vec<(Observation, Vec<i32>)>,
    /// Numbers of an arm's action.
    action: i32,
    /// Episodes of a batch.
    batch: Option<i32>,
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
    /// Of a world of this task; `finals` are there where a step that ends an episode begins the next one.
    pub(crate) fn new(task: TaskSpecs, num_envs: Option<usize>, finals: bool) -> Self {
        let (action, [lowest, highest]) = task.action;
        let mut specs = Self {
            observations: Vec::new(),
            action,
            batch: num_envs.map(|count| count as i32),
            message: ActionObservationSpecs::default(),
        };
        let lasts = task.parts.iter().filter(|look| finals && !look.result);
        let all = task.parts.iter().map(|look| (look, false)).chain(lasts.map(|look| (look, true)));
        for ((look, last), uid) in all.zip(1..) {
            let observation = Observation { part: look.part, last, result: look.result };
            let [min, max] = look.bounds;
            let spec = TensorSpec {
                name: if last { format!("final_{}", look.name) } else { look.name.to_owned() },
                // As many rows as episodes ended: any number.
                shape: if last {
                    [&[-1], &look.shape[..]].concat()
                } else {
                    specs.rows(&look.shape)
                },
                dtype: look.data_type as i32,
                min: min.map(|value| bound(value, look.data_type)),
                max: max.map(|value| bound(value, look.data_type)),
            };
            specs.message.observations.insert(uid, spec);
            specs.observations.push((observation, look.shape.clone()));
        }
        let action = TensorSpec {
            name: "action".to_owned(),
            shape: specs.rows(&[action]),
            dtype: DataType::Double as i32,
            min: Some(bound(lowest, DataType::Double)),
            max: Some(bound(highest, DataType::Double)),
        };
        specs.message.actions.insert(ACTION, action);
        specs
    }

    /// A shape for one arm, with the batch's size before it if there is one.
    fn rows(&self, shape: &[i32]) -> Vec<i32> {
        self.batch.iter().chain(shape).copied().collect()
    }

    /// What an observation is, and its shape when so many episodes ended.
    pub(crate) fn shape(&self, place: usize, ended: i32) -> (Observation, Vec<i32>) {
        let (observation, of_one) = &self.observations[place];
        let shape =
            if observation.last { [&[ended], &of_one[..]].concat() } else { self.rows(of_one) };
        (*observation, shape)
    }

    /// Number of episodes of a batch.
    pub(crate) fn num_envs(&self) -> Option<usize> {
        self.batch.map(|count| count as usize)
    }

    /// What a step is to bring, each once: its place among the observations.
    pub(crate) fn wanted(&self, request: &StepRequest) -> Answer<Vec<usize>> {
        let mut wanted = Vec::with_capacity(request.requested_observations.len().min(16));
        for uid in &request.requested_observations {
            let place = usize::try_from(*uid).ok().and_then(|uid| uid.checked_sub(1));
            let known = self.observations.len();
            let Some(place) = place.filter(|place| *place < known) else {
                let message = format!("observation {uid} is unknown; known are 1 to {known}");
                return Err(Refusal::invalid(message));
            };
            if !wanted.contains(&place) {
                wanted.push(place);
            }
        }
        Ok(wanted)
    }

    /// The actions of all arms, one after the other, if the request has any.
    pub(crate) fn actions(&self, request: &StepRequest) -> Answer<Option<Vec<f64>>> {
        let mut actions = None;
        for (uid, tensor) in &request.actions {
            if *uid != ACTION {
                let message = format!("action {uid} is unknown; known is {ACTION}");
                return Err(Refusal::invalid(message));
            }
            actions = Some(doubles_of("action", tensor, &self.rows(&[self.action]))?);
        }
        Ok(actions)
    }
}

#[cfg(test)]
mod tests {
    use octoarm_env::{Outcome, ReachOutcome};

    use super::*;

    fn names(specs: &Specs) -> Vec<&str> {
        specs.message.observations.values().map(|spec| spec.name.as_str()).collect()
    }

    #[test]
    fn observations_have_their_numbers() {
        let none = |_| [None, None];
        let cycle = TaskSpecs::new::<Outcome>(80, (0.001, 0.06), (2, [-1.0, 1.0]), none);
        let all = [
            "spring_lengths",
            "reward",
            "base_angles",
            "target",
            "tracking_error",
            "reward_tracking",
            "reward_action_change",
            "body",
            "failure",
            "terminated",
            "truncated",
        ];
        assert_eq!(names(&Specs::new(cycle.clone(), None, false)), all);
        let batch = Specs::new(cycle, Some(3), true);
        assert_eq!(names(&batch)[..11], all);
        assert_eq!(names(&batch)[11], "final_spring_lengths");
        assert_eq!(names(&batch)[18], "final_failure");

        let reach = TaskSpecs::new::<ReachOutcome>(80, (0.001, 0.06), (25, [0.0, 1.0]), |_| {
            [Some(0.0), None]
        });
        let specs = Specs::new(reach.clone().with_rates(80, 1.2), Some(3), true);
        let expected = [
            ("spring_lengths", vec![3, 80]),
            ("reward", vec![3]),
            ("achieved_goal", vec![3, 3]),
            ("desired_goal", vec![3, 3]),
            ("is_success", vec![3]),
            ("distance", vec![3]),
            ("body", vec![3]),
            ("failure", vec![3]),
            ("terminated", vec![3]),
            ("truncated", vec![3]),
            ("length_rates", vec![3, 80]),
            ("final_spring_lengths", vec![-1, 80]),
            ("final_achieved_goal", vec![-1, 3]),
            ("final_desired_goal", vec![-1, 3]),
            ("final_is_success", vec![-1]),
            ("final_distance", vec![-1]),
            ("final_body", vec![-1]),
            ("final_failure", vec![-1]),
            ("final_length_rates", vec![-1, 80]),
        ];
        let found: Vec<(&str, Vec<i32>)> = specs
            .message
            .observations
            .values()
            .map(|spec| (spec.name.as_str(), spec.shape.clone()))
            .collect();
        assert_eq!(found, expected);
        let action = &specs.message.actions[&ACTION];
        assert_eq!(
            (action.shape.clone(), action.min.clone()),
            (vec![3, 25], Some(bound(0.0, DataType::Double)))
        );
        assert_eq!(names(&Specs::new(reach, None, false)).len(), 10);
    }
}
