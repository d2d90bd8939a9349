//! Rust errors as Python exceptions.

use octoarm_arm::ParameterError;
use pyo3::PyTypeInfo;
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    octoarm_env,
    DomainError,
    PyRuntimeError,
    "The arm left the domain in which the model describes it; it keeps its last valid state.

Attributes: limit (str), compartment (int, from 1 at the base), value, low, high (float), time (s),
step (index, within the call, of the step that was not made), lengths and outputs (what was computed before it, or None)."
);

/// A parameter error as `ValueError`.
pub(crate) fn invalid(error: ParameterError) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// A domain error as [`DomainError`], with its attributes.
pub(crate) fn left_domain(
    py: Python<'_>,
    error: &octoarm_arm::DomainError,
    step: usize,
    lengths: Option<Bound<'_, PyAny>>,
    outputs: Option<Bound<'_, PyAny>>,
) -> PyErr {
    let build = || -> PyResult<PyErr> {
        let instance = DomainError::type_object(py).call1((error.to_string(),))?;
        instance.setattr("limit", error.limit.name())?;
        instance.setattr("compartment", error.compartment)?;
        instance.setattr("value", error.value)?;
        instance.setattr("low", error.low)?;
        instance.setattr("high", error.high)?;
        instance.setattr("time", error.time)?;
        instance.setattr("step", step)?;
        instance.setattr("lengths", lengths)?;
        instance.setattr("outputs", outputs)?;
        Ok(PyErr::from_value(instance))
    };
    build().unwrap_or_else(|failure| failure)
}
