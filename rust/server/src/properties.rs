//! The properties extension: what can be read and written beside steps.

use octoarm_arm::ParameterError;
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
use crate::protocol::tensor::{Payload, StringArray};
use crate::protocol::{Tensor, TensorSpec};
use crate::reply::{Answer, Refusal, quoted};
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
    State,
}

use Property as P;

impl Property {
    /// Those of the server.
    const UNIVERSAL: [Self; 2] = [P::Version, P::Worlds];
    /// Those of any joined world.
    const JOINED: [Self; 8] = [
        P::Settings,
        P::ActionRange,
        P::Amplitude,
        P::Period,
        P::Orbit,
        P::TeacherAction,
        P::Seed,
        P::State,
    ];
    /// Those of a world with one arm.
    const SINGLE: [Self; 3] = [P::ArmPositions, P::ArmJoints, P::ElapsedSteps];

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
            P::State => "state",
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
            P::State => "All that the episodes need to go on exactly where they stand, as JSON",
        }
    }

    fn readable(self) -> bool {
        self != P::Seed
    }

    fn writable(self) -> bool {
        matches!(self, P::ElapsedSteps | P::Seed | P::State)
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

fn json<T: serde::Serialize>(value: &T) -> Answer<Tensor> {
    let text = serde_json::to_string(value);
    text.map(tensor::text).map_err(|error| Refusal::new(Code::Internal, error.to_string()))
}

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
        (P::State, Episodes::Single(episode)) => json(&episode.state()),
        (P::State, Episodes::Batch(batch)) => json(&batch.state()),
        (P::ElapsedSteps, Episodes::Single(episode)) => {
            Ok(tensor::integer(episode.elapsed().cast_signed()))
        }
        (P::ArmPositions, Episodes::Single(episode)) => {
            let rows = episode.arm().positions();
            Ok(tensor::doubles(rows.as_flattened().to_vec(), &[rows.len() as i32, 3]))
        }
        (P::ArmJoints, Episodes::Single(episode)) => {
            let planes = episode.arm().joints();
            let flat = planes.as_flattened().as_flattened().to_vec();
            Ok(tensor::doubles(flat, &[planes.len() as i32, 4, 3]))
        }
        _ => {
            Err(Refusal::new(Code::PermissionDenied, format!("{} cannot be read", property.key())))
        }
    }
}

fn state_error(error: ParameterError) -> Refusal {
    Refusal::invalid(format!("state: {error}"))
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
        (P::State, episodes) => {
            let text = match &value.payload {
                Some(Payload::Strings(StringArray { array })) if array.len() == 1 => &array[0],
                _ => return Err(Refusal::invalid("state: expected one text, as it was read")),
            };
            match episodes {
                Episodes::Single(episode) => {
                    let state = octoarm_arm::read_json(text);
                    state.and_then(|state| episode.set_state(&state)).map_err(state_error)?;
                }
                Episodes::Batch(batch) => {
                    let state = octoarm_arm::read_json(text);
                    state.and_then(|state| batch.set_state(&state)).map_err(state_error)?;
                }
            }
            environment.restored();
        }
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
