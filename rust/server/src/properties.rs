//! The properties extension: what can be read and written beside steps.

use octoarm_env::MUSCLES;
use octoarm_protocol::extensions::properties::property_request::Payload as Request;
use octoarm_protocol::extensions::properties::property_response::Payload as Response;
use octoarm_protocol::extensions::properties::{
    ListPropertyResponse, PropertyRequest, PropertyResponse, PropertySpec, ReadPropertyResponse,
    WritePropertyResponse,
};
use octoarm_protocol::{Tensor, TensorSpec};
use prost::Message as _;
use prost_types::Any;
use tonic::Code;

use crate::environment::Environment;
use crate::episodes::Episodes;
use crate::reply::{Answer, Refusal, quoted};
use crate::state::{self, Form};
use crate::task_settings::TaskName;
use crate::tensor;
use crate::world::failed;

const REQUEST: &str = "dm_env_rpc.v1.extensions.properties.PropertyRequest";
const RESPONSE: &str = "dm_env_rpc.v1.extensions.properties.PropertyResponse";

/// Something that can be read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Property {
    Version,
    Worlds,
    Settings,
    ActionRange,
    Amplitude,
    Period,
    Orbit,
    TeacherAction,
    ArmPositions,
    ArmJoints,
    Activations,
    ElapsedSteps,
    /// Of every arm that reaches.
    Elapsed,
    Seed,
    Begun,
    Ended,
    /// What a step tells, as it stands now: its name, and its place among the words of the task.
    Word(&'static str, usize),
    State,
    StateBytes,
}

use Property as P;

impl Property {
    /// Those of the server.
    const UNIVERSAL: [Self; 2] = [P::Version, P::Worlds];
    /// Those of a joined world, before and after the words of its task.
    const ARMS: [Self; 2] = [P::ArmPositions, P::ArmJoints];
    const EPISODES: [Self; 5] = [P::Begun, P::Ended, P::Seed, P::State, P::StateBytes];
    /// Those of arms that follow a target.
    const CYCLE: [Self; 5] = [P::ActionRange, P::Amplitude, P::Period, P::Orbit, P::TeacherAction];
    /// Those of arms that reach.
    const REACH: [Self; 2] = [P::Activations, P::Elapsed];

    fn key(self) -> &'static str {
        match self {
            P::Version => "version",
            P::Worlds => "worlds",
            P::Settings => "settings",
            P::ActionRange => "action_range",
            P::Amplitude => "amplitude",
            P::Period => "period",
            P::Orbit => "orbit",
            P::TeacherAction => "teacher_action",
            P::ArmPositions => "arm_positions",
            P::ArmJoints => "arm_joints",
            P::Activations => "activations",
            P::ElapsedSteps | P::Elapsed => "elapsed_steps",
            P::Seed => "seed",
            P::Begun => "begun",
            P::Ended => "ended",
            P::Word(name, _) => name,
            P::State => "state",
            P::StateBytes => "state_bytes",
        }
    }

    fn description(self) -> &'static str {
        match self {
            P::Version => "Version of the server",
            P::Worlds => "Worlds of all clients",
            P::Settings => "Settings of an episode, as JSON",
            P::ActionRange => "Degrees of base rotation at an action of 1",
            P::Amplitude => "Largest |angle| of the target [degrees]",
            P::Period => "Time of one turn of the target [s]",
            P::Orbit => "The target over one period at equal intervals [degrees]",
            P::TeacherAction => "The action of the lead-compensated clock now",
            P::ArmPositions => "Centres of the arm's planes, base first [m]",
            P::ArmJoints => "Ends of the longitudinal springs, base first [m]",
            P::Activations => {
                "How active the muscles are, from 0 to 1, five of every segment, base first"
            }
            P::Elapsed => "Steps of each arm's episode",
            P::ElapsedSteps => "Steps of the episode, which max_episode_steps ends",
            P::Seed => "Starts the generator of phases anew; of a batch, with the next reset",
            P::Begun => "Whether every arm has begun an episode",
            P::Ended => "Whether each arm's episode is over",
            P::Word(..) => "As a step observes it, of the arms as they stand",
            P::State => "All that the episodes need to go on exactly where they stand, as JSON",
            P::StateBytes => "The same as state, as MessagePack",
        }
    }

    fn readable(self) -> bool {
        self != P::Seed
    }

    fn writable(self) -> bool {
        matches!(self, P::ElapsedSteps | P::Seed | P::State | P::StateBytes)
    }

    /// Those that there are for a stream that has joined this environment, or none.
    fn known(environment: Option<&Environment>) -> Vec<Self> {
        let mut known = Self::UNIVERSAL.to_vec();
        let Some(Environment { episodes, .. }) = environment else { return known };
        let own = match episodes.task() {
            TaskName::LimitCycle => &Self::CYCLE[..],
            TaskName::Reach => &Self::REACH[..],
        };
        known.push(P::Settings);
        known.extend(own.iter().chain(&Self::ARMS));
        known.extend(
            episodes.standing_words().into_iter().map(|(name, place)| P::Word(name, place)),
        );
        known.extend(Self::EPISODES);
        if matches!(episodes, Episodes::Single(_)) {
            known.push(P::ElapsedSteps);
        }
        known
    }

    fn find(key: &str, environment: Option<&Environment>) -> Answer<Self> {
        Self::known(environment).into_iter().find(|property| property.key() == key).ok_or_else(
            || {
                let known: Vec<&str> =
                    Self::known(environment).into_iter().map(Self::key).collect();
                let more = if environment.is_none() { "; more when a world is joined" } else { "" };
                let message = format!(
                    "key = {} is unknown; known are {}{more}",
                    quoted(key),
                    known.join(", ")
                );
                Refusal::new(Code::NotFound, message)
            },
        )
    }
}

/// The environment that a stream has joined.
pub(crate) type Joined<'a> = Option<&'a mut Environment>;

fn read(property: Property, worlds: usize, joined: &Joined<'_>) -> Answer<Tensor> {
    let episodes = match (property, joined) {
        (P::Version, _) => return Ok(tensor::text(env!("CARGO_PKG_VERSION"))),
        (P::Worlds, _) => return Ok(tensor::integer(worlds as i64)),
        (_, Some(environment)) => &environment.episodes,
        (_, None) => return Err(Refusal::precondition("no world is joined")),
    };
    let scalar = |value: f64| Ok(tensor::doubles(vec![value], &[]));
    let table = |rows: &[[f64; 2]]| {
        Ok(tensor::doubles(rows.as_flattened().to_vec(), &[rows.len() as i32, 2]))
    };
    let body = episodes.body();
    let planes = body.compartments as i32 + 1;
    match (property, episodes, episodes.swing()) {
        (P::Settings, ..) => Ok(tensor::text(episodes.settings()?)),
        (P::Amplitude, _, Some(swing)) => scalar(swing.orbit.amplitude()),
        (P::Period, _, Some(swing)) => scalar(swing.orbit.period()),
        (P::Orbit, _, Some(swing)) => table(swing.orbit.table()),
        (P::ActionRange, Episodes::Single(episode), _) => scalar(episode.action_range()),
        (P::ActionRange, Episodes::Batch(batch), _) => scalar(batch.action_ranges()[0]),
        (P::TeacherAction, Episodes::Single(episode), _) => {
            Ok(tensor::doubles(episode.teacher_action().to_vec(), &[2]))
        }
        (P::TeacherAction, Episodes::Batch(batch), _) => table(&batch.teacher_actions()),
        (P::Activations, Episodes::Reach { batch, .. }, _) => {
            let all = (0..batch.len()).flat_map(|index| batch.activations(index)).copied();
            let shape = [batch.settings().segments as i32, MUSCLES as i32];
            Ok(tensor::doubles(all.collect(), &episodes.rows(&shape)))
        }
        (P::Begun, ..) => Ok(tensor::bools(vec![episodes.begun()], &[])),
        (P::Ended, ..) => Ok(tensor::bools(episodes.ended(), &episodes.rows(&[]))),
        (P::Word(_, place), ..) => episodes.word(place).ok_or_else(failed),
        (P::State, ..) => state::save(episodes, Form::Text),
        (P::StateBytes, ..) => state::save(episodes, Form::Bytes),
        (P::ElapsedSteps, Episodes::Single(episode), _) => {
            Ok(tensor::integer(episode.elapsed().cast_signed()))
        }
        (P::Elapsed, Episodes::Reach { batch, .. }, _) => {
            let elapsed = batch.elapsed().into_iter().map(|steps| steps as usize);
            Ok(tensor::integers(elapsed, &episodes.rows(&[])))
        }
        (P::ArmPositions, ..) => {
            let arms = episodes.states();
            let flat = arms.iter().flat_map(|arm| arm.positions().into_flattened()).collect();
            Ok(tensor::doubles(flat, &episodes.rows(&[planes, 3])))
        }
        (P::ArmJoints, ..) => {
            let arms = episodes.states();
            let joints = arms.iter().flat_map(|arm| arm.joints(body));
            let flat = joints.flatten().flatten().collect();
            Ok(tensor::doubles(flat, &episodes.rows(&[planes, 4, 3])))
        }
        _ => {
            Err(Refusal::new(Code::PermissionDenied, format!("{} cannot be read", property.key())))
        }
    }
}

fn write(property: Property, value: &Tensor, joined: &mut Joined<'_>) -> Answer<()> {
    let key = property.key();
    let Some(environment) = joined else {
        let message = format!("{key} cannot be written");
        return Err(Refusal::new(Code::PermissionDenied, message));
    };
    match (property, &mut environment.episodes) {
        (P::Seed, _) => {
            let json = tensor::to_json(key, value, 1)?;
            let seed = json.as_u64().ok_or_else(|| {
                Refusal::invalid(format!("seed = {json} is outside the allowed range [0, 2^64)"))
            })?;
            environment.seed(seed);
        }
        (P::ElapsedSteps, Episodes::Single(episode)) => {
            let json = tensor::to_json(key, value, 1)?;
            let steps = json.as_u64().filter(|steps| *steps < 1 << 32);
            episode.set_elapsed(steps.ok_or_else(|| {
                Refusal::invalid(format!(
                    "elapsed_steps = {json} is outside the allowed range [0, 2^32)"
                ))
            })?);
        }
        (P::State, _) => state::load(environment, value, Form::Text)?,
        (P::StateBytes, _) => state::load(environment, value, Form::Bytes)?,
        _ => {
            let message = format!("{key} cannot be written");
            return Err(Refusal::new(Code::PermissionDenied, message));
        }
    }
    Ok(())
}

fn spec(property: Property, worlds: usize, joined: &Joined<'_>) -> Answer<PropertySpec> {
    let example = match property {
        P::Settings => tensor::text(""),
        P::Seed => tensor::unsigned(0),
        P::State => tensor::text(""),
        P::StateBytes => Tensor { shape: vec![-1], ..tensor::bytes(Vec::new()) },
        _ => read(property, worlds, joined)?,
    };
    Ok(PropertySpec {
        spec: Some(TensorSpec {
            name: property.key().to_owned(),
            dtype: tensor::data_type(&example) as i32,
            shape: example.shape,
            ..TensorSpec::default()
        }),
        is_readable: property.readable(),
        is_writable: property.writable(),
        is_listable: false,
        description: property.description().to_owned(),
    })
}

/// Answers a request of an extension, on a server with so many worlds; the properties are the one
/// that there is.
pub(crate) fn answer(request: &Any, worlds: usize, mut joined: Joined<'_>) -> Answer<Any> {
    if request.type_url.rsplit('/').next() != Some(REQUEST) {
        let message =
            format!("extension {} is unknown; known is {REQUEST}", quoted(&request.type_url));
        return Err(Refusal::new(Code::Unimplemented, message));
    }
    let request = PropertyRequest::decode(request.value.as_slice())
        .map_err(|error| Refusal::invalid(format!("{REQUEST}: {error}")))?;
    let find = |key: &str, joined: &Joined<'_>| Property::find(key, joined.as_deref());
    let payload = match request.payload {
        Some(Request::ReadProperty(request)) => {
            let property = find(&request.key, &joined)?;
            let value = Some(read(property, worlds, &joined)?);
            Response::ReadProperty(ReadPropertyResponse { value })
        }
        Some(Request::WriteProperty(request)) => {
            let property = find(&request.key, &joined)?;
            write(property, &request.value.unwrap_or_default(), &mut joined)?;
            Response::WriteProperty(WritePropertyResponse {})
        }
        Some(Request::ListProperty(request)) => {
            if !request.key.is_empty() {
                let property = find(&request.key, &joined)?;
                return Err(Refusal::invalid(format!("nothing lies below {:?}", property.key())));
            }
            let values = Property::known(joined.as_deref())
                .into_iter()
                .map(|property| spec(property, worlds, &joined))
                .collect::<Answer<_>>()?;
            Response::ListProperty(ListPropertyResponse { values })
        }
        None => return Err(Refusal::invalid("the property request is empty")),
    };
    Ok(Any {
        type_url: format!("type.googleapis.com/{RESPONSE}"),
        value: PropertyResponse { payload: Some(payload) }.encode_to_vec(),
    })
}
