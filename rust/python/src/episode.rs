//! `_core.Episode`.

use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use octoarm_arm::ParameterError;
use octoarm_env::{DisturbanceInfo, EpisodeConfig, Orbit, Outcome, Reading, TargetName, Told};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyDict;

use crate::arrays::{Joints, Table, Vector, is_dense, joints_array, numbers, table};
use crate::errors::{interruptible, invalid};

/// One environment's episode; `octoarm_env.OctoArmEnv` documents it.
#[pyclass(module = "octoarm_env._core")]
pub(crate) struct Episode {
    inner: octoarm_env::Episode,
}

/// An action as two numbers: without a copy of the array for float32 and float64 vectors.
fn action(value: &Bound<'_, PyAny>) -> PyResult<[f64; 2]> {
    if let Ok(array) = value.cast_exact::<PyArray1<f32>>()
        && is_dense(array)
        && let [theta, phi] = array.readonly().as_slice()?
    {
        return Ok([f64::from(*theta), f64::from(*phi)]);
    }
    if let Ok(array) = value.cast_exact::<PyArray1<f64>>()
        && is_dense(array)
        && let [theta, phi] = array.readonly().as_slice()?
    {
        return Ok([*theta, *phi]);
    }
    let (numbers, _) = numbers("action", value, &[Some(2)])?;
    Ok([numbers[0], numbers[1]])
}

/// The action of a step as two numbers, after the checks that the step of an episode makes.
#[pyfunction]
pub(crate) fn check_step<'py>(
    py: Python<'py>,
    action: &Bound<'py, PyAny>,
    running: bool,
) -> PyResult<Vector<'py>> {
    let action = octoarm_env::check_step(self::action(action)?, running).map_err(invalid)?;
    Ok(PyArray1::from_slice(py, &action))
}

fn named(name: &str) -> PyResult<TargetName> {
    serde_json::from_value(name.into())
        .map_err(|error| PyValueError::new_err(format!("target = {name:?}: {error}")))
}

/// One turn of a named limit cycle \[degrees\], and its time \[s\].
#[pyfunction]
pub(crate) fn limit_cycle_orbit<'py>(
    py: Python<'py>,
    name: &str,
    amplitude: f64,
) -> PyResult<(Table<'py>, f64)> {
    let orbit = Orbit::named(named(name)?, amplitude);
    Ok((table(py, orbit.table().as_flattened().to_vec(), 2)?, orbit.period()))
}

/// A named limit cycle as the teacher gives it, one row a millisecond \[degrees\].
#[pyfunction]
pub(crate) fn limit_cycle_signal<'py>(
    py: Python<'py>,
    name: &str,
    amplitude: f64,
    steps: usize,
) -> PyResult<Table<'py>> {
    let name = named(name)?;
    let signal = interruptible(py, || Orbit::teacher_signal(name, amplitude, steps))?;
    table(py, signal.into_flattened(), 2)
}

/// Parameters of the bodies that episodes of these settings are made with, as JSON.
#[pyfunction]
pub(crate) fn drawn_bodies(config: &str) -> PyResult<Vec<String>> {
    let config = EpisodeConfig::from_json(config).and_then(EpisodeConfig::checked);
    let config = config.map_err(invalid)?;
    config.drawn_bodies().iter().map(|body| body.to_json().map_err(invalid)).collect()
}

impl Episode {
    fn observation<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.inner.observation().into_pyarray(py)
    }
}

/// The info of one episode; its numbers are NumPy's, as its arrays are: some readers of infos ask all
/// of them for a dtype.
fn info<'py>(py: Python<'py>, outcome: &Outcome) -> PyResult<Bound<'py, PyDict>> {
    static NUMBER: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    static INDEX: PyOnceLock<Py<PyAny>> = PyOnceLock::new();
    let number = NUMBER.import(py, "numpy", "float64")?;
    let index = INDEX.import(py, "numpy", "int64")?;
    let info = PyDict::new(py);
    for word in Outcome::INFO {
        match word.reading {
            Reading::Number(read) => info.set_item(word.name, number.call1((read(outcome),))?)?,
            Reading::Angles(read) => {
                info.set_item(word.name, PyArray1::from_slice(py, &read(outcome)))?;
            }
            Reading::Point(read) => {
                info.set_item(word.name, PyArray1::from_slice(py, &read(outcome)))?;
            }
            Reading::Index(read) => info.set_item(word.name, index.call1((read(outcome),))?)?,
            Reading::Flag(read) => info.set_item(word.name, read(outcome))?,
            Reading::Text(read) => {
                if let Some(text) = read(outcome) {
                    info.set_item(word.name, text)?;
                }
            }
        }
    }
    let disturbance = outcome.disturbance.as_deref();
    for (name, read) in disturbance.map_or(&[][..], |_| &DisturbanceInfo::PARTS) {
        match disturbance.and_then(read) {
            Some(Told::Numbers(numbers)) => {
                info.set_item(name, PyArray1::from_slice(py, numbers))?
            }
            Some(Told::Flags(flags)) => info.set_item(name, PyArray1::from_slice(py, flags))?,
            Some(Told::Count(count)) => info.set_item(name, index.call1((count,))?)?,
            None => {}
        }
    }
    Ok(info)
}

#[pymethods]
impl Episode {
    #[new]
    fn new(py: Python<'_>, config: &str) -> PyResult<Self> {
        let config = EpisodeConfig::from_json(config).map_err(invalid)?;
        let inner = interruptible(py, || octoarm_env::Episode::new(config))?;
        Ok(Self { inner })
    }

    fn seed(&mut self, seed: u64) {
        self.inner.seed(seed);
    }

    #[pyo3(signature = (phase=None))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        phase: Option<f64>,
    ) -> PyResult<(Vector<'py>, Bound<'py, PyDict>)> {
        let outcome = match phase {
            None => self.inner.reset(),
            Some(phase) => self.inner.reset_to_phase(phase).map_err(invalid)?,
        };
        Ok((self.observation(py), info(py, &outcome)?))
    }

    fn step<'py>(
        &mut self,
        py: Python<'py>,
        action: &Bound<'py, PyAny>,
    ) -> PyResult<(Vector<'py>, f64, bool, Bound<'py, PyDict>)> {
        let action = self::action(action)?;
        let outcome = py.detach(|| self.inner.step(action)).map_err(invalid)?;
        Ok((self.observation(py), outcome.reward, outcome.terminated(), info(py, &outcome)?))
    }

    fn teacher_action<'py>(&self, py: Python<'py>) -> Vector<'py> {
        PyArray1::from_slice(py, &self.inner.teacher_action())
    }

    fn save(&self) -> PyResult<String> {
        serde_json::to_string(&self.inner.state())
            .map_err(|error| invalid(ParameterError::Format(error.to_string())))
    }

    fn load(&mut self, state: &str) -> PyResult<()> {
        let state = octoarm_arm::read_json(state).map_err(invalid)?;
        self.inner.set_state(&state).map_err(invalid)
    }

    #[getter]
    fn config(&self) -> PyResult<String> {
        self.inner.config().to_json().map_err(invalid)
    }

    #[getter]
    fn action_range(&self) -> f64 {
        self.inner.action_range()
    }

    #[getter]
    fn observation_len(&self) -> usize {
        self.inner.arm().observation_len()
    }

    #[getter]
    fn observation_bounds(&self) -> (f64, f64) {
        self.inner.observation_bounds()
    }

    #[getter]
    fn amplitude(&self) -> f64 {
        self.inner.swing().orbit.amplitude()
    }

    #[getter]
    fn period(&self) -> f64 {
        self.inner.swing().orbit.period()
    }

    #[getter]
    fn orbit<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        table(py, self.inner.swing().orbit.table().as_flattened().to_vec(), 2)
    }

    #[getter]
    fn joints<'py>(&self, py: Python<'py>) -> PyResult<Joints<'py>> {
        joints_array(py, self.inner.arm().joints())
    }

    #[getter]
    fn positions<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        table(py, self.inner.arm().positions().into_flattened(), 3)
    }
}
