//! The properties extension: what can be read and written beside steps.

use octoarm_arm::ArmState;
use octoarm_env::{Outcome, Reading, Word};
use prost::Message as _;
use prost_types::Any;
use tonic::Code;

use crate::environment::{Environment, Episodes};
use crate::protocol::extensions::properties::property_request::Payload as Request;
use crate::protocol::extensions::properties::property_response::Payload as Response;
use crate::protocol::extensions::properties::{
    ListPropertyResponse, PropertyRequest, PropertyResponse, PropertySpec, ReadPropertyResponse,
    WritePropertyResponse,
};
use crate::protocol::{Tensor, TensorSpec};
use crate::reply::{Answer, Refusal, quoted};
use crate::state::{self, Form};
use crate::tensor;

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
    ElapsedSteps,
    Seed,
    Begun,
    Ended,
    /// What a step tells, as it stands now.
    Word(usize),
    State,
    StateBytes,
}

use Property as P;

impl Property {
    /// Those of the server.
    const UNIVERSAL: [Self; 2] = [P::Version, P::Worlds];
    /// Those of any joined world.
    const JOINED: [Self; 19] = [
        P::Settings,
        P::ActionRange,
        P::Amplitude,
        P::Period,
        P::Orbit,
        P::TeacherAction,
        P::ArmPositions,
        P::ArmJoints,
        P::Word(0),
        P::Word(1),
        P::Word(2),
        P::Word(3),
        P::Word(4),
        P::Word(5),
        P::Begun,
        P::Ended,
        P::Seed,
        P::State,
        P::StateBytes,
    ];
    /// That of a world with one arm.
    const SINGLE: [Self; 1] = [P::ElapsedSteps];

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
            P::ElapsedSteps => "elapsed_steps",
            P::Seed => "seed",
            P::Begun => "begun",
            P::Ended => "ended",
            P::Word(place) => Outcome::INFO[place].name,
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
            P::ElapsedSteps => "Steps of the episode, which max_episode_steps ends",
            P::Seed => "Starts the generator of phases anew; of a batch, with the next reset",
            P::Begun => "Whether every arm has begun an episode",
            P::Ended => "Whether each arm's episode is over",
            P::Word(_) => "As a step observes it, of the arms as they stand",
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
    fn known(environment: Option<&Environment>) -> impl Iterator<Item = Self> {
        let single =
            environment.is_some_and(|joined| matches!(joined.episodes, Episodes::Single(_)));
        let joined = if environment.is_some() { &Self::JOINED[..] } else { &[] };
        let single = if single { &Self::SINGLE[..] } else { &[] };
        Self::UNIVERSAL.iter().chain(joined).chain(single).copied()
    }

    fn find(key: &str, environment: Option<&Environment>) -> Answer<Self> {
        Self::known(environment).find(|property| property.key() == key).ok_or_else(|| {
            let known: Vec<&str> = Self::known(environment).map(Self::key).collect();
            let more = if environment.is_none() { "; more when a world is joined" } else { "" };
            let message =
                format!("key = {} is unknown; known are {}{more}", quoted(key), known.join(", "));
            Refusal::new(Code::NotFound, message)
        })
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
    let swing = episodes.swing();
    let scalar = |value: f64| Ok(tensor::doubles(vec![value], &[]));
    let table = |rows: &[[f64; 2]]| {
        Ok(tensor::doubles(rows.as_flattened().to_vec(), &[rows.len() as i32, 2]))
    };
    match (property, episodes) {
        (P::Settings, _) => Ok(tensor::text(episodes.config().to_json()?)),
        (P::Amplitude, _) => scalar(swing.orbit.amplitude()),
        (P::Period, _) => scalar(swing.orbit.period()),
        (P::Orbit, _) => table(swing.orbit.table()),
        (P::ActionRange, Episodes::Single(episode)) => scalar(episode.action_range()),
        (P::ActionRange, Episodes::Batch(batch)) => scalar(batch.action_ranges()[0]),
        (P::TeacherAction, Episodes::Single(episode)) => {
            Ok(tensor::doubles(episode.teacher_action().to_vec(), &[2]))
        }
        (P::TeacherAction, Episodes::Batch(batch)) => table(&batch.teacher_actions()),
        (P::Begun, _) => Ok(tensor::bools(vec![episodes.begun()], &[])),
        (P::Ended, Episodes::Single(episode)) => Ok(tensor::bools(vec![episode.ended()], &[])),
        (P::Ended, Episodes::Batch(batch)) => {
            Ok(tensor::bools(batch.ended(), &rows(episodes, &[])))
        }
        (P::Word(place), _) => word(Outcome::INFO[place], episodes),
        (P::State, _) => state::save(episodes, Form::Text),
        (P::StateBytes, _) => state::save(episodes, Form::Bytes),
        (P::ElapsedSteps, Episodes::Single(episode)) => {
            Ok(tensor::integer(episode.elapsed().cast_signed()))
        }
        (P::ArmPositions, _) => {
            let arms = states(episodes);
            let flat = arms.iter().flat_map(|arm| arm.positions().into_flattened()).collect();
            Ok(tensor::doubles(flat, &rows(episodes, &[planes(episodes), 3])))
        }
        (P::ArmJoints, _) => {
            let body = &episodes.config().arm;
            let arms = states(episodes);
            let joints = arms.iter().flat_map(|arm| arm.joints(body));
            let flat = joints.flatten().flatten().collect();
            Ok(tensor::doubles(flat, &rows(episodes, &[planes(episodes), 4, 3])))
        }
        _ => {
            Err(Refusal::new(Code::PermissionDenied, format!("{} cannot be read", property.key())))
        }
    }
}

/// A shape for one arm, with the batch's size before it if there is one.
fn rows(episodes: &Episodes, shape: &[i32]) -> Vec<i32> {
    match episodes {
        Episodes::Single(_) => shape.to_vec(),
        Episodes::Batch(batch) => [&[batch.len() as i32], shape].concat(),
    }
}

/// Number of an arm's planes.
fn planes(episodes: &Episodes) -> i32 {
    episodes.config().arm.compartments as i32 + 1
}

fn states(episodes: &Episodes) -> Vec<ArmState> {
    match episodes {
        Episodes::Single(episode) => vec![episode.state().arm],
        Episodes::Batch(batch) => batch.arms().states(),
    }
}

/// A word for all arms as they stand.
fn word(word: Word, episodes: &Episodes) -> Answer<Tensor> {
    let outcomes = episodes.outcomes();
    let outcomes = outcomes.iter();
    match word.reading {
        Reading::Number(read) => {
            Ok(tensor::doubles(outcomes.map(read).collect(), &rows(episodes, &[])))
        }
        Reading::Angles(read) => {
            Ok(tensor::doubles(outcomes.flat_map(read).collect(), &rows(episodes, &[2])))
        }
        Reading::Index(read) => Ok(tensor::integers(outcomes.map(read), &rows(episodes, &[]))),
        Reading::Flag(_) | Reading::Text(_) => {
            Err(Refusal::new(Code::PermissionDenied, format!("{} cannot be read", word.name)))
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
            let known: Vec<Property> = Property::known(joined.as_deref()).collect();
            let values = known
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
