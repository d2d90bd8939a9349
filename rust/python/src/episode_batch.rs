//! `_core.EpisodeBatch`.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use numpy::{IntoPyArray, PyArray1};
use octoarm_arm::{ParameterError, memory};
use octoarm_env::{Autoreset, CheckedConfig, EpisodeConfig, Last, Outcome};
use pyo3::exceptions::PyValueError;
use pyo3::ffi::PyObject;
use pyo3::prelude::*;
use pyo3::types::{PyList, PyString};

use crate::arrays::{Joints, Table, Vector, joints_array, numbers, pairs_of, table};
use crate::errors::{interruptible, invalid};
use crate::infos::{Infos, Words, infos, step_infos};

/// Observations, rewards, terminations, truncations, infos.
type Step<'py> =
    (Table<'py>, Vector<'py>, Bound<'py, PyArray1<bool>>, Bound<'py, PyArray1<bool>>, Infos<'py>);

/// Many episodes; `octoarm_env.OctoArmVectorEnv` documents it.
#[pyclass(module = "octoarm_env._core")]
pub(crate) struct EpisodeBatch {
    inner: octoarm_env::EpisodeBatch,
}

fn words() -> Words<Outcome> {
    Outcome::INFO.iter().map(|word| (word.name, word.reading)).collect()
}

/// The mode of this name.
pub(crate) fn autoreset_mode(name: &str) -> PyResult<Autoreset> {
    serde_json::from_value(name.into())
        .map_err(|error| PyValueError::new_err(format!("autoreset = {name:?}: {error}")))
}

/// The actions of a step of so many episodes, (N, 2), after the checks that the step of a batch makes.
#[pyfunction]
pub(crate) fn check_actions<'py>(
    py: Python<'py>,
    actions: &Bound<'py, PyAny>,
    num_envs: usize,
) -> PyResult<Table<'py>> {
    let (actions, _) = numbers("actions", actions, &[Some(num_envs), Some(2)])?;
    let actions = octoarm_env::check_actions(pairs_of(&actions)).map_err(invalid)?;
    table(py, actions.into_flattened(), 2)
}

#[pymethods]
impl EpisodeBatch {
    #[new]
    fn new(
        py: Python<'_>,
        configs: &Bound<'_, PyList>,
        max_episode_steps: Option<u64>,
        autoreset: &str,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let autoreset = autoreset_mode(autoreset)?;
        // Environments are mostly alike: the same text is not read again.
        let mut known: HashMap<*mut PyObject, CheckedConfig> = HashMap::new();
        let what = format!("num_envs = {}", configs.len());
        let mut read = memory::reserved(&what, Some(configs.len())).map_err(invalid)?;
        for text in configs {
            let config = match known.entry(text.as_ptr()) {
                Entry::Occupied(entry) => entry.get().clone(),
                Entry::Vacant(entry) => {
                    let config = EpisodeConfig::from_json(text.cast::<PyString>()?.to_str()?);
                    let config = config.and_then(EpisodeConfig::checked).map_err(invalid)?;
                    entry.insert(config).clone()
                }
            };
            read.push(config);
        }
        let inner = interruptible(py, || {
            octoarm_env::EpisodeBatch::new(&read, max_episode_steps, autoreset, threads)
        })?;
        Ok(Self { inner })
    }

    #[pyo3(signature = (mask, seeds, phase))]
    fn reset<'py>(
        &mut self,
        py: Python<'py>,
        mask: Option<Vec<bool>>,
        seeds: Vec<Option<u64>>,
        phase: Option<f64>,
    ) -> PyResult<(Table<'py>, Infos<'py>)> {
        let reset =
            py.detach(|| self.inner.reset(mask.as_deref(), &seeds, phase)).map_err(invalid)?;
        let outcomes: Vec<Option<&Outcome>> = reset.outcomes.iter().map(Option::as_ref).collect();
        let infos = infos(py, words(), &outcomes)?;
        Ok((table(py, reset.observations, self.inner.observation_len())?, infos))
    }

    fn step<'py>(&mut self, py: Python<'py>, actions: &Bound<'py, PyAny>) -> PyResult<Step<'py>> {
        let (actions, _) = numbers("actions", actions, &[Some(self.inner.len()), Some(2)])?;
        let mut step = py.detach(|| self.inner.step(pairs_of(&actions))).map_err(invalid)?;
        let rewards: Vec<f64> = step.steps().map(|outcome| outcome.reward).collect();
        let terminated: Vec<bool> = step.steps().map(Outcome::terminated).collect();
        let truncated: Vec<bool> = step.steps().map(|outcome| outcome.truncated).collect();
        let seen = |last: Last| Ok(last.observation.into_pyarray(py));
        let infos = step_infos(py, words, &mut step, seen)?;
        Ok((
            table(py, step.observations, self.inner.observation_len())?,
            rewards.into_pyarray(py),
            terminated.into_pyarray(py),
            truncated.into_pyarray(py),
            infos,
        ))
    }

    fn teacher_actions<'py>(&self, py: Python<'py>) -> PyResult<Table<'py>> {
        table(py, self.inner.teacher_actions().into_flattened(), 2)
    }

    /// The infos of all episodes as they stand, as if they began there.
    fn infos<'py>(&self, py: Python<'py>) -> PyResult<Infos<'py>> {
        let outcomes = self.inner.outcomes();
        infos(py, words(), &outcomes.iter().map(Some).collect::<Vec<Option<&Outcome>>>())
    }

    fn save(&self) -> PyResult<String> {
        serde_json::to_string(&self.inner.state())
            .map_err(|error| invalid(ParameterError::Format(error.to_string())))
    }

    fn load(&mut self, py: Python<'_>, state: &str) -> PyResult<()> {
        let state = octoarm_arm::read_json(state).map_err(invalid)?;
        py.detach(|| self.inner.set_state(&state)).map_err(invalid)
    }

    #[getter]
    fn ended(&self) -> Vec<bool> {
        self.inner.ended()
    }

    #[getter]
    fn threads(&self) -> usize {
        self.inner.arms().threads()
    }

    #[getter]
    fn observation_len(&self) -> usize {
        self.inner.observation_len()
    }

    #[getter]
    fn observation_bounds(&self) -> Vec<(f64, f64)> {
        self.inner.observation_bounds()
    }

    #[getter]
    fn action_ranges<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.inner.action_ranges().into_pyarray(py)
    }

    #[getter]
    fn amplitudes<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.orbits().map(|orbit| orbit.amplitude()).collect::<Vec<f64>>().into_pyarray(py)
    }

    #[getter]
    fn periods<'py>(&self, py: Python<'py>) -> Vector<'py> {
        self.orbits().map(|orbit| orbit.period()).collect::<Vec<f64>>().into_pyarray(py)
    }

    #[getter]
    fn orbit_tables<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let tables: Vec<Table<'py>> = self
            .orbits()
            .map(|orbit| table(py, orbit.table().as_flattened().to_vec(), 2))
            .collect::<PyResult<_>>()?;
        PyList::new(py, tables)
    }

    /// Centres of an arm's planes.
    fn positions<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Table<'py>> {
        check_index(index, self.inner.len())?;
        table(py, self.inner.arms().state(index).positions().into_flattened(), 3)
    }

    /// Ends of an arm's longitudinal springs.
    fn joints<'py>(&self, py: Python<'py>, index: usize) -> PyResult<Joints<'py>> {
        check_index(index, self.inner.len())?;
        let state = self.inner.arms().state(index);
        joints_array(py, state.joints(self.inner.swing(index).arm.parameters()))
    }
}

impl EpisodeBatch {
    fn orbits(&self) -> impl Iterator<Item = &octoarm_env::Orbit> {
        (0..self.inner.len()).map(|index| &*self.inner.swing(index).orbit)
    }
}

/// Refuses the index of an environment that there is not.
pub(crate) fn check_index(index: usize, count: usize) -> PyResult<()> {
    if index < count {
        return Ok(());
    }
    Err(PyValueError::new_err(format!("index = {index}: expected 0 to {}", count - 1)))
}
