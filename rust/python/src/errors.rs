//! Rust errors as Python exceptions.

use std::sync::{Arc, Mutex, PoisonError};

use octoarm_arm::ParameterError;
use pyo3::PyTypeInfo;
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

pyo3::create_exception!(
    octoarm_env,
    DomainError,
    PyRuntimeError,
    "The arm left the domain in which the model describes it; it keeps its last valid state.

Attributes: limit (str), compartment (int, from 1 at the base), value, low, high (float), time (s),
step (index, within the call, of the step that was not made), lengths and outputs (what was computed before it, or None)."
);

/// A parameter error as `ValueError`, too little memory as `MemoryError`.
pub(crate) fn invalid(error: ParameterError) -> PyErr {
    match error {
        ParameterError::Memory { .. } => PyMemoryError::new_err(error.to_string()),
        _ => PyValueError::new_err(error.to_string()),
    }
}

/// Does long work without the GIL, and gives it up when Python has a signal to handle: within 50 ms
/// of Ctrl-C.
pub(crate) fn interruptible<T: Send>(
    py: Python<'_>,
    work: impl FnOnce() -> Result<T, ParameterError> + Send,
) -> PyResult<T> {
    let raised: Arc<Mutex<Option<PyErr>>> = Arc::default();
    let caught = Arc::clone(&raised);
    let stop = move || {
        let error = Python::attach(|py| py.check_signals()).err();
        let stop = error.is_some();
        *caught.lock().unwrap_or_else(PoisonError::into_inner) = error;
        stop
    };
    let result = py.detach(|| octoarm_arm::interruptible(stop, work));
    let raised = raised.lock().unwrap_or_else(PoisonError::into_inner).take();
    raised.map_or(result.map_err(invalid), Err)
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
