//! Requests to a server, and its answers, as Python has them.

use std::collections::BTreeMap;

use octoarm_protocol::environment_request::Payload as Asked;
use octoarm_protocol::environment_response::Payload as Answered;
use octoarm_protocol::extensions::properties::{
    PropertyRequest, PropertyResponse, ReadPropertyRequest, WritePropertyRequest, property_request,
    property_response,
};
use octoarm_protocol::tensor_spec::{Value, value};
use octoarm_protocol::{
    ActionObservationSpecs, CreateWorldRequest, EnvironmentRequest, EnvironmentResponse,
    JoinWorldRequest, ResetRequest, StepRequest, StepResponse, Tensor, TensorSpec,
};
use prost::Message as _;
use prost_types::Any;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::tensor::{pack, unpack};

const PROPERTY_REQUEST: &str =
    "type.googleapis.com/dm_env_rpc.v1.extensions.properties.PropertyRequest";

/// What an answer is called that cannot be read.
const UNREADABLE: &str = "an unreadable message";

/// A kind of answer, and what it holds.
pub(crate) type Answer<'py> = (&'static str, Bound<'py, PyAny>);

/// A request to a server.
#[pyclass(frozen, module = "octoarm_env._core")]
pub(crate) struct Request {
    message: EnvironmentRequest,
}

impl From<Asked> for Request {
    fn from(payload: Asked) -> Self {
        Self { message: EnvironmentRequest { payload: Some(payload) } }
    }
}

fn tensors(settings: &Bound<'_, PyDict>) -> PyResult<BTreeMap<String, Tensor>> {
    settings.iter().map(|(name, value)| Ok((name.extract()?, pack(&value)?))).collect()
}

fn property(payload: property_request::Payload) -> Request {
    let value = PropertyRequest { payload: Some(payload) }.encode_to_vec();
    Asked::Extension(Any { type_url: PROPERTY_REQUEST.to_owned(), value }).into()
}

#[pymethods]
impl Request {
    /// Makes a world.
    #[staticmethod]
    fn create_world(settings: &Bound<'_, PyDict>) -> PyResult<Self> {
        let request = CreateWorldRequest { settings: tensors(settings)? };
        Ok(Asked::CreateWorld(request).into())
    }

    /// Becomes the agent of a world.
    #[staticmethod]
    fn join_world(world_name: String) -> Self {
        let request = JoinWorldRequest { world_name, settings: BTreeMap::new() };
        Asked::JoinWorld(request).into()
    }

    /// Ends the episode; the next step begins one.
    #[staticmethod]
    fn reset(settings: &Bound<'_, PyDict>) -> PyResult<Self> {
        Ok(Asked::Reset(ResetRequest { settings: tensors(settings)? }).into())
    }

    /// Makes a step, for whose observations is asked by their numbers.
    #[staticmethod]
    #[pyo3(signature = (observations, action=None))]
    fn step(observations: Vec<u64>, action: Option<(u64, Bound<'_, PyAny>)>) -> PyResult<Self> {
        let action = action.map(|(number, value)| PyResult::Ok((number, pack(&value)?)));
        let request = StepRequest {
            actions: action.transpose()?.into_iter().collect(),
            requested_observations: observations,
        };
        Ok(Asked::Step(request).into())
    }

    /// Reads a property.
    #[staticmethod]
    fn read(key: String) -> Self {
        property(property_request::Payload::ReadProperty(ReadPropertyRequest { key }))
    }

    /// Writes a property.
    #[staticmethod]
    fn write(key: String, value: &Bound<'_, PyAny>) -> PyResult<Self> {
        let request = WritePropertyRequest { key, value: Some(pack(value)?) };
        Ok(property(property_request::Payload::WriteProperty(request)))
    }

    /// The kind of answer that belongs to it.
    #[getter]
    fn kind(&self) -> &'static str {
        match self.message.payload {
            Some(Asked::CreateWorld(_)) => "create_world",
            Some(Asked::JoinWorld(_)) => "join_world",
            Some(Asked::Step(_)) => "step",
            Some(Asked::Reset(_)) => "reset",
            Some(Asked::Extension(_)) => "extension",
            _ => "none that is made here",
        }
    }

    /// The same request, but a step of which nobody looks at what it brings.
    fn blind(&self) -> Self {
        let mut message = self.message.clone();
        if let Some(Asked::Step(request)) = &mut message.payload {
            request.requested_observations.clear();
        }
        Self { message }
    }
}

impl Request {
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        self.message.encode_to_vec()
    }
}

/// The bound of a spec, where it is one of doubles.
fn bound(value: Option<Value>) -> Option<Vec<f64>> {
    match value?.payload? {
        value::Payload::Doubles(list) => Some(list.array),
        _ => None,
    }
}

/// Specs by their names: number, shape, and bounds.
fn by_name<'py>(py: Python<'py>, specs: BTreeMap<u64, TensorSpec>) -> PyResult<Bound<'py, PyDict>> {
    let named = PyDict::new(py);
    for (number, spec) in specs {
        named.set_item(spec.name, (number, spec.shape, bound(spec.min), bound(spec.max)))?;
    }
    Ok(named)
}

fn stepped(py: Python<'_>, response: StepResponse) -> PyResult<Bound<'_, PyAny>> {
    let observations = PyDict::new(py);
    for (number, tensor) in response.observations {
        observations.set_item(number, unpack(py, tensor)?)?;
    }
    Ok((response.state, observations).into_pyobject(py)?.into_any())
}

/// An answer from its bytes: the name of the world, the specs, the state and the observations of a step, the
/// value of a property, or the code and the text of an error.
pub(crate) fn answer<'py>(py: Python<'py>, bytes: &[u8]) -> PyResult<Answer<'py>> {
    let nothing = || py.None().into_bound(py);
    let Ok(EnvironmentResponse { payload }) = EnvironmentResponse::decode(bytes) else {
        return Ok((UNREADABLE, nothing()));
    };
    Ok(match payload {
        None => (UNREADABLE, nothing()),
        Some(Answered::CreateWorld(made)) => {
            ("create_world", made.world_name.into_pyobject(py)?.into_any())
        }
        Some(Answered::JoinWorld(joined)) => {
            let ActionObservationSpecs { actions, observations } = joined.specs.unwrap_or_default();
            let specs = (by_name(py, actions)?, by_name(py, observations)?);
            ("join_world", specs.into_pyobject(py)?.into_any())
        }
        Some(Answered::Step(response)) => ("step", stepped(py, response)?),
        Some(Answered::Reset(_)) => ("reset", nothing()),
        Some(Answered::ResetWorld(_)) => ("reset_world", nothing()),
        Some(Answered::LeaveWorld(_)) => ("leave_world", nothing()),
        Some(Answered::DestroyWorld(_)) => ("destroy_world", nothing()),
        Some(Answered::Extension(response)) => {
            let Ok(PropertyResponse { payload }) = PropertyResponse::decode(&*response.value)
            else {
                return Ok((UNREADABLE, nothing()));
            };
            let value = match payload {
                Some(property_response::Payload::ReadProperty(read)) => {
                    unpack(py, read.value.unwrap_or_default())?
                }
                _ => nothing(),
            };
            ("extension", value)
        }
        Some(Answered::Error(error)) => {
            ("error", (error.code, error.message).into_pyobject(py)?.into_any())
        }
    })
}
